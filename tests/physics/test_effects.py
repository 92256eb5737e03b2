"""Every row of the table of effects: inert at null, acting off it, and what each one's formula promises."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from fleet import QUAD, TYPICAL, matrix, quad, set_random_state, without_thrust_or_ground
from oracle import RHO, G
from scipy.integrate import quad as quadrature

from flightstack.effects import EFFECTS, check_effect, ground_effect, rotor_drag, turbulence
from flightstack.effects.row import S_CHARGE, S_GUST, S_NORMALS, S_RING, S_WIND
from flightstack.gap.records import Samples
from flightstack.types import F64, InputError
from flightstack.vehicle import with_effects
from flightstack_sim.parameters import parameter_row
from flightstack_sim.plant import NativePlant

SENSORS = ("accelerometer_bias", "gyro_bias", "attitude_misalignment")
OFF = np.zeros(4)


DRAG = {"linear_drag": {"d_x_kgps": 0.1, "d_y_kgps": 0.2, "d_z_kgps": 0.1}}


def flight(effects: dict[str, dict[str, float]], background: dict[str, dict[str, float]] = DRAG) -> F64:
    """A short lively flight low over the ground, all states after it; with drag behind it all, so that wind is felt."""
    plant = NativePlant(quad(**{**background, **effects}), seed=5)
    plant.pos_ned_m[2] = -0.5
    plant.vel_ned_mps[:] = [2.0, 1.0, -0.5]
    plant.rate_frd_radps[:] = [0.5, -0.4, 0.3]
    for k in range(40):
        plant.run(np.array([0.7, 0.72, 0.69, 0.71]) + 0.02 * math.sin(k), 5)
    return plant._state[0].copy()


def test_every_effect_is_a_file_of_its_own_with_all_that_is_known_of_it() -> None:
    folder = Path(turbulence.__file__).parent
    assert {path.stem for path in folder.glob("*.py")} - {"__init__", "record", "row", "expressions"} == set(EFFECTS)
    for name, effect in EFFECTS.items():
        assert effect.name == name
        assert effect.physics.__module__ == f"flightstack.effects.{name}"
        assert min(len(effect.source), len(effect.equation), len(effect.manoeuvre)) > 5
        assert effect.words
        assert check_effect(name, effect.example, "example") == effect.example
        assert not effect.is_null(effect.example)
        assert set(effect.needs) <= {"command", *(field.name for field in fields(Samples))}


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_at_its_null_value_flies_bit_for_bit_like_none(name: str) -> None:
    nulls = {p.name: p.null for p in EFFECTS[name].params if p.null is not None}
    background = {} if name in DRAG else DRAG
    assert np.array_equal(flight({name: nulls}, background), flight({}, background))
    assert np.array_equal(flight({name: {}}, background), flight({}, background))


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_off_null_changes_what_its_kind_says(name: str) -> None:
    same = np.array_equal(flight({name: TYPICAL[name]}), flight({}))
    assert same == (name in SENSORS), "sensor effects leave the motion alone, all others change it"
    plant, plain = NativePlant(quad(**{name: TYPICAL[name]}), seed=5), NativePlant(QUAD, seed=5)
    sensed = [
        np.array_equal(getattr(plant, field), getattr(plain, field))
        for field in ("accel_bias_frd_mps2", "gyro_bias_frd_radps", "misalignment_q")
    ]
    assert sensed == [name != sensor for sensor in SENSORS]


def test_sensor_effects_show_as_their_values() -> None:
    plant = NativePlant(quad(**{name: TYPICAL[name] for name in SENSORS}), seed=0)
    assert plant.accel_bias_frd_mps2.tolist() == [0.1, -0.2, 0.3]
    assert plant.gyro_bias_frd_radps.tolist() == [0.01, 0.02, -0.03]
    roll = NativePlant(quad(attitude_misalignment={"roll_rad": 0.2}), seed=0)
    assert roll.misalignment_q == pytest.approx([math.cos(0.1), math.sin(0.1), 0, 0])


@pytest.mark.parametrize("name", ["linear_drag", "parasitic_drag", "rotor_drag", "induced_inflow", "angular_damping"])
def test_a_dissipative_effect_takes_power_out_in_still_air_in_every_state(name: str) -> None:
    """Power of the effect's force and torque on the moving, turning body is never positive."""
    rng = np.random.default_rng(6)
    plain = NativePlant(QUAD, seed=0, ground=False)
    damped = NativePlant(quad(**{name: TYPICAL[name]}), seed=0, ground=False)
    for _ in range(200):
        set_random_state(plain, rng)
        damped._state[:] = plain._state
        plain.evaluate()
        damped.evaluate()
        force = 1.2 * (damped.specific_force_frd_mps2 - plain.specific_force_frd_mps2)
        change = damped.angular_acceleration_frd_radps2 - plain.angular_acceleration_frd_radps2
        velocity = matrix(plain.q_ned_frd).T @ plain.vel_ned_mps
        power = force @ velocity + (QUAD.inertia_kgm2 * change) @ plain.rate_frd_radps
        assert power < 0.0


def test_a_fall_with_linear_drag_approaches_terminal_velocity_as_the_closed_form_says() -> None:
    d = 0.8
    plant = without_thrust_or_ground(quad(linear_drag={"d_z_kgps": d}))
    terminal = 1.2 * G / d
    for t in (1.0, 2.0, 3.0):
        plant.run(OFF, 1000)
        assert plant.vel_ned_mps[2] == pytest.approx(terminal * (1.0 - math.exp(-d / 1.2 * t)), rel=1e-9)


def test_a_fall_with_quadratic_drag_approaches_terminal_velocity_as_the_closed_form_says() -> None:
    c = 0.05
    plant = without_thrust_or_ground(quad(parasitic_drag={"c_z_kg_per_m": c}))
    terminal = math.sqrt(1.2 * G / c)
    for t in (1.0, 2.0, 3.0):
        plant.run(OFF, 1000)
        assert plant.vel_ned_mps[2] == pytest.approx(terminal * math.tanh(G * t / terminal), rel=1e-9)


def test_a_gliding_vehicle_ends_up_moving_with_the_wind() -> None:
    """Drag acts on the velocity relative to the air: hung in level flight the vehicle drifts at the wind's velocity."""
    lifted = {"down_n": -1.2 * G}
    wind = {"north_mps": 3.0, "east_mps": -2.0}
    drag = {"d_x_kgps": 2.0, "d_y_kgps": 2.0, "d_z_kgps": 2.0}
    plant = without_thrust_or_ground(quad(linear_drag=drag, steady_wind=wind, constant_force=lifted))
    plant.run(OFF, 20_000)
    assert plant.vel_ned_mps == pytest.approx([3.0, -2.0, 0.0], abs=1e-9)


def test_motors_follow_their_command_exponentially_and_exactly() -> None:
    plant = without_thrust_or_ground(quad(motor_lag={"time_constant_s": 0.05}))
    for k in range(1, 200):
        plant.step(np.full(4, 0.8))
        assert plant.motor_u == pytest.approx(0.8 * (1.0 - math.exp(-1e-3 * k / 0.05)), abs=1e-13)


def test_motors_without_lag_follow_at_once() -> None:
    plant = without_thrust_or_ground(quad(motor_lag={"time_constant_s": 0.0}))
    plant.step(np.full(4, 0.8))
    assert plant.motor_u.tolist() == [0.8] * 4
    assert plant.specific_force_frd_mps2 == pytest.approx([0, 0, -4 * 6.6 * 0.64 / 1.2])


def commands(seed: int, count: int) -> F64:
    return np.random.default_rng(seed).uniform(0.3, 0.9, (count, 4))


@pytest.mark.parametrize("delay_ms", [1, 7, 12.5, 249.75, 250])
def test_delayed_commands_act_late_by_the_delay(delay_ms: float) -> None:
    """Without lag the motors show the command of `delay` ago, between two steps the mixture of both."""
    effects = {"motor_lag": {"time_constant_s": 0.0}, "transport_delay": {"delay_s": delay_ms / 1e3}}
    plant = without_thrust_or_ground(quad(**effects))
    sent = commands(1, 600)
    past = np.concatenate([np.zeros((300, 4)), sent])
    for k in range(600):
        plant.step(sent[k])
        whole, part = int(delay_ms), delay_ms % 1
        expected = (1 - part) * past[300 + k - whole] + part * past[300 + k - whole - 1]
        assert plant.motor_u == pytest.approx(expected, abs=1e-12)


def test_a_delay_that_sets_in_during_flight_knows_the_commands_before() -> None:
    plant = without_thrust_or_ground(quad(motor_lag={"time_constant_s": 0.0}))
    sent = commands(2, 400)
    for k in range(300):
        plant.step(sent[k])
    plant.set_effect("transport_delay", {"delay_s": 0.2})
    plant.step(sent[300])
    assert plant.motor_u == pytest.approx(sent[100], abs=1e-12)


def test_the_battery_sags_under_current_and_empties_as_its_charge_runs_out() -> None:
    """Independent sum: P = sum T^1.5 / sqrt(2 rho A) / 0.6, V (V + R I) = OCV ..., charge by the current."""
    plant = without_thrust_or_ground(QUAD)
    assert plant.battery_v == 16.8
    plant.motor_u[:] = 0.7
    charge, t = 1.0, 6.6 * 0.49
    power = 4 * t**1.5 / math.sqrt(2 * RHO * math.pi * 0.12**2) / 0.6
    for _ in range(2000):
        plant.step(np.full(4, 0.7))
        open_circuit = 13.2 + 3.6 * charge
        current = power / plant.battery_v
        assert plant.battery_v == pytest.approx(open_circuit - 0.02 * current, abs=1e-9)
        charge -= current * 1e-3 / 18000
    assert plant.battery_v == pytest.approx(16.8 - 0.14, abs=0.01)  # by hand: 117 W, 7 A


def test_an_empty_battery_stays_finite() -> None:
    plant = without_thrust_or_ground(quad(battery_sag={"thrust_loss_per_v": 0.05}))
    plant._state[0, S_CHARGE] = 1e-6
    plant.run(np.full(4, 1.0), 2000)
    assert 12.0 < plant.battery_v < 13.2
    assert np.isfinite(plant._state).all()


def gusts(effects: dict[str, dict[str, float]], seconds: int, dt_us: int) -> tuple[F64, F64]:
    """(along, across, down) gusts of a vehicle at rest on the ground, and the lags' time step."""
    plant = NativePlant(quad(**effects), seed=11, dt_us=dt_us)
    count = seconds * 1_000_000 // dt_us
    winds = np.empty((count, 3))
    wind = plant._state[0, S_WIND : S_WIND + 3]
    for k in range(count):
        plant.step(OFF)
        winds[k] = wind
    return winds - np.array([6.0, 8.0, 0.0]), np.array([0.6, 0.8])


@pytest.mark.parametrize("dt_us", [2500, 10_000])
def test_gusts_have_drydens_variance_and_autocorrelation(dt_us: int) -> None:
    """tau = L/V = 0.25 s: along exp(-t/tau), across and down (1 - t/2tau) exp(-t/tau); any step, the same gusts."""
    effects = {
        "turbulence": {"sigma_mps": 1.5, "length_m": 2.5},
        "steady_wind": {"north_mps": 6.0, "east_mps": 8.0},
    }
    seconds = 1000 if dt_us > 5000 else 500
    wind, axis = gusts(effects, seconds, dt_us)
    along = wind[:, :2] @ axis
    across = wind[:, 1] * axis[0] - wind[:, 0] * axis[1]
    tau = 0.25
    for series, closed in (
        (along, lambda t: math.exp(-t / tau)),
        (across, lambda t: (1 - t / (2 * tau)) * math.exp(-t / tau)),
        (wind[:, 2], lambda t: (1 - t / (2 * tau)) * math.exp(-t / tau)),
    ):
        for lag_s in (0.0, 0.05, 0.1, 0.25, 0.5, 1.0):
            lag = round(lag_s * 1e6 / dt_us)
            found = np.mean(series[lag:] * series[: len(series) - lag]) / 1.5**2
            assert found == pytest.approx(closed(lag_s), abs=0.1)
    assert abs(np.mean(along * across)) < 0.15


def test_gusts_blow_along_north_in_still_air_and_are_repeated_by_their_seed() -> None:
    effects = {"turbulence": {"sigma_mps": 1.0, "length_m": 50.0}}
    winds = []
    for seed in (1, 1, 2):
        plant = NativePlant(quad(**effects), seed=seed)
        plant.run(OFF, 700)
        winds.append(plant.truth().wind_ned_mps)
    assert winds[0] == winds[1]
    assert winds[0] != winds[2]
    assert max(abs(w) for w in winds[0]) > 0.01


def test_effects_set_in_flight_act_from_then_on() -> None:
    """A payload dropped at 0.5 s: before it the heavy flight, after it the light one's acceleration."""
    plant = without_thrust_or_ground(quad(payload={"mass_kg": 0.3}))
    plant.motor_u[:] = 0.7
    plant.run(np.full(4, 0.7), 500)
    assert plant.specific_force_frd_mps2[2] == pytest.approx(-4 * 6.6 * 0.49 / 1.5)
    velocity = plant.vel_ned_mps.copy()
    plant.set_effect("payload", {"mass_kg": 0.0})
    assert np.array_equal(plant.vel_ned_mps, velocity)
    plant.run(np.full(4, 0.7), 1)
    assert plant.specific_force_frd_mps2[2] == pytest.approx(-4 * 6.6 * 0.49 / 1.2)
    plant.set_effect("gyro_bias", {"x_radps": 0.1})
    assert plant.gyro_bias_frd_radps.tolist() == [0.1, 0.0, 0.0]


@pytest.mark.parametrize(
    ("name", "values"), [("wings", {}), ("payload", {"mass": 1.0}), ("payload", {"mass_kg": math.nan})]
)
def test_an_impossible_event_is_refused_and_changes_nothing(name: str, values: dict[str, float]) -> None:
    plant, untouched = NativePlant(QUAD, seed=0), NativePlant(QUAD, seed=0)
    with pytest.raises(InputError, match="event"):
        plant.set_effect(name, values)
    for each in (plant, untouched):
        each.run(np.full(4, 0.8), 100)
    assert np.array_equal(plant._state, untouched._state)


@pytest.mark.parametrize(
    "effects",
    [
        {"linear_drag": {"d_x_kgps": 100.0}, "payload": {"mass_kg": -1.13}},
        {"angular_damping": {"k_x_nms": 10.0}, "inertia": {"scale_x": 0.5}},
        {"rotor_drag": {"k_d_kg_per_rad": 0.1}, "payload": {"mass_kg": -1.13}},
        {"induced_inflow": {"k_z_kg_per_rad": 0.1}, "payload": {"mass_kg": -1.13}},
        {"parasitic_drag": {"c_y_kg_per_m": 10.0}, "payload": {"mass_kg": -1.0}},
    ],
)
def test_damping_that_a_step_cannot_follow_is_refused_rather_than_flown_wrong(
    effects: dict[str, dict[str, float]],
) -> None:
    with pytest.raises(InputError, match=f"effects.{next(iter(effects))} is .* times what a 1 ms step can follow"):
        NativePlant(with_effects(QUAD, effects), seed=0)


@pytest.mark.parametrize(
    "effects",
    [
        {"linear_drag": {"d_x_kgps": 100.0, "d_y_kgps": 100.0, "d_z_kgps": 100.0}},
        {"parasitic_drag": {"c_x_kg_per_m": 10.0, "c_y_kg_per_m": 10.0, "c_z_kg_per_m": 10.0}},
        {"rotor_drag": {"k_d_kg_per_rad": 1e-4}, "induced_inflow": {"k_z_kg_per_rad": 2e-4}},
    ],
)
def test_the_strongest_damping_that_is_let_through_comes_to_rest(effects: dict[str, dict[str, float]]) -> None:
    plant = without_thrust_or_ground(quad(constant_force={"down_n": -1.2 * G}, **effects))
    plant.vel_ned_mps[:] = [40.0, -20.0, 20.0]
    plant.rate_frd_radps[:] = [5.0, 5.0, 5.0]
    speed = np.linalg.norm(plant.vel_ned_mps)
    for _ in range(100):
        plant.run(OFF, 10)
        now = np.linalg.norm(plant.vel_ned_mps)
        assert now <= speed
        speed = now


def test_start_is_at_rest_on_the_ground_facing_north_with_a_full_battery() -> None:
    truth = NativePlant(QUAD, seed=0).truth()
    assert truth.t_us == 0
    assert truth.pos_ned_m == truth.vel_ned_mps == truth.rate_frd_radps == (0.0, 0.0, 0.0)
    assert truth.q_ned_frd == (1.0, 0.0, 0.0, 0.0)
    assert truth.specific_force_frd_mps2 == pytest.approx((0.0, 0.0, -G))
    assert truth.motor_u == truth.rotor_thrust_n == (0.0,) * 4
    assert truth.battery_v == 16.8
    assert truth.on_ground


@pytest.mark.parametrize("s", [1e-7, 1e-5, 1e-3, 0.0099, 0.0101, 0.5, 3.0, 40.0])
def test_the_gust_filters_noise_of_one_step_is_the_integral_and_keeps_their_distribution_stationary(s: float) -> None:
    """Covariance 2 int_0^s exp(-2x) [[1, x], [x, x^2]] dx by SciPy; with the decay it restores the rest."""
    l11, l21, l22 = turbulence._noise_factors(s)
    found = np.array([[l11 * l11, l11 * l21], [l11 * l21, l21 * l21 + l22 * l22]])
    for power, value in ((0, found[0, 0]), (1, found[0, 1]), (2, found[1, 1])):
        integral = quadrature(lambda x, n=power: 2 * math.exp(-2 * x * s) * x**n, 0, 1, epsabs=0)[0] * s ** (power + 1)
        assert value == pytest.approx(integral, rel=1e-7)
    stationary = np.array([[1.0, 0.5], [0.5, 0.5]])
    decay = math.exp(-s) * np.array([[1.0, 0.0], [s, 1.0]])
    assert decay @ stationary @ decay.T + found == pytest.approx(stationary, abs=1e-12)


def test_gusts_start_from_their_stationary_distribution() -> None:
    """The map from normals to states, column by column: its square is the stationary covariance."""
    columns = np.zeros((5, 5))
    for k in range(5):
        row = np.zeros(S_RING)
        row[S_NORMALS + k] = 1.0
        turbulence.start(row)
        columns[:, k] = row[S_GUST : S_GUST + 5]
    block = np.array([[1.0, 0.5], [0.5, 0.5]])
    expected = np.zeros((5, 5))
    expected[0, 0] = 1.0
    expected[1:3, 1:3] = expected[3:5, 3:5] = block
    assert columns @ columns.T == pytest.approx(expected)


@pytest.mark.parametrize(
    ("radii", "strength", "times"),
    [(0.1, 1.0, 4 / 3), (0.5, 1.0, 4 / 3), (1.0, 1.0, 16 / 15), (2.0, 1.0, 64 / 63), (1.0, 20.0, 4.0), (9.0, 0.0, 1.0)],
)
def test_ground_effect_at_heights_worked_out_by_hand(radii: float, strength: float, times: float) -> None:
    """1 / (1 - s / 16 z^2) with z in radii: as at half a radius below that, four times the thrust at most."""
    row = parameter_row(quad(ground_effect={"strength": strength}), dt_us=1000)
    assert ground_effect.factor(row, 1.0, (0.0, 0.0, 0.0), radii * QUAD.rotors.radius_m) == pytest.approx(times)


def test_rotor_drag_at_a_hub_worked_out_by_hand() -> None:
    """-k_d W v across, nothing along the axis."""
    row = parameter_row(quad(rotor_drag={"k_d_kg_per_rad": 2e-4}), dt_us=1000)
    assert rotor_drag.hub_force(row, 500.0, (3.0, -2.0, 7.0)) == pytest.approx((-0.3, 0.2, 0.0))
