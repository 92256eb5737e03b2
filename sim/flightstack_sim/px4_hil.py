"""The physics behind a real PX4, sans-IO: sensors out, motor commands in, in lockstep with PX4's clock.

    hil.receive(data)        whatever came from PX4 (any piece of the TCP stream)
    hil.advance()            4 ms of physics under PX4's last motor commands, then the sensors of that moment
    hil.to_send()            what PX4 gets
    hil.answered             whether PX4 has answered the last HIL_SENSOR

PX4 is the TCP client.  HIL_SENSOR's time_usec sets its clock; in lockstep (flags bit 0 of HIL_ACTUATOR_CONTROLS) it
answers every one with the motor commands that follow from it.  Until the first answer there is none to wait for.
PX4's clock starts with the first sensor message, so an answer carries that moment less a constant: the smallest
difference seen is the one of answers in time, a larger one is an answer to an older message.
Motors are PX4's quad-x in its own order, commands 0..1 after PX4's output scaling, 0 while disarmed.
Source: PX4 user guide "Simulation" (simulator MAVLink API), MAVLink's HIL messages.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from flightstack.geodesy import PX4_SIH, LocalFrame
from flightstack.types import Tuple3
from flightstack.vehicle import Vehicle
from flightstack_sim.grade import Grade
from flightstack_sim.plant import make_plant
from flightstack_sim.sensors import Sensors
from mavlink_bridge import messages as m
from mavlink_bridge.events.hil import HilActuatorControls, HilGps, HilSensor
from mavlink_bridge.framing import StreamFraming
from mavlink_bridge.link import Link, Received
from mavlink_bridge.px4 import ARMED_BIT, Cmd, Result

STEP_MS: Final = 4
STEP_US: Final = 1000 * STEP_MS
MAG_PERIOD_US: Final = 12_000
BARO_PERIOD_US: Final = 20_000
GPS_PERIOD_US: Final = 100_000
STATE_PERIOD_US: Final = 20_000
SECOND_US: Final = 1_000_000
UNIX_AT_BOOT_US: Final = 1_767_225_600_000_000

GPS_DELAY_S: Final = 0.010
"""PX4's EKF2_GPS_DELAY behind a MAVLink simulator (its start-up sets it so for airframes such as 10016, none_iris): a
fix is to be so old when it arrives.  The stream has no stamp for that, so a wrong age is an error of position: 0.1 s at
3 m/s are 0.3 m."""

_IMU_FIELDS, _MAG_FIELDS, _BARO_FIELDS = 0x3F, 0x1C0, 0x1A00
_LEAST_ERROR_M: Final = 0.3
"""No receiver claims to be better; PX4 wants a figure that isn't 0."""
_TEMPERATURE_DEGC: Final = 11.8  # standard atmosphere at 489 m
_LOCKSTEP: Final = 1


class PhysicsBehindPx4:
    """One simulated vehicle for one PX4, at rest on the ground when it begins."""

    def __init__(
        self, truth: Vehicle, grade: Grade, *, seed: int, plant: str = "native", frame: LocalFrame = PX4_SIH
    ) -> None:
        grade = replace(grade, fix=replace(grade.fix, delay_s=GPS_DELAY_S))
        plant_seed, sensor_seed = np.random.SeedSequence(seed).spawn(2)
        self.plant = make_plant(plant, truth, seed=int(plant_seed.generate_state(1)[0]))
        self.sensors = Sensors(grade, seed=sensor_seed)
        self.link = Link(1, 51, framing=StreamFraming())
        self.motors = np.zeros(4)
        self.armed = False
        self.lockstep = False
        """PX4 has answered and says that it runs in lockstep."""
        self.steps = self.answers = 0
        self._frame = frame
        self._offset_us = math.inf
        self._answered_us = -1
        self._due = dict.fromkeys(("mag", "baro", "gps", "state", "second"), 0)
        self._state_period_us = STATE_PERIOD_US
        self._fixes = 0
        self._mag: Tuple3 = (0.0, 0.0, 0.0)
        self._pressure_hpa = 0.0
        for _ in range(2 * STEP_MS):
            self.sensors.step(self.plant)

    @property
    def t_us(self) -> int:
        """Simulated time."""
        return self.plant.t_us

    @property
    def frame(self) -> LocalFrame:
        """Where the plant's origin lies on the globe."""
        return self._frame

    def set_gps_delay(self, delay_s: float) -> None:
        """From now on fixes arrive so old: what PX4's EKF2_GPS_DELAY says."""
        self.sensors.set_fix_delay(min(max(delay_s, 0.0), 1.0))

    @property
    def answered(self) -> bool:
        """Whether PX4's motor commands for the present moment are here."""
        return self._answered_us >= self.plant.t_us

    # --- in ---

    def receive(self, data: bytes) -> None:
        """Take what came; what is no message, or none of PX4's, is dropped and counted (`link.stats`)."""
        self.link.receive_datagram(data, self.plant.t_us)
        while (received := self.link.next_event()) is not None:
            if isinstance(received.message, HilActuatorControls):
                self._take_controls(received.message)
            elif isinstance(received.message, m.CommandLong):
                self._take_command(received)

    def _take_controls(self, message: HilActuatorControls) -> None:
        self.armed = bool(message.mode & ARMED_BIT)
        self.lockstep = bool(message.flags & _LOCKSTEP)
        for index in range(4):
            command = message.controls[index] if self.armed else 0.0
            self.motors[index] = min(max(command, 0.0), 1.0) if math.isfinite(command) else 0.0
        self.answers += 1
        difference_us = self.plant.t_us - message.t_us
        self._offset_us = min(self._offset_us, difference_us)
        if difference_us <= self._offset_us:
            self._answered_us = self.plant.t_us

    def _take_command(self, received: Received) -> None:
        """SET_MESSAGE_INTERVAL of HIL_STATE_QUATERNION; PX4 asks for the truth at 200 Hz, for its log."""
        command: m.CommandLong = received.message
        number, interval_us = command.params[0], command.params[1]
        known = command.command == Cmd.SET_MESSAGE_INTERVAL and number == m.id_of(m.HilStateQuaternion)
        if known and math.isfinite(interval_us):
            period_us = STATE_PERIOD_US if interval_us == 0.0 else min(abs(interval_us), 1e12)
            self._state_period_us = 1 << 60 if interval_us < 0.0 else max(STEP_US, int(period_us))
            self._due["state"] = self.plant.t_us
        result = Result.ACCEPTED if known else Result.UNSUPPORTED
        self.link.send(m.CommandAck(command.command, int(result), 0, 0, received.system, received.component))

    # --- forward ---

    def advance(self) -> None:
        """STEP_MS of physics and the messages of its end."""
        for _ in range(STEP_MS):
            self.plant.step(self.motors)
            self.sensors.step(self.plant)
        self.steps += 1
        self.link.send(self._hil_sensor())
        if self._is_due("second", SECOND_US):
            self.link.send(m.Heartbeat(0, 8, 0, 0, 4))
            self.link.send(m.SystemTime(UNIX_AT_BOOT_US + self.t_us, self.t_us))
        if self.sensors.fix_count != self._fixes and self._is_due("gps", GPS_PERIOD_US):
            self._fixes = self.sensors.fix_count
            self.link.send(self._hil_gps())
        if self._is_due("state", self._state_period_us):
            self.link.send(self._hil_state())

    def to_send(self) -> bytes:
        """Everything queued, as one piece of the stream."""
        return b"".join(self.link.datagrams_to_send())

    def _is_due(self, name: str, period_us: int) -> bool:
        now_us = self.plant.t_us
        if now_us < self._due[name]:
            return False
        self._due[name] = max(self._due[name] + period_us, now_us - period_us)
        return True

    # --- what is sent ---

    def _hil_sensor(self) -> HilSensor:
        sensors, fields = self.sensors, _IMU_FIELDS
        if self._is_due("mag", MAG_PERIOD_US):
            fields |= _MAG_FIELDS
            self._mag = sensors.mag_frd_gauss()
        if self._is_due("baro", BARO_PERIOD_US):
            fields |= _BARO_FIELDS
            self._pressure_hpa = sensors.pressure_hpa()
        rate_x, rate_y, rate_z, x, y, z = _finite(sensors.mean_imu.tolist())
        height_m = 44330.8 * (1.0 - (self._pressure_hpa / 1013.25) ** 0.190263)
        return HilSensor(
            self.t_us, (x, y, z), (rate_x, rate_y, rate_z), self._mag, self._pressure_hpa, 0.0, height_m,
            _TEMPERATURE_DEGC, fields,
        )  # fmt: skip

    def _hil_gps(self) -> HilGps:
        fix = self.sensors.fix
        assert fix is not None  # one has just been counted
        lat, lon = self._frame.to_globe(fix.pos_ned_m[0], fix.pos_ned_m[1])
        north, east, down = fix.vel_ned_mps
        return HilGps(
            self.t_us, 3, lat, lon, self._frame.altitude_m - fix.pos_ned_m[2],
            max(_LEAST_ERROR_M, fix.pos_horizontal_std_m), max(_LEAST_ERROR_M, fix.pos_vertical_std_m),
            math.hypot(north, east), north, east, down, math.degrees(math.atan2(east, north)) % 360.0, 10,
        )  # fmt: skip

    def _hil_state(self) -> m.HilStateQuaternion:
        """The truth, for PX4's log."""
        plant = self.plant
        north, east, down = plant.pos_ned_m.tolist()
        lat, lon = self._frame.to_globe(north, east)
        w, x, y, z = plant.q_ned_frd.tolist()
        p, q, r = plant.rate_frd_radps.tolist()
        v_north, v_east, v_down = plant.vel_ned_mps.tolist()
        a_x, a_y, a_z = plant.specific_force_frd_mps2.tolist()
        speed = math.hypot(v_north, v_east, v_down)
        return m.HilStateQuaternion(
            self.t_us, (w, x, y, z), (p, q, r), lat, lon, self._frame.altitude_m - down, (v_north, v_east, v_down),
            speed, speed, (a_x, a_y, a_z),
        )  # fmt: skip


def _finite(values: list[float]) -> list[float]:
    """The same, 0 for what is no number: PX4 must never be fed one."""
    return [value if math.isfinite(value) else 0.0 for value in values]
