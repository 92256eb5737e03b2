"""Leaning into a wall 12 m away against a force that knows the loop (`fence_worst`): does the way out keep its tube?

Truth at the edge of what is declared (mass, lag, inertia 1.2, 0.15 g), the estimate off by all of it; the way out
alone, or with sliding (`--slid`).  With GPS the wall is 60 m away; other vehicles may be refused.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.attack_worlds import World
from benchmarks.fence_flight import PUSH, Attack, FenceFlight
from benchmarks.fence_worlds import HOVER
from flightstack.types import InputError

_WALL = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = {ceiling}
inside = [[-60.0, -60.0], [{wall}, -60.0], [{wall}, 60.0], [-60.0, 60.0]]
"""
_FLIGHTS = ((0.8, 0.35), (1.5, 0.35), (0.8, 0.6), (1.0, 0.35))
"""True over believed mass; tangent of the lean."""


def main() -> None:
    """Fly them and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--slid", action="store_true", help="commands are slid along what is near as well")
    parser.add_argument("--vehicle", default="quad-x")
    parser.add_argument("--grade", default="mocap")
    given = parser.parse_args()
    is_gps = given.grade == "gps"
    with tempfile.TemporaryDirectory(prefix="fence-") as folder:
        site = Path(folder) / "wall.toml"
        site.write_text(_WALL.format(ceiling=40.0 if is_gps else 8.0, wall=60.0 if is_gps else 12.0))
        hover = Path(folder) / "hover.toml"
        hover.write_text(HOVER.format(down=-8.0))
        for mass, lean in _FLIGHTS:
            world = World(
                seed=given.seed, scenario=str(hover) if is_gps else "hover", vehicle=given.vehicle, grade=given.grade,
                mass_ratio=mass, wind_g=(0.15, 0.0, 0.0), lag_ratio=1.2, inertia_ratio=1.2, down_ms=0.0,
            )  # fmt: skip
            attack = Attack(PUSH, seed=given.seed, knows=True, errs=True, begins_s=14.0 if is_gps else 4.0)
            try:
                flight = FenceFlight(world, site, attack, unslid=not given.slid)
            except InputError as error:
                print(f"mass {mass:g}, lean {lean:g}: refused: {error}")
                continue
            flight.adversary.until_s, flight.adversary.lean = math.inf, np.array([lean, 0.0])
            out = flight.run(given.seconds)
            print(
                f"mass {mass:g}, lean {lean:g}: {out.exits} ticks outside, {out.broken} outside a tube, "
                f"way followed in {out.kept} of {out.ticks}; tube at rest {flight.plan_of.certificate.radius_m:.2f} m"
            )


if __name__ == "__main__":
    main()
