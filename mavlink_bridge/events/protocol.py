"""What systems ask and answer: clocks, modes, parameters, commands, texts and events.

Fields as in `telemetry`: SI units in names, MAVLink's own names where there is no unit.  Source: MAVLink common.xml.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

PARAM_INT32 = 6
"""MAV_PARAM_TYPE_INT32"""
PARAM_REAL32 = 9
"""MAV_PARAM_TYPE_REAL32"""
_PARAM_FORMATS = {1: "<B3x", 2: "<b3x", 3: "<H2x", 4: "<h2x", 5: "<I", PARAM_INT32: "<i", PARAM_REAL32: "<f"}


def param_bits(value: float, param_type: int) -> int:
    """A parameter's 32 wire bits (PX4's byte-wise union: integers are bit-cast); saturates, never raises."""
    layout = _PARAM_FORMATS.get(param_type, "<f")
    try:
        raw = struct.pack(layout, value if layout == "<f" else int(value))
    except (struct.error, OverflowError, ValueError):  # out of range or not finite: the nearest that fits
        if layout == "<f":
            raw = struct.pack(layout, float("inf") if value > 0 else float("-inf"))
        else:
            bits = 8 * struct.calcsize(layout.replace("3x", "").replace("2x", ""))
            low, high = (0, 2**bits - 1) if layout[1].isupper() else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
            raw = struct.pack(layout, 0 if value != value else high if value > high else low)
    return int.from_bytes(raw, "little")


def param_value(bits: int, param_type: int) -> int | float:
    """The number in a parameter's 32 wire bits; a type without a meaning here is read as a float."""
    number: int | float = struct.unpack(
        _PARAM_FORMATS.get(param_type, "<f"), (bits & 0xFFFFFFFF).to_bytes(4, "little")
    )[0]
    return number


class Ping(NamedTuple):
    """Round-trip measurement; target 0/0 asks, the answer names the asker."""

    t_us: int
    seq: int
    target_system: int
    target_component: int


class Timesync(NamedTuple):
    """Clock comparison; tc1 0 asks."""

    tc1_ns: int
    ts1_ns: int
    target_system: int = 0
    target_component: int = 0


class SetMode(NamedTuple):
    """Legacy mode change."""

    target_system: int
    base_mode: int
    custom_mode: int


class ParamRequestRead(NamedTuple):
    """Ask for a parameter by name, or by index where param_index is not -1."""

    target_system: int
    target_component: int
    param_id: str
    param_index: int = -1


class ParamRequestList(NamedTuple):
    """Ask for all parameters."""

    target_system: int
    target_component: int


class ParamValue(NamedTuple):
    """A parameter; its 32 wire bits are kept as they came, `value` reads them by `param_type`."""

    param_id: str
    bits: int
    param_type: int
    param_count: int
    param_index: int

    @property
    def value(self) -> int | float:
        """The number."""
        return param_value(self.bits, self.param_type)


class ParamSet(NamedTuple):
    """Set a parameter; `bits` from `param_bits`."""

    target_system: int
    target_component: int
    param_id: str
    bits: int
    param_type: int

    @property
    def value(self) -> int | float:
        """The number."""
        return param_value(self.bits, self.param_type)


class ParamError(NamedTuple):
    """Why a parameter request failed (MAV_PARAM_ERROR)."""

    target_system: int
    target_component: int
    param_id: str
    param_index: int
    error: int


class CommandLong(NamedTuple):
    """A command with seven float parameters; NaN: unset."""

    target_system: int
    target_component: int
    command: int
    confirmation: int
    params: tuple[float, float, float, float, float, float, float]


class CommandInt(NamedTuple):
    """A command with a place: params are param1..4, x, y (integers, degrees * 1e7), z."""

    target_system: int
    target_component: int
    frame: int
    command: int
    current: int
    autocontinue: int
    params: tuple[float, float, float, float, int, int, float]


class CommandAck(NamedTuple):
    """The answer to a command (MAV_RESULT)."""

    command: int
    result: int
    progress: int = 0
    result_param2: int = 0
    target_system: int = 0
    target_component: int = 0


class MessageInterval(NamedTuple):
    """A stream's interval; -1 off, 0 unknown."""

    message_id: int
    interval_us: int


class RequestDataStream(NamedTuple):
    """Legacy request for a group of streams."""

    target_system: int
    target_component: int
    req_stream_id: int
    req_message_rate_hz: int
    start_stop: int


class ManualControl(NamedTuple):
    """Sticks: x pitch, y roll, z thrust (0..1000), r yaw, each -1000..1000."""

    target: int
    x: int
    y: int
    z: int
    r: int
    buttons: int = 0
    buttons2: int = 0
    enabled_extensions: int = 0
    s: int = 0
    t: int = 0
    aux: tuple[int, int, int, int, int, int] = (0, 0, 0, 0, 0, 0)


class Statustext(NamedTuple):
    """A text for people; longer ones come in chunks of 50 bytes with one id, the last one shorter."""

    severity: int
    text: str
    id: int = 0
    chunk_seq: int = 0


class RadioStatus(NamedTuple):
    """A telemetry radio's own word, never signed: signal and noise of both ends (254 at most; 255 unknown)."""

    rssi: int
    remrssi: int
    txbuf: int
    """Percent free."""
    noise: int
    remnoise: int
    rxerrors: int
    fixed: int


class Event(NamedTuple):
    """A PX4 event; id = component << 24 | hash of its name; destination 0: everyone."""

    destination_component: int
    destination_system: int
    id: int
    t_boot_us: int
    sequence: int
    log_levels: int
    """internal << 4 | external: 2 critical, 3 error, 4 warning, 6 info, 8 protocol."""
    arguments: bytes = bytes(40)
    """40 bytes, packed little-endian."""


class CurrentEventSequence(NamedTuple):
    """The last event's number; flags bit 0: the counter was reset."""

    sequence: int
    flags: int = 0


class RequestEvent(NamedTuple):
    """Ask for missed events again."""

    target_system: int
    target_component: int
    first_sequence: int
    last_sequence: int


class ResponseEventError(NamedTuple):
    """A requested event is gone (reason 0)."""

    target_system: int
    target_component: int
    sequence: int
    sequence_oldest_available: int
    reason: int = 0
