"""Control allocation: torque and collective thrust to motor commands, as PX4 does for a multirotor.

The mixing matrix is `flightstack.autopilot.mixer`.

Saturation is PX4's sequential desaturation with MC_AIRMODE 0, its order confirmed on a recorded flight: commands of
roll, pitch and collective thrust are mixed and brought into range by moving along one column after another, thrust
(only down: never raised for attitude), roll, pitch; yaw comes on top and gives way first, with 0.15 of headroom at full
command that thrust then gives up.
"""

from __future__ import annotations

import math

from flightstack.jit import njit
from flightstack.types import F64

YAW_HEADROOM = 0.15
"""Command above 1 that yaw may ask for; thrust makes room for it."""


@njit
def allocate(mix: F64, roll: float, pitch: float, yaw: float, thrust: float, motors: F64, lost: F64) -> None:
    """Write motor commands (4,) 0..1, and the torque (3,) that could not be given, for the integrators.

    `mix` (16,): the mixing matrix row by row, a rotor's share in roll, pitch, yaw, thrust.
    `thrust` is collective; anything that isn't finite turns the motors off.
    """
    lost[:] = 0.0
    if not (math.isfinite(thrust) and math.isfinite(roll) and math.isfinite(pitch) and math.isfinite(yaw)):
        motors[:] = 0.0
        return
    thrust = min(max(thrust, 0.0), 1.0)
    for i in range(motors.shape[0]):
        motors[i] = mix[4 * i] * roll + mix[4 * i + 1] * pitch + mix[4 * i + 3] * thrust
    _bring_in(mix, 3, motors, 1.0, True)
    lost[0] = -_bring_in(mix, 0, motors, 1.0, False)
    lost[1] = -_bring_in(mix, 1, motors, 1.0, False)
    for i in range(motors.shape[0]):
        motors[i] += mix[4 * i + 2] * yaw
    lost[2] = -_bring_in(mix, 2, motors, 1.0 + YAW_HEADROOM, False)
    _bring_in(mix, 3, motors, 1.0, True)
    for i in range(motors.shape[0]):
        motors[i] = min(max(motors[i], 0.0), 1.0)


@njit
def _bring_in(mix: F64, column: int, motors: F64, upper: float, only_down: bool) -> float:
    """Move the commands along a column towards 0..upper; returns how far.

    A second move of half the length settles between the two limits where both are broken.
    """
    first = _excess(mix, column, motors, upper)
    if only_down and first > 0.0:
        return 0.0
    for i in range(motors.shape[0]):
        motors[i] += first * mix[4 * i + column]
    second = 0.5 * _excess(mix, column, motors, upper)
    for i in range(motors.shape[0]):
        motors[i] += second * mix[4 * i + column]
    return first + second


@njit
def _excess(mix: F64, column: int, motors: F64, upper: float) -> float:
    """Move along the column that the worst command asks for; those in opposite directions add up."""
    up, down = 0.0, 0.0
    for i in range(motors.shape[0]):
        share = mix[4 * i + column]
        if abs(share) < 1e-9:
            continue
        if motors[i] < 0.0:
            move = -motors[i] / share
        elif motors[i] > upper:
            move = (upper - motors[i]) / share
        else:
            continue
        up, down = max(up, move), min(down, move)
    return up + down
