"""The certifier in flight: certificates appear, hold the path and the truth, grow, and fall with what they rest on."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
import os
import select
import signal
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from shipped import load_scenario, load_vehicle

from flightstack.barrier.certifier import OnlineCertifier
from flightstack.barrier.certifier_config import CertifierConfig, CertifierState
from flightstack.barrier.design import SafeSet, safe_sets
from flightstack.barrier.file import certificate_to_json
from flightstack.barrier.records import Certificate, area_of
from flightstack.barrier.shapes import value
from flightstack.barrier.torque import governor_terms
from flightstack.cli.workshop import Appointed, Workshop
from flightstack.frames import quat_from_euler
from flightstack.learning.learner import GpLearner
from flightstack.model import Limits, Model
from flightstack.region import Region
from flightstack.scenario import TimedEvent
from flightstack.stack import Stack
from flightstack.types import STANDARD_GRAVITY_MPS2 as G
from flightstack.types import Filtered, Learned, Measurement, changed
from tests.alone import require_one_thread
from tests.closed_loop import ClosedLoopFlight, fly

SCENARIO = load_scenario("paper-barrier")
VERTICAL = CertifierConfig(axes=(2,), slice_only=True)


class Kept(OnlineCertifier):
    """Keeps what it issues."""

    __slots__ = ("issued", "last")

    def step(self, state: CertifierState, *given: object) -> tuple[CertifierState, Certificate | None]:  # type: ignore[override]
        state, certificate = super().step(state, *given)  # type: ignore[arg-type]
        self.last = (state, given)
        if certificate is not None:
            self.issued.append((given[1].t_us, certificate))  # type: ignore[attr-defined]
        return state, certificate


def flight(
    duration_s: float, events: tuple[TimedEvent, ...] = (), elsewhere: Workshop | None = None
) -> tuple[ClosedLoopFlight, Kept]:
    kept: list[Kept] = []

    def make(model: Model, limits: Limits) -> Stack:
        certifier = Kept(
            model,
            limits,
            SCENARIO.region,
            initial=SCENARIO.knowledge,
            config=VERTICAL,
            safe={2: SafeSet(0.6, 1.2)},  # type: ignore[arg-type]
            elsewhere=elsewhere,
        )
        certifier.issued = []
        kept.append(certifier)
        return Stack(model, limits, learner=GpLearner(model), certifier=certifier)

    scenario = dataclasses.replace(SCENARIO, duration_s=duration_s, events=events)
    return fly(scenario, load_vehicle("quad-x"), make_stack=make), kept[0]


@pytest.fixture(scope="module")
def calm() -> tuple[ClosedLoopFlight, Kept]:
    return flight(10.0)


def test_certificates_appear_soon_grow_and_hold_the_path(calm: tuple[ClosedLoopFlight, Kept]) -> None:
    flown, kept = calm
    times, certificates = zip(*kept.issued, strict=True)
    assert times[0] - flown.records[0].t_us < 6_000_000
    areas = [area_of(each) for each in certificates]
    assert all(later > 1.02 * sooner for sooner, later in itertools.pairwise(areas))
    assert [each.version for each in certificates] == sorted({each.version for each in certificates})
    down = certificates[-1].axes[0]
    for t in np.linspace(0.0, 8.0, 200):
        point = SCENARIO.trajectory.at(t)
        assert value(down.barrier, float(point.pos_ned_m[2]) + 0.8, float(point.vel_ned_mps[2])) > 0.0


def test_true_braking_and_acceleration_lie_within_every_certificate(calm: tuple[ClosedLoopFlight, Kept]) -> None:
    _, kept = calm
    for _, certificate in kept.issued:
        table, box = certificate.axes[0].authority, certificate.budget
        for thrust, middle, error in (
            (box.high_mps2, table.u_low_mps2, table.error_low_mps2),
            (box.low_mps2, table.u_high_mps2, table.error_high_mps2),
        ):
            assert (np.abs(G - thrust / 1.4 - middle) <= error).all()


def test_a_dropped_payload_falsifies() -> None:
    _, kept = flight(10.0, (TimedEvent(6.0, "payload", (("mass_kg", -0.35),)),))
    reasons = [each.knowledge["falsified"] for _, each in kept.issued if "falsified" in each.knowledge]
    assert reasons
    at = next(i for i, (_, each) in enumerate(kept.issued) if "falsified" in each.knowledge)
    marked, before = kept.issued[at][1], kept.issued[at - 1][1]
    assert marked.version > before.version
    assert marked.knowledge["hand_over"] or area_of(marked) < area_of(before)


def test_an_acceleration_beyond_its_bound_hands_over(calm: tuple[ClosedLoopFlight, Kept]) -> None:
    _, kept = calm
    state, (learner, measurement, learned, _) = kept.last
    assert isinstance(measurement, Measurement)
    assert isinstance(learned, Learned)
    off = changed(measurement, specific_force_frd_mps2=measurement.specific_force_frd_mps2 + np.array([0.0, 0.0, 3.0]))
    issued = None
    for _tick in range(400):
        off = dataclasses.replace(off, t_us=off.t_us + 4000)
        state, issued = OnlineCertifier.step(kept, state, learner, off, learned, Filtered.nothing())  # type: ignore[arg-type]
        if issued is not None:
            break
    assert issued is not None
    assert "down: acceleration off by" in str(issued.knowledge["falsified"])
    assert state.widen_mps2[2] > 0.5


@pytest.mark.parametrize(
    ("beyond", "rate_radps", "engaged", "is_taken"),
    [(-1.0, 0.0, True, True), (0.01, 0.0, True, False), (-0.02, 1.5, True, False), (-0.02, -0.2, True, True),
     (0.01, 0.0, False, True)],
)  # fmt: skip
def test_an_engaged_filter_is_given_no_certificate_in_the_midst_of_a_lean_that_it_does_not_allow(
    calm: tuple[ClosedLoopFlight, Kept], beyond: float, rate_radps: float, engaged: bool, is_taken: bool
) -> None:
    """Nor where it turns too fast to be stopped within; a filter that is not engaged waits for its lean."""
    _, kept = calm
    before, (_, measurement, _, _) = kept.last
    assert isinstance(measurement, Measurement)
    governor = governor_terms(load_vehicle("quad-x"), kept.model, kept.limits, (1e-3, 1e-3, 7e-4))
    ready = dataclasses.replace(kept.issued[-1][1], governor=governor)
    assert ready.premises is not None
    lean = max(ready.premises.leans[0][1] + beyond, 0.0)
    state = CertifierState(origin_ned_m=before.origin_ned_m)
    leaning = changed(
        measurement, q_ned_frd=quat_from_euler(0.0, math.asin(lean), 0.0),
        rate_frd_radps=np.array([0.0, rate_radps, 0.0]),
    )  # fmt: skip
    assert (OnlineCertifier._judge(kept, state, ready, leaning, engaged) is ready) == is_taken


# ---------------------------------------------------------------- in a process of its own


@pytest.fixture(scope="module")
def shop() -> Iterator[Workshop]:
    with Workshop() as each:
        yield each


def ready(shop: Workshop, work: Iterator[Certificate | None]) -> Certificate | None:
    """What comes of the work; None where nothing will."""
    for certificate in work:
        if certificate is not None or shop.lost:
            return certificate
        select.select([shop], [], [], 60.0)
    return None


def test_another_process_makes_the_very_same_certificate(calm: tuple[ClosedLoopFlight, Kept], shop: Workshop) -> None:
    """One that nobody waits for any more (the bounds were falsified meanwhile) does not come in place of the next."""
    _, kept = calm
    _, (learner, _, learned, _) = kept.last
    certifier = OnlineCertifier(
        kept.model, kept.limits, kept.region, initial=kept.initial, config=kept.config, safe=kept.safe
    )
    here, there, other = CertifierState(version=4), CertifierState(version=4), CertifierState(version=8)
    expected = list(certifier.work(learner, learned, here))[-1]  # type: ignore[arg-type]
    assert expected is not None
    assert next(shop.work(certifier, learner, learned, other)) is None  # type: ignore[arg-type]
    made = ready(shop, shop.work(certifier, learner, learned, there))  # type: ignore[arg-type]
    assert made is not None
    assert made.version == 5
    assert certificate_to_json(made) == certificate_to_json(expected)
    assert there.ratios == here.ratios != {}
    assert shop.pid is not None
    assert os.getpriority(os.PRIO_PROCESS, shop.pid) > os.getpriority(os.PRIO_PROCESS, 0)  # the flight comes first


def test_a_flight_certifies_while_another_process_does_the_work(shop: Workshop) -> None:
    """How soon depends on the machine (this flight waits for nobody), what is certified is true all the same."""
    shop.count_anew()
    flown, kept = flight(40.0, elsewhere=shop)
    assert not shop.lost
    assert kept.issued
    assert kept.issued[0][0] > flown.records[0].t_us
    recorded = Workshop()
    recorded.again(shop.served)
    _, again = flight(40.0, elsewhere=recorded)  # in one process, each answer at the tick at which it came
    assert [t_us for t_us, _ in again.issued] == [t_us for t_us, _ in kept.issued]
    assert [certificate_to_json(each) for _, each in again.issued] == [
        certificate_to_json(each) for _, each in kept.issued
    ]
    test_true_braking_and_acceleration_lie_within_every_certificate((flown, kept))


def test_a_process_that_can_t_be_started_is_one_that_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: object) -> None:
        raise OSError(12, "Cannot allocate memory")

    monkeypatch.setattr("multiprocessing.context.SpawnProcess.start", refused)
    with Workshop() as lost:
        assert "could not be started: [Errno 12]" in lost.lost


@pytest.mark.parametrize("how", ["killed", "at fault"])
def test_a_process_that_is_lost_takes_nothing_with_it(calm: tuple[ClosedLoopFlight, Kept], how: str) -> None:
    _, kept = calm
    _, (learner, measurement, learned, filtered) = kept.last
    with Workshop() as lost:
        certifier = OnlineCertifier(
            kept.model, kept.limits, kept.region, initial=kept.initial, config=kept.config, safe=kept.safe,
            elsewhere=lost,
        )  # fmt: skip
        if how == "killed":
            assert lost.pid is not None
            os.kill(lost.pid, signal.SIGKILL)
            work = lost.work(certifier, learner, learned, CertifierState())  # type: ignore[arg-type]
        else:
            work = lost.work(certifier, learner, None, CertifierState())  # type: ignore[arg-type]
        assert ready(lost, work) is None
        assert ("ended" if how == "killed" else "AttributeError") in lost.lost
        state = certifier.init()
        for _ in range(3):  # in flight nothing raises, and nothing is waited for
            state, issued = certifier.step(state, learner, measurement, learned, filtered)  # type: ignore[arg-type]
            assert issued is None


class Idle:
    """Works elsewhere, and nothing ever comes of it."""

    def __init__(self, lost: str) -> None:
        self.lost = lost
        self.served: tuple[tuple[int, int, int], ...] = ()

    def count_anew(self) -> None:
        """Nothing is counted."""

    def work(self, *_: object) -> Iterator[None]:
        return itertools.repeat(None)


@pytest.mark.parametrize(("lost", "least_s", "most_s"), [("its process has ended", 0.0, 0.01), ("", 1.4, 1.6)])
def test_a_falsified_certificate_does_not_wait_for_one_that_never_comes(
    calm: tuple[ClosedLoopFlight, Kept], lost: str, least_s: float, most_s: float
) -> None:
    _, kept = calm
    _, (learner, measurement, learned, filtered) = kept.last
    assert isinstance(measurement, Measurement)
    certifier = OnlineCertifier(
        kept.model, kept.limits, kept.region, initial=kept.initial, config=kept.config, safe=kept.safe,
        elsewhere=Idle(lost),
    )  # fmt: skip
    state = certifier.init()
    state.certificate, state.falsified = kept.issued[-1][1], "down: acceleration off by 2.0 m/s^2"
    for tick in range(1000):
        now = dataclasses.replace(measurement, t_us=measurement.t_us + 4000 * tick)
        state, issued = certifier.step(state, learner, now, learned, filtered)  # type: ignore[arg-type]
        if issued is not None:
            break
    assert issued is not None
    assert issued.knowledge["hand_over"]
    assert issued.axes == kept.issued[-1][1].axes
    assert least_s <= 0.004 * tick <= most_s


def test_an_ellipsoids_safe_sets_lie_in_it_together() -> None:
    region = Region("ellipsoid", (0.0, 0.0, -0.8), (0.4, 0.4, 0.6), (0.5, 0.5, 0.4))
    sets, rng = safe_sets(region, (0, 1, 2)), np.random.default_rng(0)
    for _ in range(200):
        angle = rng.uniform(0.0, 2.0 * np.pi, 3)
        pos = np.array([sets[i].limit_m * np.cos(angle[i]) for i in range(3)])
        vel = np.array([(sets[i].limit_mps or 0.0) * np.sin(angle[i]) for i in range(3)])
        assert region.value(pos + np.array([0.0, 0.0, -0.8]), vel) >= -1e-12


# ---------------------------------------------------------------- at a tick that is appointed


@pytest.mark.parametrize("beside", [True, False])
@pytest.mark.parametrize(("in_force", "falsified", "ticks"), [(False, "", 125), (True, "", 250), (True, "why", 125)])
def test_in_lockstep_the_very_same_certificate_comes_at_its_appointed_tick_whoever_made_it(
    calm: tuple[ClosedLoopFlight, Kept], beside: bool, in_force: bool, falsified: str, ticks: int
) -> None:
    """And not one that was given up before it: what is learned after the order counts for neither."""
    _, kept = calm
    _, (learner, _, learned, _) = kept.last
    asked: tuple[Any, ...] = (kept.here(), learner.evidence(), learned)  # type: ignore[attr-defined]
    here, there = CertifierState(version=4), CertifierState(version=4, falsified=falsified)
    there.certificate = kept.issued[-1][1] if in_force else None
    expected = list(OnlineCertifier.work(*asked, here))[-1]
    assert expected is not None
    if beside:
        require_one_thread()
    appointed = Appointed()
    with appointed if beside else contextlib.nullcontext():
        assert (appointed.process.lost == "") == beside
        assert next(appointed.work(*asked, CertifierState(version=8))) is None
        while beside and not select.select([appointed.process], [], [], 0.1)[0]:
            appointed.process.push()
        came = list(itertools.islice(appointed.work(*asked, there), ticks + 2))
    assert [i for i, each in enumerate(came) if each is not None] == [ticks]
    assert certificate_to_json(came[ticks]) == certificate_to_json(expected)  # type: ignore[arg-type]
    assert there.ratios == here.ratios != {}
    assert appointed.lost == ""


@pytest.mark.parametrize("beside", [True, False])
def test_in_lockstep_a_certifier_at_fault_is_lost_at_the_appointed_tick(
    calm: tuple[ClosedLoopFlight, Kept], beside: bool
) -> None:
    _, kept = calm
    _, (learner, _, _, _) = kept.last
    if beside:
        require_one_thread()
    appointed = Appointed()
    with appointed if beside else contextlib.nullcontext():
        work = appointed.work(kept, learner, None, CertifierState())  # type: ignore[arg-type]
        assert [next(work) for _ in range(125)] == [None] * 125
        assert appointed.lost == ""
        assert next(work) is None
    assert "AttributeError" in appointed.lost
    assert next(work) is None
