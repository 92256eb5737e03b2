"""The equations of motion and their integration, against closed forms and SciPy."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from fleet import HIGH, QUAD, TYPICAL, matrix, quad, random_vehicle, set_random_state, without_thrust_or_ground
from oracle import G, State, accelerations
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from flightstack.effects.row import S_VOLTAGE
from flightstack.types import F64
from flightstack_sim.plant import NativePlant

OFF = np.zeros(4)


def test_a_body_that_falls_freely_follows_the_parabola() -> None:
    plant = without_thrust_or_ground()
    plant.vel_ned_mps[:] = [3.0, -2.0, -5.0]
    plant.run(OFF, 2000)
    t = 2.0
    assert plant.pos_ned_m == pytest.approx(HIGH + np.array([3.0 * t, -2.0 * t, -5.0 * t + 0.5 * G * t**2]), abs=1e-9)
    assert plant.vel_ned_mps == pytest.approx([3.0, -2.0, -5.0 + G * t], abs=1e-11)
    assert plant.specific_force_frd_mps2 == pytest.approx([0, 0, 0], abs=1e-13)


def skew(v: F64) -> F64:
    """The matrix of v x."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def tumbling(t_end: float, omega0: F64, rot0: F64, inertia: F64) -> tuple[F64, F64]:
    """Euler's equations with a rotation matrix, by SciPy's DOP853: rates and matrix at the end."""

    def slope(_: float, y: F64) -> F64:
        omega, rot = y[:3], y[3:].reshape(3, 3)
        return np.concatenate([-np.cross(omega, inertia * omega) / inertia, (rot @ skew(omega)).ravel()])

    start = np.concatenate([omega0, rot0.ravel()])
    solution = solve_ivp(slope, (0, t_end), start, method="DOP853", rtol=1e-12, atol=1e-13)
    return solution.y[:3, -1], solution.y[3:, -1].reshape(3, 3)


def test_torque_free_tumbling_follows_eulers_equations_as_scipy_solves_them() -> None:
    plant = without_thrust_or_ground()
    plant.rate_frd_radps[:] = [6.0, 0.05, -4.0]
    rates, rot = tumbling(3.0, plant.rate_frd_radps.copy(), np.eye(3), QUAD.inertia_kgm2)
    plant.run(OFF, 3000)
    assert plant.rate_frd_radps == pytest.approx(rates, abs=1e-8)
    assert matrix(plant.q_ned_frd) == pytest.approx(rot, abs=1e-8)


def test_torque_free_tumbling_keeps_energy_and_angular_momentum_for_a_minute() -> None:
    plant = without_thrust_or_ground()
    plant.rate_frd_radps[:] = [5.0, -3.0, 4.0]
    inertia = QUAD.inertia_kgm2

    def energy() -> float:
        return 0.5 * float(np.sum(inertia * plant.rate_frd_radps**2))

    def momentum() -> F64:
        return matrix(plant.q_ned_frd) @ (inertia * plant.rate_frd_radps)

    energy0, momentum0 = energy(), momentum()
    plant.run(OFF, 60_000)
    assert energy() == pytest.approx(energy0, rel=1e-8)
    assert momentum() == pytest.approx(momentum0, rel=1e-6)


def test_the_quaternion_keeps_its_norm_through_a_minute_of_wild_flight() -> None:
    plant = without_thrust_or_ground()
    plant.rate_frd_radps[:] = [20.0, -13.0, 14.0]
    for _ in range(60):
        plant.run(np.array([0.9, 0.2, 0.5, 0.7]), 1000)
        assert np.linalg.norm(plant.q_ned_frd) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize(("axis", "rotated"), [(0, [0, 0, 1]), (1, [0, 0, 0]), (2, [0, 1, 0])])
def test_a_second_at_90_degrees_a_second_turns_by_90_degrees(axis: int, rotated: list[float]) -> None:
    """About a principal axis: the quaternion is (cos 45, sin 45 on that axis); body y then points as by hand."""
    plant = without_thrust_or_ground()
    plant.rate_frd_radps[axis] = math.pi / 2
    plant.run(OFF, 1000)
    expected = np.zeros(4)
    expected[0] = expected[1 + axis] = math.sqrt(0.5)
    assert plant.q_ned_frd == pytest.approx(expected, abs=1e-12)
    east_of_body = matrix(plant.q_ned_frd) @ [
        0.0,
        1.0,
        0.0,
    ]  # rolled right: right wing down; yawed right: it points south
    by_hand = {0: [0, 0, 1], 1: [0, 1, 0], 2: [-1, 0, 0]}[axis]
    assert east_of_body == pytest.approx(by_hand, abs=1e-12)


@pytest.mark.parametrize(
    ("rpy_deg", "direction"),
    [((0, 0, 0), (0, 0, -1)), ((30, 0, 0), (0, 0.5, -0.8660254)), ((0, 30, 0), (-0.5, 0, -0.8660254)),
     ((0, -30, 90), (0, 0.5, -0.8660254)), ((180, 0, 0), (0, 0, 1))],
)  # fmt: skip
def test_thrust_pushes_where_the_attitude_points_it(rpy_deg: tuple[float, ...], direction: tuple[float, ...]) -> None:
    """Roll right: to the east; nose up: to the south; facing east, nose down: to the east; upside down: down."""
    plant = without_thrust_or_ground()
    plant.q_ned_frd[:] = np.roll(Rotation.from_euler("ZYX", rpy_deg[::-1], degrees=True).as_quat(), 1)
    plant.motor_u[:] = 0.5
    plant.run(np.full(4, 0.5), 1)
    thrust = 4 * 6.6 * 0.5**2
    expected = np.array(direction) * thrust / 1.2 + [0, 0, G]
    assert plant.vel_ned_mps / 1e-3 == pytest.approx(expected, abs=1e-6)
    assert plant.specific_force_frd_mps2 == pytest.approx([0, 0, -thrust / 1.2])


@pytest.mark.parametrize(
    ("rotor", "signs"), [(0, (-1, 1, 1)), (1, (1, -1, 1)), (2, (1, 1, -1)), (3, (-1, -1, -1))]
)  # fmt: skip
def test_each_rotor_turns_the_vehicle_as_its_place_says(rotor: int, signs: tuple[int, ...]) -> None:
    """Front right lifts the right side (roll left) and the nose; its reaction turns right as the file's sign says."""
    plant = without_thrust_or_ground()
    plant.motor_u[rotor] = 0.5
    plant.evaluate()
    expected = np.array(signs) * 6.6 * 0.25 * np.array([0.16, 0.13, 0.015]) / QUAD.inertia_kgm2
    assert plant.angular_acceleration_frd_radps2 == pytest.approx(expected)


def test_gyroscopic_terms_do_no_work() -> None:
    """Neither omega x I omega nor the spinning rotors change the energy of rotation: omega . I omega' = omega . tau."""
    rng = np.random.default_rng(1)
    plain, spinning = (
        without_thrust_or_ground(QUAD),
        without_thrust_or_ground(quad(rotor_gyroscopic=TYPICAL["rotor_gyroscopic"])),
    )
    for _ in range(50):
        set_random_state(plain, rng)
        spinning._state[:] = plain._state
        still = plain._state.copy()
        accelerations_of = []
        for plant in (plain, spinning):
            plant.evaluate()
            accelerations_of.append(plant.angular_acceleration_frd_radps2.copy())
        omega = plain.rate_frd_radps.copy()
        plain._state[:] = still
        plain.rate_frd_radps[:] = 0.0
        plain.evaluate()
        torque = QUAD.inertia_kgm2 * plain.angular_acceleration_frd_radps2
        for acceleration in accelerations_of:
            assert omega @ (QUAD.inertia_kgm2 * acceleration) == pytest.approx(omega @ torque, abs=1e-11)
        assert np.abs(accelerations_of[0] - accelerations_of[1]).max() > 1e-4


def reference_flight(vehicle_effects: dict[str, dict[str, float]], t_end: float, command: F64, y0: F64) -> F64:
    """pos, vel, rotation matrix, rates after t_end by DOP853 on the independent equations; motors from rest."""
    vehicle = quad(**vehicle_effects)
    tau = vehicle.rotors.time_constant_s

    def slope(t: float, y: F64) -> F64:
        rot = y[6:15].reshape(3, 3)
        u = command * (1.0 - math.exp(-t / tau))
        wind = np.array([4.0, -3.0, 0.5]) if "steady_wind" in vehicle_effects else np.zeros(3)
        state = State(y[:3], y[3:6], rot, y[15:], u, wind, 16.6)
        force, angular = accelerations(vehicle, state)
        return np.concatenate([y[3:6], rot @ force + [0, 0, G], (rot @ skew(y[15:])).ravel(), angular])

    return solve_ivp(slope, (0, t_end), y0, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]


SMOOTH = (
    "linear_drag",
    "angular_damping",
    "rotor_drag",
    "parasitic_drag",
    "rotor_gyroscopic",
    "com_offset",
    "steady_wind",
)
UNEVEN = np.array([0.70, 0.72, 0.69, 0.73])


def flight_error(dt_us: int, expected: F64, effects: dict[str, dict[str, float]]) -> float:
    plant = without_thrust_or_ground(quad(**effects), dt_us=dt_us)
    plant.rate_frd_radps[:] = [3.0, -2.0, 1.0]
    plant.vel_ned_mps[:] = [5.0, 2.0, -1.0]
    plant.run(UNEVEN, 640_000 // dt_us)
    reached = np.concatenate(
        [plant.pos_ned_m, plant.vel_ned_mps, matrix(plant.q_ned_frd).ravel(), plant.rate_frd_radps]
    )
    return float(np.abs(reached - expected).max())


def test_free_flight_is_integrated_to_fourth_order_and_agrees_with_scipy() -> None:
    """Halving the step divides the error by 16: tumbling, lagging motors, drag and wind, against DOP853."""
    effects = {name: TYPICAL[name] for name in SMOOTH}
    y0 = np.concatenate([HIGH, [5.0, 2.0, -1.0], np.eye(3).ravel(), [3.0, -2.0, 1.0]])
    expected = reference_flight(effects, 0.64, UNEVEN, y0)
    errors = [flight_error(dt_us, expected, effects) for dt_us in (8000, 4000, 2000)]
    orders = [math.log2(errors[0] / errors[1]), math.log2(errors[1] / errors[2])]
    assert min(orders) > 3.7
    assert max(orders) < 4.6
    assert flight_error(1000, expected, effects) < 1e-6


def test_random_vehicles_with_random_effects_accelerate_as_the_independent_equations_say() -> None:
    rng = np.random.default_rng(2)
    for _ in range(200):
        vehicle = random_vehicle(rng)
        vehicle = dataclasses.replace(
            vehicle, effects={k: v for k, v in vehicle.effects.items() if k not in ("slung_load", "turbulence")}
        )
        plant = NativePlant(vehicle, seed=0, ground=False)
        set_random_state(plant, rng, height_m=rng.uniform(0.02, 3.0))
        plant._state[0, S_VOLTAGE] = rng.uniform(13.0, 17.0)
        plant.evaluate()
        truth = plant.truth()
        wind = np.array(
            [vehicle.effects.get("steady_wind", {}).get(k, 0.0) for k in ("north_mps", "east_mps", "down_mps")]
        )
        state = State(plant.pos_ned_m, plant.vel_ned_mps, matrix(plant.q_ned_frd), plant.rate_frd_radps,
                      plant.motor_u, wind, truth.battery_v)  # fmt: skip
        force, angular = accelerations(vehicle, state)
        assert plant.specific_force_frd_mps2 == pytest.approx(force, rel=1e-10, abs=1e-10)
        assert plant.angular_acceleration_frd_radps2 == pytest.approx(angular, rel=1e-10, abs=1e-9)
        assert truth.wind_ned_mps == pytest.approx(wind)


def turned(plant: NativePlant, yaw_rad: float) -> tuple[F64, F64, F64, F64]:
    turn = Rotation.from_euler("Z", yaw_rad)
    attitude = turn.as_matrix() @ matrix(plant.q_ned_frd)
    return turn.apply(plant.pos_ned_m), turn.apply(plant.vel_ned_mps), attitude, plant.rate_frd_radps.copy()


def test_turning_vehicle_wind_and_force_together_turns_the_whole_flight() -> None:
    """Physics knows no north: all effects on, gusts included (they are tied to the wind), and touching the ground."""
    yaw = 1.1
    c, s = math.cos(yaw), math.sin(yaw)

    def world(table: dict[str, float], north: str, east: str) -> dict[str, float]:
        return {**table, north: c * table[north] - s * table[east], east: s * table[north] + c * table[east]}

    there = dict(TYPICAL)
    there["steady_wind"] = world(TYPICAL["steady_wind"], "north_mps", "east_mps")
    there["constant_force"] = world(TYPICAL["constant_force"], "north_n", "east_n")
    here_plant, there_plant = NativePlant(quad(**TYPICAL), seed=3), NativePlant(quad(**there), seed=3)
    there_plant.q_ned_frd[:] = [math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)]
    for command in (np.full(4, 0.3), np.array([0.8, 0.82, 0.81, 0.79]), np.full(4, 0.6)):
        for plant in (here_plant, there_plant):
            plant.run(command, 300)
        for ours, expected in zip(turned(there_plant, 0.0), turned(here_plant, yaw), strict=True):
            assert ours == pytest.approx(expected, abs=1e-8)
        assert there_plant.specific_force_frd_mps2 == pytest.approx(here_plant.specific_force_frd_mps2, abs=1e-8)


def test_hover_thrust_holds_the_vehicle_where_it_is() -> None:
    plant = without_thrust_or_ground()
    u = math.sqrt(QUAD.weight_n / QUAD.max_total_thrust_n)
    plant.motor_u[:] = u
    plant.run(np.full(4, u), 10_000)
    assert plant.pos_ned_m == pytest.approx(HIGH, abs=1e-9)
    assert plant.specific_force_frd_mps2 == pytest.approx([0, 0, -G])


@pytest.mark.parametrize("bad", [math.nan, -math.inf, -0.5])
def test_a_command_that_is_no_number_or_below_zero_stops_its_motor_and_nothing_else(bad: float) -> None:
    plant = without_thrust_or_ground()
    plant.motor_u[:] = 0.6
    plant.run(np.array([bad, 0.6, 0.6, 0.6]), 1000)
    truth = plant.truth()
    assert truth.motor_u[0] == pytest.approx(0.0, abs=1e-12)
    assert truth.motor_u[1:] == pytest.approx((0.6, 0.6, 0.6))
    assert np.isfinite(plant._state).all()


@pytest.mark.parametrize("much", [1.0, 1.5, math.inf])
def test_a_command_above_one_is_full_thrust(much: float) -> None:
    plant = without_thrust_or_ground()
    plant.run(np.full(4, much), 1000)
    assert plant.truth().rotor_thrust_n == pytest.approx([6.6] * 4)


def test_a_step_moves_the_vehicle_as_the_evaluated_accelerations_say() -> None:
    """`evaluate` without a step and the mean over a short step are the same to first order in the step."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        plant = NativePlant(quad(**{**TYPICAL, "transport_delay": {}}), seed=0, dt_us=100, ground=False)
        set_random_state(plant, rng)
        plant.evaluate()
        force, angular = plant.specific_force_frd_mps2.copy(), plant.angular_acceleration_frd_radps2.copy()
        plant.step(plant.motor_u)
        assert plant.specific_force_frd_mps2 == pytest.approx(force, abs=0.1)
        assert plant.angular_acceleration_frd_radps2 == pytest.approx(angular, abs=0.4)
