"""The thrust budget of a certificate: how far it leans, how strong it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .intervals import F64


@dataclass
class Box:
    """The thrust that may be asked for: b's parts along north and east, down part (low, high), m/s^2."""

    leans: F64
    """(2, 2) least and greatest, north and east."""
    spare: float
    """What the filter keeps from either end of them."""
    low: float
    high: float

    @property
    def corner(self) -> float:
        """Sine of the greatest tilt."""
        return math.hypot(*(float(np.abs(ends).max()) for ends in self.leans))

    @property
    def greatest(self) -> float:
        """Thrust whose down part is `high` at the greatest tilt."""
        return self.high / math.sqrt(1.0 - self.corner**2)

    def kept(self, axis: int) -> tuple[float, float]:
        """Least and greatest lean that is steered to."""
        least, most = (float(end) for end in self.leans[axis])
        return min(least + self.spare, 0.5 * (least + most)), max(most - self.spare, 0.5 * (least + most))
