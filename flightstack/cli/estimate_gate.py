"""Whether the vehicle's own words bear out what certificates of a flight take its estimate for.

Nobody knows the truth on a real vehicle.  What is known is what its estimator states of itself (ESTIMATOR_STATUS) and
how far its velocity and position disagree; where either contradicts the grade of sensors that was named, nothing is
certified, and a certificate in force is handed over (`WatchedCertifier.contradicted`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flightstack.barrier.estimate_bounds import EstimateBounds, contradiction
from mavlink_bridge.companion import Companion

_JUDGED_FROM_US = 5_000_000
"""Of flight: before, rms(c) is that of the climb."""


class EstimateGate:
    """Asked at every tick of the flight; nothing is said against anything before `companion` is known."""

    def __init__(self, bounds: EstimateBounds, sensors: str, say: Callable[[str], None]) -> None:
        self.companion: Companion | None = None
        self._bounds, self._sensors, self._say = bounds, sensors, say

    def __call__(self) -> str:
        """What contradicts the grade, in words, said when it is found; empty where nothing does."""
        words = self.look()
        if words:
            self._say(f"not protected: {words}; name the sensors that it has with --sensors")
        return words

    def look(self) -> str:
        """The same, said to nobody."""
        companion = self.companion
        if companion is None:
            return ""
        begun_us = companion.flight_start_us
        judged = begun_us >= 0 and companion.last_t_us - begun_us > _JUDGED_FROM_US
        rms = companion.view.streams.observer.rms_ned_mps if judged else np.zeros(3)
        return contradiction(self._bounds, self._sensors, companion.view.accuracy_m, rms)
