"""Rates that are dithered, thrust at its ends: torque takes rotors to their limits, and the collective with it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from attacked import attacked, engaged, held, struck

from benchmarks import attack_adversary
from benchmarks.attack_adversary import GRADIENT, INNER, KNOWN, NOISE, PUSH, SINE, SQUARE, Strategy
from benchmarks.attack_flight import AttackFlight
from benchmarks.attack_worlds import World
from tests.thorough import ONLY_THEN, THOROUGH, thorough

pytestmark = pytest.mark.attack


@pytest.fixture(scope="module")
def flight() -> AttackFlight:
    """What does not depend on how the noise fell begins here; with a flight of its own each in `make thorough`."""
    return engaged(World(0), 0)


def begun(flight: AttackFlight, seed: int) -> AttackFlight:
    return engaged(World(0), seed) if THOROUGH else flight


@pytest.mark.parametrize("seed", [0, thorough(3)])
def test_the_known_dither_does_not_take_the_vehicle_out(flight: AttackFlight, seed: int) -> None:
    held(struck(begun(flight, seed), KNOWN))


@ONLY_THEN
@pytest.mark.jsbsim
def test_nor_does_it_on_the_other_plant() -> None:
    held(attacked(World(0, plant="jsbsim"), 0, KNOWN))


@pytest.mark.parametrize(
    ("wave", "hz", "radps"), [thorough(SQUARE, 5.0, 3.0), thorough(SINE, 15.0, 6.0), thorough(NOISE, 8.0, 6.0)]
)
def test_nor_do_stronger_and_other_ones(wave: int, hz: float, radps: float) -> None:
    strategy = KNOWN._replace(wave=wave, hz=hz, roll_radps=radps, pitch_radps=radps, phase_rad=0.5 * math.pi)
    held(attacked(World(0), 1, strategy))


@pytest.fixture(scope="module")
def leaning() -> AttackFlight:
    return engaged(World(0), 503)


@pytest.mark.parametrize("k", [16, thorough(7), thorough(3)])
def test_who_leans_and_drops_the_thrust_does_not_end_the_protection(leaning: AttackFlight, k: int) -> None:
    """Each of them took the lean (0.11 beyond it) or the thrust out of the certificate's, and with it the protection,
    where the governor let the turning of one lateral axis take the other's, and thrust fell below the budget's; the
    last, flown after the others, where a barrier in need turned the lean faster than it could be stopped."""
    strategy = attack_adversary.decode(attack_adversary.drawn(np.random.default_rng([77, k])))
    held(leaning.attack(strategy, 6.0))


def test_nor_when_all_axes_are_pushed_and_thrust_goes_up_wherever_it_dithers(flight: AttackFlight) -> None:
    strategy = PUSH._replace(roll_radps=3.0, pitch_radps=3.0, hz=10.8, gate_h=0.4, together=True)
    held(struck(begun(flight, 2), strategy))


def test_without_dither_a_certificate_holds_for_the_vehicle_that_it_was_learned_on(flight: AttackFlight) -> None:
    held(struck(begun(flight, 4), PUSH))


def test_yaw_swings_do_not_lift_it_out(flight: AttackFlight) -> None:
    strategy = Strategy(
        0.0, 0.0, 2.0, 5.0, 1.5, 0.0, SINE, 2.0, INNER, GRADIENT, 0.3, 8.0, 1.0, 0.0, 0.0, 4, 1.0, 0.0, False
    )  # fmt: skip
    held(struck(begun(flight, 5), strategy))


def test_the_adversary_reaches_every_part_of_its_cube() -> None:
    rng = np.random.default_rng(0)
    drawn = [attack_adversary.decode(attack_adversary.drawn(rng)) for _ in range(2000)]
    assert {s.wave for s in drawn} == {0, 1, 2}
    assert {s.lateral for s in drawn} == {s.vertical for s in drawn} == set(range(6))
    assert {s.axes for s in drawn} == set(range(1, 8))
    assert 5.9 < max(s.roll_radps for s in drawn) <= 6.0
    assert 1.0 <= min(s.hz for s in drawn) < 1.1
    assert 14.0 < max(s.hz for s in drawn) <= 15.0
    assert 0.1 < float(np.mean([s.roll_radps == 0.0 for s in drawn])) < 0.25
