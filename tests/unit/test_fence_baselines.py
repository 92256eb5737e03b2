"""The rules that the site filter is compared with fly, each by what makes it that rule."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.attack_worlds import World
from benchmarks.fence_baselines import METHODS, replaced
from benchmarks.fence_flight import NOMINAL, Attack, FenceFlight
from flightstack.site.decide import COMMITTED, KEPT
from flightstack.site.stopping import Told
from flightstack.trajectory import hover
from tests.thorough import thorough

SITE = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = 6.0
inside = [[-9.0, -9.0], [4.0, -9.0], [4.0, 9.0], [-9.0, 9.0]]
"""


@pytest.mark.parametrize("method", ["px4", *(thorough(method) for method in METHODS if method != "px4")])
def test_each_rule_does_something_about_a_wall(method: str, tmp_path: Path) -> None:
    """A reference 20 m beyond a wall 4 m away, in calm air: without any rule the vehicle flies through it."""
    (tmp_path / "wall.toml").write_text(SITE)
    world = World(seed=1, scenario="hover", mass_ratio=1.0, wind_g=(0.0, 0.0, 0.0))
    attack = Attack(NOMINAL, begins_s=3.0, gusts=False, reference=lambda _: hover((24.0, 0.0, -1.5)).at(0.0))
    told = Told.all(0.05) if method == "gatekeeper" else Told()
    flight = FenceFlight(world, tmp_path / "wall.toml", attack, told)
    replaced(flight, method)
    outcome = flight.run(3.0, keep=True)
    assert outcome.ended == ""
    furthest_m = max(place[0] for _, place, _ in outcome.seen)
    if method == "px4":  # it acts where the point is forbidden that 4 m/s^2 and its jerk reach, and then Hold flies
        assert outcome.changed > 0
        assert furthest_m < 12.0
        return
    assert furthest_m < 4.0
    numbers = flight.timed.numbers
    if method == "backup-cbf":  # no way out is committed, followed or asked for
        assert outcome.changed > 0
        assert numbers[COMMITTED] == numbers[KEPT] == 0.0
    else:
        assert numbers[COMMITTED] > 0.0
    assert math.isfinite(outcome.nearest_m)
    assert np.isfinite(np.array([place for _, place, _ in outcome.seen])).all()
