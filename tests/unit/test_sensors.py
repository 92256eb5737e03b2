"""Sensors and their grades: noise, biases, rates and delays as the file states them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flightstack.types import F64, InputError
from flightstack_sim.estimator import joint
from flightstack_sim.grade import FixGrade, Grade, ImuGrade, load_grade, parse_grade
from flightstack_sim.sensors import FIELD_NED_GAUSS, HOME_ALTITUDE_M, Sensors

ZERO = (0.0, 0.0, 0.0)


@dataclass
class Still:
    """What a plant shows, without physics."""

    t_us: int = 0
    pos_ned_m: F64 = field(default_factory=lambda: np.zeros(3))
    vel_ned_mps: F64 = field(default_factory=lambda: np.zeros(3))
    q_ned_frd: F64 = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    rate_frd_radps: F64 = field(default_factory=lambda: np.zeros(3))
    specific_force_frd_mps2: F64 = field(default_factory=lambda: np.array([0.0, 0.0, -9.80665]))
    accel_bias_frd_mps2: F64 = field(default_factory=lambda: np.zeros(3))
    gyro_bias_frd_radps: F64 = field(default_factory=lambda: np.zeros(3))
    misalignment_q: F64 = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))


def imu(sensors: Sensors, plant: Still, ms: int) -> F64:
    """(ms, 6) gyro and accelerometer samples."""
    out = np.empty((ms, 6))
    for row in out:
        plant.t_us += 1000
        sensors.step(plant)  # type: ignore[arg-type]
        row[:3], row[3:] = sensors.gyro_frd_radps, sensors.accel_frd_mps2
    return out


def without_imu_errors(grade: Grade) -> Grade:
    return replace(grade, imu=ImuGrade(ZERO, ZERO, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("name", ["mocap", "gps"])
def test_imu_noise_is_white_with_the_density_of_the_file(name: str) -> None:
    """sd = density sqrt(f/2) within 4 standard errors, 1 / sqrt(2 N); neighbours don't correlate."""
    grade = load_grade(name)
    n = 20_000
    samples = imu(Sensors(grade, seed=3), Still(), n)
    density = np.array([*grade.imu.gyro_noise_radps_rthz, *grade.imu.accel_noise_mps2_rthz])
    np.testing.assert_allclose(samples.std(axis=0), density * math.sqrt(500.0), rtol=4.0 / math.sqrt(2.0 * n))
    white = samples - samples.mean(axis=0)
    lag1 = (white[1:] * white[:-1]).mean(axis=0) / white.var(axis=0)
    assert np.abs(lag1).max() < 4.0 / math.sqrt(n)


def test_turn_on_biases_are_constant_and_spread_over_seeds_by_the_share_left() -> None:
    base = load_grade("mocap")
    grade = replace(base, imu=ImuGrade(ZERO, ZERO, 0.01, 0.2, 0.25))
    biases = []
    for seed in range(100):
        first, last = imu(Sensors(grade, seed=seed), Still(), 2)[[0, -1]]
        np.testing.assert_array_equal(first, last)
        biases.append(first - [0.0, 0.0, 0.0, 0.0, 0.0, -9.80665])
    spread = np.sqrt(np.mean(np.square(biases), axis=0)) / (0.25 * np.array([0.01] * 3 + [0.2] * 3))
    np.testing.assert_allclose(spread, 1.0, rtol=4.0 / math.sqrt(200.0))


def test_the_bias_effects_come_on_top_whole() -> None:
    sensors, plant = Sensors(without_imu_errors(load_grade("mocap")), seed=0), Still()
    plant.gyro_bias_frd_radps[:] = 0.01, -0.02, 0.03
    plant.accel_bias_frd_mps2[:] = 0.1, 0.2, -0.3
    plant.rate_frd_radps[:] = 1.0, 2.0, 3.0
    samples = imu(sensors, plant, 9)
    np.testing.assert_allclose(samples[-1], [1.01, 1.98, 3.03, 0.1, 0.2, -10.10665], rtol=1e-12)


def test_the_reported_imu_is_the_mean_of_the_last_four_samples() -> None:
    sensors, plant = Sensors(load_grade("gps"), seed=5), Still()
    samples = imu(sensors, plant, 12)
    np.testing.assert_allclose(sensors.mean_gyro_frd_radps, samples[-4:, :3].mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(sensors.mean_accel_frd_mps2, samples[-4:, 3:].mean(axis=0), rtol=1e-12)
    imu(sensors, plant, 3)  # not yet complete: the mean stays
    np.testing.assert_allclose(sensors.mean_gyro_frd_radps, samples[-4:, :3].mean(axis=0), rtol=1e-12)


@pytest.mark.parametrize(("name", "rate_hz", "delay_ms"), [("gps", 8.0, 110), ("mocap", 100.0, 10)])
def test_fixes_come_at_their_rate_and_become_known_after_their_delay(name: str, rate_hz: float, delay_ms: int) -> None:
    sensors, plant = Sensors(load_grade(name), seed=0), Still()
    ages = []
    for _ in range(10_000 // 4):
        known = sensors.fix_count
        imu(sensors, plant, 4)
        if sensors.fix_count > known:
            assert sensors.fix is not None
            ages.append(plant.t_us - sensors.fix.t_us)
    assert len(ages) == pytest.approx(10.0 * rate_hz, abs=2)
    assert delay_ms * 1000 <= min(ages)
    assert max(ages) < delay_ms * 1000 + 4000


def test_fix_noise_is_that_of_the_file() -> None:
    grade = replace(load_grade("gps"), fix=FixGrade(250.0, 0.0, (0.2, 0.3, 0.5), (0.06, 0.07, 0.158)))
    sensors, plant = Sensors(grade, seed=1), Still()
    plant.pos_ned_m[:] = 10.0, -20.0, -30.0
    plant.vel_ned_mps[:] = 1.0, 2.0, 3.0
    rows = []
    for _ in range(2000):
        imu(sensors, plant, 4)
        assert sensors.fix is not None
        rows.append([*sensors.fix.pos_ned_m, *sensors.fix.vel_ned_mps])
    std = np.array([0.2, 0.3, 0.5, 0.06, 0.07, 0.158])
    np.testing.assert_allclose(np.std(rows, axis=0), std, rtol=4.0 / math.sqrt(4000.0))
    error = np.mean(rows, axis=0) - [10.0, -20.0, -30.0, 1.0, 2.0, 3.0]
    assert (np.abs(error) < 4.0 * std / math.sqrt(2000.0)).all()


def test_the_barometer_reads_the_standard_atmosphere() -> None:
    """ISO 2533: 898.75 hPa at 1000 m."""
    sensors, plant = Sensors(load_grade("mocap"), seed=0), Still()
    plant.pos_ned_m[2] = HOME_ALTITUDE_M - 1000.0
    imu(sensors, plant, 4)
    assert np.mean([sensors.pressure_hpa() for _ in range(400)]) == pytest.approx(898.75, abs=0.05)


def test_the_magnetometer_sees_the_field_turned_into_the_body() -> None:
    sensors, plant = Sensors(load_grade("mocap"), seed=0), Still()
    turn = Rotation.from_euler("ZYX", [1.0, -0.3, 0.5])
    x, y, z, w = turn.as_quat()
    plant.q_ned_frd[:] = w, x, y, z
    imu(sensors, plant, 4)
    mean = np.mean([sensors.mag_frd_gauss() for _ in range(400)], axis=0)
    np.testing.assert_allclose(mean, turn.inv().apply(FIELD_NED_GAUSS), atol=6e-4)


def test_reported_acceleration_is_zero_at_rest_in_any_attitude() -> None:
    sensors, plant = Sensors(without_imu_errors(load_grade("mocap")), seed=0), Still()
    turn = Rotation.from_euler("ZYX", [2.0, 0.4, -0.2])
    x, y, z, w = turn.as_quat()
    plant.q_ned_frd[:] = w, x, y, z
    plant.specific_force_frd_mps2[:] = turn.inv().apply([0.0, 0.0, -9.80665])
    imu(sensors, plant, 8)
    acceleration = sensors.estimate(np.zeros(3)).acc_ned_mps2
    assert math.hypot(*acceleration) < 9.81 * 4.0 * (3.5e-3 + 3.5e-3)  # only the attitude's error


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others() -> None:
    runs = [imu(Sensors(load_grade("gps"), seed=seed), Still(), 2100).tobytes() for seed in (7, 7, 8)]
    assert runs[0] == runs[1] != runs[2]


def test_reading_one_sensor_does_not_change_another() -> None:
    quiet, busy = Sensors(load_grade("gps"), seed=7), Sensors(load_grade("gps"), seed=7)
    one, other = Still(), Still()
    for _ in range(50):
        imu(quiet, one, 4)
        imu(busy, other, 4)
        busy.pressure_hpa()
        busy.mag_frd_gauss()
    np.testing.assert_array_equal(quiet.state, busy.state)
    np.testing.assert_array_equal(quiet.gyro_frd_radps, busy.gyro_frd_radps)
    assert quiet.fix == busy.fix


def test_a_grade_file_is_read_number_for_number() -> None:
    grade = load_grade("mocap")
    assert grade.name == "mocap"
    assert grade.estimate.pos_std_m == (0.005, 0.005, 0.005)
    assert grade.estimate.vel_std_mps == (0.02, 0.02, 0.02)
    assert load_grade("gps").estimate.vel_std_mps == (0.11, 0.28, 0.13)


TEXT = """
schema = "flightstack.sensors/1"
name = "x"
[imu]
gyro_noise_radps_rthz = [1e-3, 1e-3, 1e-3]
accel_noise_mps2_rthz = [1e-2, 1e-2, 1e-2]
gyro_bias_std_radps = 0.0
accel_bias_std_mps2 = 0.0
bias_left_by_estimator = 0.1
[fix]
rate_hz = 8
delay_s = 0.1
pos_std_m = [0.1, 0.1, 0.1]
vel_std_mps = [0.1, 0.1, 0.1]
[estimate]
pos_std_m = [0.1, 0.1, 0.1]
pos_bias_std_m = [0.1, 0.1, 0.1]
pos_time_constant_s = 1.0
vel_std_mps = [0.1, 0.1, 0.1]
vel_time_constant_s = 1.0
tilt_std_rad = 0.01
tilt_time_constant_s = 1.0
heading_std_rad = 0.01
heading_time_constant_s = 1.0
[air]
baro_std_pa = 1.0
mag_std_gauss = [0.01, 0.01, 0.01]
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rate_hz = 8", "rate_hz = 0", r"fix\.rate_hz = 0: must be a number from 0\.1 to 250"),
        ("rate_hz = 8", "", r"fix\.rate_hz = None: must be a number"),
        ("rate_hz = 8", 'rate_hz = "8"', r"fix\.rate_hz = '8'"),
        ("rate_hz = 8", "rate_hz = 8\nrate = 8", "fix: unknown key rate;"),
        ("delay_s = 0.1", "delay_s = nan", r"fix\.delay_s = nan"),
        ("delay_s = 0.1", "delay_s = true", r"fix\.delay_s = True"),
        ("mag_std_gauss = [0.01, 0.01, 0.01]", "mag_std_gauss = [0.01, 0.01]", r"air\.mag_std_gauss.*3 numbers"),
        ("mag_std_gauss = [0.01, 0.01, 0.01]", "mag_std_gauss = 0.01", r"air\.mag_std_gauss.*3 numbers"),
        ("[air]", "[wind]\n[air]", "unknown key wind"),
        ('name = "x"', "", "name = missing must be a line of text"),
        ("sensors/1", "sensors/2", "is not known; this version reads"),
        ("[imu]", "[imu", "not valid TOML"),
    ],
)
def test_a_bad_grade_file_is_refused_in_one_line_that_names_file_and_key(old: str, new: str, message: str) -> None:
    parse_grade(TEXT, "x.toml")
    with pytest.raises(InputError, match=message) as caught:
        parse_grade(TEXT.replace(old, new), "x.toml")
    assert str(caught.value).startswith("x.toml: ")
    assert "\n" not in str(caught.value)


def test_an_unknown_grade_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="use one of mocap, gps, px4-sih"):
        load_grade("rtk")


def reported(sensors: Sensors, plant: Still, count: int) -> tuple[F64, F64, F64]:
    """(n, 6) IMU as reported, (n, 3) raw accelerometer, (n, 6) estimated position and velocity, every 4 ms."""
    imu_rows, raw, state = np.empty((count, 6)), np.empty((count, 3)), np.empty((count, 6))
    for k in range(count):
        imu(sensors, plant, 4)
        imu_rows[k], raw[k], state[k] = sensors.mean_imu, sensors.raw_accel_frd_mps2, sensors.state[:6]
    return imu_rows, raw, state


def test_px4_sih_reports_a_trapezoid_of_two_samples_as_recorded() -> None:
    """0.354, 1.21, 0.984 m/s^2 and a lag-1 correlation of 0.48, none beyond: MA(1)."""
    rows, raw, _ = reported(Sensors(load_grade("px4-sih"), seed=2), Still(), 20_000)
    np.testing.assert_allclose(raw.std(axis=0), [0.354, 1.21, 0.984], rtol=0.03)
    np.testing.assert_allclose(rows[:, :3].std(axis=0), [0.098, 0.049, 0.021], rtol=0.03)
    white = np.column_stack([rows[:, :3], raw])
    white -= white.mean(axis=0)
    for lag, expected in ((1, 0.5), (2, 0.0), (3, 0.0)):
        correlation = (white[lag:] * white[:-lag]).mean(axis=0) / white.var(axis=0)
        np.testing.assert_allclose(correlation, expected, atol=0.04)


def test_px4_sih_takes_out_a_bias_that_is_not_there_and_leaves_it_in_the_raw_ones() -> None:
    taken = []
    for seed in range(12):
        rows, raw, _ = reported(Sensors(load_grade("px4-sih"), seed=seed), Still(), 4000)
        bias = raw - rows[:, 3:]
        assert np.abs(np.diff(bias, axis=0)).max() < 0.05, "slow"
        taken.append(bias[1500:])
    together = np.concatenate(taken)
    assert 0.25 < np.abs(together[:, 1]).max() < 0.9
    assert np.abs(together[:, 2]).max() < 0.1


def test_px4_sih_position_and_velocity_disagree_slowly_as_recorded() -> None:
    """c = d(position)/dt - velocity: 0.15, 0.31, 0.15 m/s rms, nine tenths of its power below 0.3 Hz."""
    grade = load_grade("px4-sih")
    of = joint(grade)
    runs = [reported(Sensors(grade, seed=seed), Still(), 15_000)[2][1000:] for seed in range(4)]
    c = np.array([np.diff(run[:, :3], axis=0) / 0.004 - 0.5 * (run[1:, 3:] + run[:-1, 3:]) for run in runs])
    np.testing.assert_allclose(np.sqrt((c**2).mean(axis=(0, 1))), [0.15, 0.31, 0.15], rtol=0.2)
    np.testing.assert_allclose(np.sqrt((c**2).mean(axis=(0, 1))), of.disagreement_std_mps, rtol=0.2)
    power = np.abs(np.fft.rfft(c, axis=1)) ** 2
    hz = np.fft.rfftfreq(c.shape[1], 0.004)
    assert (power[:, hz < 0.3].sum(axis=(0, 1)) / power.sum(axis=(0, 1)) > 0.9).all()
    pos, vel = np.array(runs)[..., :3], np.array(runs)[..., 3:]
    pos = pos - np.array([constant_bias(grade, seed) for seed in range(4)])[:, None]
    np.testing.assert_allclose(np.sqrt((vel**2).mean(axis=(0, 1))), grade.estimate.vel_std_mps, rtol=0.2)
    np.testing.assert_allclose(np.sqrt((pos**2).mean(axis=(0, 1))), grade.estimate.pos_std_m, rtol=0.2)
    together = (pos * vel).mean(axis=(0, 1)) / (np.sqrt((pos**2).mean(axis=(0, 1)) * (vel**2).mean(axis=(0, 1))))
    np.testing.assert_allclose(together, of.correlation, atol=0.05)


def constant_bias(grade: Grade, seed: int) -> F64:
    """The constant part of the position's error in a flight."""
    bias: F64 = Sensors(grade, seed=seed).estimator.model[2, :3]
    return bias


def test_a_kalman_grade_that_contradicts_itself_is_refused() -> None:
    grade = load_grade("px4-sih")
    with pytest.raises(InputError, match="vel_std_mps is less than"):
        joint(replace(grade, estimate=replace(grade.estimate, vel_std_mps=(0.17, 0.35, 0.05))))
    with pytest.raises(InputError, match="pos_std_m is less than"):
        joint(replace(grade, estimate=replace(grade.estimate, pos_std_m=(0.1, 0.1, 0.1))))
