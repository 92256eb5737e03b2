"""Several flights of one vehicle: a name has the same size in each, and says what it can't tell."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from flightstack.gap import pooled
from flightstack.gap.across import across, confirmed, differing
from flightstack.gap.name import Selection, name
from flightstack.gap.naming.estimate import same
from flightstack.gap.records import Estimate, IdentifiedEffect
from flightstack.gap.report import words
from flightstack.vehicle import Vehicle
from tests import gap_flights


def told(estimate: float, half: float) -> dict[tuple[str, str], Estimate]:
    return {("payload", "mass_kg"): Estimate(0.0, estimate, estimate - half, estimate + half)}


def flown(first_kg: float, second_kg: float) -> Selection:
    """Two flights of 16 s, each with its payload, named together."""
    samples = []
    for k, mass_kg in enumerate((first_kg, second_kg)):
        truth = gap_flights.hidden(gap_flights.quad(), {"payload": {"mass_kg": mass_kg}})
        flight = gap_flights.fly(truth, gap_flights.quad(), gap_flights.wander(seed=k), seconds=16.0, seed=k)
        samples.append(gap_flights.as_samples(flight, f"flight {k}"))
    of = pooled.split(samples, [])
    return name(gap_flights.quad(), of.flights, of.fit, of.holdout).in_each_flight([{}, {}])


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return gap_flights.quad()


def test_the_variance_between_flights_and_the_p_value_are_the_textbook_s() -> None:
    """DerSimonian and Laird 1986, and Cochran's Q, by hand: y 1, 2, 4 with variances 0.1, 0.2, 0.4."""
    theta, variance = np.array([[1.0], [2.0], [4.0]]), np.array([[0.1], [0.2], [0.4]])
    weight = np.array([10.0, 5.0, 2.5])
    mean = (10.0 + 10.0 + 10.0) / 17.5
    q = float(weight @ (theta[:, 0] - mean) ** 2)
    p_value, between = same(theta, variance, np.zeros(1))
    assert p_value[0] == pytest.approx(chi2.sf(q, 2))
    assert between[0] == pytest.approx((q - 2.0) / (17.5 - (100.0 + 25.0 + 6.25) / 17.5))


def test_flights_that_agree_within_a_tenth_are_the_same_and_others_are_not(vehicle: Vehicle) -> None:
    loaded = gap_flights.hidden(vehicle, {"payload": {"mass_kg": 0.2}})
    (agree,) = across(vehicle, loaded, {"a": told(0.19, 0.001), "b": told(0.21, 0.001)})
    (differ,) = across(vehicle, loaded, {"a": told(0.1, 0.001), "b": told(0.3, 0.001)})
    (vague,) = across(vehicle, loaded, {"a": told(0.1, 0.3), "b": told(0.3, 0.3)})
    assert agree.same
    assert not differ.same
    assert vague.same
    assert differing([agree, differ]) == ("payload",)
    assert confirmed([agree]) == {"payload"}  # stays named beside a gap that nothing explains
    assert confirmed([agree, differ]) == set()
    assert across(vehicle, loaded, {"a": told(0.2, 0.01), "b": {}}) == ()


def test_one_load_on_two_flights_is_the_same_and_two_loads_are_not() -> None:
    (one,) = flown(0.15, 0.15).across
    assert one.same
    for log, each in one.flights:
        assert each.low <= 0.15 <= each.high, log
    two = flown(0.1, 0.3)
    assert "payload" in differing(two.across)
    (row,) = (a for a in two.across if a.effect == "payload")
    assert [e.estimate for _, e in row.flights] == pytest.approx([0.1, 0.3], rel=0.1)


def test_what_the_logs_do_not_tell_has_no_number_in_the_sentence() -> None:
    shift = {
        "x_m": Estimate(0.0, 0.002, 0.001, 0.003),
        "y_m": Estimate(0.0, -0.001, -0.002, 0.0),
        "z_m": Estimate(0.0, 0.0, -0.05, 0.05, told=False),
    }
    found = IdentifiedEffect("com_offset", shift, -100.0, 0.9, 1e-9)
    assert words.parameter(found, "z_m") == "z_m not told"
    assert words.interval(shift["z_m"]) == "not told by these logs"
