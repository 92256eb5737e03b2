"""What was learned is judged on other data: true sizes hold there, wrong ones and trifles of a poor model do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flightstack.vehicle import Vehicle
from gap import pooled
from gap.held import doubtful, fitted_plainly, slope, trimmings
from gap.pooled import Split
from gap.records import Estimate, Figures, Found, Gap
from tests.gap_flights import as_samples, fly, hidden, quad, wander

HIDDEN = {"payload": {"mass_kg": 0.2}, "rotor_drag": {"k_d_kg_per_rad": 2e-4}}
POOR = Gap(Figures(1.0, 1.0, None), Figures(0.9, 0.9, None), Figures(0.1, 0.1, None), 0.1)


@pytest.fixture(scope="module")
def flown() -> Split:
    return pooled.split([as_samples(fly(hidden(quad(), HIDDEN), quad(), wander(), seconds=30.0, seed=21))], [])


def found(name: str, times: float = 1.0) -> Found:
    values = {p: Estimate(0.0, times * x, 0.0, 1.0) for p, x in HIDDEN[name].items()}
    return Found(name, values, -100.0, 0.5, 1e-9)


def with_drag(times: float) -> Vehicle:
    return hidden(quad(), HIDDEN | {"rotor_drag": {"k_d_kg_per_rad": times * 2e-4}})


@pytest.mark.parametrize(("times", "expected"), [(1.0, 1.0), (2.0, 0.5), (0.5, 2.0)])
def test_the_slope_is_the_true_size_over_the_found_one(flown: Split, times: float, expected: float) -> None:
    without = hidden(quad(), {"payload": HIDDEN["payload"]})
    got = slope(without, with_drag(times), flown)
    assert got.value == pytest.approx(expected, rel=0.05)
    assert got.holds(beside=True) == (times == 1.0)


def test_true_effects_hold_and_a_size_of_the_wrong_sign_does_not(flown: Split) -> None:
    assert doubtful(quad(), [found("payload"), found("rotor_drag")], flown, beside=True) == ()
    assert doubtful(quad(), [found("payload", -1.0)], flown, beside=False) == ("payload",)


def test_nothing_held_out_nothing_is_doubted(flown: Split) -> None:
    nothing = replace(flown, holdout=tuple(np.zeros_like(m) for m in flown.holdout))
    assert doubtful(quad(), [found("payload", -1.0)], nothing, beside=True) == ()


def test_beside_a_poor_model_only_what_matters_is_kept(flown: Split) -> None:
    trifle = Found("ground_effect", {"strength": Estimate(0.0, 0.05, 0.0, 0.1)}, -20.0, 0.01, 1e-5)
    named = [found("payload"), found("rotor_drag"), trifle]
    assert trimmings(quad(), named, flown, POOR) == ("ground_effect",)
    near_the_noise = replace(POOR, noise_floor=Figures(0.8, 0.8, None))
    assert trimmings(quad(), named, flown, near_the_noise) == ()


def test_an_estimate_at_the_end_of_its_range_stands_for_something_else(flown: Split) -> None:
    edge = Found("vortex_ring", {"strength": Estimate(0.0, 1.0, 0.4, 1.0)}, -50.0, 0.1, 1e-9)
    assert trimmings(quad(), [found("payload"), edge], flown, POOR) == ("vortex_ring",)


def test_what_changes_from_stretch_to_stretch_is_no_effect_beside_a_poor_model(flown: Split) -> None:
    named = [found("payload"), found("rotor_drag")]
    fickle = {"payload": 1e-12, "rotor_drag": 0.5}
    assert trimmings(quad(), named, flown, POOR, fickle) == ("payload",)
    near_the_noise = replace(POOR, noise_floor=Figures(0.8, 0.8, None))
    assert trimmings(quad(), named, flown, near_the_noise, fickle) == ()


def test_plain_least_squares_find_the_hidden_values_from_afar(flown: Split) -> None:
    got = fitted_plainly(quad(), [found("payload", 0.3), found("rotor_drag", 2.5)], flown)
    for each in got:
        for name, estimate in each.parameters.items():
            true = HIDDEN[each.name][name]
            assert estimate.estimate == pytest.approx(true, rel=0.05)
            assert estimate.low < estimate.estimate < estimate.high
            assert estimate.high - estimate.low < 0.2 * true
