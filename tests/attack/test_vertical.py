"""Vertical certificates: dither all the time, and dither timed for where braking is hardest.

The wind comes from above: with one from the side such a certificate leaves too little lean to hold the place against an
adversary, and the flight ends at its envelope, inside the region.
"""

from __future__ import annotations

import pytest
from attacked import engaged, held, struck

from benchmarks.attack_adversary import ALONG, GRADIENT, INNER, OUTWARD, SINE, SQUARE, SWING, Strategy
from benchmarks.attack_flight import AttackFlight
from benchmarks.attack_worlds import World
from tests.thorough import thorough

pytestmark = pytest.mark.attack
SPEED_ACROSS = (1, 2)
"""Who flies sideways as fast as he likes ends a vertical certificate: that is watched, not certified."""


@pytest.fixture(scope="module")
def flight() -> AttackFlight:
    return engaged(World(0, scenario="paper-barrier", wind_g=(0.0, 0.0, 0.05)), 4)


@pytest.mark.parametrize(
    ("vertical", "wave", "gate_h", "together"),
    [
        (GRADIENT, SINE, 2.0, False), thorough(GRADIENT, SQUARE, 0.25, True), thorough(OUTWARD, SINE, 0.2, True),
        thorough(ALONG, SQUARE, 0.5, False), (SWING, SINE, 0.4, True),
    ],
)  # fmt: skip
def test_dither_timed_or_not_does_not_take_it_out(
    flight: AttackFlight, vertical: int, wave: int, gate_h: float, together: bool
) -> None:
    strategy = Strategy(
        1.6, 1.6, 0.0, 10.8, 1.0, 1.57, wave, gate_h, INNER, vertical, 0.3, 8.0, 1.3, 0.0, 0.0, 4, 1.0, 0.0, together
    )  # fmt: skip
    held(struck(flight, strategy), may_break=SPEED_ACROSS)
