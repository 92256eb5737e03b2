"""Every kind of log becomes a flight; foreign columns through a map; what is no log is one line."""

from __future__ import annotations

import gzip
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from log_samples import sample_record
from shipped import load_vehicle

from flightstack.gap.read import column_map, flight, rotor_order
from flightstack.gap.sources import FREED
from flightstack.gap.sources.ulog import linearised, signals
from flightstack.types import InputError
from flightstack.vehicle import Vehicle
from flightstack_logs.columns import parse_columns
from flightstack_logs.reader import read
from flightstack_logs.tables import Log, Table
from flightstack_logs.topics import TOPICS
from flightstack_logs.writer import FlightLog
from tests.flown import HEADER, flown, write_csv


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("quad-x")


def test_a_csv_of_the_own_header_comes_back_number_for_number(tmp_path: Path, vehicle: Vehicle) -> None:
    made = flown(vehicle, seconds=3.0)
    path = write_csv(tmp_path / "a.csv", made)
    (tmp_path / "b.csv.gz").write_bytes(gzip.compress(path.read_bytes()))
    for name in ("a.csv", "b.csv.gz"):
        got = flight(tmp_path / name, vehicle)
        assert got.kind == "csv"
        assert set(got.signals) == set(made.signals)
        for signal, each in made.signals.items():
            np.testing.assert_allclose(got.signals[signal].value, each.value, rtol=1e-8, atol=1e-9)
            np.testing.assert_allclose(got.signals[signal].t_s, each.t_s, atol=1e-6)


def test_the_table_of_a_csv_is_typed(tmp_path: Path, vehicle: Vehicle) -> None:
    log = read(write_csv(tmp_path / "a.csv", flown(vehicle, seconds=3.0)))
    table = log.tables["flight"]
    assert log.kind == "csv"
    assert table["q_ned_frd"].shape == (len(table), 4)
    assert table.units["vel_ned_mps"] == "m/s"
    assert table.t_us.dtype == np.int64


def test_missing_cells_and_columns_only_take_their_own_signal(tmp_path: Path, vehicle: Vehicle) -> None:
    """A log whose topics come at different rates leaves cells empty; each topic keeps its own rows."""
    text = "time_s,vel_n_mps,vel_e_mps,vel_d_mps,motor_1,motor_2,motor_3,motor_4\n"
    for row in range(400):
        velocity = f"{row},0,1" if row % 4 == 0 else ",,"
        text += f"{row * 0.01},{velocity},0.5,nan,0.5,0.5\n" if row == 7 else f"{row * 0.01},{velocity},.5,.5,.5,.5\n"
    (tmp_path / "a.csv").write_text(text)
    got = flight(tmp_path / "a.csv", vehicle)
    assert set(got.signals) == {"vel_ned_mps", "motor"}
    assert len(got.signals["vel_ned_mps"].t_s) == 100
    assert got.signals["vel_ned_mps"].value[3].tolist() == [12.0, 0.0, 1.0]
    assert len(got.signals["motor"].t_s) == 399


FOREIGN = """
schema = "flightstack.columns/1"
[time]
column = "stamp"
unit = "ms"
[velocity]
columns = ["vx", "vy", "vz"]
unit = "cm/s"
frame = "enu"
[attitude]
columns = ["qx", "qy", "qz", "qw"]
order = "xyzw"
world = "enu"
body = "flu"
[rates]
columns = ["p", "q", "r"]
unit = "deg/s"
frame = "flu"
[specific_force]
columns = ["ax", "ay", "az"]
unit = "g"
frame = "flu"
[motors]
columns = ["m1", "m2", "m3", "m4"]
zero = 1000
full = 2000
places = ["rear right", "front right", "rear left", "front left"]
[battery]
column = "volts"
unit = "mV"
"""


def test_a_foreign_csv_is_read_through_a_map_of_its_columns(tmp_path: Path, vehicle: Vehicle) -> None:
    """ROS conventions by hand: ENU north is y; level in ENU and FLU, nose east, is a heading of 90 degrees."""
    header = "stamp,vx,vy,vz,qx,qy,qz,qw,p,q,r,ax,ay,az,m1,m2,m3,m4,volts"
    row = "100,200,300,0,0,0,1,90,-45,30,0.1,0.2,1,1100,1200,1300,1400,15100"
    lines = [header] + [f"{10 * k},{row}" for k in range(20)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    (tmp_path / "map.toml").write_text(FOREIGN)
    got = flight(tmp_path / "a.csv", vehicle, tmp_path / "map.toml").signals
    np.testing.assert_allclose(got["vel_ned_mps"].t_s, 0.01 * np.arange(20))
    np.testing.assert_allclose(got["vel_ned_mps"].value[0], [2.0, 1.0, -3.0])
    np.testing.assert_allclose(np.abs(got["q_ned_frd"].value[0]), [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], atol=1e-12)
    assert got["q_ned_frd"].value[0, 0] * got["q_ned_frd"].value[0, 3] > 0.0
    np.testing.assert_allclose(got["rate_frd_radps"].value[0], np.radians([90.0, 45.0, -30.0]))
    np.testing.assert_allclose(got["accel_frd_mps2"].value[0], np.array([0.1, -0.2, -1.0]) * 9.80665)
    np.testing.assert_allclose(got["motor"].value[0], [0.2, 0.3, 0.4, 0.1])
    assert got["battery_v"].value[0] == pytest.approx(15.1)


def test_roll_pitch_and_yaw_are_an_attitude_too() -> None:
    from flightstack_logs.columns import apply

    text = 'schema = "flightstack.columns/1"\nattitude = { columns = ["a", "b", "c"], order = "rpy", unit = "deg" }'
    table = {"a": np.array([0.0, 90.0]), "b": np.array([0.0, 0.0]), "c": np.array([180.0, 0.0])}
    q = apply(parse_columns(text, "x"), table, "log")[0]["q_ned_frd"]
    np.testing.assert_allclose(q, [[0, 0, 0, 1], [np.sqrt(0.5), np.sqrt(0.5), 0, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "schema must be"),
        ("= 1", "not valid TOML"),
        ('schema = "flightstack.columns/1"', "names no column"),
        ('schema = "flightstack.columns/1"\n[wind]\ncolumns = ["a"]', "unknown section"),
        ('schema = "flightstack.columns/1"\n[velocity]\ncolumns = ["a"]', "names 1 columns; it takes 3"),
        ('schema = "flightstack.columns/1"\n[velocity]\ncolumns = ["a", "b", "c"]\nunit = "mph"', "unit = 'mph'"),
        ('schema = "flightstack.columns/1"\n[velocity]\ncolumns = ["a", "b", "c"]\nframe = "up"', "frame = 'up'"),
        ('schema = "flightstack.columns/1"\n[velocity]\ncolumns = ["a", "b", "c"]\nsign = 1', "unknown key sign"),
        ('schema = "flightstack.columns/1"\n[motors]\ncolumns = ["a", "b", "c", "d"]\nzero = 1', "the same"),
        ('schema = "flightstack.columns/1"\n[motors]\ncolumns = ["a", "b", "c", "d"]\nplaces = ["left"]', "places"),
        ('schema = "flightstack.columns/1"\nvelocity = 3', "must be a section"),
        ('schema = "flightstack.columns/1"\ntime = 3', "[time] needs"),
    ],
)
def test_a_wrong_map_is_an_error_that_names_the_key(text: str, says: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_columns(text, "map.toml")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["crazyflie", "gazebo_iris", "nanobench"])
def test_the_maps_that_come_with_the_program_can_be_named(name: str) -> None:
    assert column_map(name).entries


def test_rotors_are_put_where_the_vehicle_file_has_them(vehicle: Vehicle) -> None:
    """The Crazyflie counts clockwise from front right; PX4 goes front right, rear left, front left, rear right."""
    assert rotor_order(("front right", "rear right", "rear left", "front left"), vehicle) == [0, 2, 3, 1]


def crazyflie_log(version: int, rows: int = 300) -> bytes:
    """A Crazyflie log made by hand from the format's description."""
    head = (
        struct.pack("<BHH", 0xBC, version, 2) + struct.pack("<H", 0xFFFF) + b"fixedFrequency\0" + struct.pack("<H", 7)
    )
    for name in ("acc.x(f)", "acc.y(f)", "acc.z(f)", "motor.m1(I)", "motor.m2(H)", "motor.m3(I)", "motor.m4(B)"):
        head += name.encode() + b"\0"
    head += struct.pack("<H", 3) + b"activeMarkerModeChanged\0" + struct.pack("<H", 1) + b"mode(B)\0"
    body = b""
    for k in range(rows):
        time = struct.pack("<I", 10 * k) if version == 1 else struct.pack("<Q", 10_000 * k)
        body += struct.pack("<H", 0xFFFF) + time + struct.pack("<fffIHIB", 0.0, 0.5, 1.0, 65535, 13107, k, 7)
        if k % 100 == 50:
            body += struct.pack("<H", 3) + time + b"\x02"
    return head + body + struct.pack("<I", zlib.crc32(head + body))


@pytest.mark.parametrize("version", [1, 2])
def test_both_versions_of_a_crazyflie_log_are_read(tmp_path: Path, vehicle: Vehicle, version: int) -> None:
    (tmp_path / "log00").write_bytes(crazyflie_log(version))
    log = read(tmp_path / "log00")
    assert log.kind == "cfusdlog"
    assert log.complete
    assert log.tables["fixedFrequency"].t_us.tolist() == [10_000 * k for k in range(300)]
    assert log.tables["fixedFrequency"]["motor.m3"].tolist() == list(range(300))
    assert log.tables["activeMarkerModeChanged"]["mode"].tolist() == [2, 2, 2]
    got = flight(tmp_path / "log00", vehicle).signals
    np.testing.assert_allclose(got["accel_frd_mps2"].value[5], [0.0, -0.5 * 9.80665, -9.80665])
    np.testing.assert_allclose(got["motor"].value[131], [1.0, 131 / 65535, 7 / 65535, 0.2])


def test_a_cut_off_crazyflie_log_is_read_up_to_its_last_whole_record(tmp_path: Path) -> None:
    data = crazyflie_log(2)
    for size in (len(data) - 1, len(data) - 200, 400):
        (tmp_path / "log00").write_bytes(data[:size])
        log = read(tmp_path / "log00")
        assert not log.complete
        assert "cut off" in log.notes[0]
        assert 1 <= len(log.tables["fixedFrequency"]) <= 300


def test_own_logs_give_what_the_vehicle_measured_never_the_truth(tmp_path: Path, vehicle: Vehicle) -> None:
    import random

    rng = random.Random(0)
    with_log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    pwm = (1200, 1400, 1600, 900, *([900] * 12))
    for k in range(200):
        t_us = 4000 * k
        with_log.write("/truth", t_us, sample_record(TOPICS["/truth"], rng))
        with_log.write("/vehicle/attitude", t_us, (t_us, (1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3)))
        with_log.write("/vehicle/local_position", t_us, (t_us, (1.0, 2.0, -3.0), (4.0, 5.0, 6.0)))
        with_log.write("/vehicle/imu", t_us + 1000, (t_us, (0.5, 0.0, -9.5), (0.4, 0.5, 0.6)))
        with_log.write("/vehicle/motors", t_us, (t_us, pwm))
        with_log.write("/vehicle/battery", t_us, (16.25, 1.0, 90))
        with_log.write("/vehicle/status", t_us, ("OFFBOARD", True, k < 100))
    with_log.close()
    got = flight(tmp_path / "a.mcap", vehicle).signals
    assert got["rate_frd_radps"].source.startswith("/vehicle/imu")
    assert got["accel_frd_mps2"].source.endswith(FREED)
    for name, value in {
        "pos_ned_m": [1, 2, -3], "vel_ned_mps": [4, 5, 6], "q_ned_frd": [1, 0, 0, 0], "rate_frd_radps": [0.4, 0.5, 0.6],
        "accel_frd_mps2": [0.5, 0.0, -9.5], "motor": [0.2, 0.4, 0.6, 0.0],
    }.items():  # fmt: skip
        np.testing.assert_allclose(got[name].value[50], value, rtol=1e-6, err_msg=name)
        np.testing.assert_allclose(got[name].t_s[50], 0.2, atol=1e-9, err_msg=name)
    assert got["landed"].value[[50, 150]].tolist() == [1.0, 0.0]
    assert got["battery_v"].value[0] == pytest.approx(16.25)


@pytest.mark.parametrize(("raw_hz", "freed"), [(250, False), (5, True)])
def test_a_ulog_without_a_fast_raw_accelerometer_has_one_less_the_estimators_bias(
    vehicle: Vehicle, raw_hz: int, freed: bool
) -> None:
    def stamps(hz: int) -> np.ndarray:
        return np.arange(10 * hz, dtype=np.int64) * (1_000_000 // hz)

    raw, used = stamps(raw_hz), stamps(250)
    ones = {"gyro_rad": np.ones((len(raw), 3)), "accelerometer_m_s2": np.ones((len(raw), 3))}
    tables = {
        "sensor_combined": Table("sensor_combined", raw, ones, {}),
        "vehicle_acceleration": Table("vehicle_acceleration", used, {"xyz": np.ones((len(used), 3))}, {}),
    }
    log = Log(Path("a.ulg"), "ulog", True, (), tables, {}, {}, {}, (), 0)
    assert signals(log, vehicle)[0]["accel_frd_mps2"].source.endswith(FREED) == freed


@pytest.mark.parametrize("factor", [0.0, 0.3, 0.7, 1.0])
def test_thr_mdl_fac_is_undone_as_px4_undoes_it(factor: float) -> None:
    """The command u that comes out has the thrust factor u^2 + (1 - factor) u that was asked for."""
    thrust = np.linspace(0.0, 1.0, 101)
    u = linearised(thrust, factor)
    np.testing.assert_allclose(factor * u**2 + (1.0 - factor) * u, thrust, atol=1e-12)


BAD = {
    "a.csv": (b"a,b\n", "has a header and no rows"),
    "b.csv": (b"a,b\n1,2\n", "--columns"),
    "c.csv": (b"time_s,foo\n1,2\n2,3\n", "none of the columns of a flight"),
    "d.csv": (b"time_s,vel_n_mps,vel_e_mps,vel_d_mps\nx,1,2,3\ny,2,3,4\n", "time column holds no numbers"),
    "e.csv": (b"time_s,time_s\n1,2\n", "two columns named time_s"),
    "f.csv.gz": (b"\x1f\x8bnonsense of no use", "gzip"),
    "g.ulg": (b"ULog\x01\x12\x35" + bytes(40), "ULog"),
    "h": (b"\xbc\x07\x00\x01\x00", "version 7 is not known"),
    "i": (b"\xbc\x02\x00\x01\x00\xff\xff", "Crazyflie"),
    "j.csv": (b"", "is empty"),
    "k.png": (b"\x89PNG\r\n\x1a\n" + bytes(100), "no known kind"),
    "l.txt": (b"Hello world\n", "no known kind"),
    "README.md": (b"# A stack\n\nFlies, learns, tells.\n\n* one, two\n* 3 of them\n\nAnd more.\n", "no known kind"),
    "licence": (b"Permission, free of charge, to\nobtain, 2026, this,\nto deal, in it.\nThe end\n", "no known kind"),
    "m.csv": ((HEADER + ",motor_5,motor_6\n" + ",".join(["1"] * 24) + "\n").encode(), "6 motors"),
    "n.csv": ((HEADER.replace(",motor_4", "") + "\n" + ",".join(["1"] * 21) + "\n").encode(), "3 motors"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_flight_is_one_line_that_says_what_to_do(tmp_path: Path, vehicle: Vehicle, name: str) -> None:
    content, says = BAD[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        flight(tmp_path / name, vehicle)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_map_for_a_log_that_needs_none_or_that_is_not_there_is_an_error(tmp_path: Path, vehicle: Vehicle) -> None:
    with pytest.raises(InputError, match="can't be read"):
        flight(tmp_path / "a.csv", vehicle, tmp_path / "none.toml")
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    log.close()
    with pytest.raises(InputError, match="--columns is for CSV"):
        flight(tmp_path / "a.mcap", vehicle, "nanobench")


def test_attitudes_of_no_length_are_left_out(tmp_path: Path, vehicle: Vehicle) -> None:
    rows = [f"{0.01 * k:.2f},0,0,0,{0 if k < 50 else 1},0,0,0" for k in range(100)]
    (tmp_path / "a.csv").write_text("time_s,vel_n_mps,vel_e_mps,vel_d_mps,q_w,q_x,q_y,q_z\n" + "\n".join(rows) + "\n")
    read = flight(tmp_path / "a.csv", vehicle)
    assert len(read.signals["q_ned_frd"].t_s) == 50
    assert any("q_ned_frd: 50 of 100 rows" in note for note in read.notes)


@pytest.mark.parametrize(("back_rows", "refused"), [(3, False), (200, True)])
def test_a_csv_that_jumps_back_in_time_mixes_clocks(
    tmp_path: Path, vehicle: Vehicle, back_rows: int, refused: bool
) -> None:
    times = [0.01 * (k - (back_rows if k >= 300 else 0)) for k in range(600)]
    rows = "\n".join(f"{t:.2f},0,0,0" for t in times)
    (tmp_path / "a.csv").write_text(f"time_s,vel_n_mps,vel_e_mps,vel_d_mps\n{rows}\n")
    if refused:
        with pytest.raises(InputError, match="mixes clocks"):
            flight(tmp_path / "a.csv", vehicle)
    else:
        assert np.all(np.diff(flight(tmp_path / "a.csv", vehicle).signals["vel_ned_mps"].t_s) > 0.0)


@pytest.mark.parametrize("wrong_s", [0.0, 1e6])
def test_single_rows_with_a_wrong_time_are_left_out(tmp_path: Path, vehicle: Vehicle, wrong_s: float) -> None:
    """A buffer that was not filled yet, or a bit that fell over: the rows round it are one clock's."""
    times = [5.0 + 0.01 * k for k in range(600)]
    times[200] = times[411] = wrong_s
    rows = "\n".join(f"{t:.2f},{k},0,0" for k, t in enumerate(times))
    (tmp_path / "a.csv").write_text(f"time_s,vel_n_mps,vel_e_mps,vel_d_mps\n{rows}\n")
    read = flight(tmp_path / "a.csv", vehicle)
    assert read.signals["vel_ned_mps"].value[:, 0].tolist() == [k for k in range(600) if k not in (200, 411)]
    assert any("2 rows with a time far from both" in note for note in read.notes)


@pytest.mark.parametrize(
    ("before", "header", "cell"),
    [
        ("# flight 3\n#\n\n", "time_s,vel_n_mps,vel_e_mps,vel_d_mps", "{:.2f},1.5,-2.5,0"),
        ("# flight 3\n", "# time_s,vel_n_mps,vel_e_mps,vel_d_mps", "{:.2f},1.5,-2.5,0"),  # numpy.savetxt
        ("", "time_s;vel_n_mps;vel_e_mps;vel_d_mps", "{:.2f};1.5;-2.5;0"),
        ("\ufeff", "time_s;vel_n_mps;vel_e_mps;vel_d_mps", "{:.2f};1,5;-2,5;0"),  # decimal commas
    ],
)
def test_what_spreadsheets_and_numpy_write_is_read(
    tmp_path: Path, vehicle: Vehicle, before: str, header: str, cell: str
) -> None:
    lines = [cell.format(0.01 * k) for k in range(300)]
    lines = [line.replace(".", ",") if "1,5;" in cell else line for line in lines]
    for end in ("\n", "\r\n"):
        (tmp_path / "a.csv").write_bytes((before + "\n".join([header, *lines]) + "\n").replace("\n", end).encode())
        got = flight(tmp_path / "a.csv", vehicle).signals["vel_ned_mps"]
        assert got.t_s[-1] - got.t_s[0] == pytest.approx(2.99)
        np.testing.assert_allclose(got.value, np.tile([1.5, -2.5, 0.0], (300, 1)))


@pytest.mark.parametrize(
    "change", [str.upper, lambda name: name.removesuffix("_s"), str.title], ids=["capitals", "time", "title"]
)
def test_a_header_s_capitals_do_not_matter(tmp_path: Path, vehicle: Vehicle, change: Callable[[str], str]) -> None:
    path = write_csv(tmp_path / "a.csv", flown(vehicle, seconds=3.0))
    header, rows = path.read_text().split("\n", 1)
    (tmp_path / "b.csv").write_text(",".join(map(change, header.split(","))) + "\n" + rows)
    as_written, got = flight(path, vehicle), flight(tmp_path / "b.csv", vehicle)
    assert got.signals.keys() == as_written.signals.keys()
    for name, each in as_written.signals.items():
        assert np.array_equal(got.signals[name].value, each.value), name


def test_names_without_their_units_are_si_and_names_that_are_not_known_are_said(
    tmp_path: Path, vehicle: Vehicle
) -> None:
    path = write_csv(tmp_path / "a.csv", flown(vehicle, seconds=3.0))
    text = path.read_text()
    bare = text.replace("vel_n_mps", "vel_n").replace("vel_e_mps", "vel_e").replace("vel_d_mps", "vel_d")
    (tmp_path / "b.csv").write_text(bare.replace("accel_x_mps2", "acel_x_mps2"))
    got = flight(tmp_path / "b.csv", vehicle)
    assert np.array_equal(got.signals["vel_ned_mps"].value, flight(path, vehicle).signals["vel_ned_mps"].value)
    assert "accel_frd_mps2" not in got.signals
    assert "columns without a unit were taken for SI: vel_n, vel_e, vel_d" in got.notes
    assert "columns that are not known were not used: acel_x_mps2" in got.notes
    assert flight(path, vehicle).notes == ()


def test_a_strangers_header_is_told_back(tmp_path: Path, vehicle: Vehicle) -> None:
    (tmp_path / "a.csv").write_text("time,x,y,z,height,battery\n0.0,1,2,3,4,5\n0.1,1,2,3,4,5\n")
    with pytest.raises(
        InputError, match=r"other columns than time_s,pos_n_m,\.\.\.: time, x, y, z, height, battery; say"
    ):
        flight(tmp_path / "a.csv", vehicle)
