"""The hover thrust estimate: what carries the vehicle, in every mode, and what a landing gains by it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from station import vehicle_file

from flightstack.autopilot import hover_command
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import scaled, with_effects
from flightstack_sim.autopilot.hover_thrust import HoverThrust
from flightstack_sim.autopilot.params import Params
from flightstack_sim.autopilot.position_control import PositionControl
from flightstack_sim.autopilot.setpoint import LAND, ControlKind, ControlSetpoint
from flightstack_sim.grade import load_grade
from flightstack_sim.simulated_vehicle import SimulatedVehicle, simulated_vehicle

DT_S = 0.008
UP = ControlSetpoint(ControlKind.TAKEOFF, pos_ned_m=(math.nan, math.nan, -3.0))


def state(*, down: float = -3.0, roll: float = 0.0, acc_down: float = 0.0) -> F64:
    q = [math.cos(0.5 * roll), math.sin(0.5 * roll), 0.0, 0.0]
    return np.array([0.0, 0.0, down, 0.0, 0.0, 0.0, *q, 0.0, 0.0, acc_down])


def airborne(thrust: float, seconds: float, x: F64) -> HoverThrust:
    estimate = HoverThrust(Params(), DT_S)
    estimate.update(0.0, state(down=0.0), landed=True)
    for _ in range(round(seconds / DT_S)):
        estimate.update(thrust, x, landed=False)
    return estimate


def test_it_follows_a_steady_hover_with_two_seconds_of_lag() -> None:
    """First-order: MPC_THR_HOVER is 0.5, so 0.5 + 0.2 (1 - exp(-t / 2 s))."""
    for seconds in (1.0, 2.0, 6.0):
        expected = 0.7 - 0.2 * math.exp(-seconds / 2.0)
        assert airborne(0.7, seconds, state()).value == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("roll", [0.0, 0.5])
@pytest.mark.parametrize("up", [-3.0, 0.0, 5.0])
def test_acceleration_and_tilt_do_not_count_as_weight(roll: float, up: float) -> None:
    """T cos(roll) = hover (1 + up / g)."""
    thrust = 0.4 * (1.0 + up / STANDARD_GRAVITY_MPS2) / math.cos(roll)
    assert airborne(thrust, 30.0, state(roll=roll, acc_down=-up)).value == pytest.approx(0.4, abs=1e-3)


def test_on_the_ground_and_just_above_it_stays_the_parameter() -> None:
    assert airborne(0.3, 5.0, state(down=-0.3)).value == pytest.approx(0.5)
    estimate = airborne(0.8, 5.0, state())
    estimate.update(0.0, state(down=0.0), landed=True)
    assert estimate.value == pytest.approx(0.5)


def test_nothing_takes_it_out_of_its_range() -> None:
    for thrust in (0.0, 1.0, math.nan, math.inf, -5.0):
        for acc_down in (-100.0, 9.8, 100.0, math.nan):
            assert 0.1 <= airborne(thrust, 30.0, state(acc_down=acc_down)).value <= 0.9


def test_a_new_hover_thrust_does_not_jerk_the_position_loop() -> None:
    """The same errors give the same thrust in the step after the change, bar the integral's own step."""
    loop = PositionControl(Params())
    loop.limits[:] = 12.0, 3.0, 1.5, math.radians(45.0)
    loop.setpoint[:3], loop.setpoint[9] = (0.0, 0.0, -0.1), 0.0
    x = state(down=0.0)
    for _ in range(5):
        loop.step(x)
    before = float(loop.thrust[0])
    loop.step(x)
    usual = float(loop.thrust[0]) - before
    loop.use_hover_thrust(0.7)
    loop.step(x)
    assert float(loop.thrust[0]) - before - usual == pytest.approx(1.4 * usual, rel=0.01)


def rate_mode_hover(vehicle: SimulatedVehicle, seconds: float) -> None:
    """Body rates from a stiff attitude and height loop of the client's own, level."""
    integral = 0.0
    for _ in range(round(seconds / 0.004)):
        e = vehicle.estimate
        _, x, y, _ = e.q_ned_frd
        climb = 1.0 * (-3.0 - e.pos_ned_m[2]) - e.vel_ned_mps[2]
        integral += 0.004 * climb
        thrust = min(max(0.5 - 0.15 * climb - 0.1 * integral, 0.1), 0.95)
        vehicle.advance(ControlSetpoint(ControlKind.RATE, (-12.0 * x, -12.0 * y, 0.0), thrust))


def test_landing_out_of_a_rate_mode_hover_is_gentle_with_a_mass_that_nobody_knows() -> None:
    """1.4 times the mass and a tenth of the believed weight of push; MPC_LAND_SPEED is 0.7 m/s."""
    believed = vehicle_file("px4-sihsim-quadx")
    push_n = 0.1 * believed.weight_n
    truth = with_effects(scaled(believed, mass_ratio=1.4), {"constant_force": {"north_n": push_n}})
    vehicle = simulated_vehicle(believed, truth, load_grade("mocap"), seed=1)
    for _ in range(1500):
        vehicle.advance(UP)
    rate_mode_hover(vehicle, 8.0)
    assert 2.0 < -vehicle.plant.pos_ned_m[2] < 4.0
    # the plant's static curve makes thrust proportional to the command
    assert vehicle.control.hover_thrust.value == pytest.approx(1.4 * hover_command(believed), rel=0.03)
    fastest_near_ground = 0.0
    for _ in range(4000):
        vehicle.advance(LAND)
        if vehicle.plant.on_ground:
            break
        if -vehicle.plant.pos_ned_m[2] < 0.3:
            fastest_near_ground = max(fastest_near_ground, float(vehicle.plant.vel_ned_mps[2]))
    assert vehicle.plant.on_ground
    assert 0.4 < fastest_near_ground <= 0.8
