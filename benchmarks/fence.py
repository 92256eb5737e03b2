"""`make campaign-fence`: flights in random sites against adversaries, and what came of them.

`fence_worlds` draws site, adversary, truth and link of a seed.  Every flight is one line of the journal; a run goes on
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

from benchmarks.fence_flight import FenceFlight
from benchmarks.fence_worlds import drawn_attack, drawn_site, drawn_world
from flightstack.site.stopping import Told
from flightstack.types import InputError


def flown(seed: int, seconds: float, told: float, folder: Path) -> dict[str, Any]:
    """One flight."""
    path, attack = folder / f"site-{seed}.toml", drawn_attack(seed)
    path.write_text(drawn_site(seed))
    world = drawn_world(seed, folder)
    found = {"seed": seed, "told": told, "grade": world.grade, "plant": world.plant}
    try:
        flight = FenceFlight(world, path, attack, Told.all(told))
    except InputError as error:
        return {**found, "refused": str(error).partition(": ")[2]}
    outcome = flight.run(seconds)
    return {
        **found, "kind": attack.kind, "ticks": outcome.ticks, "engaged": outcome.engaged, "exits": outcome.exits,
        "first": flight.score.outside_first, "nearest_m": round(outcome.nearest_m, 3), "changed": outcome.changed,
        "stopped": outcome.kept, "broken": outcome.broken, "ended": outcome.ended,
    }  # fmt: skip


def main() -> None:
    """Fly what is left of the campaign and print what all flights say together."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="seed to begin with")
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
        for seed in range(given.first, given.first + given.flights):
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
