"""What nobody had flown yet: PX4's own missions and fences, odd places of the earth, dying parts, routers, signals."""

from __future__ import annotations

import math
import resource
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from pymavlink.dialects.v20 import common

from benchmarks.px4.companion import start
from benchmarks.px4.deeds import (
    ARM,
    HOLD,
    RETURN,
    Attack,
    flown,
    parameters_set,
    pilot_takes_off,
    signalled,
    wait_for_pilot,
    while_waiting,
)
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.relay import Manner, Relay
from benchmarks.px4.scene import AIRBORNE_M, LIMIT_S, OFFBOARD, TRACK_S, Scene
from benchmarks.px4.station import OFFBOARD_PORT
from benchmarks.px4.subjects.attacks import ASKED as ASKED
from benchmarks.px4.subjects.interference import shell
from benchmarks.px4.subjects.strangers import PLACE

RUNS = 1
_HIGH = """schema = "flightstack.scenario/1"
name = "high"
description = "a hover 12 m up"
duration_s = 20.0

[trajectory]
kind = "hover"
position_m = [0.0, 0.0, -12.0]
"""
_M_PER_DEG = 111_194.9
_MISSION, _FENCE = 0, 1
_WAYPOINT, _FENCE_INSIDE, _SET_HOME, _INJECT_FAILURE, _MOTOR, _OFF = 16, 5001, 179.0, 420.0, 101.0, 1.0
_ACTUATOR_TEST, _CALIBRATION, _REBOOT, _STORAGE = 310.0, 241.0, 246.0, 245.0
_AUTO_MISSION = (4.0, 4.0)
_STICK_S = 0.04


def run(bench: Bench, runs: int) -> list[Row]:
    """Every one `runs` times; `ATTACKS` in the environment names those to fly."""
    return flown(bench, runs, ATTACKS)


def _in_flight(*deeds: Callable[[Scene], None], watched_s: float = LIMIT_S) -> Callable[[Scene], None]:
    """One thing after the other in flight."""

    def whole(scene: Scene) -> None:
        scene.begin()
        scene.began_s = time.monotonic()
        for deed in deeds:
            deed(scene)
        scene.wait(lambda: scene.ended, watched_s)

    return whole


def _mode(*mode: float, watched_s: float = 5.0) -> Callable[[Scene], None]:
    return lambda scene: (scene.mode(*mode), time.sleep(watched_s))[1]


def _commands(*commands: tuple[float, ...], apart_s: float = 0.5) -> Callable[[Scene], None]:
    def deed(scene: Scene) -> None:
        for number, *params in commands:
            scene.px4.command(int(number), *params)
            time.sleep(apart_s)

    return deed


def _uploaded(
    kind: int, command: int, *corners: tuple[float, float], first: float = math.nan
) -> Callable[[Scene], None]:
    """Items of a mission or of a fence at these metres north and east of SIH's home, 5 m up, one after the other."""

    def deed(scene: Scene) -> None:
        mav, system = scene.px4.link.mav, scene.px4.instance + 1
        mav.mission_count_send(system, 1, len(corners), kind)
        for number, (north_m, east_m) in enumerate(corners):
            time.sleep(0.2)
            lat = PLACE[0] + north_m / _M_PER_DEG
            lon = PLACE[1] + east_m / (_M_PER_DEG * math.cos(math.radians(PLACE[0])))
            place = round(1e7 * lat), round(1e7 * lon), 5.0
            frame = 3 if kind == _MISSION else 0
            mav.mission_item_int_send(system, 1, number, frame, command, 0, 1, first, 0.0, 0.0, 0.0, *place, kind)
        time.sleep(0.5)

    return deed


_FENCED = _in_flight(
    _uploaded(_FENCE, _FENCE_INSIDE, (2.0, 2.0), (2.0, -2.0), (-2.0, -2.0), (-2.0, 2.0), first=4.0), watched_s=20.0
)
_HOME_MOVED = _commands((_SET_HOME, 0.0, 0.0, 0.0, 0.0, PLACE[0] + 40.0 / _M_PER_DEG, PLACE[1], 489.4))


def _seen_from_outside(*, off_m: float = 0.0, frozen: bool = False, seconds: float = 8.0) -> Callable[[Scene], None]:
    """A motion capture's program tells PX4 where the vehicle is: by so much wrong, or always the same."""

    def deed(scene: Scene) -> None:
        at = scene.px4.truth[-1]
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            at = at if frozen else scene.px4.truth[-1]
            scene.px4.link.mav.vision_position_estimate_send(
                0, at.north_m + off_m, at.east_m, -at.up_m, 0.0, 0.0, 0.0, [math.nan] * 21, 0
            )
            time.sleep(0.03)

    return deed


def _sticks(main: float, *, throttle: int = 500) -> Callable[[Scene], None]:
    """The pilot takes a manual mode by sticks that stay in the middle, for 6 s."""

    def deed(scene: Scene) -> None:
        for number in range(round(6.0 / _STICK_S)):
            scene.px4.link.mav.manual_control_send(scene.px4.instance + 1, 0, 0, throttle, 0, 0)
            if number in (5, 10):
                scene.mode(main)
            time.sleep(_STICK_S)
        scene.mode(*HOLD)

    return deed


def _compass_off(scene: Scene) -> None:
    """The compass errs while the companion waits for the pilot."""
    wait_for_pilot(scene)
    scene.px4.set_param("SIM_MAG_OFFSET_X", -0.15)
    scene.px4.set_param("SIM_MAG_OFFSET_Y", 0.2)
    time.sleep(8.0)
    pilot_takes_off(scene)
    scene.began_s = time.monotonic()
    scene.wait(lambda: scene.ended, LIMIT_S)


_TRANSMITTER = (
    ("COM_RC_IN_MODE", 0.0), ("RC_CHAN_CNT", 8.0), ("RC_MAP_ROLL", 1.0), ("RC_MAP_PITCH", 2.0),
    ("RC_MAP_THROTTLE", 3.0), ("RC_MAP_YAW", 4.0), ("RC_MAP_KILL_SW", 5.0), ("COM_KILL_DISARM", 5.0),
)  # fmt: skip


def _kill_switch(scene: Scene, seconds: float = 1.5) -> None:
    """A transmitter's kill switch is thrown for so long, 12 m up, and released."""
    file = scene.folder / "high.toml"
    file.write_text(_HIGH)

    def send(killed: bool, until: Callable[[], bool], limit_s: float) -> None:
        deadline = time.monotonic() + limit_s
        while not until() and time.monotonic() < deadline:
            pulses = [1500, 1500, 1500, 1500, 2000 if killed else 1000, *(1500,) * 3]
            scene.px4.link.mav.rc_channels_override_send(scene.px4.instance + 1, 1, *pulses)
            time.sleep(_STICK_S)

    scene.process = start(scene.px4, scene.folder, str(file))
    send(False, lambda: scene.px4.height_m > 11.0 or scene.ended, LIMIT_S)
    scene.began_s = time.monotonic()
    send(True, lambda: False, seconds)
    send(False, lambda: scene.ended, 15.0)


def _little_memory(scene: Scene) -> None:
    """The companion may take no memory any more."""
    assert scene.process is not None
    resource.prlimit(scene.process.pid, resource.RLIMIT_AS, (1 << 26, 1 << 26))


def _router_restarted(*, gone_s: float) -> Callable[[Scene], None]:
    """The router between PX4 and companion is started anew: what it says comes from another port."""

    def deed(scene: Scene) -> None:
        port = OFFBOARD_PORT + scene.px4.instance
        with Relay(port, Manner()) as relay:
            scene.begin("--connect", f"udpin:127.0.0.1:{relay.port}")
            scene.began_s = time.monotonic()
        time.sleep(gone_s)
        with Relay(port, Manner()):
            scene.wait(lambda: scene.ended, LIMIT_S)

    return deed


@contextmanager
def _other_vehicle(scene: Scene, system: int) -> Iterator[None]:
    """Another PX4 tells the companion's port of itself from a port of its own: at rest, and ready."""
    mav = common.MAVLink(None, srcSystem=system, srcComponent=1)
    stop = threading.Event()

    def speak() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not stop.wait(0.1):
                for message in (
                    mav.heartbeat_encode(2, 12, 0x1D, 0x03040000, 3),
                    mav.local_position_ned_encode(1000, 5.0, 5.0, 0.0, 0.0, 0.0, 0.0),
                ):
                    out.sendto(message.pack(mav), ("127.0.0.1", OFFBOARD_PORT + scene.px4.instance))

    thread = threading.Thread(target=speak)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _second_vehicle(*, before: bool) -> Callable[[Scene], None]:
    """Of two vehicles on one port the companion may fly one, and never the wrong one."""

    def deed(scene: Scene) -> None:
        if not before:
            scene.begin()
        scene.began_s = time.monotonic()
        with _other_vehicle(scene, 9):
            if before:
                time.sleep(0.5)
                scene.process = start(scene.px4, scene.folder, "hover", "--duration", "5")
            scene.wait(lambda: scene.ended, LIMIT_S)

    return deed


def _px4_comes_later(scene: Scene) -> None:
    """The companion is there first; PX4 boots under its eyes."""
    scene.px4.signal(signal.SIGKILL)
    time.sleep(0.5)
    scene.process = start(scene.px4, scene.folder, "figure8", "--duration", f"{TRACK_S:g}", "--timeout", "40")
    time.sleep(5.0)
    scene.began_s = time.monotonic()
    scene.px4.restart()
    scene.wait(lambda: scene.ended, LIMIT_S)


def _another_program(*, arm: bool) -> Callable[[Scene], None]:
    """A program flies PX4 in OFFBOARD by positions, by the other link; then the companion is started."""

    def deed(scene: Scene) -> None:
        system, stop = scene.px4.instance + 1, threading.Event()

        def speak() -> None:
            while not stop.wait(0.05):
                scene.px4.link.mav.set_position_target_local_ned_send(
                    0, system, 1, 1, 0b101111111000, 0, 0, -3.0, 0, 0, 0, 0, 0, 0, 0, 0
                )

        thread = threading.Thread(target=speak)
        thread.start()
        try:
            time.sleep(1.0)
            scene.mode(float(OFFBOARD))
            time.sleep(0.3)
            scene.px4.command(ARM, 1.0, 0.0)
            if not scene.wait(lambda: scene.px4.height_m > AIRBORNE_M, 30.0):
                scene.notes.append("the other program did not take off")
            time.sleep(4.0)
            scene.began_s = time.monotonic()
            more = () if arm else ("--timeout", "20")
            scene.process = start(scene.px4, scene.folder, "hover", *more)
            scene.wait(lambda: scene.ended, 20.0)
            time.sleep(3.0)
            if scene.px4.mode >> 16 & 0xFF != OFFBOARD or not 2.0 < scene.px4.height_m < 4.0:
                scene.notes.append(
                    f"the other program lost it: mode {scene.px4.mode:#x}, {scene.px4.height_m:.1f} m up"
                )
        finally:
            stop.set()
            thread.join()

    return deed


def _again_at_once(scene: Scene) -> None:
    """The same command once more as soon as the first one has landed, and once more then."""
    scene.process = start(scene.px4, scene.folder, "hover", "--duration", "3")
    scene.wait(lambda: scene.ended, LIMIT_S)
    for number in range(2):
        code = scene.beside(f"again{number}", "--duration", "3").wait(LIMIT_S)
        if code != 0:
            scene.notes.append(f"again {number}: exit {code}")
    scene.began_s = time.monotonic()


def _nothing(scene: Scene) -> None:
    scene.wait(lambda: scene.ended, LIMIT_S)


def _at(lat_deg: float, lon_deg: float, height_m: float) -> tuple[tuple[str, str], ...]:
    return ("PX4_HOME_LAT", f"{lat_deg}"), ("PX4_HOME_LON", f"{lon_deg}"), ("PX4_HOME_ALT", f"{height_m}")


ATTACKS: dict[str, Attack] = {
    "Mission chosen in flight": Attack(
        _in_flight(_uploaded(_MISSION, _WAYPOINT, (8.0, 0.0), (8.0, 8.0), (0.0, 8.0), first=0.0), _mode(*_AUTO_MISSION),
                   watched_s=5.0)
    ),
    "PX4's own fence uploaded round it, Hold": Attack(_FENCED, params=(("GF_ACTION", 2.0),)),
    "PX4's own fence uploaded round it, Return": Attack(_FENCED, params=(("GF_ACTION", 3.0),)),
    "PX4's own fence uploaded round it, Land": Attack(_FENCED, params=(("GF_ACTION", 5.0),)),
    "PX4's own fence uploaded round it, terminate": Attack(
        _FENCED, params=(("GF_ACTION", 4.0), ("CBRK_FLIGHTTERM", 0.0)), soft=False
    ),
    "home moved by 40 m, then Return": Attack(
        _in_flight(_HOME_MOVED, _mode(*RETURN), watched_s=5.0)
    ),
    "home moved by 40 m": Attack(_in_flight(_HOME_MOVED), codes=(0,)),
    "motion capture, right": Attack(
        _in_flight(_seen_from_outside()), codes=(0, 1), params=(("EKF2_EV_CTRL", 3.0),)
    ),
    "motion capture, 1 m off": Attack(
        _in_flight(_seen_from_outside(off_m=1.0)), codes=(0, 1), params=(("EKF2_EV_CTRL", 3.0),)
    ),
    "motion capture that has frozen": Attack(
        _in_flight(_seen_from_outside(frozen=True)), codes=(0, 1), params=(("EKF2_EV_CTRL", 3.0),)
    ),
    "a motor stops": Attack(
        _in_flight(_commands((_INJECT_FAILURE, _MOTOR, _OFF, 1.0)), watched_s=15.0), soft=False,
        params=(("CA_FAILURE_MODE", 1.0), ("FD_ACT_EN", 1.0)),
    ),
    "inertia three times as high": Attack(
        parameters_set(("SIH_IXX", 0.075), ("SIH_IYY", 0.075)), codes=(0, 1)
    ),
    "compass 70 degrees off from before the flight": Attack(_compass_off, codes=(0, 1, 2)),
    "kill switch for 1.5 s": Attack(
        _kill_switch, soft=False, params=_TRANSMITTER
    ),
    "kill switch for 0.4 s": Attack(
        lambda scene: _kill_switch(scene, 0.4), codes=(0, 1), soft=False,
        params=_TRANSMITTER
    ),
    "Stabilized by sticks": Attack(_in_flight(_sticks(7.0), watched_s=3.0)),
    "Altitude by sticks": Attack(_in_flight(_sticks(2.0), watched_s=3.0)),
    "Acro by sticks": Attack(_in_flight(_sticks(5.0), watched_s=3.0), soft=False),
    "SIGSEGV": Attack(signalled((signal.SIGSEGV, 5.0)), codes=(-11,)),
    "SIGABRT": Attack(signalled((signal.SIGABRT, 5.0)), codes=(-6,)),
    "SIGUSR1": Attack(signalled((signal.SIGUSR1, 5.0)), codes=(-10, 0)),
    "no memory any more": Attack(_in_flight(_little_memory), codes=(0, 1)),
    "the router started anew": Attack(_router_restarted(gone_s=0.0), codes=(0, 1)),
    "the router started anew after 0.3 s": Attack(_router_restarted(gone_s=0.3), codes=(0, 1)),
    "the router started anew after 2 s": Attack(_router_restarted(gone_s=2.0), soft=False),
    "another vehicle on the port from before the start": Attack(_second_vehicle(before=True)),
    "another vehicle on the port in flight": Attack(_second_vehicle(before=False), codes=(0,)),
    "PX4 started after the companion": Attack(_px4_comes_later, codes=(0,)),
    "another program flies in OFFBOARD, --arm": Attack(_another_program(arm=True), keeps=False),
    "three flights, one right after the other": Attack(_again_at_once, codes=(0,)),
    "actuators tested in flight": Attack(
        _in_flight(_commands((_ACTUATOR_TEST, 0.0, 3.0, 0.0, 0.0, 1101.0))), codes=(0,)
    ),
    "gyros calibrated while it waits": Attack(
        while_waiting(lambda scene: (scene.px4.command(int(_CALIBRATION), 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
                                     time.sleep(2.0))[1]), codes=(0, 1)
    ),
    "reboot asked for while it waits": Attack(
        while_waiting(lambda scene: scene.px4.command(int(_REBOOT), 1.0)), codes=(0, 1)
    ),
    "MAV_TYPE 13 (a hexarotor)": Attack(_in_flight(_nothing), codes=(1, 2), params=(("MAV_TYPE", 13.0),)),
    "MAV_TYPE 13 in flight": Attack(parameters_set(("MAV_TYPE", 13.0)), codes=(0, 1)),
    "COM_SPOOLUP_TIME 4": Attack(_in_flight(_nothing), codes=(0, 1), params=(("COM_SPOOLUP_TIME", 4.0),)),
    "COM_DISARM_PRFLT 0.5": Attack(_in_flight(_nothing), codes=(0, 1), params=(("COM_DISARM_PRFLT", 0.5),)),
    "COM_DISARM_LAND 0.1": Attack(_in_flight(_nothing), codes=(0,), params=(("COM_DISARM_LAND", 0.1),)),
    "MPC_LAND_SPEED 0.6, MPC_LAND_CRWL 0.1": Attack(
        _in_flight(_nothing), codes=(0,), params=(("MPC_LAND_SPEED", 0.6), ("MPC_LAND_CRWL", 0.1))
    ),
    "MC_AIRMODE 2": Attack(_in_flight(_nothing), codes=(0,), params=(("MC_AIRMODE", 2.0),)),
    "MC_YAWRATE_K 0": Attack(_in_flight(_nothing), codes=(0, 1), params=(("MC_YAWRATE_K", 0.0),)),
    "a motor of the file's four turned round (CA_ROTOR0_KM)": Attack(
        while_waiting(lambda scene: scene.px4.set_param("CA_ROTOR0_KM", -0.05)), codes=(1, 2)
    ),
    "across the date line": Attack(_in_flight(_nothing), codes=(0,), env=_at(47.4, 179.999999, 489.4)),
    "near the pole": Attack(_in_flight(_nothing), codes=(0, 1), env=_at(89.9, 8.5, 0.0)),
    "south of the equator, west of Greenwich": Attack(_in_flight(_nothing), codes=(0,), env=_at(-33.9, -70.6, 520.0)),
    "below the sea": Attack(_in_flight(_nothing), codes=(0,), env=_at(31.5, 35.5, -420.0)),
    "5000 m high": Attack(_in_flight(_nothing), codes=(0,), env=_at(27.9, 86.9, 5000.0)),
    "PX4 twice as fast as the clock": Attack(_in_flight(_nothing), codes=(0, 1), env=(("PX4_SIM_SPEED_FACTOR", "2"),)),
    "PX4 half as fast as the clock": Attack(_in_flight(_nothing), codes=(0, 1), env=(("PX4_SIM_SPEED_FACTOR", "0.5"),)),
    "a hexarotor": Attack(_in_flight(_nothing), codes=(1, 2), env=(("PX4_SIM_MODEL", "sihsim_hex"),)),
    "PX4's logger stopped, its navigator stopped": Attack(
        shell("logger", "stop", then=("navigator", "stop"), watched_s=60.0), codes=(0, 1)
    ),
    "PX4's rate controller stopped": Attack(shell("mc_rate_control", "stop"), codes=(1,), soft=False),
    "PX4's commander stopped": Attack(shell("commander", "stop"), codes=(1,), soft=False),
}  # fmt: skip
