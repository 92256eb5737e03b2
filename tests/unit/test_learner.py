"""The learner in closed loop, without the wire: it learns the truth, it pays, its bound holds, and it survives."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from measured import measured
from shipped import load_scenario, load_vehicle

from flightstack.frames import quat_to_matrix
from flightstack.learning.learner import GpLearner, LearnerConfig
from flightstack.model import Limits, Model
from flightstack.scenario import Scenario, TimedEvent
from flightstack.seams import Learner
from flightstack.stack import Stack
from flightstack.types import F64, Command, FlatOutput, Learned, Measurement, changed
from flightstack.vehicle import with_effects
from tests.closed_loop import ClosedLoopFlight, fly
from tests.thorough import THOROUGH

QUAD = load_vehicle("quad-x")
MODEL = Model.from_vehicle(QUAD)
G = 9.80665


def learning(model: Model, limits: Limits) -> Stack:
    return Stack(model, limits, learner=GpLearner(model))


def rows(flight: ClosedLoopFlight) -> F64:
    return np.array([record.learned.row for record in flight.records])


def true_residual(flight: ClosedLoopFlight, model: Model) -> F64:
    """(n, 3) body FRD: true specific force less the model's at the rotors' true state."""
    out = []
    for truth in flight.truths:
        u = np.array(truth.motor_u)
        thrust = np.mean([model.thrust_of(value) for value in u])
        vel = quat_to_matrix(np.array(truth.q_ned_frd)).T @ np.array(truth.vel_ned_mps)
        model_force = np.array([0.0, 0.0, -thrust]) - np.array(model.drag_kgps) * vel
        out.append(np.array(truth.specific_force_frd_mps2) - model_force / model.mass_kg)
    return np.array(out)


@functools.cache
def paper(*, learns: bool) -> ClosedLoopFlight:
    scenario = load_scenario("paper-tracking").with_duration(24.0)
    return fly(scenario, QUAD, seed=5, make_stack=learning if learns else Stack)


def test_the_applied_thrust_is_the_rotors_own() -> None:
    """Commands, latency and lag give the thrust that acted, a tick late as the streams are; it varies 20 times more."""
    flight = fly(load_scenario("figure8").with_duration(8.0), QUAD, seed=3, make_stack=learning)
    acted = np.array([sum(truth.rotor_thrust_n) for truth in flight.truths])[500:-1] / MODEL.mass_kg
    applied = rows(flight)[501:, Learned.applied_thrust_n.place] / MODEL.mass_kg
    assert acted.std() > 0.3
    assert np.sqrt(np.mean((applied - acted) ** 2)) < 0.02


def test_on_the_papers_flight_the_error_falls_to_a_tenth_and_below() -> None:
    with_it, without = paper(learns=True), paper(learns=False)
    assert without.rmse_settled_m > 0.3
    assert with_it.rmse_settled_m < 0.1 * without.rmse_settled_m
    assert not with_it.guards
    assert rows(with_it)[-1, 28] > 4000, "it was really fed"


def test_it_learns_the_papers_truth() -> None:
    """1.4 times the mass: thrust gives 1 / 1.4 of what is believed; 0.1 of the true weight pushes north."""
    learned = [record.learned for record in paper(learns=True).records[-1500:]]
    assert np.mean([one.thrust_gain for one in learned]) == pytest.approx(1.0 / 1.4, abs=0.01)
    north, east, down = np.mean([one.acc_ned_mps2 for one in learned], axis=0)
    assert north == pytest.approx(0.1 * G, abs=0.04)
    assert east == pytest.approx(0.0, abs=0.04)
    assert down == pytest.approx(0.0, abs=0.15), "traded against the gain, which hardly varies here"


def test_three_sigma_hold_the_true_residual() -> None:
    """Over the track: a Gaussian bound would hold 99.7 %, one that is twice too narrow 87 %."""
    flight = paper(learns=True)
    ticks = len(flight.errors_m)
    learned = rows(flight)[-ticks:]
    error = np.abs(true_residual(flight, MODEL)[-ticks:] - learned[:, 9:12])
    assert np.mean(error <= 3.0 * learned[:, 12:15]) > 0.985
    assert np.mean(3.0 * learned[:, 12:15]) < 0.15, "and says something"


def test_what_is_fed_forward_moves_at_the_rate_it_says() -> None:
    """Strong linear drag, not believed: the jerk is the time derivative of the acceleration along the reference."""
    drag = {"linear_drag": {"d_x_kgps": 0.8, "d_y_kgps": 0.8, "d_z_kgps": 0.8}}
    flight = fly(
        load_scenario("figure8").with_duration(20.0), QUAD, seed=6, make_stack=learning, truth=with_effects(QUAD, drag)
    )
    learned = rows(flight)[-1000:]
    dt = 0.004
    slope = (learned[20:, 0:3] - learned[:-20, 0:3]) / (20 * dt)
    said = learned[10:-10, 3:6]
    assert np.std(slope[:, :2]) > 1.0
    for axis in (0, 1):
        assert np.corrcoef(slope[:, axis], said[:, axis])[0, 1] > 0.97
        assert np.std(slope[:, axis] - said[:, axis]) < 0.3 * np.std(slope[:, axis])
    assert flight.rmse_settled_m < 0.02


def test_with_nothing_to_learn_nothing_is_lost() -> None:
    scenario = load_scenario("figure8").with_duration(16.0)
    ratios = [
        fly(scenario, QUAD, seed=seed, make_stack=learning).rmse_m / fly(scenario, QUAD, seed=seed).rmse_m
        for seed in ((1, 2, 3) if THOROUGH else (1,))
    ]
    assert np.mean(ratios) < 1.02


def dropped(scenario: Scenario) -> Scenario:
    event = TimedEvent(8.0, "payload", (("mass_kg", 0.0),))
    return dataclasses.replace(scenario.with_duration(14.0), events=(event,))


def test_a_dropped_payload_is_noticed_the_bound_widens_and_it_is_learned_anew() -> None:
    scenario = dropped(load_scenario("figure8"))
    flight = fly(scenario, QUAD, seed=7, make_stack=learning, truth=with_effects(QUAD, {"payload": {"mass_kg": 0.3}}))
    learned, truth = rows(flight), true_residual(flight, MODEL)
    drop = len(learned) - len(flight.errors_m) + 2000
    assert learned[drop - 10, 30] == 0.0
    assert abs(learned[drop - 10, 11] - truth[drop - 10, 2]) < 0.2
    noticed = np.argmax(learned[:, 30] > 0.0)
    assert 0 < noticed - drop < 75, "within 0.3 s"
    error = np.abs(truth[:, 2] - learned[:, 11])
    assert error[drop + 10] > 1.0, "what was learned is wrong by a fifth of g"
    assert np.all(error[noticed : noticed + 250] <= 3.0 * learned[noticed : noticed + 250, 14])
    assert np.all(error[drop + 500 : drop + 1000] < 0.15), "converged within 2 s"
    assert flight.max_m < 0.2


@pytest.mark.parametrize("ticks", range(0, 15, 3))
def test_a_drop_is_noticed_wherever_in_a_window_it_falls(ticks: int) -> None:
    """The window that the drop falls into widens the bound; the alarm must not take that for what it may expect."""
    event = TimedEvent(4.0 + 0.004 * ticks, "payload", (("mass_kg", 0.0),))
    scenario = dataclasses.replace(load_scenario("hover").with_duration(5.0), events=(event,))
    flight = fly(scenario, QUAD, seed=9, make_stack=learning, truth=with_effects(QUAD, {"payload": {"mass_kg": 0.3}}))
    changes = rows(flight)[:, Learned.changes.place]
    drop = len(changes) - len(flight.errors_m) + 1000 + ticks
    assert changes[drop - 2] == 0.0
    assert changes[drop + 75] > 0.0, "within 0.3 s"


def test_with_noisy_sensors_near_the_ground_nothing_fed_forward_runs_away() -> None:
    """GPS grade: what is learned depends steeply on the thrust axis; acceleration and jerk stay in their range."""
    flight = fly(load_scenario("low-pass").with_duration(8.0), QUAD, seed=1, grade="gps", make_stack=learning)
    learned = rows(flight)[:, :8]
    assert np.isfinite(learned).all()
    assert np.abs(learned[:, :3]).max() <= 0.8 * G
    assert np.abs(learned[:, 3:6]).max() <= 20.0
    assert not flight.guards


def test_a_change_that_is_no_change_is_not_noticed() -> None:
    assert all(record.learned.changes == 0.0 for record in paper(learns=True).records)


def test_held_by_a_hand_and_let_go_it_recovers() -> None:
    """Most of the weight is carried by somebody for 2 s: refused as beyond what physics of flight explains."""
    scenario = load_scenario("hover")
    events = (
        TimedEvent(4.0, "constant_force", (("down_n", -0.9 * QUAD.weight_n), ("north_n", 4.0))),
        TimedEvent(6.0, "constant_force", ()),
    )
    held = dataclasses.replace(scenario.with_duration(14.0), events=events)
    flight = fly(held, QUAD, seed=8, make_stack=learning)
    learned = rows(flight)
    assert learned[-1, 29] > learned[len(learned) // 2, 29] or learned[-1, 30] > 0
    assert np.all(learned[:, 6] >= 0.4) and np.all(learned[:, 6] <= 2.0)  # noqa: PT018
    assert np.sqrt((flight.errors_m[-500:] ** 2).sum(axis=1).mean()) < 0.05
    assert not flight.guards


def measurement(t_us: int, force_frd: F64, pos: F64, age_us: int = 0) -> Measurement:
    zero = np.zeros(3)
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    return measured(t_us, pos, zero, upright, zero, force_frd, np.full(4, np.nan), 0, 0, age_us)


class Hover:
    """A learner beside a vehicle that hovers at 2 m and misses 1 m/s^2 upwards."""

    point = FlatOutput.of(np.array([0.0, 0.0, -2.0]), *(np.zeros(3) for _ in range(4)))

    def __init__(self, config: LearnerConfig | None = None) -> None:
        self.learner = GpLearner(MODEL, config)
        self.state = self.learner.init()
        self.rng = np.random.default_rng(3)
        self.t_us = 0
        for _ in range(100):  # on the ground until the rotors turn
            self.tick(pos=np.zeros(3))

    def tick(self, force: F64 | None = None, pos: F64 | None = None, **changes: F64) -> Learned:
        self.t_us += 4000
        thrust = MODEL.weight_n
        up = np.array([0.0, 0.0, -G + 1.0]) + self.rng.normal(scale=0.1, size=3)
        where = np.array([0.0, 0.0, -2.0]) if pos is None else pos
        seen = changed(measurement(self.t_us, up if force is None else force, where), **changes)
        sent = Command(self.t_us - 4000, thrust, MODEL.norm_of(thrust), np.zeros(3))
        self.state, learned = self.learner.step(self.state, seen, sent, self.point)
        return learned

    def run(self, ticks: int) -> Learned:
        for _ in range(ticks):
            learned = self.tick()
        return learned

    def points(self) -> tuple[int, ...]:
        return tuple(len(store.gp) for store in (self.state.lateral, self.state.vertical, self.state.rates))


def test_the_stages_follow_each_other() -> None:
    hover, stages = Hover(), []
    for _ in range(400):
        stage = hover.tick().stage
        if not stages or stages[-1] != stage:
            stages.append(stage)
    assert stages == [1.0, 2.0, 3.0]
    assert hover.tick().confidence > 0.8


def test_without_new_samples_it_freezes_and_keeps_what_it_learned() -> None:
    """The IMU stops: the same sample time again and again."""
    hover = Hover()
    before = hover.run(400)
    for k in range(200):
        age = (k + 1) * 4000
        seen = measurement(hover.t_us + age, np.array([0.0, 0.0, -G + 1.0]), np.array([0.0, 0.0, -2.0]), age)
        sent = Command(seen.t_us - 4000, MODEL.weight_n, MODEL.hover_norm, np.zeros(3))
        hover.state, learned = hover.learner.step(hover.state, seen, sent, hover.point)
    assert learned.stage == 4.0
    assert learned.fed == before.fed
    np.testing.assert_allclose(learned.acc_ned_mps2, before.acc_ned_mps2, atol=1e-6)
    assert learned.thrust_gain == pytest.approx(before.thrust_gain)


def test_a_tick_between_two_samples_costs_no_window() -> None:
    """An IMU stream a little slower than the ticks, as PX4's 246 Hz: every 40th tick finds the sample before again."""
    hover = Hover()
    before, points = hover.run(1), len(hover.state.lateral.gp)
    for k in range(600):
        if k % 40 == 39:
            hover.t_us += 4000
            seen = measurement(hover.t_us, np.array([0.0, 0.0, -G + 1.0]), np.array([0.0, 0.0, -2.0]), 4000)
            sent = Command(hover.t_us - 4000, MODEL.weight_n, MODEL.hover_norm, np.zeros(3))
            hover.state, learned = hover.learner.step(hover.state, seen, sent, hover.point)
        else:
            learned = hover.tick()
    assert learned.fed == before.fed + 585
    assert learned.refused == before.refused
    for _ in range(4):  # the last window is in the lateral store by then
        hover.tick()
    assert len(hover.state.lateral.gp) == points + 585 // 15


def test_a_window_enters_one_store_a_tick_in_which_nothing_else_is_due() -> None:
    """An exchange of points costs as much as a prediction: three of them and a look ahead in one tick are too many."""
    hover = Hover()
    hover.run(400)
    entered = []
    for _ in range(300):
        step, before = hover.state.steps, hover.points()
        hover.tick()
        grown = sum(hover.points()) - sum(before)
        entered += [grown] if grown else []
        assert not grown or (step % 4 and step % 64 != 1)
    assert set(entered) == {1}
    assert len(entered) in range(3 * 20 - 2, 3 * 20 + 3)


def test_far_from_all_data_the_bound_is_the_priors() -> None:
    """At 40 m/s, ten length-scales away, the smooth part knows nothing; what is fed forward stays within its clip."""
    hover = Hover()
    near = hover.run(600)
    far = hover.tick(vel_ned_mps=np.array([40.0, 0.0, 0.0]))
    assert near.sigma_frd_mps2[0] < 0.05
    smooth, per_speed = 0.6, 0.5
    assert far.sigma_frd_mps2[0] > np.hypot(smooth, per_speed * 40.0), "the prior's, inflated"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e9])
def test_bad_samples_are_counted_and_change_nothing(value: float) -> None:
    hover = Hover()
    before = hover.run(400)
    for _ in range(50):
        learned = hover.tick(specific_force_frd_mps2=np.array([0.0, 0.0, value]))
    assert learned.refused == before.refused + 50
    assert learned.fed == before.fed
    after = hover.run(1)
    np.testing.assert_allclose(after.acc_ned_mps2, before.acc_ned_mps2, atol=0.02)
    assert np.isfinite(after.row[:15]).all()


def test_hitting_the_ground_teaches_nothing() -> None:
    """Impact (60 m/s^2), then lying there while thrust is still asked for: the ground carries, the learner must not."""
    hover = Hover()
    before = hover.run(600)
    for k in range(500):
        force = np.array([0.0, 0.0, -60.0 if k < 10 else -G])
        learned = hover.tick(force=force, pos=np.array([0.0, 0.0, -0.02]))
    assert learned.fed == before.fed
    assert learned.thrust_gain == pytest.approx(before.thrust_gain, abs=2e-3)


def test_the_kernels_relevance_keeps_the_neighbourhood_of_now() -> None:
    """The paper's rule: with a full store the point least like the present one leaves."""
    config = LearnerConfig(capacity=20, relevance="kernel")
    hover = Hover(config)
    hover.run(600)
    for _ in range(154):  # ten windows, and the tick in which the last is taken
        hover.tick(vel_ned_mps=np.array([6.0, 0.0, 0.0]))
    assert np.sum(hover.state.lateral.gp.x[:, 0] > 3.0) >= 10
    assert len(hover.state.lateral.gp) == 20


def test_the_learner_keeps_to_its_seam() -> None:
    learner: Learner = GpLearner(MODEL)
    assert learner.enabled
