"""Whether a flight was flown and whether it was protected: heights, touchdowns and spans worked out by hand."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import pytest
from certified import says

from flightstack.cli import console
from flightstack.cli.barrier_score import FilterScore
from flightstack.cli.result import NO_BARRIER, NO_GP, NO_LOOP, FlightResult
from flightstack.cli.verdict import Ascent, Flown, most_rms_m, protection_of, spans_words
from flightstack_logs.report.flight import FlightReport
from flightstack_logs.report.result import outcome_from_result
from flightstack_logs.report.words import figures, headline, verdict

GRAVITY_MPS2 = 9.80665


def flown(**changes: Any) -> Flown:
    return dataclasses.replace(Flown(1.5, 1.5, 0.7, 0.5), **changes)


# ---------------------------------------------------------------- flown


def test_a_flight_that_rose_followed_and_touched_down_softly_lacks_nothing() -> None:
    assert flown().shortcoming(0.03) == ""


@pytest.mark.parametrize(
    ("changes", "rmse_m", "said"),
    [
        ({"rose_m": 0.0}, 0.03, "never flew: it rose 0.00 m of the 1.50 m"),
        ({"rose_m": 0.74}, 0.03, "never flew: it rose 0.74 m"),
        ({"rose_m": None}, 0.03, "never flew: its height is not known"),
        ({"rose_m": float("nan")}, 0.03, "never flew"),
        ({}, None, "no tick of the track was scored"),
        ({}, 0.51, "did not fly what was asked: 0.51 m rms"),
        ({}, float("nan"), "did not fly what was asked"),
        ({"touchdown_mps": 1.6}, 0.03, "hit the ground at 1.6 m/s"),
        ({"touchdown_mps": None}, 0.03, "its touchdown was not seen"),
    ],
)
def test_each_thing_that_lacks_is_said_in_one_line(changes: dict[str, Any], rmse_m: float | None, said: str) -> None:
    line = flown(**changes).shortcoming(rmse_m)
    assert said in line
    assert "\n" not in line


def test_a_site_that_stopped_a_flight_again_and_again_is_named_as_why_it_was_elsewhere() -> None:
    assert "the site's filter stopped it in 26% of the ticks" in flown().shortcoming(1.36, 0.26)
    assert "site" not in flown().shortcoming(1.36, 0.01)
    assert flown().shortcoming(0.3, 0.26) == ""


def test_half_the_height_half_a_metre_and_one_and_a_half_metres_a_second_just_count() -> None:
    assert flown(rose_m=0.75, touchdown_mps=1.5).shortcoming(0.5) == ""


def test_a_rough_estimate_may_be_a_metre_off() -> None:
    assert most_rms_m("truth", "mocap") == 0.5
    assert most_rms_m("truth", "gps") == most_rms_m("estimate", "") == most_rms_m("estimate", "mocap") == 1.0


def test_the_true_touchdown_is_that_of_a_fall_from_a_height_and_the_hardest_counts() -> None:
    """Dropped from 0.2 m: sqrt(2 g h) = 1.98 m/s, to a tick's worth; the hop after it counts for less."""
    ascent, down_mps, height_m = Ascent(), 0.0, 0.2
    ascent.true_contact((0.0, 0.0, 0.0), False)
    while height_m > 0.0:
        down_mps += 0.004 * GRAVITY_MPS2
        height_m -= 0.004 * down_mps
        ascent.true_contact((0.0, 0.0, down_mps), height_m <= 0.0)
    for on_ground in (False, True):
        ascent.true_contact((0.0, 0.0, 0.1), on_ground)
    assert ascent.touchdown_mps == pytest.approx((2.0 * GRAVITY_MPS2 * 0.2) ** 0.5, abs=2 * 0.004 * GRAVITY_MPS2)


def test_one_that_stays_on_the_ground_has_no_touchdown_and_no_height() -> None:
    ascent = Ascent()
    for _ in range(100):
        ascent.true_contact((0.0, 0.0, 0.0), True)
        ascent.height(0.001)
    assert ascent.touchdown_mps is None
    assert ascent.rose_m == pytest.approx(0.001)


def descend(ascent: Ascent, speeds_mps: list[float], *, height_m: float) -> None:
    """Samples of a descent from a height, 8 ms apart; on the ground the place stays."""
    for speed in speeds_mps:
        height_m = max(0.0, height_m - 0.008 * speed)
        ascent.estimated_descent(-height_m, speed)


@pytest.mark.parametrize(("speed_mps", "rest_mps"), [(0.7, 0.05), (5.8, -0.2), (3.3, 0.4)])
def test_the_estimated_touchdown_is_the_speed_at_which_the_ground_was_reached(
    speed_mps: float, rest_mps: float
) -> None:
    """What an estimate at rest wanders by afterwards hides nothing."""
    ascent = Ascent()
    descend(ascent, [speed_mps] * 250 + [rest_mps] * 300, height_m=2.0 * speed_mps)
    assert ascent.touchdown_mps == pytest.approx(speed_mps)


def test_a_fast_descent_high_up_is_no_hard_touchdown_and_a_drop_at_its_end_is_one() -> None:
    slowing, dropping = Ascent(), Ascent()
    descend(slowing, [2.0] * 300 + [0.7] * 200 + [0.0] * 100, height_m=0.008 * (2.0 * 300 + 0.7 * 200))
    assert slowing.touchdown_mps == pytest.approx(0.7)
    drop = [0.7] * 250 + [min(0.7 + 0.0785 * k, 4.0) for k in range(60)]
    descend(dropping, [*drop, *[0.0] * 100], height_m=0.008 * sum(drop))
    assert dropping.touchdown_mps == pytest.approx(4.0)


# ---------------------------------------------------------------- protected

HELD = {"violations": 0, "min_h_truth": 0.1, "min_h_estimate": 0.1}


@pytest.mark.parametrize(
    ("asked", "spans", "region", "expected"),
    [
        (True, [(1.0, 9.0)], HELD, "held"),
        (True, [(1.0, 9.0)], HELD | {"violations": 3, "min_h_truth": -0.1}, "left"),
        (True, [(1.0, 9.0)], HELD | {"violations": None, "min_h_truth": None}, "held"),
        (True, [(1.0, 9.0)], HELD | {"violations": None, "min_h_truth": None, "min_h_estimate": -0.2}, "left"),
        (True, [(1.0, 9.0)], HELD | {"violations": None, "min_h_truth": None, "min_h_estimate": None}, "none"),
        (True, [(1.0, 9.0)], HELD | {"violations": 0, "min_h_truth": None}, "none"),
        (True, [], HELD, "none"),
        (True, [], HELD | {"violations": 3}, "none"),
        (False, [], HELD | {"violations": 3}, "off"),
    ],
)
def test_the_verdict_on_the_protection(
    asked: bool, spans: list[tuple[float, float]], region: dict[str, Any], expected: str
) -> None:
    assert protection_of(asked, spans, region) == expected


def test_spans_begin_and_end_with_the_ticks_whose_command_the_certificate_allows() -> None:
    """Statuses: 0 and 1 nothing yet, 2 and 3 protected, 4 a fallback, 2 again; the first 10 ticks climb."""
    score = FilterScore()
    for k, status in enumerate([0] * 10 + [1] * 10 + [2] * 40 + [3] * 10 + [4] * 5 + [2] * 25):
        score.add(0.004 * k, says(status), climbing=k < 10)
    assert score.spans == [(pytest.approx(0.08), pytest.approx(0.276)), (pytest.approx(0.3), pytest.approx(0.396))]
    assert score.engaged_share == pytest.approx(75 / 90)
    assert (score.acting, score.infeasible) == (80, 5)


def test_spans_in_words() -> None:
    assert spans_words([]) == "not protected"
    assert spans_words([(12.34, 61.0)]) == "protected from 12.3 s to 61.0 s"
    assert spans_words([(1.0, 3.0), (5.0, 9.0)]) == "protected from 1.0 s to 9.0 s, 6.0 s in 2 parts"


# ---------------------------------------------------------------- what is said and what it costs


def result_of(protection: str, **changes: Any) -> FlightResult:
    spans = [] if protection == "none" else [{"from_s": 6.0, "to_s": 20.0}]
    outside = {"held": 0, "left": 4, "none": None}.get(protection)
    barrier = NO_BARRIER | {"enabled": True, "violations": outside, "min_h_truth": -0.1, "protected": spans}
    result = FlightResult(
        scenario="paper-tracking", seed=0, log=None, completed=True, reason="", flight_time_s=30.0, wall_time_s=1.0,
        clock_time_s=30.0, plant="native", controller="flatness", gp=NO_GP, loop=NO_LOOP,
        tracking={"of": "truth", "rmse_m": 0.01, "max_m": 0.2, "rmse_settled_m": 0.1},
        barrier=NO_BARRIER if protection == "off" else barrier | {"interventions": 0},
        protection=protection, filter_words="off: --no-filter" if protection == "off" else "sound, in flight",
    )  # fmt: skip
    return dataclasses.replace(result, **changes)


@pytest.mark.parametrize(
    ("protection", "passed", "words"),
    [
        ("held", True, "protected from 6.0 s to 20.0 s"),
        ("left", False, "left (protected from 6.0 s to 20.0 s)"),
        ("none", False, "not protected"),
        ("off", True, "off: --no-filter"),
    ],
)
def test_protection_is_in_json_terminal_and_page_by_the_same_words(
    protection: str, passed: bool, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    result = result_of(protection)
    data = json.loads(json.dumps(result.as_json(), allow_nan=False))
    assert (data["protection"], data["passed"], data["protection_words"]) == (protection, passed, words)
    assert result.passed is passed
    assert bool(result.failure()) is not passed
    console.show_result(result)
    assert words in " ".join(capsys.readouterr().out.split())
    page = FlightReport(outcome_from_result(data))
    assert (verdict(page)[0] == "good") is passed
    assert (words in headline(page)) is (protection != "off")
    assert any(figure.state == "bad" for figure in figures(page)) is not passed


@pytest.mark.parametrize("protection", ["left", "none"])
def test_what_was_not_protected_passes_where_that_is_allowed_and_says_so_all_the_same(protection: str) -> None:
    result = result_of(protection, unprotected_ok=True)
    assert result.passed
    assert result.as_json()["protection"] == protection
    assert verdict(FlightReport(outcome_from_result(result.as_json())))[0] != "good"


def test_a_log_that_is_not_whole_and_a_failed_check_make_no_green_page() -> None:
    broken = result_of("held", log_problem="log x: no space left")
    assert verdict(FlightReport(outcome_from_result(broken.as_json())))[0] == "bad"
    missed = result_of("held", checks=[{"words": "close", "metric": "x", "value": 1.0, "passed": False}])
    missed.miss_checks()
    assert missed.completed is False
    assert missed.as_json()["reason"] == "check failed: close (x = 1.0)"
    assert verdict(FlightReport(outcome_from_result(missed.as_json())))[0] == "bad"


def test_a_dry_run_is_neither_completed_nor_failed(capsys: pytest.CaptureFixture[str]) -> None:
    result = result_of("off", completed=None)
    assert result.as_json()["completed"] is None
    assert result.passed
    console.show_result(result)
    assert "completed" not in capsys.readouterr().out
