"""A flight with an outsider in it: companions, PX4, forged datagrams; and what is to be said of it afterwards."""

from __future__ import annotations

import itertools
import math
import random
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.px4.companion import command, start
from benchmarks.px4.records import Bench
from benchmarks.px4.station import OFFBOARD_PORT, Px4

SOFT_MPS = 1.5
AIRBORNE_M, FLOWN_S, TRACK_S = 1.5, 6.0, 20.0
LIMIT_S = 100.0
OFFBOARD, SET_MODE = 6, 176


@dataclass
class Scene:
    """One attack under way."""

    bench: Bench
    px4: Px4
    folder: Path
    process: subprocess.Popen[bytes] | None = None
    began_s: float = 0.0
    others: list[subprocess.Popen[bytes]] = field(default_factory=list)
    sockets: list[socket.socket] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def mode(self, main: float, sub: float = 0.0) -> None:
        """As a ground station chooses it."""
        self.px4.command(SET_MODE, 1.0, main, sub)

    def begin(self, *more: str, scenario: str = "figure8") -> None:
        """Start the companion and let it fly for a while."""
        self.process = start(self.px4, self.folder, scenario, "--duration", f"{TRACK_S:g}", *more)
        if not self.px4.wait(lambda: self.px4.height_m > AIRBORNE_M or self.ended, LIMIT_S):
            self.notes.append("did not take off")
        time.sleep(FLOWN_S)

    @property
    def ended(self) -> bool:
        """The companion has ended."""
        return self.process is not None and self.process.poll() is not None

    @property
    def said(self) -> str:
        """All that the companion said."""
        file = self.folder / "companion.txt"
        return file.read_text(errors="replace") if file.exists() else ""

    def wait(self, wanted: Callable[[], bool], limit_s: float) -> bool:
        """Whether it came true in time."""
        return self.px4.wait(wanted, limit_s)

    def beside(self, name: str, *words: str) -> subprocess.Popen[bytes]:
        """Another companion, its files in a folder of its own."""
        folder = self.folder / name
        folder.mkdir()
        said = (folder / "companion.txt").open("wb")
        line = command(self.px4, folder, "hover", *words)  # of an option that is given twice the second counts
        self.others.append(subprocess.Popen(line, stdout=said, stderr=subprocess.STDOUT))
        return self.others[-1]

    def forge(self, seconds: float, *frames: bytes) -> None:
        """Datagrams to the companion's port from a port of one's own, a thousand a second."""
        out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sockets.append(out)
        draw, until = random.Random(1), time.monotonic() + seconds
        target = ("127.0.0.1", OFFBOARD_PORT + self.px4.instance)
        while time.monotonic() < until:
            for _ in range(10):
                out.sendto(draw.choice(frames) if frames else draw.randbytes(draw.randrange(1, 300)), target)
            time.sleep(0.01)


def judge(scene: Scene, codes: tuple[int, ...], *, keeps: bool, soft: bool) -> tuple[list[str], str]:
    """What was wrong, and what happened, in words."""
    assert scene.process is not None
    px4, wrong = scene.px4, list(scene.notes)
    try:
        code: int | None = scene.process.wait(LIMIT_S)
    except subprocess.TimeoutExpired:
        code = None
    if code not in codes:
        wrong.append(f"exit code {code}")
    said = scene.said
    if "Traceback" in said:
        wrong.append("raised")
    px4.wait(lambda: False, 3.0)
    after = [mode if is_armed else 0 for at_s, mode, is_armed in px4.modes if at_s > scene.began_s]
    armed = [is_armed for at_s, _, is_armed in px4.modes if at_s > scene.began_s]
    left = next((i for i, mode in enumerate(after) if mode >> 16 & 0xFF != OFFBOARD), None)
    if keeps and left is not None and any(mode >> 16 & 0xFF == OFFBOARD for mode in after[left:]):
        wrong.append("OFFBOARD again")
    if any(later and not sooner for sooner, later in itertools.pairwise(armed)):
        wrong.append("armed again")
    low = [t.vel_d_mps for t in px4.truth if t.up_m < 0.1 and t.at_s > scene.began_s]
    tilt = max((math.degrees(t.tilt_rad) for t in px4.truth if t.at_s > scene.began_s), default=0.0)
    if soft and max(low, default=0.0) > SOFT_MPS:
        wrong.append(f"ground at {max(low):.1f} m/s")
    modes = " ".join(f"{mode >> 16 & 0xFF}.{mode >> 24}" for mode in dict.fromkeys(after))
    why = next((line.strip() for line in said.splitlines() if " why" in line or "error:" in line), "")
    return wrong, f"exit {code}, {' '.join(why.split())[:170]!r}, tilt {tilt:.0f}, modes {modes or '-'}"


def end(scene: Scene) -> None:
    """Whoever still runs is killed."""
    for process in (*scene.others, *([scene.process] if scene.process else [])):
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.kill()
            process.wait()
    for each in scene.sockets:
        each.close()
