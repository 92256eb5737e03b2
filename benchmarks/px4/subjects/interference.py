"""What else an outsider does to a flight: gains and sensors changed under way, a bad link, PX4's shell, odd moments."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable

from benchmarks.px4.companion import start
from benchmarks.px4.deeds import (
    ARM,
    HOLD,
    LAND,
    TAKEOFF,
    Attack,
    already_flying,
    commanded,
    flown,
    parameters_set,
    pilot_takes_off,
    wait_for_pilot,
    while_waiting,
)
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.relay import Manner, Relay
from benchmarks.px4.scene import AIRBORNE_M, LIMIT_S, OFFBOARD, Scene
from benchmarks.px4.station import OFFBOARD_PORT
from benchmarks.px4.subjects.attacks import ASKED as ASKED
from benchmarks.px4.subjects.attacks import PAYLOAD_PORT

RUNS = 1
_INJECT_FAILURE, _GPS_ORIGIN, _REPOSITION, _ORBIT, _STORAGE = 420.0, 48.0, 192.0, 34.0, 245.0
_GYRO, _ACCEL, _MAG, _BARO, _GPS = 0.0, 1.0, 2.0, 3.0, 4.0
_OFF, _STUCK, _WRONG = 1.0, 2.0, 4.0


def run(bench: Bench, runs: int) -> list[Row]:
    """Every one `runs` times."""
    return flown(bench, runs, ATTACKS)


def _failed(unit: float, kind: float, watched_s: float = 20.0) -> Callable[[Scene], None]:
    """PX4 simulates failures of its sensors behind a simulator only (`kind="hil"`): SIH takes no notice."""
    return commanded((_INJECT_FAILURE, unit, kind, 0.0), apart_s=watched_s)


def linked(first: Manner, *then: tuple[Manner, float]) -> Callable[[Scene], None]:
    """By a relay; in flight its manner changes, each for a while."""

    def deed(scene: Scene) -> None:
        with Relay(OFFBOARD_PORT + scene.px4.instance, first) as relay:
            scene.begin("--connect", f"udpin:127.0.0.1:{relay.port}")
            scene.began_s = time.monotonic()
            for manner, seconds in then:
                relay.manner = manner
                scene.wait(lambda: scene.ended, seconds)
            scene.wait(lambda: scene.ended, LIMIT_S)

    return deed


def _at_arming(*commands: tuple[float, ...], number: int = 0) -> Callable[[Scene], None]:
    """As soon as the vehicle says that it is armed: commands, a signal to the companion."""

    def deed(scene: Scene) -> None:
        scene.process = start(scene.px4, scene.folder, "figure8")
        if not scene.wait(lambda: scene.px4.armed or scene.ended, LIMIT_S):
            scene.notes.append("did not arm")
        scene.began_s = time.monotonic()
        for which, *params in commands:
            scene.px4.command(int(which), *params)
        if number:
            scene.process.send_signal(number)
        scene.wait(lambda: scene.ended, 20.0)

    return deed


def shell(*words: str, then: tuple[str, ...] = (), watched_s: float = 10.0) -> Callable[[Scene], None]:
    """A command of PX4's own shell, half a second later another; `PX4_SHELL` names the folder of its programs."""

    def deed(scene: Scene) -> None:
        scene.begin()
        scene.began_s = time.monotonic()
        folder = os.environ["PX4_SHELL"]
        for program, *options in filter(None, (words, then)):
            filled = [word.format(port=14580 + scene.px4.instance) for word in options]
            line = [f"{folder}/px4-{program}", "--instance", str(scene.px4.instance), *filled]
            scene.others.append(subprocess.Popen(line))  # PX4 may never answer
            time.sleep(0.5)
        scene.wait(lambda: scene.ended, watched_s)

    return deed


def _undisturbed(scene: Scene) -> None:
    scene.begin()
    scene.began_s = time.monotonic()


def _rival_positions(scene: Scene) -> None:
    """Position setpoints of a ground station, 20 a second for 3 s."""
    scene.begin()
    scene.began_s = time.monotonic()
    for _ in range(60):
        scene.px4.link.mav.set_position_target_local_ned_send(
            0, scene.px4.instance + 1, 1, 1, 0b101111111000, 20.0, 0, -10.0, 0, 0, 0, 0, 0, 0, 0, 0
        )
        time.sleep(0.05)
    scene.wait(lambda: scene.ended, 60.0)


def _sticks(scene: Scene) -> None:
    """The pilot takes Position with sticks, flies, lets them be lost, then gives OFFBOARD back."""
    scene.begin()
    scene.began_s = time.monotonic()
    for number in range(150):
        scene.px4.link.mav.manual_control_send(scene.px4.instance + 1, 300, 0, 500, 0, 0)
        if number in (20, 25):
            scene.mode(3.0)
        time.sleep(0.04)
    time.sleep(3.0)
    scene.mode(float(OFFBOARD))
    time.sleep(4.0)


def _second_while_flying(scene: Scene) -> None:
    """Another companion on the other link, with the same system and component, while the first flies."""
    scene.begin()
    scene.began_s = time.monotonic()
    code = scene.beside("second", "--connect", f"udpin:127.0.0.1:{PAYLOAD_PORT + scene.px4.instance}").wait(LIMIT_S)
    if code != 1:
        scene.notes.append(f"the second one ended with {code}")


def _swapped_while_waiting(scene: Scene) -> None:
    for name, value in (("CA_ROTOR0_PX", -0.15), ("CA_ROTOR2_PX", -0.15), ("CA_ROTOR1_PX", 0.15)):
        scene.px4.set_param(name, value)


def _origin_moved(scene: Scene) -> None:
    """The estimator's origin is set elsewhere: its position jumps by 100 m, and it says so."""
    scene.begin()
    scene.began_s = time.monotonic()
    scene.px4.command(int(_GPS_ORIGIN), 0.0, 0.0, 0.0, 0.0, 47.3989, 8.5456, 489.4)
    scene.px4.link.mav.set_gps_global_origin_send(scene.px4.instance + 1, 473989000, 85456000, 489400)
    scene.wait(lambda: scene.ended, 60.0)


def _full_disk(scene: Scene) -> None:
    """The folder of the log is full a second after take-off."""
    disk = scene.folder / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(disk)], check=True)
    try:
        scene.began_s = time.monotonic()
        scene.begin("--out", str(disk))
        scene.wait(lambda: scene.ended, 60.0)
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=False)


def _killed_with(name: str, value: float) -> Callable[[Scene], None]:
    """A parameter is set in flight, then the companion is killed."""

    def deed(scene: Scene) -> None:
        scene.begin()
        scene.began_s = time.monotonic()
        scene.px4.set_param(name, value)
        assert scene.process is not None
        scene.process.send_signal(signal.SIGKILL)
        time.sleep(6.0)

    return deed


def _waits_then_killed(scene: Scene) -> None:
    """The pilot arms and takes OFFBOARD while the companion is stopped."""
    wait_for_pilot(scene)
    scene.began_s = time.monotonic()
    assert scene.process is not None
    scene.process.send_signal(signal.SIGSTOP)
    time.sleep(0.5)
    pilot_takes_off(scene)
    time.sleep(2.0)
    scene.process.send_signal(signal.SIGCONT)
    scene.wait(lambda: scene.ended, 20.0)


def _given_again(scene: Scene) -> None:
    """The pilot takes Hold while the vehicle still climbs, and 3 s later lands it."""
    scene.process = start(scene.px4, scene.folder, "figure8")
    scene.wait(lambda: scene.px4.height_m > 0.3 * AIRBORNE_M or scene.ended, LIMIT_S)
    scene.began_s = time.monotonic()
    scene.mode(*HOLD)
    time.sleep(3.0)
    scene.mode(*LAND)
    time.sleep(5.0)


_UNTOUCHED = Manner()
ATTACKS: dict[str, Attack] = {
    "rate gains three times as high": Attack(
        parameters_set(("MC_ROLLRATE_K", 3.0), ("MC_PITCHRATE_K", 3.0)), codes=(0, 1)
    ),
    "rate gains a third": Attack(parameters_set(("MC_ROLLRATE_K", 0.34), ("MC_PITCHRATE_K", 0.34)), codes=(0, 1)),
    "gyro filter at 10 Hz": Attack(parameters_set(("IMU_GYRO_CUTOFF", 10.0)), codes=(0, 1)),
    "SENS_BOARD_X_OFF 8 degrees": Attack(parameters_set(("SENS_BOARD_X_OFF", 8.0)), codes=(0, 1)),
    "magnetometer offset of 0.3 gauss": Attack(parameters_set(("SIM_MAG_OFFSET_X", 0.3)), codes=(0, 1)),
    "baro offset of 200 Pa": Attack(parameters_set(("SIM_BARO_OFF_P", 200.0)), codes=(0, 1)),
    "height from the baro (EKF2_HGT_REF 0)": Attack(parameters_set(("EKF2_HGT_REF", 0.0)), codes=(0, 1)),
    "GPS fusion off for 3 s": Attack(
        lambda scene: (
            parameters_set(("EKF2_GPS_CTRL", 0.0), watched_s=3.0)(scene),
            scene.px4.set_param("EKF2_GPS_CTRL", 7.0),
            scene.wait(lambda: scene.ended, 60.0),
        )[0],
        codes=(0, 1),
    ),
    "GPS off": Attack(_failed(_GPS, _OFF), codes=(1,), kind="hil", soft=False),
    "GPS stuck": Attack(_failed(_GPS, _STUCK), codes=(0, 1), kind="hil", soft=False),
    "GPS wrong": Attack(_failed(_GPS, _WRONG), codes=(0, 1), kind="hil", soft=False),
    "barometer off": Attack(_failed(_BARO, _OFF), codes=(0, 1), kind="hil"),
    "barometer stuck": Attack(_failed(_BARO, _STUCK), codes=(0, 1), kind="hil"),
    "magnetometer off": Attack(_failed(_MAG, _OFF), codes=(0, 1), kind="hil"),
    "magnetometer stuck": Attack(_failed(_MAG, _STUCK), codes=(0, 1), kind="hil"),
    "accelerometer off": Attack(_failed(_ACCEL, _OFF), codes=(0, 1), kind="hil", soft=False),
    "gyro stuck": Attack(_failed(_GYRO, _STUCK), codes=(0, 1), kind="hil", soft=False),
    "0.5 kg more in flight": Attack(parameters_set(("SIH_MASS", 1.5)), codes=(0, 1)),
    "0.4 kg dropped in flight": Attack(parameters_set(("SIH_MASS", 0.6)), codes=(0, 1)),
    "a third of the thrust lost": Attack(parameters_set(("SIH_T_MAX", 3.4)), codes=(0, 1)),
    "drag four times as high": Attack(parameters_set(("SIH_KDV", 4.0)), codes=(0, 1)),
    "motors three times as slow": Attack(parameters_set(("SIH_T_TAU", 0.15)), codes=(0, 1), soft=False),
    "battery empty at default parameters": Attack(
        parameters_set(("SIM_BAT_MIN_PCT", 0.0)), codes=(0, 1), params=(("SIM_BAT_DRAIN", 8.0),)
    ),
    "MC_BAT_SCALE_EN 1 in flight": Attack(parameters_set(("MC_BAT_SCALE_EN", 1.0)), codes=(0, 1)),
    "MAV_SYS_ID 77 in flight": Attack(parameters_set(("MAV_SYS_ID", 77.0)), codes=(0, 1)),
    "all parameters reset in flight": Attack(commanded((_STORAGE, 2.0, -1.0), apart_s=30.0), codes=(0, 1)),
    "DO_REPOSITION": Attack(
        commanded((_REPOSITION, -1.0, 1.0, 0.0, 0.0, 47.3979, 8.5457, 495.0), apart_s=5.0), codes=(0, 1)
    ),
    "DO_ORBIT": Attack(commanded((_ORBIT, 5.0, 1.0), apart_s=5.0), codes=(0, 1)),
    "take-off, mission start, parachute, a motor test": Attack(
        commanded((22.0,), (300.0, 0.0, 0.0), (208.0, 2.0), (209.0, 1.0, 0.0, 100.0, 3.0), apart_s=3.0), codes=(0, 1)
    ),
    "the estimator's origin moved by 120 m": Attack(_origin_moved, codes=(0, 1)),
    "rotors swapped while it waits": Attack(
        while_waiting(_swapped_while_waiting), codes=(1, 2), soft=False
    ),
    "a ground station sends positions for 3 s": Attack(_rival_positions, codes=(0, 1)),
    "Position by sticks, sticks lost, OFFBOARD again": Attack(_sticks, keeps=False),
    "a second companion by the other link in flight": Attack(_second_while_flying, codes=(0,)),
    "Hold at the tick of arming": Attack(_at_arming((176.0, 1.0, *HOLD))),
    "Land at the tick of arming": Attack(_at_arming((176.0, 1.0, *LAND))),
    "disarmed at the tick of arming": Attack(_at_arming((float(ARM), 0.0, 0.0))),
    "take-off by PX4 at the tick of arming": Attack(_at_arming((176.0, 1.0, *TAKEOFF))),
    "Hold in the climb, Land 3 s later": Attack(_given_again),
    "stopped while it waits, the pilot takes off": Attack(_waits_then_killed, codes=(1,)),
    "started while it lands, --arm": Attack(already_flying(LAND, arm=True)),
    "started while it orbits, --arm": Attack(already_flying((3.0, 1.0), arm=True)),
    "started while PX4 takes off, without --arm": Attack(already_flying(TAKEOFF, arm=False), codes=(130,)),
    "PX4's mavlink stopped": Attack(shell("mavlink", "stop", "-u", "{port}"), codes=(1,)),
    "HIGHRES_IMU at 5 Hz": Attack(shell("mavlink", "stream", "-u", "{port}", "-s", "HIGHRES_IMU", "-r", "5")),
    "ESTIMATOR_STATUS off": Attack(
        shell("mavlink", "stream", "-u", "{port}", "-s", "ESTIMATOR_STATUS", "-r", "0", watched_s=60.0), codes=(0, 1)
    ),
    "the estimator stopped": Attack(shell("ekf2", "stop"), codes=(1,), soft=False),
    "the estimator stopped and started": Attack(
        shell("ekf2", "stop", then=("ekf2", "start")), codes=(1,), soft=False
    ),
    "never disarms": Attack(_undisturbed, codes=(1,), params=(("COM_DISARM_LAND", -1.0),)),
    "a full disk": Attack(_full_disk, codes=(0, 1)),
    "COM_OBL_RC_ACT 7 (disarm) set, then killed": Attack(_killed_with("COM_OBL_RC_ACT", 7.0), codes=(-9,)),
    "COM_OF_LOSS_T 0.1 set, then killed": Attack(_killed_with("COM_OF_LOSS_T", 0.1), codes=(-9,)),
    "SIGINT at the tick of arming": Attack(_at_arming(number=signal.SIGINT), codes=(130,)),
    "5 % lost": Attack(linked(Manner(lost=0.05)), codes=(0, 1)),
    "a tenth doubled": Attack(linked(Manner(doubled=0.1)), codes=(0,)),
    "shuffled over 8 ms": Attack(linked(Manner(jitter_s=0.008)), codes=(0, 1)),
    "60 ms there and back": Attack(linked(Manner(up_s=0.03, down_s=0.03)), codes=(1,)),
    "60 ms more from the middle of the flight on": Attack(
        linked(_UNTOUCHED, (Manner(up_s=0.03, down_s=0.03), LIMIT_S)), codes=(0, 1)
    ),
    "PX4 not heard for 0.3 s, three times": Attack(
        linked(_UNTOUCHED, *((Manner(down_cut=cut), 0.3) for cut in (True, False) * 3)), codes=(0, 1)
    ),
    "not heard by PX4 for 2 s": Attack(
        linked(_UNTOUCHED, (Manner(up_cut=True), 2.0), (_UNTOUCHED, 1.0)), codes=(0, 1)
    ),
}  # fmt: skip
