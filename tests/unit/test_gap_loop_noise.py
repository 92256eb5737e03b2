"""Slow flights on a noisy gyro, whose noise the rate loop feeds back: loads and drags are named as what they are.

Commands answer the gyro's noise, so that they seem to turn the vehicle less than they do, and sooner.  A weak thrust, a
quicker rotor or a delay stood for a load and a drag then, or nothing was named.
"""

from __future__ import annotations

import pytest
from shipped import load_vehicle

from flightstack.gap import pooled
from flightstack.gap.classes import DRAGS, doubled
from flightstack.gap.concluded import concluded
from flightstack.gap.records import Estimate, IdentifiedEffect, Samples
from flightstack.vehicle import Vehicle
from tests.gap_flights import as_samples, fly, hidden, wander
from tests.thorough import thorough

SIH = load_vehicle("px4-sihsim-quadx")
FLIGHTS = [
    thorough(0.133, 1.612, 1.4, 2),
    (0.111, 1.502, 1.4, 4),
    thorough(0.3, 1.7, 1.4, 23),
    thorough(0.056, 1.767, 0.8, 5),
    thorough(0.281, 1.378, 1.4, 1),
    thorough(0.12, 1.6, 1.4, 21),
]


def loaded(load_kg: float, drag_kgps: float) -> Vehicle:
    drag = {f"d_{axis}_kgps": drag_kgps for axis in "xyz"}
    return hidden(SIH, {"payload": {"mass_kg": load_kg}, "linear_drag": drag})


def flown(load_kg: float, drag_kgps: float, speed_mps: float, seed: int) -> Samples:
    """Without rate doublets, and sampled at 83 Hz as MAVLink's streams are."""
    truth, path = loaded(load_kg, drag_kgps), wander(speed_mps, 3.0)
    return as_samples(fly(truth, SIH, path, seconds=40.0, seed=seed, grade="px4-sih", every_ms=12, dither=0.0))


@pytest.mark.parametrize(("load_kg", "drag_kgps", "speed_mps", "seed"), FLIGHTS)
def test_a_load_and_a_drag_are_named_and_nothing_else(
    load_kg: float, drag_kgps: float, speed_mps: float, seed: int
) -> None:
    """Of these six the first three and the fourth were told otherwise."""
    named, _, _ = concluded(SIH, pooled.split([flown(load_kg, drag_kgps, speed_mps, seed)], []), SIH.name)
    assert not named.unexplained.significant
    (load,) = (f for f in named.found if f.name == "payload")
    (drag,) = (f for f in named.found if f is not load)
    assert drag.name in DRAGS
    told = load.parameters["mass_kg"]
    assert told.low <= load_kg <= told.high
    assert told.estimate == pytest.approx(load_kg, rel=0.08)


@pytest.mark.parametrize(("load_kg", "down_mps", "gone"), [(1.25, -8.9, True), (1.25, 8.9, False), (0.3, -1.0, False)])
def test_a_wind_from_below_that_carries_what_was_named_as_a_load_is_none(
    load_kg: float, down_mps: float, gone: bool
) -> None:
    """A kilogram a second of drag: 8.9 m/s from below hold 8.9 N of 12.3."""
    load = {"mass_kg": Estimate(0.0, load_kg, load_kg - 0.1, load_kg + 0.1)}
    wind = {p: Estimate(0.0, x, x - 0.1, x + 0.1) for p, x in (("north_mps", 0.0), ("down_mps", down_mps))}
    names = [IdentifiedEffect(e, v, -50.0, 0.1, 1e-9) for e, v in (("payload", load), ("steady_wind", wind))]
    assert doubled(names, SIH) == (("steady_wind",) if gone else ())
