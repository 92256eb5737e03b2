"""An outsider around the shield on a real PX4: programs, shields and PX4s that die or stop, a pilot who takes over."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from benchmarks.px4.companion import MASS_KG, light_vehicle
from benchmarks.px4.deeds import ARM, HOLD, LAND, RETURN
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.scene import OFFBOARD, SET_MODE, SOFT_MPS
from benchmarks.px4.station import Px4, Truth, log_folder

ASKED = (
    "A program races at 4 m/s behind the shield (SIH_MASS 0.7, PX4 else at default parameters), an outsider "
    "interferes: the site is never left, whoever takes the vehicle keeps it, the ground is met at 1.5 m/s at most, "
    "nothing raises, what ends or hinders the shield is told in one line."
)
RUNS = 1
SITE = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = 20.0
inside = [[-30.0, -20.0], [{north}, -20.0], [{north}, 20.0], [-30.0, 20.0]]
"""
_NORTH_M, NEAR_M = 30.0, 13.0
"""The program turns 15 m north: with the near wall it never gets there."""
_PORT = 14640
_PROGRAM = Path(__file__).parents[3] / "tests" / "client" / "shielded_program.py"
_LIMIT_S = 70.0
_POSITION = (3.0, 0.0)


@dataclass
class Behind:
    """A shield, the programs behind it and the PX4 before it."""

    bench: Bench
    px4: Px4
    folder: Path
    north_m: float
    address: str = ""
    """Of the vehicle, for the shields."""
    shields: list[subprocess.Popen[bytes]] = field(default_factory=list)
    programs: list[subprocess.Popen[bytes]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    seen: list[Truth] = field(default_factory=list)
    """Of a PX4 that was started anew since."""

    def shield(self) -> None:
        """Start another one."""
        (self.folder / "field.toml").write_text(SITE.format(north=self.north_m))
        words = [*self.bench.prefix, sys.executable, "-m", "flightstack", "shield"]
        words += ["--connect", self.address or self.px4.address]
        words += ["--serve", f"udpout:127.0.0.1:{_PORT}", "--site", str(self.folder / "field.toml")]
        words += ["--vehicle", str(light_vehicle(self.folder)), "--sensors", "px4-sih-ekf"]
        said = (self.folder / f"shield{len(self.shields)}.txt").open("wb")
        self.shields.append(subprocess.Popen(words, stdout=said, stderr=subprocess.STDOUT))

    def program(self, *more: str, program: Path = _PROGRAM) -> None:
        """Start another one."""
        said = (self.folder / f"program{len(self.programs)}.txt").open("wb")
        words = [sys.executable, str(program), f"udpin:127.0.0.1:{_PORT}", "8", *more]
        self.programs.append(subprocess.Popen(words, stdout=said, stderr=subprocess.STDOUT))

    def begin(self) -> None:
        """Take off and race."""
        self.shield()
        self.program()
        self.races()

    def races(self) -> None:
        """Until the program has its way again."""
        if not self.px4.wait(lambda: bool(self.px4.truth) and abs(self.px4.truth[-1].vel_n_mps) > 3.0, _LIMIT_S):
            self.notes.append("the program never got fast")

    def mode(self, main: float, sub: float = 0.0) -> None:
        """As a ground station chooses it."""
        self.px4.command(SET_MODE, 1.0, main, sub)

    def expect(self, *mains: tuple[float, float], after_s: float) -> None:
        """After a while PX4 is in one of these modes."""
        time.sleep(after_s)
        mode = self.px4.mode >> 16 & 0xFF, self.px4.mode >> 24
        if mode not in mains:
            self.notes.append(f"in mode {mode[0]}.{mode[1]}, not {' or '.join(f'{a:g}.{b:g}' for a, b in mains)}")

    def restart(self) -> None:
        """Another PX4 in place of this one."""
        self.seen += self.px4.truth
        self.px4.restart()

    @property
    def said(self) -> str:
        """All that the shields said."""
        files = sorted(self.folder.glob("shield*.txt"))
        return "\n".join(file.read_text(errors="replace") for file in files)

    def close(self) -> None:
        """End whoever still runs: the programs, then the shields, which hand over first."""
        for process in (*self.programs, *self.shields):
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
        for process in self.shields:
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(10.0)
                except subprocess.TimeoutExpired:
                    self.notes.append("the shield did not end")
                    process.kill()
        for process in self.programs:
            process.kill()
            process.wait()


class Deed(NamedTuple):
    """What is done, and what is to be said of it."""

    deed: Callable[[Behind], None]
    says: str = ""
    code: int = 130
    """Of the last shield."""
    north_m: float = _NORTH_M
    soft: bool = True
    returns: bool = False
    """PX4's Return climbs above the site."""
    params: tuple[tuple[str, float], ...] = ()


_OFFBOARD, _HOLD = (float(OFFBOARD), 0.0), HOLD


def _program_killed(b: Behind) -> None:
    b.begin()
    b.programs[-1].kill()
    b.expect(_HOLD, after_s=9.0)
    b.program()
    b.expect(_HOLD, after_s=5.0)  # it speaks, and nobody chose OFFBOARD
    b.mode(*_OFFBOARD)
    b.races()


def _program_stopped(b: Behind) -> None:
    b.begin()
    for stopped_s in (0.3, 1.0, 3.0):
        b.programs[-1].send_signal(signal.SIGSTOP)
        time.sleep(stopped_s)
        b.programs[-1].send_signal(signal.SIGCONT)
        b.expect(_OFFBOARD, after_s=3.0)
    b.programs[-1].send_signal(signal.SIGSTOP)
    b.expect(_HOLD, after_s=8.0)
    b.programs[-1].send_signal(signal.SIGCONT)
    b.expect(_HOLD, after_s=3.0)


def _second_program(b: Behind) -> None:
    b.begin()
    b.program()
    b.expect(_OFFBOARD, after_s=6.0)


def _pilot(*modes: tuple[float, float], back: bool) -> Callable[[Behind], None]:
    def deed(b: Behind) -> None:
        b.begin()
        for mode in modes:
            b.mode(*mode)
            b.expect(mode, after_s=6.0)
            if back:
                b.mode(*_OFFBOARD)
                b.races()

    return deed


def _lands_and_flies_again(b: Behind) -> None:
    b.begin()
    b.mode(*LAND)
    b.programs[-1].kill()
    if not b.px4.wait(lambda: not b.px4.armed, 60.0):
        b.notes.append("did not land")
    time.sleep(2.0)
    b.program()
    b.races()


def _sticks(b: Behind) -> None:
    b.begin()
    until = time.monotonic() + 8.0
    while time.monotonic() < until:
        b.px4.link.mav.manual_control_send(b.px4.instance + 1, 0, 0, 500, 0, 0)
        if b.px4.mode >> 16 & 0xFF == OFFBOARD:
            b.mode(*_POSITION)
        time.sleep(0.04)
    b.expect(_POSITION, after_s=0.0)


def wall(b: Behind) -> None:
    """Race towards a wall for a while."""
    b.begin()
    b.notes.clear()  # before a wall it need not get fast
    time.sleep(20.0)


def _shield_killed(b: Behind) -> None:
    b.begin()
    b.shields[-1].kill()
    b.expect(_HOLD, after_s=4.0)
    b.shield()
    time.sleep(12.0)
    b.mode(*_OFFBOARD)
    b.expect(_HOLD, after_s=4.0)
    b.mode(*LAND)
    if not b.px4.wait(lambda: not b.px4.armed, 60.0):
        b.notes.append("did not land")


def _shield_stopped(b: Behind) -> None:
    b.begin()
    for stopped_s in (0.1, 0.3, 0.45):
        b.shields[-1].send_signal(signal.SIGSTOP)
        time.sleep(stopped_s)
        b.shields[-1].send_signal(signal.SIGCONT)
        b.expect(_OFFBOARD, after_s=11.0)
    b.shields[-1].send_signal(signal.SIGSTOP)
    time.sleep(2.0)
    b.shields[-1].send_signal(signal.SIGCONT)
    b.expect(_HOLD, after_s=6.0)


def _dead_man(b: Behind) -> None:
    b.begin()
    children = Path(f"/proc/{b.shields[-1].pid}/task/{b.shields[-1].pid}/children").read_text().split()
    for child in children:
        if "dead_man" in Path(f"/proc/{child}/cmdline").read_text():
            os.kill(int(child), signal.SIGKILL)
    b.expect(_HOLD, after_s=4.0)


def _loss_time(b: Behind) -> None:
    b.begin()
    b.px4.set_param("COM_OF_LOSS_T", 5.0)
    b.shields[-1].kill()
    b.expect(_HOLD, after_s=5.0)


def _restarted(b: Behind) -> None:
    b.begin()
    b.px4.signal(signal.SIGKILL)
    time.sleep(0.5)
    b.restart()
    b.shields[-1].wait(20.0)


def _px4_killed(b: Behind) -> None:
    b.begin()
    b.px4.signal(signal.SIGKILL)
    time.sleep(6.0)


def _px4_stopped(b: Behind) -> None:
    b.begin()
    b.px4.signal(signal.SIGSTOP)
    time.sleep(0.4)
    b.px4.signal(signal.SIGCONT)
    b.expect(_OFFBOARD, after_s=4.0)
    b.px4.signal(signal.SIGSTOP)
    time.sleep(3.5)
    b.px4.signal(signal.SIGCONT)
    time.sleep(6.0)


def _disarmed(b: Behind) -> None:
    b.begin()
    b.px4.command(ARM, 0.0, 21196.0)
    time.sleep(6.0)


_UNHEARD = "nothing heard of the vehicle for 3 s"
DEEDS = {
    "program killed, another one 9 s later": Deed(_program_killed),
    "program stopped for 0.3, 1, 3 and 8 s": Deed(_program_stopped),
    "a second program on its port": Deed(_second_program),
    "Hold, and OFFBOARD again": Deed(_pilot(HOLD, back=True)),
    "Return": Deed(_pilot(RETURN, back=False), returns=True),
    "Position by sticks": Deed(_sticks),
    "landed, and flown again": Deed(_lands_and_flies_again),
    "a wall before the program's turn": Deed(wall, north_m=NEAR_M),
    "shield killed, another one in flight": Deed(_shield_killed, "armed before the shield heard it"),
    "shield stopped for 0.1, 0.3, 0.45 and 2 s": Deed(_shield_stopped),
    "its dead-man killed": Deed(_dead_man, "the dead-man's process has ended"),
    "COM_OF_LOSS_T 5 in flight, shield killed": Deed(_loss_time, code=-signal.SIGKILL),
    "PX4 killed and started anew": Deed(_restarted, "error: the vehicle restarted", code=1),
    "PX4 killed": Deed(_px4_killed, _UNHEARD),
    "PX4 stopped for 0.4 and 3.5 s": Deed(_px4_stopped, _UNHEARD),
    "force-disarmed": Deed(_disarmed, soft=False),
}


def run(bench: Bench, runs: int) -> list[Row]:
    """Every deed `runs` times, each on a PX4 of its own; `ATTACKS` in the environment names those to fly."""
    return flown(bench, runs, DEEDS)


def flown(bench: Bench, runs: int, deeds: Mapping[str, Deed]) -> list[Row]:
    """The rows of deeds."""
    wanted = os.environ.get("ATTACKS", "").split(",")
    return [_row(bench, name, deed, runs) for name, deed in deeds.items() if any(word in name for word in wanted)]


def _row(bench: Bench, name: str, deed: Deed, runs: int) -> Row:
    notes, seen = [], ""
    for number in range(runs):
        wrong, seen = _flown(bench, name, deed)
        print(f"{name}: {'; '.join(wrong) or 'good'} | {seen}", flush=True)
        notes += [f"run {number}: {'; '.join(wrong)}; {seen}"] if wrong else []
    return Row(name, seen, not notes, runs, notes)


def _flown(bench: Bench, name: str, deed: Deed) -> tuple[list[str], str]:
    """What was wrong, and what was seen."""
    folder = log_folder(bench, "shielded-" + "-".join(name.replace(",", "").split()))
    with Px4(bench, params={"SIH_MASS": MASS_KG, **dict(deed.params)}) as px4:
        behind = Behind(bench, px4, folder, deed.north_m)
        try:
            deed.deed(behind)
        finally:
            behind.close()
        truth = [*behind.seen, *px4.truth]
    wrong, code = behind.notes, behind.shields[-1].returncode
    outside = [
        t for t in truth if not (-30.0 <= t.north_m <= deed.north_m and abs(t.east_m) <= 20.0 and t.up_m <= 20.0)
    ]
    sink_mps = max((t.vel_d_mps for t in truth if t.up_m < 0.1), default=0.0)
    tilt = math.degrees(max((t.tilt_rad for t in truth if t.up_m > 0.5), default=0.0))
    if outside and not deed.returns:
        wrong.append(f"outside its site in {len(outside)} of {len(truth)} samples")
    if deed.soft and sink_mps > SOFT_MPS:
        wrong.append(f"ground at {sink_mps:.1f} m/s")
    if "Traceback" in behind.said:
        wrong.append("raised")
    if code != deed.code:
        wrong.append(f"exit code {code}")
    lines = [line for line in behind.said.splitlines() if deed.says and deed.says in line]
    if deed.says and len(lines) != 1:
        wrong.append(f"{deed.says!r} was said {len(lines)} times")
    told = f", {' '.join(lines[0].split())[:110]!r}" if lines else ""
    north = [t.north_m for t in truth]
    places = f"north {min(north):.0f} to {max(north):.0f} m, up to {max(t.up_m for t in truth):.0f} m"
    return wrong, f"exit {code}{told}; {places}, tilt {tilt:.0f}, ground met at {max(sink_mps, 0.0):.1f} m/s"
