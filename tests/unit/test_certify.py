"""What `certify` makes of an exploration: its figures, its page, its files; no flight here."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from axis_certificates import axis_of, certificate_of
from barriers import in_kernel
from measured import measured
from shipped import load_scenario, load_vehicle

from flightstack.barrier.file import certificate_to_json
from flightstack.barrier.growing import VERTICAL, GrowingCertifier, GrowthState
from flightstack.barrier.records import Certificate, Margin
from flightstack.barrier.shapes import Quadratic, Stopping, value
from flightstack.certificate_check import check
from flightstack.cli.barrier_score import WatchedCertifier
from flightstack.cli.certified import counted_mps2
from flightstack.cli.certify import CERTIFICATE, CertifyResult, ExplorationPlanner, write_certificate
from flightstack.cli.result import NO_GP, NO_LOOP, FlightResult
from flightstack.explore import FALSIFIED, ExploreConfig, Explorer, Round
from flightstack.learning.learner import GpLearner, LearnerState, Learnt
from flightstack.mission import Mission, plan
from flightstack.model import Model
from flightstack.seams import NoCertifier
from flightstack.types import Command, Filtered, FlatOutput, Learned, Measurement, Proposal, TickRecord
from flightstack_logs.report.certified import ExplorationPage, kernel_outline, render
from flightstack_logs.report.phase_plane import boundary
from flightstack_logs.report.plot import Plot, ticks
from flightstack_logs.report.words import KeyFigure

SLOW, FAST = Stopping(-0.4, 0.4, 0.2, 0.8, 2.0), Stopping(-0.5, 0.5, 0.2, 1.2, 3.0)


# ------------------------------------------------------------------ figures


@pytest.mark.parametrize(("doubt", "mu"), [(0.05, 0.6054), (0.1, 0.6166), (0.2, 0.6403), (0.3, 0.6659), (0.5, 0.7237)])
def test_counted_braking_gives_the_mu_that_physics_allows_for_named_margins(doubt: float, mu: float) -> None:
    """The table of the vertical experiment: 1.8/1.4 g of thrust, |e| <= 0.6 m, so much taken from it."""
    axis = axis_of(FAST, error_mps2=0.5 * doubt, slope_ps=0.0, u_mps2=((1.0 - 1.8 / 1.4) * 9.81, 9.81))
    axis = replace(axis, margins=(Margin("gp_error", 9.0, "counted in the bound"), Margin("delay", 0.5 * doubt, "")))
    low, high = counted_mps2(axis)
    assert 1.0 / (0.6 * -low) == pytest.approx(mu, abs=1e-4)
    assert high == pytest.approx(9.81 - doubt)


def test_the_worst_speed_of_the_region_counts() -> None:
    axis = axis_of(FAST, error_mps2=0.1, slope_ps=0.5)
    fastest = max(abs(v) for v in FAST.box[2:])
    low, _ = counted_mps2(axis)
    assert low == pytest.approx(-2.6 + 0.1 + 0.5 * fastest + 0.1, abs=0.11)  # the larger error of a node's two sides


# ------------------------------------------------------------------ planner


def _record(mission: Mission, t_s: float) -> TickRecord:
    reference = mission.reference(t_s)
    still = measured(
        round(1e6 * t_s), reference.pos_ned_m, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3),
        np.full(4, np.nan), 0, 0, 0,
    )  # fmt: skip
    proposal, command = Proposal(0.0, np.zeros(20)), Command(round(1e6 * t_s), 0.0, 0.0, np.zeros(3))
    return TickRecord(round(1e6 * t_s), reference, still, proposal, Learned.nothing(), command, False, "")


def _flown(planner: ExplorationPlanner, mission: Mission, until_s: float) -> tuple[Mission, list[FlatOutput]]:
    points = []
    for k in range(round(until_s / 0.02)):
        t_s = 0.02 * k
        points.append(mission.reference(t_s))
        mission = planner.step(mission, t_s, _record(mission, t_s))
        if mission.phase(t_s + 1e-9) == "done":
            break
    return mission, points


def test_the_planner_begins_on_the_track_and_flies_leg_after_leg_without_a_step() -> None:
    scenario = load_scenario("hover")
    mission = plan(scenario, np.zeros(3))
    watched = WatchedCertifier(NoCertifier())
    watched.adopted.append(certificate_of(axis_of(FAST)))
    planner = ExplorationPlanner(Explorer(ExploreConfig(rounds_max=2, axes=(2,), identify_first=1)), watched)
    assert planner.step(mission, mission.track_start_s - 0.01, _record(mission, 0.0)) is mission
    assert planner.state is None
    mission, points = _flown(planner, mission, 60.0)
    assert planner.state is not None
    assert "2 rounds were flown" in planner.state.ended
    position = np.array([p.pos_ned_m for p in points])
    velocity = np.array([p.vel_ned_mps for p in points])
    assert np.abs(np.diff(position, axis=0) - 0.02 * velocity[:-1]).max() < 2e-3  # no step: it moves as it says
    assert 0.2 < np.abs(velocity[:, 2]).max() < 2.0
    assert mission.phase(mission.track_end_s) == "done"


def test_a_falsified_certificate_ends_the_exploration_and_lands() -> None:
    scenario = load_scenario("hover")
    mission = plan(scenario, np.zeros(3))
    watched = WatchedCertifier(NoCertifier())
    planner = ExplorationPlanner(Explorer(), watched)
    mission, _ = _flown(planner, mission, mission.track_start_s + 2.0)
    t_s = mission.track_start_s + 2.0
    watched.adopted.append(certificate_of(axis_of(FAST), **{FALSIFIED: "seen beyond its bound"}))
    after = planner.step(mission, t_s, _record(mission, t_s))
    assert after.phase(t_s) == "done"
    assert planner.state is not None
    assert planner.state.failed


class _Widening:
    """A certifier that every tick widens what it doubts, and a learner's bound, as a landing does which others fly."""

    enabled = True

    def __init__(self, state: GrowthState) -> None:
        self.state = state

    def init(self) -> GrowthState:
        return self.state

    def step(
        self, state: GrowthState, learner: object, measurement: Measurement, learned: Learned, filtered: Filtered
    ) -> tuple[GrowthState, None]:
        state.inner.widen_mps2 = state.inner.widen_mps2 + 1.0
        assert isinstance(learner, LearnerState)
        learner.vertical.excess += 1.0
        return state, None


def test_what_a_landing_contradicts_does_not_count_for_what_was_explored() -> None:
    scenario = load_scenario("paper-barrier")
    model = Model.from_vehicle(load_vehicle("quad-x"))
    assert scenario.region is not None
    state = GrowingCertifier(model, scenario.limits, scenario.region, certifier=VERTICAL).init()
    watched, still = WatchedCertifier(_Widening(state)), _record(plan(load_scenario("hover"), np.zeros(3)), 0.0)
    watched.init()
    learns = GpLearner(model).init()
    arguments = (learns, still.measurement, still.learned, still.filtered)
    watched.step(state, *arguments)
    explored = learns.vertical.excess.copy()
    watched.look_away()
    watched.step(state, *arguments)
    assert watched.seen is not None
    kept, learner, _ = watched.seen
    assert isinstance(kept, GrowthState)
    assert isinstance(learner, Learnt)
    np.testing.assert_array_equal(learner.vertical.excess, explored)
    np.testing.assert_array_equal(learns.vertical.excess, explored + 1.0)
    assert kept.inner.widen_mps2.tolist() == [1.0, 1.0, 1.0]
    assert state.inner.widen_mps2.tolist() == [2.0, 2.0, 2.0]


# ------------------------------------------------------------------ files


def test_nothing_is_announced_that_the_checker_refuses(tmp_path: Path) -> None:
    handmade = certificate_of(axis_of(FAST))
    assert not check(certificate_to_json(handmade)).valid
    path, lines = write_certificate([handmade], tmp_path / CERTIFICATE)
    assert path is None
    assert lines
    assert not (tmp_path / CERTIFICATE).exists()
    assert (tmp_path / "refused.json").exists()


def test_a_falsified_certificate_is_not_written(tmp_path: Path) -> None:
    path, lines = write_certificate([certificate_of(axis_of(FAST), **{FALSIFIED: "so"})], tmp_path / CERTIFICATE)
    assert (path, lines) == (None, [])


# ------------------------------------------------------------------ page


class _Tags(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.wrong: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)


def _exploration(**changes: object) -> ExplorationPage:
    path = np.zeros((200, 6))
    path[:, 2], path[:, 5] = 0.2 * np.sin(np.linspace(0.0, 6.0, 200)), 0.3 * np.cos(np.linspace(0.0, 6.0, 200))
    certificates: tuple[Certificate, ...] = (certificate_of(axis_of(SLOW)), certificate_of(axis_of(FAST), version=2))
    rounds = (Round(2, 5.0, 1, 1.0, 0.4, (0.1, 0.3), (0.2, 0.5)), Round(2, 9.0, 2, 1.5, 0.3, None, None))
    made = ExplorationPage(
        "a <b> flight", True, "it & ended", (KeyFigure("Area", "1.5", "of <2>"),), certificates, rounds, path,
        (0.6, -2.0, 8.0), ("seal: fits",),
    )  # fmt: skip
    return replace(made, **changes)  # type: ignore[arg-type]


_FLOWN = FlightResult(
    scenario="a", seed=0, log=None, completed=True, reason="", flight_time_s=300.0, wall_time_s=1.0, clock_time_s=300.0,
    plant="native", controller="flatness", tracking={}, gp=NO_GP, loop=NO_LOOP,
)  # fmt: skip


@pytest.mark.parametrize(
    ("ended", "words"), [("", "its time was up, after 300 s"), ("down: all of it", "down: all of it")]
)
def test_how_an_exploration_ended_is_never_left_out(ended: str, words: str) -> None:
    state = replace(Explorer().init(0.0, np.zeros(3)), ended=ended)
    result = CertifyResult(_FLOWN, state, None, None, 0.0, as_published=False, span_us=(5_000_000, 305_000_000))
    assert result.words == words


def test_the_page_is_whole_escaped_and_needs_nothing_from_outside() -> None:
    text = render(_exploration())
    tags = _Tags()
    tags.feed(text)
    assert not tags.wrong
    assert not tags.open
    assert not tags.links
    assert "<b>" not in text
    assert "a &lt;b&gt; flight" in text
    assert "made up &lt;&amp;&gt;" in text  # the ledger's words
    assert text.count("<svg") == 4  # regions, cover, growth, bound
    for words in ("gp error", "delay", "viability kernel", "seal: fits", "first region", "final region"):
        assert words in text


def test_growth_ends_at_what_the_headline_says() -> None:
    """What the flight's data gave after landing is the last mark; without it the last round is."""
    assert re.findall(r"<title>(?:round|after).*?</title>", render(_exploration(settled=(3.007, 0.2)))) == [
        "<title>round 1: 1.000</title>", "<title>round 2: 1.500</title>", "<title>after landing: 3.007</title>",
        "<title>round 1: 0.400</title>", "<title>round 2: 0.300</title>", "<title>after landing: 0.200</title>",
    ]  # fmt: skip
    assert "after landing" not in render(_exploration())


def test_a_page_without_rounds_cells_or_path_still_comes_out() -> None:
    bare = replace(axis_of(FAST), cells=np.zeros((0, 6)))
    text = render(_exploration(certificates=(certificate_of(bare),), rounds=(), path=np.zeros((0, 6)), kernel=None))
    assert "no round was flown" in text
    assert "No cells" in text


def test_outlines_lie_on_their_boundaries() -> None:
    for e, v in boundary(Quadratic(0.0, -0.1, 3.0, 0.4, 1.2)):
        assert value(Quadratic(0.0, -0.1, 3.0, 0.4, 1.2), float(e), float(v)) == pytest.approx(0.0, abs=1e-6)
    for e, v in kernel_outline(0.6, -2.0, 8.0)[1:-1:7]:
        assert in_kernel(float(e), float(0.999 * v), -0.6, 0.6, -2.0, 8.0)
        assert abs(v) < 1e-9 or not in_kernel(float(e), float(1.001 * v), -0.6, 0.6, -2.0, 8.0)


def test_ticks_are_round_and_inside() -> None:
    assert ticks(-0.62, 0.62) == pytest.approx([-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6])
    assert ticks(0.0, 30.0) == pytest.approx([0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0])


def test_a_plot_draws_up_as_up_and_leaves_out_what_is_not_finite() -> None:
    plot = Plot((0.0, 1.0), (0.0, 2.0), ("x", "y"), "t")
    assert plot.y(2.0) < plot.y(0.0)
    assert plot.x(1.0) > plot.x(0.0)
    plot.line(np.array([[0.0, 0.0], [np.nan, 1.0], [1.0, 2.0]]), "flown")
    assert len(re.findall(r"M[\d. ]+", plot.svg().split('class="flown"')[1].split("/>")[0].split(">")[0])) == 2
