"""Do the streams of an estimate contradict one another?  What no single stream can tell of itself.

Each watch is fed with the samples of its streams, each with the vehicle's own stamp, and says in one word what is
wrong.  A sensor or an estimate that has stopped repeats its values with stamps that go on; one that drifts away is told
by another stream that measures the same motion:

    velocity against the IMU          d/dt v = R f + g
    position against velocity         d/dt p = v
    the tilt against the gyro         d/dt (R^T e_z) = -w x (R^T e_z)

The difference of both sides is summed up and forgotten with a time constant (a high-pass), so that biases stay below
the thresholds, which stand well above what PX4's estimator shows against itself in a recorded flight (the tests replay
it): 0.7 m/s, 0.5 m and 0.03 rad at most, steps of 0.02 m.

All numbers of a watch lie in one row, stamps included, and the arithmetic is compiled: it runs with every sample.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import Entry, njit
from flightstack.rows import Q_W, Q_X, Q_Y, Q_Z, VEL_D, VEL_E, VEL_N
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Tuple3, Tuple4

FROZEN_US = 100_000
"""Identical samples for so long: twelve of the position at 125 Hz."""
JUMP_M = 0.25
"""A step of position that the velocities on both of its sides don't explain."""
VELOCITY_ERROR_MPS = 2.0
POSITION_ERROR_M = 1.5
TILT_ERROR_RAD = 0.35
_VELOCITY_FORGET_S = 0.5
_POSITION_FORGET_S = 1.0
_TILT_FORGET_S = 0.5
_STEP_MAX_S = 0.1
"""A gap in a stream longer than this begins the sums anew: staleness is somebody else's business."""
_JERK_MPS3 = 60.0
"""Over a gap the velocities at its ends explain a step up to jerk times gap^3 / 12 (the trapezoid's error); PX4's
default of 220 deg/s at 1 g makes 38."""
_JUDGED_MAX_S = 0.5
"""Over a longer gap a step of position says nothing."""

_GYRO, _TURNS = 3, 4
"""Body rates in a sample of the IMU, of the attitude."""

# The row: samples as they came last, what is worked out from them, then stamps (us; -1 before the first).
_POS, _VEL, _FORCE, _RATE, _ATTITUDE_RATE, _Q = 0, 3, 6, 9, 12, 15
_DOWN = 19
"""World's down in body axes as the gyro carries it on."""
_VELOCITY_ERROR, _POSITION_ERROR, _TILT_ERROR = 22, 25, 28
_POSITION_US, _IMU_US, _ATTITUDE_US = 29, 30, 31
_POSITION_CHANGED_US, _VELOCITY_CHANGED_US, _IMU_CHANGED_US, _ATTITUDE_CHANGED_US = 32, 33, 34, 35
"""When a stream had another value than before; what it repeats it has held since."""
_STEP = 36
"""What the newest position moved beyond what velocity explains."""
_ROW = 39

_TROUBLES = (
    "", "frozen-attitude", "frozen-imu", "frozen-position", "attitude-against-gyro", "velocity-against-imu",
    "position-against-velocity",
)  # fmt: skip


class EstimateWatch:
    """Watches position, velocity, attitude and IMU of one vehicle; `trouble` names the first contradiction.

    Steps of position are not judged here: `step_ned_m` holds the newest one, and who knows the estimator's counter of
    resets decides what it was.  `row` is for compiled code that feeds it (`watch_imu` and the other two).
    """

    __slots__ = ("row",)

    def __init__(self) -> None:
        self.row = np.zeros(_ROW)
        self.row[_Q] = self.row[_DOWN + 2] = 1.0
        self.row[_POSITION_US:_STEP] = -1.0

    def forgive(self) -> None:
        """Begin all sums anew, as after a reset of the estimator that is accounted for."""
        _forgive(self.row)

    def imu(self, t_us: int, force_frd_mps2: Tuple3, rate_frd_radps: Tuple3) -> None:
        """HIGHRES_IMU: specific force and body rates."""
        watch_imu(self.row, float(t_us), np.array([*force_frd_mps2, *rate_frd_radps]))

    def attitude(self, t_us: int, q_ned_frd: Tuple4, rate_frd_radps: Tuple3) -> None:
        """ATTITUDE_QUATERNION."""
        watch_attitude(self.row, float(t_us), np.array([*q_ned_frd, *rate_frd_radps]))

    def position(self, t_us: int, pos_ned_m: Tuple3, vel_ned_mps: Tuple3) -> None:
        """LOCAL_POSITION_NED."""
        watch_position(self.row, float(t_us), np.array([*pos_ned_m, *vel_ned_mps]))

    @property
    def step_ned_m(self) -> Tuple3:
        """What the newest position sample moved beyond what velocity explains, m."""
        north, east, down = self.row[_STEP : _STEP + 3].tolist()
        return north, east, down

    @property
    def velocity_error_mps(self) -> float:
        """Velocity's lead over the IMU's of the last half second or so."""
        return math.hypot(*self.row[_VELOCITY_ERROR : _VELOCITY_ERROR + 3].tolist())

    @property
    def position_error_m(self) -> float:
        """Position's lead over velocity's of the last second or so."""
        return math.hypot(*self.row[_POSITION_ERROR : _POSITION_ERROR + 3].tolist())

    @property
    def tilt_error_rad(self) -> float:
        """Between the tilt reported and the one that the gyro carried on."""
        return self.row.item(_TILT_ERROR)

    @property
    def trouble(self) -> str:
        """Name of the first contradiction (a row of the fault table), empty where there is none."""
        return _TROUBLES[_JUDGE.call(self.row)]


@njit
def _trouble(row: F64) -> int:
    """Place in `_TROUBLES` of what is wrong."""
    if row[_ATTITUDE_US] - row[_ATTITUDE_CHANGED_US] >= FROZEN_US:
        return 1
    if row[_IMU_US] - row[_IMU_CHANGED_US] >= FROZEN_US:
        return 2
    changed_us = min(row[_POSITION_CHANGED_US], row[_VELOCITY_CHANGED_US])
    if row[_POSITION_US] - changed_us >= FROZEN_US:
        return 3
    if row[_TILT_ERROR] > TILT_ERROR_RAD:
        return 4
    if _length(row, _VELOCITY_ERROR) > VELOCITY_ERROR_MPS:
        return 5
    return 6 if _length(row, _POSITION_ERROR) > POSITION_ERROR_M else 0


@njit
def _forgive(row: F64) -> None:
    row[_VELOCITY_ERROR : _TILT_ERROR + 1] = 0.0
    row[_DOWN], row[_DOWN + 1], row[_DOWN + 2] = _down(row[_Q], row[_Q + 1], row[_Q + 2], row[_Q + 3])


@njit
def _put(row: F64, place: int, x: float, y: float, z: float) -> bool:
    """Three numbers into the row; whether they are other ones than before."""
    other = x != row[place] or y != row[place + 1] or z != row[place + 2]
    row[place], row[place + 1], row[place + 2] = x, y, z
    return bool(other)


@njit
def watch_imu(row: F64, t_us: float, sample: F64) -> None:
    """Specific force and body rates (6,); `row` is an EstimateWatch's."""
    dt = (t_us - row[_IMU_US]) * 1e-6
    if dt <= 0.0:
        return
    row[_IMU_US] = t_us
    fx, fy, fz, p, q, r = sample[0], sample[1], sample[2], sample[_GYRO], sample[_GYRO + 1], sample[_GYRO + 2]
    p0, q0, r0 = row[_RATE], row[_RATE + 1], row[_RATE + 2]
    pushed, turned = _put(row, _FORCE, fx, fy, fz), _put(row, _RATE, p, q, r)
    if pushed or turned or row[_IMU_CHANGED_US] < 0.0:
        row[_IMU_CHANGED_US] = t_us
    if dt > _STEP_MAX_S:
        _forgive(row)
        return
    w, x, y, z = row[_Q], row[_Q + 1], row[_Q + 2], row[_Q + 3]  # R f = f + 2 w (u x f) + 2 u x (u x f)
    tx, ty, tz = 2.0 * (y * fz - z * fy), 2.0 * (z * fx - x * fz), 2.0 * (x * fy - y * fx)
    north, east, down = fx + w * tx + y * tz - z * ty, fy + w * ty + z * tx - x * tz, fz + w * tz + x * ty - y * tx
    down += STANDARD_GRAVITY_MPS2
    fade = math.exp(-dt / _VELOCITY_FORGET_S)
    for i, acc in enumerate((north, east, down)):
        row[_VELOCITY_ERROR + i] = (row[_VELOCITY_ERROR + i] - dt * acc) * fade
    half = 0.5 * dt
    _turn(row, half * (p0 + p), half * (q0 + q), half * (r0 + r))


@njit
def watch_attitude(row: F64, t_us: float, sample: F64) -> None:
    """Attitude and body rates (7,); `row` is an EstimateWatch's."""
    dt = (t_us - row[_ATTITUDE_US]) * 1e-6
    if dt <= 0.0:
        return
    row[_ATTITUDE_US] = t_us
    w, x, y, z = sample[Q_W], sample[Q_X], sample[Q_Y], sample[Q_Z]
    p, q, r = sample[_TURNS], sample[_TURNS + 1], sample[_TURNS + 2]
    turned, lain = _put(row, _ATTITUDE_RATE, p, q, r), _put(row, _Q + 1, x, y, z)
    if turned or lain or w != row[_Q] or row[_ATTITUDE_CHANGED_US] < 0.0:
        row[_ATTITUDE_CHANGED_US] = t_us
    row[_Q] = w
    mx, my, mz = _down(w, x, y, z)
    if dt > _STEP_MAX_S:
        row[_DOWN], row[_DOWN + 1], row[_DOWN + 2] = mx, my, mz
    x, y, z = row[_DOWN], row[_DOWN + 1], row[_DOWN + 2]
    row[_TILT_ERROR] = math.acos(min(max(mx * x + my * y + mz * z, -1.0), 1.0))
    pull = 1.0 - math.exp(-min(dt, _STEP_MAX_S) / _TILT_FORGET_S)
    _put_unit(row, x + pull * (mx - x), y + pull * (my - y), z + pull * (mz - z))


@njit
def watch_position(row: F64, t_us: float, sample: F64) -> float:
    """Position and velocity (6,); `row` is an EstimateWatch's.  The largest part of its unexplained step."""
    step = _moved(row, t_us, sample)
    row[_STEP], row[_STEP + 1], row[_STEP + 2] = step
    return max(abs(step[0]), abs(step[1]), abs(step[2]))


@njit
def _moved(row: F64, t_us: float, sample: F64) -> Tuple3:
    """What the sample moved beyond what velocity explains."""
    dt = (t_us - row[_POSITION_US]) * 1e-6
    if dt <= 0.0:
        return 0.0, 0.0, 0.0
    first = row[_POSITION_US] < 0.0
    row[_POSITION_US] = t_us
    n, e, d, vn, ve, vd = sample[0], sample[1], sample[2], sample[VEL_N], sample[VEL_E], sample[VEL_D]
    n0, e0, d0 = row[_POS], row[_POS + 1], row[_POS + 2]
    vn0, ve0, vd0 = row[_VEL], row[_VEL + 1], row[_VEL + 2]
    if _put(row, _POS, n, e, d) or row[_POSITION_CHANGED_US] < 0.0:
        row[_POSITION_CHANGED_US] = t_us
    if _put(row, _VEL, vn, ve, vd) or row[_VELOCITY_CHANGED_US] < 0.0:
        row[_VELOCITY_CHANGED_US] = t_us
    if first or dt > _JUDGED_MAX_S:
        return 0.0, 0.0, 0.0
    half = 0.5 * dt
    step = n - n0 - half * (vn0 + vn), e - e0 - half * (ve0 + ve), d - d0 - half * (vd0 + vd)
    if dt > _STEP_MAX_S:
        if max(abs(step[0]), abs(step[1]), abs(step[2])) < JUMP_M + _JERK_MPS3 * dt**3 / 12.0:
            return 0.0, 0.0, 0.0
    else:
        fade = math.exp(-dt / _POSITION_FORGET_S)
        for i, change in enumerate(((vn, vn0), (ve, ve0), (vd, vd0))):
            row[_VELOCITY_ERROR + i] = row[_VELOCITY_ERROR + i] + change[0] - change[1]
            row[_POSITION_ERROR + i] = (row[_POSITION_ERROR + i] + step[i]) * fade
    return step


@njit
def _length(row: F64, place: int) -> float:
    return math.sqrt(row[place] * row[place] + row[place + 1] * row[place + 1] + row[place + 2] * row[place + 2])


@njit
def _down(w: float, x: float, y: float, z: float) -> Tuple3:
    """World's down in body axes: the rotation matrix's third row."""
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z


@njit
def _turn(row: F64, p: float, q: float, r: float) -> None:
    """The world's down, seen from a body that has turned by the small rotation vector (p, q, r)."""
    x, y, z = row[_DOWN], row[_DOWN + 1], row[_DOWN + 2]
    a, b, c = y * r - z * q, z * p - x * r, x * q - y * p
    _put_unit(
        row, x + a + 0.5 * (b * r - c * q), y + b + 0.5 * (c * p - a * r), z + c + 0.5 * (a * q - b * p)
    )  # fmt: skip


@njit
def _put_unit(row: F64, x: float, y: float, z: float) -> None:
    """The world's down into the row, of length 1."""
    size = math.sqrt(x * x + y * y + z * z)
    size = size if size > 0.0 else 1.0
    row[_DOWN], row[_DOWN + 1], row[_DOWN + 2] = x / size, y / size, z / size


_JUDGE = Entry(_trouble, "f8[::1]")
