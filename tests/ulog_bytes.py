"""A ULog made by hand from PX4's description of the format, small enough to be cut and flipped anywhere."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence

import numpy as np

_TYPES = {"f": "float", "Q": "uint64_t", "B": "uint8_t", "i": "int32_t", "d": "double"}


def _message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog(
    topics: Mapping[str, tuple[Mapping[str, tuple[str, int]], np.ndarray]],
    parameters: Mapping[str, float],
    *,
    begins_us: int = 0,
    lines: Sequence[tuple[int, int, str]] = (),
) -> bytes:
    """topics: name -> (field -> (code, length), rows (N, k) with the time in us first, fields in order).

    `begins_us`: what the header says; `lines`: time, severity and text of what PX4 prints.
    """
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", begins_us) + _message("B", bytes(40))
    for name, value in parameters.items():
        key = f"float {name}".encode()
        out += _message("P", bytes([len(key)]) + key + struct.pack("<f", value))
    for name, (fields, _) in topics.items():
        said = ";".join(
            [f"{_TYPES[code]}{f'[{size}]' if size > 1 else ''} {field}" for field, (code, size) in fields.items()]
        )
        out += _message("F", f"{name}:uint64_t timestamp;{said};".encode())
    for number, name in enumerate(topics):
        out += _message("A", struct.pack("<BH", 0, number) + name.encode())
    for number, (fields, rows) in enumerate(topics.values()):
        code = "<HQ" + "".join(f"{size}{letter}" for letter, size in fields.values())
        integer = [letter not in "fd" for letter, size in fields.values() for _ in range(size)]
        for row in rows.tolist():
            values = [int(value) if whole else value for value, whole in zip(row[1:], integer, strict=True)]
            out += _message("D", struct.pack(code, number, int(row[0]), *values))
    for t_us, severity, text in lines:
        out += _message("L", struct.pack("<BQ", ord("0") + severity, t_us) + text.encode())
    return out


def as_logged(data: bytes, stamp_us: Callable[[str, int], int]) -> bytes:
    """A ULog of `ulog` with its messages in order of time, as a logger writes them; then each is stamped anew.

    `stamp_us`: topic and true time -> what the message says.
    """
    at, head, rows, names = 16, data[:16], [], {}
    while at < len(data):
        size, kind = struct.unpack_from("<HB", data, at)
        body, at = data[at + 3 : at + 3 + size], at + 3 + size
        if kind == ord("D"):
            rows.append((*struct.unpack_from("<HQ", body), body[10:]))
        else:
            head += struct.pack("<HB", size, kind) + body
        if kind == ord("A"):
            names[struct.unpack_from("<H", body, 1)[0]] = body[3:].decode()
    rows.sort(key=lambda row: row[1])
    parts = [_message("D", struct.pack("<HQ", k, stamp_us(names[k], t)) + rest) for k, t, rest in rows]
    return head + b"".join(parts)


def px4_flight(signals: Mapping[str, np.ndarray], t_us: np.ndarray, parameters: Mapping[str, float]) -> bytes:
    """A flight by today's topic names: q, xyz of gyro and accelerometer, position and velocity, motors' control."""
    rows = {name: np.column_stack([t_us, value]) for name, value in signals.items()}
    valid = np.ones((len(t_us), 4))
    imu = np.column_stack([t_us, signals["gyro"], signals["accel"]])
    where = np.column_stack([t_us, signals["pos"], signals["vel"], valid])
    flags = ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")
    fields = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), ("f", 1)) | dict.fromkeys(flags, ("B", 1))
    topics = {
        "vehicle_attitude": ({"q": ("f", 4)}, rows["q"]),
        "sensor_combined": ({"gyro_rad": ("f", 3), "accelerometer_m_s2": ("f", 3)}, imu),
        "vehicle_local_position": (fields, where),
        "actuator_motors": (
            {"control": ("f", 12)},
            np.column_stack([rows["control"], np.full((len(t_us), 8), np.nan)]),
        ),
    }
    return ulog(topics, parameters)
