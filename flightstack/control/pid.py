"""PD and PID on position, with the reference's whole feed-forward: what a user takes before anything learns.

    a_d = a_ref + Kp (r_ref - r) + Kd (v_ref - v) + Ki int(r_ref - r)
    j_d = j_ref + Kp (v_ref - v) + Kd (a_ref - a) + Ki (r_ref - r)

in NED, with other gains down than sideways; a is the measured specific force plus gravity behind a low-pass of 10 Hz.
The jerk leads the attitude, so that the inner loop's lag does not eat the damping.  Without integral (Ki = 0) this is
the paper's feed-forward with PD feedback: a constant unexplained acceleration d leaves the error d / Kp.

Anti-windup: the integral stands still while correction, thrust or tilt are at their limits, unless the error brings it
back, and never exceeds the correction's own limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flightstack.control.attitude import PROPOSAL, AttitudeGains, follow, reachable, together, vehicle_rows
from flightstack.frames import Rows3, rotation
from flightstack.jit import njit
from flightstack.model import Limits, Model
from flightstack.rows import L_GAIN
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Command, FlatOutput, Learned, Measurement, Proposal

CORRECTION_MAX_MPS2 = (5.0, 5.0, 6.0)
"""How far feedback may move the acceleration, as for the nominal of the flatness controller."""
DT_MAX_S = 0.05
"""A longer gap between two ticks counts as this long."""
MEMORY = 6
"""Numbers that the law remembers: integral (3) m/s^2 and filtered acceleration (3) m/s^2, NED."""
_FILTER_RADPS = 2.0 * math.pi * 10.0


_P, _D, _I, _MOST = range(4)
"""Of `pid_constants`."""


@dataclass(frozen=True, slots=True)
class PidGains:
    """The law's gains, horizontal and down, as a bandwidth w: Kp = w^2, Kd = 2 damping w, Ki = integral w^3."""

    bandwidth_xy_radps: float = 2.8
    damping_xy: float = 0.9
    integral_xy: float = 0.25
    """0 makes the law PD; a third is what three equal poles would have."""
    bandwidth_z_radps: float = 3.5
    damping_z: float = 0.9
    integral_z: float = 0.25


class Remembered(NamedTuple):
    """What a controller remembers: its numbers and the time of its last step."""

    row: F64
    t_us: int

    @property
    def healthy(self) -> bool:
        """Whether every number is finite."""
        return bool(np.isfinite(self.row).all())

    def seconds_until(self, now_us: int) -> float:
        """Time since the last step, within 0 and DT_MAX_S."""
        return min(max((now_us - self.t_us) * 1e-6, 0.0), DT_MAX_S)


class PidController:
    """The law above for one model; final, holds only constants."""

    __slots__ = ("_constants",)

    def __init__(self, model: Model, limits: Limits, attitude: AttitudeGains, gains: PidGains) -> None:
        self._constants = pid_constants(model, limits, attitude, gains)

    def init(self, now_us: int) -> Remembered:
        """Nothing integrated yet."""
        return Remembered(np.zeros(MEMORY), now_us)

    def healthy(self, state: Remembered) -> bool:
        """Whether integral and filter are finite."""
        return state.healthy

    def step(
        self, state: Remembered, measurement: Measurement, reference: FlatOutput, learned: Learned, sent: Command,
        now_us: int,
    ) -> tuple[Remembered, Proposal]:  # fmt: skip
        """One step; what is learned is fed forward, as by the flatness controller."""
        row, memory = np.empty(PROPOSAL), state.row.copy()
        dt = state.seconds_until(now_us)
        thrust = pid_step(self._constants, memory, dt, reference.row, measurement.row, learned.row, row)
        return Remembered(memory, now_us), Proposal(thrust, row)


def pid_constants(model: Model, limits: Limits, attitude: AttitudeGains, gains: PidGains) -> F64:
    """(9, 3) everything that does not change in flight."""
    w, wz = gains.bandwidth_xy_radps, gains.bandwidth_z_radps
    return np.array(
        [
            (w * w, w * w, wz * wz),
            (2.0 * gains.damping_xy * w, 2.0 * gains.damping_xy * w, 2.0 * gains.damping_z * wz),
            (gains.integral_xy * w**3, gains.integral_xy * w**3, gains.integral_z * wz**3),
            CORRECTION_MAX_MPS2,
            *vehicle_rows(model, limits, attitude),
        ]
    )


@njit
def filter_acceleration(r: Rows3, specific_force: F64, keep: float, filtered: F64) -> None:
    """Low-pass of the acceleration that the specific force tells; `filtered` (3,) NED in place, `keep` of the old."""
    for i in range(3):
        acc = r[i][0] * specific_force[0] + r[i][1] * specific_force[1] + r[i][2] * specific_force[2]
        if i == 2:
            acc += STANDARD_GRAVITY_MPS2
        filtered[i] = acc + keep * (filtered[i] - acc)


@njit
def pid_step(constants: F64, memory: F64, dt: float, reference: F64, measured: F64, learned: F64, out: F64) -> float:
    """One step, `memory` (6,) in place: total thrust, its parts in `out`; rows as in `follow`, `measured` (20,)."""
    q, rate, integral, filtered = measured[6:10], measured[10:13], memory[0:3], memory[3:6]
    acc, jerk, vehicle = out[11:14], out[14:17], constants[4:9]
    r = rotation(q)
    filter_acceleration(r, measured[13:16], math.exp(-dt * _FILTER_RADPS), filtered)
    wanted = np.empty(3)
    for i in range(3):
        p, d, limit = constants[_P, i], constants[_D, i], constants[_MOST, i]
        error, drift = reference[i] - measured[i], reference[3 + i] - measured[3 + i]
        correction = p * error + d * drift + integral[i]
        wanted[i] = reference[6 + i] + correction
        lead = p * drift + d * (reference[6 + i] - filtered[i]) + constants[_I, i] * error
        if abs(correction) >= limit:
            correction, lead = math.copysign(limit, correction), 0.0
        acc[i] = reference[6 + i] + correction
        jerk[i] = reference[9 + i] + lead
    reached = reachable(acc, learned[0:3], reference[3:6], learned[L_GAIN], vehicle)
    for i in range(3):
        error = reference[i] - measured[i]
        if error * (wanted[i] - reached[i]) <= 1e-9:  # more of it would only ask for what is cut off
            more = integral[i] + constants[_I, i] * error * dt
            integral[i] = min(max(more, -constants[_MOST, i]), constants[_MOST, i])
    out[1] = 0.0
    follow(vehicle, reached, jerk, reference, learned, learned[L_GAIN], (r, rate), out)
    return together(out)
