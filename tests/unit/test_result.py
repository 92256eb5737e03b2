"""A flight's result: what of the learner is timed, scored, told and printed."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from typing import Any

import numpy as np
import pytest
from log_samples import tick_record
from shipped import load_vehicle

from flightstack.cli import console
from flightstack.cli.calibration import TimedLearner, gp_summary
from flightstack.cli.recorder import LearnerEvents
from flightstack.cli.result import NO_GP, NO_LOOP, FlightResult, judge, percentiles
from flightstack.cli.ticks import FlownTicks, TickTable
from flightstack.model import Model
from flightstack.scenario import Check
from flightstack.seams import NoLearner
from flightstack.types import STANDARD_GRAVITY_MPS2, Command, FlatOutput, Learned, Measurement, changed
from flightstack_sim.plant import Truth

MODEL = Model.from_vehicle(load_vehicle("quad-x"))
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


class Said:
    """A learner that says what it is told to say, after a while."""

    enabled = True

    def __init__(self, learned: Learned, takes_s: float = 0.0) -> None:
        self.learned, self.takes_s = learned, takes_s

    def init(self) -> int:
        return 0

    def step(
        self, state: Any, measurement: Measurement, sent: Command, reference: FlatOutput
    ) -> tuple[object, Learned]:
        until = time.perf_counter() + self.takes_s
        while time.perf_counter() < until:
            pass
        return state + 1, self.learned


def knows(residual: tuple[float, float, float], sigma: float = 0.1, **more: Any) -> Learned:
    told = {"stage": 3.0, "points": 300.0, "fed": 15000.0, "refused": 7.0, "changes": 1.0, "latency_s": 0.008, **more}
    return changed(Learned.nothing(), residual_frd_mps2=residual, sigma_frd_mps2=sigma, **told)


def hovers(mass_ratio: float) -> Truth:
    """Hovering level with this true over believed mass."""
    norm = MODEL.norm_of(mass_ratio * MODEL.weight_n)
    force = (0.0, 0.0, -STANDARD_GRAVITY_MPS2)
    zero = (0.0, 0.0, 0.0)
    return Truth(0, zero, zero, UPRIGHT, zero, force, zero, (norm,) * 4, (0.0,) * 4, zero, 16.0, False)


def ticks(*learned: Learned, truth: Truth | None = None) -> TickTable:
    """Of the track."""
    kept, record = FlownTicks(), tick_record(1)
    for one in learned:
        kept.add((0, 0, True, 0), record._replace(learned=one), record.reference.row, np.zeros(3))
        if truth is not None:
            kept.add_truth((0.0, 0.0, 0.0), truth.pos_ned_m, truth)
    return kept.table(np.zeros(3))


# ---------------------------------------------------------------- timing


def test_a_timed_learner_says_what_the_learner_says_and_counts_every_step_since_its_init() -> None:
    learned = knows((1.0, 2.0, 3.0))
    timed = TimedLearner(Said(learned, takes_s=0.001))
    record = tick_record(1)
    state = timed.init()
    for _ in range(3):
        state, seen = timed.step(state, record.measurement, record.command, record.reference)
        assert seen is learned
    assert state == 3
    assert len(timed.step_ns) == 3
    assert min(timed.step_ns) >= 1_000_000
    assert timed.init() == 0
    assert len(timed.step_ns) == 0


# ---------------------------------------------------------------- the JSON's `gp`


def test_without_a_learner_every_figure_is_null() -> None:
    summary = gp_summary(NoLearner(), MODEL, None, ticks())
    assert summary.pop("enabled") is False
    assert summary.pop("step_us") == {"p50": None, "p99": None, "max": None}
    assert set(summary.values()) == {None}


def test_coverage_is_of_the_truth_against_the_delivered_thrust() -> None:
    """Hovering with 1.4 times the mass leaves (0, 0, 0.4 g): x is wrong throughout, z right in one tick of two."""
    right, wrong = knows((1.0, 0.0, 0.4 * STANDARD_GRAVITY_MPS2)), knows((1.0, 0.0, 3.0))
    summary = gp_summary(Said(right), MODEL, wrong, ticks(right, wrong, truth=hovers(1.4)))
    assert summary["coverage_3sigma_axes"] == [0.0, 1.0, 0.5]
    assert summary["coverage_3sigma"] == pytest.approx(0.5)
    assert summary["coverage_simultaneous"] == 0.0


def test_a_tick_before_anything_is_used_counts_and_one_without_a_word_does_not() -> None:
    early = knows((0.0, 0.0, 0.0), sigma=5.0, stage=0.0)
    score = ticks(early, Learned.nothing(), truth=hovers(1.4))
    summary = gp_summary(Said(early), MODEL, early, score)
    assert summary["coverage_3sigma"] == 1.0


def test_where_nobody_knows_the_truth_coverage_is_null_and_the_rest_is_said() -> None:
    learned = knows((0.0, 0.0, 0.0), thrust_gain=0.714)
    summary = gp_summary(Said(learned), MODEL, learned, ticks(learned))
    assert summary["coverage_3sigma"] is None
    assert summary["coverage_simultaneous"] is None
    expected = {"enabled": True, "points": 300, "fed": 15000, "refused": 7, "changes": 1, "latency_s": 0.008}
    assert {name: summary[name] for name in expected} == expected
    assert summary["thrust_gain"] == pytest.approx(0.714)
    assert all(isinstance(summary[name], int) for name in ("points", "fed", "refused", "changes"))


def test_the_summary_is_json_whatever_the_learner_says() -> None:
    learned = knows((math.nan,) * 3, sigma=math.nan, latency_s=math.nan, thrust_gain=math.inf)
    summary = gp_summary(TimedLearner(Said(learned)), MODEL, learned, ticks(learned, truth=hovers(1.0)))
    assert set(summary) == set(NO_GP)
    json.dumps(summary, allow_nan=False)
    assert summary["latency_s"] is None


def test_the_conformal_check_is_of_the_learners_own_targets() -> None:
    rng = np.random.default_rng(0)
    off = np.repeat(rng.normal(size=(400, 3)), 60, axis=0)
    noisy = [knows((0.0, 0.0, 0.0), sigma=0.5, target_frd_mps2=each) for each in off]
    summary = gp_summary(Said(noisy[0]), MODEL, noisy[0], ticks(*noisy))
    assert set(summary["conformal"]) == {"quantile_sigma", "coverage_heldout", "alpha"}
    assert summary["conformal"]["quantile_sigma"] == pytest.approx(3.0 / 0.5, rel=0.2)  # errors of 1, claimed as 0.5
    assert summary["conformal"]["coverage_heldout"] == pytest.approx(0.9973, abs=0.005)


def test_step_times_are_in_microseconds() -> None:
    timed = TimedLearner(Said(knows((0.0, 0.0, 0.0))))
    for step_ns in (1_000, 2_000, 3_000):
        timed.step_ns.append(step_ns)
    assert gp_summary(timed, MODEL, None, ticks())["step_us"] == percentiles([1.0, 2.0, 3.0])


# ---------------------------------------------------------------- the result


def flown(**changes: Any) -> FlightResult:
    result = FlightResult(
        scenario="hover", seed=0, log=None, completed=True, reason="", flight_time_s=10.0, wall_time_s=1.0,
        clock_time_s=10.0, plant="native", controller="flatness",
        tracking={"of": "truth", "rmse_m": 0.1, "max_m": 0.2, "rmse_settled_m": 0.1}, gp=NO_GP, loop=NO_LOOP,
    )  # fmt: skip
    return dataclasses.replace(result, **changes)


def test_a_check_may_ask_for_what_the_learner_reached_and_fails_where_nothing_learned() -> None:
    check = Check("gp.coverage_3sigma", None, 0.99, "bounds hold")
    assert judge(check, flown(gp=NO_GP | {"coverage_3sigma": 0.997}).as_json())["passed"]
    assert not judge(check, flown().as_json())["passed"]


def test_a_flight_prints_one_line_on_learning(capsys: pytest.CaptureFixture[str]) -> None:
    learned = NO_GP | {
        "enabled": True, "points": 300, "fed": 15000, "thrust_gain": 0.7141, "coverage_3sigma": 0.99734,
        "step_us": {"p50": 12.3, "p99": 30.6, "max": 99.0},
    }  # fmt: skip
    console.show_result(flown(gp=learned))
    printed = " ".join(capsys.readouterr().out.split())
    assert "300 points of 15000 samples, thrust 0.714 of the believed" in printed
    assert "truth within 3 sigma 99.73 %, step 12 us (p99 31 us)" in printed


def test_a_flight_without_learning_says_off_and_one_that_learned_nothing_says_so(
    capsys: pytest.CaptureFixture[str],
) -> None:
    console.show_result(flown())
    console.show_result(flown(gp=NO_GP | {"enabled": True}))
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if "learning" in line]
    assert lines == [["learning", "off"], ["learning", "nothing", "learned"]]


def test_a_flight_that_learned_of_nothing_or_was_none_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    """Of a wrong vehicle file: "thrust 1.000 of the believed", "0.0 s from take-off to disarmed"."""
    nothing = NO_GP | {"enabled": True, "points": 0, "fed": 243, "thrust_gain": 1.0}
    console.show_result(flown(gp=nothing, flight_time_s=0.0, completed=False, wall_time_s=0.7))
    printed = " ".join(capsys.readouterr().out.split())
    assert "learning 0 points of 243 samples" in printed
    assert "believed" not in printed
    assert "flight none: refused or ended before it (after 0.7 s)" in printed
    assert "take-off" not in printed


# ---------------------------------------------------------------- events


def told(*ticks: Learned) -> list[tuple[int, str, str]]:
    """What is told of these ticks, 4 ms apart: time in ms, text, severity."""
    lines: list[tuple[int, str, str]] = []

    def tell(t_us: int, name: str, text: str, severity: str) -> None:
        assert name == "learner"
        lines.append((t_us // 1000, text, severity))

    events = LearnerEvents(tell)
    for index, learned in enumerate(ticks):
        events.on_learned(4000 * index, learned)
    return lines


def at_stage(stage: int, ticks: int) -> list[Learned]:
    return [knows((0.0, 0.0, 0.0), stage=float(stage), changes=0.0)] * ticks


def test_each_new_stage_is_told_once() -> None:
    ticks = [
        *at_stage(0, 50),
        *at_stage(1, 50),
        *at_stage(2, 50),
        *at_stage(3, 50),
        *at_stage(4, 50),
        *at_stage(3, 150),
    ]
    assert told(*ticks) == [
        (200, "learner: calculable", "info"),
        (400, "learner: valid", "info"),
        (600, "learner: used", "info"),
        (800, "learner: used but frozen", "info"),
        (1500, "learner: used", "info"),
    ]


def test_a_stage_that_comes_and_goes_with_every_tick_is_told_once_and_its_end_when_it_lasts() -> None:
    """A real PX4 that could not leave the ground: "calculable" and "nothing learned" ten times a second."""
    ticks = [at_stage(index % 2, 1)[0] for index in range(500)]
    assert told(*ticks, *at_stage(0, 250)) == [
        (4, "learner: calculable", "info"),
        (2500, "learner: nothing learned", "info"),
    ]


def test_without_a_learner_nothing_is_told() -> None:
    assert told(*[Learned.nothing()] * 10) == []


def test_a_sudden_change_is_told_once_with_its_axis_and_size() -> None:
    before = at_stage(3, 25)
    surprising = knows((0.0, 0.0, 0.0), changes=0.0, target_frd_mps2=(0.1, 0.0, -0.9), surprise=8.24)
    noticed = changed(surprising, changes=1.0, sigma_frd_mps2=(0.1, 0.1, 5.0))  # the bound is widened at once
    silent = changed(noticed, target_frd_mps2=math.nan)
    lines = told(*before, *[surprising] * 8, noticed, noticed, silent, *[silent] * 50)
    assert lines[1:] == [(132, "learner: sudden change noticed on z (8.2 sigma)", "warning")]


def test_a_second_change_is_told_too_and_a_new_start_is_no_change() -> None:
    one, two = (knows((0.0, 0.0, 0.0), changes=count) for count in (1.0, 2.0))
    lines = told(one, two, knows((0.0, 0.0, 0.0), changes=0.0), one)
    assert [text for _, text, severity in lines if severity == "warning"] == ["learner: sudden change noticed"] * 3
