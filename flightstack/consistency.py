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
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from flightstack.types import STANDARD_GRAVITY_MPS2, Tuple3, Tuple4

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
_JUDGED_MAX_S = 0.5
"""Over a longer gap a step of position says nothing."""
_ZERO = (0.0, 0.0, 0.0)


@dataclass(slots=True)
class Repetition:
    """For how long a stream has repeated its value."""

    value: object = None
    changed_us: int = -1
    held_us: int = 0

    def see(self, t_us: int, value: object) -> None:
        """Take a sample."""
        if value != self.value or self.changed_us < 0:
            self.value, self.changed_us = value, t_us
        self.held_us = t_us - self.changed_us


class EstimateWatch:
    """Watches position, velocity, attitude and IMU of one vehicle; `trouble` names the first contradiction.

    Steps of position are not judged here: `step_ned_m` holds the newest one, and who knows the estimator's counter of
    resets decides what it was.
    """

    def __init__(self) -> None:
        self._position, self._velocity = Repetition(), Repetition()
        self._attitude, self._imu = Repetition(), Repetition()
        self._position_us = self._imu_us = self._attitude_us = -1
        self._pos: Tuple3 = _ZERO
        self._vel: Tuple3 = _ZERO
        self._rate: Tuple3 = _ZERO
        self._q: Tuple4 = (1.0, 0.0, 0.0, 0.0)
        self._down: Tuple3 = (0.0, 0.0, 1.0)
        """World's down in body axes as the gyro carries it on."""
        self._velocity_error: Tuple3 = _ZERO
        self._position_error: Tuple3 = _ZERO
        self._tilt_error = 0.0
        self.step_ned_m: Tuple3 = _ZERO
        """What the newest position sample moved beyond what velocity explains, m."""

    def forgive(self) -> None:
        """Begin all sums anew, as after a reset of the estimator that is accounted for."""
        self._velocity_error = self._position_error = _ZERO
        self._tilt_error = 0.0
        self._down = _down(self._q)

    def imu(self, t_us: int, force_frd_mps2: Tuple3, rate_frd_radps: Tuple3) -> None:
        """HIGHRES_IMU: specific force and body rates."""
        dt = (t_us - self._imu_us) * 1e-6
        if dt <= 0.0:
            return
        self._imu_us = t_us
        self._imu.see(t_us, (force_frd_mps2, rate_frd_radps))
        if dt <= _STEP_MAX_S:
            (w, x, y, z), (fx, fy, fz) = self._q, force_frd_mps2  # R f = f + 2 w (u x f) + 2 u x (u x f)
            tx, ty, tz = 2.0 * (y * fz - z * fy), 2.0 * (z * fx - x * fz), 2.0 * (x * fy - y * fx)
            north, east, down = (
                fx + w * tx + y * tz - z * ty,
                fy + w * ty + z * tx - x * tz,
                fz + w * tz + x * ty - y * tx,
            )
            x, y, z = self._velocity_error
            fade = math.exp(-dt / _VELOCITY_FORGET_S)
            down += STANDARD_GRAVITY_MPS2
            self._velocity_error = ((x - dt * north) * fade, (y - dt * east) * fade, (z - dt * down) * fade)
            (p, q, r), (p2, q2, r2), half = self._rate, rate_frd_radps, 0.5 * dt
            self._down = _turned(self._down, (half * (p + p2), half * (q + q2), half * (r + r2)))
        else:
            self.forgive()
        self._rate = rate_frd_radps

    def attitude(self, t_us: int, q_ned_frd: Tuple4, rate_frd_radps: Tuple3) -> None:
        """ATTITUDE_QUATERNION."""
        dt = (t_us - self._attitude_us) * 1e-6
        if dt <= 0.0:
            return
        self._attitude_us, self._q = t_us, q_ned_frd
        self._attitude.see(t_us, (q_ned_frd, rate_frd_radps))
        measured = _down(q_ned_frd)
        if dt > _STEP_MAX_S:
            self._down = measured
        (x, y, z), (mx, my, mz) = self._down, measured
        self._tilt_error = math.acos(min(1.0, max(-1.0, mx * x + my * y + mz * z)))
        pull = 1.0 - math.exp(-min(dt, _STEP_MAX_S) / _TILT_FORGET_S)
        self._down = _unit(x + pull * (mx - x), y + pull * (my - y), z + pull * (mz - z))

    def position(self, t_us: int, pos_ned_m: Tuple3, vel_ned_mps: Tuple3) -> None:
        """LOCAL_POSITION_NED."""
        dt = (t_us - self._position_us) * 1e-6
        self.step_ned_m = _ZERO
        if dt <= 0.0:
            return
        first, self._position_us = self._position_us < 0, t_us
        self._position.see(t_us, pos_ned_m)
        self._velocity.see(t_us, vel_ned_mps)
        pos, vel = self._pos, self._vel
        self._pos, self._vel = pos_ned_m, vel_ned_mps
        if first or dt > _JUDGED_MAX_S:
            return
        (n, e, d), (vn, ve, vd), (wn, we, wd), half = pos, vel, vel_ned_mps, 0.5 * dt
        self.step_ned_m = step = (
            pos_ned_m[0] - n - half * (vn + wn),
            pos_ned_m[1] - e - half * (ve + we),
            pos_ned_m[2] - d - half * (vd + wd),
        )
        if dt > _STEP_MAX_S:
            return
        x, y, z = self._velocity_error
        self._velocity_error = (x + wn - vn, y + we - ve, z + wd - vd)
        fade = math.exp(-dt / _POSITION_FORGET_S)
        x, y, z = self._position_error
        self._position_error = ((x + step[0]) * fade, (y + step[1]) * fade, (z + step[2]) * fade)

    @property
    def velocity_error_mps(self) -> float:
        """Velocity's lead over the IMU's of the last half second or so."""
        return _norm(self._velocity_error)

    @property
    def position_error_m(self) -> float:
        """Position's lead over velocity's of the last second or so."""
        return _norm(self._position_error)

    @property
    def tilt_error_rad(self) -> float:
        """Between the tilt reported and the one that the gyro carried on."""
        return self._tilt_error

    @property
    def trouble(self) -> str:
        """Name of the first contradiction (a row of the fault table), empty where there is none."""
        if self._attitude.held_us >= FROZEN_US:
            return "frozen-attitude"
        if self._imu.held_us >= FROZEN_US:
            return "frozen-imu"
        if self._position.held_us >= FROZEN_US or self._velocity.held_us >= FROZEN_US:
            return "frozen-position"
        if self._tilt_error > TILT_ERROR_RAD:
            return "attitude-against-gyro"
        x, y, z = self._velocity_error
        if math.sqrt(x * x + y * y + z * z) > VELOCITY_ERROR_MPS:
            return "velocity-against-imu"
        x, y, z = self._position_error
        return "position-against-velocity" if math.sqrt(x * x + y * y + z * z) > POSITION_ERROR_M else ""


def _norm(a: Tuple3) -> float:
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def _down(q: Tuple4) -> Tuple3:
    """World's down in body axes: the rotation matrix's third row."""
    w, x, y, z = q
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z


def _turned(d: Tuple3, turn: Tuple3) -> Tuple3:
    """A world vector `d`, seen from a body that turns by the small rotation vector `turn`; of length 1."""
    (x, y, z), (p, q, r) = d, turn
    a, b, c = y * r - z * q, z * p - x * r, x * q - y * p
    x, y, z = x + a + 0.5 * (b * r - c * q), y + b + 0.5 * (c * p - a * r), z + c + 0.5 * (a * q - b * p)
    return _unit(x, y, z)


def _unit(x: float, y: float, z: float) -> Tuple3:
    size = math.sqrt(x * x + y * y + z * z) or 1.0
    return x / size, y / size, z / size
