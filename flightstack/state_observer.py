"""A steadier estimate: the autopilot's position, velocity and attitude, weighed against its accelerometer.

What an autopilot reports of position and velocity errs from sample to sample in a fraction of a second; its
accelerometer says what the vehicle did meanwhile.  A Kalman filter for each axis, its gains constant:

    p' = v                  position                        ep, ev, ea: first-order Gauss-Markov errors of the reported
    v' = a - ea + noise     velocity                        position and velocity, and of the acceleration a = R f + g
    zp = p + ep             position as reported            (specific force turned by the attitude as reported)
    zv = v + ev             velocity as reported

ea is mostly the attitude's error, so the attitude is turned by the small angle that takes its part across the specific
force out.  The gains and the variances that remain are the solution of the Riccati equation at the streams' rate.
A reported state that is farther from the expected one than _GATE standard deviations (a reset that nobody announced, a
fault), or a gap, begins anew with what is reported: nothing is held back from whoever watches the streams.

Source: R. Kalman, "A new approach to linear filtering and prediction problems", 1960; coloured measurement noise by
augmentation: A. Gelb, "Applied optimal estimation", 1974, section 4.5.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from flightstack.error_statistics import ErrorStatistics
from flightstack.frames import quat_from_rotation_vector, quat_multiply, rotate
from flightstack.jit import Entry, njit
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Measurement

SAMPLE_S = 0.008
"""Period of LOCAL_POSITION_NED at PX4's greatest rate."""
_GAP_MAX_US = 50_000
"""Older positions, and longer gaps between ticks, begin anew."""
_GATE = 8.0
_P, _V, _EP, _EV, _EA = range(5)


@lru_cache(maxsize=8)
def steady(statistics: ErrorStatistics, sample_s: float = SAMPLE_S) -> tuple[F64, F64]:
    """Gains (3, 5, 2) and covariances (3, 5, 5) of p, v, ep, ev, ea, each axis, after each sample.

    Of errors that are not independent: no gain, and the errors as they are.
    """
    gains, covariances = np.zeros((3, 5, 2)), np.empty((3, 5, 5))
    if not statistics.independent:
        for i in range(3):
            own = (statistics.pos_std_m[i], statistics.vel_std_mps[i])
            covariances[i] = np.diag(np.square([*own, *own, statistics.acc_std_mps2[i]]))
        return gains, covariances
    for i in range(3):
        gains[i], covariances[i] = _riccati(statistics, i, sample_s)
    return gains, covariances


def _riccati(s: ErrorStatistics, axis: int, dt: float) -> tuple[F64, F64]:
    """One axis' gain (5, 2) and covariance (5, 5)."""
    from scipy.linalg import solve_discrete_are  # 0.15 s, which whatever only names a certificate need not wait for

    fade = [math.exp(-dt / time) for time in (s.pos_time_s, s.vel_time_s, s.acc_time_s)]
    step = np.diag([1.0, 1.0, *fade])
    step[_P, _V], step[_P, _EA], step[_V, _EA] = dt, -0.5 * dt * dt, -dt
    sigma = np.array([s.pos_std_m[axis], s.vel_std_mps[axis], s.acc_std_mps2[axis]])
    noise = np.diag([0.0, 0.0, *(sigma**2 * (1.0 - np.square(fade)))])
    density = s.acc_noise_mps2_rthz[axis] ** 2
    noise[:2, :2] += density * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    seen = np.array([[1.0, 0.0, 1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 1.0, 0.0]])
    least = 1e-6 * np.diag(sigma[:2] ** 2 + 1e-12)
    p = solve_discrete_are(step.T, seen.T, noise, least)
    gain = p @ seen.T @ np.linalg.inv(seen @ p @ seen.T + least)
    kept = np.eye(5) - gain @ seen
    return gain, kept @ p @ kept.T + gain @ least @ gain.T


class StateObserver:
    """The observer of one vehicle; its memory is changed in place."""

    __slots__ = ("_constants", "_gains", "_last_us", "_sample_us", "_state", "restarts")

    def __init__(self, statistics: ErrorStatistics) -> None:
        gains, _ = steady(statistics)
        self._gains = gains
        times = (statistics.pos_time_s, statistics.vel_time_s, statistics.acc_time_s)
        gates = np.array([*statistics.pos_std_m, *statistics.vel_std_mps])
        self._constants = np.array([*times, *(_GATE * gates)])
        self._state = np.zeros((3, 5))
        self._last_us = self._sample_us = -1
        self.restarts = 0
        """How often it began anew after its first sample."""

    def refine(self, measurement: Measurement) -> Measurement:
        """The measurement with position, velocity and attitude as the observer has them; ages are untouched."""
        now_us, sample_us = measurement.t_us, measurement.t_us - measurement.position_age_us
        span_us, new = now_us - self._last_us, sample_us > self._sample_us
        anew = self._last_us < 0 or span_us > _GAP_MAX_US or measurement.position_age_us > _GAP_MAX_US
        row = measurement.row.copy()
        restarted = _REFINE.call(
            self._state, max(1e-6 * span_us, 0.0), anew or span_us < 0, new, self._gains, self._constants, row
        )
        self.restarts += restarted and self._last_us >= 0
        self._last_us, self._sample_us = now_us, sample_us
        return Measurement(
            now_us,
            row,
            measurement.position_age_us,
            measurement.attitude_age_us,
            measurement.imu_age_us,
            measurement.battery_v,
            measurement.late_us,
        )


@njit
def _refine(state: F64, dt: float, anew: bool, new: bool, gains: F64, constants: F64, row: F64) -> bool:
    """One tick: the state (3, 5) moves on, `row` (20,), a Measurement's, becomes what it says; True: it began anew."""
    for i in range(16):
        if not math.isfinite(row[i]):
            return False
    acc = rotate(row[6:10], row[13:16])
    size = acc[0] * acc[0] + acc[1] * acc[1] + acc[2] * acc[2]
    if not anew:
        fades = np.exp(-dt / constants[:3])
        for i in range(3):
            x, gravity = state[i], STANDARD_GRAVITY_MPS2 if i == 2 else 0.0
            a = acc[i] + gravity - x[_EA]
            x[_P] += dt * (x[_V] + 0.5 * dt * a)
            x[_V] += dt * a
            for k in range(3):
                x[_EP + k] *= fades[k]
            off_p, off_v = row[i] - x[_P] - x[_EP], row[3 + i] - x[_V] - x[_EV]
            if abs(off_p) > constants[3 + i] or abs(off_v) > constants[6 + i]:
                anew = True
            elif new:
                for k in range(5):
                    x[k] += gains[i, k, 0] * off_p + gains[i, k, 1] * off_v
    if anew:
        for i in range(3):
            state[i, :] = 0.0
            state[i, _P], state[i, _V] = row[i], row[3 + i]
        return True
    for i in range(3):
        row[i], row[3 + i] = state[i, _P], state[i, _V]
    if size > 1.0:  # phi x (R f) = -ea across it
        e0, e1, e2 = state[0, _EA], state[1, _EA], state[2, _EA]
        turn = np.empty(3)
        turn[0] = -(acc[1] * e2 - acc[2] * e1) / size
        turn[1] = -(acc[2] * e0 - acc[0] * e2) / size
        turn[2] = -(acc[0] * e1 - acc[1] * e0) / size
        turned = quat_multiply(quat_from_rotation_vector(turn), row[6:10])
        norm = math.sqrt(np.sum(turned * turned))
        for i in range(4):
            row[6 + i] = turned[i] / norm
    return False


_REFINE = Entry(_refine, "f8[:, ::1], f8, b1, b1, f8[:, :, ::1], f8[::1], f8[::1]")
