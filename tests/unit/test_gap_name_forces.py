"""Each force, torque and motion of the air, hidden in a short flight, is found; what none explains is not named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flightstack.effects import EFFECTS
from flightstack.gap import pooled
from flightstack.gap.name import name
from tests import gap_flights
from tests.gap_hidden import flights, named
from tests.unit.test_gap_name_vehicle import KINDS, check_found


@pytest.mark.parametrize(
    "effect", [each for each, spec in EFFECTS.items() if spec.kind not in KINDS and each != "turbulence"]
)
def test_a_hidden_effect_is_found(effect: str) -> None:
    check_found(effect)


def test_gusts_are_not_taken_for_another_effect() -> None:
    assert {found.name for found in named(flights()["turbulence"]).found} <= {"turbulence"}


def test_a_jet_of_air_in_one_place_is_unexplained_and_depends_on_the_position() -> None:
    """2 m/s^2 to the north round one point: added to the accelerometer and to nothing the simulator knows."""
    clean = flights()[""]
    near = np.exp(-0.5 * np.sum((clean.pos_ned_m[:, :2] - [1.5, -1.0]) ** 2, axis=1))
    w, x, y, z = clean.q_ned_frd.T
    north = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1)
    push = 2.0 * near[:, None] * north
    velocity = clean.vel_ned_mps.copy()
    velocity[:, 0] += np.cumsum(2.0 * near) * clean.dt_s
    verdict = named(replace(clean, accel_frd_mps2=clean.accel_frd_mps2 + push))
    assert verdict.found == ()
    assert verdict.unexplained.significant
    assert "position" in verdict.unexplained.depends_on


def test_a_steady_forces_interval_knows_of_the_sensors_own_slow_errors() -> None:
    """An accelerometer that is off by some mm/s^2 for the whole flight looks like a force; missed by 3 before."""
    force = {"north_n": 0.3, "east_n": -0.4, "down_n": 0.2}
    truth = gap_flights.hidden(gap_flights.quad(), {"constant_force": force})
    flown = gap_flights.fly(truth, gap_flights.quad(), gap_flights.wander(seed=2), seconds=30.0, seed=2)
    of = pooled.split([gap_flights.as_samples(flown)], [])
    (found,) = name(gap_flights.quad(), of.flights, of.fit, of.holdout).found
    assert found.name == "constant_force"
    off = [abs(e.estimate - force[p]) / (0.5 * (e.high - e.low)) for p, e in found.parameters.items()]
    assert max(off) < 1.5  # three standard errors
