"""The latest sample of every stream, and the state predicted from them to now.

Streams come at 100-250 Hz with their own sample times; the tick wants one state at one time.  The attitude is turned
by the body rates over its age; position and velocity are carried over theirs by the specific force, turned into the
world, plus gravity.  Prediction goes over short ages only (50 ms at most): what is older is left where it is, and its
age in the Measurement tells the guard.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.estimate_observer import EstimateObserver, correct, distrusted, observe
from flightstack.frames import quat_from_rotation_vector, quat_multiply, rotate
from flightstack.imu_bias import ImuBias, add_bias, keep_reported
from flightstack.jit import Entry, njit
from flightstack.rows import Q_W, Q_X, Q_Y, Q_Z
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Measurement, Tuple3, Tuple4

_AGE_MAX_S = 0.05
_NEVER = -1.0
_LATEST_US = 4e18
_NO_TIME = -(2**63)

# The row: the newest samples (attitude and rates, position and velocity, gyro, specific force, motors), then the
# vehicle's stamps of the four.
_ATTITUDE, _POSITION, _GYRO, _FORCE, _MOTORS = 0, 7, 13, 16, 19
_ATTITUDE_US, _POSITION_US, _IMU_US, _MOTORS_US = 23, 24, 25, 26
_ROW = 27


class Streams:
    """Latest samples, each with the vehicle's own time in microseconds; the one mutable thing between link and tick.

    A sample older than the one held (reordered on the way) is not taken.  `row` is for compiled code that feeds it
    (`take_attitude` and the others).
    """

    __slots__ = ("imu_bias", "observer", "row")

    def __init__(self) -> None:
        self.row = np.zeros(_ROW)
        self.row[_MOTORS : _MOTORS + 4] = math.nan
        self.row[_ATTITUDE_US:] = _NEVER
        self.observer = EstimateObserver()
        """Fed with every position; who hears of a reset tells it."""
        self.imu_bias = ImuBias()

    def attitude(self, t_us: int, q_ned_frd: Tuple4, rate_frd_radps: Tuple3) -> None:
        """ATTITUDE_QUATERNION: attitude and body rates."""
        take_attitude(self.row, float(t_us), np.array([*q_ned_frd, *rate_frd_radps]))

    def position(self, t_us: int, pos_ned_m: Tuple3, vel_ned_mps: Tuple3) -> None:
        """LOCAL_POSITION_NED: position and velocity."""
        take_position(self.row, self.observer.row, float(t_us), np.array([*pos_ned_m, *vel_ned_mps]))

    def imu(self, t_us: int, accel_frd_mps2: Tuple3, rate_frd_radps: Tuple3) -> None:
        """HIGHRES_IMU: specific force and body rates."""
        take_imu(self.row, self.imu_bias.row, float(t_us), np.array([*accel_frd_mps2, *rate_frd_radps]))

    def raw_imu(self, t_us: int, accel_frd_mps2: Tuple3) -> None:
        """SCALED_IMU: specific force without the correction of the accelerometer's bias."""
        self.imu_bias.raw(t_us, accel_frd_mps2)

    def motors(self, t_us: int, command: Tuple4) -> None:
        """SERVO_OUTPUT_RAW: normalised motor commands 0..1."""
        take_motors(self.row, float(t_us), np.array(command))

    @property
    def attitude_us(self) -> int:
        """Stamp of the newest attitude, -1 before the first."""
        return int(self.row.item(_ATTITUDE_US))

    @property
    def position_us(self) -> int:
        """Of the position."""
        return int(self.row.item(_POSITION_US))

    @property
    def imu_us(self) -> int:
        """Of the IMU."""
        return int(self.row.item(_IMU_US))


@njit
def take_attitude(row: F64, t_us: float, sample: F64) -> None:
    """Attitude and body rates (7,) into a Streams' row."""
    if t_us > row[_ATTITUDE_US]:
        row[_ATTITUDE_US] = t_us
        row[_ATTITUDE : _ATTITUDE + 7] = sample


@njit
def take_position(row: F64, observed: F64, t_us: float, sample: F64) -> None:
    """Position and velocity (6,) into the rows of a Streams and its observer."""
    if t_us > row[_POSITION_US]:
        row[_POSITION_US] = t_us
        row[_POSITION : _POSITION + 6] = sample
        observe(observed, 1e-6 * t_us, sample)


@njit
def take_imu(row: F64, bias: F64, t_us: float, sample: F64) -> None:
    """Specific force and body rates (6,) into the rows of a Streams and its accelerometer's bias."""
    if t_us > row[_IMU_US]:
        row[_IMU_US] = t_us
        row[_GYRO : _GYRO + 3] = sample[3:6]
        row[_FORCE : _FORCE + 3] = sample[0:3]
        keep_reported(bias, sample[0:3])


@njit
def take_motors(row: F64, t_us: float, command: F64) -> None:
    """Normalised motor commands (4,) into a Streams' row."""
    if t_us > row[_MOTORS_US]:
        row[_MOTORS_US] = t_us
        row[_MOTORS : _MOTORS + 4] = command


def sampled(streams: Streams, now_us: int, *, corrected: bool = True) -> Measurement | None:
    """As `predict`, but to the newest sample only: what came after it the commands that were sent say (`under_way`)."""
    return predict(streams, now_us, corrected=corrected, newest_only=True)


def predict(streams: Streams, now_us: int, *, corrected: bool = True, newest_only: bool = False) -> Measurement | None:
    """The state at `now_us`, or None until every stream (but the motors') has been heard; ages are in the result.

    `corrected` False: the velocity as it is reported, for whoever weighs it against the rest of the state.
    `newest_only`: the state at the newest sample, where that is older.
    Nothing here judges freshness: `flightstack.guard.stale` does, by the ages.
    """
    out = np.empty(20)
    rows = streams.row, streams.observer.row, streams.imu_bias.row
    at_us, position_age, attitude_age, imu_age = _PREDICT.call(*rows, now_us, corrected, newest_only, out)
    return Measurement(at_us, out, position_age, attitude_age, imu_age) if at_us != _NO_TIME else None


_Ages = tuple[int, int, int, int]


@njit
def _whole(stamp_us: float) -> int:
    """A stamp off the wire, which may be any number of 64 bits, or a time by such stamps."""
    return int(max(min(stamp_us, _LATEST_US), -_LATEST_US))


@njit
def _predict(
    row: F64, observed: F64, bias: F64, now_us: float, corrected: bool, newest_only: bool, out: F64
) -> _Ages:  # fmt: skip
    """Time and ages (no time: not every stream has been heard); `out` (20,): a Measurement's row."""
    position_us, attitude_us, imu_us = _whole(row[_POSITION_US]), _whole(row[_ATTITUDE_US]), _whole(row[_IMU_US])
    if min(position_us, attitude_us, imu_us) < 0:
        return _NO_TIME, 0, 0, 0
    at_us = _whole(now_us)
    if newest_only:
        at_us = min(at_us, max(position_us, attitude_us, imu_us))
    position_age, attitude_age = at_us - position_us, at_us - attitude_us
    # The gyro counts where it is newer than the attitude's own rates.
    _carried_over(row, position_age * 1e-6, attitude_age * 1e-6, imu_us > attitude_us, out)
    if corrected:
        correct(observed, out[3:6])
        add_bias(bias, distrusted(observed), out[13:16])
    return at_us, position_age, attitude_age, at_us - imu_us


@njit
def _carried_over(samples: F64, position_age: float, attitude_age: float, gyro_newer: bool, out: F64) -> None:
    """`samples`: a Streams' row; `out` (20,): a Measurement's row."""
    turn = np.empty(3)
    span = min(max(attitude_age, 0.0), _AGE_MAX_S)
    for i in range(3):
        rate = samples[13 + i] if gyro_newer else samples[4 + i]
        out[10 + i] = rate
        turn[i] = 0.5 * (samples[4 + i] + rate) * span
    q = quat_multiply(samples[0:4], quat_from_rotation_vector(turn))
    size = math.sqrt(q[Q_W] * q[Q_W] + q[Q_X] * q[Q_X] + q[Q_Y] * q[Q_Y] + q[Q_Z] * q[Q_Z])
    for i in range(4):
        out[6 + i] = q[i] / size
        out[16 + i] = samples[19 + i]
    acc = rotate(out[6:10], samples[16:19])
    acc[2] += STANDARD_GRAVITY_MPS2
    span = min(max(position_age, 0.0), _AGE_MAX_S)
    for i in range(3):
        out[i] = samples[7 + i] + span * (samples[10 + i] + 0.5 * span * acc[i])
        out[3 + i] = samples[10 + i] + span * acc[i]
        out[13 + i] = samples[16 + i]


_PREDICT = Entry(_predict, "f8[::1], f8[::1], f8[::1], f8, b1, b1, f8[::1]")
