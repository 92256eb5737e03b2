"""ArduPilot's words: how its board sits, which output drives which motor, when it flew.

The trims and the means of the accelerometer are those of two real flights of ArduCopter 3.6.8 hovering in calm air; the
motors' places are those of AP_MotorsMatrix.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flightstack.cli.vehicle import parameters
from flightstack.types import InputError
from flightstack_logs import ardupilot
from flightstack_logs.readers.dataflash import read_dataflash
from flightstack_logs.standard import with_vehicle_topics
from flightstack_logs.tables import Table
from tests.unit.test_log_formats import dataflash

G = 9.80665


def events(*pairs: tuple[int, int]) -> dict[str, Table]:
    at_us, ids = np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])
    return {"EV": Table("EV", at_us, {"Id": ids}, {})}


@pytest.mark.parametrize(
    ("trim_x", "trim_y", "measured"),
    [(-0.0091, 0.0303, (0.325, 0.115, -9.85)), (-0.0399, -0.0073, (-0.215, 0.43, -9.85))],
)
def test_the_boards_trim_is_taken_out_of_what_it_measures_in_a_hover(
    trim_x: float, trim_y: float, measured: tuple[float, float, float]
) -> None:
    """The attitude of the frame was level within 0.3 degrees (0.05 m/s^2) in both; the second had a breeze."""
    said = {"AHRS_TRIM_X": trim_x, "AHRS_TRIM_Y": trim_y, "AHRS_TRIM_Z": 0.0}
    force = ardupilot.board_to_frame(said) @ np.array(measured)
    assert np.abs(force[:2]).max() < 0.15 < np.abs(measured[:2]).max()
    assert np.linalg.norm(force) == pytest.approx(np.linalg.norm(measured), rel=1e-12)


def test_a_log_with_a_trim_has_its_imu_in_the_axes_of_its_attitude(tmp_path: Path) -> None:
    """A board that sits 3 degrees nose down on a level frame feels gravity along its x: the frame does not."""
    log = read_dataflash(tmp_path / "a.BIN", dataflash())
    plain = with_vehicle_topics(log).tables["/vehicle/imu"]["accel_frd_mps2"]
    pitch = -np.radians(3.0)
    names = np.array(["AHRS_TRIM_X", "AHRS_TRIM_Y"])
    said = Table("PARM", np.zeros(2, np.int64), {"Name": names, "Value": np.array([0.0, pitch])}, {})
    trimmed = with_vehicle_topics(replace(log, tables={**log.tables, "PARM": said})).tables["/vehicle/imu"][
        "accel_frd_mps2"
    ]
    c, s = np.cos(pitch), np.sin(pitch)
    np.testing.assert_allclose(trimmed, plain @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T, atol=1e-12)


def test_an_absurd_trim_is_no_trim() -> None:
    np.testing.assert_array_equal(ardupilot.board_to_frame({"AHRS_TRIM_X": 3.0}), np.eye(3))


@pytest.mark.parametrize(
    ("frame", "places"),  # of the motors 1 to 4, by the angle from the nose: 45 front right ... -135 rear left
    [(1, (45, -135, -45, 135)), (12, (135, 45, -135, -45)), (13, (45, -45, -135, 135)), (14, (45, 135, -135, -45))],
)
def test_motors_come_in_px4s_order_whatever_frame_and_output_drive_them(
    frame: int, places: tuple[int, int, int, int]
) -> None:
    channels = (4, 1, 6, 2)  # outputs of the motors 1 to 4
    pulses = np.arange(16)[None] * 10 + 1000
    said = {f"SERVO{channel + 1}_FUNCTION": 33.0 + k for k, channel in enumerate(channels)}
    out = ardupilot.motors_first({**said, "FRAME_CLASS": 1.0, "FRAME_TYPE": float(frame)}, pulses)
    of_place = {place: 1000 + 10 * channel for place, channel in zip(places, channels, strict=True)}
    assert out[0, :4].tolist() == [of_place[angle] for angle in (45, -135, -45, 135)]
    assert sorted(out[0].tolist()) == sorted(pulses[0].tolist())


def test_pulses_are_scaled_by_the_motors_own_range_and_what_is_no_quadrotor_is_left_alone() -> None:
    functions = {f"SERVO{k + 1}_FUNCTION": 33.0 + k for k in range(4)}
    pulses = np.array([[1100, 1500, 1900, 0, 1500]])
    out = ardupilot.motors_first({**functions, "MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0}, pulses)
    assert out[0].tolist() == [1000, 1500, 2000, 0, 1500]
    for said in ({}, {**functions, "FRAME_CLASS": 2.0}):
        np.testing.assert_array_equal(ardupilot.motors_first(said, pulses), pulses)


def test_events_tell_when_it_was_armed_and_when_it_flew() -> None:
    state = ardupilot.states(events((5, 10), (9, 57), (20, 28), (30, 17), (40, 18), (50, 11)))
    assert state is not None
    at_us, armed, landed = state
    assert at_us.tolist() == [5, 20, 40, 50]
    assert armed.tolist() == [True, True, True, False]
    assert landed.tolist() == [True, False, True, True]
    assert ardupilot.states(events((5, 10), (50, 11))) is None
    assert ardupilot.states({}) is None


@pytest.mark.parametrize("name", ["PARM", "EV"])
def test_a_log_that_says_rows_of_numbers_where_one_belongs_is_read_without_them(tmp_path: Path, name: str) -> None:
    """The format letter `a` is 32 numbers: any log may say it of any column."""
    log = read_dataflash(tmp_path / "a.BIN", dataflash())
    wide = np.arange(64).reshape(2, 32)
    columns = {"Name": np.array(["AHRS_TRIM_X", "b"]), "Value": wide} if name == "PARM" else {"Id": wide}
    strange = replace(log, tables={**log.tables, name: Table(name, np.zeros(2, np.int64), columns, {})})
    tables = with_vehicle_topics(strange).tables
    assert "/vehicle/status" not in tables
    plain = with_vehicle_topics(log).tables["/vehicle/imu"]["accel_frd_mps2"]
    np.testing.assert_array_equal(tables["/vehicle/imu"]["accel_frd_mps2"], plain)


def test_a_vehicle_file_begins_with_what_a_dataflash_log_says(tmp_path: Path) -> None:
    said = ardupilot.as_px4({"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0, "MOT_THST_HOVER": 0.29}, "a.BIN")
    assert said["MPC_THR_HOVER"] == 0.29
    assert (said["CA_ROTOR0_PX"], said["CA_ROTOR0_PY"], said["CA_ROTOR0_KM"]) == (1.0, 1.0, 1.0)
    turned = ardupilot.as_px4({"FRAME_CLASS": 1.0, "FRAME_TYPE": 18.0}, "a.BIN")
    assert turned["CA_ROTOR0_KM"] == -1.0
    for wrong in ({"FRAME_CLASS": 2.0}, {"FRAME_TYPE": 1.0}, {"FRAME_CLASS": 1.0, "FRAME_TYPE": 0.0}):
        with pytest.raises(InputError, match=r"^a\.BIN: FRAME_"):
            ardupilot.as_px4(wrong, "a.BIN")
    (path := tmp_path / "a.BIN").write_bytes(dataflash())
    with pytest.raises(InputError, match="FRAME_CLASS is not told"):
        parameters(str(path))
