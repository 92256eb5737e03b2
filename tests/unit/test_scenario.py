"""Scenario files: the shipped ones are what they claim, and every mistake is one line that names its key."""

from __future__ import annotations

import math

import numpy as np
import pytest
from shipped import ROOT, load_scenario, load_vehicle

from flightstack.region import Region
from flightstack.scenario import parse_scenario, waypoints_scenario
from flightstack.types import InputError
from flightstack.vehicle import with_effects
from flightstack.waypoints import parse_waypoints

MINIMAL = """
schema = "flightstack.scenario/1"
name = "small"
description = "a small one"
duration_s = 5
[trajectory]
kind = "hover"
position_m = [0, 0, -1]
"""


@pytest.mark.parametrize(
    "path", sorted((ROOT / "flightstack/data/scenarios").glob("*.toml")), ids=lambda path: path.stem
)
def test_every_shipped_scenario_parses_and_is_named_like_its_file(path) -> None:  # type: ignore[no-untyped-def]
    scenario = parse_scenario(path.read_text(), path.name)
    assert scenario.name == path.stem
    assert scenario.description
    scenario.truth_vehicle(load_vehicle("quad-x"))


def test_paper_tracking_is_the_papers_flight() -> None:
    scenario, believed = load_scenario("paper-tracking"), load_vehicle("quad-x")
    assert scenario.duration_s == 60.0
    assert scenario.limits.thrust_max_weights == 1.8
    for t in (0.0, 2.0, 41.0):
        wanted = [1.5 * math.sin(0.6 * t), math.sin(0.9 * t), -1.5 + 0.5 * math.sin(0.6 * t)]
        np.testing.assert_allclose(scenario.trajectory.at(t).pos_ned_m, wanted)
    truth = scenario.truth_vehicle(believed)
    assert truth.mass_kg == pytest.approx(1.4 * believed.mass_kg)
    force = truth.effects["constant_force"]
    assert force["north_n"] == pytest.approx(0.1 * 1.4 * 1.2 * 9.80665)
    assert (force["east_n"], force["down_n"]) == (0.0, 0.0)


def test_the_path_of_paper_tracking_lies_inside_its_region_which_leaves_half_a_metre() -> None:
    scenario = load_scenario("paper-tracking")
    assert scenario.region is not None
    values = [
        scenario.region.value(p.pos_ned_m, p.vel_ned_mps)
        for p in (scenario.trajectory.at(t) for t in np.linspace(0.0, 60.0, 1000))
    ]
    assert min(values) > 0.4
    np.testing.assert_allclose(scenario.region.semi_axes_m, [2.0, 1.5, 1.0])


def test_paper_barriers_region_is_the_papers_ellipsoid_at_mu_6_3() -> None:
    region = load_scenario("paper-barrier").region
    assert region is not None
    pos, vel = np.array([0.1, -0.2, -1.0]), np.array([0.1, 0.05, -0.2])
    wanted = (
        1 - (-1.0 + 0.8) ** 2 / 0.36 - 6.3 * 0.2**2 - 0.1**2 / 0.16 - 0.2**2 / 0.16 - 0.1**2 / 0.25 - 0.05**2 / 0.25
    )
    assert region.value(pos, vel) == pytest.approx(wanted)
    scenario = load_scenario("paper-barrier")
    assert min(region.value(p.pos_ned_m, p.vel_ned_mps) for p in map(scenario.trajectory.at, range(30))) > 0.05


def test_a_region_by_axes_is_its_worst_ellipse() -> None:
    region = Region("axes", (0.0, 0.0, -1.0), (2.0, 1.0, 1.0), (1.0, 1.0, 1.0))
    assert region.value(np.array([1.0, 0.0, -1.0]), np.array([0.0, 0.5, 0.0])) == pytest.approx(0.75)
    assert region.value(np.array([0.0, 0.0, -1.5]), np.array([0.0, 0.0, 1.0])) == pytest.approx(-0.25)


def test_figure8_is_five_laps_of_8_seconds_2_metres_up_with_the_truth_as_believed() -> None:
    scenario, believed = load_scenario("figure8"), load_vehicle("quad-x")
    assert scenario.duration_s == 40.0
    np.testing.assert_allclose(scenario.trajectory.at(2.0).pos_ned_m, [3.0, 0.0, -2.0], atol=1e-12)
    np.testing.assert_allclose(scenario.trajectory.at(1.0).pos_ned_m, [3.0 * math.sqrt(0.5), 1.5, -2.0])
    assert scenario.truth_vehicle(believed) == believed


def test_the_envelope_reaches_5_metres_beyond_the_path_unless_given() -> None:
    limits = load_scenario("figure8").limits
    assert (limits.radius_m, limits.height_m) == pytest.approx((8.0, 7.0), abs=1e-3)
    assert parse_scenario(MINIMAL + "[limits]\nradius_m = 99\n", "s").limits.radius_m == 99.0


def test_the_envelope_holds_the_region_that_is_asked_for() -> None:
    """gps-barrier: 16 m round 20 m, where its path reaches 22 m; the paper's regions lie within 5 m of their paths."""
    limits = {name: load_scenario(name).limits for name in ("gps-barrier", "paper-barrier", "paper-tracking")}
    assert limits["gps-barrier"].height_m == 37.0
    assert limits["gps-barrier"].radius_m == 5.0, "of an ellipsoid nothing is certified sideways"
    assert limits["paper-barrier"].height_m == pytest.approx(0.8 + 0.35 + 5.0, abs=1e-3)
    assert limits["paper-tracking"].height_m == pytest.approx(1.5 + 0.5 + 5.0, abs=1e-3)
    assert 6.0 < limits["paper-tracking"].radius_m < math.hypot(1.5, 1.0) + 5.0


def test_truth_effects_are_set_on_top_of_the_believed_ones() -> None:
    text = MINIMAL + "[truth.effects.linear_drag]\nd_x_kgps = 0.3\n[truth.effects.payload]\nmass_kg = 0.1\n"
    believed = with_effects(
        load_vehicle("quad-x"), {"linear_drag": {"d_x_kgps": 0.1}, "motor_lag": {"time_constant_s": 0.03}}
    )
    truth = parse_scenario(text, "s").truth_vehicle(believed)
    assert truth.effects["linear_drag"]["d_x_kgps"] == 0.3
    assert truth.effects["motor_lag"]["time_constant_s"] == 0.03
    assert truth.weight_n == pytest.approx(1.3 * 9.80665)


def test_events_and_checks_are_read_in_order() -> None:
    text = (
        MINIMAL
        + """
[[events]]
time_s = 2.5
effect = "payload"
values = { mass_kg = 0.2 }
[[checks]]
metric = "tracking.rmse_m"
below = 0.03
words = "stays within 3 cm"
"""
    )
    scenario = parse_scenario(text, "s")
    assert scenario.events[0].time_s == 2.5
    assert (scenario.events[0].effect, scenario.events[0].values) == ("payload", (("mass_kg", 0.2),))
    assert (scenario.checks[0].metric, scenario.checks[0].below, scenario.checks[0].above) == (
        "tracking.rmse_m",
        0.03,
        None,
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("not = [toml", "s.toml: not valid TOML"),
        (MINIMAL.replace("scenario/1", "scenario/9"), "s.toml: schema = 'flightstack.scenario/9' is not known"),
        (MINIMAL.replace("duration_s", "duration_ms"), "s.toml: unknown key duration_ms"),
        (MINIMAL.replace("duration_s = 5", "duration_s = 0"), "s.toml: duration_s = 0 is not allowed"),
        (MINIMAL.replace("duration_s = 5", "duration_s = nan"), "s.toml: duration_s = nan is not allowed"),
        (MINIMAL.replace("duration_s = 5\n", ""), "s.toml: duration_s = missing is not allowed"),
        (MINIMAL.replace('name = "small"', "name = 3"), "s.toml: name = 3 must be a line of text"),
        (MINIMAL.replace('"hover"', '"spiral"'), "s.toml: trajectory.kind = 'spiral' is not known"),
        (MINIMAL.replace("position_m", "position"), "s.toml: trajectory: unknown key position"),
        (MINIMAL.replace("[0, 0, -1]", "[0, 0]"), r"s.toml: trajectory.position_m = \[0, 0\] must be a list of 3"),
        (MINIMAL.replace("[0, 0, -1]", "[0, 0, 1]"), "s.toml: trajectory comes down to -1.00 m above the start"),
        (MINIMAL.replace("[0, 0, -1]", '["a", 0, -1]'), "s.toml: trajectory.position_m = 'a' is not allowed"),
        (MINIMAL + "[limits]\nthrust_max_weights = 0.5\n", "s.toml: limits.thrust_max_weights = 0.5 is not allowed"),
        (MINIMAL + "[truth]\nmass_ratio = true\n", "s.toml: truth.mass_ratio = True is not allowed"),
        (MINIMAL + "[truth.effects.magic]\na = 1\n", "s.toml: truth: unknown effect effects.magic"),
        (MINIMAL + "[truth.effects.payload]\nkg = 1\n", "unknown key effects.payload.kg"),
        (MINIMAL + "[region]\nkind = 'cube'\n", "s.toml: region.kind = 'cube' is not known"),
        (MINIMAL + "[region]\nkind = 'axes'\ncentre_m = [0,0,0]\n", "s.toml: region.semi_axes_m = missing must be"),
        (MINIMAL + "[[events]]\ntime_s = -1\neffect = 'payload'\nvalues = {}\n", "s.toml: event 1: time_s = -1"),
        (MINIMAL + "[[events]]\ntime_s = 1\nvalues = {}\n", "s.toml: event 1: effect = missing"),
        (MINIMAL + "[events]\ntime_s = 1\n", r"s.toml: events must be a list of tables, written \[\[events\]\]"),
        (MINIMAL + "[[checks]]\nmetric = 'a'\nwords = 'b'\n", "s.toml: check 1: give below, above or both"),
        ("trajectory = 3\n" + MINIMAL.replace("[trajectory]", "[limits]"), "s.toml: "),
        (
            MINIMAL.replace("duration_s = 5", 'duration_s = 5\nsensors = "radar"'),
            "s.toml: sensors = 'radar' is not known",
        ),
    ],
)
def test_a_mistake_is_one_line_that_names_file_and_key(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        parse_scenario(text, "s.toml")
    assert "\n" not in str(caught.value)


def test_another_duration_is_checked_too() -> None:
    scenario = load_scenario("hover")
    assert scenario.with_duration(33.0).duration_s == 33.0
    with pytest.raises(InputError, match="hover: duration_s = -1 is not allowed"):
        scenario.with_duration(-1)


def test_waypoints_become_a_scenario_that_flies_through_them() -> None:
    text = (ROOT / "flightstack/data/scenarios" / "waypoints" / "square.toml").read_text()
    scenario = waypoints_scenario(parse_waypoints(text, "square.toml"), "square.toml")
    assert scenario.duration_s == 12.0
    np.testing.assert_allclose(scenario.trajectory.at(6.0).pos_ned_m, [2.0, 2.0, -2.0], atol=1e-9)
