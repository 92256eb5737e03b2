"""What an outsider does to a flight: rivals, a PX4 that dies, ground stations, failsafes, forged datagrams, signals."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

from pymavlink.dialects.v20 import common

from benchmarks.px4.companion import start
from benchmarks.px4.deeds import (
    ARM,
    HOLD,
    LAND,
    RETURN,
    TAKEOFF,
    Attack,
    already_flying,
    chosen,
    commanded,
    flown,
    parameters_set,
    px4_signalled,
    signalled,
    while_waiting,
)
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.scene import LIMIT_S, Scene

ASKED = (
    "An outsider interferes with figure8 at default parameters: whoever takes the vehicle keeps it (PX4 does not go "
    "back to OFFBOARD, nothing arms again), one line says why, nothing raises, the exit code is 0 where the flight was "
    "completed and 1 where it was not; unless somebody stops the motors the ground is met at 1.5 m/s at most."
)
RUNS = 1
PAYLOAD_PORT = 14030
"""PX4's third link, of 4 kB/s until streams are asked for."""
_FORCE = 21196.0


def run(bench: Bench, runs: int) -> list[Row]:
    """Every attack `runs` times."""
    return flown(bench, runs, ATTACKS)


def _second_on_the_port(scene: Scene) -> None:
    scene.begin()
    scene.began_s = time.monotonic()
    code = scene.beside("second").wait(LIMIT_S)
    if code != 2 and code != 1:
        scene.notes.append(f"the second one ended with {code}")


def _second_by_the_other_link(scene: Scene) -> None:
    """Both at once, each on a link of its own."""
    second = scene.beside("second", "--connect", f"udpin:127.0.0.1:{PAYLOAD_PORT + scene.px4.instance}")
    scene.process = start(scene.px4, scene.folder, "hover")
    scene.began_s = time.monotonic()
    scene.wait(lambda: scene.ended, LIMIT_S)
    if scene.process.poll() == second.wait(LIMIT_S) == 0:
        scene.notes.append("both flew")


def _rival_setpoints(scene: Scene) -> None:
    """A ground station that sends body rates of its own, 50 a second for 3 s."""
    scene.begin()
    scene.began_s = time.monotonic()
    for _ in range(150):
        scene.px4.link.mav.set_attitude_target_send(0, scene.px4.instance + 1, 1, 128, [1, 0, 0, 0], 0.5, 0, 0, 0.5)
        time.sleep(0.02)


def _frames(instance: int) -> list[bytes]:
    """Well-formed lies of the vehicle's own system: another mode, disarmed, somewhere else, a clock that jumps."""
    mav = common.MAVLink(None, srcSystem=instance + 1, srcComponent=1)
    said = [
        mav.heartbeat_encode(2, 12, 0x1D, 0x03040000, 3),
        mav.heartbeat_encode(2, 12, 0x9D, 0x05040000, 5),
        mav.local_position_ned_encode(1000, 50.0, 50.0, -50.0, 9.0, 9.0, 9.0),
        mav.attitude_quaternion_encode(1000, 0.0, 1.0, 0.0, 0.0, 5.0, 5.0, 5.0),
        mav.timesync_encode(10**15, 1),
        mav.statustext_encode(0, b"Failsafe activated"),
    ]
    return [message.pack(mav) for message in said]


def _noise(scene: Scene) -> None:
    scene.begin()
    scene.began_s = time.monotonic()
    scene.forge(5.0)


def _lies(scene: Scene) -> None:
    scene.begin()
    scene.began_s = time.monotonic()
    scene.forge(5.0, *_frames(scene.px4.instance))


def _noise_first(scene: Scene) -> None:
    """The first datagram that the companion's port ever gets is somebody else's."""
    scene.px4.signal(signal.SIGSTOP)
    scene.process = start(scene.px4, scene.folder, "hover")
    scene.began_s = time.monotonic()
    until = time.monotonic() + 20.0
    while time.monotonic() < until and "link" not in scene.said:
        scene.forge(0.2)
        if time.monotonic() > until - 12.0:
            scene.px4.signal(signal.SIGCONT)
    scene.px4.signal(signal.SIGCONT)
    scene.wait(lambda: scene.ended, 60.0)


def _dead_man(number: int) -> Callable[[Scene], None]:
    """A signal to the companion's child that answers its silence."""

    def deed(scene: Scene) -> None:
        scene.begin()
        scene.began_s = time.monotonic()
        assert scene.process is not None
        for child in dead_men(scene.process.pid):
            os.kill(child, number)

    return deed


def dead_men(pid: int) -> list[int]:
    """The processes that answer this companion's silence."""
    children = [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return [child for child in children if "dead_man" in Path(f"/proc/{child}/cmdline").read_text()]


def _gcs_lost(scene: Scene) -> None:
    """The ground station falls silent."""
    scene.begin()
    scene.began_s = time.monotonic()
    scene.px4.silent = True
    time.sleep(15.0)
    scene.px4.silent = False


ATTACKS: dict[str, Attack] = {
    "a second companion on the same port": Attack(_second_on_the_port, codes=(0,)),
    "a second companion through the other link": Attack(_second_by_the_other_link, codes=(0, 1)),
    "a ground station sends body rates for 3 s": Attack(_rival_setpoints, codes=(0, 1)),
    "random datagrams at the companion's port": Attack(_noise, codes=(0,)),
    "lies in the vehicle's name at the companion's port": Attack(_lies, codes=(0,)),
    "random datagrams before PX4 is heard": Attack(_noise_first, codes=(0, 1)),
    "PX4 killed": Attack(px4_signalled((signal.SIGKILL, 0.0)), soft=False),
    "PX4 killed and started anew": Attack(px4_signalled((signal.SIGKILL, 0.2), anew=True), soft=False),
    "PX4 killed and started anew while the companion waits": Attack(
        px4_signalled((signal.SIGKILL, 0.2), anew=True, arm=False), codes=(0, 1)
    ),
    "PX4 stands still for 0.4 s": Attack(px4_signalled((signal.SIGSTOP, 0.4), (signal.SIGCONT, 0.0)), codes=(0, 1)),
    "PX4 stands still for 2 s": Attack(px4_signalled((signal.SIGSTOP, 2.0), (signal.SIGCONT, 0.0))),
    "PX4 stands still for 6 s": Attack(px4_signalled((signal.SIGSTOP, 6.0), (signal.SIGCONT, 0.0))),
    "Hold chosen": Attack(chosen(HOLD)),
    "Return chosen": Attack(chosen(RETURN)),
    "Land chosen": Attack(chosen(LAND)),
    "Position chosen": Attack(chosen((3.0, 0.0)), codes=(0, 1)),
    "Takeoff chosen": Attack(chosen(TAKEOFF)),
    "Hold, 0.2 s later OFFBOARD": Attack(chosen(HOLD, (6.0, 0.0)), codes=(0, 1), keeps=False),
    "Hold, 2 s later OFFBOARD": Attack(chosen(HOLD, (6.0, 0.0), apart_s=2.0), keeps=False),
    "force-disarmed in the air": Attack(commanded((ARM, 0.0, _FORCE)), soft=False),
    "disarmed in the air (PX4 denies it)": Attack(commanded((ARM, 0.0, 0.0)), codes=(0,)),
    "terminated in the air": Attack(commanded((185.0, 1.0)), soft=False),
    "armed again and again, reboot and calibration asked for": Attack(
        commanded((ARM, 1.0, 0.0), (246.0, 1.0), (241.0, 1.0), (511.0, 30.0, 1e6), (31000.0,)), codes=(0,)
    ),
    "MPC_THR_HOVER 0.3 in flight": Attack(parameters_set(("MPC_THR_HOVER", 0.3)), codes=(0,)),
    "COM_OF_LOSS_T 5 in flight": Attack(parameters_set(("COM_OF_LOSS_T", 5.0)), codes=(0, 1)),
    "COM_OF_LOSS_T 0 in flight": Attack(parameters_set(("COM_OF_LOSS_T", 0.0)), codes=(0, 1)),
    "rate limits of 40 deg/s in flight": Attack(
        parameters_set(("MC_ROLLRATE_MAX", 40.0), ("MC_PITCHRATE_MAX", 40.0)), codes=(0, 1)
    ),
    "THR_MDL_FAC 0.5 in flight": Attack(parameters_set(("THR_MDL_FAC", 0.5)), codes=(0, 1)),
    "COM_OBL_RC_ACT 6 (terminate) in flight": Attack(parameters_set(("COM_OBL_RC_ACT", 6.0)), codes=(0, 1)),
    "THR_MDL_FAC 0.5 while it waits": Attack(
        while_waiting(lambda scene: scene.px4.set_param("THR_MDL_FAC", 0.5)), codes=(0, 1)
    ),
    "COM_OF_LOSS_T 5 while it waits": Attack(
        while_waiting(lambda scene: scene.px4.set_param("COM_OF_LOSS_T", 5.0)), codes=(1,)
    ),
    "the ground station falls silent (NAV_DLL_ACT 2)": Attack(
        _gcs_lost, params=(("NAV_DLL_ACT", 2.0), ("COM_DL_LOSS_T", 5.0))
    ),
    "low battery (COM_LOW_BAT_ACT 3)": Attack(
        parameters_set(("SIM_BAT_MIN_PCT", 3.0)), params=(("SIM_BAT_DRAIN", 8.0), ("COM_LOW_BAT_ACT", 3.0))
    ),
    "PX4's fence of 2 m, Hold": Attack(parameters_set(("GF_MAX_HOR_DIST", 2.0)), params=(("GF_ACTION", 2.0),)),
    "PX4's fence of 2 m, Return": Attack(parameters_set(("GF_MAX_HOR_DIST", 2.0)), params=(("GF_ACTION", 3.0),)),
    "PX4's fence of 2 m, Land": Attack(parameters_set(("GF_MAX_HOR_DIST", 2.0)), params=(("GF_ACTION", 5.0),)),
    "no GPS any more": Attack(parameters_set(("SIM_GPS_USED", 0.0)), codes=(0, 1), soft=False),
    "started while it flies in Hold, --arm": Attack(already_flying(arm=True)),
    "started while it flies in Hold, without --arm": Attack(already_flying(arm=False), codes=(130,)),
    "started in Hold, the pilot gives it the vehicle": Attack(
        already_flying(arm=False, offboard_after_s=12.0), codes=(0, 1), keeps=False
    ),
    "started while it returns, --arm": Attack(already_flying(RETURN, arm=True)),
    "SIGINT": Attack(signalled((signal.SIGINT, 0.0)), codes=(130,)),
    "SIGTERM": Attack(signalled((signal.SIGTERM, 0.0)), codes=(130,)),
    "SIGHUP": Attack(signalled((signal.SIGHUP, 0.0)), codes=(130,)),
    "SIGINT twice": Attack(signalled((signal.SIGINT, 0.3), (signal.SIGINT, 0.0)), codes=(130,)),
    "the dead-man killed": Attack(_dead_man(signal.SIGKILL)),
    "the dead-man stopped": Attack(_dead_man(signal.SIGSTOP)),
}
