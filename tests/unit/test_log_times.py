"""The time line of logs of other origin: where it begins and ends, and that every message is on it."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.DFReader import DFReader_binary
from pyulog import ULog

from flightstack_logs.info import info, parameters
from flightstack_logs.reader import read
from flightstack_logs.standard import with_vehicle_topics
from tests.ulog_bytes import ulog

BEGINS_US, SECONDS = 112_500_000, 6.0
ONE = {"value": ("f", 1)}


def stamped(*stamps_us: int) -> tuple[dict[str, tuple[str, int]], np.ndarray]:
    return ONE, np.array([[t_us, k] for k, t_us in enumerate(stamps_us)], float)


def px4_log() -> bytes:
    """As PX4 begins a log in the middle of a boot: with what was published before, and with what never had a time."""
    moving = np.arange(BEGINS_US + 4_000, BEGINS_US + int(1e6 * SECONDS), 4_000)
    topics = {
        "sensor_combined": stamped(*moving.tolist()),
        "vehicle_status": stamped(BEGINS_US - 300_000, BEGINS_US + 200_000, BEGINS_US + 700_000),
        "commander_state": stamped(*[2_069_758] * 5),
        "ekf2_innovations": stamped(*[0] * 7),
        "mission": stamped(1_194_367_328),  # of the boot before
    }
    lines = [(BEGINS_US - 1_000, 6, "[logger] log started"), (BEGINS_US + 2_000_000, 4, "[commander] Failsafe <b>")]
    return ulog(topics, {}, begins_us=BEGINS_US, lines=lines)


def test_a_ulog_begins_when_its_header_says_and_keeps_every_row(tmp_path: Path) -> None:
    (path := tmp_path / "a.ulg").write_bytes(px4_log())
    peer = ULog(str(path))
    log = read(path)
    assert log.span_us == (peer.start_timestamp, BEGINS_US + int(1e6 * SECONDS) - 4_000)
    for topic in peer.data_list:
        assert log.tables[topic.name]["value"].tolist() == topic.data["value"].tolist(), topic.name
    held = ("commander_state", "ekf2_innovations", "mission")
    assert all(np.all(log.tables[name].t_us == BEGINS_US) for name in held)
    assert log.tables["vehicle_status"].t_us.tolist() == [BEGINS_US, BEGINS_US + 200_000, BEGINS_US + 700_000]
    assert info(log).duration_s == pytest.approx(SECONDS - 0.004)


def test_a_header_whose_time_is_damaged_moves_no_row(tmp_path: Path) -> None:
    whole = px4_log()
    (path := tmp_path / "a.ulg").write_bytes(whole[:8] + struct.pack("<Q", 1 << 60) + whole[16:])
    moving = read(path).tables["sensor_combined"]
    assert (moving.t_us[0], len(np.unique(moving.t_us))) == (BEGINS_US + 4_000, len(moving))


def test_what_px4_printed_is_among_the_events(tmp_path: Path) -> None:
    (path := tmp_path / "a.ulg").write_bytes(px4_log())
    said = [(event.t_s, event.level, event.text) for event in info(read(path)).events]
    assert said == [(0.0, "info", "[logger] log started"), (2.0, "warning", "[commander] Failsafe <b>")]


def test_a_recorded_px4_log_lasts_as_long_as_its_own_header_says(recorded: Path) -> None:
    """Flight Review and ulog_info say 68 s; three of its topics bear stamps of long before."""
    path = recorded / "px4_real_bench_NOTFLYING_68s.ulg"
    peer, log = ULog(str(path)), read(path)
    lasted_s = 1e-6 * (peer.last_timestamp - peer.start_timestamp)
    assert info(log).duration_s == pytest.approx(lasted_s, abs=1e-6)
    assert lasted_s == pytest.approx(69.0, abs=0.1)
    assert {topic.name: len(topic.data["timestamp"]) for topic in peer.data_list if topic.multi_id == 0} == {
        name: len(log.tables[name]) for name in (topic.name for topic in peer.data_list if topic.multi_id == 0)
    }


OLD = {
    "PARM": (129, "Nf", "Name,Value"),
    "MODE": (130, "Mh", "Mode,ThrCrs"),
    "ATT": (131, "Icc", "TimeMS,Roll,Pitch"),
    "GPS": (132, "BIHBcLLeeEefI", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T"),
}
_STRUCT = {
    "N": "16s",
    "f": "f",
    "M": "B",
    "h": "h",
    "I": "I",
    "c": "h",
    "B": "B",
    "H": "H",
    "L": "i",
    "e": "i",
    "E": "I",
}


def old_dataflash() -> bytes:
    """As ArduCopter 3.2 of 2014 wrote it: the GPS' own time beside the board's, and messages without any."""
    out = bytearray()
    layouts = {name: "<" + "".join(_STRUCT[letter] for letter in letters) for name, (_, letters, _) in OLD.items()}
    rows = [(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    rows += [(n, 3 + struct.calcsize(layouts[name]), name, *rest) for name, (n, *rest) in OLD.items()]
    for number, length, name, letters, columns in rows:
        said = (number, length, name.encode(), letters.encode(), columns.encode())
        out += b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *said)

    def put(name: str, *values: Any) -> None:
        out.extend(b"\xa3\x95" + bytes([OLD[name][0]]) + struct.pack(layouts[name], *values))

    put("PARM", b"MOT_SPIN_ARM", 0.125)
    for k in range(100):
        put("ATT", 312_990 + 100 * k, 100, 200)
        if k % 2 == 0:
            put("GPS", 3, 3_880_600 + 100 * k, 1815, 9, 130, 10, 20, 300, 400, 50, 60, 0.5, 312_991 + 100 * k)
        if k == 50:
            put("MODE", 5, 400)
    return bytes(out)


def test_the_boards_time_counts_where_a_gps_has_its_own_and_what_has_none_is_kept(tmp_path: Path) -> None:
    (path := tmp_path / "a.BIN").write_bytes(old_dataflash())
    log = read(path)
    assert log.span_us == (312_990_000, 312_990_000 + 9_900_000)
    assert log.tables["GPS"].t_us.tolist() == [312_991_000 + 100_000 * k for k in range(0, 100, 2)]
    assert log.tables["GPS"]["TimeMS"][0] == 3_880_600
    assert (log.tables["MODE"].t_us.tolist(), log.tables["MODE"]["ThrCrs"].tolist()) == ([317_991_000], [400])
    assert log.metadata["parameters"] == {"MOT_SPIN_ARM": "0.125"}
    reader, counts = DFReader_binary(str(path)), dict.fromkeys(OLD, 0)
    while (message := reader.recv_msg()) is not None:
        if message.get_type() in counts:
            counts[message.get_type()] += 1
    reader.data_map.close()
    reader.filehandle.close()
    assert counts == {name: len(log.tables[name]) for name in OLD}
    assert with_vehicle_topics(log).span_us == (0, 9_900_000)


def test_a_log_without_any_time_is_a_log_without_data(tmp_path: Path) -> None:
    whole = old_dataflash()
    begins = whole.index(b"\xa3\x95\x81")
    (path := tmp_path / "a.BIN").write_bytes(whole[: begins + 23])
    with pytest.raises(ValueError, match="without data"):
        read(path)


def test_parameters_are_shown_as_they_are_on_board(tmp_path: Path) -> None:
    """PX4 and ArduPilot keep them in single precision, where 0.05 is 0.0500000007..."""
    path = tmp_path / "a.ulg"
    path.write_bytes(ulog({"sensor_combined": stamped(1_000, 5_000)}, {"BAT_LOW_THR": 0.05, "MPC_XY_CRUISE": 5.0}))
    log = read(path)
    assert parameters(log) == [("BAT_LOW_THR", "0.05"), ("MPC_XY_CRUISE", "5")]
    assert float(log.metadata["parameters"]["BAT_LOW_THR"]) == float(np.float32(0.05))


def test_a_log_that_never_says_whether_it_landed_has_while_disarmed(tmp_path: Path) -> None:
    rows = np.array([[1e6, 0, 1], [2e6, 0, 2], [3e6, 0, 1]])
    (path := tmp_path / "a.ulg").write_bytes(
        ulog({"vehicle_status": ({"nav_state": ("B", 1), "arming_state": ("B", 1)}, rows)}, {})
    )
    status = with_vehicle_topics(read(path)).tables["/vehicle/status"]
    assert status["armed"].tolist() == [False, True, False]
    assert status["landed"].tolist() == [True, False, True]
