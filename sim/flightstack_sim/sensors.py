"""Sensors: IMU at 1 kHz, raw position fixes, barometer, magnetometer, and the state estimate made of them.

The IMU's noise is white with the grade's density n: a sample's standard deviation is n sqrt(rate / 2).  Turn-on biases
are constant in a flight and drawn from the seed; the autopilot's estimator takes all but a stated share of them out, so
the samples here carry that share.  The effects `accelerometer_bias` and `gyro_bias` come on top, whole: measured =
true + bias.

A grade's table `kalman` makes of the reported means what PX4 reports: the trapezoidal mean of two 4 ms samples (noise
MA(1), lag-1 correlation 0.5), less the filter's estimate of an accelerometer bias that is not there.  What is not
corrected stays in `raw_accel_frd_mps2` (SCALED_IMU).

Every purpose has its own random generator, spawned from the seed: one sensor's use never changes another's noise.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from operator import add

import numpy as np

from flightstack.jit import njit
from flightstack.rows import Q_W, Q_X, Q_Y, Q_Z
from flightstack.types import F64, Tuple3
from flightstack_sim.estimator import EstimatorModel, EstimatorOutput, estimate, joint
from flightstack_sim.grade import Grade, KalmanGrade
from flightstack_sim.plant import Plant

ESTIMATE_EVERY_MS = 4
_BLOCK = 1024
_FIX_BLOCK = 64
_AIR_BLOCK = 256
GYRO, _ACCEL, _SUM, _MEAN_GYRO, _MEAN_ACCEL, _COUNT = 0, 3, 6, 12, 15, 18
"""Places in the IMU's numbers: last sample, sums, means over 4 ms, samples in the sums."""
_LAST_NOISE, _RAW_ACCEL, _BIAS, _COLOURED = 19, 25, 28, 31
"""The noise of the 4 ms before, means before the filter's bias is taken out, that bias, share of the noise before."""
_IMU_SIZE = 32
FIELD_NED_GAUSS = (0.2147, 0.0116, 0.4297)
"""Earth's magnetic field at Zurich (World Magnetic Model)."""
HOME_ALTITUDE_M = 489.4
"""Height of the local origin above sea level."""
STANDARD_DEGC = 11.82
"""The standard atmosphere's temperature there."""


@dataclass(frozen=True, slots=True)
class Fix:
    """One raw fix of the position sensor, taken at `t_us` (it becomes known a delay later)."""

    t_us: int
    pos_ned_m: Tuple3
    vel_ned_mps: Tuple3
    pos_horizontal_std_m: float
    pos_vertical_std_m: float
    vel_std_mps: float


WORKS, OFF, STUCK = 0, 1, 2
"""MAVLink's FAILURE_TYPE: as ever, no samples, the last one again and again."""
_LOST_US = 1_000_000
"""PX4's checks want a barometer's and a magnetometer's sample within a second."""


class Failing:
    """What was made of a sensor by INJECT_FAILURE."""

    __slots__ = ("_since_us", "kind")

    def __init__(self) -> None:
        self.kind, self._since_us = WORKS, 0

    def become(self, kind: int, now_us: int) -> None:
        """Off, stuck, or working again, from now on."""
        if kind != self.kind:
            self.kind, self._since_us = kind, now_us

    def lost(self, now_us: int) -> bool:
        """Whether PX4 misses its samples."""
        return self.kind == OFF and now_us - self._since_us >= _LOST_US


class Sensors:
    """Sensors of one vehicle.

    Updated in place by `step`: `gyro_frd_radps`, `accel_frd_mps2` (3,) the last IMU sample; `mean_gyro_frd_radps`,
    `mean_accel_frd_mps2` (3,) their mean over the last 4 ms as reported, both in `mean_imu` (6,), and
    `raw_accel_frd_mps2` (3,) without the filter's bias; every 4 ms `state` (13,): the estimate's position, velocity,
    quaternion, acceleration.  `fix_count` raw fixes have become known.
    """

    def __init__(self, grade: Grade, *, seed: int | np.random.SeedSequence) -> None:
        root = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        bias_rng, self._imu_rng, estimate_rng, self._fix_rng, self._air_rng, kalman_rng = (
            np.random.Generator(np.random.PCG64(child)) for child in root.spawn(6)
        )
        self.grade = grade
        self.origin_altitude_m = HOME_ALTITUDE_M
        """Of the local frame's origin above the sea: what the barometer feels."""
        self.position_valid = True
        self.attitude_valid = True
        self.barometer, self.magnetometer = Failing(), Failing()
        self.imu_degc, self.air_degc = 15.0, STANDARD_DEGC
        """What the IMU and the barometer tell; the first as a PX4 with SIH does."""
        self._pressure_hpa, self._mag_frd_gauss = math.nan, (math.nan, math.nan, math.nan)
        self.position_resets = 0
        self.t_us = 0
        imu = grade.imu
        left = imu.bias_left_by_estimator
        bias_std = np.repeat([imu.gyro_bias_std_radps, imu.accel_bias_std_mps2], 3)
        self._imu_bias = left * bias_std * bias_rng.standard_normal(6)
        density = np.array([*imu.gyro_noise_radps_rthz, *imu.accel_noise_mps2_rthz])
        self._imu_std = density * math.sqrt(0.5 * 1000.0)
        self.noise = np.empty((_BLOCK, 6))
        self._next = _BLOCK
        self.imu = np.zeros(_IMU_SIZE)
        self.gyro_frd_radps = self.imu[GYRO : GYRO + 3]
        self.accel_frd_mps2 = self.imu[_ACCEL : _ACCEL + 3]
        self.mean_imu = self.imu[_MEAN_GYRO : _MEAN_ACCEL + 3]
        self.mean_gyro_frd_radps = self.imu[_MEAN_GYRO : _MEAN_GYRO + 3]
        self.mean_accel_frd_mps2 = self.imu[_MEAN_ACCEL : _MEAN_ACCEL + 3]
        self.raw_accel_frd_mps2 = self.imu[_RAW_ACCEL : _RAW_ACCEL + 3]
        together = None if grade.kalman is None else joint(grade)
        self.estimator = EstimatorModel(grade.estimate, estimate_rng, 0.001 * ESTIMATE_EVERY_MS, together)
        self._bias = _BiasEstimate(grade.kalman, kalman_rng, self.imu) if grade.kalman is not None else None
        self.state = self.estimator.state
        self._fix: tuple[int, list[float]] | None = None
        self.fix_count = 0
        self._pending: deque[tuple[int, list[float]]] = deque()  # when taken, position and velocity
        fix = grade.fix
        self._fix_std = np.array([*fix.pos_std_m, *fix.vel_std_mps])
        self._fix_accuracy = (math.hypot(*fix.pos_std_m[:2]), fix.pos_std_m[2], math.hypot(*fix.vel_std_mps))
        self._fix_noise: list[list[float]] = []
        self._air_noise: list[float] = []
        self._fix_period_us = round(1e6 / grade.fix.rate_hz)
        self._fix_delay_us = round(1e6 * grade.fix.delay_s)
        self._next_fix_us = 0
        self._pos_ned_m, self._q_ned_frd = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])

    def step(self, plant: Plant) -> None:
        """Sample the plant's present state; call once a millisecond."""
        estimator = self.estimator
        sense(
            (plant.rate_frd_radps, plant.specific_force_frd_mps2, plant.pos_ned_m, plant.vel_ned_mps, plant.q_ned_frd),
            (plant.gyro_bias_frd_radps, plant.accel_bias_frd_mps2, plant.misalignment_q),
            (self.noise, self.noise_row(), self.imu),
            (estimator.noise, estimator.noise_row(), estimator.model, estimator.state),
        )
        self.sampled(plant, 1)

    def noise_row(self) -> int:
        """Row of `noise` for the next sample; a block lasts for a whole number of estimates."""
        if self._next == _BLOCK:
            self._imu_rng.standard_normal(out=self.noise)
            self.noise *= self._imu_std
            self.noise += self._imu_bias
            self._next = 0
        return self._next

    def sampled(self, plant: Plant, count: int) -> None:
        """`count` samples have been taken, the last of them now; every 4 ms the raw fixes are looked at."""
        self._next += count
        if self._next % ESTIMATE_EVERY_MS:
            return
        self.estimator.used()
        if self._bias is not None:
            self._bias.step()
        self.t_us = plant.t_us
        self._pos_ned_m, self._q_ned_frd = plant.pos_ned_m, plant.q_ned_frd
        if self.t_us >= self._next_fix_us:
            self._next_fix_us += self._fix_period_us
            self._take_fix(plant)
        while self._pending and self._pending[0][0] + self._fix_delay_us <= self.t_us:
            self._fix = self._pending.popleft()
            self.fix_count += 1

    def _take_fix(self, plant: Plant) -> None:
        if not self._fix_noise:
            self._fix_noise = (self._fix_std * self._fix_rng.standard_normal((_FIX_BLOCK, 6))).tolist()
        truth = plant.pos_ned_m.tolist() + plant.vel_ned_mps.tolist()
        self._pending.append((self.t_us, list(map(add, truth, self._fix_noise.pop()))))

    @property
    def fix(self) -> Fix | None:
        """The last raw fix that has become known."""
        if self._fix is None:
            return None
        t_us, (n, e, d, vn, ve, vd) = self._fix
        return Fix(t_us, (n, e, d), (vn, ve, vd), *self._fix_accuracy)

    def estimate(self, rate_frd_radps: F64) -> EstimatorOutput:
        """Frozen copy of the last estimate; `rate_frd_radps` is the rate loop's filtered gyro."""
        n, e, d, vn, ve, vd, w, x, y, z, an, ae, ad = self.state.tolist()
        p, q, r = rate_frd_radps.tolist()
        return EstimatorOutput(
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

    def set_fix_delay(self, delay_s: float) -> None:
        """From now on a fix becomes known so late after it was taken."""
        self._fix_delay_us = round(1e6 * delay_s)

    def jump_north(self, distance_m: float) -> None:
        """The estimate's position jumps, and the reset is counted."""
        self.estimator.jump_north(distance_m)
        self.position_resets += 1

    def pressure_hpa(self) -> float:
        """Barometer now: standard atmosphere at the true height, with noise."""
        altitude_m = self.origin_altitude_m - float(self._pos_ned_m[2])
        if self.barometer.kind != STUCK or math.isnan(self._pressure_hpa):
            noise_pa = self.grade.air.baro_std_pa * self._air_normal()
            self._pressure_hpa = 1013.25 * math.pow(1.0 - 2.25577e-5 * altitude_m, 5.25588) + 0.01 * noise_pa
        return self._pressure_hpa

    def mag_frd_gauss(self) -> Tuple3:
        """Magnetometer now: Earth's field turned into the body, with noise."""
        if self.magnetometer.kind != STUCK or math.isnan(self._mag_frd_gauss[0]):
            x, y, z = _to_body(self._q_ned_frd.tolist(), FIELD_NED_GAUSS)
            normal, std = self._air_normal, self.grade.air.mag_std_gauss
            self._mag_frd_gauss = x + std[0] * normal(), y + std[1] * normal(), z + std[2] * normal()
        return self._mag_frd_gauss

    def _air_normal(self) -> float:
        """The next normal for the barometer or the magnetometer."""
        if not self._air_noise:
            self._air_noise = self._air_rng.standard_normal(_AIR_BLOCK)[::-1].tolist()
        return self._air_noise.pop()


def _to_body(q: list[float], v: Tuple3) -> Tuple3:
    """R(q)^T v in plain floats, which are faster than arrays for one vector."""
    w, x, y, z = q[Q_W], -q[Q_X], -q[Q_Y], -q[Q_Z]
    tx, ty, tz = 2.0 * (y * v[2] - z * v[1]), 2.0 * (z * v[0] - x * v[2]), 2.0 * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )


class _BiasEstimate:
    """The filter's wrong accelerometer bias, first-order Gauss-Markov, in the IMU's numbers; begins at 0."""

    def __init__(self, kalman: KalmanGrade, rng: np.random.Generator, imu: F64) -> None:
        decay = math.exp(-0.001 * ESTIMATE_EVERY_MS / kalman.accel_bias_time_constant_s)
        self._decay, self._drive = decay, math.sqrt(1.0 - decay * decay) * np.array(kalman.accel_bias_std_mps2)
        self._rng, self._normals, self._next = rng, np.empty((_BLOCK, 3)), _BLOCK
        self._value = imu[_BIAS : _BIAS + 3]
        imu[_COLOURED] = 0.5 * (kalman.imu_samples - 1.0)

    def step(self) -> None:
        """4 ms on."""
        if self._next == _BLOCK:
            self._rng.standard_normal(out=self._normals)
            self._next = 0
        self._value *= self._decay
        self._value += self._drive * self._normals[self._next]
        self._next += 1


@njit
def sense(
    true: tuple[F64, F64, F64, F64, F64], errors: tuple[F64, F64, F64], sensors: tuple[F64, int, F64],
    estimator: tuple[F64, int, F64, F64],
) -> None:  # fmt: skip
    """One millisecond of sensors: an IMU sample, and with every fourth the means and the next estimate.

    true: body rates, specific force, position, velocity, attitude; errors: biases of gyro and accelerometer,
    misalignment; sensors: noise, its row, the IMU's numbers; estimator: noise, its row, model, state.
    """
    (rate, force, pos, vel, q), (gyro_bias, accel_bias, misalignment), (noise, row, imu) = true, errors, sensors
    for i in range(3):
        imu[GYRO + i] = rate[i] + gyro_bias[i] + noise[row, i]
        imu[_ACCEL + i] = force[i] + accel_bias[i] + noise[row, 3 + i]
    for i in range(6):
        imu[_SUM + i] += imu[i]
    imu[_COUNT] += 1.0
    if imu[_COUNT] == ESTIMATE_EVERY_MS:
        coloured = imu[_COLOURED]
        for i in range(6):
            imu[_MEAN_GYRO + i] = imu[_SUM + i] / ESTIMATE_EVERY_MS
            imu[_SUM + i] = 0.0
            if coloured > 0.0:  # noise alone: the trapezoid's true part is the mean already
                new = 0.0
                for k in range(ESTIMATE_EVERY_MS):
                    new += noise[row - k, i] / ESTIMATE_EVERY_MS
                imu[_MEAN_GYRO + i] += coloured * (imu[_LAST_NOISE + i] - new)
                imu[_LAST_NOISE + i] = new
        imu[_COUNT] = 0.0
        for i in range(3):
            imu[_RAW_ACCEL + i] = imu[_MEAN_ACCEL + i]
            imu[_MEAN_ACCEL + i] -= imu[_BIAS + i]
        mean_accel, accel_noise = imu[_MEAN_ACCEL : _MEAN_ACCEL + 3], imu[_LAST_NOISE + 3 : _LAST_NOISE + 6]
        estimate((pos, vel, q, misalignment), (mean_accel, accel_noise), estimator)
