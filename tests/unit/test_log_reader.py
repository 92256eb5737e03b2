from __future__ import annotations

import io
import json
import random
import struct
from pathlib import Path

import numpy as np
import pytest
from log_samples import Truth, sample_record, tick_record
from mcap.writer import CompressionType, Writer
from rich.console import Console

from flightstack.types import InputError
from flightstack_logs.encoder import make_encoder
from flightstack_logs.info import info, render
from flightstack_logs.reader import Log, read
from flightstack_logs.topics import TOPICS, Attachment, Field, Kind, Topic
from flightstack_logs.wire import descriptor
from flightstack_logs.writer import FlightLog

VEHICLE = Attachment("vehicle.toml", "application/toml", b"name = 'x'\n")


def message_count(log: Log) -> int:
    return sum(len(table) for table in log.tables.values()) + sum(len(raw) for raw in log.messages.values())


@pytest.mark.parametrize("topic", TOPICS.values(), ids=TOPICS.keys())
def test_every_topic_comes_back_as_it_was_written(tmp_path: Path, topic: Topic) -> None:
    rng = random.Random(topic.name)
    records = [sample_record(topic, rng) for _ in range(50)]
    with_log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    for k, record in enumerate(records):
        with_log.write(topic.name, 1_000_000 + k * 4000, record)
    with_log.close()
    log = read(tmp_path / "a.mcap")
    assert log.complete
    assert log.notes == ()
    found = log.messages[topic.name] if topic.kind in (Kind.RAW, Kind.VIEW) else log.tables[topic.name]
    assert found.t_us.tolist() == [1_000_000 + k * 4000 for k in range(50)]
    if topic.name in log.messages:
        assert log.messages[topic.name].data == records
        return
    table = log.tables[topic.name]
    assert list(table.columns) == [field.name for field in topic.fields]
    assert table.units == {field.name: field.unit for field in topic.fields}
    for place, field in enumerate(topic.fields):
        column = table[field.name]
        assert column.shape == ((50, field.size) if field.size else (50,))
        assert column.tolist() == [list(record[place]) if field.size else record[place] for record in records]
        if field.type in ("double", "float"):
            assert column.dtype == np.float64


def test_nan_and_infinity_come_back(tmp_path: Path) -> None:
    with_log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    with_log.write("/command", 0, (float("nan"), float("inf"), (float("-inf"), float("nan"), -0.0)))
    with_log.write("/vehicle/battery", 0, (float("nan"), float("inf"), -1))
    with_log.close()
    tables = read(tmp_path / "a.mcap").tables
    np.testing.assert_array_equal(tables["/command"]["thrust_n"], [np.nan])
    np.testing.assert_array_equal(tables["/command"]["thrust_norm"], [np.inf])
    np.testing.assert_array_equal(tables["/command"]["rate_frd_radps"], [[-np.inf, np.nan, -0.0]])
    np.testing.assert_array_equal(tables["/vehicle/battery"]["voltage_v"], [np.nan])
    np.testing.assert_array_equal(tables["/vehicle/battery"]["current_a"], [np.inf])


def flight(path: Path, seconds: float = 2.0) -> FlightLog:
    """A small flight; not closed."""
    log = FlightLog.open(path, metadata={"run": {"seed": "7"}}, attachments=[VEHICLE])
    for k in range(int(seconds * 250)):
        t_us = 500_000 + k * 4000
        log.mavlink("rx", t_us, struct.pack("<I", k) * 10)
        log.tick(tick_record(t_us))
        log.truth(t_us, Truth(t_us, (0.1, 0.2, -0.3), (1.0, 0.0, 0.0, 0.0)))
        if k % 100 == 0:
            log.event(t_us, "phase", f"number {k}")
    return log


def test_metadata_and_attachments_come_back(tmp_path: Path) -> None:
    flight(tmp_path / "a.mcap", 0.1).close()
    log = read(tmp_path / "a.mcap")
    assert log.metadata["run"] == {"seed": "7"}
    assert log.metadata["log"]["format"] == "flightstack.log/1"
    assert log.attachments == (VEHICLE,)
    assert log.attachment("vehicle.toml") == VEHICLE.data
    assert log.attachment("none") is None


def test_a_log_that_was_not_closed_is_readable_up_to_the_last_chunk_and_says_so(tmp_path: Path) -> None:
    unfinished = flight(tmp_path / "a.mcap")
    unfinished.flush()
    (tmp_path / "b.mcap").write_bytes((tmp_path / "a.mcap").read_bytes())
    unfinished.close()
    whole, cut = read(tmp_path / "a.mcap"), read(tmp_path / "b.mcap")
    assert whole.complete
    assert not cut.complete
    assert "was not closed" in cut.notes[0]
    assert message_count(cut) == message_count(whole) == unfinished.messages
    assert cut.metadata == whole.metadata
    np.testing.assert_array_equal(cut.tables["/tick"]["pos_ned_m"], whole.tables["/tick"]["pos_ned_m"])


def test_a_log_that_holds_only_metadata_is_readable(tmp_path: Path) -> None:
    unfinished = FlightLog.open(tmp_path / "a.mcap", metadata={"run": {"seed": "7"}})
    log = read(tmp_path / "a.mcap")
    unfinished.close()
    assert not log.complete
    assert log.metadata["run"] == {"seed": "7"}
    assert log.span_us == (0, 0)
    assert info(log).duration_s == 0.0


def test_any_cut_leaves_a_readable_beginning_or_a_clear_error(tmp_path: Path) -> None:
    flight(tmp_path / "a.mcap", 0.6).close()
    data = (tmp_path / "a.mcap").read_bytes()
    whole = message_count(read(tmp_path / "a.mcap"))
    last = 0
    for size in [*range(1, 60), *range(60, len(data), len(data) // 60), len(data) - 9, len(data) - 1]:
        (tmp_path / "cut.mcap").write_bytes(data[:size])
        if size < 8:
            with pytest.raises(InputError, match="cut off within its first bytes"):
                read(tmp_path / "cut.mcap")
            continue
        log = read(tmp_path / "cut.mcap")
        assert not log.complete
        assert log.notes
        assert last <= message_count(log) <= whole
        last = message_count(log)
    assert last == whole


def test_no_flipped_bit_makes_reading_raise_or_passes_for_complete_data(tmp_path: Path) -> None:
    """Every chunk has a checksum: a damaged one is skipped and named, never read as numbers."""
    flight(tmp_path / "a.mcap", 0.6).close()
    data = (tmp_path / "a.mcap").read_bytes()
    right = read(tmp_path / "a.mcap").tables["/tick"]["pos_ned_m"].tolist()
    rng = random.Random(0)
    skipped = 0
    for _ in range(100):
        broken = bytearray(data)
        broken[rng.randrange(8, len(data))] ^= 1 << rng.randrange(8)
        (tmp_path / "b.mcap").write_bytes(broken)
        log = read(tmp_path / "b.mcap")
        json.dumps(info(log).as_json())
        if "/tick" in log.tables:
            rows = log.tables["/tick"]["pos_ned_m"].tolist()
            assert all(row in right for row in rows[:20])
            assert len(rows) == len(right) or log.notes
        skipped += any("skipped" in note for note in log.notes)
    assert skipped > 30


def test_garbage_behind_the_magic_is_a_log_with_nothing_in_it(tmp_path: Path) -> None:
    rng = random.Random(1)
    for size in (0, 1, 8, 9, 100, 5000):
        (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + rng.randbytes(size))
        log = read(tmp_path / "a.mcap")
        assert not log.complete
        assert message_count(log) == 0


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"", "is empty"), (b"\x89MC", "cut off within its first bytes"), (b"ULog nonsense", "no known kind")],
)
def test_a_file_that_is_no_log_is_an_input_error_of_one_line(tmp_path: Path, content: bytes, says: str) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(InputError, match=says) as caught:
        read(tmp_path / "a.mcap")
    assert "\n" not in str(caught.value)


def test_a_missing_file_or_a_folder_is_an_input_error(tmp_path: Path) -> None:
    for path in (tmp_path / "none.mcap", tmp_path):
        with pytest.raises(InputError, match=r"can't be read|is no file"):
            read(path)


def write_with_mcap(path: Path, topic: Topic, rows: list[tuple[int, bytes]], **options: object) -> None:
    """A log of another writer (mcap's own)."""
    stream = io.BytesIO()
    writer = Writer(stream, **options)  # type: ignore[arg-type]
    writer.start(profile="", library="test")
    schema = writer.register_schema(topic.schema, "protobuf", descriptor(topic))
    channel = writer.register_channel(topic.name, "protobuf", schema)
    other = writer.register_channel("/json", "json", 0)
    for t_us, data in rows:
        writer.add_message(channel, t_us * 1000, data, t_us * 1000, 0)
        writer.add_message(other, t_us * 1000, b'{"a": 1}', t_us * 1000, 0)
    writer.finish()
    path.write_bytes(stream.getvalue())


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_files_of_other_writers_are_read_and_their_unknown_topics_kept_as_they_are(
    tmp_path: Path, compression: CompressionType, chunked: bool
) -> None:
    topic = TOPICS["/command"]
    record = (12.0, 0.5, (1.0, 2.0, 3.0))
    rows = [(k, make_encoder(topic, record)(record)) for k in range(10)]
    write_with_mcap(tmp_path / "a.mcap", topic, rows, compression=compression, use_chunking=chunked)
    log = read(tmp_path / "a.mcap")
    assert log.complete
    assert log.tables["/command"]["rate_frd_radps"].tolist() == [[1.0, 2.0, 3.0]] * 10
    assert log.messages["/json"].data == [b'{"a": 1}'] * 10


def test_a_log_of_another_version_is_read_by_the_schema_that_it_carries(tmp_path: Path) -> None:
    fields = (Field("old_m", "double", 2, "m", "gone since"), Field("count", "int32", 0, "", ""))
    topic = Topic("/command", Kind.TABLE, "flightstack.Command", 0.0, "", "", fields)
    encode = make_encoder(topic, ())
    write_with_mcap(tmp_path / "a.mcap", topic, [(0, encode(((1.5, 2.5), 7))), (1, encode(((3.5, 4.5), -8)))])
    table = read(tmp_path / "a.mcap").tables["/command"]
    assert table["old_m"].tolist() == [[1.5, 2.5], [3.5, 4.5]]
    assert table["count"].tolist() == [7, -8]


@pytest.mark.parametrize("odd", [b"", b"\x09" + bytes(7), b"\xff\xff", bytes(41), b"\x1a\x18" + bytes(24)])
def test_a_table_whose_messages_are_not_of_one_form_is_kept_raw_with_a_note(tmp_path: Path, odd: bytes) -> None:
    topic = TOPICS["/command"]
    record = (12.0, 0.5, (1.0, 2.0, 3.0))
    good = make_encoder(topic, record)(record)
    for rows in ([(0, good), (1, odd)], [(0, odd), (1, good)], [(0, odd)]):
        write_with_mcap(tmp_path / "a.mcap", topic, rows)
        log = read(tmp_path / "a.mcap")
        assert "/command" not in log.tables
        assert log.messages["/command"].data == [data for _, data in rows]
        assert "kept as raw messages" in log.notes[0]


def test_messages_come_in_order_of_time_however_they_were_written(tmp_path: Path) -> None:
    with_log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    for t_us in (5000, 1000, 3000, 1000):
        with_log.mavlink("rx", t_us, str(with_log.messages).encode())
        with_log.write("/vehicle/battery", t_us, (t_us * 1.0, 0.0, -1))
    with_log.close()
    log = read(tmp_path / "a.mcap")
    assert log.messages["/mavlink/rx"].t_us.tolist() == [1000, 1000, 3000, 5000]
    assert log.messages["/mavlink/rx"].data == [b"2", b"6", b"4", b"0"]
    assert log.tables["/vehicle/battery"]["voltage_v"].tolist() == [1000.0, 1000.0, 3000.0, 5000.0]


def test_info_counts_messages_rates_and_events(tmp_path: Path) -> None:
    log = flight(tmp_path / "a.mcap", 2.0)
    log.statustext(700_000, 4, "low battery")
    log.close()
    summary = info(read(tmp_path / "a.mcap"))
    topics = {topic.name: topic for topic in summary.topics}
    assert summary.duration_s == pytest.approx(1.996)
    assert summary.start_us == 500_000
    assert summary.messages == log.messages
    assert topics["/tick"].messages == 500
    assert topics["/tick"].rate_hz == pytest.approx(250.0)
    assert topics["/pose"].rate_hz == pytest.approx(5.0, rel=0.02)  # the first one comes off the beat
    assert topics["/truth"].source == "simulator"
    units = {field.name: (field.unit, field.size) for field in topics["/tick"].fields}
    assert units["pos_ned_m"] == ("m", 3)
    assert units["delay_s"] == ("s", 0)
    assert summary.attachments == {"vehicle.toml": len(VEHICLE.data)}
    assert [(event.t_s, event.source, event.text) for event in summary.events[:2]] == [
        (0.0, "companion", "number 0"),
        (pytest.approx(0.2), "vehicle", "low battery"),
    ]


def test_info_is_json_and_a_table_that_names_everything(tmp_path: Path) -> None:
    unfinished = flight(tmp_path / "a.mcap", 0.5)
    unfinished.flush()
    summary = info(read(tmp_path / "a.mcap"))
    unfinished.close()
    again = json.loads(json.dumps(summary.as_json()))
    assert again["schema"] == "flightstack.loginfo/1"
    assert again["complete"] is False
    stream = io.StringIO()
    Console(file=stream, width=140).print(render(summary))
    text = stream.getvalue()
    for word in ("not complete", "was not closed", "/tick", "/truth", "250.0", "vehicle.toml", "seed 7", "number 100"):
        assert word in text
