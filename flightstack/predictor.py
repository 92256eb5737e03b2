"""The latest sample of every stream, and the state predicted from them to now.

Streams come at 100-250 Hz with their own sample times; the tick wants one state at one time.  The attitude is turned
by the body rates over its age; position and velocity are carried over theirs by the specific force, turned into the
world, plus gravity.  Prediction goes over short ages only (50 ms at most): what is older is left where it is, and its
age in the Measurement tells the guard.
"""

from __future__ import annotations

import math
from struct import Struct

import numpy as np

from flightstack.estimate_observer import EstimateObserver
from flightstack.frames import quat_from_rotation_vector, quat_multiply, rotate
from flightstack.imu_bias import ImuBias
from flightstack.jit import njit
from flightstack.rows import Q_W, Q_X, Q_Y, Q_Z
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Measurement, Tuple3, Tuple4

_AGE_MAX_S = 0.05
_NEVER = -1
_FOUR, _SIX, _SEVEN = (Struct(f"={count}d").pack_into for count in (4, 6, 7))


class Streams:
    """Latest samples, each with the vehicle's own time in microseconds; the one mutable thing between link and tick.

    A sample older than the one held (reordered on the way) is not taken.
    """

    __slots__ = ("_bytes", "_samples", "attitude_us", "imu_bias", "imu_us", "motors_us", "observer", "position_us")

    def __init__(self) -> None:
        self._samples = np.zeros(23)  # q 4, rates 3, position 3, velocity 3, gyro 3, specific force 3, motors 4
        self._samples[19:23] = math.nan
        self._bytes = self._samples.data.cast("B")  # packing into it takes a third of a numpy assignment
        self.attitude_us = self.position_us = self.imu_us = self.motors_us = _NEVER
        self.observer = EstimateObserver()
        """Fed with every position; who hears of a reset tells it."""
        self.imu_bias = ImuBias()

    def attitude(self, t_us: int, q_ned_frd: Tuple4, rate_frd_radps: Tuple3) -> None:
        """ATTITUDE_QUATERNION: attitude and body rates."""
        if t_us > self.attitude_us:
            self.attitude_us = t_us
            _SEVEN(self._bytes, 0, *q_ned_frd, *rate_frd_radps)

    def position(self, t_us: int, pos_ned_m: Tuple3, vel_ned_mps: Tuple3) -> None:
        """LOCAL_POSITION_NED: position and velocity."""
        if t_us > self.position_us:
            self.position_us = t_us
            _SIX(self._bytes, 7 * 8, *pos_ned_m, *vel_ned_mps)
            self.observer.position(t_us, pos_ned_m, vel_ned_mps)

    def imu(self, t_us: int, accel_frd_mps2: Tuple3, rate_frd_radps: Tuple3) -> None:
        """HIGHRES_IMU: specific force and body rates."""
        if t_us > self.imu_us:
            self.imu_us = t_us
            _SIX(self._bytes, 13 * 8, *rate_frd_radps, *accel_frd_mps2)
            self.imu_bias.reported(accel_frd_mps2)

    def raw_imu(self, t_us: int, accel_frd_mps2: Tuple3) -> None:
        """SCALED_IMU: specific force without the correction of the accelerometer's bias."""
        self.imu_bias.raw(t_us, accel_frd_mps2)

    def motors(self, t_us: int, command: Tuple4) -> None:
        """SERVO_OUTPUT_RAW: normalised motor commands 0..1."""
        if t_us > self.motors_us:
            self.motors_us = t_us
            _FOUR(self._bytes, 19 * 8, *command)

    @property
    def complete(self) -> bool:
        """Whether attitude, position and IMU have each been heard."""
        return self.attitude_us >= 0 and self.position_us >= 0 and self.imu_us >= 0


def sampled(streams: Streams, now_us: int, *, corrected: bool = True) -> Measurement | None:
    """As `predict`, but to the newest sample only: what came after it the commands that were sent say (`under_way`)."""
    newest_us = max(streams.position_us, streams.attitude_us, streams.imu_us)
    return predict(streams, min(now_us, newest_us), corrected=corrected)


def predict(streams: Streams, now_us: int, *, corrected: bool = True) -> Measurement | None:
    """The state at `now_us`, or None until every stream (but the motors') has been heard; ages are in the result.

    `corrected` False: the velocity as it is reported, for whoever weighs it against the rest of the state.
    Nothing here judges freshness: `flightstack.guard.stale` does, by the ages.
    """
    if not streams.complete:
        return None
    position_age, attitude_age = now_us - streams.position_us, now_us - streams.attitude_us
    out = np.empty(20)
    _predict(
        streams._samples, position_age * 1e-6, attitude_age * 1e-6, streams.imu_us > streams.attitude_us, out
    )  # the gyro counts where it is newer than the attitude's own rates
    if corrected:
        streams.observer.correct(out[3:6])
        out[13:16] += streams.observer.distrust * streams.imu_bias.bias_frd_mps2
    return Measurement(now_us, out, position_age, attitude_age, now_us - streams.imu_us)


@njit
def _predict(samples: F64, position_age: float, attitude_age: float, gyro_newer: bool, out: F64) -> None:
    """`samples` (23,) as in Streams; `out` (20,): a Measurement's row."""
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
