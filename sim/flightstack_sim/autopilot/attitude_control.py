"""Attitude control: quaternion error to body rates, with yaw behind roll and pitch in priority.

After Brescianini, Hehn and D'Andrea, "Nonlinear Quadrocopter Attitude Control" (ETH Zurich, 2013), which PX4's
documentation names: the reduced attitude turns the thrust axis to where it should point by the shortest way; the turn
about that axis that is left over counts only in part (MC_YAW_WEIGHT).  Rates = gain * 2 sgn(q_w) q_xyz of the error;
yaw's gain is divided by the weight, so that small yaw errors see MC_YAW_P itself.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.frames import quat_conjugate, quat_multiply
from flightstack.jit import njit
from flightstack.rows import Q_W, Q_X, Q_Y, Q_Z
from flightstack.types import F64
from flightstack_sim.autopilot.params import Params

_YAW_WEIGHT = 6
"""Of the configuration, after gains and limits."""


@njit
def reduced_attitude(q: F64, q_sp: F64) -> F64:
    """Setpoint (4,) that has `q_sp`'s thrust axis and is reached from `q` by the shortest turn of that axis."""
    ax, ay, az = 2.0 * (q[Q_X] * q[Q_Z] + q[Q_W] * q[Q_Y]), 2.0 * (q[Q_Y] * q[Q_Z] - q[Q_W] * q[Q_X]), 0.0
    az = 1.0 - 2.0 * (q[Q_X] * q[Q_X] + q[Q_Y] * q[Q_Y])
    bx, by = (
        2.0 * (q_sp[Q_X] * q_sp[Q_Z] + q_sp[Q_W] * q_sp[Q_Y]),
        2.0 * (q_sp[Q_Y] * q_sp[Q_Z] - q_sp[Q_W] * q_sp[Q_X]),
    )
    bz = 1.0 - 2.0 * (q_sp[Q_X] * q_sp[Q_X] + q_sp[Q_Y] * q_sp[Q_Y])
    turn = np.empty(4)
    turn[Q_W] = 1.0 + ax * bx + ay * by + az * bz
    turn[Q_X] = ay * bz - az * by
    turn[Q_Y] = az * bx - ax * bz
    turn[Q_Z] = ax * by - ay * bx
    norm = math.sqrt(turn[Q_W] ** 2 + turn[Q_X] ** 2 + turn[Q_Y] ** 2 + turn[Q_Z] ** 2)
    if norm < 1e-4:  # opposite axes: every way is as short, take the setpoint's own
        return q_sp.copy()
    return quat_multiply(turn / norm, q)


@njit
def attitude_error(q: F64, q_sp: F64, yaw_weight: float) -> F64:
    """Rotation (3,) about the body axes from `q` to `q_sp` as 2 sgn(w) (x, y, z), yaw's part weighted."""
    reduced = reduced_attitude(q, q_sp)
    left = quat_multiply(quat_conjugate(reduced), q_sp)
    if left[Q_W] < 0.0:
        left = -left
    angle = 2.0 * math.atan2(left[Q_Z], left[Q_W])
    half = 0.5 * yaw_weight * angle
    goal = quat_multiply(reduced, np.array([math.cos(half), 0.0, 0.0, math.sin(half)]))
    error = quat_multiply(quat_conjugate(q), goal)
    sign = 2.0 if error[Q_W] >= 0.0 else -2.0
    return np.array([sign * error[Q_X], sign * error[Q_Y], sign * error[Q_Z]])


@njit
def attitude_step(q: F64, q_sp: F64, yaw_rate_sp: float, c: F64, rate_out: F64) -> None:
    """Write rates (3,) rad/s; `c`: gains (3,), limits (3,), yaw weight; `yaw_rate_sp` turns about the world's down."""
    error = attitude_error(q, q_sp, c[_YAW_WEIGHT])
    # the world's down axis in the body: third row of the rotation matrix
    down = (
        2.0 * (q[Q_X] * q[Q_Z] - q[Q_W] * q[Q_Y]),
        2.0 * (q[Q_Y] * q[Q_Z] + q[Q_W] * q[Q_X]),
        1.0 - 2.0 * (q[Q_X] * q[Q_X] + q[Q_Y] * q[Q_Y]),
    )
    for axis in range(3):
        rate = c[axis] * error[axis] + yaw_rate_sp * down[axis]
        rate_out[axis] = min(max(rate, -c[3 + axis]), c[3 + axis])


class AttitudeControl:
    """Attitude loop of one vehicle; `rate_setpoint_frd_radps` (3,) is updated in place."""

    __slots__ = ("_config", "rate_setpoint_frd_radps")

    def __init__(self, params: Params) -> None:
        self._config = np.zeros(7)
        self.rate_setpoint_frd_radps = np.zeros(3)
        self.configure(params)

    def configure(self, params: Params) -> None:
        """Take gains and limits from the parameters."""
        c = self._config
        weight = params.get("MC_YAW_WEIGHT")
        c[0], c[1] = params.get("MC_ROLL_P"), params.get("MC_PITCH_P")
        c[2] = params.get("MC_YAW_P") / weight if weight > 1e-4 else 0.0
        for axis, name in enumerate(("ROLLRATE", "PITCHRATE", "YAWRATE")):
            c[3 + axis] = math.radians(params.get(f"MC_{name}_MAX"))
        c[_YAW_WEIGHT] = weight

    def step(self, q_ned_frd: F64, q_sp_ned_frd: F64, yaw_rate_sp_radps: float) -> None:
        """Attitude and setpoint (4,) -> `rate_setpoint_frd_radps`."""
        attitude_step(q_ned_frd, q_sp_ned_frd, yaw_rate_sp_radps, self._config, self.rate_setpoint_frd_radps)
