"""Any offboard program behind `flightstack shield`: pymavlink, velocities only, and no idea of the site.

    flightstack sim
    flightstack shield --connect udpin:127.0.0.1:14540 --serve udpout:127.0.0.1:14640 --site site.toml
    python tests/client/shielded_program.py udpin:127.0.0.1:14640 [HEIGHT_M [YAW_DEG_S]]

Takes off and races north and south at 4 m/s, 15 m to each side or as far as the site goes, until Ctrl-C; with a yaw
rate it turns at that on the spot instead.
"""

from __future__ import annotations

import math
import sys
import time
from typing import Any

from pymavlink import mavutil

MAV = mavutil.mavlink
SPEED_MPS, REACH_M, HEIGHT_M = 4.0, 15.0, "2.5"
POSITION, VELOCITY, TURN = 0b1001_1111_1000, 0b1001_1100_0111, 0b0101_1100_0111
OFFBOARD = 6 << 16


class Program:
    """The vehicle as a program sees it, and what it asks for."""

    def __init__(self, address: str) -> None:
        self.link: Any = mavutil.mavlink_connection(address, source_system=245, source_component=190)
        self.vehicle = self._autopilot()
        self.mode, self.armed, self.north_m, self.height_m, self.speed_mps = 0, False, 0.0, 0.0, 0.0

    def _autopilot(self) -> int:
        """The first system that is one: a PX4 passes a ground station's heartbeats on."""
        while (heard := self.link.wait_heartbeat(timeout=60)) is not None:
            if heard.autopilot != MAV.MAV_AUTOPILOT_INVALID:
                return int(heard.get_srcSystem())
        raise TimeoutError("no autopilot heard")

    def ask(self, mask: int, north: float, down: float, yaw_radps: float = 0.0) -> None:
        """Send a setpoint, then listen for 20 ms."""
        place = (north, 0.0, down) * 2
        self.link.mav.set_position_target_local_ned_send(0, self.vehicle, 1, 1, mask, *place, 0, 0, 0, 0, yaw_radps)
        ends_s = time.monotonic() + 0.02
        while (left_s := ends_s - time.monotonic()) > 0.0:
            message = self.link.recv_match(type=["HEARTBEAT", "LOCAL_POSITION_NED"], blocking=True, timeout=left_s)
            if message is None or (message.get_srcSystem(), message.get_srcComponent()) != (self.vehicle, 1):
                continue
            if message.get_type() == "HEARTBEAT":
                self.mode, self.armed = message.custom_mode, bool(message.base_mode & MAV.MAV_MODE_FLAG_SAFETY_ARMED)
            else:
                self.north_m, self.height_m, self.speed_mps = message.x, -message.z, message.vx

    def command(self, number: int, *params: float) -> None:
        """Send a command and wait for nothing."""
        given = (*params, *(0.0,) * (7 - len(params)))
        self.link.mav.command_long_send(self.vehicle, 1, number, 0, *given)


def main(address: str, height_m: float, yaw_degps: float) -> None:
    """Until somebody ends it."""
    program, ticks, sign, fast = Program(address), 0, 1.0, 0.0
    while program.height_m < 0.9 * height_m:
        program.ask(POSITION, 0.0, -height_m)
        ticks += 1
        if ticks % 50 == 0 and program.mode != OFFBOARD:
            program.command(MAV.MAV_CMD_DO_SET_MODE, 1.0, 6.0)
        elif ticks % 50 == 0 and not program.armed:
            program.command(MAV.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    print("up", flush=True)
    while yaw_degps:
        program.ask(TURN, 0.0, 0.0, math.radians(yaw_degps))
    while True:
        program.ask(VELOCITY, sign * SPEED_MPS, 0.0)
        if sign * program.north_m > REACH_M:
            sign = -sign
        if sign * program.speed_mps > 0.75 * SPEED_MPS and fast != sign:
            fast = sign
            print("north" if sign > 0.0 else "south", flush=True)


if __name__ == "__main__":
    height, turn = (*sys.argv[2:4], *(HEIGHT_M, "0")[len(sys.argv) - 2 :])
    main(sys.argv[1], float(height), float(turn))
