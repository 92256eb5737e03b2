"""Strangers around the shield on a real PX4: turns, stalls while arming, bad links, other stations, PX4's own fence."""

from __future__ import annotations

import itertools
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.px4.deeds import ARM, HOLD
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.relay import Manner, Relay
from benchmarks.px4.scene import OFFBOARD
from benchmarks.px4.station import OFFBOARD_PORT
from benchmarks.px4.subjects.shield_outsiders import NEAR_M, Behind, Deed, flown, wall

ASKED = (
    "Around the shield (SIH_MASS 0.7, PX4 else at default parameters), as under shield_outsiders: the site is never "
    "left, whoever takes the vehicle keeps it, the ground is met at 1.5 m/s at most, nothing raises, nothing is left "
    "armed on the ground, what hinders is told in one line."
)
RUNS = 1
_CLIENT = Path(__file__).parents[3] / "tests" / "client"
_ONCE, _SLOW = _CLIENT / "program_once.py", _CLIENT / "program_slow_streams.py"
_ALL_KINDS = _CLIENT / "program_all_kinds.py"
_LATE = Manner(up_s=0.015, down_s=0.015)
_OFFBOARD = float(OFFBOARD), 0.0
_LIMIT_S = 60.0


def run(bench: Bench, runs: int) -> list[Row]:
    """Every deed `runs` times; `ATTACKS` in the environment names those to fly."""
    return flown(bench, runs, DEEDS)


def _turns(b: Behind) -> None:
    b.shield()
    b.program("40")
    if not b.px4.wait(lambda: b.px4.height_m > 6.0, _LIMIT_S):
        b.notes.append("did not take off")
    time.sleep(15.0)
    b.expect(_OFFBOARD, after_s=0.0)


def _stalls_while_arming(*stalls: tuple[float, float]) -> Callable[[Behind], None]:
    """Stalls: seconds after the motors' first turn (of the program's asking once), and their length."""

    def deed(b: Behind) -> None:
        b.shield()
        b.program(program=_ONCE)
        if not b.px4.wait(lambda: b.px4.spins, _LIMIT_S):
            b.notes.append("never armed")
        for after_s, stalled_s in stalls:
            time.sleep(after_s)
            b.shields[-1].send_signal(signal.SIGSTOP)
            time.sleep(stalled_s)
            b.shields[-1].send_signal(signal.SIGCONT)
        if not b.px4.wait(lambda: b.px4.height_m > 1.5 or not b.px4.armed, 15.0):
            b.notes.append("left armed on the ground")

    return deed


def _station(*words: Callable[[Behind], None], watched_s: float = 15.0) -> Callable[[Behind], None]:
    """A ground station does something in flight; the program keeps its vehicle."""

    def deed(b: Behind) -> None:
        b.begin()
        for word in words:
            word(b)
            time.sleep(0.3)
        b.expect(_OFFBOARD, after_s=watched_s)

    return deed


def _sets(name: str, value: float) -> Callable[[Behind], None]:
    return lambda b: b.px4.set_param(name, value)


def _places(b: Behind) -> None:
    """Places far outside of the site, by the ground station's own link, for 3 s."""
    for _ in range(150):
        b.px4.link.mav.set_position_target_local_ned_send(
            0, b.px4.instance + 1, 1, 1, 0b1001_1111_1000, 100.0, 0.0, -8.0, 0, 0, 0, 0, 0, 0, 0.0, 0.0
        )
        time.sleep(0.02)


def _fence(b: Behind) -> None:
    b.begin()
    b.px4.set_param("GF_MAX_HOR_DIST", 10.0)
    b.expect(HOLD, (4.0, 5.0), after_s=15.0)


def _sticks_lost(b: Behind) -> None:
    ends = threading.Event()

    def move() -> None:
        while not ends.wait(0.04):
            b.px4.link.mav.manual_control_send(b.px4.instance + 1, 0, 0, 500, 0, 0)

    thread = threading.Thread(target=move)
    thread.start()
    try:
        b.begin()
        time.sleep(3.0)
    finally:
        ends.set()
        thread.join()
    b.expect(HOLD, (4.0, 5.0), (3.0, 0.0), after_s=9.0)


def _relayed(manner: Manner, whole: Callable[[Behind], None] | None = None) -> Callable[[Behind], None]:
    def deed(b: Behind) -> None:
        with Relay(OFFBOARD_PORT + b.px4.instance, manner) as relay:
            b.address = f"udpin:127.0.0.1:{relay.port}"
            if whole is None:
                b.begin()
                time.sleep(15.0)
            else:
                whole(b)
            b.close()

    return deed


def _all_kinds(b: Behind) -> None:
    """Places, velocities, attitudes, body rates; what the program says of them goes into the notes that are printed."""
    b.shield()
    b.program(program=_ALL_KINDS)
    said = b.folder / "program0.txt"
    if not b.px4.wait(lambda: "done" in said.read_text(), 2.0 * _LIMIT_S + 40.0):
        b.notes.append("not done with every kind")
    print(" | ".join(said.read_text().splitlines()), flush=True)


def _slow_streams(b: Behind) -> None:
    """The program asks for slow streams on the shield's own link."""
    b.shield()
    b.program(program=_SLOW)
    b.races()
    b.expect(_OFFBOARD, after_s=15.0)


def _second_shield(b: Behind) -> None:
    b.begin()
    b.shield()
    second = b.shields.pop()
    if not b.px4.wait(lambda: second.poll() is not None, 40.0):
        b.notes.append("two shields on one port")
        second.kill()
    b.expect(_OFFBOARD, after_s=1.0)


def _no_satellites(b: Behind) -> None:
    b.begin()
    b.px4.set_param("SIM_GPS_USED", 0.0)
    time.sleep(3.0)
    b.px4.set_param("SIM_GPS_USED", 10.0)
    b.expect(HOLD, after_s=6.0)


def _lists(b: Behind) -> None:
    """Parameters listed again and again, as a ground station that connects anew."""
    for _ in range(10):
        b.px4.link.mav.param_request_list_send(b.px4.instance + 1, 1)
        time.sleep(0.5)


def _disarm_and_reboot(b: Behind) -> None:
    b.px4.command(ARM, 0.0, 0.0)
    time.sleep(0.5)
    b.px4.command(246, 1.0)


_RATES = tuple(
    _sets(f"MC_{axis}RATE_{gain}", value)
    for axis, (gain, value) in itertools.product(("ROLL", "PITCH"), (("P", 0.45), ("I", 0.6)))
)
DEEDS = {
    "a turn of 40 degrees a second": Deed(_turns, "turning was held back"),
    "stopped for 0.3 s as the motors turn": Deed(_stalls_while_arming((0.0, 0.3))),
    "stopped for 0.7 s as the motors turn": Deed(_stalls_while_arming((0.0, 0.7))),
    "stopped for 0.7 s as it is about to climb": Deed(_stalls_while_arming((0.6, 0.7))),
    "stopped for 0.7 s at the tick of the climb": Deed(_stalls_while_arming((1.0, 0.7))),
    "stopped for 2 s as it is about to climb": Deed(_stalls_while_arming((0.6, 2.0))),
    "stopped for 0.2 s twice as the motors turn": Deed(_stalls_while_arming((0.0, 0.2), (0.6, 0.2))),
    "5 % lost, 5 % doubled, shuffled over 8 ms": Deed(_relayed(Manner(lost=0.05, doubled=0.05, jitter_s=0.008))),
    "20 ms more each way": Deed(_relayed(Manner(up_s=0.02, down_s=0.02))),
    "places, velocities, attitudes, body rates": Deed(_all_kinds),
    "places, velocities, attitudes, body rates, 15 ms more each way": Deed(_relayed(_LATE, _all_kinds)),
    "towards a wall, 15 ms more each way": Deed(_relayed(_LATE, wall), north_m=NEAR_M),
    "no satellites for 3 s": Deed(_no_satellites, "the satellites are lost"),
    "rate gains three times as high": Deed(_station(*_RATES), "MC_ROLLRATE_P is 0.45 now"),
    "THR_MDL_FAC 0.5 in flight": Deed(_station(_sets("THR_MDL_FAC", 0.5)), "THR_MDL_FAC is 0.5 now"),
    "a ground station sends places outside": Deed(_station(_places)),
    "PX4's fence of 10 m inside the site": Deed(_fence, params=(("GF_ACTION", 2.0),)),
    "sticks lost in flight": Deed(_sticks_lost, params=(("COM_RC_IN_MODE", 1.0),)),
    "system id 3": Deed(_station(), params=(("MAV_SYS_ID", 3.0),)),
    "a program that asks for slow streams": Deed(_slow_streams),
    "a second shield on its port": Deed(_second_shield),
    "parameters listed again and again": Deed(_station(_lists)),
    "disarming and reboot asked for": Deed(_station(_disarm_and_reboot)),
}
