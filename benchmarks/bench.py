"""`make bench`: what the parts cost, as multiples of a fixed reference kernel, into docs/benchmarks.md.

    python -m benchmarks.bench             measure and write the table between the marks
    python -m benchmarks.bench --check     a short form, compared: exit code 1 where a part takes 4/3 of its multiple

Two reference kernels that never change stand for the machine: one compiled (products of a matrix of 300 x 300 and a
vector), one in Python (dictionaries, tuples, packing of numbers).  A part is held to the kernel that is like it, so
hosts can be compared: the multiples should be much the same, whatever the machine.  Parts and kernels take turns, and
of each the quickest turn counts: a busy neighbour can only make one slower.  Measured is processor time, so that a
neighbour that is given the processor meanwhile counts for nothing.

Multiples differ from one kind of processor to another (wider registers, larger caches) by more than a quarter: each
kind has its table, and on one that has none nothing is held to anything, and that is said.
"""

from __future__ import annotations

import itertools
import os
import platform
import re
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite.binding import get_host_cpu_name  # type: ignore[import-untyped]
from threadpoolctl import threadpool_limits

from benchmarks import barrier, bench_peers, campaign, gap_timing, plant
from benchmarks.bench_peers import Work
from flightstack.cli import files
from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.versions import commit
from flightstack.gap.workflow import analyse
from flightstack.gp import RecursiveGP, SquaredExponential
from flightstack.jit import njit
from flightstack.types import F64
from flightstack.vehicle import parse_vehicle, with_effects
from flightstack_logs.topics import TOPICS
from flightstack_logs.writer import FlightLog
from mavlink_bridge import messages
from mavlink_bridge.link import Link

PAGE = Path(__file__).resolve().parents[1] / "docs/benchmarks.md"
BEGIN, END = "<!-- make bench: begin -->", "<!-- make bench: end -->"
ROUNDS, SHORT_ROUNDS, MORE_ROUNDS = 5, 1, 11
"""Turns of each part: measuring, comparing, and at most of what seems too slow: perhaps a neighbour was busy."""
SLOWER = 4.0 / 3.0
"""Three quarters of the speed: as far as a part may fall behind its kernel."""
_TOLD_TICKS = 25
"""Ticks between two words of a flight on its progress."""
_COLUMNS = 5
COMPILED, PYTHON = "reference, compiled", "reference, Python"
UNHELD = ""
"""Compared with nothing: a busy neighbour makes what it likes of a 99th percentile."""
GP, LINK, PLANT, LOG = "Gaussian process, 300 points, 9 to 6", "MAVLink message, both ends", "plant, no effect", "log"


@dataclass(slots=True)
class Part:
    """One line of the table."""

    name: str
    piece: str
    kernel: str
    measure: Callable[[], float]
    """Time of a piece, us."""
    beside: str = ""
    """Part that it is a peer of, or a floor."""
    held: bool = True
    """Compared; what goes through more memory than a core has of its own is its neighbours' as well."""
    us: float = field(default=np.inf)
    """The least so far."""

    def turn(self) -> None:
        """Measure once more."""
        self.us = min(self.us, self.measure())


def timed(work: Work) -> Callable[[], float]:
    """Processor time of a piece, us."""

    def measure() -> float:
        began = time.process_time()
        pieces = work()
        return 1e6 * (time.process_time() - began) / pieces

    return measure


@njit
def _products(matrix: F64, vector: F64, out: F64, count: int) -> None:
    for _ in range(count):
        for i in range(matrix.shape[0]):
            total = 0.0
            for j in range(matrix.shape[1]):
                total += matrix[i, j] * vector[j]
            out[i] = total


def _compiled() -> int:
    _products(_MATRIX, _MATRIX[0], _OUT, 100)
    return 100


def _python(count: int = 2000) -> int:
    pack, seen = struct.Struct("<IffB").pack, {}
    for k in range(count):
        data = pack(k, 0.5 * k, 1.0, k & 0xFF)
        seen[k & 0x3F] = (k, len(data), data[4:8])
    return count


_MATRIX, _OUT = np.cos(np.arange(90_000.0)).reshape(300, 300), np.empty(300)


def _gp_step() -> Work:
    x, y = bench_peers.points()
    kernel = SquaredExponential(1.0, tuple(bench_peers.SCALES))
    gp = RecursiveGP(kernel, bench_peers.NOISE, input_dim=bench_peers.INPUTS, output_dim=bench_peers.OUTPUTS)
    gp.add(x[:300], y[:300])

    def work() -> int:
        for k in range(300):
            gp.remove(gp.oldest())
            gp.add(x[k], y[k])
            gp.predict(x[k])
        return 300

    return work


def _link() -> Work:
    ours, theirs = Link(1, 1), Link(240, 191)
    force, rate, field_gauss = (0.1, 0.2, -9.8), (0.01, 0.02, 0.03), (0.2, 0.0, 0.4)
    message = messages.HighresImu(1, force, rate, field_gauss, 1013.0, 0.0, 488.0, 25.0, 63)

    def work() -> int:
        for k in range(500):
            ours.send(message)
            for data in ours.datagrams_to_send():
                theirs.receive_datagram(data, k)
            theirs.take_events()
        return 500

    return work


def _log(folder: Path) -> Work:
    log = FlightLog.open(folder / "bench.mcap", metadata={}, compact=True)
    width = sum(max(field.size, 1) for field in TOPICS["/vehicle/attitude"].fields)
    rows = np.random.default_rng(0).normal(size=(1000, width))
    ticks = itertools.count()

    def work() -> int:
        for row in rows:
            log.write("/vehicle/attitude", 4000 * next(ticks), row)
        assert not log.failed, log.failed
        return len(rows)

    return work


def _certificate(folder: Path) -> Callable[[], float]:
    """The last certificate of a flight, made anew from what it was made of; us."""
    begun = barrier.flown("paper-tracking", 8.0, folder / "certified")[-1]
    return lambda: 1e3 * barrier.timed(begun)[0]


def _gap(folder: Path) -> Work:
    """A clean minute at 125 Hz: read, compared, named, held out; its page is not written."""
    log, file = gap_timing.minute("clean", folder)
    vehicle, _ = files.load_vehicle(str(file))

    def work() -> int:
        analyse([log], vehicle)
        return 1

    return work


def _flight(scenario: str, seconds: float) -> list[Part]:
    """A tick of a flight in lockstep, both ends and the log; what its learner and its filter took of it."""
    seen: dict[str, Any] = {}

    def tick_us() -> float:
        told: list[float] = []

        def on_progress(share: float, words: str) -> None:
            if not words.startswith("compiling"):
                told.append(time.process_time())

        with tempfile.TemporaryDirectory() as folder:
            options = FlyOptions(out=Path(folder), scenario=scenario, duration_s=seconds, seed=1)
            result = fly(
                options, stop_requested=lambda: "", on_progress=on_progress, report_wanted=lambda result: False
            )
        seen.update(result.as_json())
        return 1e6 * (told[-1] - told[0]) / (_TOLD_TICKS * (len(told) - 1))

    def of(*keys: str) -> Callable[[], float]:
        def measure() -> float:
            found: Any = seen
            for key in keys:
                found = found[key]
            return float(found)

        return measure

    return [
        Part(f"lockstep flight, {scenario}", "tick, all of it", PYTHON, tick_us),
        Part(f"{scenario}: learner, median", "step", COMPILED, of("gp", "step_us", "p50")),
        Part(f"{scenario}: learner, p99", "step", UNHELD, of("gp", "step_us", "p99")),
        Part(f"{scenario}: safety filter, median", "solved step", PYTHON, of("qp", "solve_us", "p50")),
    ]


def parts(folder: Path) -> list[Part]:
    """The table's lines, in order; `folder`: for what they need."""
    text = (plant.ROOT / "flightstack/data/vehicles" / "quad-x.toml").read_text()
    plain = parse_vehicle(text, "quad-x.toml")
    lines = [
        Part(COMPILED, "product 300 x 300", COMPILED, timed(_compiled)),
        Part(PYTHON, "pass of its loop", PYTHON, timed(_python)),
        Part(GP, "exchange, prediction", COMPILED, timed(_gp_step())),
        Part(LINK, "message", PYTHON, timed(_link())),
    ]
    for vehicle, words in ((plain, "no effect"), (with_effects(plain, plant.ALL_EFFECTS), "every effect")):
        batch = timed(plant.batch(vehicle, plant.STEPS, threads=1))
        flown = timed(plant.closed_loop(vehicle, threads=1))
        lines += [
            Part(f"plant, {words}", "RK4 step of 1 ms", COMPILED, timed(plant.loop(vehicle))),
            Part(f"plant, batch of {plant.BATCH}, one thread, {words}", "vehicle's step", COMPILED, batch, held=False),
            Part(f"closed loop, the same, {words}", "vehicle's tick", COMPILED, flown, held=False),
        ]
    return [
        *lines,
        Part(LOG, "row of numbers, chunks included", PYTHON, timed(_log(folder))),
        Part("certificate of a flight, anew", "certificate", COMPILED, _certificate(folder)),
        Part("gap, a clean minute at 125 Hz, no page", "log", PYTHON, timed(_gap(folder))),
        *_flight("hover", 4.0)[:1],
        *_flight("paper-tracking", 8.0),
    ]


def peers() -> list[Part]:
    """Lines of others' means for a piece of one of ours."""
    row = bytes(range(8 * 8))
    return [
        Part(name, "the same", UNHELD, timed(work), beside)
        for beside, found in (
            (GP, bench_peers.of_the_process()), (LINK, bench_peers.of_the_link()),
            (PLANT, bench_peers.of_the_plant()), (LOG, bench_peers.of_the_log(row)),
        )
        for name, work in found
    ]  # fmt: skip


def processor() -> str:
    """Name and, of those that share one, kind."""
    return f"{campaign.processor()} ({get_host_cpu_name()})"


def table(lines: list[Part]) -> str:
    """As markdown, with the machine it was measured on."""
    known = {each.name: each.us for each in lines}
    load = os.getloadavg()[0]
    rows = [
        f"{date.today()}, {processor()}, Python {platform.python_version()}, flightstack {commit()}, "
        f"load {load:.1f} at the end:",
        "",
        "| part | piece | us | a second | times its kernel |",
        "| --- | --- | --: | --: | --: |",
    ]
    for each in lines:
        which = each.kernel.removeprefix("reference, ")
        times = f"{each.us / known[each.kernel]:.3g} x {which}" if which else ""
        if each.beside:
            times = f"{each.us / known[each.beside]:.3g} times {each.beside}"
        rows.append(f"| {each.name} | {each.piece} | {each.us:.3g} | {1e6 / each.us:,.0f} | {times} |")
    return "\n".join(rows)


def multiples(text: str) -> dict[str, float]:
    """Part -> multiple of its kernel, of a table."""
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if " x " in line]
    return {row[0]: float(row[-1].split()[0]) for row in cells if len(row) == _COLUMNS}


def tables(text: str) -> dict[str, str]:
    """Processor -> its table, of what stands between the marks."""
    parts = (part.strip() for part in re.split(r"(?m)^(?=\d{4}-\d\d-\d\d, )", text))
    return {found[1]: part for part in parts if (found := re.match(r"\S+, (.*?), Python ", part))}


def behind(then: dict[str, float], now: dict[str, float]) -> dict[str, str]:
    """Which parts fell behind their kernel by a quarter of their speed or more, and what to say of each."""
    return {
        name: f"{name}: {now[name]:.3g} times its kernel, {before:.3g} are stated"
        for name, before in then.items()
        if name in now and now[name] > SLOWER * before
    }


def check(lines: list[Part], stated: str) -> str:
    """Measure a few turns; what is to be said where a part is slower than stated, else nothing."""
    own = tables(stated).get(processor())
    if own is None:
        print(f"not compared: docs/{PAGE.name} has no table of {processor()}; make bench writes one")
        return ""
    lines = [each for each in lines if each.held]
    for each in lines:
        if each.name == each.kernel:  # of one turn it might be slow by chance, and everything else seem quick
            each.turn()
            each.us = np.inf  # that one compiled
            for _ in range(ROUNDS):
                each.turn()
    slow = {each.name: "" for each in lines}
    for turn in range(SHORT_ROUNDS + MORE_ROUNDS):
        for each in lines:
            if each.name in slow or each.name == each.kernel:
                each.turn()
        if turn + 1 < SHORT_ROUNDS:
            continue
        slow = behind(multiples(own), multiples(table(lines)))
        if not slow:
            break
    print(table(lines))
    return "\n".join(["error: slower than stated", *slow.values()]) if slow else ""


def main() -> None:
    """Measure, then write or compare."""
    if set(sys.argv[1:]) - {"--check"}:
        sys.exit("error: known is --check")
    page = PAGE.read_text("utf-8")
    head, _, rest = page.partition(BEGIN)
    stated, mark, tail = rest.partition(END)
    if not mark:
        sys.exit(f"error: {PAGE} lacks the marks {BEGIN} and {END}")
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1, "blas"):
        lines = parts(Path(folder))
        if "--check" in sys.argv:
            sys.exit(check(lines, stated) or 0)
        lines += peers()
        for _ in range(ROUNDS):
            for each in lines:
                each.turn()
    found = table(lines)
    print(found)
    every = "\n\n".join((tables(stated) | {processor(): found}).values())
    PAGE.write_text(f"{head}{BEGIN}\n{every}\n{END}{tail}", "utf-8")


if __name__ == "__main__":
    main()
