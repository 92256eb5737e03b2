"""Times of the cover, of re-certification and of the design, and the cells of a cover beside uniform ones.

Run: python -m benchmarks.barrier
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np

from flightstack.barrier import viability
from flightstack.barrier.certifier import OnlineCertifier
from flightstack.barrier.condition import Setting
from flightstack.barrier.cover import best_command, cover, outside, region_box
from flightstack.barrier.design import SafeSet, at_speed, grow, largest, slice_area, worst_slice_area
from flightstack.barrier.growing import VERTICAL
from flightstack.barrier.records import Authority, Response
from flightstack.barrier.search import Axis, Ledger, again, largest_steps, whole
from flightstack.barrier.shapes import Barrier, Quadratic, Stopping
from flightstack.cli import files
from flightstack.learning.learner import GpLearner
from flightstack.model import Model
from flightstack.types import Learned, changed

U_LOW, U_HIGH = -2.80286, 9.81
SAFE = SafeSet(0.6)
LATE = Response(0.05, 0.0, 0.02)
SETTING = Setting(2.0, 0.02, 0.1, 0.004)
SHAPES: dict[str, Barrier] = {
    "quadratic": Quadratic(0.0, -0.9, 3.40, 0.37, 0.225),
    "stopping": Stopping(-0.583, 0.595, 0.06, 2.5, 9.0),
}


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


def recertification() -> str:
    """The vertical slice with a live learner of 300 points: bounds, ledger, size and proof, as one call."""
    vehicle, _ = files.load_vehicle(None)
    scenario, _ = files.load_scenario("paper-barrier")
    model, region = Model.from_vehicle(vehicle), scenario.region
    assert region is not None
    learner, learned = GpLearner(model).init(), changed(Learned.nothing(), latency_s=0.02)
    rng = np.random.default_rng(0)
    for _ in range(300):
        weights, speed, lean = rng.uniform(0.6, 1.8), rng.uniform(-1.2, 1.2, 3), rng.uniform(-0.15, 0.15, 2)
        x = np.array([*speed, *lean, weights, 1e-3 * weights])
        noise = 0.02 * rng.normal(size=3)
        learner.lateral.gp.add(x, noise[:2])
        learner.vertical.gp.add(x, 9.81 * weights * (1.0 - 1.0 / 1.4) + noise[2:])
    config = dataclasses.replace(VERTICAL, slice_only=True)
    certifier = OnlineCertifier(
        model, scenario.limits, region, initial=scenario.knowledge, config=config, safe={2: SafeSet(0.6, 1.4)}
    )

    def asked() -> tuple[Axis, Ledger]:
        return certifier.axis_of(2, certifier.knowledge_now(learner), learned)

    first = whole(largest_steps(*asked()))
    assert first is not None

    def again_now() -> float:
        axis, ledger = asked()
        found = again(axis, ledger, first[0])
        assert found is not None
        return found.barrier.area_m2ps

    again_now()
    half, most = milliseconds(again_now, 200)
    return (
        f"re-certification of the vertical slice, live learner of {len(learner.vertical.gp)} points: "
        f"{half:.2f} ms (p99 {most:.2f} ms), {again_now():.3f} m^2/s; {first[0].barrier.area_m2ps:.3f} before"
    )


def main() -> None:
    """Print the tables."""
    print(recertification())
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


if __name__ == "__main__":
    main()
