"""Two things at once on figure8 and in a site: a link of 15 ms each way, and whoever interferes besides."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable

from pymavlink.dialects.v10 import common as mavlink1
from pymavlink.dialects.v20 import common

from benchmarks.px4.deeds import HOLD, LAND, RETURN, Attack, flown
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.relay import Manner, Relay
from benchmarks.px4.scene import LIMIT_S, OFFBOARD, Scene
from benchmarks.px4.station import OFFBOARD_PORT
from benchmarks.px4.subjects.attacks import ASKED as ASKED
from benchmarks.px4.subjects.interference import linked
from benchmarks.px4.subjects.kills import in_site

RUNS = 1
_VEHICLE_PORT = 14580
"""PX4's end of the offboard link."""
_INTERVAL, _ARM, _STICK_S = 511, 400, 0.04
_ATTITUDE, _QUATERNION, _POSITION, _IMU, _ODOMETRY, _FIXES = 30, 31, 32, 105, 331, 24
LATE = Manner(up_s=0.015, down_s=0.015)


def run(bench: Bench, runs: int) -> list[Row]:
    """Every one `runs` times; `ATTACKS` in the environment names those to fly."""
    return flown(bench, runs, ATTACKS)


def _late(deed: Callable[[Scene], None], *more: str, scenario: str = "figure8") -> Callable[[Scene], None]:
    """A deed in a flight whose link takes 15 ms each way."""

    def whole(scene: Scene) -> None:
        with Relay(OFFBOARD_PORT + scene.px4.instance, LATE) as relay:
            scene.begin("--connect", f"udpin:127.0.0.1:{relay.port}", *more, scenario=scenario)
            scene.began_s = time.monotonic()
            deed(scene)
            scene.wait(lambda: scene.ended, LIMIT_S)

    return whole


def _straight(deed: Callable[[Scene], None], *, site: bool = False) -> Callable[[Scene], None]:
    def whole(scene: Scene) -> None:
        scene.begin(*(in_site(scene.folder) if site else ()), scenario="gps-barrier" if site else "figure8")
        scene.began_s = time.monotonic()
        deed(scene)
        scene.wait(lambda: scene.ended, LIMIT_S)

    return whole


def _mode(*mode: float) -> Callable[[Scene], None]:
    return lambda scene: (scene.mode(*mode), time.sleep(5.0))[1]


def _set(*params: tuple[str, float], seconds: float = 0.0) -> Callable[[Scene], None]:
    def deed(scene: Scene) -> None:
        for name, value in params:
            scene.px4.set_param(name, value)
        time.sleep(seconds)

    return deed


def _after(*deeds: Callable[[Scene], None]) -> Callable[[Scene], None]:
    def whole(scene: Scene) -> None:
        for deed in deeds:
            deed(scene)

    return whole


def _signal(number: int, seconds: float = 0.0) -> Callable[[Scene], None]:
    def deed(scene: Scene) -> None:
        assert scene.process is not None
        scene.process.send_signal(number)
        time.sleep(seconds)

    return deed


def _while_landing(*mode: float) -> Callable[[Scene], None]:
    """When PX4 is told to land at the flight's end, the pilot wants something else."""

    def deed(scene: Scene) -> None:
        scene.wait(lambda: scene.px4.mode >> 16 & 0xFF != OFFBOARD or scene.ended, LIMIT_S)
        time.sleep(0.3)
        scene.began_s = time.monotonic()
        scene.mode(*mode)
        time.sleep(8.0)

    return deed


def _at_touchdown(scene: Scene) -> None:
    """The pilot chooses OFFBOARD when the vehicle stands again, and the stream may not fly it."""
    scene.wait(lambda: scene.px4.mode >> 16 & 0xFF != OFFBOARD or scene.ended, LIMIT_S)
    scene.wait(lambda: scene.px4.height_m < 0.1 or scene.ended, LIMIT_S)
    scene.began_s = time.monotonic()
    scene.mode(float(OFFBOARD))
    time.sleep(3.0)
    scene.px4.command(_ARM, 1.0, 0.0)
    time.sleep(5.0)


def _sticks(scene: Scene) -> None:
    """Sticks are pushed and Position is chosen, for 5 s."""
    for number in range(round(5.0 / _STICK_S)):
        scene.px4.link.mav.manual_control_send(scene.px4.instance + 1, 400, -300, 500, 200, 0)
        if number == 5:
            scene.mode(3.0)
        time.sleep(_STICK_S)


def _intervals(*streams: int, every_us: float, times: int = 1) -> Callable[[Scene], None]:
    """Another ground station asks on the companion's own link for slow streams."""

    def deed(scene: Scene) -> None:
        mav = common.MAVLink(None, srcSystem=250, srcComponent=190)
        target = ("127.0.0.1", _VEHICLE_PORT + scene.px4.instance)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            for _ in range(times):
                for number in streams:
                    word = mav.command_long_encode(
                        scene.px4.instance + 1, 1, _INTERVAL, 0, float(number), every_us, 0, 0, 0, 0, 0
                    )
                    out.sendto(word.pack(mav), target)
                time.sleep(1.0)

    return deed


def _flood(seconds: float, *frames: bytes) -> Callable[[Scene], None]:
    """Five thousand datagrams a second to the companion's port, junk where no frames are given."""

    def deed(scene: Scene) -> None:
        junk = [os.urandom(24 + 16 * number % 260) for number in range(97)] if not frames else list(frames)
        target = ("127.0.0.1", OFFBOARD_PORT + scene.px4.instance)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            begun_s, sent = time.monotonic(), 0
            while (past_s := time.monotonic() - begun_s) < seconds:
                for _ in range(round(5000.0 * past_s) - sent):
                    out.sendto(junk[sent % len(junk)], target)
                    sent += 1
                time.sleep(0.002)

    return deed


def _others(system: int, *, first: bool = False) -> tuple[bytes, ...]:
    """Well-formed words of another vehicle, in MAVLink 1 or 2."""
    dialect = mavlink1 if first else common
    mav = dialect.MAVLink(None, srcSystem=system, srcComponent=1)
    said = [
        mav.heartbeat_encode(2, 12, 0x81, 0x00060000, 4),
        mav.local_position_ned_encode(1000, 50.0, 50.0, -50.0, 9.0, 9.0, 9.0),
        mav.attitude_quaternion_encode(1000, 0.0, 1.0, 0.0, 0.0, 5.0, 5.0, 5.0),
    ]
    return tuple(message.pack(mav) for message in said)


def _estimator_stopped(scene: Scene) -> None:
    """By PX4's own shell: attitude and position stop coming."""
    words = [f"{os.environ['PX4_SHELL']}/px4-ekf2", "--instance", str(scene.px4.instance), "stop"]
    scene.others.append(subprocess.Popen(words))  # it may never answer


def _rebooted(scene: Scene) -> None:
    scene.px4.signal(signal.SIGKILL)
    time.sleep(0.2)
    scene.px4.restart()


def _gps_gone(seconds: float) -> Callable[[Scene], None]:
    """No satellite for so long: the estimate drifts, and jumps when they are back."""
    return _after(_set(("SIM_GPS_USED", 0.0), seconds=seconds), _set(("SIM_GPS_USED", 10.0)))


def _two_stations(scene: Scene) -> None:
    """A second ground station of the same system id contradicts the first: Hold and OFFBOARD by turns."""
    for _ in range(6):
        scene.mode(*HOLD)
        time.sleep(0.05)
        scene.mode(float(OFFBOARD))
        time.sleep(0.05)
    scene.mode(*HOLD)
    time.sleep(5.0)


ATTACKS: dict[str, Attack] = {
    "15/15 ms, Hold": Attack(_late(_mode(*HOLD))),
    "15/15 ms, Return": Attack(_late(_mode(*RETURN))),
    "15/15 ms, Position by sticks": Attack(_late(_sticks)),
    "15/15 ms, killed": Attack(_late(_signal(signal.SIGKILL, 5.0)), codes=(-9,)),
    "15/15 ms, stopped for 0.3 s": Attack(
        _late(_after(_signal(signal.SIGSTOP, 0.3), _signal(signal.SIGCONT))), codes=(0, 1)
    ),
    "15/15 ms, two stations quarrel": Attack(_late(_two_stations), keeps=False),
    "15/15 ms, PX4 started anew": Attack(_late(_rebooted), soft=False),
    "15/15 ms, battery empty": Attack(
        _late(_set(("SIM_BAT_MIN_PCT", 0.0))), params=(("SIM_BAT_DRAIN", 8.0), ("COM_LOW_BAT_ACT", 3.0))
    ),
    "15/15 ms, MPC_THR_HOVER 0.2, COM_OF_LOSS_T 5, killed": Attack(
        _late(_after(_set(("MPC_THR_HOVER", 0.2), ("COM_OF_LOSS_T", 5.0)), _signal(signal.SIGKILL, 6.0))), codes=(-9,)
    ),
    "15/15 ms, no GPS for 3 s": Attack(_late(_gps_gone(3.0)), codes=(0, 1)),
    "15/15 ms, the estimator stopped": Attack(_late(_estimator_stopped), soft=False),
    "15/15 ms, flood of junk at 5 kHz": Attack(_late(_flood(8.0)), codes=(0, 1)),
    "15/15 ms and 5 % lost, Hold": Attack(
        linked(LATE._replace(lost=0.05), (LATE._replace(lost=0.05, doubled=0.05, jitter_s=0.005), 4.0)), codes=(0, 1)
    ),
    "flood of junk at 5 kHz": Attack(_straight(_flood(8.0)), codes=(0, 1)),
    "flood of another vehicle's words at 5 kHz": Attack(_straight(_flood(8.0, *_others(9))), codes=(0, 1)),
    "flood of another vehicle's MAVLink 1 at 5 kHz": Attack(
        _straight(_flood(8.0, *_others(9, first=True))), codes=(0, 1)
    ),
    "streams at 5 Hz by another station": Attack(
        _straight(_intervals(_ATTITUDE, _QUATERNION, _POSITION, _IMU, _ODOMETRY, every_us=200_000.0)), codes=(0, 1)
    ),
    "streams at 5 Hz by another station, again and again": Attack(
        _straight(_intervals(_ATTITUDE, _QUATERNION, _POSITION, _IMU, _ODOMETRY, every_us=200_000.0, times=8)),
        codes=(0, 1),
    ),
    "ODOMETRY off by another station, then no GPS for 6 s": Attack(
        _straight(_after(_intervals(_ODOMETRY, every_us=-1.0), _gps_gone(6.0))), codes=(0, 1)
    ),
    "satellites' stream off by another station": Attack(_straight(_intervals(_FIXES, every_us=-1.0)), codes=(0,)),
    "satellites' stream off by another station, then no GPS for 6 s": Attack(
        _straight(_after(_intervals(_FIXES, every_us=-1.0), _gps_gone(6.0))), codes=(0, 1)
    ),
    "no GPS for 1 s": Attack(_straight(_gps_gone(1.0)), codes=(0, 1)),
    "no GPS for 6 s": Attack(_straight(_gps_gone(6.0)), codes=(0, 1)),
    "MAV_PROTO_VER 1 (PX4 speaks MAVLink 1 only)": Attack(
        _straight(lambda scene: None), codes=(0, 1), params=(("MAV_PROTO_VER", 1.0),)
    ),
    "OFFBOARD while it lands": Attack(_straight(_while_landing(float(OFFBOARD))), codes=(0, 1), keeps=False),
    "Hold while it lands": Attack(_straight(_while_landing(*HOLD)), codes=(0, 1)),
    "OFFBOARD and armed as it stands again": Attack(_straight(_at_touchdown), codes=(0, 1), keeps=False),
    "in a site: Hold": Attack(_straight(_mode(*HOLD), site=True), params=(("SIH_MASS", 0.7),)),
    "in a site: Land": Attack(_straight(_mode(*LAND), site=True), params=(("SIH_MASS", 0.7),)),
    "in a site: no GPS for 3 s": Attack(
        _straight(_gps_gone(3.0), site=True), codes=(0, 1), params=(("SIH_MASS", 0.7),)
    ),
    "in a site: killed": Attack(
        _straight(_signal(signal.SIGKILL, 5.0), site=True), codes=(-9,), params=(("SIH_MASS", 0.7),)
    ),
    "in a site: flood of junk at 5 kHz": Attack(
        _straight(_flood(8.0), site=True), codes=(0, 1), params=(("SIH_MASS", 0.7),)
    ),
}  # fmt: skip
