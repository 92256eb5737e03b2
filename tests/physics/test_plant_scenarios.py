"""Every shipped scenario on both plants: the same stack flies the same path on either physics."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from flightstack.cli import files
from flightstack.types import F64
from tests import closed_loop
from tests.thorough import thorough

pytest.importorskip("jsbsim", reason="no JSBSim here (wheels exist for x86-64 only)")
pytestmark = pytest.mark.jsbsim
SECONDS, EVENT_S = 1.5, 0.5
PATHS_M = 0.005
"""As docs/physics.md states it for whole flights."""


def errors(name: str, plant: str) -> F64:
    """(n, 3) distance from the reference on the first seconds of the track; what happens later happens early here."""
    believed, _ = files.load_vehicle(None)
    scenario, _ = files.load_scenario(name)
    events = tuple(dataclasses.replace(event, time_s=EVENT_S) for event in scenario.events)
    short = dataclasses.replace(scenario, duration_s=SECONDS, events=events)
    flight = closed_loop.fly(short, believed, plant=plant)
    assert not flight.guards
    assert flight.least_height_m > 0.1
    return flight.errors_m


ALIKE = (
    "excite-low-pass", "excite-rate-doublets", "excite-thrust-chirp", "gps-barrier", "hover", "minimum-snap",
    "payload-drop",
)  # fmt: skip
"""Flown by `make thorough`: the others have their heights, turns and effects."""


@pytest.mark.parametrize(
    "name", [thorough(name) if name in ALIKE else name for name in files.shipped_names("scenarios")]
)
def test_both_plants_fly_it_alike(name: str) -> None:
    native, other = errors(name, "native"), errors(name, "jsbsim")
    assert len(native) == len(other) > 100
    apart = np.linalg.norm(native - other, axis=1)
    assert np.sqrt(np.mean(apart**2)) < PATHS_M
    assert apart.max() > 0.0  # two physics, not one twice
