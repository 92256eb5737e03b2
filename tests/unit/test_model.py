"""The controller's model against closed forms, SciPy's linear systems and PX4's measured allocation."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from shipped import load_vehicle

from flightstack.certificate_check.samples import Believed
from flightstack.gap.evaluated import evaluate_at
from flightstack.gap.simulate import params_row
from flightstack.model import MC_RATE_D, MC_RATE_P, Limiter, Limits, Model, thrust_to_norm
from flightstack.types import InputError
from flightstack.vehicle import parse_vehicle, scaled, vehicle_to_toml, with_effects


@settings(deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.1, 1e4))
def test_the_inverted_thrust_curve_gives_the_command_back(command: float, factor: float, max_thrust: float) -> None:
    thrust = max_thrust * (factor * command**2 + (1.0 - factor) * command)
    assert thrust_to_norm(thrust, max_thrust, factor) == pytest.approx(command, abs=2e-8)


def test_thrust_beyond_the_curve_is_clipped() -> None:
    assert thrust_to_norm(-1.0, 10.0, 0.5) == 0.0
    assert thrust_to_norm(11.0, 10.0, 0.5) == 1.0
    assert thrust_to_norm(math.inf, 10.0, 0.0) == 1.0


def test_a_linear_vehicle_hovers_at_its_weight_over_four_times_a_rotors_thrust() -> None:
    model = Model.from_vehicle(load_vehicle("px4-sihsim-quadx"))
    assert model.hover_norm == pytest.approx(1.0 * 9.80665 / (4 * 5.0))
    assert model.drag_kgps == (1.0, 1.0, 1.0)
    assert model.motor_lag_s == 0.048


def test_a_quadratic_vehicle_hovers_at_the_square_root_of_its_share() -> None:
    model = Model.from_vehicle(load_vehicle("quad-x"))
    assert model.hover_norm == pytest.approx(math.sqrt(1.2 * 9.80665 / 26.4))
    assert model.thrust_of(model.hover_norm) == pytest.approx(1.2 * 9.80665)


def test_effects_that_the_model_can_express_are_in_its_numbers_and_the_others_are_listed_in_order() -> None:
    vehicle = with_effects(
        load_vehicle("quad-x"),
        {
            "rotor_drag": {"k_d_kg_per_rad": 1e-4},
            "payload": {"mass_kg": 0.3},
            "thrust_scale": {"scale": 0.9},
            "thrust_curve": {"thrust_model_factor": 0.4},
            "motor_lag": {"time_constant_s": 0.05},
            "transport_delay": {"delay_s": 0.01},
            "linear_drag": {"d_x_kgps": 0.2, "d_y_kgps": 0.3, "d_z_kgps": 0.4},
            "com_offset": {"x_m": 0.01},
        },
    )
    model = Model.from_vehicle(vehicle)
    assert model.mass_kg == pytest.approx(1.5)
    assert model.max_thrust_n == pytest.approx(0.9 * 26.4)
    assert model.thrust_model_factor == 0.4
    assert (model.motor_lag_s, model.transport_delay_s) == (0.05, 0.01)
    across = 1e-4 * 4.0 * vehicle.rotors.max_speed_radps * math.sqrt(1.5 * 9.80665 / (0.9 * 26.4))
    assert model.drag_kgps == pytest.approx((0.2 + across, 0.3 + across, 0.4))
    assert model.left_to_learner == ("com_offset",)


def test_the_rotors_drag_in_hover_and_the_parasitic_one_at_2_mps_are_what_the_plant_feels() -> None:
    """The simulator's specific force at hover's command, at 2 m/s along each axis less that at rest."""
    effects = {
        "rotor_drag": {"k_d_kg_per_rad": 2e-4},
        "induced_inflow": {"k_z_kg_per_rad": 3e-4},
        "parasitic_drag": {"c_x_kg_per_m": 0.05, "c_y_kg_per_m": 0.06, "c_z_kg_per_m": 0.08},
    }
    vehicle = with_effects(load_vehicle("quad-x"), effects)
    model = Model.from_vehicle(vehicle)
    vel, level = np.vstack([np.zeros(3), 2.0 * np.eye(3)]), np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    pos, load = np.tile([0.0, 0.0, -50.0], (4, 1)), np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (4, 1))
    u, out = np.full((4, 4), model.hover_norm), np.empty((4, 6, 1))
    row = params_row(vehicle, 0.001)[None]
    evaluate_at(row, np.hstack((pos, vel, level, np.zeros((4, 3)), load)), u, np.zeros(4), out)
    felt = np.diag(out[1:, :3, 0] - out[0, :3, 0])
    assert felt == pytest.approx(-2.0 * np.array(model.drag_kgps) / model.mass_kg, rel=1e-6)
    checker = Believed.of(tomllib.loads(vehicle_to_toml(vehicle)))
    assert checker.drag_kgps == pytest.approx(model.drag_kgps)


def test_the_rate_lag_of_px4s_own_simulator_follows_from_its_measured_torque() -> None:
    """A unit roll command accelerates PX4's default simulated quad by 113 rad/s^2 (2.83 N m on 0.025 kg m^2)."""
    model = Model.from_vehicle(load_vehicle("px4-sihsim-quadx"))
    assert model.rate_lag_s == pytest.approx((1.0 + 113.1 * 0.003) / (113.1 * 0.15), rel=2e-3)


def test_the_rate_lag_is_how_far_the_rate_loop_trails_a_ramp() -> None:
    """SciPy: closed loop a P / (tau s^2 + (1 + a D) s + a P), without integrator, after its transient."""
    a, tau = 113.137, 0.05
    loop = signal.TransferFunction([a * MC_RATE_P], [tau, 1.0 + a * MC_RATE_D, a * MC_RATE_P])
    t = np.linspace(0.0, 3.0, 3001)
    _, rate, _ = signal.lsim(loop, t, t)
    model = Model.from_vehicle(load_vehicle("px4-sihsim-quadx"))
    assert t[-1] - rate[-1] == pytest.approx(model.rate_lag_s, rel=1e-3)


def test_more_inertia_makes_the_rate_loop_slower() -> None:
    vehicle = load_vehicle("quad-x")
    heavy = with_effects(vehicle, {"inertia": {"scale_x": 2.0, "scale_y": 2.0}})
    assert Model.from_vehicle(heavy).rate_lag_s > Model.from_vehicle(vehicle).rate_lag_s


def test_a_vehicle_that_cannot_hover_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"vehicle quad-x: .* cannot fly .*rotors\.max_thrust_n"):
        Model.from_vehicle(scaled(load_vehicle("quad-x"), mass_ratio=2.3))


def test_the_thrust_range_is_in_weights_and_never_beyond_the_rotors() -> None:
    model = Model.from_vehicle(load_vehicle("quad-x"))
    low, high = model.thrust_range_n(Limits(thrust_max_weights=1.8, thrust_min_weights=0.1))
    assert (low, high) == pytest.approx((0.1 * model.weight_n, 1.8 * model.weight_n))
    assert model.thrust_range_n(Limits(thrust_max_weights=5.0))[1] == pytest.approx(26.4)


def test_the_limiter_cuts_thrust_and_rates_and_leaves_nan_to_the_guard() -> None:
    model, limits = Model.from_vehicle(load_vehicle("quad-x")), Limits(rate_max_radps=(3.0, 3.0, 1.0))
    command, cut = Limiter(model, limits).limit(1000.0, np.array([5.0, -5.0, 0.5]), 7)
    assert cut
    assert command.t_us == 7
    assert command.thrust_n == pytest.approx(1.8 * model.weight_n)
    assert model.thrust_of(command.thrust_norm) == pytest.approx(command.thrust_n)
    np.testing.assert_array_equal(command.rate_frd_radps, [3.0, -3.0, 0.5])
    command, cut = Limiter(model, limits).limit(model.weight_n, np.zeros(3), 7)
    assert not cut
    assert command.thrust_n == model.weight_n
    command, _ = Limiter(model, limits).limit(math.nan, np.array([math.nan, 0.0, 0.0]), 7)
    assert math.isnan(command.thrust_n)
    assert math.isnan(command.rate_frd_radps[0])


@pytest.mark.recorded
def test_the_recorded_px4_vehicle_file_is_the_one_that_is_shipped(recorded: Path) -> None:
    vehicle = parse_vehicle((recorded / "px4_sih.toml").read_text(), "px4_sih.toml")
    assert Model.from_vehicle(vehicle) == Model.from_vehicle(load_vehicle("px4-sihsim-quadx"))
