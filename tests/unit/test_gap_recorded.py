"""Recorded flights of other people's vehicles and simulators: each is read, checked, and used or refused as it is."""

from __future__ import annotations

import gzip
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shipped import load_vehicle

from flightstack.types import InputError
from flightstack.vehicle import Vehicle, parse_vehicle
from gap.check import check
from gap.read import flight
from gap.records import Checked
from logs.reader import read
from tests.recorded_px4 import read_flight

pytestmark = pytest.mark.recorded

NANO = """
schema = "flightstack.vehicle/1"
name = "crazyflie"
[body]
mass_kg = 0.027
inertia_kgm2 = [1.66e-5, 1.66e-5, 2.93e-5]
[rotors]
position_m = [[0.0325, 0.0325, 0.0], [-0.0325, -0.0325, 0.0], [0.0325, -0.0325, 0.0], [-0.0325, 0.0325, 0.0]]
torque_ratio_m = [0.006, 0.006, -0.006, -0.006]
max_thrust_n = 0.15
max_speed_radps = 2500.0
thrust_model_factor = 1.0
time_constant_s = 0.03
radius_m = 0.0235
"""


def nano() -> Vehicle:
    return parse_vehicle(NANO, "nano")


def iris() -> Vehicle:
    """1.5 kg; 5.84e-6 N s^2/rad^2 up to 1100 rad/s: 7.07 N."""
    quad = load_vehicle("quad-x")
    return replace(quad, mass_kg=1.5, rotors=replace(quad.rotors, max_thrust_n=7.07, max_speed_radps=1100.0))


def sih(folder: Path) -> Vehicle:
    return parse_vehicle((folder / "px4_sih.toml").read_text(), "px4_sih.toml")


def by_name(checked: Checked, level: str) -> dict[str, str]:
    return {each.name: each.text for each in checked.findings if each.level == level}


def test_px4s_flight_is_usable_and_its_gyro_late_by_half_an_integration_interval(recorded: Path) -> None:
    """`sensor_combined` holds means over 4 ms, stamped at their end: 2 ms late, by PX4's own description."""
    checked = check(flight(recorded / "px4_sih_flight.ulg.gz", sih(recorded)), sih(recorded))
    assert checked.samples is not None
    offsets = {each.signal: each for each in checked.offsets}
    assert offsets["rate_frd_radps"].offset_s == pytest.approx(0.002, abs=2e-4)
    assert abs(offsets["vel_ned_mps"].offset_s) < 0.003
    assert "rotors" in by_name(checked, "ok")
    assert checked.samples.dt_s == pytest.approx(0.004)
    assert 25.0 < checked.samples.valid.sum() * 0.004 < 33.0


def test_px4s_samples_agree_with_the_simulators_ground_truth(recorded: Path) -> None:
    """The truth topics, which the reader never looks at, are the oracle; 0.03 rad/s of it are noise."""
    samples = check(flight(recorded / "px4_sih_flight.ulg.gz", sih(recorded)), sih(recorded)).samples
    assert samples is not None
    topics, _ = read_flight(recorded)
    truth = topics["vehicle_angular_velocity_groundtruth"]
    t_s = truth["timestamp"].astype(float) * 1e-6
    rows = (t_s > samples.t_s[50]) & (t_s < samples.t_s[-50])
    for axis in range(3):
        got = np.interp(t_s[rows], samples.t_s, samples.rate_frd_radps[:, axis])
        assert np.sqrt(np.mean((got - truth["xyz"][rows, axis]) ** 2)) < 0.1
    truth = topics["vehicle_attitude_groundtruth"]
    nearest = np.clip(np.searchsorted(samples.t_s, truth["timestamp"].astype(float) * 1e-6), 0, len(samples.t_s) - 1)
    dots = np.abs(np.sum(samples.q_ned_frd[nearest] * truth["q"], axis=1))[rows]
    assert np.degrees(2.0 * np.arccos(np.minimum(dots, 1.0))).mean() < 4.0


def test_thr_mdl_fac_of_the_log_is_applied_to_its_motors(recorded: Path, tmp_path: Path) -> None:
    """The recorded flight, written again by pyulog with another parameter: u solves f u^2 + (1 - f) u = control."""
    from pyulog import ULog

    log = ULog(io.BytesIO(gzip.decompress((recorded / "px4_sih_flight.ulg.gz").read_bytes())))
    log.initial_parameters["THR_MDL_FAC"] = 0.4
    log.write_ulog(str(tmp_path / "a.ulg"))
    plain = flight(recorded / "px4_sih_flight.ulg.gz", sih(recorded)).signals["motor"].value
    got = flight(tmp_path / "a.ulg", sih(recorded))
    u = got.signals["motor"].value
    np.testing.assert_allclose(0.4 * u**2 + 0.6 * u, plain, atol=1e-6)
    assert any("THR_MDL_FAC 0.4" in note for note in got.notes)


def test_a_vehicle_file_whose_rotors_sit_elsewhere_is_refused_by_the_logs_own_geometry(recorded: Path) -> None:
    other = sih(recorded)
    other = replace(other, rotors=replace(other.rotors, position_m=other.rotors.position_m[[2, 3, 0, 1]]))
    with pytest.raises(InputError, match="order must be PX4's"):
        flight(recorded / "px4_sih_flight.ulg.gz", other)


def test_a_px4_moved_by_hand_on_a_bench_is_no_flight(recorded: Path) -> None:
    checked = check(flight(recorded / "px4_real_bench_NOTFLYING_68s.ulg", iris()), iris())
    assert checked.samples is None
    assert "SDLOG" in by_name(checked, "refused")["flight"]


def test_a_default_px4_log_is_too_slow_and_says_what_to_record(recorded: Path) -> None:
    checked = check(flight(recorded / "px4_sitl_modern_topics_31s.ulg", iris()), iris())
    assert checked.samples is None
    assert "SDLOG_PROFILE 25" in by_name(checked, "refused")["rate"]


def test_gazebos_flight_needs_its_map_and_passes_with_it(recorded: Path) -> None:
    path = recorded / "gazebo_iris_sitl_56s.csv.gz"
    with pytest.raises(InputError, match="--columns"):
        flight(path, iris())
    checked = check(flight(path, iris(), "gazebo_iris"), iris())
    assert checked.samples is not None
    assert checked.samples.dt_s == pytest.approx(0.01)
    assert checked.samples.derived == ("pos_ned_m",)
    assert not {"units", "frames", "quaternion"} & by_name(checked, "warning").keys()
    assert "rotors" in by_name(checked, "ok")


@pytest.mark.parametrize(
    "name", ["B2_circle_fast_rep1", "B2_circle_medium_rep1", "B3_figure8_fast_rep2", "B6_linear_ramp_rep2"]
)
def test_nanobench_flights_pass_with_their_map(recorded: Path, name: str) -> None:
    checked = check(flight(recorded / f"nanobench_{name}.csv.gz", nano(), "nanobench"), nano())
    assert checked.samples is not None, checked.findings
    assert not {"units", "frames", "quaternion"} & by_name(checked, "warning").keys()
    force = checked.samples.accel_frd_mps2[checked.samples.valid]
    assert np.mean(force[:, 2]) == pytest.approx(-9.81, rel=0.04)
    assert 0.3 < np.median(checked.samples.height_m) < 1.6


def test_a_crazyflies_imu_log_without_attitude_is_used_for_what_it_can_show(recorded: Path) -> None:
    checked = check(flight(recorded / "crazyflie_thrust_chirp_50s.cfusdlog", nano()), nano())
    assert checked.samples is not None, checked.findings
    assert checked.samples.dt_s == pytest.approx(0.004)
    assert np.isnan(checked.samples.q_ned_frd).all()
    assert np.isfinite(checked.samples.accel_frd_mps2[checked.samples.valid]).all()
    assert checked.samples.valid.sum() * 0.004 > 25.0


def test_crazyflie_logs_with_roll_and_yaw_only_get_their_pitch_from_the_acceleration(recorded: Path) -> None:
    for name in ("normal_E8_log00", "cut4mm_M3_E8_log00"):
        checked = check(flight(recorded / "crazypad" / name, nano()), nano())
        assert checked.samples is not None, checked.findings
        assert set(checked.samples.derived) == {"q_ned_frd", "rate_frd_radps", "accel_frd_mps2"}
        force = checked.samples.accel_frd_mps2[checked.samples.valid]
        assert np.mean(force[:, 2]) == pytest.approx(-9.81, rel=0.04)


def test_a_recorded_px4_log_cut_anywhere_is_still_read_as_far_as_it_goes(recorded: Path, tmp_path: Path) -> None:
    data = (recorded / "px4_sitl_modern_topics_31s.ulg").read_bytes()
    last = 0
    for size in range(len(data) // 4, len(data), len(data) // 4 - 1):
        (tmp_path / "cut.ulg").write_bytes(data[:size])
        log = read(tmp_path / "cut.ulg")
        count = sum(map(len, log.tables.values()))
        assert count > last
        last = count
    broken = data[: len(data) // 2] + bytes(5000) + data[len(data) // 2 + 5000 :]
    (tmp_path / "broken.ulg").write_bytes(broken)
    log = read(tmp_path / "broken.ulg")
    assert not log.complete
    assert "damaged" in log.notes[0]
    assert sum(map(len, log.tables.values())) > 0.9 * last
