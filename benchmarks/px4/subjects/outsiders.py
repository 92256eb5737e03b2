"""More of what outsiders do: fences, sticks, failsafes that a user has set, other vehicles' files, silent streams."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from benchmarks.px4.companion import start
from benchmarks.px4.deeds import HOLD, Attack, commanded, flown, parameters_set
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.relay import Manner
from benchmarks.px4.scene import LIMIT_S, OFFBOARD, Scene
from benchmarks.px4.subjects.attacks import ASKED as ASKED
from benchmarks.px4.subjects.interference import linked, shell
from flightstack.cli.files import load_vehicle
from flightstack.vehicle import vehicle_to_toml
from tests.wrong_vehicles import WRONG

RUNS = 1
_PAUSE, _CHANGE_SPEED, _SET_HOME, _SET_MODE, _ROI = 193.0, 178.0, 179.0, 176.0, 195.0
_STICK_S = 0.05
_LOW = "two fifths of the thrust missing"


def run(bench: Bench, runs: int) -> list[Row]:
    """Every one `runs` times."""
    return flown(bench, runs, ATTACKS)


def _sticks(*, pitch: int, stop: bool) -> Callable[[Scene], None]:
    """A joystick is there from before the flight on: in flight it is pushed, or falls silent."""

    def centred(scene: Scene) -> None:
        scene.px4.link.mav.manual_control_send(scene.px4.instance + 1, 0, 0, 500, 0, 0)

    def deed(scene: Scene) -> None:
        scene.process = start(scene.px4, scene.folder, "figure8", "--duration", "20")
        flying = lambda: scene.px4.height_m > 1.5 or scene.ended  # noqa: E731
        while not flying():
            centred(scene)
            time.sleep(_STICK_S)
        for _ in range(round(4.0 / _STICK_S)):
            centred(scene)
            time.sleep(_STICK_S)
        scene.began_s = time.monotonic()
        for _ in range(0 if stop else round(5.0 / _STICK_S)):
            scene.px4.link.mav.manual_control_send(scene.px4.instance + 1, pitch, 0, 500, 0, 0)
            time.sleep(_STICK_S)
        scene.wait(lambda: scene.ended, 6.0)

    return deed


def _file(vehicle: str) -> Callable[[Scene], None]:
    """The companion is told another vehicle's file."""

    def deed(scene: Scene) -> None:
        scene.began_s = time.monotonic()
        scene.process = start(scene.px4, scene.folder, "hover", "--duration", "5", "--vehicle", vehicle)
        scene.wait(lambda: scene.ended, LIMIT_S)

    return deed


def _both_wrong(scene: Scene) -> None:
    """File and MPC_THR_HOVER agree on a hover thrust that is 1.6 times the true one."""
    file = scene.folder / "vehicle.toml"
    file.write_text(vehicle_to_toml(WRONG[_LOW](load_vehicle("px4-sihsim-quadx")[0])))
    _file(str(file))(scene)


def _stopped_modes(scene: Scene) -> None:
    """A ground station asks for modes that need sticks; nobody holds any."""
    scene.begin()
    scene.began_s = time.monotonic()
    for main in (1.0, 7.0, 5.0, 2.0):
        scene.mode(main)
        time.sleep(0.3)
    scene.wait(lambda: scene.ended, 60.0)


def _taken_and_given_in_the_climb(scene: Scene) -> None:
    """Hold for 3 s during the climb, then OFFBOARD again: nobody streams any more."""
    scene.process = start(scene.px4, scene.folder, "figure8", "--duration", "20")
    scene.wait(lambda: scene.px4.height_m > 0.5 or scene.ended, LIMIT_S)
    scene.began_s = time.monotonic()
    scene.mode(*HOLD)
    time.sleep(3.0)
    scene.mode(float(OFFBOARD))
    time.sleep(4.0)


def _key(scene: Scene) -> None:
    """The companion has a signing key, PX4 has none."""
    key = scene.folder / "key"
    key.write_bytes(bytes(range(32)))
    os.chmod(key, 0o600)
    _with(scene, "--signing-key", str(key))


def _with(scene: Scene, *more: str) -> None:
    scene.began_s = time.monotonic()
    scene.process = start(scene.px4, scene.folder, "hover", "--duration", "5", *more)
    scene.wait(lambda: scene.ended, LIMIT_S)


def _stream(name: str, rate: str, watched_s: float = 60.0) -> Callable[[Scene], None]:
    return shell("mavlink", "stream", "-u", "{port}", "-s", name, "-r", rate, watched_s=watched_s)


def _hovering(scene: Scene) -> None:
    _with(scene)


_FENCE = ("GF_MAX_HOR_DIST", 2.0)
ATTACKS: dict[str, Attack] = {
    "fence of 2 m set in flight, Hold": Attack(parameters_set(_FENCE, watched_s=15.0)),
    "fence of 2 m, Return": Attack(parameters_set(_FENCE, watched_s=15.0), params=(("GF_ACTION", 3.0),)),
    "fence of 2 m, Land": Attack(parameters_set(_FENCE, watched_s=15.0), params=(("GF_ACTION", 5.0),)),
    "fence of 1.5 m of height from the start": Attack(
        _hovering, params=(("GF_MAX_VER_DIST", 1.0), ("GF_ACTION", 5.0))
    ),
    "sticks lost in flight": Attack(_sticks(pitch=0, stop=True), codes=(0, 1)),
    "sticks lost in flight, they are needed (COM_RC_IN_MODE 1)": Attack(
        _sticks(pitch=0, stop=True), codes=(0, 1), params=(("COM_RC_IN_MODE", 1.0),)
    ),
    "sticks pushed, COM_RC_OVERRIDE 3": Attack(
        _sticks(pitch=700, stop=False), params=(("COM_RC_OVERRIDE", 3.0), ("COM_RC_IN_MODE", 1.0))
    ),
    "manual modes without sticks": Attack(_stopped_modes, codes=(0, 1)),
    "battery empty, COM_LOW_BAT_ACT 3": Attack(
        parameters_set(("SIM_BAT_MIN_PCT", 0.0)), codes=(0, 1),
        params=(("SIM_BAT_DRAIN", 8.0), ("COM_LOW_BAT_ACT", 3.0)),
    ),
    "flight time over (COM_FLT_TIME_MAX 15, Return)": Attack(
        parameters_set(("COM_FLT_TIME_MAX", 15.0)), codes=(0, 1), params=(("COM_FLTT_LOW_ACT", 3.0),)
    ),
    "arming needs an authorisation that nobody gives": Attack(_hovering, params=(("COM_ARM_AUTH_REQ", 1.0),)),
    "too weak to leave the ground (SIH_T_MAX 1.5)": Attack(_hovering, codes=(1, 2), params=(("SIH_T_MAX", 1.5),)),
    "file of iris": Attack(_file("iris"), codes=(2,)),
    "file of quad-x": Attack(_file("quad-x"), codes=(2,)),
    "file of f450": Attack(_file("f450"), codes=(0, 2)),
    "file and MPC_THR_HOVER both say 0.8": Attack(_both_wrong, codes=(0, 1, 2), params=(("MPC_THR_HOVER", 0.8),)),
    "a signing key that PX4 has not": Attack(_key, codes=(1, 2)),
    "MAVLink 1 until it hears 2": Attack(_hovering, codes=(0,), params=(("MAV_PROTO_VER", 1.0),)),
    "Hold in the climb, 3 s later OFFBOARD": Attack(_taken_and_given_in_the_climb, keeps=False),
    "pause, speed, home and region of interest": Attack(
        commanded((_CHANGE_SPEED, 1.0, 2.0), (_SET_HOME, 1.0), (_ROI, 0.0, 0.0, 0.0, 0.0, 47.4, 8.5, 500.0),
                  (_PAUSE, 0.0), apart_s=2.0), codes=(0, 1)
    ),
    "5 % lost, 5 % doubled, shuffled over 8 ms": Attack(
        linked(Manner(lost=0.05, doubled=0.05, jitter_s=0.008)), codes=(0, 1)
    ),
    "attitude at 10 Hz": Attack(_stream("ATTITUDE_QUATERNION", "10", 15.0)),
    "position at 5 Hz": Attack(_stream("LOCAL_POSITION_NED", "5", 15.0)),
    "ODOMETRY off": Attack(_stream("ODOMETRY", "0"), codes=(0, 1)),
    "HEARTBEAT off": Attack(_stream("HEARTBEAT", "0"), codes=(0, 1)),
    "CURRENT_MODE off": Attack(_stream("CURRENT_MODE", "0"), codes=(0, 1)),
}  # fmt: skip
