"""From a row of the message table to two lean functions: payload bytes -> event, event -> payload bytes.

A row says for every field of the event where it comes from on the wire and in which unit (`Wire`); decoder and encoder
are both generated from that one statement, so they can't disagree, and both are straight-line code: one struct call,
one tuple.  Generated on first use: most programs meet a handful of messages.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from struct import error as StructError
from typing import Any

from mavlink_bridge.layout import MessageLayout, WireField, layout, struct_of

_FLOAT32_MAX = 3.4028234663852886e38
_UNIT = re.compile("_(m|mps|rad|radps|deg|degc|hpa|v|a|s|ns|hz|norm)$")
_PER = {"degE7": 1e7, "degE5": 1e5, "mm": 1e3, "mm/s": 1e3, "cm": 1e2, "cm/s": 1e2, "cdeg": 1e2, "cdegC": 1e2}
_PER |= {
    "mV": 1e3,
    "cA": 1e2,
    "mrad/s": 1e3,
    "mgauss": 1e3,
    "mG": 1e3 / 9.80665,
}  # flightstack.types has the constant, but would import numpy here
"""How many of MAVLink's units make one of ours."""
_ON_THE_WIRE = {
    "t_boot_us": ("time_boot_ms", "event_time_boot_ms"),
    "t_us": ("time_usec",),
    "lat_deg": ("lat", "latitude", "lat_int"),
    "lon_deg": ("lon", "longitude", "lon_int"),
    "alt_msl_m": ("alt", "altitude"),
    "pos_ned_m": ("x y z",),
    "vel_ned_mps": ("vx vy vz",),
    "acc_ned_mps2": ("afx afy afz",),
    "q_ned_frd": ("q", "q1 q2 q3 q4", "attitude_quaternion"),
    "rate_frd_radps": (
        "rollspeed pitchspeed yawspeed",
        "body_roll_rate body_pitch_rate body_yaw_rate",
        "xgyro ygyro zgyro",
    ),
    "accel_frd_mps2": ("xacc yacc zacc",),
    "mag_frd_gauss": ("xmag ymag zmag",),
    "frame": ("coordinate_frame",),
    "params": (" ".join(f"param{i}" for i in range(1, 8)), "param1 param2 param3 param4 x y z"),
}
"""What MAVLink calls what events call so, in one message or another."""


@dataclass(frozen=True, slots=True)
class Wire:
    """Where an event's field comes from: one wire field, or several that make a tuple."""

    names: tuple[str, ...]
    times: int = 1
    """Integers: event = wire * times (milliseconds to microseconds: 1000)."""
    per: float = 0.0
    """Where not 0: event = wire / per, a float (centimetres to metres: 100)."""
    unknown: int | None = None
    """The wire's integer for "not known"; NaN in the event."""


def wire(names: str, *, times: int = 1, per: float = 0.0, unknown: int | None = None) -> Wire:
    """A `Wire` of one or several names, separated by spaces."""
    return Wire(tuple(names.split()), times, per, unknown)


def camel_to_upper(name: str) -> str:
    """`LocalPositionNed` -> `LOCAL_POSITION_NED`."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).upper()


def _text(raw: bytes) -> str:
    """A char array: up to the first NUL; what isn't UTF-8 becomes a replacement character."""
    return raw.partition(b"\0")[0].decode("utf-8", "replace")


@dataclass(frozen=True, slots=True)
class _Element:
    """One element of the unpacked tuple and what it is to the event."""

    field: WireField
    wire: Wire | None
    """None: not part of the event; `constant` goes out."""
    constant: int = 0


class Row:
    """One message: event class, layout, decoder, encoder, NaN rule, nominal rate and time-out."""

    def __init__(
        self,
        event: type[Any],
        layout: MessageLayout,
        wires: Mapping[str, Wire],
        constants: Mapping[str, int],
        nan: frozenset[str],
        rate_hz: float,
    ) -> None:
        self.event = event
        self.layout = layout
        self.wires = wires
        """Event field -> where it comes from, in the event's order."""
        self.nan = nan
        """Event fields that may hold NaN or infinity; elsewhere such a message is dropped."""
        self.rate_hz = rate_hz
        """PX4's default rate on the onboard link; 0 for what isn't a stream."""
        self.constants = constants
        """Wire fields that aren't in the event and go out with this value; others go out as 0."""
        self.wire_fields = _up_to_last_used(layout, wires, constants)
        """The layout's fields as far as the event needs them: MAVLink 2 cuts trailing zeros anyway."""
        self.struct = struct_of(self.wire_fields)
        self.size = self.struct.size
        """Bytes that `decode` reads and `encode` writes."""
        self.id = layout.id
        self.crc_extra = layout.crc_extra
        self.name = layout.name

    @cached_property
    def decode(self) -> Callable[[bytes, int], Any]:
        """`decode(data, offset)`: the event, or None where a field isn't finite that must be; needs `size` bytes."""
        return _build_decoder(self)

    @cached_property
    def encode(self) -> Callable[[Any], bytes]:
        """`encode(event)`: the full payload (not truncated).  Out-of-range values saturate, nothing raises."""
        return _build_encoder(self)

    def elements(self) -> list[_Element]:
        """The unpacked tuple, element by element."""
        owner = {name: source for source in self.wires.values() for name in source.names}
        return [
            _Element(field, owner.get(field.name), self.constants.get(field.name, 0))
            for field in self.wire_fields
            for _ in range(field.elements)
        ]

    def element_indices(self, source: Wire) -> list[int]:
        """Places of a `Wire`'s elements in the unpacked tuple, in the event's order."""
        starts, place = {}, 0
        for field in self.wire_fields:
            starts[field.name] = range(place, place + field.elements)
            place += field.elements
        return [index for name in source.names for index in starts[name]]

    def is_tuple(self, source: Wire) -> bool:
        """Whether the event's field is a tuple."""
        field = self.layout.field(source.names[0])
        return len(source.names) > 1 or (field.length > 0 and not field.is_bytes)

    def encode_slowly(self, event: Any) -> bytes:
        """The payload of an event whose values don't fit the wire: integers saturate, floats overflow to infinity."""
        elements = self.elements()
        values: list[Any] = [b"" if e.field.is_bytes else e.constant for e in elements]
        for value, source in zip(event, self.wires.values(), strict=True):
            parts = tuple(value) if self.is_tuple(source) else (value,)
            for index, part in zip(self.element_indices(source), parts, strict=True):
                values[index] = _fit(elements[index].field, source, part)
        return self.struct.pack(*values)


def _up_to_last_used(
    layout: MessageLayout, wires: Mapping[str, Wire], constants: Mapping[str, int]
) -> tuple[WireField, ...]:
    used = {name for source in wires.values() for name in source.names} | set(constants)
    last = max(i for i, field in enumerate(layout.fields) if field.name in used)
    return layout.fields[: last + 1]


def _fit(field: WireField, source: Wire, value: Any) -> Any:
    """An event's value as the nearest value that the wire can carry."""
    if field.is_bytes:
        return value.encode("utf-8", "replace") if isinstance(value, str) else bytes(value)
    number = value * source.per if source.per else value
    if field.is_float:
        number = float(number)
        return math.copysign(math.inf, number) if field.type == "float" and abs(number) > _FLOAT32_MAX else number
    low, high = field.integer_range
    if number != number:
        return source.unknown if source.unknown is not None else 0
    if source.unknown == high:  # too much is not the same as unknown
        high -= 1
    if number in (math.inf, -math.inf):
        return high if number > 0 else low
    return min(high, max(low, round(number) if source.per else int(number) // source.times))


def _build_decoder(row: Row) -> Callable[[bytes, int], Any]:
    names = [f"v{i}" if element.wire else "_" for i, element in enumerate(row.elements())]
    strict = []
    parts = []
    for name, source in row.wires.items():
        indices = row.element_indices(source)
        field = row.layout.field(source.names[0])
        if field.is_float and name not in row.nan:
            strict += [f"v{i}" for i in indices]
        exprs = [_decoded(field, source, f"v{i}") for i in indices]
        parts.append(f"({', '.join(exprs)},)" if row.is_tuple(source) else exprs[0])
    lines = ["def decode(data, offset):", f"    {', '.join(names)}, = unpack(data, offset)"]
    if strict:  # inf - inf and NaN - NaN are NaN, and a sum of float32 values can't overflow a double
        lines += [f"    s = {' + '.join(strict)}", "    if s - s != 0.0:", "        return None"]
    lines.append(f"    return new(cls, ({', '.join(parts)},))")
    scope = {
        "unpack": row.struct.unpack_from,
        "new": tuple.__new__,
        "cls": row.event,
        "nan": math.nan,
        "text": _text,
    }
    return _compile(lines, scope, row, "decode")


def _decoded(field: WireField, source: Wire, name: str) -> str:
    if field.is_bytes:
        return f"text({name})" if field.type == "char" else name
    if source.per:
        expr = f"{name} / {source.per!r}"
        return f"(nan if {name} == {source.unknown} else {expr})" if source.unknown is not None else expr
    return f"{name} * {source.times}" if source.times != 1 else name


def _build_encoder(row: Row) -> Callable[[Any], bytes]:
    elements = row.elements()
    values = [repr(b"") if e.field.is_bytes else repr(e.constant) for e in elements]
    targets = []
    for source in row.wires.values():
        indices = row.element_indices(source)
        field = row.layout.field(source.names[0])
        for i in indices:
            values[i] = _encoded(field, source, f"v{i}")
        group = ", ".join(f"v{i}" for i in indices)
        targets.append(f"({group},)" if row.is_tuple(source) else group)
    lines = [
        "def encode(event):",
        "    try:",
        f"        {', '.join(targets)}, = event",
        f"        return pack({', '.join(values)})",
        "    except (error, OverflowError, ValueError, TypeError):",
        "        return slowly(event)",
    ]
    scope = {"pack": row.struct.pack, "error": StructError, "slowly": row.encode_slowly, "round": round}
    return _compile(lines, scope, row, "encode")


def _encoded(field: WireField, source: Wire, name: str) -> str:
    if field.is_bytes:
        return f"{name}.encode()" if field.type == "char" else name
    if source.per:
        scaled = f"{name} * {source.per!r}"
        if field.is_float:
            return scaled
        return (
            f"({source.unknown} if {name} != {name} else round({scaled}))"
            if source.unknown is not None
            else f"round({scaled})"
        )
    return f"{name} // {source.times}" if source.times != 1 else name


def _compile(lines: list[str], scope: dict[str, Any], row: Row, name: str) -> Callable[..., Any]:
    exec(compile("\n".join(lines), f"<{name} {row.name}>", "exec"), scope)
    function: Callable[..., Any] = scope[name]
    return function


def row(
    event: type[Any],
    *,
    rate_hz: float = 0.0,
    nan: str = "",
    fixed: Mapping[str, int] | None = None,
    **wires: Wire | str,
) -> Row:
    """A row: event fields not named in `wires` come from the wire field of their own name, or of what MAVLink calls it,
    converted from MAVLink's unit into the one that ends their name.

    rate_hz: PX4's default rate on the onboard link, 0 for what isn't a stream.  nan: event fields (separated by spaces,
    or `*`) that may be NaN.  fixed: what goes out in wire fields that aren't in the event.
    """
    name = camel_to_upper(event.__name__)
    shape = layout(name)
    fields: tuple[str, ...] = event._fields
    said = {field: source if isinstance(source, Wire) else wire(source) for field, source in wires.items()}
    sources = {field: said.pop(field) if field in said else _found(field, shape) for field in fields}
    allowed = frozenset(fields) if nan == "*" else frozenset(nan.split())
    if said or not allowed <= set(fields):
        raise ValueError(f"row {name}: the event has no field {sorted(said) or sorted(allowed - set(fields))}")
    for source in sources.values():
        for field in source.names:
            shape.field(field)
    return Row(event, shape, sources, dict(fixed or {}), allowed, rate_hz)


def _found(name: str, shape: MessageLayout) -> Wire:
    """Where an event's field that its row does not name comes from."""
    fields = {field.name: field for field in shape.fields}
    if name in fields:
        return Wire((name,))
    for said in (*_ON_THE_WIRE.get(name, ()), _UNIT.sub("", name)):
        names = tuple(said.split())
        if fields.keys() >= set(names):
            return Wire(names, 1000 if said.endswith("_ms") else 1, _PER.get(fields[names[0]].unit, 0.0))
    return Wire((name,))  # which `row` refuses
