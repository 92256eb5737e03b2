"""The report's section on learning: what it takes from a log, what it computes, what it draws."""

from __future__ import annotations

import base64
import dataclasses
import math
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flightstack.cli.result import NO_GP
from flightstack.model import Model
from flightstack.types import STANDARD_GRAVITY_MPS2
from flightstack.vehicle import parse_vehicle
from flightstack_logs.reader import Log, read
from flightstack_logs.report import learning, signals
from flightstack_logs.report.flight import FlightEvent, FlightReport, LearnerOutcome, Learning, Outcome, ReportSamples
from flightstack_logs.report.log_input import from_log
from flightstack_logs.report.page import render_report
from flightstack_logs.report.panel import Panel
from flightstack_logs.report.result import outcome_from_result
from flightstack_logs.topics import TOPICS, Attachment
from flightstack_logs.writer import FlightLog

ROOT = Path(__file__).parents[2]
VEHICLE = (ROOT / "flightstack/data/vehicles" / "quad-x.toml").read_text()
MODEL = Model.from_vehicle(parse_vehicle(VEHICLE, "quad-x"))
NO_ERROR = Panel("error-distance", "Tracking error", "m", 3, ())
HEAVY = 0.4 * STANDARD_GRAVITY_MPS2


def _row(topic: str, **values: Any) -> tuple[Any, ...]:
    blank = {"string": "", "bool": False}
    zeros = {f.name: [blank.get(f.type, 0)] * f.size if f.size else blank.get(f.type, 0) for f in TOPICS[topic].fields}
    return tuple((zeros | values).values())


def write_hover(path: Path, *, truth: bool = True, expected_z: float = HEAVY, rows: int = 2000) -> Log:
    """Hover at 100 rows a second with 1.4 times the believed mass, first on the ground; measured noise 0.5."""
    rng = np.random.default_rng(0)
    log = FlightLog.open(path, metadata={}, attachments=[Attachment("vehicle.toml", "", VEHICLE.encode())])
    norm = MODEL.norm_of(1.4 * MODEL.weight_n)
    for k in range(rows):
        t_us = 10_000 * k
        if truth:
            ground = {"on_ground": t_us < 1_000_000}
            force = [0.0, 0.0, -STANDARD_GRAVITY_MPS2]
            hover = {"specific_force_frd_mps2": force, "motor_u": [norm] * 4, "q_ned_frd": [1.0, 0.0, 0.0, 0.0]}
            log.write("/truth", t_us, _row("/truth", **hover, **ground))
        target = [0.0, 0.0, HEAVY] + 0.5 * rng.normal(size=3) if k % 2 else [math.nan] * 3
        says = {
            "residual_frd_mps2": [0.0, 0.0, expected_z], "sigma_frd_mps2": [0.1, 0.1, 0.2], "stage": min(k // 100, 3),
            "target_frd_mps2": target, "thrust_gain": 1 / 1.4, "thrust_gain_sigma": 0.01, "confidence": 0.9,
        }  # fmt: skip
        log.write("/learner", t_us, _row("/learner", **says))
    log.close()
    assert log.failed is None, log.failed
    return read(path)


def known(signal: ReportSamples | None) -> ReportSamples:
    assert signal is not None
    return signal


# ---------------------------------------------------------------- from a log


def test_a_log_gives_what_was_expected_its_bound_and_what_was_true_in_the_air(tmp_path: Path) -> None:
    seen = from_log(write_hover(tmp_path / "f.mcap")).learning
    assert seen is not None
    np.testing.assert_allclose(seen.bound_frd_mps2.values[0], [0.3, 0.3, 0.6])
    truth = known(seen.truth_frd_mps2)
    assert np.isnan(truth.values[:100]).all()
    np.testing.assert_allclose(truth.values[100:], np.tile([0.0, 0.0, HEAVY], (1900, 1)), atol=1e-9)
    assert known(seen.thrust_gain_bound).values[0, 0] == pytest.approx(0.03)


def test_a_log_without_learner_has_no_such_section_and_one_without_truth_has(tmp_path: Path) -> None:
    assert 'id="learning"' not in render_report(FlightReport(Outcome()))
    flight = from_log(write_hover(tmp_path / "f.mcap", truth=False))
    assert flight.learning is not None
    assert flight.learning.truth_frd_mps2 is None
    page = render_report(flight)
    assert 'id="learning"' in page
    drawn = {panel.key: panel for panel in learning.panels(flight, NO_ERROR)}
    assert [curve.label for curve in drawn["residual-z"].curves] == ["±3σ", "±3σ", "measured", "expected"]
    assert [curve.label for curve in drawn["surprise-z"].curves] == ["±3σ", "±3σ", "measured − expected"]


@pytest.mark.parametrize(("expected_z", "share"), [(HEAVY + 0.5, 1.0), (HEAVY + 0.7, 0.0)])
def test_without_a_result_coverage_and_held_out_check_are_computed(
    tmp_path: Path, expected_z: float, share: float
) -> None:
    """Three sigma of z are 0.6 m/s^2; noise of 0.5 on every sample is no error of the learner.  Held out is half of
    the windows of 15; to promise 99.73 % takes 370 scores in the other half: 80 s with a target in every other row."""
    log = write_hover(tmp_path / "f.mcap", expected_z=expected_z, rows=8000)
    flight = learning.with_measured_honesty(from_log(log))
    learner = flight.outcome.learner
    assert learner is not None
    assert learner.coverage_axes == pytest.approx((1.0, 1.0, share))
    assert learner.coverage == pytest.approx((2.0 + share) / 3.0)
    assert learner.coverage_simultaneous == pytest.approx(share)
    assert learner.conformal is not None
    mean_noise = 0.5 / math.sqrt(15.0)
    of_a_window, off = math.hypot(0.2, mean_noise), expected_z - HEAVY
    assert off / of_a_window < learner.conformal.quantile_sigma < (off + 3.5 * mean_noise) / of_a_window


def test_what_the_result_says_stands(tmp_path: Path) -> None:
    said = NO_GP | {"enabled": True, "coverage_3sigma": 0.5, "coverage_3sigma_axes": [0.1, 0.2, None]}
    flight = from_log(write_hover(tmp_path / "f.mcap"), {"gp": said})
    learner = learning.with_measured_honesty(flight).outcome.learner
    assert learner is not None
    assert (learner.coverage, learner.coverage_axes) == (0.5, (0.1, 0.2, None))


@pytest.mark.parametrize(
    "gp", [{}, {"enabled": None}, {"enabled": True, "conformal": {"alpha": 0.01}, "step_us": 3, "points": "many"}]
)
def test_a_result_that_says_little_or_nonsense_is_no_error(gp: dict[str, object]) -> None:
    learner = outcome_from_result({"gp": gp}).learner
    assert learner is None or (learner.conformal, learner.points, learner.step_p50_us) == (None, None, None)


# ---------------------------------------------------------------- figures and words


class Text(HTMLParser):
    """The texts of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.text = ""
        self.feed(html)

    def handle_data(self, data: str) -> None:
        self.text += data + "\n"


def test_coverage_held_out_check_gain_points_and_step_are_told(tmp_path: Path) -> None:
    gp = {
        "enabled": True, "points": 300, "fed": 15000, "step_us": {"p50": 12.0, "p99": 30.0, "max": 99.0},
        "coverage_3sigma": 0.9974, "coverage_3sigma_axes": [0.99, 1.0, 0.9999], "coverage_simultaneous": 0.991,
        "conformal": {"quantile_sigma": 3.14, "coverage_heldout": 0.995, "alpha": 0.0027}, "thrust_gain": 0.7141,
        "changes": 2,
    }  # fmt: skip
    text = Text(render_report(from_log(write_hover(tmp_path / "f.mcap"), {"gp": gp}))).text
    for said in (
        "99.7 %", "x 99.0, y 100.0, z 99.99", "99.1 %", "3.1 sigma", "held 99.7 % of the windows",
        "then 99.5 %", "0.714", "of 15000 samples", "12 µs", "p99 30 µs",
    ):  # fmt: skip
        assert said in text, said


def test_a_share_never_claims_a_whole_that_is_not() -> None:
    assert [learning.share(value) for value in (1.0, 0.99996, 0.9994, 0.995, 0.5, 0.0)] == [
        "100.0 %", "99.99 %", "99.94 %", "99.5 %", "50.0 %", "0.0 %",
    ]  # fmt: skip


# ---------------------------------------------------------------- panels


def flight_of(**changes: Any) -> FlightReport:
    """10 s of a residual of 1 m/s^2 along every axis, expected as 1.1, bound 0.3."""
    t = np.arange(0.0, 10.0, 0.004)
    ones = np.ones((len(t), 3))
    stage = ReportSamples(t, np.repeat([0.0, 1.0, 2.0, 3.0], len(t) // 4)[:, None])
    learned = Learning(
        ReportSamples(t, 1.1 * ones), ReportSamples(t, 0.3 * ones), stage, ReportSamples(t, ones),
        ReportSamples(t, ones),
        ReportSamples(t, ones[:, :1]), ReportSamples(t, 0.1 * ones[:, :1]), ReportSamples(t, ones[:, :1]),
    )  # fmt: skip
    return FlightReport(Outcome(learner=LearnerOutcome(True)), learning=dataclasses.replace(learned, **changes))


def drawn_of(flight: FlightReport) -> dict[str, Panel]:
    return {panel.key: panel for panel in learning.panels(flight, NO_ERROR)}


def test_the_band_stands_round_what_was_expected() -> None:
    upper, lower, *_, expected = drawn_of(flight_of())["residual-x"].curves
    assert (upper.edge, lower.edge, expected.label) == ("upper", "lower", "expected")
    np.testing.assert_allclose(upper.samples.values, 1.4)
    np.testing.assert_allclose(lower.samples.values, 0.8)


def test_a_prediction_error_counts_from_when_something_is_learned_on() -> None:
    *_, away = drawn_of(flight_of())["surprise-y"].curves
    assert np.isnan(away.samples.values[away.samples.t_s < 5.0]).all()
    np.testing.assert_allclose(away.samples.values[away.samples.t_s >= 5.0], -0.1, atol=1e-12)


def test_a_moments_peak_does_not_take_the_scale_and_is_said_to_be_cut() -> None:
    t = np.arange(0.0, 10.0, 0.004)
    truth = np.ones((len(t), 3))
    truth[2000:2005] = 50.0
    panel = drawn_of(flight_of(truth_frd_mps2=ReportSamples(t, truth)))["surprise-z"]
    assert panel.cut is not None
    assert 0.3 < panel.cut[1] < 0.5
    assert panel.note == "peaks are cut"
    assert drawn_of(flight_of())["surprise-z"].note == ""


def test_noticed_changes_are_marked_in_every_panel() -> None:
    events = (FlightEvent(3.0, "learner", "learner: used"), FlightEvent(7.0, "learner", "a change", "warning"),
              FlightEvent(8.0, "mode", "lost", "warning"))  # fmt: skip
    flight = dataclasses.replace(flight_of(), events=events)
    assert {tuple(mark.t_s for mark in panel.marks) for panel in learning.panels(flight, NO_ERROR)} == {(7.0,)}


def test_the_strip_names_the_stages_in_their_order() -> None:
    strip = drawn_of(flight_of())["confidence"].strip
    assert [span.label for span in strip] == ["nothing learned", "calculable", "valid", "used"]
    np.testing.assert_allclose([span.start_s for span in strip], [0.0, 2.5, 5.0, 7.5], atol=0.004)
    np.testing.assert_allclose([span.end_s for span in strip], [2.5, 5.0, 7.5, 10.0], atol=0.01)


def test_a_stage_that_flickers_becomes_no_thousand_spans() -> None:
    t = np.arange(0.0, 100.0, 0.004)
    stage = ReportSamples(t, ((np.arange(len(t)) // 3) % 2).astype(np.float64)[:, None])
    assert 1 <= len(learning._strip(stage)) <= 500


def test_a_decimated_bands_edges_are_its_outermost() -> None:
    rng = np.random.default_rng(1)
    flight = flight_of()
    assert flight.learning is not None
    t = np.arange(0.0, 40.0, 0.004)
    noise = rng.normal(size=(len(t), 3))
    noisy = dataclasses.replace(
        flight.learning,
        residual_frd_mps2=ReportSamples(t, noise),
        bound_frd_mps2=ReportSamples(t, np.full((len(t), 3), 0.5)),
    )
    panel = drawn_of(dataclasses.replace(flight, learning=noisy))["residual-x"]
    payload: Any = panel.payload()
    upper, lower = (np.frombuffer(base64.b64decode(payload["curves"][i]["y"]), "<f4") for i in (0, 1))
    assert len(upper) == learning.POINTS
    edges = np.array_split(noise[:, 0], learning.POINTS // 2)
    np.testing.assert_allclose(upper[::2], [part.max() + 0.5 for part in edges], rtol=1e-6)
    np.testing.assert_allclose(lower[1::2], [part.min() - 0.5 for part in edges], rtol=1e-6)
    assert (upper[::2] == upper[1::2]).all()


def test_means_over_a_stretch_leave_out_what_is_unknown() -> None:
    t = np.arange(10) * 0.1
    values = np.array([[1.0], [3.0], [math.nan], [5.0], [math.nan], [math.nan], [2.0], [4.0], [6.0], [8.0]])
    mean = signals.mean_over(ReportSamples(t, values), 0.2)
    np.testing.assert_allclose(mean.t_s, [0.1, 0.3, 0.5, 0.7, 0.9])
    np.testing.assert_allclose(mean.values[:, 0], [2.0, 5.0, math.nan, 3.0, 7.0])
