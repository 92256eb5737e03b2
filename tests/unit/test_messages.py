"""The message table against pymavlink, its dialect's units, and a recorded PX4."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavlink_bridge import messages as m
from mavlink_bridge.codec import Row
from mavlink_bridge.framing import build_frame
from mavlink_bridge.layout import EXTENSIONS, LACKING, dialect
from mavlink_bridge.link import Link
from tests.mavlink_samples import (
    IN_DIALECT,
    SCALED_WITHOUT_UNIT,
    UNIT_FACTORS,
    dialect_class,
    payload_of,
    random_event,
    random_wire_value,
    random_wire_values,
)

SEED = 7
ROWS = pytest.mark.parametrize("row", m.MESSAGES, ids=lambda row: row.name)
DIALECT_ROWS = pytest.mark.parametrize("row", IN_DIALECT, ids=lambda row: row.name)

# What the companion, MAVSDK and PX4's default streams need; a row that goes missing is a broken peer.
EXPECTED_IDS = {
    0, 1, 2, 4, 8, 11, 20, 21, 22, 23, 24, 29, 30, 31, 32, 33, 36, 42, 43, 44, 45, 47, 49, 51, 66, 69, 74, 75, 76, 77,
    82, 83, 84, 85, 86, 87, 105, 110, 111, 115, 132, 141, 147, 148, 230, 241, 242, 244, 245, 253, 264, 300, 331, 345,
    380, 395, 397, 410, 411, 435, 436, 12901, 12904,
}  # fmt: skip


def _values_equal(ours: Any, theirs: Any) -> bool:
    if isinstance(ours, tuple):
        return len(ours) == len(theirs) and all(_values_equal(a, b) for a, b in zip(ours, theirs, strict=True))
    if isinstance(ours, float) and math.isnan(ours):
        return math.isnan(theirs)
    return bool(ours == theirs)


def _pymavlink(row: Row, values: dict[str, Any]) -> Any:
    """A pymavlink message with these wire values."""
    message = dialect_class(row)
    arguments = []
    for name in message.fieldnames:
        value = values[name]
        if name == "param_value":  # this row keeps the float's bits
            value = _float_of_bits(value)
        arguments.append(
            value.encode() if isinstance(value, str) else list(value) if isinstance(value, bytes) else value
        )
    return message(*arguments)


def _float_of_bits(bits: int) -> float:
    return m.param_value(bits, m.PARAM_REAL32)


def _dialect_values(row: Row, rng: random.Random) -> dict[str, Any]:
    """Random wire values, extensions that pymavlink doesn't know at 0, parameter bits those of an ordinary float."""
    values = random_wire_values(row, rng)
    known = set(dialect_class(row).fieldnames)
    for field in row.layout.fields:
        if field.name not in known:
            values[field.name] = [0.0] * field.length if field.length else 0
        elif field.name == "param_value":
            values[field.name] = m.param_bits(rng.gauss(0.0, 100.0), m.PARAM_REAL32)
    return values


@DIALECT_ROWS
def test_what_pymavlink_encodes_is_decoded_to_the_same_values_in_si_units(row: Row) -> None:
    rng = random.Random(SEED)
    sender = dialect.MAVLink(None, srcSystem=3, srcComponent=4)
    units = dialect_class(row).fieldunits_by_name
    for _ in range(25):
        values = _dialect_values(row, rng)
        link = Link(1, 1)
        link.receive_datagram(bytes(_pymavlink(row, values).pack(sender)), 123)
        received = link.next_event()
        assert received is not None
        assert (received.system, received.component, received.t_us) == (3, 4, 123)
        for field, source in row.wires.items():
            ours = getattr(received.message, field)
            flat = [
                _expected(value, source.unknown, _factor(field, name, units))
                for name in source.names
                for value in (values[name] if isinstance(values[name], list) else [values[name]])
            ]
            for mine, theirs in zip(ours if row.is_tuple(source) else (ours,), flat, strict=True):
                if isinstance(mine, float):
                    assert mine == pytest.approx(theirs, rel=1e-12, abs=0.0, nan_ok=True), field
                else:
                    assert mine == theirs, field


def _factor(field: str, name: str, units: dict[str, str]) -> float:
    """Our value per wire value; a field with a unit that kept the wire's name (yaw of GPS_RAW_INT) is raw."""
    if field == name:
        return 1
    return SCALED_WITHOUT_UNIT.get(name) or UNIT_FACTORS.get(units.get(name, ""), ("", 1))[1]


def _expected(value: Any, unknown: int | None, factor: float) -> Any:
    if unknown is not None and value == unknown:
        return math.nan
    return value * factor if factor != 1 else value


@DIALECT_ROWS
def test_what_is_encoded_is_decoded_by_pymavlink_to_the_same_wire_values(row: Row) -> None:
    rng = random.Random(SEED + 1)
    parser = dialect.MAVLink(None)
    for sequence in range(25):
        values = _dialect_values(row, rng)
        for name in set(values) - {name for source in row.wires.values() for name in source.names}:
            values[name] = row.constants.get(name, 0 if not isinstance(values[name], list) else [0.0] * 4)
        event = row.decode(payload_of(row, values), 0)
        link = Link(9, 8)
        for _ in range(sequence):
            link.send(m.Ping(0, 0, 0, 0))
        link.send(event, component=77 if sequence % 2 else None)
        frame = link.datagrams_to_send()[-1]
        theirs = parser.decode(bytearray(frame))  # raises where the CRC is wrong
        assert theirs.get_msgId() == row.id
        assert (theirs.get_srcSystem(), theirs.get_srcComponent()) == (9, 77 if sequence % 2 else 8)
        assert theirs.get_seq() == (0 if sequence % 2 else sequence)
        expected = _pymavlink(row, values)
        for name in theirs.fieldnames:
            mine, wanted = getattr(theirs, name), getattr(expected, name)
            assert _values_equal(_plain(mine), _plain(wanted)), name


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode().rstrip("\0")
    return tuple(value) if isinstance(value, list) else value.rstrip("\0") if isinstance(value, str) else value


@ROWS
def test_an_event_comes_back_from_the_wire_unchanged(row: Row) -> None:
    rng = random.Random(SEED + 2)
    sender, receiver = Link(1, 1), Link(2, 2)
    for _ in range(25):
        event = random_event(row, rng)
        sender.send(event)
        for datagram in sender.datagrams_to_send():
            receiver.receive_datagram(datagram, 0)
        received = receiver.next_event()
        assert received is not None
        assert type(received.message) is row.event
        assert _values_equal(received.message, event)
    assert receiver.stats.lost == receiver.stats.dropped == 0


@DIALECT_ROWS
def test_names_carry_the_units_that_the_dialect_states(row: Row) -> None:
    """A wire field with a unit has it in our field's name, but percentages, bytes and what is named as on the wire."""
    units = dialect_class(row).fieldunits_by_name
    for field, source in row.wires.items():
        for name in source.names:
            unit = units.get(name, "")
            if unit in UNIT_FACTORS and field != name:
                suffix, factor = UNIT_FACTORS[unit]
                assert field.endswith(f"_{suffix}"), f"{field} is in {suffix} ({unit} on the wire)"
                assert factor == 1 or source.times == factor or source.per == pytest.approx(1.0 / factor)
            else:
                assert (source.times, source.per) == (1, 0.0) or name in SCALED_WITHOUT_UNIT


@ROWS
def test_a_float_that_is_not_finite_passes_only_where_the_row_allows_it(row: Row) -> None:
    rng = random.Random(SEED + 3)
    for field, source in row.wires.items():
        for name in source.names:
            shape = row.layout.field(name)
            if not shape.is_float:
                continue
            for bad in (math.nan, math.inf, -math.inf):
                for element in range(shape.elements):
                    values = random_wire_values(row, rng)
                    values[name] = bad if not shape.length else [
                        bad if i == element else 0.5 for i in range(shape.length)
                    ]  # fmt: skip
                    decoded = row.decode(payload_of(row, values), 0)
                    assert (decoded is not None) == (field in row.nan), (field, bad)


@ROWS
def test_values_that_do_not_fit_saturate_and_never_raise(row: Row) -> None:
    rng = random.Random(SEED + 4)
    for huge in (10**30, -(10**30), math.nan, math.inf, -math.inf, 3.5e38):
        event = random_event(row, rng)
        for field, source in row.wires.items():
            shape = row.layout.field(source.names[0])
            if shape.is_bytes:
                continue
            value = (huge,) * len(row.element_indices(source)) if row.is_tuple(source) else huge
            payload = row.encode(event._replace(**{field: value}))
            raw = row.struct.unpack(payload)[row.element_indices(source)[0]]
            if shape.is_float:
                with np.errstate(over="ignore"):
                    assert np.array_equal(np.float32(raw), np.float32(huge), equal_nan=True)
            else:
                low, high = shape.integer_range
                high -= source.unknown == high
                assert raw == ((source.unknown or 0) if math.isnan(huge) else high if huge > 0 else low), field


def test_the_slow_encoder_agrees_with_the_fast_one() -> None:
    rng = random.Random(SEED + 5)
    for row in m.MESSAGES:
        for _ in range(10):
            event = random_event(row, rng)
            assert row.encode_slowly(event) == row.encode(event)


def test_the_table_has_every_message_once_and_all_that_the_peers_need() -> None:
    ids = [row.id for row in m.MESSAGES]
    assert len(ids) == len(set(ids))
    assert set(ids) >= EXPECTED_IDS
    assert all(m.BY_ID[row.id] is row and m.BY_EVENT[row.event] is row for row in m.MESSAGES)
    assert m.id_of(m.CurrentMode) == 436


def test_integer_parameters_are_bit_cast_and_every_one_survives() -> None:
    """-5000000 is a signalling NaN if read as a float; as bits it stays what it is."""
    for value in (0, 1, -1, 2**31 - 1, -(2**31), -5_000_000, 2_139_095_041):
        sent = m.ParamValue("COM_RC_IN_MODE", m.param_bits(value, m.PARAM_INT32), m.PARAM_INT32, 875, 3)
        row = m.BY_EVENT[m.ParamValue]
        assert row.decode(row.encode(sent), 0).value == value
    assert m.param_value(m.param_bits(0.15, m.PARAM_REAL32), m.PARAM_REAL32) == pytest.approx(0.15, rel=1e-7)
    assert m.param_value(m.param_bits(10**12, m.PARAM_INT32), m.PARAM_INT32) == 2**31 - 1
    assert m.param_value(m.param_bits(math.nan, m.PARAM_INT32), m.PARAM_INT32) == 0
    assert m.param_value(m.param_bits(1e300, m.PARAM_REAL32), m.PARAM_REAL32) == math.inf
    assert m.param_value(m.param_bits(-7, 2), 2) == -7


def test_text_that_is_not_utf8_or_too_long_is_cut_and_never_raises() -> None:
    row = m.BY_EVENT[m.Statustext]
    assert row.decode(b"\x02" + b"\xff\xfeabc".ljust(50, b"\0") + bytes(3), 0).text == "\ufffd\ufffdabc"
    assert row.decode(row.encode(m.Statustext(2, "x" * 80)), 0).text == "x" * 50
    assert row.decode(row.encode(m.Statustext(2, "\udcff")), 0).severity == 2


def _frames(path: Path) -> list[bytes]:
    """The frames of a tlog: before each a big-endian time stamp of 8 bytes."""
    data, at, frames = path.read_bytes(), 0, []
    while at < len(data):
        size = 12 + data[at + 9]
        frames.append(data[at + 8 : at + 8 + size])
        at += 8 + size
    return frames


@pytest.mark.recorded
def test_every_frame_of_the_recorded_px4_is_decoded_and_encoded_to_the_same_bytes(recorded: Path) -> None:
    """109,764 frames, both directions; only a PARAM_ERROR with stray memory in its name isn't reproduced.

    Layouts and CRC extras of the messages that the dialect lacks are confirmed by these CRCs.
    """
    frames = _frames(recorded / "px4_sih_offboard.tlog")
    link = Link(9, 9)
    seen: set[int] = set()
    different: list[int] = []
    for frame in frames:
        link.receive_datagram(frame, 0)
        received = link.next_event()
        assert received is not None
        assert link.next_event() is None
        row = m.BY_EVENT[type(received.message)]
        seen.add(row.id)
        again = build_frame(
            row.encode(received.message), row.id, row.crc_extra, received.seq, received.system, received.component
        )
        if again != frame:
            different.append(row.id)
    assert link.stats.received == len(frames) == 109_764
    assert link.stats.dropped == 0
    assert seen >= {LACKING[name][0] for name in LACKING} - {412, 413}
    assert different == [345]


def test_messages_that_the_dialect_lacks_have_mavlinks_published_crc_extras() -> None:
    """The generated C headers state them (MAVLINK_MSG_ID_..._CRC)."""
    published = {8: 117, 300: 217, 380: 232, 395: 0, 397: 182, 410: 160, 411: 106, 412: 33, 413: 77}
    assert {row.id: row.crc_extra for row in m.MESSAGES if row.name in LACKING} == published


def test_every_row_of_the_lists_beside_the_table_is_used() -> None:
    names = {row.name for row in m.MESSAGES}
    assert set(LACKING) <= names
    assert set(EXTENSIONS) <= names


def test_random_values_cover_the_range_of_a_wire_field() -> None:
    rng = random.Random(SEED)
    field = m.BY_EVENT[m.GpsRawInt].layout.field("lat")
    values = {random_wire_value(field, rng) for _ in range(200)}
    assert {-(2**31), 2**31 - 1, 0} <= values
