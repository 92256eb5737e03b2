"""The battery: open-circuit voltage falling linearly with charge, and an inner resistance.

The rotors draw their induced power sum T^1.5 / sqrt(2 rho A) over a figure of merit (motors and ESCs included); the
terminal voltage solves V = OCV - R P / V, and where no such V exists the battery gives all it can, V = OCV / 2.
"""

from __future__ import annotations

import math

from flightstack.effects import row as at
from flightstack.jit import njit
from flightstack.types import F64

FIGURE_OF_MERIT = 0.6


@njit
def discharge(p: F64, row: F64) -> None:
    """Take one step's charge out of the battery and set the voltage that the next step sees; 0 V without battery."""
    if p[at.P_HAS_BATTERY] == 0.0:
        row[at.S_VOLTAGE] = 0.0
        return
    power = 0.0
    for i in range(4):
        thrust = max(row[at.S_THRUST + i], 0.0)
        power += thrust * math.sqrt(thrust / p[at.D_DISK])
    power /= FIGURE_OF_MERIT
    open_circuit = p[at.P_EMPTY_V] + (p[at.P_FULL_V] - p[at.P_EMPTY_V]) * row[at.S_CHARGE]
    inside = max(open_circuit * open_circuit - 4.0 * p[at.P_RESISTANCE] * power, 0.0)
    voltage = 0.5 * (open_circuit + math.sqrt(inside))
    row[at.S_VOLTAGE] = voltage
    row[at.S_CHARGE] = max(row[at.S_CHARGE] - power / voltage * p[at.P_DT] / p[at.P_CAPACITY], 0.0)
