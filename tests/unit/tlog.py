"""A tlog for tests: 8 bytes of big-endian microseconds before every frame."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from mavlink_bridge.link import Link


class Heard(NamedTuple):
    """One message of a recording."""

    t_us: int
    system: int
    frame: bytes
    message: Any


def recording(path: Path) -> Iterator[Heard]:
    """The messages of a recording, in order; `t_us` counts from the first one."""
    data, link, at, start = path.read_bytes(), Link(1, 1), 0, None
    while at + 8 < len(data):
        t_us = int.from_bytes(data[at : at + 8], "big")
        start = t_us if start is None else start
        size = 12 + data[at + 9] + (13 if data[at + 10] & 1 else 0)
        frame = data[at + 8 : at + 8 + size]
        at += 8 + size
        link.receive_datagram(frame, 0)
        received = link.next_event()
        if received is not None:
            yield Heard(t_us - start, received.system, frame, received.message)
