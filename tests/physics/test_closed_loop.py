"""Plant, sensors and control loops together: response, hold, landing, determinism."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flightstack.types import F64
from flightstack.vehicle import Vehicle, parse_vehicle, scaled, with_effects
from flightstack_sim.autopilot.params import ParamResult
from flightstack_sim.autopilot.setpoint import HOLD, LAND, NAN, OFF, ControlKind, ControlSetpoint
from flightstack_sim.grade import EstimateGrade, Grade, ImuGrade, load_grade
from flightstack_sim.simulated_vehicle import SimulatedVehicle, simulated_vehicle
from tests.recorded_px4 import latest, read_flight

ZERO = (0.0, 0.0, 0.0)
VEHICLES = Path(__file__).parents[2] / "flightstack/data/vehicles"
G = 9.80665


def vehicle(name: str) -> Vehicle:
    return parse_vehicle((VEHICLES / f"{name}.toml").read_text(), name)


QUAD, SIH = vehicle("quad-x"), vehicle("px4-sihsim-quadx")
NANO = parse_vehicle(
    """
schema = "flightstack.vehicle/1"
name = "nano"
[body]
mass_kg = 0.027
inertia_kgm2 = [1.6e-5, 1.6e-5, 2.9e-5]
[rotors]
position_m = [[0.0325, 0.0325, 0.0], [-0.0325, -0.0325, 0.0], [0.0325, -0.0325, 0.0], [-0.0325, 0.0325, 0.0]]
torque_ratio_m = [0.006, 0.006, -0.006, -0.006]
max_thrust_n = 0.15
max_speed_radps = 2500.0
thrust_model_factor = 0.6
time_constant_s = 0.05
radius_m = 0.023
""",
    "nano",
)


def perfect() -> Grade:
    """Sensors without errors."""
    estimate = EstimateGrade(ZERO, ZERO, 1.0, ZERO, 1.0, 0.0, 1.0, 0.0, 1.0)
    return replace(load_grade("mocap"), imu=ImuGrade(ZERO, ZERO, 0.0, 0.0, 0.0), estimate=estimate)


def takeoff(height_m: float = 5.0) -> ControlSetpoint:
    return ControlSetpoint(ControlKind.TAKEOFF, pos_ned_m=(NAN, NAN, -height_m))


def rates(rate: tuple[float, float, float], thrust: float) -> ControlSetpoint:
    return ControlSetpoint(ControlKind.RATE, rate_frd_radps=rate, thrust_norm=thrust)


def airborne(believed: Vehicle, truth: Vehicle, grade: Grade, *, seed: int = 0) -> SimulatedVehicle:
    """Taken off and holding."""
    flown = simulated_vehicle(believed, truth, grade, seed=seed)
    flown.advance(OFF, 40)
    flown.advance(takeoff(), 12_000)
    flown.advance(HOLD, 4_000)
    return flown


def rate_step(flown: SimulatedVehicle, axis: int, amplitude: float, ms: int) -> F64:
    """True rate about the axis over its setpoint, every millisecond from a hover."""
    rate = [0.0, 0.0, 0.0]
    rate[axis] = amplitude
    setpoint = rates((rate[0], rate[1], rate[2]), flown.params.get("MPC_THR_HOVER"))
    out = np.empty(ms)
    for k in range(ms):
        flown.advance(setpoint, 1)
        out[k] = flown.plant.rate_frd_radps[axis]
    return out / amplitude


def heavy_in_wind(believed: Vehicle) -> Vehicle:
    """1.5 times the believed mass, 0.15 g from the south."""
    truth = scaled(believed, mass_ratio=1.5)
    return with_effects(truth, {**truth.effects, "constant_force": {"north_n": 0.15 * 1.5 * believed.mass_kg * G}})


def land(flown: SimulatedVehicle, seconds: float = 20.0) -> float:
    """Fly the landing; returns its duration, fails when it doesn't end."""
    for k in range(round(seconds / 0.004)):
        flown.advance(LAND)
        if flown.landed:
            return 0.004 * k
    pytest.fail("not landed")


def test_a_roll_rate_step_on_sih_rises_as_measured_on_px4() -> None:
    """Measured: 90 % at about 0.13 s; here within 0.02 s, and less than 15 % overshoot."""
    response = rate_step(airborne(SIH, SIH, perfect()), 0, 1.0, 500)
    assert int(np.argmax(response >= 0.9)) * 1e-3 == pytest.approx(0.13, abs=0.02)
    assert response[:10].max() < 0.05
    assert response.max() < 1.15


@pytest.mark.recorded
def test_recorded_rate_setpoints_turn_sih_as_they_turned_px4s(recorded: Path) -> None:
    """25 s of doublets, thrust steps and a circle, against the recording's ground truth."""
    log, _ = read_flight(recorded)
    truth = log["vehicle_angular_velocity_groundtruth"]
    flown = airborne(SIH, SIH, perfect())
    times = range(12_000_000, 36_900_000, 4000)
    ours = np.empty((len(times), 3))
    for row, t in zip(ours, times, strict=True):
        asked = latest(log["vehicle_rates_setpoint"], t)
        rate = (float(asked["roll"]), float(asked["pitch"]), float(asked["yaw"]))
        flown.advance(rates(rate, -float(asked["thrust_body"][2])))
        row[:] = flown.plant.rate_frd_radps
    for axis in range(3):
        real = np.interp(times, truth["timestamp"], truth["xyz"][:, axis])
        assert np.corrcoef(ours[:, axis], real)[0, 1] > 0.99
        assert np.std(ours[:, axis] - real) < 0.12 * np.std(real)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("flown", [QUAD, SIH, NANO], ids=lambda v: v.name)
def test_a_rate_step_settles_without_oscillation(flown: Vehicle, axis: int) -> None:
    """At most one overshoot, below 20 %; from 0.4 s on within 10 % of the setpoint and hardly moving."""
    response = rate_step(airborne(flown, flown, perfect()), axis, 0.5, 700)
    assert response.max() < 1.2
    settled = response[400:]
    assert np.abs(settled - 1.0).max() < 0.1
    assert np.ptp(settled) < 0.08
    ups = np.diff(np.sign(np.diff(response[::10])))
    assert np.count_nonzero(ups[np.abs(np.diff(response[::10])[1:]) > 5e-3]) <= 2


def test_a_yaw_rate_step_settles_without_oscillation() -> None:
    response = rate_step(airborne(QUAD, QUAD, perfect()), 2, 0.5, 2500)
    assert response.max() < 1.25
    assert np.abs(response[1500:] - 1.0).max() < 0.1


@pytest.mark.parametrize(("grade", "hold_m"), [("mocap", 0.08), ("gps", 1.0)])
@pytest.mark.parametrize("truth", ["as believed", "heavy in wind"])
def test_it_takes_off_holds_goes_and_lands(grade: str, hold_m: float, truth: str) -> None:
    """Errors are of the true position; the bounds are a few times the grade's own errors."""
    flies = QUAD if truth == "as believed" else heavy_in_wind(QUAD)
    flown = airborne(QUAD, flies, load_grade(grade), seed=2)
    flown.advance(HOLD, 10_000)
    held = np.empty((1000, 3))
    for row in held:
        flown.advance(HOLD)
        row[:] = flown.plant.pos_ned_m
    assert np.abs(held[:, 2] + 5.0).max() < hold_m
    assert np.ptp(held[:, :2], axis=0).max() < 2.0 * hold_m
    goal = (4.0, -3.0, -4.0)
    flown.advance(ControlSetpoint(ControlKind.GOTO, pos_ned_m=goal, yaw_rad=1.0), 12_000)
    assert float(np.linalg.norm(flown.plant.pos_ned_m - goal)) < 2.0 * hold_m
    assert not flown.landed
    assert land(flown) < 15.0
    assert flown.plant.on_ground
    assert abs(float(flown.plant.q_ned_frd[1])) + abs(float(flown.plant.q_ned_frd[2])) < 0.03
    flown.advance(LAND, 2000)
    assert flown.landed
    assert flown.motor_command.max() < 1e-9


def test_landing_descends_at_its_parameters_speed() -> None:
    flown = airborne(QUAD, QUAD, perfect())
    assert flown.params.set("MPC_LAND_SPEED", 1.0) is ParamResult.OK
    flown.advance(LAND, 2000)
    assert float(flown.plant.vel_ned_mps[2]) == pytest.approx(1.0, abs=0.05)


def test_hold_stops_from_speed_and_stays_where_it_stopped() -> None:
    flown = airborne(QUAD, QUAD, perfect())
    flown.advance(ControlSetpoint(ControlKind.POSITION, pos_ned_m=(NAN, NAN, -5.0), vel_ned_mps=(3.0, 0.0, NAN)), 4000)
    assert float(flown.plant.vel_ned_mps[0]) == pytest.approx(3.0, abs=0.4)  # the velocity's integrator overshoots
    start = float(flown.plant.pos_ned_m[0])
    flown.advance(HOLD, 10_000)
    stopped = float(flown.plant.pos_ned_m[0])
    assert 1.0 < stopped - start < 4.0
    flown.advance(HOLD, 4000)
    assert float(flown.plant.pos_ned_m[0]) == pytest.approx(stopped, abs=0.1)


def test_an_attitude_setpoint_is_reached_and_yaw_follows() -> None:
    flown = airborne(QUAD, QUAD, perfect())
    half = 0.15
    q = (math.cos(half), 0.0, math.sin(half), 0.0)  # nose 0.3 rad up
    thrust = flown.params.get("MPC_THR_HOVER")
    flown.advance(ControlSetpoint(ControlKind.ATTITUDE, q_ned_frd=q, thrust_norm=thrust), 1500)
    assert abs(float(np.dot(flown.plant.q_ned_frd, q))) == pytest.approx(1.0, abs=1e-3)


def test_armed_without_a_wish_to_climb_it_stays_on_the_ground_with_motors_off() -> None:
    flown = simulated_vehicle(QUAD, QUAD, load_grade("gps"), seed=1)
    for setpoint in (HOLD, LAND, ControlSetpoint(ControlKind.POSITION, pos_ned_m=(0.0, 0.0, 1.0)), rates(ZERO, 0.0)):
        flown.advance(OFF, 40)
        flown.advance(setpoint, 5000)
        assert flown.landed
        assert flown.plant.on_ground
        assert flown.motor_command.max() < 0.01


def test_motors_spin_up_before_a_take_off_starts() -> None:
    flown = simulated_vehicle(QUAD, QUAD, perfect(), seed=1)
    flown.advance(OFF, 40)
    flown.advance(takeoff(), 980)
    np.testing.assert_array_equal(flown.motor_command, 0.0)
    flown.advance(takeoff(), 200)
    assert flown.motor_command.min() > 0.3
    assert flown.control.taking_off


def test_rate_offboard_lifts_off_hovers_and_lands_without_a_false_landing() -> None:
    """Hover thrust is not a landing in 10 s; 0.6 s at a third of it in flight neither; zero thrust on the ground is."""
    flown = simulated_vehicle(SIH, SIH, perfect(), seed=0)
    flown.advance(OFF, 40)
    hover = flown.params.get("MPC_THR_HOVER")
    flown.advance(rates(ZERO, 1.3 * hover), 1500)
    for _ in range(2500):
        flown.advance(rates(ZERO, hover))
        assert not flown.landed
    for _ in range(150):
        flown.advance(rates(ZERO, 0.33 * hover))
        assert not flown.landed
    flown.advance(rates(ZERO, 0.9 * hover), 4000)
    assert flown.plant.on_ground
    flown.advance(rates(ZERO, 0.0), 1500)
    assert flown.landed


def test_a_parameter_change_in_flight_acts_at_once() -> None:
    flown = airborne(SIH, SIH, perfect())
    slow = rate_step(flown, 0, 0.5, 60)[-1]
    flown.advance(HOLD, 6000)
    flown.params.set("MC_ROLLRATE_P", 0.4)
    assert rate_step(flown, 0, 0.5, 60)[-1] > 1.5 * slow


def test_disarming_stops_the_motors_within_a_millisecond_of_the_next_step() -> None:
    flown = airborne(QUAD, QUAD, perfect())
    assert flown.motor_command.min() > 0.3
    flown.advance(OFF, 1 + (-flown.t_us // 1000) % 4)
    np.testing.assert_array_equal(flown.motor_command, 0.0)


def test_nan_thrust_turns_the_motors_off() -> None:
    flown = airborne(QUAD, QUAD, perfect())
    flown.advance(rates(ZERO, math.nan), 4)
    np.testing.assert_array_equal(flown.motor_command, 0.0)


def flight_bytes(seed: int) -> bytes:
    flown = simulated_vehicle(QUAD, QUAD, load_grade("gps"), seed=seed)
    record = []
    for _ in range(750):
        flown.advance(takeoff(), 4)
        record += [flown.plant.pos_ned_m.tobytes(), flown.motor_command.tobytes(), repr(flown.estimate).encode()]
    return b"".join(record)


def test_the_same_seed_flies_the_same_bytes_and_another_seed_does_not() -> None:
    first = flight_bytes(5)
    assert first == flight_bytes(5)
    assert first != flight_bytes(6)
