"""The thrust budget that balances what is known and leaves what is asked for."""

from __future__ import annotations

import numpy as np

from flightstack.barrier.certifier_config import Thrust
from flightstack.barrier.initial import DOWN
from flightstack.barrier.posterior import Accelerations
from flightstack.barrier.queries import budget
from flightstack.barrier.records import Budget
from flightstack.model import Limits, Model
from flightstack.types import STANDARD_GRAVITY_MPS2

_LEAST_HOVER_MPS2 = 1.0
"""What a vehicle out of hand has taught of its hover may be below zero."""


def budget_for(model: Model, limits: Limits, learned: Accelerations, asked: Thrust) -> tuple[Budget, float]:
    """The budget that balances what is known and leaves what is asked for; and the specific thrust of hover."""
    g = STANDARD_GRAVITY_MPS2
    thrust = np.array([[0.0, 0.0, 0.8 * g], [0.0, 0.0, 1.6 * g]])
    still, far = np.zeros((2, 3)), np.zeros(2)
    down, _, _ = learned.at(DOWN, still, thrust, far)
    gain = max(float(down[0] - down[1]) / (0.8 * g), 0.2)
    hover = max(0.8 * g + float(down[0]) / gain, _LEAST_HOVER_MPS2)
    at = np.array([[0.0, 0.0, hover]])
    force = max(
        abs(float(mean[0])) + 3.0 * float(sigma[0])
        for mean, sigma, _ in (learned.at(i, still[:1], at, far[:1]) for i in (0, 1))
    )
    box = budget(
        model, limits, lateral_mps2=(force + asked.lateral_mps2) / gain,
        low_mps2=asked.least_hovers * hover, high_mps2=asked.most_hovers * hover, hover_mps2=hover,
    )  # fmt: skip
    return box, hover
