"""What the autopilot's state estimator reports: the truth with errors of stated statistics.

Not a filter but a model of one.  Position, velocity and attitude each carry a first-order Gauss-Markov error with
standard deviation sigma and time constant tau, discretised exactly:

    x[k+1] = exp(-dt/tau) x[k] + sigma sqrt(1 - exp(-2 dt/tau)) n,   n ~ N(0, 1)

started in its stationary distribution; position also carries a bias that is constant in a flight.  Attitude is the true
one, followed by the sensor's misalignment, followed by the small rotation whose body components are the tilt errors and
the heading error.  The errors are independent of one another and of the motion; what a real filter gets wrong in
manoeuvres is not modelled.

With a grade's table `kalman` velocity and position err together, as a Kalman filter's do (world axes, exact steps):

    o' = -o / tau + white                 slow, from the attitude's error
    s' = (o - s) / T_s                    the velocity error's slow part
    m' = -m / tau + R n                   what the filter integrates of the IMU's noise n
    f' = s + m - f / T                    position sums velocity's error up, fixes pull it back

    e_v = s + m,   e_p = f + own part + bias

so that d(position)/dt - velocity, which a client sees, is -f / T: slow, and nearly all of the velocity's error.  The
file states the standard deviations of e_v and e_p; `joint` gives their correlation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flightstack.frames import quat_from_rotation_vector, quat_multiply, rotate
from flightstack.jit import njit
from flightstack.rows import ATTITUDE, Q_W, Q_X, Q_Y, Q_Z, RATE_Z
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, InputError, Tuple3, Tuple4
from flightstack_sim.grade import EstimateGrade, Grade

_BLOCK = 512
_DECAY, _DRIVE, _BIAS, _ERROR, _KALMAN, _LAGS = 0, 1, 2, 3, 4, 5  # rows of the model
_SLOW, _SUMMED, _FOLLOWS = 0, 3, 6  # places in its row _KALMAN: s, m, f
_HAS_KALMAN, _SMOOTHING, _FOLLOWING, _STEP_S = 0, 1, 2, 3  # places in its row _LAGS


@dataclass(frozen=True, slots=True)
class EstimatorAccuracy:
    """One sigma errors as the estimator itself would state them, biases included."""

    pos_horizontal_std_m: float
    pos_vertical_std_m: float
    vel_std_mps: float
    tilt_std_rad: float
    heading_std_rad: float


@dataclass(frozen=True, slots=True)
class EstimatorOutput:
    """The estimator's output at `t_us`."""

    t_us: int
    pos_ned_m: Tuple3
    vel_ned_mps: Tuple3
    q_ned_frd: Tuple4
    rate_frd_radps: Tuple3
    """Gyro without its estimated bias, through the rate loop's low-pass."""
    acc_ned_mps2: Tuple3
    """Acceleration over ground: mean specific force of the last 4 ms turned by the estimate, plus gravity."""
    accuracy: EstimatorAccuracy
    position_valid: bool
    attitude_valid: bool
    position_resets: int
    """Counts jumps of position or velocity; a client must not differentiate across one."""


@dataclass(frozen=True, slots=True)
class Joint:
    """Stationary statistics of the velocity's and the position's error, each (3,): what a `kalman` grade says."""

    slow_std_mps: F64
    """Of o, which drives the velocity's slow part."""
    summed_std_mps: F64
    """Of m, the IMU's noise integrated."""
    follows_std_m: F64
    """Of f, the position's part that follows velocity."""
    own_pos_std_m: F64
    correlation: F64
    """Of the errors of position and velocity."""
    disagreement_std_mps: F64
    """Of d(position)/dt - velocity, its slow part."""
    vel_smoothing_s: float
    pos_follows_vel_s: float


def joint(grade: Grade) -> Joint:
    """Of a grade with a table `kalman`: moments of the linear equations above, each from d/dt E[..] = 0.

    InputError where the file's velocity error is less than the IMU's noise makes in it, or its position error less than
    follows from that.
    """
    kalman, estimate = grade.kalman, grade.estimate
    assert kalman is not None
    tau, smooth, follow = estimate.vel_time_constant_s, kalman.vel_smoothing_s, kalman.pos_follows_vel_s
    density = np.array(grade.imu.accel_noise_mps2_rthz)
    summed = 0.5 * tau * 0.5 * density**2
    slow = np.array(estimate.vel_std_mps) ** 2 - summed
    if (slow < 0.0).any():
        raise InputError(f"grade {grade.name}: estimate.vel_std_mps is less than the accelerometer's noise makes in it")
    fast = slow * tau * follow / (tau + follow)  # E[o f]
    slow_follows = (fast / smooth + slow) / (1.0 / smooth + 1.0 / follow)
    summed_follows = summed * tau * follow / (tau + follow)
    both = slow_follows + summed_follows
    follows = follow * both
    own = np.array(estimate.pos_std_m) ** 2 - follows
    if (own < -0.02 * follows).any():
        raise InputError(f"grade {grade.name}: estimate.pos_std_m is less than follows from the velocity's error")
    return Joint(
        np.sqrt(slow * (tau + smooth) / tau), np.sqrt(summed), np.sqrt(follows), np.sqrt(np.maximum(own, 0.0)),
        both / (np.array(estimate.vel_std_mps) * np.array(estimate.pos_std_m)), np.sqrt(follows) / follow,
        smooth, follow,
    )  # fmt: skip


class EstimatorModel:
    """Error processes of one vehicle.

    `state` (13,) is updated in place: position, velocity (NED), quaternion, acceleration over ground (NED).
    """

    __slots__ = ("_next", "_rng", "accuracy", "model", "noise", "state")

    def __init__(
        self, grade: EstimateGrade, rng: np.random.Generator, dt_s: float = 0.004, joint: Joint | None = None
    ) -> None:
        self._rng = rng
        tilt, heading = grade.tilt_std_rad, grade.heading_std_rad
        own = (grade.pos_std_m, grade.vel_std_mps) if joint is None else (joint.own_pos_std_m, joint.slow_std_mps)
        sigma = np.array([*own[0], *own[1], tilt, tilt, heading])
        tau = np.array(
            [grade.pos_time_constant_s] * 3
            + [grade.vel_time_constant_s] * 3
            + [grade.tilt_time_constant_s] * 2
            + [grade.heading_time_constant_s]
        )
        model = np.zeros((6, 9))
        model[_DECAY] = np.exp(-dt_s / tau)
        model[_DRIVE] = sigma * np.sqrt(-np.expm1(-2.0 * dt_s / tau))
        model[_BIAS, :3] = rng.standard_normal(3) * np.asarray(grade.pos_bias_std_m)
        model[_ERROR] = sigma * rng.standard_normal(9)
        if joint is not None:
            model[_KALMAN] = rng.standard_normal(9)
            model[_KALMAN] *= [*(0.8 * joint.slow_std_mps), *joint.summed_std_mps, *joint.follows_std_m]
            lags = -np.expm1(-dt_s / np.array([joint.vel_smoothing_s, joint.pos_follows_vel_s]))
            model[_LAGS, :4] = 1.0, *lags, dt_s
        self.model = model
        self.noise = np.empty((_BLOCK, 9))
        self._next = _BLOCK
        self.state = np.zeros(13)
        self.state[ATTITUDE] = 1.0
        self.accuracy = EstimatorAccuracy(
            math.hypot(*grade.pos_std_m[:2], *grade.pos_bias_std_m[:2]),
            math.hypot(grade.pos_std_m[2], grade.pos_bias_std_m[2]),
            math.hypot(*grade.vel_std_mps),
            tilt,
            heading,
        )

    def step(self, pos_ned_m: F64, vel_ned_mps: F64, q_ned_frd: F64, misalignment_q: F64, accel_frd_mps2: F64) -> None:
        """Next sample of the errors on top of the truth -> `state`; `accel` is the measured specific force."""
        row = self.noise_row()
        model = self.noise, row, self.model, self.state
        estimate((pos_ned_m, vel_ned_mps, q_ned_frd, misalignment_q), (accel_frd_mps2, _ZERO), model)
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
def estimate(true: tuple[F64, F64, F64, F64], felt: tuple[F64, F64], estimator: tuple[F64, int, F64, F64]) -> None:
    """One sample of one vehicle: the errors in the model move on, truth and errors give the state (13,).

    true: position, velocity, attitude, misalignment; felt: the accelerometer's mean and what of it is noise, which a
    Kalman filter integrates; estimator: noise, its row, model, state.
    """
    (pos, vel, q, tilt), (accel, accel_noise), (noise, row, model, out) = true, felt, estimator
    error = model[_ERROR]
    for i in range(9):
        error[i] = model[_DECAY, i] * error[i] + model[_DRIVE, i] * noise[row, i]
    for i in range(3):
        out[i] = pos[i] + model[_BIAS, i] + error[i]
        out[3 + i] = vel[i] + error[3 + i]
    if model[_LAGS, _HAS_KALMAN] != 0.0:
        _kalman_errors(vel, rotate(q, accel_noise), model, out)
    measured = quat_multiply(quat_multiply(q, tilt), quat_from_rotation_vector(error[6:9]))
    norm = math.sqrt(measured[Q_W] ** 2 + measured[Q_X] ** 2 + measured[Q_Y] ** 2 + measured[Q_Z] ** 2)
    for i in range(4):
        out[6 + i] = measured[i] / norm
    turned = rotate(out[6:10], accel)
    for i in range(3):
        out[10 + i] = turned[i]
    out[RATE_Z] += STANDARD_GRAVITY_MPS2


@njit
def _kalman_errors(vel: F64, accel_noise_ned: F64, model: F64, out: F64) -> None:
    """Velocity and position errors of the header's equations, one step on, into `out`."""
    state, lags = model[_KALMAN], model[_LAGS]
    for i in range(3):
        slow, summed, follows = state[_SLOW + i], state[_SUMMED + i], state[_FOLLOWS + i]
        slow += lags[_SMOOTHING] * (model[_ERROR, 3 + i] - slow)
        summed = model[_DECAY, 3 + i] * summed + lags[_STEP_S] * accel_noise_ned[i]
        follows += lags[_STEP_S] * (slow + summed) - lags[_FOLLOWING] * follows
        state[_SLOW + i], state[_SUMMED + i], state[_FOLLOWS + i] = slow, summed, follows
        out[i] += follows
        out[3 + i] = vel[i] + slow + summed


_ZERO = np.zeros(3)
