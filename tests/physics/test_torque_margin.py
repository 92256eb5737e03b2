"""The ledger's line `torque` against rate loop, allocation, rotors and plant: dithered rates, switched thrust."""

from __future__ import annotations

import pytest

from benchmarks.dither import terms_of, trial
from flightstack.cli import files
from tests.thorough import thorough

VEHICLES = ("quad-x", "px4-sihsim-quadx")
_ROUNDING_MPS2 = 5e-3
"""Of the delayed collective command, followed here in steps of a millisecond."""


@pytest.mark.parametrize("name", [VEHICLES[0], *map(thorough, VEHICLES[1:])])
def test_dither_takes_no_thrust_and_adds_no_more_than_the_line_says(name: str) -> None:
    vehicle = files.load_vehicle(name)[0]
    terms = terms_of(vehicle)
    for seed in range(8):
        found = trial(vehicle, terms, seed, seconds=2.0)
        assert found.spread <= terms.margin, seed
        assert -_ROUNDING_MPS2 <= found.gain_mps2 <= terms.lift_mps2 + 1e-3, seed
        assert found.loss_mps2 <= terms.loss_mps2 + _ROUNDING_MPS2, seed


@pytest.mark.parametrize("name", [VEHICLES[0], *map(thorough, VEHICLES[1:])])
def test_the_same_dither_takes_metres_a_second_squared_without_the_governor(name: str) -> None:
    vehicle = files.load_vehicle(name)[0]
    found = [trial(vehicle, terms_of(vehicle), seed, seconds=2.0, governed=False) for seed in range(4)]
    assert max(each.loss_mps2 for each in found) > 2.0
    assert max(each.spread for each in found) > 0.4
