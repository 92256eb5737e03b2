from __future__ import annotations

import contextlib
import itertools
import math
import os
import random
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from log_samples import Truth, proto_class, sample_record, tick_record
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Chunk, Message, Metadata
from mcap.stream_reader import StreamReader

from flightstack.types import InputError
from flightstack_logs import encoder
from flightstack_logs.scene import Scene, SceneRegion
from flightstack_logs.topics import TOPICS, Attachment, Kind
from flightstack_logs.writer import CHUNK_BYTES, FLUSH_PERIOD_US, FlightLog

PYTHONPATH = os.pathsep.join([str(Path(__file__).parent), *sys.path])
RUN = {"run": {"seed": "7", "commit": "abc"}}
VEHICLE = Attachment("vehicle.toml", "application/toml", b"name = 'x'\n")


def decoded(path: Path, skip: str = "none") -> dict[str, list[tuple[int, Any]]]:
    """Topic -> (log time ns, message), by mcap's reader and protobuf's parser: nothing of ours.

    Messages whose schema's name begins with `skip` stay bytes.
    """
    out: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    classes: dict[int, Any] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert message.publish_time == message.log_time
            body: Any = message.data
            if channel.message_encoding == "protobuf" and schema is not None and not schema.name.startswith(skip):
                if schema.id not in classes:
                    classes[schema.id] = proto_class(schema.data, schema.name)
                body = classes[schema.id].FromString(message.data)
            out[channel.topic].append((message.log_time, body))
    return out


def test_a_second_log_of_the_same_records_compiles_nothing(tmp_path: Path) -> None:
    compiled = []
    for name in ("first.mcap", "second.mcap"):
        with contextlib.closing(FlightLog.open(tmp_path / name, metadata=RUN)) as log:
            log.tick(tick_record(0))
        assert not log.rejected
        compiled.append(encoder._code.cache_info().misses)
    assert compiled[0] > 0
    assert compiled[1] == compiled[0]


def write_samples(path: Path, count: int = 20) -> dict[str, list[tuple[int, Any]]]:
    """`count` seeded records of every topic; topic -> (time us, record)."""
    rng = random.Random(3)
    records: dict[str, list[tuple[int, Any]]] = {name: [] for name in TOPICS}
    with_log = FlightLog.open(path, metadata=RUN, attachments=[VEHICLE])
    for k in range(count):
        for name, topic in TOPICS.items():
            record = sample_record(topic, rng)
            records[name].append((k * 4000, record))
            with_log.write(name, k * 4000, record)
    assert with_log.failed is None
    assert with_log.messages == count * len(TOPICS)
    with_log.close()
    return records


def test_protobuf_reads_every_table_topic_exactly_as_it_was_written(tmp_path: Path) -> None:
    written = write_samples(tmp_path / "a.mcap")
    found = decoded(tmp_path / "a.mcap", skip="foxglove.")
    for name, topic in TOPICS.items():
        if topic.kind is not Kind.TABLE:
            continue
        for (t_us, record), (t_ns, message) in zip(written[name], found[name], strict=True):
            assert t_ns == t_us * 1000
            values = [getattr(message, field.name) for field in topic.fields]
            assert [tuple(v) if f.size else v for f, v in zip(topic.fields, values, strict=True)] == list(record)


def test_raw_mavlink_is_in_the_log_byte_for_byte(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    log.mavlink("rx", 5, b"\xfd\x00rx")
    log.mavlink("tx", 6, b"\xfd\x00tx")
    log.close()
    found = decoded(tmp_path / "a.mcap")
    assert found["/mavlink/rx"] == [(5000, b"\xfd\x00rx")]
    assert found["/mavlink/tx"] == [(6000, b"\xfd\x00tx")]


class _Imu(NamedTuple):
    t_us: int
    accel_frd_mps2: Any
    rate_frd_radps: Any


@pytest.mark.parametrize("dtypes", list(itertools.permutations([np.float32, np.float64, np.int64])))
def test_tuples_objects_and_arrays_of_any_type_give_the_same_message(tmp_path: Path, dtypes: list[type]) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    log.write("/vehicle/imu", 0, (1, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)))
    log.write("/vehicle/imu", 1, _Imu(1, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)))
    log.close()
    arrays = FlightLog.open(tmp_path / "b.mcap", metadata={})
    block = np.array([[1.0, 4.0], [2.0, 5.0], [3.0, 6.0]])
    for dtype in dtypes:
        arrays.write("/vehicle/imu", 0, _Imu(1, block[:, 0].astype(dtype), block[:, 1].astype(dtype)))
    arrays.write("/vehicle/imu", 0, _Imu(1, block[:, 0], block[:, 1].tolist()))
    arrays.close()
    assert arrays.failed is None
    messages = [m for name in ("a", "b") for _, m in decoded(tmp_path / f"{name}.mcap")["/vehicle/imu"]]
    assert len(messages) == 2 + 4
    assert all(list(m.accel_frd_mps2) == [1.0, 2.0, 3.0] for m in messages)
    assert all(list(m.rate_frd_radps) == [4.0, 5.0, 6.0] for m in messages)


def test_a_tick_goes_into_setpoint_command_and_tick(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    record = tick_record(4000, (1.0, 2.0, -3.0), guard="tilt")
    log.tick(record)
    log.close()
    found = decoded(tmp_path / "a.mcap")
    tick, setpoint, command, control = (found[name][0][1] for name in ("/tick", "/setpoint", "/command", "/control"))
    assert list(tick.pos_ned_m) == [1.0, 2.0, -3.0]
    assert list(tick.specific_force_frd_mps2) == list(record.measurement.specific_force_frd_mps2)
    assert list(control.nominal_jerk_ned_mps3) == list(np.float32(record.proposal.nominal_jerk_ned_mps3))
    assert (tick.attitude_age_us, control.thrust_fb_n, tick.thrust_saturated, tick.guard) == (8000, -0.5, True, "tilt")
    assert list(setpoint.snap_ned_mps4) == list(np.float32(record.reference.snap_ned_mps4))
    assert setpoint.yaw_rate_radps == np.float32(0.2)
    assert (command.thrust_norm, list(command.rate_frd_radps)) == (0.44, list(record.command.rate_frd_radps))


def test_metadata_and_attachments_come_before_any_message(tmp_path: Path) -> None:
    write_samples(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        kinds = [type(record) for record in StreamReader(file, emit_chunks=True).records]
    first_chunk = kinds.index(Chunk)
    assert kinds.count(Metadata) == 2
    assert max(i for i, kind in enumerate(kinds) if kind in (Metadata, AttachmentRecord)) < first_chunk


def test_metadata_and_attachments_are_on_disk_before_the_first_message(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata=RUN, attachments=[VEHICLE])
    data = (tmp_path / "a.mcap").read_bytes()
    log.close()
    assert b"commit" in data
    assert VEHICLE.data in data


def test_mcaps_own_reader_finds_metadata_attachments_and_an_index(tmp_path: Path) -> None:
    write_samples(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert {m.name: m.metadata for m in reader.iter_metadata()}["run"] == RUN["run"]
        assert [(a.name, a.media_type, a.data) for a in reader.iter_attachments()] == [
            (VEHICLE.name, VEHICLE.media_type, VEHICLE.data)
        ]
        summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 20 * len(TOPICS)
    assert summary.chunk_indexes


def test_a_chunk_is_closed_after_64_kib_and_after_a_fifth_of_a_second(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    for k in range(3000):
        log.mavlink("rx", k * 40, bytes(200))  # much data, little time
    for k in range(100):
        log.mavlink("rx", 120_000 + k * 50_000, bytes(10))  # little data, much time
    log.close()
    with (tmp_path / "a.mcap").open("rb") as file:
        chunks = [record for record in StreamReader(file, emit_chunks=True).records if isinstance(record, Chunk)]
    assert max(chunk.uncompressed_size for chunk in chunks) < CHUNK_BYTES + 1000
    assert (
        max(chunk.message_end_time - chunk.message_start_time for chunk in chunks) <= (FLUSH_PERIOD_US + 50_000) * 1000
    )
    assert len(chunks) > 25


def fly(path: Path) -> FlightLog:
    """Half a second of a flight, every kind of call."""
    log = FlightLog.open(path, metadata={"b": {"y": "1", "x": "2"}, "a": {"z": "3"}}, attachments=[VEHICLE])
    rotors = np.array([[0.1, 0.2, 0.0], [-0.1, -0.2, 0.0]])
    log.scene(0, Scene(rotors, 0.1, reference_ned_m=np.ones((4, 3)), region=SceneRegion("box", (0, 0, -1), (1, 1, 1))))
    for k in range(125):
        t_us = k * 4000
        log.mavlink("rx", t_us, bytes([k] * 30))
        log.write("/vehicle/imu", t_us, (t_us, (0.1 * k, 0.2, 0.3), (0.4, 0.5, 0.6)))
        log.tick(tick_record(t_us))
        log.truth(t_us, Truth(t_us, (0.01 * k, 0.0, -1.0), (1.0, 0.0, 0.0, 0.0)))
    log.event(500_000, "phase", "track")
    log.statustext(500_000, 4, "low battery")
    log.location(500_000, 47.1, 8.2, 400.0)
    log.close()
    assert log.failed is None
    return log


def test_the_same_calls_give_the_same_bytes(tmp_path: Path) -> None:
    fly(tmp_path / "a.mcap")
    fly(tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_another_process_with_another_hash_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    fly(tmp_path / "a.mcap")
    code = f"from pathlib import Path; import test_log_writer as t; t.fly(Path({str(tmp_path / 'b.mcap')!r}))"
    environment = {**os.environ, "PYTHONHASHSEED": "5", "PYTHONPATH": PYTHONPATH}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


class _SmallDisk:
    """A file on a disk that is full after `room` bytes."""

    def __init__(self, room: int) -> None:
        self.room = room
        self.data = bytearray()

    def write(self, data: bytes) -> int:
        if len(self.data) >= self.room:
            raise OSError(28, "No space left on device")
        part = data[: self.room - len(self.data)]
        self.data += part
        return len(part)

    def seek(self, offset: int, whence: int = 0) -> int:
        return len(self.data)

    def tell(self) -> int:
        return len(self.data)

    def truncate(self, size: int) -> int:
        del self.data[size:]
        return size

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass


def test_a_full_disk_never_raises_says_so_in_one_line_and_keeps_what_is_written(tmp_path: Path) -> None:
    disk: Any = _SmallDisk(100_000)
    log = FlightLog(tmp_path / "a.mcap", disk)
    rng = random.Random(0)
    for k in range(5000):
        log.mavlink("rx", k * 4000, rng.randbytes(100))
    log.event(30_000_000, "still", "flying")
    log.close()
    assert log.failed is not None
    assert "No space left on device" in log.failed
    assert "\n" not in log.failed
    (tmp_path / "a.mcap").write_bytes(disk.data)
    count = 0
    with (tmp_path / "a.mcap").open("rb") as file, contextlib.suppress(EndOfFile):
        for record in StreamReader(file).records:
            count += isinstance(record, Message)
    assert count * 100 > 50_000


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_log_on_a_full_disk_is_an_input_error_before_the_flight() -> None:
    with pytest.raises(InputError, match="log /dev/full: No space left on device"):
        FlightLog.open("/dev/full", metadata=RUN, overwrite=True)
    assert Path("/dev/full").exists()


def test_an_existing_log_is_not_overwritten_unless_asked(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(InputError, match="exists already") as caught:
        FlightLog.open(path, metadata={})
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == b"precious"
    FlightLog.open(path, metadata={}, overwrite=True).close()
    assert path.read_bytes() != b"precious"


def test_a_path_that_cannot_be_made_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="can't be written"):
        FlightLog.open(tmp_path / "file" / "a.mcap", metadata={})
    with pytest.raises(InputError, match="can't be written"):
        FlightLog.open(tmp_path, metadata={}, overwrite=True)


@pytest.mark.parametrize(
    ("topic", "record"),
    [
        ("/vehicle/imu", (1, (1.0, 2.0), (3.0, 4.0, 5.0))),
        ("/vehicle/imu", (1, None, (3.0, 4.0, 5.0))),
        ("/vehicle/imu", object()),
        ("/mavlink/rx", None),
        ("/no/such/topic", (1,)),
        ("/timing", (1.0, 2.0, 3.5)),
    ],
)
def test_a_record_that_does_not_fit_is_dropped_and_named_and_the_log_goes_on(
    tmp_path: Path, topic: str, record: object
) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    log.write(topic, 0, record)
    log.write("/vehicle/battery", 1, (16.0, 3.0, 90))
    log.write("/vehicle/battery", -1, (16.0, 3.0, 90))
    log.close()
    assert log.rejected == 2
    assert log.failed is not None
    assert topic in log.failed
    assert [t for t, _ in decoded(tmp_path / "a.mcap")["/vehicle/battery"]] == [1000]


def test_close_may_be_called_again_and_nothing_is_written_after_it(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    log.close()
    size = (tmp_path / "a.mcap").stat().st_size
    log.mavlink("rx", 1, b"late")
    log.flush()
    log.close()
    assert (tmp_path / "a.mcap").stat().st_size == size
    assert log.failed is None


def test_a_vehicle_north_above_the_ground_and_heading_east_is_so_in_the_3d_view(tmp_path: Path) -> None:
    """NED (1, 0, -2) is ENU (0, 1, 2); heading east, the FLU axes are east, north, up: no rotation."""
    half = math.sqrt(0.5)
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    log.truth(1_500_000, Truth(1_500_000, (1.0, 0.0, -2.0), (half, 0.0, 0.0, half)))
    log.close()
    found = decoded(tmp_path / "a.mcap")
    (transform,) = found["/truth/tf"][0][1].transforms
    assert (transform.parent_frame_id, transform.child_frame_id) == ("world", "body_true")
    assert (transform.timestamp.seconds, transform.timestamp.nanos) == (1, 500_000_000)
    at, turn = transform.translation, transform.rotation
    assert (at.x, at.y, at.z) == pytest.approx((0.0, 1.0, 2.0))
    assert (abs(turn.w), turn.x, turn.y, turn.z) == pytest.approx((1.0, 0.0, 0.0, 0.0), abs=1e-12)
    pose = found["/truth/pose"][0][1]
    assert (pose.frame_id, pose.pose.position.y, pose.pose.position.z) == ("world", 1.0, 2.0)


def test_poses_come_at_25_hz_and_the_path_stays_bounded(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    for k in range(250 * 2):
        log.tick(tick_record(k * 4000, (0.01 * k, 0.0, 0.0)))
    for k in range(2000):
        log.truth(2_000_000 + k * 200_000, Truth(0, (0.01 * k, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    log.close()
    found = decoded(tmp_path / "a.mcap")
    assert (len(found["/pose"]), len(found["/tf"])) == (10, 50)
    assert [t // 1_000_000_000 for t, _ in found["/path"]] == [0, 1]
    path = [pose.position.y for pose in found["/path"][-1][1].poses]
    assert path == pytest.approx([0.5 * k for k in range(6)])
    (line,) = found["/scene/path"][-1][1].entities[0].lines
    assert [point.y for point in line.points] == path
    last = [pose.position.y for pose in found["/truth/path"][-1][1].poses]
    assert len(last) < 600
    assert last[0] == 0.0
    assert 20.0 * 8 / 9 - 0.1 < last[-1] <= 20.0  # it is written anew when it has grown by an eighth
    assert last == sorted(last)


def test_the_scene_has_rotors_ground_reference_and_region_where_they_are(tmp_path: Path) -> None:
    rotors = np.array([[0.13, 0.16, 0.0], [-0.13, -0.16, 0.0], [0.13, -0.16, 0.0], [-0.13, 0.16, -0.02]])
    reference = np.array([[0.0, 0.0, -1.0], [3.0, 1.0, -1.5]])
    region = SceneRegion("ellipsoid", (1.0, 2.0, -3.0), (0.5, 1.0, 1.5))
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    log.scene(0, Scene(rotors, 0.12, ground_down_m=0.25, region=region, reference_ned_m=reference, truth=True))
    log.close()
    found = decoded(tmp_path / "a.mcap")
    entities = {entity.id: entity for entity in found["/scene"][0][1].entities}
    assert set(entities) == {"ground", "vehicle", "vehicle_true", "region", "reference"}
    discs = [(d.pose.position.x, d.pose.position.y, d.pose.position.z) for d in entities["vehicle_true"].cylinders]
    assert discs == [(0.13, -0.16, 0.0), (-0.13, 0.16, 0.0), (0.13, 0.16, 0.0), (-0.13, -0.16, 0.02)]
    assert entities["vehicle_true"].frame_id == "body_true"
    assert entities["vehicle"].frame_id == "body"
    assert {point.z for point in entities["ground"].lines[0].points} == {-0.25}
    (ball,) = entities["region"].spheres
    assert (ball.pose.position.x, ball.pose.position.y, ball.pose.position.z) == (2.0, 1.0, 3.0)
    assert (ball.size.x, ball.size.y, ball.size.z) == (2.0, 1.0, 3.0)
    path = [(p.position.x, p.position.y, p.position.z) for p in found["/reference/path"][0][1].poses]
    assert path == [(0.0, 0.0, 1.0), (1.0, 3.0, 1.5)]
    np.testing.assert_array_equal(cloud(found, "reference"), path)
    ellipsoid = (cloud(found, "region") - [2.0, 1.0, 3.0]) / [1.0, 0.5, 1.5]
    np.testing.assert_allclose(np.linalg.norm(ellipsoid, axis=1), 1.0, rtol=1e-5)
    assert found["/outline/vehicle"][0][1].frame_id == "body_true"
    shape = cloud(found, "vehicle")
    nearest = np.min([np.hypot(*(shape - disc).T[:2]) for disc in discs], axis=0)
    assert pytest.approx(nearest[nearest > 0.119].min(), abs=1e-4) == 0.12
    for end, disc in zip(shape.reshape(len(rotors), 2, -1, 3)[:, 1, -1], discs, strict=True):
        assert end == pytest.approx(disc)


def cloud(found: dict[str, list[tuple[int, Any]]], name: str) -> np.ndarray:
    """(N, 3): the points of the first message of an outline."""
    message = found[f"/outline/{name}"][0][1]
    assert [(field.name, field.offset, field.type) for field in message.fields] == [
        ("x", 0, 7),
        ("y", 4, 7),
        ("z", 8, 7),
    ]
    return np.frombuffer(message.data, "<f4").reshape(-1, message.point_stride // 4)


def test_a_box_is_outlined_by_its_edges_and_the_flown_path_by_its_points(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    log.scene(0, SceneRegion("box", (1.0, 2.0, -3.0), (0.5, 1.0, 1.5)))
    for k in range(3):
        log.tick(tick_record(1_000_000 * k, (1.0 * k, 0.0, -2.0)))
    log.close()
    found = decoded(tmp_path / "a.mcap")
    box = np.abs(cloud(found, "certified") - [2.0, 1.0, 3.0]) / [1.0, 0.5, 1.5]
    assert ((np.isclose(box, 1.0).sum(axis=1) >= 2) & (box <= 1.0 + 1e-6).all(axis=1)).all()
    assert len(np.unique(cloud(found, "certified").round(4), axis=0)) == 12 * 39 + 8
    flown = np.frombuffer(found["/outline/path"][-1][1].data, "<f4").reshape(-1, 3)
    np.testing.assert_array_equal(flown[:, 1:], [[k, 2.0] for k in range(len(flown))])


def test_events_and_the_vehicles_words_are_foxglove_log_lines(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    log.event(1, "phase", "track", "warning")
    log.event(2, "mode", "pilot", "critical")
    log.event(3, "odd", "severity", "shouting")
    log.statustext(4, 2, "motor failure")
    log.location(5, 47.25, 8.5, 410.0)
    log.close()
    found = decoded(tmp_path / "a.mcap")
    assert [(m.level, m.name, m.message) for _, m in found["/events"]] == [
        (3, "phase", "track"), (5, "mode", "pilot"), (2, "odd", "severity"),
    ]  # fmt: skip
    assert [(m.level, m.name, m.message) for _, m in found["/vehicle/statustext"]] == [(5, "critical", "motor failure")]
    fix = found["/vehicle/location"][0][1]
    assert (fix.latitude, fix.longitude, fix.altitude) == (47.25, 8.5, 410.0)
