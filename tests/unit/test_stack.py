"""The stack in flight, without a wire: against the simulated vehicle with its lags, rate loop and noisy sensors."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from certificates import certificate as certificate_with_premises
from certified import certificate
from shipped import load_scenario, load_vehicle

from flightstack.control.feedback import FeedbackGains, FlatnessController
from flightstack.frames import quat_from_euler
from flightstack.model import Limits, Model
from flightstack.predictor import Streams, predict
from flightstack.seams import NoFilter, NoLearner
from flightstack.stack import Stack
from flightstack.trajectory import figure8, hover
from flightstack.types import Command, Filtered, FlatOutput, Learned, Measurement, Proposal, changed
from flightstack.vehicle import Vehicle, with_effects
from flightstack.warmup import warm_up
from tests.closed_loop import ClosedLoopFlight, fly
from tests.thorough import thorough

QUAD = load_vehicle("quad-x")
SIH = load_vehicle("px4-sihsim-quadx")
MODEL = Model.from_vehicle(QUAD)
SETPOINT = hover((0.0, 0.0, -1.0)).at(0.0)


def measurement(t_us: int = 4000, **changes: object) -> Measurement:
    streams = Streams()
    streams.attitude(t_us, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    streams.position(t_us, (0.0, 0.0, -1.0), (0.0, 0.0, 0.0))
    streams.imu(t_us, (0.0, 0.0, -9.80665), (0.0, 0.0, 0.0))
    seen = predict(streams, t_us)
    assert seen is not None
    return changed(seen, **changes)


def tick(stack: Stack, seen: Measurement | None, setpoint: FlatOutput = SETPOINT) -> tuple[Command, str]:
    _, command, record = stack.tick(stack.init(measurement(0)), seen, setpoint, 4000)
    assert record.command is command
    return command, record.guard


def test_at_the_reference_the_command_is_hover() -> None:
    command, guard = tick(Stack(MODEL), measurement())
    assert guard == ""
    assert command.thrust_n == pytest.approx(1.2 * 9.80665)
    assert command.thrust_norm == pytest.approx(MODEL.hover_norm)
    np.testing.assert_allclose(command.rate_frd_radps, 0.0, atol=1e-12)
    assert command.t_us == 4000


@pytest.mark.parametrize("yaw", [0.0, 1.2, -2.9])
def test_errors_are_answered_in_the_right_direction_at_every_heading(yaw: float) -> None:
    """Below the reference: more thrust.  Beside it: the axis of the turn is across the way to the goal."""
    q = quat_from_euler(0.0, 0.0, yaw)
    stack, goal = Stack(MODEL), changed(SETPOINT, yaw_rad=yaw)
    low, _ = tick(stack, measurement(q_ned_frd=q, pos_ned_m=np.array([0.0, 0.0, -0.9])), goal)
    sinking, _ = tick(stack, measurement(q_ned_frd=q, vel_ned_mps=np.array([0.0, 0.0, 0.3])), goal)
    assert min(low.thrust_n, sinking.thrust_n) > 1.2 * 9.80665 + 0.1
    for error in (np.array([0.2, 0.0, 0.0]), np.array([0.0, 0.2, 0.0])):
        command, _ = tick(stack, measurement(q_ned_frd=q, pos_ned_m=np.array([0.0, 0.0, -1.0]) - error), goal)
        c, s = math.cos(yaw), math.sin(yaw)
        forward, right = c * error[0] + s * error[1], -s * error[0] + c * error[1]
        p, pitch_rate, _ = command.rate_frd_radps
        assert p * right >= -1e-9
        assert pitch_rate * forward <= 1e-9
        assert p * forward + pitch_rate * right == pytest.approx(0.0, abs=0.01 * math.hypot(p, pitch_rate))


def test_the_feedback_is_the_papers_for_small_errors() -> None:
    """Level, at rest, nominal's pole at (nearly) zero: f_FB and omega_FB of Section IV.A with Kbar turned by yaw."""
    gains = FeedbackGains(nominal=dataclasses.replace(FeedbackGains().nominal, pole_radps=(1e-6, 1e-6, 1e-6)))
    stack, yaw = Stack(MODEL, controller=FlatnessController(MODEL, gains)), 0.4
    goal = changed(SETPOINT, yaw_rad=yaw)
    euler, rate = np.array([0.01, -0.02, yaw + 0.015]), np.array([0.1, -0.2, 0.05])
    error = np.array([0.05, -0.03, 0.04])
    seen = measurement(
        q_ned_frd=quat_from_euler(*euler), pos_ned_m=goal.pos_ned_m - error, rate_frd_radps=rate,
        vel_ned_mps=np.array([0.0, 0.0, 0.1]),
    )  # fmt: skip
    _, _, record = stack.tick(stack.init(measurement(0)), seen, goal, 4000)
    force = -MODEL.mass_kg * (gains.thrust_p_ps2 * error[2] + gains.thrust_d_ps * -0.1)
    assert record.proposal.thrust_fb_n == pytest.approx(force, abs=0.02)
    north, east = error[:2]
    right = -math.sin(yaw) * north + math.cos(yaw) * east
    forward = math.cos(yaw) * north + math.sin(yaw) * east
    gain = np.array([gains.attitude_p_ps, gains.attitude_p_ps, gains.yaw_p_ps])
    drift = gains.position_rate_radpms * np.array([right, -forward, 0.0])
    wanted = gain * (np.array([0.0, 0.0, yaw]) - euler) - gains.rate_p * rate + drift
    np.testing.assert_allclose(record.proposal.rate_fb_frd_radps, wanted, atol=2e-3)


@pytest.mark.parametrize(
    ("name", "vehicle"),
    [
        ("figure8", QUAD), ("minimum-snap", SIH), thorough("hover", QUAD), thorough("hover", SIH),
        thorough("figure8", SIH), thorough("minimum-snap", QUAD),
    ],
    ids=lambda value: value if isinstance(value, str) else value.name,
)  # fmt: skip
def test_with_a_right_model_the_true_path_is_within_3_cm(name: str, vehicle: Vehicle) -> None:
    scenario = load_scenario(name)
    flight = fly(scenario.with_duration(min(scenario.duration_s, 16.0)), vehicle, seed=3)
    assert flight.rmse_m < 0.03
    assert flight.max_m < 0.06
    assert flight.guards == set()


@pytest.fixture(scope="module")
def wrong_model() -> ClosedLoopFlight:
    """The paper's flight for 20 s: 1.4 times the mass, 0.1 g to the north, nothing learned."""
    return fly(load_scenario("paper-tracking").with_duration(20.0), QUAD, seed=1)


def test_with_the_papers_wrong_model_the_error_is_large_but_the_flight_is_safe(wrong_model: ClosedLoopFlight) -> None:
    assert 0.2 < wrong_model.rmse_m < 0.6
    assert wrong_model.least_height_m > 0.4
    assert wrong_model.guards == set()


def test_the_wrong_masss_error_is_the_one_that_the_gains_predict(wrong_model: ClosedLoopFlight) -> None:
    """0.4 g of missing thrust against a stiffness of p^2 / 3 + Kp / m along body z: a constant droop."""
    gains = FeedbackGains()
    stiffness = gains.nominal.pole_radps[2] ** 2 / 3.0 + gains.thrust_p_ps2
    assert wrong_model.errors_m[:, 2].mean() == pytest.approx(0.4 * 9.80665 / stiffness, rel=0.05)
    assert wrong_model.errors_m[:, 0].mean() > 0.05, "pushed north"
    assert abs(wrong_model.errors_m[:, 1].mean()) < 0.02


def test_gps_grade_sensors_and_the_wrong_model_together_still_fly() -> None:
    flight = fly(load_scenario("paper-tracking").with_duration(15.0), QUAD, seed=2, grade="gps")
    assert flight.guards == set()
    assert flight.max_m < 1.3
    assert flight.least_height_m > 0.1


def test_40_ms_of_latency_that_the_samples_own_times_tell_cost_nothing() -> None:
    late = fly(load_scenario("figure8").with_duration(10.0), QUAD, seed=4, latency_ticks=10)
    assert late.rmse_m < 0.03
    assert late.guards == set()


def test_a_believed_drag_is_compensated() -> None:
    """The same vehicle, told and not told of its drag of 1 kg/s on 1 kg; 3.3 m/s."""
    scenario = load_scenario("figure8").with_duration(10.0)
    ignorant = with_effects(SIH, {"linear_drag": {"d_x_kgps": 0.0, "d_y_kgps": 0.0, "d_z_kgps": 0.0}})
    assert fly(scenario, SIH).rmse_m < 0.25 * fly(scenario, ignorant, truth=SIH).rmse_m


def test_the_same_seed_gives_the_same_flight_bit_for_bit() -> None:
    scenario = load_scenario("hover").with_duration(2.0)
    first, second = fly(scenario, QUAD, seed=9), fly(scenario, QUAD, seed=9)
    np.testing.assert_array_equal(first.errors_m, second.errors_m)
    assert not np.array_equal(first.errors_m, fly(scenario, QUAD, seed=10).errors_m)


@pytest.mark.parametrize(
    ("seen", "guard"),
    [
        (None, "zero_rates: attitude lost"),
        (measurement(attitude_age_us=10**6), "zero_rates: attitude lost"),
        (measurement(position_age_us=10**6), "level: position lost"),
        (measurement(pos_ned_m=np.full(3, np.nan)), "level: position lost"),
        (measurement(q_ned_frd=np.full(4, np.nan)), "zero_rates: attitude lost"),
        (measurement(pos_ned_m=np.array([1e6, 0.0, 0.0])), "brake: outside the envelope"),
    ],
)
def test_whatever_is_missing_ends_in_the_guards_fallback_and_the_next_good_tick_flies_on(
    seen: Measurement | None, guard: str
) -> None:
    stack = Stack(MODEL)
    state, command, record = stack.tick(stack.init(measurement(0)), seen, SETPOINT, 4000)
    assert record.guard == guard
    assert np.isfinite([command.thrust_n, command.thrust_norm, *command.rate_frd_radps]).all()
    assert command.t_us == 4000
    for i in range(2, 200):
        state, command, record = stack.tick(state, measurement(4000 * i), SETPOINT, 4000 * i)
    assert record.guard == ""
    np.testing.assert_allclose(command.rate_frd_radps, 0.0, atol=0.05)


class _Less(NoFilter):
    """Lets pass a share of the thrust."""

    def __init__(self, share: float) -> None:
        self.share, self.asked = share, list[Command]()

    def step(
        self, state: object, measurement: Measurement, command: Command, sent: Command, learned: Learned
    ) -> tuple[object, Command, Filtered]:
        self.asked.append(command)
        thrust = self.share * command.thrust_n
        return state, command._replace(thrust_n=thrust, thrust_norm=MODEL.norm_of(thrust)), Filtered.nothing()


@pytest.mark.parametrize("place", [(51.0, 0.0, -1.0), (0.0, 0.0, -52.0)])
def test_outside_the_envelope_the_brake_is_what_the_filter_makes_of_it(place: tuple[float, float, float]) -> None:
    """A certificate holds there as well: the guard does not override what keeps it."""
    seen = measurement(pos_ned_m=np.array(place), vel_ned_mps=np.array([2.0, 0.0, 0.5]))
    less = _Less(0.9)
    command, guard = tick(Stack(MODEL, safety_filter=less), seen)
    assert guard == "brake: outside the envelope"
    assert less.asked[0].rate_frd_radps[1] > 0.5, "flying north it pitches up"
    np.testing.assert_array_equal(command.rate_frd_radps, less.asked[0].rate_frd_radps)
    assert command.thrust_n == pytest.approx(0.9 * MODEL.weight_n), "it sinks at 0.5 m/s already: thrust that carries"


def test_outside_the_envelope_a_filter_that_gives_no_number_is_overridden() -> None:
    command, guard = tick(
        Stack(MODEL, safety_filter=_Less(math.nan)), measurement(pos_ned_m=np.array([60.0, 0.0, -1.0]))
    )
    assert guard == "brake: command not finite"
    assert np.isfinite([command.thrust_n, *command.rate_frd_radps]).all()


def test_a_setpoint_that_is_not_finite_brakes_and_is_forgotten() -> None:
    stack = Stack(MODEL)
    bad = changed(SETPOINT, pos_ned_m=np.full(3, np.nan))
    state, _, record = stack.tick(stack.init(measurement(0)), measurement(), bad, 4000)
    assert record.guard == "brake: command not finite"
    _, command, record = stack.tick(state, measurement(8000), SETPOINT, 8000)
    assert record.guard == ""
    assert command.thrust_n == pytest.approx(MODEL.weight_n, rel=0.01)


def test_thrust_is_cut_at_its_limit_and_the_record_says_so() -> None:
    far_below = measurement(pos_ned_m=np.array([0.0, 0.0, 4.0]))
    stack = Stack(MODEL)
    _, command, record = stack.tick(stack.init(measurement(0)), far_below, SETPOINT, 4000)
    assert record.thrust_saturated
    assert command.thrust_n == pytest.approx(1.8 * MODEL.weight_n)
    assert record.guard == ""


def test_tilt_stays_within_the_plan_for_any_error() -> None:
    """A kilometre away the desired attitude leans by at most the limit, so the attitude error does too."""
    stack = Stack(MODEL, limits=Limits(radius_m=1e4, tilt_max_rad=0.5))
    state = stack.init(measurement(0))
    for i in range(1, 100):
        seen = measurement(4000 * i, pos_ned_m=np.array([1e3, 1e3, -1.0]))
        state, _, record = stack.tick(state, seen, SETPOINT, 4000 * i)
    assert np.linalg.norm(record.proposal.attitude_error_rad) <= 0.5 + 1e-6
    assert np.linalg.norm(record.proposal.attitude_error_rad) > 0.4


class _Known:
    """A learner that has learned a constant acceleration."""

    enabled = True

    def init(self) -> object:
        return 0

    def step(self, state: object, seen: Measurement, sent: Command, reference: FlatOutput) -> tuple[object, Learned]:
        known = changed(Learned.nothing(), acc_ned_mps2=np.array([0.0, 0.0, 2.0]), thrust_gain=0.8)
        return int(str(state)) + 1, known


class _Halves:
    """A filter that halves the thrust once it has a certificate, which comes with the first point learned."""

    enabled = True

    def init(self, origin_ned_m: np.ndarray) -> object:
        return None

    def adopt(self, state: object, certificate: object) -> object:
        return "adopted"

    def bend(self, state: object, setpoint: FlatOutput) -> FlatOutput:
        return setpoint

    def step(
        self, state: object, seen: Measurement, command: Command, sent: Command, learned: Learned
    ) -> tuple[object, Command, Filtered]:
        assert sent.t_us < command.t_us
        said = changed(Filtered.nothing(), status=0.0)
        if state != "adopted":
            return state, command, said
        return state, command._replace(thrust_n=0.5 * command.thrust_n, thrust_norm=0.3), changed(said, status=3.0)


class _Certifies:
    enabled = True

    def init(self) -> object:
        return 0

    def step(
        self, state: object, learner: object, seen: Measurement, learned: Learned, filtered: Filtered
    ) -> tuple[object, object]:
        return filtered.status, (certificate() if learner == 1 else None)


class _CertifiesWithPremises(_Certifies):
    def step(
        self, state: object, learner: object, seen: Measurement, learned: Learned, filtered: Filtered
    ) -> tuple[object, object]:
        return state, certificate_with_premises()


def test_a_learner_and_a_filter_have_their_seams() -> None:
    stack = Stack(MODEL, learner=_Known())
    state, command, _ = stack.tick(stack.init(measurement(0)), measurement(), SETPOINT, 4000)
    carried = 1.2 * (9.80665 + 2.0) / 0.8
    assert command.thrust_n == pytest.approx(carried), "2 m/s^2 downwards are carried too, by thrust that gives 80 %"
    assert state.learner == 1
    guarded = Stack(MODEL, learner=_Known(), certifier=_Certifies(), safety_filter=_Halves())
    state, command, record = guarded.tick(guarded.init(measurement(0)), measurement(), SETPOINT, 4000)
    assert command.thrust_n == pytest.approx(0.5 * carried)
    assert (record.guard, record.filtered.status, state.certifier) == ("", 3.0, -1.0)
    state, _, record = guarded.tick(state, measurement(8000), SETPOINT, 8000)
    assert (record.filtered.status, state.certifier) == (3.0, 3.0), "the certifier hears what the filter said"
    assert not NoLearner.enabled
    assert not NoFilter.enabled


def test_what_a_certificate_says_stays_with_its_flight() -> None:
    """Beside no filter its premises are told as well, and not in the records of the process' other flights."""
    alone = Stack(MODEL)
    before = alone.tick(alone.init(measurement(0)), measurement(), SETPOINT, 4000)[2].digest
    watched = Stack(MODEL, learner=_Known(), certifier=_CertifiesWithPremises())
    record = watched.tick(watched.init(measurement(0)), measurement(), SETPOINT, 4000)[2]
    assert (record.filtered.premise, record.filtered.ended_by) == (0.0, 0.0)
    assert alone.tick(alone.init(measurement(0)), measurement(), SETPOINT, 4000)[2].digest == before


class _PushesUp:
    """Full thrust, whatever the reference; its state is its own."""

    def init(self, now_us: int) -> list[int]:
        return [now_us]

    def healthy(self, state: list[int]) -> bool:
        return len(state) == 1

    def step(
        self, state: list[int], seen: Measurement, reference: FlatOutput, learned: Learned, sent: Command, now_us: int
    ) -> tuple[list[int], Proposal]:
        return [state[0] + 1], Proposal(1.8 * MODEL.weight_n, np.zeros(20))


class _CertifiesOnce(_Certifies):
    def step(
        self, state: object, learner: object, seen: Measurement, learned: Learned, filtered: Filtered
    ) -> tuple[object, object]:
        return 1, (certificate_with_premises() if state == 0 else None)


def test_where_a_certificate_is_over_whoever_flew_no_longer_does() -> None:
    """Rate gains told, then a lost second of somebody else's: the stack's own controller brings it to rest."""
    stack = Stack(MODEL, controller=_PushesUp(), certifier=_CertifiesOnce())
    state, command, record = stack.tick(stack.init(measurement(0)), measurement(), SETPOINT, 4000)
    assert command.thrust_n == pytest.approx(1.8 * MODEL.weight_n)
    state = stack.gains_changed(state)
    for t_us in (8000, 12_000):
        state, command, record = stack.tick(state, measurement(t_us), SETPOINT, t_us)
        assert command.thrust_n == pytest.approx(MODEL.weight_n, rel=0.02)
        assert record.filtered.ended_by > 0.0
    again = stack.resume(state, measurement(1_000_000))
    _, command, _ = stack.tick(again, measurement(1_004_000), SETPOINT, 1_004_000)
    assert command.thrust_n == pytest.approx(MODEL.weight_n, rel=0.02)


def test_the_stacks_own_controller_goes_on_as_it_was() -> None:
    own = FlatnessController(MODEL, FeedbackGains(thrust_p_ps2=1.0))
    assert Stack(MODEL, controller=own).braking is own


def test_known_lag_is_led() -> None:
    """At constant errors of zero, thrust is led by the rotors' lag, rates by the rate loop's."""
    path = figure8(length_m=3.0, width_m=1.5, period_s=8.0, height_m=1.0)
    point = path.at(0.7)
    quick = dataclasses.replace(MODEL, motor_lag_s=0.0, rate_lag_s=0.0)
    q = quat_from_euler(0.0, 0.0, 0.0)
    seen = measurement(pos_ned_m=point.pos_ned_m, vel_ned_mps=point.vel_ned_mps, q_ned_frd=q)
    records = []
    for model in (MODEL, quick):
        stack = Stack(model)
        records.append(stack.tick(stack.init(measurement(0)), seen, point, 4000)[2])
    assert not np.allclose(records[0].proposal.rate_ff_frd_radps, records[1].proposal.rate_ff_frd_radps, atol=1e-4)
    assert records[0].proposal.thrust_ff_n != pytest.approx(records[1].proposal.thrust_ff_n, abs=1e-5)


def test_warming_up_leaves_no_trace() -> None:
    stack = Stack(MODEL)
    before, _ = tick(stack, measurement())
    warm_up(stack, load_scenario("figure8"))
    after, _ = tick(stack, measurement())
    np.testing.assert_array_equal(before.rate_frd_radps, after.rate_frd_radps)
    assert before.thrust_n == after.thrust_n


def test_confidence_lowers_the_gains_by_the_schedules_share() -> None:
    """Half the share at full confidence: Kp falls to a quarter, Kd to a half; without confidence nothing changes."""
    point = changed(SETPOINT, pos_ned_m=SETPOINT.pos_ned_m)
    seen = measurement(4000, pos_ned_m=SETPOINT.pos_ned_m - [0.0, 0.0, 0.1], vel_ned_mps=np.array([0.0, 0.0, 0.2]))
    still = dataclasses.replace(FeedbackGains().nominal, pole_radps=(1e-6, 1e-6, 1e-6))
    gains = FeedbackGains(nominal=still, confident_share=0.5)
    controller = FlatnessController(MODEL, gains)
    sent = Command(0, MODEL.weight_n, MODEL.hover_norm, np.zeros(3))
    for confidence, p, d in ((0.0, 1.0, 1.0), (1.0, 0.25, 0.5)):
        learned = changed(Learned.nothing(), confidence=confidence)
        _, proposal = controller.step(controller.init(0), seen, point, learned, sent, 4000)
        force = -MODEL.mass_kg * (p * gains.thrust_p_ps2 * 0.1 + d * gains.thrust_d_ps * -0.2)
        assert proposal.thrust_fb_n == pytest.approx(force, rel=1e-6)
