"""Which bytes of a program or a vehicle the shield passes on; PX4 reads what comes as one stream of bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mavlink_bridge import messages as m
from mavlink_bridge.framing import CRC, HEADER_SIZE, MAGIC_V1, MAGIC_V2, SIGNATURE_SIZE, Frame, frame_at
from mavlink_bridge.layout import CRC_EXTRAS
from mavlink_bridge.messages import BY_ID, MESSAGES

SETPOINTS = (m.SetAttitudeTarget, m.SetPositionTargetLocalNed, m.SetPositionTargetGlobalInt)
_ACTUATORS = 139
"""SET_ACTUATOR_CONTROL_TARGET: PX4 up to 1.13 flies it."""
SETPOINT_IDS = frozenset((*map(m.id_of, SETPOINTS), _ACTUATORS))
_EXTRAS = CRC_EXTRAS | {row.id: row.crc_extra for row in MESSAGES}
_UNKNOWN = "unknown_id"


def decoded(frame: Frame, payload: bytes) -> Any:
    """The message of a frame; None where it is none that is known."""
    row = BY_ID.get(frame.id)
    return None if row is None else row.decode(payload.ljust(row.size, b"\0"), 0)


def is_mavlink(data: bytes) -> bool:
    """Whether a datagram begins with a whole frame of a message that is known, a heartbeat for one."""
    return bool(data) and isinstance(frame_at(data, 0, _EXTRAS), Frame)


def is_one_frame(data: bytes, but: int) -> bool:
    """Whether a datagram is as long as the one frame that its head tells of, and that of another message than `but`.

    Cheap: nothing is decoded, no CRC looked at.
    """
    if len(data) < HEADER_SIZE:
        return False
    if data[0] == MAGIC_V2:
        size = HEADER_SIZE + data[1] + CRC.size + SIGNATURE_SIZE * (data[2] & 1)
        return size == len(data) and int.from_bytes(data[7:10], "little") != but
    _, length, _, _, _, message, *_ = data
    return data[0] == MAGIC_V1 and 6 + length + CRC.size == len(data) and message != but


def without(data: bytes, is_taken: Callable[[Frame, bytes], bool], *, whole: bool) -> list[bytes]:
    """The datagram without the frames that are taken; the very same bytes where none is.

    `whole`: nor passes what begins like a frame and is none.  PX4's parser takes as many bytes as such a head says,
    over the end of the datagram: what follows would be read otherwise than here, a setpoint in a payload among it.
    """
    kept, at, since = [], 0, 0
    while at < len(data):
        frame = frame_at(data, at, _EXTRAS)
        if isinstance(frame, Frame):
            end, good = frame.end, not is_taken(frame, data[frame.payload_at : frame.payload_at + frame.payload_size])
        elif frame.reason == _UNKNOWN:
            end, good = _end_of_unknown(data, at), True
        else:
            end, good = at + 1, not whole or data[at] not in (MAGIC_V1, MAGIC_V2)
        if not good:
            kept.append(data[since:at])
            since = end
        at = end
    if not kept:
        return [data]
    rest = b"".join([*kept, data[since:]])
    return [rest] if rest else []


def _end_of_unknown(data: bytes, at: int) -> int:
    """Where a whole frame ends whose id, and so whose CRC, is not known."""
    if data[at] == MAGIC_V1:
        return at + 6 + data[at + 1] + CRC.size
    return at + HEADER_SIZE + data[at + 1] + CRC.size + SIGNATURE_SIZE * data[at + 2]
