"""Times of a flight's certificates, of cover and design beside a grid of hj_reachability, and the cells of a cover.

Run: python -m benchmarks.barrier
"""

from __future__ import annotations

import copy
import gc
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from benchmarks.reachability import grids
from flightstack.barrier import viability
from flightstack.barrier.certifier import OnlineCertifier
from flightstack.barrier.certifier_config import CertifierState
from flightstack.barrier.condition import Setting
from flightstack.barrier.cover import best_command, cover, outside, region_box
from flightstack.barrier.design import SafeSet, at_speed, grow, largest, slice_area, worst_slice_area
from flightstack.barrier.posterior import Accelerations
from flightstack.barrier.records import Authority, Certificate, Response
from flightstack.barrier.shapes import Barrier, Quadratic, Stopping
from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.workshop import Appointed
from flightstack.learning.learner import LearnerState, Learnt
from flightstack.types import Learned

U_LOW, U_HIGH = -2.80286, 9.81
SAFE = SafeSet(0.6)
LATE = Response(0.05, 0.0, 0.02)
SETTING = Setting(2.0, 0.02, 0.1, 0.004)
SHAPES: dict[str, Barrier] = {
    "quadratic": Quadratic(0.0, -0.9, 3.40, 0.37, 0.225),
    "stopping": Stopping(-0.583, 0.595, 0.06, 2.5, 9.0),
}


_LAST, _RUNS = 8, 3


def authority(error: float, nodes: int) -> Authority:
    """Constant, but given at this many speeds as from a learned bound."""
    v, one = np.linspace(-6.0, 6.0, nodes), np.ones(nodes)
    return Authority(v, U_HIGH * one, one, U_LOW * one, U_HIGH * one, error * one, error * one)


def milliseconds(job: Callable[[], object], runs: int) -> tuple[float, float]:
    """Median and 99th percentile."""
    took = []
    for _ in range(runs):
        begin = time.perf_counter()
        job()
        took.append(1e3 * (time.perf_counter() - begin))
    return float(np.median(took)), float(np.percentile(took, 99))


def uniform_cells(shape: Barrier, at: Authority) -> int:
    """Cells of the coarsest uniform grid, by doubling its lines, whose cells all hold a proof of the same kind."""
    e_low, e_high, v_low, v_high = region_box(shape, SETTING.eta)
    reach = at.reach(0.0)
    for n in (16, 23, 32, 45, 64, 91, 128, 181, 256, 362, 512):
        e, v, used, closed = np.linspace(e_low, e_high, n + 1), np.linspace(v_low, v_high, n + 1), 0, True
        for i in range(n):
            for j in range(n):
                box = (float(e[i]), float(e[i + 1]), float(v[j]), float(v[j + 1]))
                if outside(shape.rows, *box, SETTING.eta):
                    continue
                used += 1
                closed = closed and best_command(shape.rows, *box, SETTING, reach)[1] >= 0.0
            if not closed:
                break
        if closed:
            return used
    return -1


class Begun(NamedTuple):
    """What the work on a certificate began with, as copies."""

    certifier: OnlineCertifier
    learnt: Learnt
    learned: Learned
    state: CertifierState


def flown(scenario: str, duration_s: float, out: Path) -> list[Begun]:
    """Of a flight, in the order in which they were made."""
    found: list[Begun] = []
    make = Appointed.work

    def kept(
        self: Appointed,
        certifier: OnlineCertifier,
        learner: LearnerState | Learnt,
        learned: Learned,
        state: CertifierState,
    ) -> Iterator[Certificate | None]:
        held = replace(state, work=None)
        found.append(Begun(certifier.here(), *copy.deepcopy((learner.evidence(), learned, held))))
        return make(self, certifier, learner, learned, state)

    Appointed.work = kept  # type: ignore[method-assign]
    try:
        flight = fly(FlyOptions(scenario=scenario, duration_s=duration_s, out=out), stop_requested=lambda: "")
    finally:
        Appointed.work = make  # type: ignore[method-assign]
    assert flight.completed
    return found


def timed(begun: Begun, known: Accelerations | None = None) -> tuple[float, Certificate]:
    """Milliseconds of processor time that the certificate takes anew, and it; `known`: the posterior, where given."""
    freeze = Accelerations.frozen_steps
    if known is not None:
        Accelerations.frozen_steps = lambda *_: iter((known,))  # type: ignore[method-assign,assignment]
    work = begun.certifier.work(begun.learnt, begun.learned, copy.deepcopy(begun.state))
    try:
        began = time.process_time()
        (found,) = deque(work, maxlen=1)
        took = time.process_time() - began
    finally:
        Accelerations.frozen_steps = freeze  # type: ignore[method-assign]
    assert found is not None
    return 1e3 * took, found


def certificates(scenario: str, made: list[Begun], slice_only: bool = False) -> str:
    """How long the last of a flight's certificates take that have a region, with the posterior given and in all.

    `slice_only`: for the slice without speed and thrust across the axis, in place of as in flight.
    """
    timed(made[-1])  # loads what is compiled
    gc.freeze()  # as the process that makes them in flight
    given, whole, axes, points = list[float](), list[float](), 0, list[int]()
    for begun in reversed(made):
        one = begun.certifier
        if slice_only:
            config = replace(one.config, slice_only=True)
            one = OnlineCertifier(
                one.model, one.limits, one.region, initial=one.initial, config=config, safe=one.safe
            )  # fmt: skip
        known = deque(Accelerations.frozen_steps(begun.learnt, one.model), maxlen=1)[0]
        assert known is not None
        for _ in range(_RUNS):
            took, found = timed(begun._replace(certifier=one), known)
            if found.axes:  # else the work ends where an axis has no region
                given.append(took)
                whole.append(timed(begun._replace(certifier=one))[0])
                axes, points = len(found.axes), [*points, len(known.vertical.process.x)]
        if len(given) == _LAST * _RUNS:
            break
    name = f"{scenario}, {axes} axes" + ", slice alone" * slice_only
    rest = (
        f"{len(given) // _RUNS} | {np.median(given):.1f} | {max(given):.1f} | {np.median(whole):.1f} | {max(whole):.1f}"
    )
    return f"| {name} | {min(points)} to {max(points)} | {rest} |"


def main() -> None:
    """Print the tables."""
    print("| certificates of a flight | points | made | ms p50, posterior given | worst | ms p50, whole | worst |")
    print("|---|---|---|---|---|---|---|")
    with TemporaryDirectory() as folder:
        for scenario in ("gps-barrier", "paper-tracking"):
            made = flown(scenario, 60.0, Path(folder) / scenario)
            print(certificates(scenario, made))
            if scenario == "gps-barrier":
                print(certificates(scenario, made, slice_only=True))
    square = np.asfortranarray(np.eye(300) + 0.5)
    print(f"\none Cholesky factor of 300 points: {milliseconds(lambda: lapack.dpotrf(square, lower=1), 200)[0]:.2f} ms")
    print()
    print("| shape | authority's nodes | cover ms p50 / p99 | cells | uniform cells | grow ms p50 / p99 |")
    print("|---|---|---|---|---|---|")
    for name, shape in SHAPES.items():
        for nodes in (2, 25):
            at = authority(0.1, nodes)
            found = cover(shape, SETTING, at)
            assert found.closed
            proof = milliseconds(lambda: cover(shape, SETTING, at), 200)  # noqa: B023
            small = at_speed(shape, 0.8)
            assert grow(small, SAFE, SETTING, at, change=at_speed).barrier is not None, name
            growth = milliseconds(lambda: grow(small, SAFE, SETTING, at, change=at_speed), 200)  # noqa: B023
            uniform = str(uniform_cells(shape, at)) if nodes == 2 and name == "quadratic" else "-"
            print(
                f"| {name} | {nodes} | {proof[0]:.2f} / {proof[1]:.2f} | {len(found.cells)} | {uniform} "
                f"| {growth[0]:.2f} / {growth[1]:.2f} |"
            )
    print()
    print("| E m/s^2 | family | area | of the kernel | slice a = 0 | worst slice | cells | design s |")
    print("|---|---|---|---|---|---|---|---|")
    for error in (0.0, 0.05, 0.1, 0.15, 0.3, 0.5, 1.0):
        kernel = viability.area(-0.6, 0.6, U_LOW + error, U_HIGH - error)
        for family in ("centred", "quadratic", "stopping"):
            begin = time.perf_counter()
            design = largest(SAFE, SETTING, authority(error, 2), LATE, family=family)
            took = time.perf_counter() - begin
            if design.barrier is None or design.cover is None:
                print(f"| {error} | {family} | none | | | | | {took:.2f} |")
                continue
            area = design.barrier.area_m2ps
            print(
                f"| {error} | {family} | {area:.3f} | {area / kernel:.3f} | {slice_area(design.barrier, LATE):.3f} "
                f"| {worst_slice_area(design.barrier, LATE, U_LOW, U_HIGH):.3f} "
                f"| {len(design.cover.cells)} | {took:.2f} |"
            )
    print()
    print(grids(SAFE.limit_m, U_LOW + 0.1, U_HIGH - 0.1))


if __name__ == "__main__":
    main()
