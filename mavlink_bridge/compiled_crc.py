"""The CRC of MAVLink's frames (CRC-16/MCRF4XX) for compiled code; everybody else calls `fastcrc`."""

from __future__ import annotations

from typing import Any

import numpy as np
from fastcrc.crc16 import mcrf4xx

from flightstack.jit import njit

_STEPS = np.array([mcrf4xx(bytes([value]), 0) for value in range(256)], np.int64)


@njit
def crc(data: Any, begin: int, end: int, extra: int) -> int:
    """Of the bytes (or uint8 array) from begin up to end, and the message's extra byte."""
    out = 0xFFFF
    for i in range(begin, end):
        out = _STEPS[(out ^ data[i]) & 0xFF] ^ out >> 8
    return int(_STEPS[(out ^ extra) & 0xFF] ^ out >> 8)
