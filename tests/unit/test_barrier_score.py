"""The barrier filter seen from outside: time of its steps, h of the judged region, the JSON, the verdict."""

from __future__ import annotations

import dataclasses
import json
import time
from typing import Any

import numpy as np
import pytest
from certified import CENTRE, certificate, says
from log_samples import tick_record
from shipped import load_vehicle

from flightstack.barrier.records import Certificate
from flightstack.cli import barrier_score, console
from flightstack.cli.barrier_score import (
    FilterScore,
    GivenCertificate,
    RegionScore,
    TimedFilter,
    WatchedCertifier,
    barrier_summary,
    certified_values,
    engaged_from,
    premises_of,
    qp_summary,
)
from flightstack.cli.protection import Protection
from flightstack.cli.result import NO_BARRIER, NO_GP, NO_LOOP, NO_QP, FlightResult
from flightstack.model import Model
from flightstack.region import Region
from flightstack.seams import NoFilter
from flightstack.types import F64, Command, Filtered, FlatOutput, Learned, Measurement

TICK_US = 4_000
BOX = Region("axes", (0.0, 0.0, -1.5), (2.0, 1.0, 1.0), (1.0, 1.0, 0.5))

MODEL = Model.from_vehicle(load_vehicle("quad-x"))


class Says:
    """A filter that says what it is told to say, one after the other."""

    enabled = True

    def __init__(self, *words: Filtered, takes_s: float = 0.0) -> None:
        self.words, self.takes_s = words, takes_s
        self.adopted: list[Certificate] = []

    def init(self, origin_ned_m: F64) -> int:
        return 0

    def bend(self, state: Any, setpoint: FlatOutput) -> FlatOutput:
        return setpoint

    def adopt(self, state: Any, certificate: Certificate) -> Any:
        self.adopted.append(certificate)
        return state

    def step(
        self, state: Any, measurement: Measurement, command: Command, sent: Command, learned: Learned
    ) -> tuple[Any, Command, Filtered]:
        until = time.perf_counter() + self.takes_s
        while time.perf_counter() < until:
            pass
        return state + 1, command, self.words[state % len(self.words)]


def run(safety_filter: TimedFilter, ticks: int) -> None:
    record = tick_record(1)
    state = safety_filter.init(np.zeros(3))
    for _ in range(ticks):
        state, command, _ = safety_filter.step(
            state, record.measurement, record.command, record.command, record.learned
        )
        assert command is record.command


# ---------------------------------------------------------------- timing


def test_only_steps_that_solve_are_timed_and_an_init_forgets_them() -> None:
    timed = TimedFilter(Says(says(0), says(1), says(2), says(3), says(4), says(5), takes_s=0.001))
    run(timed, 6)
    assert len(timed.solve_ns) == 4
    assert min(timed.solve_ns) >= 1_000_000
    run(timed, 2)
    assert len(timed.solve_ns) == 0


def test_a_timed_filter_hands_certificates_on() -> None:
    inner, one = Says(says(0)), certificate()
    TimedFilter(inner).adopt(0, one)
    assert inner.adopted == [one]


def test_a_given_certificate_is_handed_over_once_with_the_vehicle_it_flies() -> None:
    given = certificate(knowledge={"sha256": "x"})
    certifier = WatchedCertifier(GivenCertificate(given, MODEL), {"vehicle": "quad-x"})
    record = tick_record(1)
    for _ in range(2):  # a second flight begins anew
        state, handed = certifier.init(), []
        for _ in range(3):
            state, one = certifier.step(state, None, record.measurement, record.learned, record.filtered)
            handed.append(one)
        assert handed[1:] == [None, None]
        assert handed[0] is not None
        assert handed[0].knowledge == {"sha256": "x", "vehicle": "quad-x"}
        assert handed[0].axes is given.axes
        assert certifier.adopted == handed[:1]


# ---------------------------------------------------------------- h


def test_a_certificates_h_is_the_least_of_its_axes_and_as_published_their_common_ellipsoid() -> None:
    states = np.array([[*np.add(CENTRE, (0.5, 0.0, 0.3)), 0.0, 0.25, 0.0]])
    assert certified_values(certificate(), states) == pytest.approx(0.75)  # both 0.5^2 and (0.25 / 0.5)^2 are 1/4
    published = certificate(mode="as-published")
    assert certified_values(published, states) == pytest.approx(1.0 - 0.25 - 0.25 - 0.09)


def test_a_region_counts_from_half_a_second_at_0_05_on() -> None:
    t_us = list(range(0, 2_000_000, TICK_US))
    h = np.full(len(t_us), 0.2)
    assert engaged_from(t_us, h) == 125
    h[100] = 0.049  # 0.4 s: it begins anew
    assert engaged_from(t_us, h) == 101 + 125
    assert engaged_from(t_us, np.full(len(t_us), 0.04)) is None
    assert engaged_from(t_us, np.full(len(t_us), np.nan)) is None
    assert engaged_from(t_us[:125], h[:125]) is None


def scored(region: Region | None, down_m: F64, *, off_m: float = 0.0, truth: bool = True) -> dict[str, Any]:
    """The summary of a flight along down: as estimated, and `off_m` further down in truth."""
    states = np.zeros((len(down_m), 6))
    states[:, 2] = down_m
    t_us = 1_000_000.0 + TICK_US * np.arange(len(states))
    true = states + np.array([0.0, 0.0, off_m, 0.0, 0.0, 0.0])
    return RegionScore(region).summary(t_us, np.zeros(len(states), np.int64), states, true if truth else None)


def test_violations_are_ticks_of_the_true_state_outside_once_it_counts() -> None:
    """From the ground up into the box round 1.5 m, 1 m high each way; then out by 0.1 m for 10 ticks."""
    down = np.concatenate([np.zeros(50), np.full(250, -1.5), np.full(10, -2.6), np.full(40, -1.5)])
    seen = scored(BOX, down)
    assert (seen["of"], seen["violations"]) == ("scenario", 10)
    assert seen["engaged_s"] == pytest.approx((50 + 125) * 0.004)
    assert seen["left_s"] == pytest.approx(300 * 0.004)
    assert seen["min_h_truth"] == pytest.approx(1.0 - 1.1**2)


def test_it_is_the_truth_that_counts_and_not_the_estimate() -> None:
    down = np.concatenate([np.full(250, -1.5), np.full(10, -0.6)])
    seen = scored(BOX, down, off_m=0.2)
    assert seen["min_h_estimate"] == pytest.approx(1.0 - 0.9**2)
    assert seen["min_h_truth"] == pytest.approx(1.0 - 1.1**2)
    assert seen["violations"] == 10
    blind = scored(BOX, down, truth=False)
    assert (blind["min_h_truth"], blind["violations"], blind["left_s"]) == (None, None, None)
    assert blind["min_h_estimate"] == seen["min_h_estimate"]


def test_of_a_flight_that_never_came_inside_neither_violations_nor_h_are_known() -> None:
    seen = scored(BOX, np.zeros(500))
    assert (seen["violations"], seen["min_h_truth"], seen["engaged_s"]) == (None, None, None)
    assert set(scored(None, np.zeros(500)).values()) <= {None, 0}


def test_under_a_certificate_the_one_in_force_at_the_tick_judges() -> None:
    certifier = WatchedCertifier(GivenCertificate(certificate(), MODEL))
    certifier.adopted += [certificate(), certificate(semi_m=0.6)]
    inside = np.concatenate([CENTRE, np.zeros(3)])
    away = np.add(inside, (0.9, 0.0, 0.0, 0.0, 0.0, 0.0))
    in_force = np.repeat([0, 1, 2], [1, 209, 5])  # at first nothing is
    states = np.repeat([inside, away], [200, 15], axis=0)
    seen = RegionScore(None, certifier).summary(float(TICK_US) * np.arange(215), in_force, states, states)
    assert (seen["of"], seen["violations"]) == ("certificate", 5)
    assert seen["min_h_truth"] == pytest.approx(1.0 - (0.9 / 0.6) ** 2)
    assert seen["left_s"] == pytest.approx(0.84)


# ---------------------------------------------------------------- the JSON


def test_the_json_of_a_filtered_flight_has_the_fields_that_are_promised() -> None:
    timed = TimedFilter(Says(says(2)))
    for solve_ns in (20_000, 30_000, 40_000):
        timed.solve_ns.append(solve_ns)
    region = scored(BOX, np.full(300, -1.5))
    result = flown(
        barrier=barrier_summary(True, region, FilterScore(interventions=12)), qp=qp_summary(timed, 3), region=region
    ).as_json()
    barrier = {"enabled": True, "min_h_truth": 1.0, "min_h_estimate": 1.0, "violations": 0, "interventions": 12,
               "protected": [], "engaged_share": None, "governor_share": None, "premises_broken": 0}  # fmt: skip
    assert result["barrier"] == barrier
    assert result["qp"]["solve_us"] == {"p50": 30.0, "p99": pytest.approx(39.8), "max": 40.0}
    assert result["qp"]["infeasible"] == 3
    histogram = result["qp"]["histogram"]
    assert sum(histogram["counts"]) == 3
    assert len(histogram["edges_us"]) == len(histogram["counts"]) + 1
    json.dumps(result, allow_nan=False)


def test_the_governors_share_is_of_the_engaged_ticks() -> None:
    score = FilterScore()
    for governed in (True, True, False, False):
        score.add(1.0, says(1), climbing=True, governed=True)
        score.add(2.0, says(2), climbing=False, governed=governed)
    assert barrier_summary(True, scored(BOX, np.full(3, -1.5)), score)["governor_share"] == 0.5


def test_a_premise_counts_as_broken_as_measured_or_by_the_truth_while_the_filter_is_engaged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Ticks: not engaged and far off; within; velocity beyond; position beyond; measured; nothing known."""
    monkeypatch.setattr(barrier_score, "carried_off", lambda certificate: (np.full(3, 0.1), np.full(3, 0.2)))
    said = says(1, premise=1.0), says(2), says(2, premise=0.0), says(3), says(4, premise=2.0), says(2)
    premises = np.array([premises_of(each) for each in said])
    assert premises.tolist() == [0, 1, 1, 1, 2, 1]
    off = np.zeros((6, 6))
    off[0], off[1], off[2, 4], off[3, 0], off[5] = 1.0, 0.1, -0.21, -0.11, np.nan
    score = FilterScore()
    score.judge(certificate(), premises, off)
    assert score.premises_broken == 0, "it has none"
    rests_on: Any = certificate(premises=object())
    score.judge(rests_on, premises, off)
    assert score.premises_broken == 3
    score.judge(rests_on, premises, None)
    assert score.premises_broken == 4


def test_time_in_which_somebody_else_flew_is_not_protected() -> None:
    score = FilterScore()
    for flight_s in (1.0, 1.004, 1.1, 1.4, 1.404):  # 0.1 s is a late tick; in 0.3 s the autopilot had the vehicle
        score.add(flight_s, says(2), climbing=False)
    assert score.spans == [(1.0, 1.1), (1.4, 1.404)]


def test_without_a_filter_every_field_is_null_and_the_region_is_told_all_the_same() -> None:
    region = scored(BOX, np.concatenate([np.full(250, -1.5), np.zeros(10)]))
    barrier, qp = barrier_summary(False, region, FilterScore()), qp_summary(NoFilter(), 0)
    assert (barrier, qp) == (NO_BARRIER, NO_QP)
    assert set(barrier.values()) == {False, None}
    result = flown(barrier=barrier, qp=qp, region=region)
    assert result.as_json()["region"]["violations"] == 10
    assert result.passed  # nothing was asked to keep inside


def test_a_filter_that_never_solved_anything_has_no_times() -> None:
    qp = qp_summary(TimedFilter(Says(says(0))), 0)
    assert (qp["infeasible"], qp["histogram"], qp["solve_us"]["p50"]) == (0, None, None)


def flown(**changes: Any) -> FlightResult:
    result = FlightResult(
        scenario="hover", seed=0, log=None, completed=True, reason="", flight_time_s=10.0, wall_time_s=1.0,
        clock_time_s=10.0, plant="native", controller="flatness",
        tracking={"of": "truth", "rmse_m": 0.1, "max_m": 0.2, "rmse_settled_m": 0.1}, gp=NO_GP, loop=NO_LOOP,
    )  # fmt: skip
    return dataclasses.replace(result, **changes)


def left() -> FlightResult:
    region = scored(BOX, np.concatenate([np.full(250, -1.5), np.full(10, -2.6), np.full(9, -1.5)]))
    return flown(barrier=barrier_summary(True, region, FilterScore(interventions=7)), qp=NO_QP | {"infeasible": 2},
                 region=region, protection="left")  # fmt: skip


def test_a_flight_that_left_its_region_has_failed_though_it_completed() -> None:
    result = left()
    assert result.completed
    assert not result.passed
    words = "left its region: h of the true state was below 0 in 10 ticks (least -0.210), first 1.00 s after take-off"
    assert result.failure() == words
    data = result.as_json()
    assert (data["completed"], data["reason"]) == (True, words)
    early = dataclasses.replace(result, completed=False, reason="stopped by the user")
    assert early.failure() == "stopped by the user"
    assert early.as_json()["reason"] == f"stopped by the user; {words}"


# ---------------------------------------------------------------- the terminal


def printed(result: FlightResult, capsys: pytest.CaptureFixture[str]) -> str:
    console.show_result(result)
    return " ".join(capsys.readouterr().out.split())


def test_the_summary_says_what_the_filter_kept_to_and_what_it_took(capsys: pytest.CaptureFixture[str]) -> None:
    told = printed(dataclasses.replace(left(), filter_words="sound, certified in flight"), capsys)
    assert "completed, but left its region" in told
    assert "barrier filter sound, certified in flight, least h of the truth -0.210 (10 ticks outside)" in told
    assert "7 interventions, 2 infeasible" in told


def test_the_summary_says_why_there_was_no_filter(capsys: pytest.CaptureFixture[str]) -> None:
    assert "barrier filter off: --no-filter" in printed(flown(filter_words="off: --no-filter"), capsys)
    assert "barrier filter off" in printed(flown(), capsys)


def test_a_filter_that_never_engaged_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    region = scored(BOX, np.zeros(300))
    result = flown(barrier=barrier_summary(True, region, FilterScore()), qp=NO_QP | {"infeasible": 0}, region=region)
    assert "nothing was certified in time: it never engaged" in printed(result, capsys)
    result.unprotected_because = Protection("sound, certificate f", given=certificate()).not_taken(0)
    assert "never within region, speeds and leans of the certificate" in result.unprotected_because
    told = printed(result, capsys)
    assert "it never engaged" in told
    assert "certified in time" not in told
    result.region["filtered_ticks"] = 1
    assert "it never engaged" not in printed(result, capsys)
    assert result.passed


def test_a_certificate_that_was_taken_or_is_made_in_flight_is_not_called_not_taken() -> None:
    assert Protection("sound, certificate f", given=certificate()).not_taken(1) == ""
    assert Protection("sound, certified in flight").not_taken(0) == ""
