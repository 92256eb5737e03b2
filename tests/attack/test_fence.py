"""Adversaries in a site: references through walls and corners, pushes, dither, gusts; no exit.

And with a force twice as large as the prior says, exits are seen: the tests can fail.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.attack_worlds import World
from benchmarks.fence_flight import DITHER, PUSH, RANDOM, THROUGH, Attack, FenceFlight, Outcome

pytestmark = pytest.mark.attack

SITE = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = 5.0
inside = [[-8.0, -6.0], [8.0, -6.0], [8.0, 6.0], [3.0, 6.0], [3.0, 2.5], [-1.0, 2.5], [-1.0, 6.0], [-8.0, 6.0]]
[[keep_out]]
polygon = [[3.0, -3.0], [4.0, -3.0], [4.5, -1.5], [3.0, -2.0]]
[[keep_out]]
centre = [-4.0, -2.5]
radius_m = 0.6
ceiling_m = 2.5
[[keep_out]]
centre = [-4.5, 3.0, 2.0]
radius_m = 0.7
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("site") / "hall.toml"
    path.write_text(SITE)
    return path


def attacked(site: Path, kind: str, seed: int, mass: float, wind_g: tuple[float, float, float]) -> Outcome:
    world = World(seed=seed, scenario="hover", vehicle="quad-x", grade="mocap", mass_ratio=mass, wind_g=wind_g)
    return FenceFlight(world, site, Attack(kind, seed=seed)).run(8.0)


@pytest.mark.parametrize(
    ("kind", "seed", "mass", "wind_g"),
    [
        (PUSH, 304, 1.4, (0.1, 0.1, 0.05)),
        (THROUGH, 21, 0.8, (0.1, 0.0, 0.1)),
        (DITHER, 30, 1.2, (0.0, 0.1, 0.0)),
        (RANDOM, 3, 1.2, (0.0, 0.0, 0.0)),
    ],
)
def test_no_exit(site: Path, kind: str, seed: int, mass: float, wind_g: tuple[float, float, float]) -> None:
    outcome = attacked(site, kind, seed, mass, wind_g)
    assert outcome.exits == 0
    assert outcome.engaged >= 0.95 * outcome.ticks
    assert outcome.changed > 0


def test_half_of_the_true_force_is_found_out(site: Path) -> None:
    outcome = attacked(site, PUSH, 304, 1.4, (0.2, 0.2, 0.1))
    assert outcome.exits > 0
    assert outcome.broken > 0
