from __future__ import annotations

import foxglove.messages
import pytest
from google.protobuf.descriptor import FieldDescriptor
from log_samples import proto_class

from flightstack_logs.topics import LEVELS, SEVERITIES, TOPICS, Kind, Topic, severity_names
from flightstack_logs.wire import descriptor, read_varint, varint, walk

TABLES = [topic for topic in TOPICS.values() if topic.kind is Kind.TABLE]
UNIT_OF_SUFFIX = {
    "m": "m", "mps": "m/s", "mps2": "m/s^2", "mps3": "m/s^3", "mps4": "m/s^4", "rad": "rad", "radps": "rad/s",
    "radps2": "rad/s^2", "us": "us", "n": "N", "v": "V", "a": "A", "norm": "1",
}  # fmt: skip
PROTO_TYPES = {
    "double": FieldDescriptor.TYPE_DOUBLE,
    "float": FieldDescriptor.TYPE_FLOAT,
    "int64": FieldDescriptor.TYPE_SFIXED64,
    "int32": FieldDescriptor.TYPE_SFIXED32,
    "bool": FieldDescriptor.TYPE_BOOL,
    "string": FieldDescriptor.TYPE_STRING,
}


@pytest.mark.parametrize("topic", TABLES, ids=lambda topic: topic.name)
def test_protobuf_accepts_the_descriptor_and_finds_every_field(topic: Topic) -> None:
    found = proto_class(descriptor(topic), topic.schema).DESCRIPTOR
    assert [field.name for field in found.fields] == [field.name for field in topic.fields]
    for ours, theirs in zip(topic.fields, found.fields, strict=True):
        assert theirs.type == PROTO_TYPES[ours.type]
        assert theirs.is_repeated == (ours.size > 0)


@pytest.mark.parametrize("topic", TABLES, ids=lambda topic: topic.name)
def test_the_suffix_of_a_name_is_its_unit(topic: Topic) -> None:
    for field in topic.fields:
        suffix = field.name.rpartition("_")[2]
        if "_" in field.name and suffix in UNIT_OF_SUFFIX:
            assert field.unit == UNIT_OF_SUFFIX[suffix], field.name


def test_every_topic_says_what_it_is_and_where_it_comes_from() -> None:
    for name, topic in TOPICS.items():
        assert name == topic.name
        assert name.startswith("/")
        assert topic.text
        assert topic.source
        assert bool(topic.fields) == (topic.kind in (Kind.TABLE, Kind.LOG))


def test_one_schema_name_means_one_schema() -> None:
    names = [topic.schema for topic in TABLES]
    assert len(set(names)) == len(names)


def test_viewer_topics_use_schemas_that_foxglove_knows() -> None:
    for topic in TOPICS.values():
        if topic.kind in (Kind.VIEW, Kind.LOG):
            message = getattr(foxglove.messages, topic.schema.removeprefix("foxglove."))
            assert message.get_schema().name == topic.schema


def test_whatever_is_the_truth_is_marked_as_truth() -> None:
    for topic in TOPICS.values():
        if topic.source == "simulator":
            assert topic.name.startswith("/truth")
            assert "TRUTH" in topic.text or "true" in topic.text


def test_every_mavlink_severity_has_a_level_and_odd_ones_count_as_the_nearest() -> None:
    assert [severity_names(number)[0] for number in range(8)] == [
        "fatal", "fatal", "fatal", "error", "warning", "info", "info", "debug",
    ]  # fmt: skip
    assert {severity_names(number)[0] for number in range(8)} <= set(LEVELS)
    assert severity_names(-3)[1] == SEVERITIES[0]
    assert severity_names(99)[1] == "debug"


@pytest.mark.parametrize(
    ("value", "wire"), [(0, "00"), (127, "7f"), (128, "8001"), (150, "9601"), (2**32, "8080808010")]
)
def test_varints_are_those_of_the_protobuf_documentation(value: int, wire: str) -> None:
    assert varint(value).hex() == wire
    assert read_varint(bytes.fromhex(wire), 0) == (value, len(wire) // 2)


@pytest.mark.parametrize("data", [b"\x80", b"\xff" * 11, b"\x09\x00", b"\x0a\x05ab", b"\x0b", b"\x0d\x00\x00"])
def test_a_malformed_message_is_a_value_error(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"cut off|not known"):
        list(walk(data))
