"""Sensors: IMU at 1 kHz, raw position fixes, barometer, magnetometer, and the state estimate made of them.

The IMU's noise is white with the grade's density n: a sample's standard deviation is n sqrt(rate / 2).  Turn-on biases
are constant in a flight and drawn from the seed; the autopilot's estimator takes all but a stated share of them out, so
the samples here carry that share.  The effects `accelerometer_bias` and `gyro_bias` come on top, whole: measured =
true + bias (a change in flight shows from the next 4 ms).

Every purpose has its own random generator, spawned from the seed: one sensor's use never changes another's noise.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from flightstack.jit import njit
from flightstack.types import F64, Tuple3
from sim.estimator import Estimate, EstimatorModel
from sim.grade import Grade
from sim.plant import Plant

ESTIMATE_EVERY_MS = 4
_BLOCK = 1024
_FIX_BLOCK = 64
FIELD_NED_GAUSS = (0.2147, 0.0116, 0.4297)
"""Earth's magnetic field at Zurich (World Magnetic Model)."""
HOME_ALTITUDE_M = 489.4
"""Height of the local origin above sea level."""


@dataclass(frozen=True, slots=True)
class Fix:
    """One raw fix of the position sensor, taken at `t_us` (it becomes known a delay later)."""

    t_us: int
    pos_ned_m: Tuple3
    vel_ned_mps: Tuple3
    pos_horizontal_std_m: float
    pos_vertical_std_m: float
    vel_std_mps: float


class Sensors:
    """Sensors of one vehicle.

    Updated in place by `step`: `gyro_frd_radps`, `accel_frd_mps2` (3,) the last IMU sample; `mean_gyro_frd_radps`,
    `mean_accel_frd_mps2` (3,) their mean over the last 4 ms; every 4 ms `state` (13,): the estimate's position,
    velocity, quaternion, acceleration.  `fix` is the last raw fix that has become known, `fix_count` their number.
    """

    def __init__(self, grade: Grade, *, seed: int | np.random.SeedSequence) -> None:
        root = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        bias_rng, self._imu_rng, estimate_rng, self._fix_rng, self._air_rng = (
            np.random.Generator(np.random.PCG64(child)) for child in root.spawn(5)
        )
        self.grade = grade
        self.position_valid = True
        self.attitude_valid = True
        self.position_resets = 0
        self.t_us = 0
        imu = grade.imu
        left = imu.bias_left_by_estimator
        bias_std = np.repeat([imu.gyro_bias_std_radps, imu.accel_bias_std_mps2], 3)
        self._imu_bias = left * bias_std * bias_rng.standard_normal(6)
        density = np.array([*imu.gyro_noise_radps_rthz, *imu.accel_noise_mps2_rthz])
        self._imu_std = density * math.sqrt(0.5 * 1000.0)
        self._imu_noise = np.empty((_BLOCK, 6))
        self._imu_next = _BLOCK
        self._imu = np.zeros(24)
        self._plant_bias = self._imu[18:24]
        self.gyro_frd_radps = self._imu[0:3]
        self.accel_frd_mps2 = self._imu[3:6]
        self.mean_gyro_frd_radps = self._imu[12:15]
        self.mean_accel_frd_mps2 = self._imu[15:18]
        self._samples = 0
        self.estimator = EstimatorModel(grade.estimate, estimate_rng, 0.001 * ESTIMATE_EVERY_MS)
        self.state = self.estimator.state
        self.fix: Fix | None = None
        self.fix_count = 0
        self._pending: deque[tuple[int, Fix]] = deque()
        fix = grade.fix
        self._fix_std = np.array([*fix.pos_std_m, *fix.vel_std_mps])
        self._fix_accuracy = (math.hypot(*fix.pos_std_m[:2]), fix.pos_std_m[2], math.hypot(*fix.vel_std_mps))
        self._fix_noise: list[list[float]] = []
        self._fix_period_us = round(1e6 / grade.fix.rate_hz)
        self._fix_delay_us = round(1e6 * grade.fix.delay_s)
        self._next_fix_us = 0
        self._pos_ned_m, self._q_ned_frd = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])

    def step(self, plant: Plant) -> None:
        """Sample the plant's present state; call once a millisecond."""
        if self._imu_next == _BLOCK:
            self._imu_rng.standard_normal(out=self._imu_noise)
            self._imu_noise *= self._imu_std
            self._imu_noise += self._imu_bias
            self._imu_next = 0
        self._samples += 1
        last = self._samples % ESTIMATE_EVERY_MS == 0
        _imu_sample(
            plant.rate_frd_radps, plant.specific_force_frd_mps2, self._imu_noise, self._imu_next, last, self._imu
        )
        self._imu_next += 1
        if last:
            self._sample_slow(plant)

    def _sample_slow(self, plant: Plant) -> None:
        """The 4 ms part: biases that may change in flight, state estimate, raw fixes."""
        self.t_us = plant.t_us
        self._pos_ned_m, self._q_ned_frd = plant.pos_ned_m, plant.q_ned_frd
        self._plant_bias[:3] = plant.gyro_bias_frd_radps
        self._plant_bias[3:] = plant.accel_bias_frd_mps2
        self.estimator.step(
            plant.pos_ned_m, plant.vel_ned_mps, plant.q_ned_frd, plant.misalignment_q, self.mean_accel_frd_mps2
        )
        if self.t_us >= self._next_fix_us:
            self._next_fix_us += self._fix_period_us
            self._pending.append((self.t_us + self._fix_delay_us, self._take_fix(plant)))
        while self._pending and self._pending[0][0] <= self.t_us:
            self.fix = self._pending.popleft()[1]
            self.fix_count += 1

    def _take_fix(self, plant: Plant) -> Fix:
        if not self._fix_noise:
            self._fix_noise = (self._fix_std * self._fix_rng.standard_normal((_FIX_BLOCK, 6))).tolist()
        en, ee, ed, evn, eve, evd = self._fix_noise.pop()
        n, e, d = plant.pos_ned_m.tolist()
        vn, ve, vd = plant.vel_ned_mps.tolist()
        return Fix(plant.t_us, (n + en, e + ee, d + ed), (vn + evn, ve + eve, vd + evd), *self._fix_accuracy)

    def estimate(self, rate_frd_radps: F64) -> Estimate:
        """Frozen copy of the last estimate; `rate_frd_radps` is the rate loop's filtered gyro."""
        n, e, d, vn, ve, vd, w, x, y, z, an, ae, ad = self.state.tolist()
        p, q, r = rate_frd_radps.tolist()
        return Estimate(
            self.t_us,
            (n, e, d),
            (vn, ve, vd),
            (w, x, y, z),
            (p, q, r),
            (an, ae, ad),
            self.estimator.accuracy,
            self.position_valid,
            self.attitude_valid,
            self.position_resets,
        )

    def pressure_hpa(self) -> float:
        """Barometer now: standard atmosphere at the true height, with noise."""
        altitude_m = HOME_ALTITUDE_M - float(self._pos_ned_m[2])
        noise_pa = self.grade.air.baro_std_pa * float(self._air_rng.standard_normal())
        return 1013.25 * math.pow(1.0 - 2.25577e-5 * altitude_m, 5.25588) + 0.01 * noise_pa

    def mag_frd_gauss(self) -> Tuple3:
        """Magnetometer now: Earth's field turned into the body, with noise."""
        x, y, z = _to_body(self._q_ned_frd.tolist(), FIELD_NED_GAUSS)
        n = self._air_rng.standard_normal(3).tolist()
        std = self.grade.air.mag_std_gauss
        return x + std[0] * n[0], y + std[1] * n[1], z + std[2] * n[2]


def _to_body(q: list[float], v: Tuple3) -> Tuple3:
    """R(q)^T v in plain floats, which are faster than arrays for one vector."""
    w, x, y, z = q[0], -q[1], -q[2], -q[3]
    tx, ty, tz = 2.0 * (y * v[2] - z * v[1]), 2.0 * (z * v[0] - x * v[2]), 2.0 * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )


@njit
def _imu_sample(rate: F64, force: F64, noise: F64, row: int, last: bool, out: F64) -> None:
    """out: gyro, accel, their sums, their means, their effects' biases; `last` closes a mean."""
    for i in range(3):
        out[i] = rate[i] + out[18 + i] + noise[row, i]
        out[3 + i] = force[i] + out[21 + i] + noise[row, 3 + i]
    for i in range(6):
        out[6 + i] += out[i]
        if last:
            out[12 + i] = out[6 + i] / ESTIMATE_EVERY_MS
            out[6 + i] = 0.0
