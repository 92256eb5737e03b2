"""Logs of other origin: packed by pymavlink, or read by pymavlink too; and what can be made of them."""

from __future__ import annotations

import csv
import io
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.DFReader import DFReader_binary
from pymavlink.dialects.v20 import ardupilotmega as dialect

from flightstack.cli import files
from flightstack.cli.main import main
from flightstack.types import InputError
from flightstack_logs.convert import convert
from flightstack_logs.export import export
from flightstack_logs.reader import read
from flightstack_logs.recover import recover
from flightstack_logs.standard import with_vehicle_topics
from flightstack_logs.tables import Log
from flightstack_logs.writer import FlightLog
from tests.flown import flown, write_csv
from tests.ulog_bytes import px4_flight

UTC_US = 1_767_225_600_000_000
SECONDS, HZ = 4.0, 50.0
ROLL = 0.3


def circle(t_s: float) -> tuple[list[float], list[float]]:
    """Position and velocity: a circle of 1 m, 2 m up, one turn in 2 pi s."""
    return [math.cos(t_s), math.sin(t_s), -2.0], [-math.sin(t_s), math.cos(t_s), 0.0]


def tlog(*, version1: bool = False) -> bytes:
    """A flight round a circle as a ground station records it, 10 ms late, with its own heartbeat in between."""
    vehicle = dialect.MAVLink(io.BytesIO(), srcSystem=3, srcComponent=1)
    station = dialect.MAVLink(io.BytesIO(), srcSystem=255, srcComponent=190)
    out = bytearray()
    for k in range(int(SECONDS * HZ)):
        t_s = k / HZ
        boot_ms = 100_000 + round(1e3 * t_s)
        place, speed = circle(t_s)
        said: list[tuple[Any, Any]] = [
            (vehicle, dialect.MAVLink_local_position_ned_message(boot_ms, *place, *speed)),
            (vehicle, dialect.MAVLink_attitude_message(boot_ms, ROLL, 0.0, 0.5, 0.1, 0.2, 0.3)),
            (vehicle, dialect.MAVLink_scaled_imu_message(boot_ms, 0, 0, -1000, 100, 200, 300, 0, 0, 0)),
            (vehicle, dialect.MAVLink_servo_output_raw_message(1000 * boot_ms, 0, 1500, 1500, 1500, 1500, 0, 0, 0, 0)),
        ]
        if k % int(HZ) == 0:
            said += [
                (vehicle, dialect.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3)),
                (vehicle, dialect.MAVLink_sys_status_message(0, 0, 0, 0, 15_900, 250, 80, 0, 0, 0, 0, 0, 0)),
                (station, dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)),
            ]
        if k == 30:
            said.append((vehicle, dialect.MAVLink_statustext_message(4, b"<b>EKF</b> yaw reset")))
            said.append((vehicle, dialect.MAVLink_param_value_message(b"MOT_SPIN_ARM", 0.125, 9, 10, 3)))
        for link, message in said:
            frame = message.pack(link, force_mavlink1=version1)
            out += (UTC_US + 10_000 + round(1e6 * t_s)).to_bytes(8, "big") + frame
    return bytes(out)


FORMATS = {
    "ATT": ("QccccCC", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
    "XKF1": ("QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH"),
    "IMU": ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "RCOU": ("QHHHH", "TimeUS,C1,C2,C3,C4"),
    "BAT": ("QBffB", "TimeUS,Instance,Volt,Curr,RemPct"),
    "MSG": ("QZ", "TimeUS,Message"),
    "PARM": ("QNff", "TimeUS,Name,Value,Default"),
}
_STRUCT = {"Q": "Q", "B": "B", "c": "h", "C": "H", "f": "f", "e": "i", "H": "H", "Z": "64s", "N": "16s"}


def dataflash(*, filtered: bool = True) -> bytes:
    """The same circle as ArduPilot writes it; a second IMU and a second EKF beside the first."""
    out = bytearray()

    def describe(number: int, length: int, name: str, letters: str, columns: str) -> None:
        head = struct.pack("<BB4s16s64s", number, length, name.encode(), letters.encode(), columns.encode())
        out.extend(b"\xa3\x95\x80" + head)

    describe(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    numbers = {name: 130 + k for k, name in enumerate(FORMATS)}
    layouts = {name: "<" + "".join(_STRUCT[letter] for letter in letters) for name, (letters, _) in FORMATS.items()}
    for name, (letters, columns) in FORMATS.items():
        describe(numbers[name], 3 + struct.calcsize(layouts[name]), name, letters, columns)

    def put(name: str, *values: Any) -> None:
        out.extend(b"\xa3\x95" + bytes([numbers[name]]) + struct.pack(layouts[name], *values))

    put("PARM", 1_000_000, b"MOT_SPIN_ARM", 0.125, 0.1)
    put("MSG", 1_000_000, b"ArduCopter V4.5 <script>")
    for k in range(int(SECONDS * HZ)):
        t_us, (place, speed) = 1_000_000 + round(1e6 * k / HZ), circle(k / HZ)
        if not filtered:
            place, speed = np.full(3, -0.0), np.zeros(3)
        put("ATT", t_us, 0, round(100 * math.degrees(ROLL)), 0, 0, 0, round(100 * math.degrees(0.5)))
        for core in (0, 1):
            put("XKF1", t_us, core, 0, 0, 0, *speed, 0.0, *[part + core * filtered for part in place], 0, 0, 0, 0)
            put("IMU", t_us, core, 0.1, 0.2, 0.3, 0.0, 0.0, -9.80665)
        put("RCOU", t_us, 1500, 1500, 1500, 1500)
        if k % int(HZ) == 0:
            put("BAT", t_us, 0, 15.9, 2.5, 80)
    return bytes(out)


def ulog() -> bytes:
    log = flown(files.load_vehicle("quad-x")[0], seconds=4.0, hz=50.0, seed=2)
    names = {"q": "q_ned_frd", "gyro": "rate_frd_radps", "accel": "accel_frd_mps2", "pos": "pos_ned_m",
             "vel": "vel_ned_mps", "control": "motor"}  # fmt: skip
    values = {key: log.signals[name].value for key, name in names.items()}
    return px4_flight(values, 1e6 + 1e6 * log.signals["motor"].t_s, {"THR_MDL_FAC": 0.3})


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One file of each kind; the name of one is meant to be shown in a page."""
    folder = tmp_path_factory.mktemp("logs")
    made = {"tlog": folder / "<i>a.tlog", "dataflash": folder / "a.BIN", "ulog": folder / "a.ulg"}
    made["tlog"].write_bytes(tlog())
    made["dataflash"].write_bytes(dataflash())
    made["ulog"].write_bytes(ulog())
    made["csv"] = write_csv(folder / "a.csv", flown(files.load_vehicle("quad-x")[0], seconds=4.0, hz=50.0, seed=2))
    return made


# ---------------------------------------------------------------- telemetry logs


@pytest.mark.parametrize("version1", [False, True])
def test_a_telemetry_log_gives_every_field_as_it_was_packed(tmp_path: Path, version1: bool) -> None:
    path = tmp_path / "a.tlog"
    path.write_bytes(tlog(version1=version1))
    log = read(path)
    assert (log.kind, log.complete, log.notes) == ("tlog", True, ())
    table = log.tables["LOCAL_POSITION_NED"]
    times = np.arange(int(SECONDS * HZ)) / HZ
    assert table.t_us.tolist() == np.round(1e6 * times).astype(int).tolist()
    assert table["time_boot_ms"].tolist() == (100_000 + np.round(1e3 * times)).astype(int).tolist()
    assert table["x"] == pytest.approx(np.cos(times), abs=1e-6)
    assert table.units["vx"] == "m/s"
    assert log.metadata["vehicle"] == {"system": "3", "component": "1"}
    assert log.metadata["clock"]["utc_start"].startswith("2026-01-01T00:00:00")
    assert log.metadata["parameters"] == {"MOT_SPIN_ARM": "0.125"}
    assert log.tables["HEARTBEAT"]["autopilot"].tolist() == [3] * 4
    assert log.tables["HEARTBEAT@255.190"]["autopilot"].tolist() == [8] * 4
    assert log.tables["STATUSTEXT"]["text"].tolist() == ["<b>EKF</b> yaw reset"]


def test_a_frame_of_an_unknown_kind_is_told_and_a_damaged_one_is_left_out(tmp_path: Path) -> None:
    data = tlog()
    stamp = UTC_US.to_bytes(8, "big")
    foreign = stamp + bytes([0xFD, 3, 0, 0, 0, 3, 1]) + (16_000_000).to_bytes(3, "little") + b"abc" + b"\0\0"
    flipped = bytearray(data)
    flipped[8 + 12] ^= 0x40  # in the first payload
    path = tmp_path / "a.tlog"
    path.write_bytes(bytes(flipped) + foreign + data[: len(data) // 2 + 5])
    log = read(path)
    whole = int(SECONDS * HZ)
    assert 1.4 * whole < len(log.tables["LOCAL_POSITION_NED"]) < 1.5 * whole
    assert not log.complete
    assert any("1 messages of a kind that is not known" in note for note in log.notes)
    assert any("bytes are no whole message" in note for note in log.notes)


def test_the_recorded_telemetry_log_of_a_px4_holds_what_its_frames_hold(recorded: Path) -> None:
    from tlog import recording

    from mavlink_bridge import messages as m

    log = read(recorded / "px4_sih_offboard.tlog")
    heard = [one.message for one in recording(recorded / "px4_sih_offboard.tlog") if one.system == 1]
    places = [message for message in heard if isinstance(message, m.LocalPositionNed)]
    table = log.tables["LOCAL_POSITION_NED"]
    assert len(table) == len(places) > 10_000
    assert table["x"].tolist() == [message.pos_ned_m[0] for message in places]
    assert log.metadata["parameters"]["SYS_AUTOSTART"] == "10040"  # an integer, sent as its bits


# ---------------------------------------------------------------- DataFlash


def test_a_dataflash_log_gives_what_pymavlinks_own_reader_gives(logs: dict[str, Path]) -> None:
    log = read(logs["dataflash"])
    assert (log.kind, log.complete) == ("dataflash", True)
    reader = DFReader_binary(str(logs["dataflash"]))
    rows: dict[str, list[Any]] = {}
    while (message := reader.recv_msg()) is not None:
        rows.setdefault(message.get_type(), []).append(message.to_dict())
    reader.data_map.close()
    reader.filehandle.close()
    for name in ("ATT", "RCOU", "BAT"):
        table = log.tables[name]
        for column in table.columns:
            assert table[column].tolist() == pytest.approx([row[column] for row in rows[name]]), (name, column)
    second = log.tables["XKF1_1"]
    assert second["PN"].tolist() == pytest.approx([row["PN"] for row in rows["XKF1"] if row["C"] == 1])
    assert log.metadata["parameters"] == {"MOT_SPIN_ARM": "0.125"}


# ---------------------------------------------------------------- under our topics


def test_arducopters_old_names_of_outputs_are_known_and_a_filter_that_never_ran_gives_no_position(
    tmp_path: Path,
) -> None:
    """ArduCopter before 3.4 calls them Ch1, Ch2, ...; a filter without a position logs zeros."""
    path, columns = tmp_path / "a.BIN", FORMATS["RCOU"][1].encode()
    path.write_bytes(dataflash().replace(columns.ljust(64, b"\0"), columns.replace(b"C", b"Ch").ljust(64, b"\0")))
    log = with_vehicle_topics(read(path))
    assert np.all(log.tables["/vehicle/motors"]["pwm_us"][:, :4] == 1500)
    (rest := tmp_path / "rest.BIN").write_bytes(dataflash(filtered=False))
    idle = with_vehicle_topics(read(rest))
    assert "/vehicle/local_position" not in idle.tables
    assert "/vehicle/attitude" in idle.tables


def test_a_signalling_nan_and_outputs_that_are_no_whole_numbers_are_read_without_a_warning(tmp_path: Path) -> None:
    """Bytes of a damaged log, or one that describes its outputs as floats; pytest takes a warning for an error."""
    whole, signalling = dataflash(), struct.pack("<I", 0x7F800001)
    broken = whole.replace(struct.pack("<f", 0.1), signalling).replace(struct.pack("<f", 15.9), signalling)
    letters, columns = (text.encode() for text in FORMATS["RCOU"])
    as_halves = letters.replace(b"H", b"g").ljust(16, b"\0") + columns.ljust(64, b"\0")
    broken = broken.replace(letters.ljust(16, b"\0") + columns.ljust(64, b"\0"), as_halves)
    broken = broken.replace(struct.pack("<4H", *4 * (1500,)), struct.pack("<4e", np.nan, np.inf, -np.inf, 1500.0))
    (path := tmp_path / "a.BIN").write_bytes(broken)
    log = with_vehicle_topics(read(path))
    assert np.all(log.tables["/vehicle/motors"]["pwm_us"][:, :4] == [0, 0, 0, 1500])
    assert np.all(np.isnan(log.tables["/vehicle/battery"]["voltage_v"]))


@pytest.mark.parametrize("kind", ["tlog", "dataflash"])
def test_the_circle_is_the_same_under_our_topics_whoever_recorded_it(logs: dict[str, Path], kind: str) -> None:
    log = with_vehicle_topics(read(logs[kind]))
    position, attitude, imu = (log.tables[f"/vehicle/{name}"] for name in ("local_position", "attitude", "imu"))
    t_s = 1e-6 * position["t_boot_us"]
    assert t_s[0] == pytest.approx(0.0, abs=0.011)
    assert position["pos_ned_m"] == pytest.approx(np.array([circle(t - t_s[0])[0] for t in t_s]), abs=1e-5)
    half = math.cos(0.5 * ROLL), math.sin(0.5 * ROLL)
    expected = [half[0] * math.cos(0.25), half[1] * math.cos(0.25), half[1] * math.sin(0.25), half[0] * math.sin(0.25)]
    assert attitude["q_ned_frd"] == pytest.approx(np.tile(expected, (len(attitude), 1)), abs=1e-4)
    assert imu["accel_frd_mps2"][5] == pytest.approx([0.0, 0.0, -9.80665], abs=1e-5)
    assert imu["rate_frd_radps"][5] == pytest.approx([0.1, 0.2, 0.3], abs=1e-5)
    assert log.tables["/vehicle/motors"]["pwm_us"][3].tolist() == [1500] * 4 + [0] * 12
    assert log.tables["/vehicle/battery"]["voltage_v"][0] == pytest.approx(15.9, abs=1e-5)
    assert log.tables["/vehicle/battery"]["remaining"][0] == 80


@pytest.mark.parametrize("kind", ["tlog", "dataflash", "ulog", "csv"])
def test_what_is_converted_reads_back_row_for_row(logs: dict[str, Path], kind: str, tmp_path: Path) -> None:
    source = with_vehicle_topics(read(logs[kind]))
    made = convert(read(logs[kind]), tmp_path / "a.mcap")
    back = read(tmp_path / "a.mcap")
    assert back.complete
    assert back.span_us[0] == 0
    assert made.topics == len(source.tables)
    assert "/pose" in back.messages
    for name, table in source.tables.items():
        same = back.tables[name if name.startswith("/vehicle/") else f"/{kind}/{name}"]
        assert same.t_us.tolist() == table.t_us.tolist()
        for column, values, copy in zip(table.columns, table.columns.values(), same.columns.values(), strict=True):
            single = values.dtype.kind == "f" and name.startswith("/vehicle/")
            np.testing.assert_allclose(copy, values, rtol=1e-6) if single else np.testing.assert_array_equal(
                copy, values, err_msg=column
            )
    with pytest.raises(InputError, match="exists already"):
        convert(read(logs[kind]), tmp_path / "a.mcap")
    with pytest.raises(InputError, match="is an MCAP already"):
        convert(back, tmp_path / "b.mcap")


# ---------------------------------------------------------------- CSV, Parquet, frames


def vehicle_log(path: Path) -> Log:
    convert(read_tlog_bytes(path.with_suffix(".tlog")), path)
    return read(path)


def read_tlog_bytes(path: Path) -> Log:
    path.write_bytes(tlog())
    return read(path)


def test_exported_files_hold_the_tables_and_only_what_was_chosen(tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    log = vehicle_log(tmp_path / "a.mcap")
    made = export(log, tmp_path / "csv", "csv", ["/vehicle/*"], ["pos_*", "voltage_v"])
    assert [path.name for path in made] == ["vehicle_local_position.csv", "vehicle_battery.csv"]
    with made[0].open() as file:
        header, *rows = csv.reader(file)
    table = log.tables["/vehicle/local_position"]
    assert header == ["t_s", "pos_ned_m_0", "pos_ned_m_1", "pos_ned_m_2"]
    assert [float(row[0]) for row in rows] == (table.t_us / 1e6).tolist()
    assert [[float(part) for part in row[1:]] for row in rows] == table["pos_ned_m"].tolist()
    (parquet,) = export(log, tmp_path / "parquet", "parquet", ["/vehicle/local_position"])
    back = pq.read_table(parquet)
    assert back["pos_ned_m"].to_pylist() == table["pos_ned_m"].tolist()
    assert back.schema.field("pos_ned_m").metadata == {b"unit": b"m"}
    for chosen in (["/nothing"], ["/vehicle/*"]):
        with pytest.raises(InputError, match="has no such topic and column"):
            export(log, tmp_path / "none", "csv", chosen, ["nothing"])


def test_a_table_as_a_frame_of_pandas_and_polars(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    pytest.importorskip("polars")
    table = vehicle_log(tmp_path / "a.mcap").tables["/vehicle/local_position"]
    frame, other = table.to_pandas(), table.to_polars()
    assert frame.index.name == other.columns[0] == "t_s"
    assert frame["pos_ned_m_1"].tolist() == other["pos_ned_m_1"].to_list() == table["pos_ned_m"][:, 1].tolist()
    assert frame.index.tolist() == other["t_s"].to_list()


# ---------------------------------------------------------------- mending


def long_log(path: Path) -> list[int]:
    """Ten seconds in many chunks; the numbers that it holds."""
    log = FlightLog.open(path, metadata={"run": {"seed": "7"}})
    for k in range(2500):
        log.write("/vehicle/imu", 4000 * k, (k, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3)))
        log.event(4000 * k, "tick", f"<b>{k}</b>") if k % 100 == 0 else None
    log.close()
    return list(range(2500))


def numbers(path: Path) -> list[int]:
    found: list[int] = read(path).tables["/vehicle/imu"]["t_us"].tolist()
    return found


def test_a_whole_log_recovered_is_the_same_and_nothing_was_lost(tmp_path: Path) -> None:
    written = long_log(tmp_path / "a.mcap")
    saved = recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert (saved.messages, saved.lost) == (2525, ())
    assert numbers(tmp_path / "b.mcap") == written
    back = read(tmp_path / "b.mcap")
    assert back.complete
    assert back.metadata["run"] == {"seed": "7"}
    assert len(back.tables["/events"]) == 25


@pytest.mark.parametrize("share", [0.05, 0.3, 0.7, 0.99])
def test_a_cut_log_is_mended_up_to_its_last_chunk(tmp_path: Path, share: float) -> None:
    long_log(tmp_path / "a.mcap")
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: int(share * len(data))])
    saved = recover(tmp_path / "cut.mcap", tmp_path / "b.mcap")
    assert any("cut off" in line for line in saved.lost)
    kept = numbers(tmp_path / "b.mcap")
    assert kept == list(range(len(kept)))
    assert len(kept) > 2500 * (share - 0.15)
    assert read(tmp_path / "b.mcap").complete


def test_damage_in_the_middle_loses_that_chunk_and_says_from_when_to_when(tmp_path: Path) -> None:
    long_log(tmp_path / "a.mcap")
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    middle = data.find(b"\x03\x00\x00\x00lz4", len(data) // 2)
    for at, lost in ((middle + 40, "checksum"), (middle - 30, "no record")):  # in its data; in its size
        broken = bytearray(data)
        broken[at] ^= 0xFF
        (tmp_path / "broken.mcap").write_bytes(bytes(broken))
        out = tmp_path / f"{at}.mcap"
        saved = recover(tmp_path / "broken.mcap", out)
        assert any("damaged" in line for line in saved.lost), lost
        kept = numbers(out)
        assert 2300 < len(kept) < 2500
        assert (kept[0], kept[-1]) == (0, 2499)
        assert kept == sorted(set(kept))


def test_the_first_chunk_lost_leaves_the_others_readable(tmp_path: Path) -> None:
    """The first chunk describes the topics; a finished file tells them once more at its end."""
    long_log(tmp_path / "a.mcap")
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    data[data.find(b"\x03\x00\x00\x00lz4") + 30] ^= 0xFF
    (tmp_path / "broken.mcap").write_bytes(bytes(data))
    saved = recover(tmp_path / "broken.mcap", tmp_path / "b.mcap")
    assert any("what was logged from 0.00 s to " in line for line in saved.lost)
    assert len(numbers(tmp_path / "b.mcap")) > 2300


# ---------------------------------------------------------------- the verbs, and bad input


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    return int(stop.value.code or 0)


@pytest.mark.parametrize("kind", ["tlog", "dataflash", "ulog", "csv"])
def test_every_verb_takes_every_kind(
    logs: dict[str, Path], kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("log", "info", logs[kind]) == 0
    assert run("log", "report", logs[kind], "--out", tmp_path / "page") == 0
    page = (tmp_path / "page" / "report.html").read_text()
    assert "</html>" in page
    assert '<canvas id="path3d"' in page
    assert "<b>EKF" not in page
    assert "<script>\\" not in page
    assert run("log", "convert", logs[kind], "--out", tmp_path / "a.mcap") == 0
    assert run("log", "report", tmp_path / "a.mcap", "--out", tmp_path / "again") == 0
    assert run("log", "export", tmp_path / "a.mcap", "--out", tmp_path / "tables", "--topic", "/vehicle/*") == 0
    assert (tmp_path / "tables" / "vehicle_attitude.csv").is_file()
    assert run("log", "recover", tmp_path / "a.mcap", "--out", tmp_path / "b.mcap") == 0
    said = capsys.readouterr()
    assert "nothing was lost" in said.out
    assert said.err == ""


BAD = {
    "empty": b"",
    "foreign": bytes(range(256)) * 40,
    "text": b"dear diary\n" * 100,
    "mcap-begun": b"\x89MCAP0\r\n",
    "ulog-begun": b"ULog\x01\x12\x35\x01" + bytes(8),
    "tlog-cut": tlog()[:17],
    "bin-cut": dataflash()[:100],
    "gzip-cut": b"\x1f\x8b\x08\x00",
}


@pytest.mark.parametrize("verb", ["info", "report", "convert", "export", "recover"])
@pytest.mark.parametrize("name", [*BAD, "missing", "folder", "huge"])
def test_bad_logs_are_one_line_and_exit_code_2(
    verb: str, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"{name}.log"
    if name == "folder":
        path.mkdir()
    elif name == "huge":
        with path.open("wb") as file:
            file.truncate(9 << 30)  # sparse
    elif name != "missing":
        path.write_bytes(BAD[name])
    out = [] if verb == "info" else ["--out", tmp_path / "out.mcap"]
    code = run("log", verb, path, *out)
    said = capsys.readouterr()
    if (verb, name) != ("info", "mcap-begun"):
        assert code == 2, said
        assert said.err.startswith("error: ")
        assert said.err.count("\n") == 1
    assert not list(tmp_path.glob("*.part")) + list(tmp_path.glob(".*.part"))


@pytest.mark.parametrize("verb", ["convert", "export", "recover", "report"])
def test_a_full_disk_is_one_line_and_leaves_nothing_half_written(
    logs: dict[str, Path], verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    resource = pytest.importorskip("resource")
    convert(read(logs["tlog"]), tmp_path / "a.mcap")
    source = logs["tlog"] if verb == "convert" else tmp_path / "a.mcap"
    before = source.read_bytes()
    kept = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, kept[1]))
    try:
        code = run("log", verb, source, "--out", tmp_path / "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, kept)
    said = capsys.readouterr()
    assert code == 2
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    assert source.read_bytes() == before
    assert not [path for path in tmp_path.rglob("*") if path.name.endswith(".part")]


@pytest.mark.parametrize("name", FORMATS)
def test_a_dataflash_log_that_describes_its_columns_otherwise_is_read_without_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Each column once under a name that nobody knows, and once as a text of the same length in bytes."""
    letters, columns = FORMATS[name]
    path = tmp_path / "a.BIN"
    for k, column in enumerate(columns.split(",")):
        for written in (columns.split(","), [*columns.split(",")[:k], "Q" * len(column), *columns.split(",")[k + 1 :]]):
            as_text = written[k] == column
            if as_text and struct.calcsize("<" + _STRUCT[letters[k]]) != 4:
                continue
            broken = dataflash().replace(columns.encode().ljust(64, b"\0"), ",".join(written).encode().ljust(64, b"\0"))
            if as_text:
                broken = broken.replace(
                    letters.encode().ljust(16, b"\0"), (letters[:k] + "n" + letters[k + 1 :]).encode().ljust(16, b"\0")
                )
            path.write_bytes(broken)
            log = with_vehicle_topics(read(path))
            assert log.tables
            if as_text and name in log.tables and column in log.tables[name].columns:
                assert log.tables[name].columns[column].dtype.kind == "U"


@pytest.mark.parametrize("kind", ["tlog", "dataflash"])
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_bytes_make_reading_raise_anything_but_a_refusal(tmp_path: Path, kind: str, data: st.DataObject) -> None:
    whole = tlog() if kind == "tlog" else dataflash()
    end = data.draw(st.integers(0, len(whole)))
    broken = bytearray(whole[: max(end, 40)])
    for at in data.draw(st.lists(st.integers(0, len(broken) - 1), max_size=20)):
        broken[at] = data.draw(st.integers(0, 255))
    path = tmp_path / "a.log"
    path.write_bytes(bytes(broken))
    try:
        log = with_vehicle_topics(read(path))
    except InputError:
        return
    for table in log.tables.values():
        assert np.all(np.diff(table.t_us) >= 0)
