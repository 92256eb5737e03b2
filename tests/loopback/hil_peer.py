"""PX4's side of the simulator's TCP link, from its documentation, for tests: a stand-in with pymavlink as its codec.

It connects, sends a HEARTBEAT and asks for HIL_STATE_QUATERNION; takes HIL_SENSOR's time for its clock (which starts
1 ms after the first one) and answers every one, in lockstep, with HIL_ACTUATOR_CONTROLS.  It flies on the truth that
it gets, mixing by airframe 10016 (none_iris): its rotors' turning sense, and the model's own arms.
"""

from __future__ import annotations

import math
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common

HOST = "127.0.0.1"
ARMS_M = ((0.13, 0.22), (-0.13, -0.20), (0.13, -0.22), (-0.13, 0.20))
"""models/iris/iris.sdf, forward and right of rotor_0..3: front right, rear left, front left, rear right."""
SPIN = (0.06, 0.06, -0.06, -0.06)
"""CA_ROTORi_KM's signs (positive: counter-clockwise), the model's momentConstant."""
MASS_KG, INERTIA_KGM2 = 1.535, (0.029125, 0.029125, 0.055225)
MOTOR_N_S2 = 5.84e-6
G = 9.80665
# PX4's effectiveness of a rotor with its axis up: force along -z, moment p x (0, 0, -1) + km (0, 0, 1)
_EFFECT = np.array([[1.0] * 4, [-y for _, y in ARMS_M], [x for x, _ in ARMS_M], list(SPIN)])
_MIX = np.linalg.inv(_EFFECT)


def command_for(thrust_n: float) -> float:
    """The model's motor: speed 100 + 1000 u rad/s, thrust 5.84e-6 speed^2."""
    return min(max((math.sqrt(max(thrust_n, 0.0) / MOTOR_N_S2) - 100.0) / 1000.0, 0.0), 1.0)


@dataclass
class Peer:
    """One connection; `heard` keeps every message with its name."""

    port: int
    heard: dict[str, list[Any]] = field(default_factory=dict)
    in_company: int = 0
    """How often more than one sensor message came in one go: in lockstep only after a stall of this peer's own."""
    target: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """North, east, up, yaw."""

    def __post_init__(self) -> None:
        self.socket = socket.create_connection((HOST, self.port), timeout=20.0)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
        self.mav.robust_parsing = True
        self._first_us: int | None = None
        self._sum = 0.0
        self.send(self.mav.heartbeat_encode(0, 12, 0, 0, 0))
        self.send(self.mav.command_long_encode(0, 0, 511, 0, 115.0, 4000.0, 0, 0, 0, 0, 0))

    def send(self, message: Any) -> None:
        self.socket.sendall(message.pack(self.mav))

    def hear(self) -> list[Any]:
        """Wait for the next piece of the stream; what it holds."""
        data = self.socket.recv(65536)
        if not data:
            raise ConnectionError("the simulator has gone")
        messages = self.mav.parse_buffer(data) or []
        for message in messages:
            self.heard.setdefault(message.get_type(), []).append(message)
        return messages

    def clock_us(self, stamp_us: int) -> int:
        if self._first_us is None:
            self._first_us = stamp_us
        return stamp_us - self._first_us + 1000

    def answer(self, stamp_us: int, controls: list[float], *, armed: bool) -> None:
        padded = [*controls, *[0.0] * (16 - len(controls))]
        mode = 1 | (128 if armed else 0)
        self.send(self.mav.hil_actuator_controls_encode(self.clock_us(stamp_us), padded, mode, 1))

    def fly(self, seconds: float, *, armed: bool, controls: Callable[[], list[float]] | None = None) -> None:
        """Answer every sensor message, one by one, for so many seconds of the simulator's clock."""
        end_us: int | None = None
        while True:
            sensors = [message for message in self.hear() if message.get_type() == "HIL_SENSOR"]
            self.in_company += len(sensors) > 1
            for sensor in sensors:
                motors = controls() if controls else self.hover(sensor) if armed else [0.0] * 4
                self.answer(sensor.time_usec, motors, armed=armed)
                end_us = sensor.time_usec + round(1e6 * seconds) if end_us is None else end_us
            if sensors and end_us is not None and sensors[-1].time_usec >= end_us:
                return

    def state(self) -> tuple[float, float, float]:
        """True north, east, up in metres from the first truth."""
        truths = self.heard["HIL_STATE_QUATERNION"]
        first, now = truths[0], truths[-1]
        scale = math.radians(1e-7) * 6_371_000.0
        north = (now.lat - first.lat) * scale
        east = (now.lon - first.lon) * scale * math.cos(math.radians(first.lat * 1e-7))
        return north, east, 1e-3 * (now.alt - first.alt)

    def hover(self, sensor: Any) -> list[float]:
        """A plain position controller on the truth and the gyro -> motor commands."""
        if "HIL_STATE_QUATERNION" not in self.heard:
            return [0.0] * 4
        truth = self.heard["HIL_STATE_QUATERNION"][-1]
        north, east, up = self.state()
        roll, pitch, yaw = euler(truth.attitude_quaternion)
        t_north, t_east, t_up, t_yaw = self.target
        v_north, v_east, v_up = 0.01 * truth.vx, 0.01 * truth.vy, -0.01 * truth.vz
        a_north = _held(1.0 * (t_north - north) - 1.5 * v_north, 2.0)
        a_east = _held(1.0 * (t_east - east) - 1.5 * v_east, 2.0)
        a_up = _held(3.0 * _held(t_up - up, 1.0) - 3.0 * v_up, 4.0)
        ahead = a_north * math.cos(yaw) + a_east * math.sin(yaw)
        right = a_east * math.cos(yaw) - a_north * math.sin(yaw)
        angle = (right / G - roll, -ahead / G - pitch, math.remainder(t_yaw - yaw, 2.0 * math.pi))
        rate = (sensor.xgyro, sensor.ygyro, sensor.zgyro)
        gains = ((40.0, 9.0), (40.0, 9.0), (4.0, 3.0))
        torque = [i * (p * a - d * w) for i, (p, d), a, w in zip(INERTIA_KGM2, gains, angle, rate, strict=True)]
        thrust = MASS_KG * (G + a_up) / max(0.5, math.cos(roll) * math.cos(pitch))
        return [command_for(float(t)) for t in _MIX @ np.array([thrust, *torque])]

    def close(self) -> None:
        self.socket.close()


def _held(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


def euler(q: Any) -> tuple[float, float, float]:
    """Roll, pitch, yaw of (w, x, y, z)."""
    w, x, y, z = q
    return (
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x)))),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )
