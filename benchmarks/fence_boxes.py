"""`python -m benchmarks.fence_boxes`: figure-8s that lie inside a box, with the site filter and without, in memory.

The first box is 12 x 10 x 3 m with a figure-8 of 6 x 3 m at 8 s a lap; ten more of up to 40 m are drawn, each with the
largest figure-8 (up to 4 m/s) whose certified way out, and 0.1 m for smoothness, lies inside from every point.  Where
the site bends that figure, the largest one that it does not bend is flown as well: both are in the table.
Printed: rms error with and without, their ratio, share of the commands that the site filter changed.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.attack_worlds import World
from benchmarks.fence_flight import NOMINAL, Attack, FenceFlight
from flightstack.cli import files
from flightstack.cli.controllers import build
from flightstack.mission import plan
from flightstack.seams import NoFilter
from flightstack.site import backup, bend, slide
from flightstack.site.clearance import clear_of

_LAPS, _SMOOTH_M = 3, 0.1
_LEAST_GAIN, _HEIGHT_M, _STEP_S = 0.84, 1.6, 0.02
_FASTEST_MPS = 4.0


@dataclass(frozen=True, slots=True)
class Box:
    """A box and the figure-8 in it: sides, half lengths of the figure, a lap's time."""

    north_m: float
    east_m: float
    ceiling_m: float
    length_m: float
    width_m: float
    lap_s: float

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Scenario and site files."""
        scenario, site = folder / "figure8.toml", folder / "box.toml"
        scenario.write_text(
            'schema = "flightstack.scenario/1"\nname = "figure8"\ndescription = "inside a box"\n'
            f'duration_s = {_LAPS * self.lap_s}\n[trajectory]\nkind = "figure8"\nlength_m = {self.length_m}\n'
            f"width_m = {self.width_m}\nperiod_s = {self.lap_s}\nheight_m = {_HEIGHT_M}\n"
        )
        n, e = 0.5 * self.north_m, 0.5 * self.east_m
        site.write_text(
            f'schema = "flightstack.site/1"\nfloor_m = 0.3\nceiling_m = {self.ceiling_m}\n'
            f"inside = [[{-n}, {-e}], [{n}, {-e}], [{n}, {e}], [{-n}, {e}]]\n"
        )
        return scenario, site


def flight_of(box: Box, seed: int, folder: Path, given: Path | None = None) -> FenceFlight:
    """The flight, its attack (none) begins with the track."""
    scenario, site = box.write(folder)
    parsed, _ = files.load_scenario(str(scenario))
    attack = Attack(NOMINAL, seed, begins_s=plan(parsed, np.zeros(3)).track_start_s, gusts=False)
    world = World(seed=seed, scenario=str(scenario), mass_ratio=1.0, wind_g=(0.0, 0.0, 0.0))
    return FenceFlight(world, site, attack, given=given)


def is_deep_inside(flight: FenceFlight) -> bool:
    """Whether the way out from every point of the reference, and what smoothness needs, is clear."""
    made, packed = flight.plan_of.certificate, flight.score.packed
    row, half = made.rows[made.row_of(_LEAST_GAIN)], made.halves()[1]
    points, way = np.zeros((backup.STEPS, backup.ROW)), np.zeros((backup.STEPS, 5))
    for at in _reference(flight):
        start = np.zeros(backup.ROW)
        start[:9], start[9:11], start[11:13] = at[:9], at[9:11], at[9:11]
        count = backup.roll(start, row, half, points, way)
        way[:, 3:] += _SMOOTH_M
        if count == 0 or clear_of(packed, way, count, 1.0)[0] < 0.0:
            return False
    return True


def is_bent(flight: FenceFlight) -> bool:
    """Whether the site bends the reference anywhere."""
    made, packed = flight.plan_of.certificate, flight.score.packed
    soft, memory = made.soft[made.row_of(_LEAST_GAIN)], np.zeros(bend.SIZE)
    near, way, bent = np.zeros((slide.MOST_ROWS, 6)), np.zeros((backup.STEPS, 5)), np.zeros(17)
    rows = _reference(flight)
    bend.begin(memory, rows[0], np.zeros(3))
    return any(bend.bend(memory, packed, soft, at, _STEP_S, near, way, bent) for at in rows)


def _reference(flight: FenceFlight) -> list[np.ndarray]:
    times_s = np.arange(flight.mission.track_start_s, flight.mission.track_end_s, _STEP_S).tolist()
    rows = [flight.mission.reference(t_s).row.copy() for t_s in times_s]
    for at in rows:
        at[:3] -= flight.origin
    return rows


def drawn_boxes(seed: int, folder: Path) -> list[Box]:
    """A box of up to 40 m with the largest figure-8 deep inside it and, where that is bent, with the largest unbent."""
    rng = np.random.default_rng([31, seed])
    north, east, ceiling = rng.uniform(10.0, 40.0), rng.uniform(8.0, 40.0), rng.uniform(3.0, 8.0)
    share, slower = 0.45, float(rng.uniform(1.0, 1.5))
    found: list[Box] = []
    while share > 0.0:
        length, width = share * north, 0.5 * share * east
        lap = slower * 2.0 * math.pi * math.hypot(length, 2.0 * width) / _FASTEST_MPS
        box = Box(*(round(x, 2) for x in (north, east, ceiling, length, width, lap)))
        flight = flight_of(box, seed, folder)
        if is_deep_inside(flight):
            bent = is_bent(flight)
            if not bent or not found:
                found.append(box)
            if not bent:
                return found
        share -= 0.05
    raise ValueError(f"box {seed} has no figure-8 that is deep inside and unbent")


def errors(box: Box, seed: int, folder: Path, given: Path | None) -> tuple[float, float, float, float]:
    """Rms error with the site and without (the controller as it flies without), shares changed and governed."""
    seconds = _LAPS * box.lap_s
    kept = flight_of(box, seed, folder, given)
    outcome = kept.run(seconds, keep=True)
    places = [place for _, place, _ in outcome.seen]
    free = flight_of(box, seed, folder)
    free.adversary.inner = build("flatness", free.stack.model, free.stack.limits)[0]
    free.stack.filter = NoFilter()
    bare = free.run(seconds, keep=True)
    with_m, without_m = (
        _rms(flight, [place for _, place, _ in out.seen], [t_s for t_s, _, _ in out.seen])
        for flight, out in ((kept, outcome), (free, bare))
    )
    assert len(places) == len(bare.seen)
    return with_m, without_m, outcome.changed / outcome.ticks, kept.score.governed / max(kept.score.ticks, 1)


def _rms(flight: FenceFlight, places: list[np.ndarray], times_s: list[float]) -> float:
    wanted = np.array([flight.mission.reference(t_s).pos_ned_m - flight.origin for t_s in times_s])
    return float(np.sqrt(np.mean(np.sum((np.array(places) - wanted) ** 2, axis=1))))


def main() -> None:
    """Fly the boxes and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boxes", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="the first of the drawn ones")
    parser.add_argument("--certificate", type=Path, help="a learned one (`certify --site`); without: the prior's")
    given = parser.parse_args()
    print("| box | figure-8 (half), lap | rms with site | without | ratio | changed | governed |")
    with tempfile.TemporaryDirectory(prefix="boxes-") as name:
        folder = Path(name)
        boxes = [(0, Box(12.0, 10.0, 3.0, 3.0, 1.5, 8.0))]
        for seed in range(given.first, given.first + given.boxes):
            boxes += [(seed + 1, box) for box in drawn_boxes(seed, folder)]
        for k, box in boxes:
            with_m, without_m, changed, governed = errors(box, k, folder, given.certificate)
            size = f"{box.north_m:g} x {box.east_m:g} x {box.ceiling_m:g} m"
            figure = f"{box.length_m:g} x {box.width_m:g} m, {box.lap_s:g} s"
            print(
                f"| {size} | {figure} | {100 * with_m:.2f} cm | {100 * without_m:.2f} cm | {with_m / without_m:.2f} | "
                f"{100 * changed:.2f} % | {100 * governed:.1f} % |",
                flush=True,
            )


if __name__ == "__main__":
    main()
