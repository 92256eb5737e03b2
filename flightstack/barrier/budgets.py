"""The thrust budget that balances what is known and leaves what is asked for.

A lean to each axis of its own: about the one that balances the steady force along it, as the learner has it, to either
side as far as what is asked for takes, and by what the filter keeps from the ends (`records.Budget.lean_spare`).  A
wind along one axis leaves the other's range as it is, and what a lean takes from thrust along down is that of the
corner that leans furthest.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.barrier.certifier_config import Thrust
from flightstack.barrier.initial import DOWN
from flightstack.barrier.posterior import Accelerations
from flightstack.barrier.records import Budget, Leans
from flightstack.model import Limits, Model
from flightstack.types import STANDARD_GRAVITY_MPS2

HOVER_OFF = 1.05
"""The thrust of hover, by which that of other commands is counted, may do so much more than the weight."""
_LEAST_HOVER_MPS2 = 1.0
"""What a vehicle out of hand has taught of its hover may be below zero."""
_ROUNDS = 20
NONE = (0.0, 0.0), (0.0, 0.0)


def budget(
    model: Model, limits: Limits, *, sideways_mps2: Leans = NONE, low_mps2: float = 0.0, high_mps2: float = math.inf,
    hover_mps2: float | None = None, tilt_off: float = 0.0,
) -> Budget:  # fmt: skip
    """Thrust of any length from `low` to the greatest, leaning as far as the specific thrust sideways asks for at F0.

    F0 = max(hover, (low + high) / 2) is the thrust that the filter steers with (`response`); to north and to east it
    asks for leans of (least, most) / F0, and to either side for what is spared: what the tilt may be off by, tilt_off,
    as far as the greatest thrust is above hover.  Whatever the lean within the box, thrust reaches down to `low` and up
    to high = greatest cos(tilt) along down, tilt that of the box's furthest corner; the greatest is the vehicle's, or
    what reaches up to `high_mps2`.  All is specific thrust as commanded, so it fits whatever the gain is.  Tilt is cut
    at the limit, and all leans with it.
    """
    least, greatest = (n / model.mass_kg for n in model.thrust_range_n(limits))
    hover = max(hover_mps2 or STANDARD_GRAVITY_MPS2, least)  # a vehicle out of hand may teach that it needs none
    low = min(max(low_mps2, least), greatest)
    most = math.sin(limits.tilt_max_rad)
    upright, lead, spare, leans = 1.0, max(hover, 0.5 * (low + greatest)), 0.0, NONE
    for _ in range(_ROUNDS):  # high and with it F0 fall a little with the lean: a contraction
        longest = max(min(greatest * upright, high_mps2), low) / upright
        spare = HOVER_OFF * longest / hover * tilt_off
        leans, corner = _cut([(a / lead - spare, b / lead + spare) for a, b in sideways_mps2], most)
        upright = math.sqrt(1.0 - corner * corner)
        lead = max(hover, 0.5 * (low + min(greatest * upright, high_mps2)))
    high = max(min(greatest * upright, high_mps2), low)
    north, east = leans
    spare = HOVER_OFF * high / upright / hover * tilt_off
    return Budget(*north, *east, low, high, high / upright, math.acos(upright), spare)


def _cut(leans: list[tuple[float, float]], most: float) -> tuple[Leans, float]:
    """These leans, all cut alike where their furthest corner is beyond the limit; and that corner."""
    furthest = math.hypot(*(max(abs(a), abs(b)) for a, b in leans))
    share = min(1.0, most / furthest) if furthest > 0.0 else 1.0
    (a, b), (c, d) = leans
    return ((share * a, share * b), (share * c, share * d)), share * furthest


def budget_for(
    model: Model, limits: Limits, learned: Accelerations, asked: Thrust, tilt_off: float
) -> tuple[Budget, float]:
    """The budget for a vehicle as learned; and the specific thrust of hover."""
    g = STANDARD_GRAVITY_MPS2
    thrust = np.array([[0.0, 0.0, 0.8 * g], [0.0, 0.0, 1.6 * g]])
    still, far = np.zeros((2, 3)), np.zeros(2)
    down, _, _ = learned.at(DOWN, still, thrust, far)
    gain = max(float(down[0] - down[1]) / (0.8 * g), 0.2)
    hover = max(0.8 * g + float(down[0]) / gain, _LEAST_HOVER_MPS2)
    at = np.array([[0.0, 0.0, hover]])
    forces = [float(learned.at(i, still[:1], at, far[:1])[0][0]) for i in (0, 1)]
    north, east = (((force - asked.lateral_mps2) / gain, (force + asked.lateral_mps2) / gain) for force in forces)
    box = budget(
        model, limits, sideways_mps2=(north, east), low_mps2=asked.least_hovers * hover,
        high_mps2=asked.most_hovers * hover, hover_mps2=hover, tilt_off=tilt_off,
    )  # fmt: skip
    return box, hover
