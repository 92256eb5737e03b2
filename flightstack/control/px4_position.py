"""PX4's own position control as its documentation describes it, flown from the companion.

    v_sp = v_ref + P (r_ref - r)                               feedback's share within MPC_XY_VEL_MAX, MPC_Z_VEL_MAX_*
    a_sp = a_ref + P_v (v_sp - v) + I_v int(v_sp - v) + D_v (a_ref - a)
    body z along (-a_x, -a_y, g - a_z),  thrust = hover thrust * |(a_x, a_y, g - a_z)| / g

a is the velocity's derivative behind MPC_VELD_LP (5 Hz).  The hover thrust is estimated in flight from
thrust and acceleration; when it moves, the vertical integral moves so that thrust doesn't.  The integral is held where
the limits cut the acceleration: down by condition, sideways by back-calculation with 2 / P_v.

Three things are better than in PX4 with its defaults, so that nothing but the law is compared: the tilt counts the
vertical acceleration (PX4's MPC_ACC_DECOUPLE = 0), the D term sees the reference's acceleration, and the attitude
loop gets the reference's body rates and the lag compensation that every controller here has (PX4 has neither).
Source: PX4 user guide, "Controller Diagrams" and the parameter reference, v1.14 to v1.16.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flightstack.control.attitude import PROPOSAL, AttitudeGains, follow, reachable, together, vehicle_rows
from flightstack.control.pid import Remembered, filter_acceleration
from flightstack.frames import Rows3, rotation
from flightstack.jit import njit
from flightstack.model import Limits, Model
from flightstack.rows import L_GAIN
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Command, FlatOutput, Learned, Measurement, Proposal

_INTEGRAL, _FILTERED, _HOVER, _GROUND, _STAGE, _ACC_DOWN, _MEMORY = 0, 3, 6, 7, 8, 9, 10
_P, _VEL_P, _I, _DAMPING, _HOVER_LAG = range(5)
"""Of the constants."""
_UNSEEN, _LOW, _AIRBORNE = 0.0, 1.0, 2.0
_SPEED_MAX_MPS = (12.0, 12.0, 1.5)
"""MPC_XY_VEL_MAX, MPC_Z_VEL_MAX_DN."""
_CLIMB_MAX_MPS = 3.0
"""MPC_Z_VEL_MAX_UP."""
_FILTER_RADPS = 2.0 * math.pi * 5.0
_RISEN_M = 0.5
_HOVER_RANGE = (0.4, 2.5)
_LEAST_LOAD_FACTOR = 0.3
"""Nearly falling, a sample of the hover thrust says more about noise than about weight."""


@dataclass(frozen=True, slots=True)
class Px4Gains:
    """PX4's parameters of the same names, and the hover thrust's time constant."""

    xy_p: float = 2.0
    xy_vel_p_acc: float = 4.0
    xy_vel_i_acc: float = 2.0
    xy_vel_d_acc: float = 0.2
    z_p: float = 2.0
    z_vel_p_acc: float = 6.0
    z_vel_i_acc: float = 3.0
    z_vel_d_acc: float = 0.2
    hover_thrust_s: float = 2.0
    """PX4 has a Kalman filter here; a low-pass stands for it."""


class Px4Controller:
    """The cascade above for one model; final, holds only constants."""

    __slots__ = ("_constants",)

    def __init__(self, model: Model, limits: Limits, attitude: AttitudeGains, gains: Px4Gains) -> None:
        self._constants = np.array(
            [
                (gains.xy_p, gains.xy_p, gains.z_p),
                (gains.xy_vel_p_acc, gains.xy_vel_p_acc, gains.z_vel_p_acc),
                (gains.xy_vel_i_acc, gains.xy_vel_i_acc, gains.z_vel_i_acc),
                (gains.xy_vel_d_acc, gains.xy_vel_d_acc, gains.z_vel_d_acc),
                (gains.hover_thrust_s, 0.0, 0.0),
                *vehicle_rows(model, limits, attitude),
            ]
        )

    def init(self, now_us: int) -> Remembered:
        """Nothing integrated, the hover thrust as believed."""
        memory = np.zeros(_MEMORY)
        memory[_HOVER] = 1.0
        return Remembered(memory, now_us)

    def healthy(self, state: Remembered) -> bool:
        """Whether integral, filter and hover thrust are finite."""
        return state.healthy

    def step(
        self, state: Remembered, measurement: Measurement, reference: FlatOutput, learned: Learned, sent: Command,
        now_us: int,
    ) -> tuple[Remembered, Proposal]:  # fmt: skip
        """One step; `sent` feeds the hover thrust's estimate."""
        row, memory = np.empty(PROPOSAL), state.row.copy()
        thrust = _step(
            self._constants, memory, state.seconds_until(now_us), sent.thrust_n, reference.row, measurement.row,
            learned.row, row,
        )  # fmt: skip
        return Remembered(memory, now_us), Proposal(thrust, row)


@njit
def _step(
    constants: F64, memory: F64, dt: float, sent_n: float, reference: F64, measured: F64, learned: F64, out: F64
) -> float:
    """One step, `memory` (10,) in place; rows as in `follow`, `measured` (20,) a Measurement's."""
    q, rate, vehicle = measured[6:10], measured[10:13], constants[5:10]
    acc, jerk, integral, filtered = out[11:14], out[14:17], memory[0:3], memory[_FILTERED:_HOVER]
    r = rotation(q)
    filter_acceleration(r, measured[13:16], math.exp(-dt * _FILTER_RADPS), filtered)
    _hover_thrust(r, sent_n / vehicle[2, 0], measured, dt / (dt + constants[_HOVER_LAG, 0]), memory)
    gain = learned[L_GAIN] / memory[_HOVER]
    missing = np.empty(3)
    for i in range(3):
        least = -_CLIMB_MAX_MPS if i == 2 else -_SPEED_MAX_MPS[i]
        push = min(max(constants[_P, i] * (reference[i] - measured[i]), least), _SPEED_MAX_MPS[i])
        missing[i] = reference[3 + i] + push - measured[3 + i]
        damping = constants[_DAMPING, i] * (reference[6 + i] - filtered[i])
        acc[i] = reference[6 + i] + constants[_VEL_P, i] * missing[i] + integral[i] + damping
        jerk[i] = reference[9 + i]
    reached = reachable(acc, learned[0:3], reference[3:6], gain, vehicle)
    for i in range(3):
        cut = acc[i] - reached[i]
        if i < 2:
            missing[i] -= 2.0 / max(constants[_VEL_P, i], 1e-3) * cut
        elif missing[i] * cut > 1e-9:
            missing[i] = 0.0
        integral[i] += constants[_I, i] * missing[i] * dt
        integral[i] = min(max(integral[i], -STANDARD_GRAVITY_MPS2), STANDARD_GRAVITY_MPS2)
    memory[_ACC_DOWN] = acc[2]
    out[1] = 0.0
    follow(vehicle, reached, jerk, reference, learned, gain, (r, rate), out)
    return together(out)


@njit
def _hover_thrust(r: Rows3, sent_mps2: float, measured: F64, share: float, memory: F64) -> None:
    """Estimate the ratio of true to believed hover thrust; keep (a_z - g) * hover, hence thrust, by the integral."""
    f = measured[13:16]
    load_factor = -(r[2][0] * f[0] + r[2][1] * f[1] + r[2][2] * f[2]) / STANDARD_GRAVITY_MPS2
    if memory[_STAGE] == _UNSEEN:
        memory[_GROUND], memory[_STAGE] = measured[2], _LOW
    if measured[2] < memory[_GROUND] - _RISEN_M:
        memory[_STAGE] = _AIRBORNE
    if memory[_STAGE] != _AIRBORNE or load_factor < _LEAST_LOAD_FACTOR:
        return
    sample = sent_mps2 * r[2][2] / STANDARD_GRAVITY_MPS2 / load_factor
    before = memory[_HOVER]
    memory[_HOVER] += share * (min(max(sample, _HOVER_RANGE[0]), _HOVER_RANGE[1]) - before)
    asked = memory[_ACC_DOWN] - STANDARD_GRAVITY_MPS2
    memory[_INTEGRAL + 2] += asked * before / memory[_HOVER] - asked
