"""The streams that come nearly every tick, all that are due in one compiled call: the bytes that builder and link make.

Which message has what and where is said by `builders` and the message table; the tests hold these bytes to theirs.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from flightstack.jit import Entry, njit
from flightstack.types import F64, U8
from flightstack_sim.autopilot.setpoint import ControlKind
from flightstack_sim.view import View
from mavlink_bridge import messages as m
from mavlink_bridge.compiled_crc import crc
from mavlink_bridge.framing import HEADER_SIZE, MAGIC_V2
from mavlink_bridge.link import Link

KINDS: Final = (m.HighresImu, m.AttitudeQuaternion, m.LocalPositionNed, m.ServoOutputRaw)
_IMU, _ATTITUDE, _POSITION, _MOTORS = range(1, 5)
_ROWS = [m.BY_EVENT[kind] for kind in KINDS]
_IDS, _EXTRAS, _SIZES = (np.array([0, *(getattr(row, name) for row in _ROWS)]) for name in ("id", "crc_extra", "size"))
_LONGEST, _HIGHEST_US = 80, 4_000_000_000_000
_UNUSED_PWM = 900


class TickFrames:
    """Writes the frames of one link; its memory is its own."""

    __slots__ = ("_ends", "_memory", "_out")

    def __init__(self) -> None:
        self._out = np.zeros(_LONGEST * len(KINDS), np.uint8)
        self._ends = np.zeros(len(KINDS), np.int64)
        data = np.zeros(_LONGEST // 8, np.int64)
        payload = data, data.view(np.float32), data.view(np.uint16), data.view(np.uint8)
        self._memory = payload, self._out, self._ends

    def send(self, order: int, view: View, link: Link) -> None:
        """Queue the messages whose numbers (1 to 4, as in KINDS) are the octal digits of `order`, in their order."""
        vehicle, setpoint = view.vehicle, view.setpoint
        spinning = setpoint.kind is not ControlKind.OFF and abs(setpoint.thrust_norm) < np.inf
        air = (*view.mag_frd_gauss, view.pressure_hpa, view.altitude_m, vehicle.sensors.imu_degc)
        count = _WRITE.call(
            order, view.stamp_us,
            (vehicle.sensors.state, vehicle.rate_frd_radps, vehicle.sensors.mean_imu, vehicle.motor_command), air,
            view.fields_updated, spinning, (link.next_sequence(link.component), link.system, link.component),
            self._memory,
        )  # fmt: skip
        link.queue(self._out.tobytes(), self._ends.tolist()[:count])


def plain(view: View, link: Link) -> bool:
    """Whether the frames are as usual: nothing is withheld or frozen by a fault, nothing signed."""
    return not (view.silenced or view.frozen or link.signing) and view.stamp_us < _HIGHEST_US


_PRESSURE, _ALTITUDE, _TEMPERATURE, _FIELDS = 11, 13, 14, 30
"""Places in HIGHRES_IMU, of floats and (the last) of 16 bits."""


@njit
def _write(
    order: int, stamp_us: int, state: tuple[F64, F64, F64, F64], air: tuple[float, float, float, float, float, float],
    fields: int, spinning: bool, sender: tuple[int, int, int], memory: Any,
) -> int:  # fmt: skip
    estimate, rate, imu, motors = state
    (words, floats, halves, data), out, ends = memory
    digits, number, count, at = 0, order, 0, 0
    while number:
        digits, number = digits * 8 + number % 8, number // 8
    while digits:
        kind, digits = digits % 8, digits // 8
        words[:] = 0
        if kind == _IMU:
            words[0] = stamp_us
            for i in range(3):
                floats[2 + i], floats[5 + i] = imu[3 + i], imu[i]
                floats[8 + i] = air[i]
            _, _, _, pressure_hpa, altitude_m, degc = air
            floats[_PRESSURE], floats[_ALTITUDE] = pressure_hpa, altitude_m
            floats[_TEMPERATURE], halves[_FIELDS] = degc, fields
        elif kind == _MOTORS:
            words[0] = min(stamp_us, 0xFFFF_FFFF)
            for i in range(8):
                pwm = np.int64(1000.5 + 1000.0 * motors[i]) if spinning and i < 4 else _UNUSED_PWM
                halves[2 + i] = pwm
                data[21 + 2 * i], data[22 + 2 * i] = _UNUSED_PWM & 0xFF, _UNUSED_PWM >> 8
        else:
            words[0] = stamp_us // 1000
            for i in range(7 if kind == _ATTITUDE else 6):
                if kind == _POSITION:
                    floats[1 + i] = estimate[i]
                else:
                    floats[1 + i] = estimate[6 + i] if i < 4 else rate[i - 4]
        at = _frame(kind, (sender[0] + count, sender[1], sender[2]), data, out, at)
        ends[count] = at
        count += 1
    return count


@njit
def _frame(kind: int, sender: tuple[int, int, int], data: U8, out: U8, at: int) -> int:
    """A MAVLink 2 frame round the payload, its trailing zeros cut; where it ends."""
    size = _SIZES[kind]
    while size > 1 and data[size - 1] == 0:
        size -= 1
    head = (MAGIC_V2, size, 0, 0, sender[0] & 0xFF, sender[1], sender[2], _IDS[kind], 0, 0)  # ids below 256
    for i in range(HEADER_SIZE):
        out[at + i] = head[i]
    for i in range(size):
        out[at + HEADER_SIZE + i] = data[i]
    end = at + HEADER_SIZE + size
    check = crc(out, at + 1, end, _EXTRAS[kind])
    out[end], out[end + 1] = check & 0xFF, check >> 8
    return int(end + 2)


_WRITE = Entry(
    _write,
    "i8, i8, UniTuple(f8[::1], 4), UniTuple(f8, 6), i8, b1, UniTuple(i8, 3), "
    "Tuple((Tuple((i8[::1], f4[::1], u2[::1], u1[::1])), u1[::1], i8[::1]))",
)
