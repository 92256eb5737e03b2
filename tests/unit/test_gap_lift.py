"""A thrust scale that would not have carried the vehicle is put right by the mean vertical force; a push is named once.

The flights are the closed loop's (`tests.gap_flights`): the truth is hidden in the plant.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from flightstack.gap import lift, pooled
from flightstack.gap.held import corrected
from flightstack.gap.lift import told_by_lift
from flightstack.gap.name import Selection, name
from flightstack.gap.one_heading import with_one_push
from flightstack.gap.pooled import FitHoldoutSplit
from flightstack.gap.records import Estimate, Figures, Gap, IdentifiedEffect, Unexplained
from flightstack.types import F64
from flightstack.vehicle import Vehicle, parse_vehicle
from tests.gap_flights import VEHICLES, as_samples, fly, hidden, quad, wander

TRUE_SCALE = 0.8
OPEN = Unexplained(True, ("airspeed",), 0.5)
HIDDEN = {
    "thrust_scale": {"scale": TRUE_SCALE},
    "linear_drag": {"d_x_kgps": 0.5, "d_y_kgps": 0.3, "d_z_kgps": 0.3},
    "steady_wind": {"north_mps": 2.0, "east_mps": -1.0, "down_mps": 0.0},
    "attitude_misalignment": {"roll_rad": 0.03, "pitch_rad": -0.04, "yaw_rad": 0.0},
}


def _northward(t: float) -> tuple[F64, F64, F64, float]:
    """The path of `wander`, nose to the north."""
    return (*wander()(t)[:3], 0.0)


@cache
def flight() -> tuple[Selection, FitHoldoutSplit]:
    """What is named of it, and its halves to learn from and to judge by."""
    of = pooled.split([as_samples(fly(hidden(quad(), HIDDEN), quad(), _northward, seconds=30.0, seed=5))], [])
    return name(quad(), of.flights, of.fit, of.holdout), of


def gap(after: float, floor: float) -> Gap:
    figures = [Figures(x, x, None) for x in (2.0, after, floor)]
    return Gap(*figures, (2.0 - after) / (2.0 - floor))


def said(
    scale: float | None, left: Unexplained = OPEN, believed: Vehicle | None = None
) -> tuple[Selection, FitHoldoutSplit, Gap]:
    """A verdict on the flight with the true effects but for its thrust scale, which is this one."""
    naming, of = flight()
    values = {k: v for k, v in HIDDEN.items() if k != "thrust_scale"} | (
        {"thrust_scale": {"scale": scale}} if scale else {}
    )
    found = tuple(
        IdentifiedEffect(e, {p: Estimate(0.0, x, x - 0.01, x + 0.01) for p, x in own.items()}, -50.0, 0.1, 1e-9)
        for e, own in values.items()
    )
    return (
        replace(naming, found=found, vehicle=corrected(believed or quad(), found), unexplained=left),
        of,
        gap(0.9, 0.05),
    )


@pytest.mark.parametrize("told", [0.5, 0.95])
def test_the_scale_is_what_carries_the_vehicle(told: float) -> None:
    naming, _, after = told_by_lift(quad(), said(told))
    (scale,) = [f for f in naming.found if f.name == "thrust_scale"]
    value = scale.parameters["scale"]
    assert value.low < TRUE_SCALE < value.high
    assert value.estimate == pytest.approx(TRUE_SCALE, rel=0.02)
    assert scale.indistinguishable_from == ("payload",)
    assert {f.name for f in naming.found} == set(HIDDEN)
    assert naming.vehicle.effects["thrust_scale"]["scale"] == value.estimate
    assert after.closed is not None
    assert after.closed > 0.9


@pytest.mark.parametrize(("scale", "left"), [(0.84, OPEN), (0.5, Unexplained(False))])
def test_a_scale_that_nearly_carries_it_stays_and_so_does_one_beside_which_nothing_is_left(
    scale: float, left: Unexplained
) -> None:
    verdict = said(scale, left)
    assert told_by_lift(quad(), verdict) is verdict


def test_where_no_scale_is_named_a_fifth_of_the_weight_may_hang_from_a_cord() -> None:
    """A spring that pulls up by a seventh of the weight was named a thrust scale; half of it no cord carries unseen."""
    verdict = said(None)
    assert told_by_lift(quad(), verdict) is verdict
    believed = replace(quad(), rotors=replace(quad().rotors, max_thrust_n=2.0 * quad().rotors.max_thrust_n))
    (scale,) = [f for f in told_by_lift(believed, said(None, believed=believed))[0].found if f.name == "thrust_scale"]
    assert scale.parameters["scale"].estimate == pytest.approx(0.5 * TRUE_SCALE, rel=0.02)


def test_where_the_file_guesses_thrust_it_is_no_scale_of_it() -> None:
    """The file's own numbers are fitted there, which a scale on top of it would lose."""
    text = (VEHICLES / "quad-x.toml").read_text("utf-8")
    guessed = parse_vehicle(text.replace("max_thrust_n = 6.6", "max_thrust_n = {value = 6.6, range = [3.0, 9.0]}"), "x")
    assert guessed.ranges
    verdict = said(0.5)
    assert told_by_lift(guessed, verdict) is verdict


def test_where_no_scale_balances_one_that_would_lift_nothing_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a flight of others 0.01 was named, where all rotors at full command lift 2.4 weights."""
    monkeypatch.setattr(lift, "_balancing", lambda *_, **__: None)
    least = quad().weight_n / quad().max_total_thrust_n
    for scale, gone in ((0.9 * least, True), (1.1 * least, False)):
        naming, _, _ = told_by_lift(quad(), said(scale))
        assert naming.unexplained.significant
        assert ("thrust_scale" not in {f.name for f in naming.found}) is gone
        assert "linear_drag" in {f.name for f in naming.found}


def test_far_from_the_noise_on_one_heading_a_push_is_named_once_in_a_class_with_the_others() -> None:
    naming, of = flight()
    assert {"steady_wind", "attitude_misalignment"} <= {f.name for f in naming.found}
    one, _, _ = with_one_push(quad(), (naming, of, gap(0.9, 0.05)))
    pushes = {f.name for f in one.found} & {"steady_wind", "attitude_misalignment"}
    assert len(pushes) == 1
    assert {f.name for f in naming.found} - {"steady_wind", "attitude_misalignment"} == (
        {f.name for f in one.found} - pushes
    )


def test_near_the_noise_two_pushes_are_what_the_evidence_says() -> None:
    naming, of = flight()
    verdict = (replace(naming, unexplained=Unexplained(False)), of, gap(0.055, 0.05))
    assert with_one_push(quad(), verdict) is verdict
