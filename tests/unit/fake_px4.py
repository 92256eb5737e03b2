"""A stand-in for a PX4 at the other end of a link: its answers as measured on a real one, no physics at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from flightstack.types import Tuple3
from mavlink_bridge import messages as m
from mavlink_bridge.companion import Companion
from mavlink_bridge.link import Link, Signing

HOLD, LAND, OFFBOARD, POSITION, RTL = 0x03040000, 0x06040000, 0x00060000, 0x00030000, 0x05040000
STEP_US = 4_000
PARAMS = {
    "COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 0.0, "THR_MDL_FAC": 0.0, "MPC_THR_HOVER": 0.5, "MC_BAT_SCALE_EN": 0.0,
    "MC_ROLLRATE_MAX": 220.0, "MC_PITCHRATE_MAX": 220.0, "MC_YAWRATE_MAX": 200.0,
    "PWM_MAIN_FUNC1": 101.0, "PWM_MAIN_FUNC2": 102.0, "PWM_MAIN_FUNC3": 103.0, "PWM_MAIN_FUNC4": 104.0,
}  # fmt: skip
"""As a PX4 with its internal simulator has them; all sent as REAL32."""
REST: Tuple3 = (0.0, 0.0, 0.0)


@dataclass
class FakePx4:
    """Stands on the ground; accepts what a healthy PX4 accepts; the fields make it behave otherwise."""

    autopilot: int = 12
    type: int = 2
    system: int = 1
    armed: bool = False
    mode: int = HOLD
    landed: int = 1
    status: int = 4
    """HEARTBEAT's MAV_STATE; 8: its motors are stopped, by a kill switch or a flight termination."""
    intended: int | None = None
    """The mode that it goes back to when setpoints arrive; None: the present one."""
    tells_mode: bool = True
    """Whether it sends CURRENT_MODE."""
    flags: int = 1023
    accuracy_m: float = 0.1
    """Of the position across, as its estimator states it."""
    fix: int | None = None
    """GPS_RAW_INT's fix type, 8 times a second; None: no receiver, none is sent."""
    answers_version: bool = True
    arm_result: int = 0
    mode_result: int = 0
    texts: tuple[str, ...] = ()
    heartbeats: bool = True
    answers_heartbeat: bool = True
    """Whether it sends one on request."""
    streams: bool = True
    resets: int = 0
    """ODOMETRY's reset counter."""
    signing: Signing | None = None
    motion: Callable[[int], tuple[Tuple3, Tuple3, Tuple3]] = lambda now_us: (REST, REST, REST)
    """Position, velocity and acceleration at a time."""
    alter: Callable[[Any], Any | None] = lambda message: message
    """What becomes of attitude, position and IMU on their way; None: lost."""
    round_trip_us: int | None = None
    """It answers TIMESYNC as if asked so long before, half way there; None: it does not."""
    clock_us: Callable[[int], int] = lambda now_us: now_us
    """What its answers to TIMESYNC say of a time."""
    params: dict[str, float] = field(default_factory=lambda: dict(PARAMS))
    answers_params: bool = True
    lacks_param_error: bool = False
    setpoints: list[m.SetAttitudeTarget] = field(default_factory=list)
    commands: list[m.CommandLong] = field(default_factory=list)
    heard: list[object] = field(default_factory=list)
    """Setpoints and commands in their order."""

    def __post_init__(self) -> None:
        self.link = Link(self.system, 1, signing=self.signing)
        self._ticks = self._now_us = 0

    def step(self, now_us: int) -> None:
        """Answer what came in and send what is due."""
        self._now_us = now_us
        while (received := self.link.next_event()) is not None:
            self._take(received.message, received.system, received.component)
        if self.heartbeats and self._ticks % 250 == 0:
            self._send_heartbeat()
        if self._ticks % 25 == 0:
            self.link.send(m.ExtendedSysState(0, self.landed))
            if self.tells_mode:
                intended = self.mode if self.intended is None else self.intended
                self.link.send(m.CurrentMode(0, self.mode, intended))
        if self._ticks % 50 == 0:
            self.link.send(_estimator(now_us, self.flags)._replace(pos_horiz_accuracy_m=self.accuracy_m))
        if self.fix is not None and self._ticks % 31 == 0:
            self.link.send(m.GpsRawInt(0, self.fix, 47.4, 8.5, 489.0, 0.7, 1.1, 0.0, 0.0, 10 if self.fix else 0))
        if self.streams:
            self._send_state(now_us)
        self._ticks += 1

    def _send_heartbeat(self) -> None:
        self.link.send(
            m.Heartbeat(self.type, self.autopilot, 0x01 | (0x80 if self.armed else 0), self.mode, self.status)
        )

    def _send_state(self, now_us: int) -> None:
        """Level where `motion` says, with the least noise that a float can show: an estimate never repeats itself."""
        noise = 1e-6 * (self._ticks % 7)
        (n, e, d), (vn, ve, vd), acc = self.motion(now_us)
        for message in (
            m.AttitudeQuaternion(now_us, (1.0, 0.0, noise, 0.0), (0.0, noise, 0.0)),
            m.LocalPositionNed(now_us, (n + noise, e, d), (vn, ve + noise, vd)),
            _imu(now_us, noise, acc),
        ):
            altered = self.alter(message)
            if altered is not None:
                self.link.send(altered)
        if self._ticks % 10 == 0:
            self.link.send(_odometry(now_us, self.resets))

    def _take(self, message: object, system: int, component: int) -> None:
        if isinstance(message, m.SetAttitudeTarget):
            self.setpoints.append(message)
            self.heard.append(message)
        elif isinstance(message, m.ParamRequestRead) and self.answers_params:
            kind = m.PARAM_REAL32
            if message.param_id in self.params:
                bits = m.param_bits(self.params[message.param_id], kind)
                self.link.send(m.ParamValue(message.param_id, bits, kind, 875, 1))
            elif not self.lacks_param_error:
                self.link.send(m.ParamError(system, component, message.param_id, -1, 1))
        elif isinstance(message, m.Timesync) and self.round_trip_us is not None and not message.tc1_ns:
            half_us = self.round_trip_us // 2
            self.link.send(m.Timesync(1000 * (self.clock_us(self._now_us) - half_us), message.ts1_ns - 2000 * half_us))
        elif isinstance(message, m.CommandLong):
            self.commands.append(message)
            self.heard.append(message)
            self._obey(message, system, component)

    def _obey(self, command: m.CommandLong, system: int, component: int) -> None:
        def answer(result: int) -> None:
            self.link.send(m.CommandAck(command.command, result, 0, 0, system, component))

        if command.command == 176:
            answer(0)  # the receiver's word, before the commander's
            answer(self.mode_result)
            if self.mode_result == 0:
                self.mode = int(command.params[1]) << 16 | int(command.params[2] or 0) << 24
        elif command.command == 400:
            answer(self.arm_result)
            for text in self.texts if self.arm_result else ():
                self.link.send(m.Statustext(2, text))
            self.armed = command.params[0] == 1.0 and (self.armed or self.arm_result == 0)
        elif command.command == 512:
            if command.params[0] == m.id_of(m.Heartbeat):
                if self.answers_heartbeat:
                    answer(0)
                    self._send_heartbeat()
            elif command.params[0] == m.id_of(m.CurrentMode):
                answer(0)
                self.link.send(m.CurrentMode(0, self.mode, self.mode))
            elif self.answers_version:
                answer(0)
                self.link.send(m.AutopilotVersion(0xE8FF, 0x01120040))
        else:
            answer(0)

    def set_modes(self, command: int) -> list[m.CommandLong]:
        """Commands of one number that arrived."""
        return [given for given in self.commands if given.command == command]


def _estimator(now_us: int, flags: int) -> m.EstimatorStatus:
    return m.EstimatorStatus(now_us, flags, *(0.1 for _ in m.EstimatorStatus._fields[2:]))


def _odometry(now_us: int, resets: int) -> m.Odometry:
    return m.Odometry(now_us, 1, 1, REST, (1.0, 0.0, 0.0, 0.0), REST, REST, resets)


def _imu(now_us: int, noise: float, acc: Tuple3) -> m.HighresImu:
    force = (acc[0] + noise, acc[1], acc[2] - 9.80665)
    return m.HighresImu(now_us, force, (0.0, 0.0, 0.0), (0.2, 0.0, 0.4), 955.0, 0.0, 488.0, 20.0, 63)


def exchange(
    companion: Companion,
    vehicle: FakePx4,
    seconds: float,
    *,
    start_us: int = 0,
    until: Callable[[], bool] | None = None,
    each: Callable[[int], None] | None = None,
) -> int:
    """Let both run in lockstep, every datagram delivered at once; the time at the end."""
    now_us = start_us
    for _ in range(round(seconds * 1e6 / STEP_US)):
        now_us += STEP_US
        if each is not None:
            each(now_us)
        vehicle.step(now_us)
        for data in vehicle.link.datagrams_to_send():
            companion.receive_datagram(data, now_us)
        companion.step(now_us)
        for data in companion.link.datagrams_to_send():
            vehicle.link.receive_datagram(data, now_us)
        if companion.done or (until is not None and until()):
            vehicle.step(now_us)  # what was said last is heard
            break
    return now_us
