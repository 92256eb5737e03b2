"""Every controller that `--controller` names: its null case, its closed forms, and short flights of all of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from measured import measured as measured_at
from scipy import signal
from shipped import load_scenario, load_vehicle

from flightstack.cli.controllers import CONTROLLERS, build, load_gains
from flightstack.control.attitude import AttitudeGains
from flightstack.control.indi import IndiController
from flightstack.control.observer import FILTER, DisturbanceObserver, ObserverGains, observe
from flightstack.control.pid import CORRECTION_MAX_MPS2, PidController, PidGains
from flightstack.control.px4_position import Px4Controller, Px4Gains
from flightstack.learning.sampler import S_OK, S_TARGET_FRD, SAMPLE
from flightstack.model import Limits, Model
from flightstack.seams import Controller
from flightstack.stack import Stack
from flightstack.trajectory import hover
from flightstack.types import Command, InputError, Learned, Measurement, changed
from flightstack.vehicle import with_effects
from tests.closed_loop import ClosedLoopFlight, fly

QUAD = load_vehicle("quad-x")
MODEL = Model.from_vehicle(QUAD)
LIMITS = Limits()
POINT = hover((0.0, 0.0, -1.0)).at(0.0)
BASELINES = [name for name in CONTROLLERS if name not in ("flatness", "state-gp")]
G = 9.80665


def seen(t_us: int = 0, **changes: object) -> Measurement:
    """Hovering at POINT."""
    still = np.zeros(3)
    at = measured_at(
        t_us, POINT.pos_ned_m, still, np.array([1.0, 0.0, 0.0, 0.0]), still, np.array([0.0, 0.0, -G]), np.zeros(4),
        0, 0, 0,
    )  # fmt: skip
    return changed(at, **changes)


def sent(t_us: int, thrust_n: float = MODEL.weight_n) -> Command:
    return Command(t_us, thrust_n, MODEL.norm_of(thrust_n), np.zeros(3))


def stack_maker(name: str) -> Callable[[Model, Limits], Stack]:
    def make(model: Model, limits: Limits) -> Stack:
        controller, learner = build(name, model, limits)
        return Stack(model, limits, controller=controller, learner=learner)

    return make


def laws() -> dict[str, Controller]:
    return {name: build(name, MODEL, LIMITS)[0] for name in CONTROLLERS}


@pytest.mark.parametrize("name", CONTROLLERS)
def test_at_the_reference_the_command_is_hover_and_stays_so(name: str) -> None:
    stack = stack_maker(name)(MODEL, LIMITS)
    state = stack.init(seen())
    for i in range(1, 500):
        state, command, record = stack.tick(state, seen(4000 * i), POINT, 4000 * i)
    assert record.guard == ""
    assert command.thrust_n == pytest.approx(MODEL.weight_n)
    np.testing.assert_allclose(command.rate_frd_radps, 0.0, atol=1e-9)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_whatever_is_measured_the_proposal_is_finite_and_the_controller_healthy(name: str) -> None:
    rng = np.random.default_rng(7)
    controller, learner = build(name, MODEL, LIMITS)
    state, known = controller.init(0), learner.init()
    for i in range(1, 400):
        q = rng.standard_normal(4)
        measured = seen(
            4000 * i, pos_ned_m=30.0 * rng.standard_normal(3), vel_ned_mps=20.0 * rng.standard_normal(3),
            q_ned_frd=q / np.linalg.norm(q), rate_frd_radps=10.0 * rng.standard_normal(3),
            specific_force_frd_mps2=30.0 * rng.standard_normal(3),
        )  # fmt: skip
        before = sent(4000 * (i - 1), float(rng.uniform(0.0, 25.0)))
        known, learned = learner.step(known, measured, before, POINT)
        state, proposal = controller.step(state, measured, POINT, learned, before, 4000 * i)
        assert np.isfinite(proposal.row).all()
        assert math.isfinite(proposal.thrust_n)
    assert controller.healthy(state)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_controller_that_met_nan_flies_on_with_the_next_good_tick(name: str) -> None:
    stack = stack_maker(name)(MODEL, LIMITS)
    state = stack.init(seen())
    nowhere = changed(POINT, vel_ned_mps=np.full(3, np.nan))
    state, command, record = stack.tick(state, seen(4000), nowhere, 4000)
    assert record.guard
    assert math.isfinite(command.thrust_n)
    deaf = seen(8000, specific_force_frd_mps2=np.full(3, np.nan))
    state, command, _ = stack.tick(state, deaf, POINT, 8000)
    assert np.isfinite([command.thrust_n, *command.rate_frd_radps]).all()
    for i in range(3, 200):
        state, command, record = stack.tick(state, seen(4000 * i), POINT, 4000 * i)
    assert record.guard == ""
    assert command.thrust_n == pytest.approx(MODEL.weight_n, rel=0.01)


def test_the_pd_law_is_its_formula_for_small_errors() -> None:
    """Level and at rest: thrust answers the height's error, the attitude the others'."""
    attitude = AttitudeGains()
    gains = PidGains(integral_xy=0.0, integral_z=0.0)
    controller = PidController(MODEL, LIMITS, attitude, gains)
    error = np.array([0.03, -0.02, 0.05])
    _, proposal = controller.step(
        controller.init(0), seen(4000, pos_ned_m=POINT.pos_ned_m - error), POINT, Learned.nothing(), sent(0), 4000
    )
    acc = error * np.array([gains.bandwidth_xy_radps, gains.bandwidth_xy_radps, gains.bandwidth_z_radps]) ** 2
    np.testing.assert_allclose(proposal.nominal_acc_ned_mps2, acc)
    assert proposal.thrust_n == pytest.approx(MODEL.mass_kg * (G - acc[2]), rel=1e-3)
    tilt = np.array([acc[1], -acc[0]]) / (G - acc[2])  # to fly north the nose goes down, to fly east the right side
    np.testing.assert_allclose(proposal.attitude_error_rad[:2], tilt, rtol=2e-3)
    np.testing.assert_allclose(proposal.rate_fb_frd_radps[:2], attitude.attitude_p_ps * tilt, rtol=2e-3)


@pytest.mark.parametrize("name", ["pid", "px4"])
def test_the_integral_does_not_wind_up_while_thrust_is_at_its_limit(name: str) -> None:
    """Held down for 10 s far below the goal, all thrust asked for; back at the goal there is nothing to undo."""
    controller = laws()[name]
    state, low = controller.init(0), POINT.pos_ned_m + np.array([0.0, 0.0, 5.0])
    for i in range(1, 2500):
        state, proposal = controller.step(
            state, seen(4000 * i, pos_ned_m=low), POINT, Learned.nothing(), sent(4000 * i), 4000 * i
        )
    assert proposal.thrust_n > 1.4 * MODEL.weight_n
    _, proposal = controller.step(state, seen(10**7), POINT, Learned.nothing(), sent(10**7), 10**7)
    assert proposal.thrust_n == pytest.approx(MODEL.weight_n, rel=0.01)


def test_the_integral_adds_up_the_error_over_time_to_its_limit() -> None:
    gains = PidGains(bandwidth_xy_radps=2.0, integral_xy=0.25)
    controller = PidController(MODEL, LIMITS, AttitudeGains(), gains)
    state, beside = controller.init(0), POINT.pos_ned_m - np.array([0.1, 0.0, 0.0])
    means = []
    for i in range(1, 10_001):
        measured = seen(4000 * i, pos_ned_m=beside)
        state, proposal = controller.step(state, measured, POINT, Learned.nothing(), sent(4000 * i), 4000 * i)
        means.append(proposal.nominal_acc_ned_mps2[0])
    assert means[2499] == pytest.approx(0.1 * 2.0**2 + 0.25 * 2.0**3 * 0.1 * 10.0, rel=0.01), "after 10 s"
    assert means[-1] == CORRECTION_MAX_MPS2[0]


def test_the_observers_filter_is_a_second_order_butterworth() -> None:
    """Its step response and that of SciPy's analogue filter; the rate that it keeps is the response's derivative."""
    cutoff, dt, wanted = 8.0, 0.0005, np.array([0.7, -0.3, 2.0])
    state, sample = np.zeros(FILTER), np.zeros(SAMPLE)
    sample[S_OK] = 1.0
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    observe(cutoff, state, sample, upright, dt)  # begins at what it first sees: nothing
    sample[S_TARGET_FRD : S_TARGET_FRD + 3] = wanted
    times = dt * np.arange(1, 2001)
    heard = []
    for _ in times:
        observe(cutoff, state, sample, upright, dt)
        heard.append(state[:6].copy())
    b, a = signal.butter(2, cutoff, analog=True)
    _, response = signal.step((b, a), T=np.append(0.0, times))
    np.testing.assert_allclose(np.array(heard)[:, :3], np.outer(response[1:], wanted), atol=0.01)
    np.testing.assert_allclose(np.array(heard)[:, 3:], np.outer(np.gradient(response, dt)[1:], wanted), atol=0.1)


def test_the_observers_estimate_starts_at_the_first_sample_and_turns_with_the_attitude() -> None:
    state, sample = np.zeros(FILTER), np.zeros(SAMPLE)
    sample[S_TARGET_FRD] = 1.5
    east = np.array([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
    observe(8.0, state, sample, east, 0.004)
    assert not state.any(), "a sample that is not fit is not taken"
    sample[S_OK] = 1.0
    observe(8.0, state, sample, east, 0.004)
    np.testing.assert_allclose(state[:3], [0.0, 1.5, 0.0], atol=1e-12)


def _held(name: str, duration_s: float = 10.0) -> ClosedLoopFlight:
    """Hover with 1.25 times the mass and a twentieth of the weight to the north."""
    scenario = load_scenario("hover").with_duration(duration_s)
    heavy = with_effects(
        QUAD, {"payload": {"mass_kg": 0.3}, "constant_force": {"north_n": 0.6, "east_n": 0.0, "down_n": 0.0}}
    )
    return fly(scenario, QUAD, seed=11, truth=heavy, make_stack=stack_maker(name))


@pytest.mark.parametrize("name", ["pid", "indi", "dob", "px4"])
def test_a_constant_force_and_a_wrong_mass_leave_no_error(name: str) -> None:
    settled = _held(name, 25.0 if name == "pid" else 10.0).errors_m[-1000:]  # pid's integral, as tuned, takes its time
    np.testing.assert_allclose(settled.mean(axis=0), 0.0, atol=0.01)


def test_pd_leaves_the_error_that_its_stiffness_predicts() -> None:
    """d / Kp: a quarter of the weight down, 0.4 m/s^2 north per true mass, both by the believed one."""
    settled = _held("pd").errors_m[-1000:].mean(axis=0)
    gains = load_gains()["pd"].groups[1]
    assert isinstance(gains, PidGains)
    assert settled[2] == pytest.approx(0.25 * G / gains.bandwidth_z_radps**2, rel=0.05)
    tilt = 0.6 / (1.5 * G)  # thrust carries the weight and balances the force
    assert settled[0] == pytest.approx(tilt * 1.25 * G / gains.bandwidth_xy_radps**2, rel=0.1)
    assert abs(settled[1]) < 0.02


def test_the_disturbance_observer_finds_the_force_that_nobody_told() -> None:
    """What is fed forward is d = a - a_model: constant force over the true mass, thrust missing by the mass ratio."""
    flight = _held("dob")
    learned = np.mean([record.learned.acc_ned_mps2 for record in flight.records[-500:]], axis=0)
    north = 0.6 / 1.2  # what balances it per believed kilogram
    np.testing.assert_allclose(learned, [north, 0.0, 0.25 * G], atol=0.08)
    assert flight.records[-1].learned.stage == 3.0
    assert flight.records[0].learned.stage == 0.0, "on the ground nothing is estimated"


def test_px4s_hover_thrust_estimate_finds_the_mass() -> None:
    flight_stack: list[Stack] = []

    def make(model: Model, limits: Limits) -> Stack:
        flight_stack.append(stack_maker("px4")(model, limits))
        return flight_stack[-1]

    scenario = load_scenario("hover").with_duration(8.0)
    heavy = with_effects(QUAD, {"payload": {"mass_kg": 0.3}})
    flight = fly(scenario, QUAD, truth=heavy, make_stack=make)
    last = flight.records[-1]
    assert last.command.thrust_n == pytest.approx(1.5 * G, rel=0.03)
    # with the hover thrust right, the acceleration that is asked for is nearly nothing, integral included
    assert abs(last.proposal.nominal_acc_ned_mps2[2]) < 0.35  # one tick, with the noise of the velocity in it


@pytest.mark.parametrize("name", BASELINES)
def test_with_a_right_model_the_true_path_is_within_3_cm(name: str) -> None:
    flight = fly(load_scenario("figure8").with_duration(8.0), QUAD, seed=3, make_stack=stack_maker(name))
    assert flight.rmse_m < 0.03
    assert flight.max_m < 0.08
    assert flight.guards == set()


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_controller_flies_the_papers_path_with_the_wrong_model(name: str) -> None:
    scenario = load_scenario("paper-tracking").with_duration(4.0)
    flight = fly(scenario, QUAD, seed=1, make_stack=stack_maker(name))
    truths = np.array([truth.pos_ned_m for truth in flight.truths])
    assert np.ptp(truths[:, 0]) > 1.0, "it moved"
    assert np.ptp(truths[:, 1]) > 0.8
    assert flight.rmse_m < 0.6
    assert flight.guards == set()
    assert flight.least_height_m > 0.3


def test_gains_are_per_kilogram_and_thrust_is_scaled_by_the_learned_gain() -> None:
    """Vehicles of any mass answer alike; thrust that gives 80 % is asked for 1.25 times."""
    heavy = replace(MODEL, mass_kg=2.0 * MODEL.mass_kg, max_thrust_n=2.0 * MODEL.max_thrust_n)
    groups = {
        PidController: (AttitudeGains(), PidGains()),
        Px4Controller: (AttitudeGains(), Px4Gains()),
        IndiController: (AttitudeGains(), PidGains(), ObserverGains()),
    }
    weak = changed(Learned.nothing(), thrust_gain=0.8)
    for kind, gains in groups.items():
        thrusts = []
        for model, learned in ((MODEL, Learned.nothing()), (heavy, Learned.nothing()), (MODEL, weak)):
            controller = kind(model, LIMITS, *gains)  # type: ignore[arg-type]
            measured = seen(4000, pos_ned_m=POINT.pos_ned_m + np.array([0.0, 0.0, 0.02]))
            _, proposal = controller.step(controller.init(0), measured, POINT, learned, sent(0), 4000)
            thrusts.append(proposal.thrust_n)
        assert thrusts[1] == pytest.approx(2.0 * thrusts[0])
        assert thrusts[2] == pytest.approx(1.25 * thrusts[0])


def test_a_controller_nobody_knows_is_refused_with_the_names_that_there_are() -> None:
    with pytest.raises(InputError, match="no controller named 'lqr': use one of flatness, pd, pid, indi, dob, px4"):
        build("lqr", MODEL, LIMITS)


def test_without_learning_no_learner_flies() -> None:
    for name in CONTROLLERS:
        assert not build(name, MODEL, LIMITS, learning=False)[1].enabled
    assert isinstance(build("dob", MODEL, LIMITS)[1], DisturbanceObserver)
