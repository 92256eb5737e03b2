"""`make campaign-fence`: flights in random sites against adversaries, and what came of them.

A site is a star-shaped polygon of up to 50 edges round the start, with pillars, spheres and blocks; a flight draws the
adversary, the truth (mass, force, lags, inertia) and the link.  Every flight is one line of the journal; a run goes on
where the last one stopped.  `--told 0.5`: the filter is told half of the true doubts, so that exits are to be seen.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack_worlds import World
from benchmarks.fence_flight import DITHER, PUSH, RANDOM, THROUGH, Attack, FenceFlight
from flightstack.types import InputError

KINDS = (PUSH, THROUGH, DITHER, RANDOM)


def drawn_site(seed: int, reach_m: float) -> str:
    """A site file's text: every corner at 0.35 to 1 of the reach, nothing within 2.2 m of the start."""
    rng = np.random.default_rng([21, seed])
    count = int(rng.integers(4, 51))
    angle = np.sort((np.arange(count) + rng.uniform(0.1, 0.9, count)) * 2.0 * math.pi / count)
    radius = rng.uniform(0.35, 1.0, count) * reach_m
    corners = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1).round(3).tolist()
    text = (
        f'schema = "flightstack.site/1"\nfloor_m = 0.3\nceiling_m = {rng.uniform(3.5, 8.0):.2f}\ninside = {corners}\n'
    )
    for _ in range(int(rng.integers(0, 5))):
        far, way, size = rng.uniform(3.5, reach_m), rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.2, 1.0)
        n, e = far * math.cos(way), far * math.sin(way)
        kind = rng.integers(3)
        if kind == 0:
            text += f"[[keep_out]]\ncentre = [{n:.2f}, {e:.2f}]\nradius_m = {size:.2f}\n"
        elif kind == 1:
            text += f"[[keep_out]]\ncentre = [{n:.2f}, {e:.2f}, {rng.uniform(0.5, 4.0):.2f}]\nradius_m = {size:.2f}\n"
        else:
            block = [[n, e], [n + size, e], [n + size, e + size], [n, e + size]]
            text += f"[[keep_out]]\npolygon = {np.round(block, 2).tolist()}\nceiling_m = {rng.uniform(0.5, 3.0):.2f}\n"
    return text


def drawn_world(seed: int) -> World:
    """The truth and the link of a flight."""
    rng = np.random.default_rng([22, seed])
    way = rng.normal(size=3)
    force = rng.uniform(0.0, 0.15) * way / np.linalg.norm(way)
    return World(
        seed=seed, scenario="hover", vehicle="quad-x", grade="mocap", mass_ratio=float(rng.uniform(0.8, 1.5)),
        wind_g=(float(force[0]), float(force[1]), float(force[2])), lag_ratio=float(rng.uniform(0.8, 1.2)),
        inertia_ratio=float(rng.uniform(0.85, 1.2)),
    )  # fmt: skip


def flown(seed: int, seconds: float, told: float, folder: Path) -> dict[str, Any]:
    """One flight."""
    path = folder / f"site-{seed}.toml"
    path.write_text(drawn_site(seed, float(np.random.default_rng([23, seed]).uniform(6.0, 20.0))))
    kind, found = KINDS[seed % len(KINDS)], {"seed": seed, "told": told}
    try:
        flight = FenceFlight(drawn_world(seed), path, Attack(kind, seed=seed), told)
    except InputError as error:
        return {**found, "refused": str(error).partition(": ")[2]}
    outcome = flight.run(seconds)
    return {
        **found, "kind": kind, "ticks": outcome.ticks, "engaged": outcome.engaged, "exits": outcome.exits,
        "first": flight.score.outside_first, "nearest_m": round(outcome.nearest_m, 3), "changed": outcome.changed,
        "stopped": outcome.kept, "broken": outcome.broken, "ended": outcome.ended,
    }  # fmt: skip


def main() -> None:
    """Fly what is left of the campaign and print what all flights say together."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=5000)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--told", type=float, default=1.0)
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--journal", type=Path, default=Path("runs/fence.jsonl"))
    given = parser.parse_args()
    given.journal.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in given.journal.read_text().splitlines()] if given.journal.exists() else []
    done, began = {row["seed"] for row in rows if row["told"] == given.told}, time.monotonic()
    with tempfile.TemporaryDirectory(prefix="fence-") as folder, given.journal.open("a") as journal:
        for seed in range(given.flights):
            if seed in done:
                continue
            if time.monotonic() - began > 60.0 * given.minutes:
                break
            rows.append(flown(seed, given.seconds, given.told, Path(folder)))
            print(json.dumps(rows[-1]), file=journal, flush=True)
    mine = [row for row in rows if row["told"] == given.told]
    flights = [row for row in mine if "refused" not in row]
    left = [row["seed"] for row in flights if row["exits"]]
    engaged = sum(row["engaged"] for row in flights) / max(sum(row["ticks"] for row in flights), 1)
    refused = len(mine) - len(flights)
    print(f"{len(mine)} drawn, {refused} refused, {len(flights)} flown, {len(left)} left (seeds {left[:20]})")
    ended, broken = sum(bool(row["ended"]) for row in flights), sum(row["broken"] > 0 for row in flights)
    print(f"engaged in {100.0 * engaged:.1f} % of the ticks; {ended} ended early, {broken} with a broken premise")


if __name__ == "__main__":
    main()
