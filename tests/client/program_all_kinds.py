"""A program that asks in every way that OFFBOARD has: places, velocities, attitudes, body rates; one after the other.

    python tests/client/program_all_kinds.py udpin:127.0.0.1:14640 [HEIGHT_M [HOVER_THRUST]]

Each for 16 s about the place of take-off; by attitudes and rates it holds its place and height by itself, as a program
with a controller of its own does.  Prints how far it was from what it asked for: rms of place (m) or velocity (m/s).
"""

from __future__ import annotations

import math
import sys
import time

from shielded_program import HEIGHT_M, MAV, OFFBOARD, POSITION, VELOCITY, Program

KIND_S, PERIOD_S, LEG_S = 16.0, 0.02, 4.0
CORNERS = (3.0, 0.0), (3.0, 3.0), (0.0, 3.0), (0.0, 0.0)
SPEED_MPS, LAP_S = 1.0, 8.0
LEAN_MAX_RAD, PLACE_GAIN, SPEED_GAIN, TURN_GAIN = 0.15, 0.06, 0.12, 4.0
CLIMB_GAIN, SINK_GAIN = 0.05, 0.10
ATTITUDE, RATES = 0b111, 0b1000_0000


class Client(Program):
    """A program that knows its attitude too."""

    def __init__(self, address: str) -> None:
        super().__init__(address)
        self.place, self.velocity = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        self.roll = self.pitch = self.yaw = 0.0
        self.began_s = time.monotonic()

    def target(self, mask: int, place: tuple[float, ...], velocity: tuple[float, ...]) -> None:
        """A place or a velocity."""
        self.link.mav.set_position_target_local_ned_send(
            0, self.vehicle, 1, 1, mask, *place, *velocity, 0, 0, 0, self.yaw, 0
        )
        self.listen()

    def by_lean(self, mask: int, height_m: float, hover: float) -> None:
        """Hold the place of take-off by leaning against the error, asked for as an attitude or as body rates."""
        (north, east, down), (vel_n, vel_e, vel_d) = self.place, self.velocity
        ahead, right = -PLACE_GAIN * north - SPEED_GAIN * vel_n, -PLACE_GAIN * east - SPEED_GAIN * vel_e
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        pitch, roll = (
            max(-LEAN_MAX_RAD, min(LEAN_MAX_RAD, lean))
            for lean in (-(cosine * ahead + sine * right), cosine * right - sine * ahead)
        )
        thrust = hover * (1.0 + CLIMB_GAIN * 4.0 * (height_m + down) + SINK_GAIN * 4.0 * vel_d)
        rates = TURN_GAIN * (roll - self.roll), TURN_GAIN * (pitch - self.pitch), 0.0
        half_roll, half_pitch, half_yaw = roll / 2.0, pitch / 2.0, self.yaw / 2.0
        cr, sr, cp, sp, cy, sy = (f(a) for a in (half_roll, half_pitch, half_yaw) for f in (math.cos, math.sin))
        q = [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
             cr * cp * sy - sr * sp * cy]  # fmt: skip
        self.link.mav.set_attitude_target_send(0, self.vehicle, 1, mask, q, *rates, max(0.05, min(0.9, thrust)))
        self.listen()

    def listen(self) -> None:
        """For a period."""
        ends_s = time.monotonic() + PERIOD_S
        while (left_s := ends_s - time.monotonic()) > 0.0:
            heard = self.link.recv_match(
                type=["HEARTBEAT", "LOCAL_POSITION_NED", "ATTITUDE"], blocking=True, timeout=left_s
            )
            if heard is None or (heard.get_srcSystem(), heard.get_srcComponent()) != (self.vehicle, 1):
                continue
            if heard.get_type() == "HEARTBEAT":
                self.mode, self.armed = heard.custom_mode, bool(heard.base_mode & MAV.MAV_MODE_FLAG_SAFETY_ARMED)
            elif heard.get_type() == "ATTITUDE":
                self.roll, self.pitch, self.yaw = heard.roll, heard.pitch, heard.yaw
            else:
                self.place, self.velocity = (heard.x, heard.y, heard.z), (heard.vx, heard.vy, heard.vz)


def take_off(client: Client, height_m: float) -> None:
    """Until it is up."""
    ticks = 0
    while -client.place[2] < 0.9 * height_m:
        client.target(POSITION, (0.0, 0.0, -height_m), (0.0, 0.0, 0.0))
        ticks += 1
        if ticks % 50 == 0 and client.mode != OFFBOARD:
            client.command(MAV.MAV_CMD_DO_SET_MODE, 1.0, 6.0)
        elif ticks % 50 == 0 and not client.armed:
            client.command(MAV.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    print("up", flush=True)


def ask_for(client: Client, kind: str, height_m: float, hover: float, t_s: float) -> float | None:
    """One period of a kind; how far off, None: not judged by now."""
    if kind == "places":
        corner = (*CORNERS[int(t_s / LEG_S) % len(CORNERS)], -height_m)
        client.target(POSITION, corner, (0.0, 0.0, 0.0))
        return math.dist(client.place, corner) if t_s % LEG_S > LEG_S - 1.0 else None
    if kind == "velocities":
        angle = 2.0 * math.pi * t_s / LAP_S
        wanted = SPEED_MPS * math.cos(angle), SPEED_MPS * math.sin(angle), 0.0
        client.target(VELOCITY, (0.0, 0.0, 0.0), wanted)
        return math.dist(client.velocity, wanted) if t_s > 2.0 else None
    client.by_lean(ATTITUDE if kind == "attitudes" else RATES, height_m, hover)
    return math.dist(client.place, (0.0, 0.0, -height_m)) if t_s > KIND_S / 2.0 else None


def main(address: str, height_m: float, hover: float) -> None:
    """Every kind once, then it holds its place until somebody ends it."""
    client = Client(address)
    take_off(client, height_m)
    for kind in ("places", "velocities", "places", "attitudes", "rates"):
        began_s, errors = time.monotonic(), []
        while (t_s := time.monotonic() - began_s) < KIND_S:
            error = ask_for(client, kind, height_m, hover, t_s)
            errors += [error] if error is not None else []
        rms = math.sqrt(sum(error * error for error in errors) / len(errors))
        print(f"{kind} {rms:.2f} most {max(errors):.2f}", flush=True)
    print("done", flush=True)
    while True:
        client.target(POSITION, (0.0, 0.0, -height_m), (0.0, 0.0, 0.0))


if __name__ == "__main__":
    given = (*sys.argv[2:4], *(HEIGHT_M, "0.343")[len(sys.argv) - 2 :])
    main(sys.argv[1], float(given[0]), float(given[1]))
