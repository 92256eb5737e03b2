"""Records whose numbers lie in one row: what the log makes of them."""

from __future__ import annotations

import random
import zlib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from log_samples import proto_class, sample_record, tick_record
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from flightstack.types import FlatOutput, changed
from flightstack_logs import rows
from flightstack_logs.convert import convert
from flightstack_logs.info import info
from flightstack_logs.mcap_file import scan
from flightstack_logs.reader import read
from flightstack_logs.recover import recover
from flightstack_logs.topics import MESSAGE, TOPICS, Kind
from flightstack_logs.writer import FlightLog


def test_every_named_part_of_a_tick_reads_back_from_compressed_chunks(tmp_path: Path) -> None:
    record = tick_record(8000)
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    log.tick(record)
    log.close()
    with (tmp_path / "a.mcap").open("rb") as file:
        chunks = [part for part in StreamReader(file, emit_chunks=True).records if isinstance(part, Chunk)]
    assert {chunk.compression for chunk in chunks} == {"lz4"}
    tables = read(tmp_path / "a.mcap").tables
    for topic, source, names in (
        ("/tick", record.measurement, "pos_ned_m vel_ned_mps q_ned_frd rate_frd_radps motor_command imu_age_us"),
        ("/control", record.proposal, "thrust_ff_n thrust_fb_n rate_ff_frd_radps rate_fb_frd_radps attitude_error_rad"),
        ("/control", record.proposal, "nominal_acc_ned_mps2 nominal_jerk_ned_mps3"),
        ("/learner", record.learned, "acc_ned_mps2 thrust_gain residual_frd_mps2 sigma_frd_mps2 target_frd_mps2 fed"),
        ("/setpoint", record.reference, "pos_ned_m vel_ned_mps acc_ned_mps2 jerk_ned_mps3 snap_ned_mps4 yaw_rad"),
    ):
        for name in names.split():
            told = np.asarray(getattr(source, name))
            wanted = told if topic == "/tick" else told if name == "pos_ned_m" else told.astype(np.float32)
            np.testing.assert_array_equal(tables[topic][name][0], wanted, err_msg=name)


def test_a_row_of_the_wrong_length_is_refused_and_the_next_one_is_written(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    good = tick_record(4000).reference
    for reference in (good, FlatOutput(good.row[:9]), good):
        log.write("/setpoint", 4000, reference)
    log.close()
    assert log.rejected == 1
    assert "/setpoint" in (log.failed or "")
    assert read(tmp_path / "a.mcap").tables["/setpoint"]["yaw_rad"].tolist() == [np.float32(0.1)] * 2


def test_a_changed_record_leaves_the_first_one_as_it_was() -> None:
    first = tick_record(4000).measurement
    before = first.row.copy()
    second = changed(first, vel_ned_mps=np.array([1.0, 2.0, 3.0]), imu_age_us=7)
    np.testing.assert_array_equal(first.row, before)
    assert second.vel_ned_mps.tolist() == [1.0, 2.0, 3.0]
    assert (second.imu_age_us, second.position_age_us, second.t_us) == (7, first.position_age_us, first.t_us)
    np.testing.assert_array_equal(second.row[6:], before[6:])


def test_blocks_give_back_every_row_in_the_order_written_whatever_its_size() -> None:
    rng = random.Random(1)
    written = [(k * 4000, rng.randbytes(rng.choice([5, 5, 5, 9]))) for k in range(200)]
    blocks, packed = rows.RowBlocks(), []
    for t_us, data in written:
        blocks.add("/x", t_us, data)
        if rng.random() < 0.1:
            packed += [block for _, block in blocks.take()]
    packed += [block for _, block in blocks.take()]
    found = rows.unpack(packed)
    assert [*zip(found.t_us.tolist(), found.messages, strict=True)] == written
    assert found.place.tolist() == list(range(200))


def test_a_block_is_what_its_module_says_it_is() -> None:
    """By hand: two rows of one byte of message, 0x10 at 256 us and 0x13 at 257 us, and Google's own parser."""
    blocks = rows.RowBlocks()
    blocks.add("/x", 256, b"\x10")
    blocks.add("/x", 257, b"\x13")
    ((_, block),) = blocks.take()
    message = proto_class(rows.schema(), rows.SCHEMA_NAME).FromString(block)
    by_hand = [(0, 1), (1, 0), *[(0, 0)] * 6, (0, 1), *[(0, 0)] * 3, (0x10, 3)]
    assert (message.size, message.data) == (13, bytes(byte for pair in by_hand for byte in pair))


@pytest.mark.parametrize("damage", [b"", b"\x0d\x01", b"\x0d\x0d\x00\x00\x00", b"\x0d\x02\x00\x00\x00\x12\x01\x00"])
def test_a_malformed_block_is_a_value_error(damage: bytes) -> None:
    with pytest.raises(ValueError, match=r"malformed|cut off"):
        rows.unpack([damage])


def test_a_compact_log_holds_every_message_of_every_topic(tmp_path: Path) -> None:
    """The same calls to a plain log and to a compact one read the same; the compact one has thinned copies beside."""
    tables, messages = [], []
    for compact in (False, True):
        rng = random.Random(5)
        log = FlightLog.open(tmp_path / f"{compact}.mcap", metadata={}, compact=compact)
        for k in range(400):
            for name, topic in TOPICS.items():
                log.write(name, k * 4000, sample_record(topic, rng))
        log.close()
        assert log.failed is None
        back = read(tmp_path / f"{compact}.mcap")
        assert back.notes == ()
        tables.append(back.tables)
        messages.append(back.messages)
    for name, table in tables[0].items():
        np.testing.assert_array_equal(table.t_us, tables[1][name].t_us)
        assert table.columns.keys() == tables[1][name].columns.keys()
        for column, values in table.columns.items():
            np.testing.assert_array_equal(values, tables[1][name][column], err_msg=f"{name} {column}")
    assert messages[0][MESSAGE].data == messages[1][MESSAGE].data
    with (tmp_path / "True.mcap").open("rb") as file:
        counts = Counter(channel.topic for _, channel, _ in make_reader(file).iter_messages())
    packed = [name for name, topic in TOPICS.items() if topic.packed and topic.kind is Kind.TABLE]
    assert {counts[name] for name in packed} == {8}  # of 400 in 1.6 s


def test_converted_a_compact_log_has_every_message_on_its_own(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={"run": {"seed": "7"}}, compact=True)
    rng, names = random.Random(6), [name for name, topic in TOPICS.items() if name != "/clock"]
    for k in range(100):
        for name in names:
            log.write(name, k * 4000, sample_record(TOPICS[name], rng))
    log.close()
    made = convert(read(tmp_path / "a.mcap"), tmp_path / "b.mcap")
    assert made.messages == 100 * len(names)
    with (tmp_path / "b.mcap").open("rb") as file:
        counts = Counter(channel.topic for _, channel, _ in make_reader(file).iter_messages())
    assert counts == dict.fromkeys(names, 100)
    back = [read(tmp_path / f"{name}.mcap") for name in "ab"]
    assert back[1].metadata["run"] == {"seed": "7"}
    for name, table in back[0].tables.items():
        for column, values in table.columns.items():
            np.testing.assert_array_equal(values, back[1].tables[name][column], err_msg=f"{name} {column}")


def test_a_cut_off_compact_log_is_mended_with_its_rows(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={}, compact=True)
    for k in range(500):
        log.tick(tick_record(k * 4000))
    log.flush()
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "a.mcap").read_bytes())
    log.close()
    saved = recover(tmp_path / "cut.mcap", tmp_path / "b.mcap")
    cut, mended = read(tmp_path / "cut.mcap"), read(tmp_path / "b.mcap")
    assert (cut.complete, mended.complete) == (False, True)
    assert saved.messages == info(mended).messages >= 500  # rows, as `log info` counts them
    for whole in (cut, mended):
        assert whole.tables["/tick"].t_us.tolist() == [k * 4000 for k in range(500)]  # what was flushed is there


def test_a_compact_flight_says_in_every_tick_whether_the_rest_was_the_same(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={}, compact=True)
    for k in range(50):
        log.tick(tick_record(k * 4000))
    log.close()
    tables = read(tmp_path / "a.mcap").tables
    assert [len(tables[name]) for name in ("/tick", "/command", "/learner", "/control", "/setpoint")] == [
        50,
        50,
        5,
        5,
        5,
    ]
    record = tick_record(8000)
    parts = (record.reference, record.proposal, record.learned, record.filtered)
    assert tables["/tick"]["digest"][2] == zlib.crc32(b"".join(part.row.tobytes() for part in parts))
    assert record._replace(learned=changed(record.learned, fed=0.5)).digest != record.digest


@pytest.mark.parametrize("compact", [False, True])
def test_rows_of_numbers_become_the_messages_that_their_records_become(tmp_path: Path, compact: bool) -> None:
    """Alone and mixed with records, byte for byte; one of another length is refused."""
    topics, logs = ("/vehicle/imu", "/vehicle/motors", "/vehicle/local_position"), []
    for name in ("records", "numbers", "mixed"):
        log, rng = FlightLog.open(tmp_path / f"{name}.mcap", metadata={}, compact=compact), random.Random(5)
        for k in range(300):
            for topic in topics:
                record = tuple(
                    tuple(_number(field.type, rng) for _ in range(field.size))
                    if field.size
                    else _number(field.type, rng)
                    for field in TOPICS[topic].fields
                )
                numbers = np.concatenate([np.atleast_1d(np.asarray(value, np.float64)) for value in record])
                log.write(topic, 4000 * k, record if name == "records" or (name == "mixed" and k % 3) else numbers)
        log.write(topics[0], 4000 * k, np.zeros(3))
        log.close()
        assert log.rejected == 1
        scanned = scan((tmp_path / f"{name}.mcap").read_bytes(), name).channels.values()
        logs.append({channel.topic: (channel.messages, list(channel.times_ns)) for channel in scanned})
    assert logs[1] == logs[0]
    assert logs[2] == logs[0]


def _number(kind: str, rng: random.Random) -> float | int:
    """One that a message off the wire may hold: whole, or of 32 bits."""
    return rng.randrange(0x10000) if kind.startswith("int") else float(np.float32(rng.gauss(0.0, 5.0)))
