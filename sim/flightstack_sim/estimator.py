"""What the autopilot's state estimator reports: the truth with errors of stated statistics.

Not a filter but a model of one.  Position, velocity and attitude each carry a first-order Gauss-Markov error with
standard deviation sigma and time constant tau, discretised exactly:

    x[k+1] = exp(-dt/tau) x[k] + sigma sqrt(1 - exp(-2 dt/tau)) n,   n ~ N(0, 1)

started in its stationary distribution; position also carries a bias that is constant in a flight.  Attitude is the true
one, followed by the sensor's misalignment, followed by the small rotation whose body components are the tilt errors and
the heading error.  The errors are independent of one another and of the motion; what a real filter gets wrong in
manoeuvres is not modelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flightstack.frames import quat_from_rotation_vector, quat_multiply, rotate
from flightstack.jit import njit
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Tuple3, Tuple4
from flightstack_sim.grade import EstimateGrade

_BLOCK = 512
_DECAY, _DRIVE, _BIAS, _ERROR = 0, 1, 2, 3  # rows of the model


@dataclass(frozen=True, slots=True)
class Accuracy:
    """One sigma errors as the estimator itself would state them, biases included."""

    pos_horizontal_std_m: float
    pos_vertical_std_m: float
    vel_std_mps: float
    tilt_std_rad: float
    heading_std_rad: float


@dataclass(frozen=True, slots=True)
class Estimate:
    """The estimator's output at `t_us`."""

    t_us: int
    pos_ned_m: Tuple3
    vel_ned_mps: Tuple3
    q_ned_frd: Tuple4
    rate_frd_radps: Tuple3
    """Gyro without its estimated bias, through the rate loop's low-pass."""
    acc_ned_mps2: Tuple3
    """Acceleration over ground: mean specific force of the last 4 ms turned by the estimate, plus gravity."""
    accuracy: Accuracy
    position_valid: bool
    attitude_valid: bool
    position_resets: int
    """Counts jumps of position or velocity; a client must not differentiate across one."""


class EstimatorModel:
    """Error processes of one vehicle.

    `state` (13,) is updated in place: position, velocity (NED), quaternion, acceleration over ground (NED).
    """

    __slots__ = ("_next", "_rng", "accuracy", "model", "noise", "state")

    def __init__(self, grade: EstimateGrade, rng: np.random.Generator, dt_s: float = 0.004) -> None:
        self._rng = rng
        tilt, heading = grade.tilt_std_rad, grade.heading_std_rad
        sigma = np.array([*grade.pos_std_m, *grade.vel_std_mps, tilt, tilt, heading])
        tau = np.array(
            [grade.pos_time_constant_s] * 3
            + [grade.vel_time_constant_s] * 3
            + [grade.tilt_time_constant_s] * 2
            + [grade.heading_time_constant_s]
        )
        model = np.zeros((4, 9))
        model[_DECAY] = np.exp(-dt_s / tau)
        model[_DRIVE] = sigma * np.sqrt(-np.expm1(-2.0 * dt_s / tau))
        model[_BIAS, :3] = rng.standard_normal(3) * np.asarray(grade.pos_bias_std_m)
        model[_ERROR] = sigma * rng.standard_normal(9)
        self.model = model
        self.noise = np.empty((_BLOCK, 9))
        self._next = _BLOCK
        self.state = np.zeros(13)
        self.state[6] = 1.0
        self.accuracy = Accuracy(
            math.hypot(*grade.pos_std_m[:2], *grade.pos_bias_std_m[:2]),
            math.hypot(grade.pos_std_m[2], grade.pos_bias_std_m[2]),
            math.hypot(*grade.vel_std_mps),
            tilt,
            heading,
        )

    def step(self, pos_ned_m: F64, vel_ned_mps: F64, q_ned_frd: F64, misalignment_q: F64, accel_frd_mps2: F64) -> None:
        """Next sample of the errors on top of the truth -> `state`; `accel` is the measured specific force."""
        row = self.noise_row()
        estimate(
            pos_ned_m, vel_ned_mps, q_ned_frd, misalignment_q, accel_frd_mps2, self.noise, row, self.model, self.state
        )
        self.used()

    def jump_north(self, distance_m: float) -> None:
        """From now on the position is off by so much more."""
        self.model[_BIAS, 0] += distance_m

    def noise_row(self) -> int:
        """Row of `noise` for the next sample."""
        if self._next == _BLOCK:
            self._rng.standard_normal(out=self.noise)
            self._next = 0
        return self._next

    def used(self) -> None:
        """That row has been used."""
        self._next += 1


@njit
def estimate(pos: F64, vel: F64, q: F64, tilt: F64, accel: F64, noise: F64, row: int, model: F64, out: F64) -> None:
    """One sample of one vehicle: the errors in `model` move on, truth and errors give `out` (13,)."""
    error = model[_ERROR]
    for i in range(9):
        error[i] = model[_DECAY, i] * error[i] + model[_DRIVE, i] * noise[row, i]
    for i in range(3):
        out[i] = pos[i] + model[_BIAS, i] + error[i]
        out[3 + i] = vel[i] + error[3 + i]
    measured = quat_multiply(quat_multiply(q, tilt), quat_from_rotation_vector(error[6:9]))
    norm = math.sqrt(measured[0] ** 2 + measured[1] ** 2 + measured[2] ** 2 + measured[3] ** 2)
    for i in range(4):
        out[6 + i] = measured[i] / norm
    turned = rotate(out[6:10], accel)
    for i in range(3):
        out[10 + i] = turned[i]
    out[12] += STANDARD_GRAVITY_MPS2
