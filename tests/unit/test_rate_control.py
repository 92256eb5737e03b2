"""The body-rate loop against PX4's own torques, SciPy's filters and the loop's stated rules."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from flightstack.autopilot import LOOP_GAIN_MAX, angular_acceleration_per_torque, hover_command, phase_margin_deg
from flightstack.rate_loop import butterworth2, first_order_alpha
from flightstack.types import F64
from flightstack.vehicle import Vehicle, parse_vehicle, with_effects
from flightstack_sim.autopilot.flight_control import airframe_params
from flightstack_sim.autopilot.params import Params
from flightstack_sim.autopilot.rate_control import RateControl
from tests.recorded_px4 import latest, read_flight

VEHICLES = Path(__file__).parents[2] / "flightstack/data/vehicles"
GAINS = ("MC_ROLLRATE_K", "MC_PITCHRATE_K", "MC_YAWRATE_K")


def vehicle(name: str) -> Vehicle:
    return parse_vehicle((VEHICLES / f"{name}.toml").read_text(), name)


SIH = vehicle("px4-sihsim-quadx")


def loop(params: Params | None = None, dt_s: float = 0.001) -> RateControl:
    return RateControl(SIH, params or Params(), dt_s)


def run(control: RateControl, gyro: tuple[float, float, float], steps: int) -> F64:
    sample = np.array(gyro)
    for _ in range(steps):
        control.step(sample)
    return control.torque.copy()


@pytest.mark.parametrize("cutoff_hz", [5.0, 40.0, 200.0])
def test_the_gyro_low_pass_is_scipys_butterworth(cutoff_hz: float) -> None:
    b, a = signal.butter(2, cutoff_hz, fs=1000.0)
    np.testing.assert_allclose(butterworth2(cutoff_hz, 1000.0), [*b, *a[1:]], rtol=1e-12)


def test_the_gyro_passes_through_that_filter_and_starts_settled() -> None:
    control = loop()
    noise = np.random.default_rng(0).normal((5.0, -3.0, 0.5), 1.0, (400, 3))
    b, a = signal.butter(2, 40.0, fs=1000.0)
    expected = np.stack([signal.lfilter(b, a, x, zi=signal.lfilter_zi(b, a) * x[0])[0] for x in noise.T], axis=1)
    ours = []
    for sample in noise:
        control.step(sample)
        ours.append(control.rate_frd_radps.copy())
    np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-12)


def test_cut_offs_of_zero_mean_no_filter() -> None:
    assert butterworth2(0.0, 1000.0) == (1.0, 0.0, 0.0, 0.0, 0.0)
    assert first_order_alpha(0.0, 0.001) == 1.0


@pytest.mark.recorded
def test_torques_follow_those_a_real_px4_computed_from_the_same_rates(recorded: Path) -> None:
    """Fed PX4's filtered rates and setpoints at its 250 Hz; what error is left comes from the log's gaps."""
    log, values = read_flight(recorded)
    params = Params()
    for name in (n for n in values if n.startswith("MC_") and params.set(n, values[n][1]).name == "OK"):
        assert params.get(name) == values[name][1]
    params.set("IMU_GYRO_CUTOFF", 0.0)  # the recorded rates are filtered already
    control = RateControl(SIH, params, 0.004)
    rates, torque = log["vehicle_angular_velocity"], log["vehicle_torque_setpoint"]
    integrals = log["rate_ctrl_status"]
    torque_at = {int(t): i for i, t in enumerate(torque["timestamp_sample"])}
    ours, real, acceleration, real_acceleration = [], [], [], []
    for i in range(*np.searchsorted(rates["timestamp"], [11_600_000, 40_900_000]).tolist()):
        t = int(rates["timestamp"][i])
        target = latest(log["vehicle_rates_setpoint"], t - 1)  # the attitude loop runs after the rate loop
        rate = (float(target["roll"]), float(target["pitch"]), float(target["yaw"]))
        control.set_target(rate, -float(target["thrust_body"][2]), armed=True, hold_integral=False)
        if t <= 12_000_000:
            row = latest(integrals, t)
            control.integral[:] = row["rollspeed_integ"], row["pitchspeed_integ"], row["yawspeed_integ"]
        control.step(rates["xyz"][i].astype(float))
        if t > 12_000_000 and t in torque_at:
            ours.append(control.torque.copy())
            real.append(torque["xyz"][torque_at[t]].astype(float))
            acceleration.append(control.angular_acceleration_frd_radps2.copy())
            real_acceleration.append(rates["xyz_derivative"][i].astype(float))
    assert len(ours) > 7000
    error = np.sqrt(np.mean((np.array(ours) - real) ** 2, axis=0)) / np.sqrt(np.mean(np.square(real), axis=0))
    assert error.max() < 0.04
    error = np.std(np.array(acceleration) - real_acceleration, axis=0) / np.std(real_acceleration, axis=0)
    assert error.max() < 0.03


def test_proportional_and_derivative_act_at_once_with_k_times_their_gain() -> None:
    params = Params({"MC_ROLLRATE_K": 0.5, "MC_ROLLRATE_I": 0.0, "IMU_GYRO_CUTOFF": 0.0, "IMU_DGYRO_CUTOFF": 0.0})
    control = loop(params)
    control.set_target((1.0, 0.0, 0.0), 0.5, armed=True, hold_integral=False)
    assert run(control, (0.0, 0.0, 0.0), 1)[0] == pytest.approx(0.5 * 0.15)
    assert run(control, (0.1, 0.0, 0.0), 1)[0] == pytest.approx(0.5 * (0.15 * 0.9 - 0.003 * 0.1 / 0.001))


def test_feed_forward_acts_on_the_setpoint_without_k() -> None:
    params = Params({"MC_PITCHRATE_FF": 0.1, "MC_PITCHRATE_K": 0.01, "MC_PITCHRATE_I": 0.0})
    control = loop(params)
    control.set_target((0.0, 2.0, 0.0), 0.5, armed=True, hold_integral=False)
    assert run(control, (0.0, 2.0, 0.0), 1)[1] == pytest.approx(0.2)


def test_the_integral_grows_by_i_times_error_and_stops_at_its_limit() -> None:
    control = loop()
    control.set_target((0.1, 0.0, 0.0), 0.5, armed=True, hold_integral=False)
    run(control, (0.0, 0.0, 0.0), 1000)
    fade = 1.0 - (0.1 / math.radians(400.0)) ** 2
    assert control.integral[0] == pytest.approx(0.2 * 0.1 * fade, rel=1e-6)
    run(control, (0.0, 0.0, 0.0), 30_000)
    assert control.integral[0] == pytest.approx(0.3)


def test_the_integral_takes_nothing_from_errors_beyond_400_degrees_per_second() -> None:
    control = loop()
    control.set_target((7.0, 0.0, 0.0), 0.5, armed=True, hold_integral=False)
    run(control, (0.0, 0.0, 0.0), 100)
    assert control.integral[0] == 0.0


def test_the_integral_is_held_while_landed_and_starts_at_zero_on_arming() -> None:
    control = loop()
    control.set_target((0.1, 0.0, 0.0), 0.5, armed=True, hold_integral=False)
    run(control, (0.0, 0.0, 0.0), 500)
    before = control.integral[0]
    control.set_target((0.1, 0.0, 0.0), 0.0, armed=True, hold_integral=True)
    run(control, (0.0, 0.0, 0.0), 500)
    assert control.integral[0] == before > 0.0
    control.set_target((0.1, 0.0, 0.0), 0.0, armed=False, hold_integral=False)
    run(control, (0.0, 0.0, 0.0), 1)
    assert control.integral[0] == 0.0
    np.testing.assert_array_equal(control.motor_command, 0.0)


def test_the_integral_does_not_wind_up_into_a_saturated_axis_but_unwinds() -> None:
    control = loop()
    control.set_target((2.0, 0.0, 0.0), 0.05, armed=True, hold_integral=False)  # hardly any thrust to roll with
    run(control, (0.0, 0.0, 0.0), 1000)
    assert control.integral[0] < 1e-3  # what the first sample took
    control.integral[0] = 0.1
    control.set_target((0.05, 0.0, 0.0), 0.05, armed=True, hold_integral=False)
    run(control, (0.15, 0.0, 0.0), 1000)
    assert control.integral[0] < 0.09


def test_an_unset_yaw_rate_leaves_yaw_to_itself() -> None:
    control = loop()
    control.set_target((0.0, 0.0, math.nan), 0.5, armed=True, hold_integral=False)
    torque = run(control, (0.0, 0.0, 0.7), 500)
    assert torque[2] == 0.0
    assert control.integral[2] == 0.0


def test_yaw_torque_rises_with_its_two_hertz_low_pass() -> None:
    params = Params({"MC_YAWRATE_I": 0.0})
    control = loop(params)
    control.set_target((0.0, 0.0, 1.0), 0.5, armed=True, hold_integral=False)
    tau_ms = 1000.0 / (2.0 * math.pi * 2.0)
    assert run(control, (0.0, 0.0, 0.0), round(tau_ms))[2] == pytest.approx(0.2 * (1.0 - math.exp(-1.0)), rel=0.02)


def test_a_changed_gain_acts_when_the_loop_is_configured_again() -> None:
    params = Params({"MC_ROLLRATE_I": 0.0})
    control = loop(params)
    control.set_target((1.0, 0.0, 0.0), 0.5, armed=True, hold_integral=False)
    assert run(control, (0.0, 0.0, 0.0), 1)[0] == pytest.approx(0.15)
    params.set("MC_ROLLRATE_P", 0.3)
    control.configure(params)
    assert run(control, (0.0, 0.0, 0.0), 1)[0] == pytest.approx(0.3)


def test_a_thrust_curve_is_undone_in_the_motor_commands() -> None:
    control = loop(Params({"THR_MDL_FAC": 0.6}))
    for thrust in (0.0, 0.3, 1.0):
        control.set_target((0.0, 0.0, 0.0), thrust, armed=True, hold_integral=False)
        run(control, (0.0, 0.0, 0.0), 1)
        u = control.motor_command
        np.testing.assert_allclose(0.6 * u * u + 0.4 * u, thrust, atol=1e-6)


def test_a_unit_of_torque_turns_sih_as_measured() -> None:
    """113 rad/s^2 for roll and pitch, 13.3 for yaw."""
    np.testing.assert_allclose(angular_acceleration_per_torque(SIH), [113.0, 113.0, 13.3], rtol=0.005)


@pytest.mark.parametrize("name", ["quad-x", "px4-sihsim-quadx"])
def test_ordinary_vehicles_keep_px4s_rate_gains(name: str) -> None:
    params = airframe_params(vehicle(name))
    assert [params.get(k) for k in GAINS] == [1.0, 1.0, 1.0]


def test_an_agile_vehicle_gets_the_k_that_its_lag_allows() -> None:
    agile = replace(SIH, inertia_kgm2=SIH.inertia_kgm2 / 20.0)
    params = airframe_params(agile)
    alpha = angular_acceleration_per_torque(agile)
    lag_s = 0.048 + math.sqrt(2.0) / (2.0 * math.pi * 40.0)
    assert params.get("MC_ROLLRATE_K") == pytest.approx(LOOP_GAIN_MAX[0] / (0.15 * alpha[0] * lag_s), rel=1e-6)
    assert params.get("MC_YAWRATE_K") < 1.0


@pytest.mark.parametrize("dead_s", [0.0, 0.005, 0.02])
def test_the_phase_margin_of_an_integrator_with_dead_time_is_the_closed_form(dead_s: float) -> None:
    """P alpha e^(-s T) / s crosses 1 at P alpha: 90 degrees less T P alpha."""
    margin = phase_margin_deg((0.15, 0.0, 0.0, 0.0), 270.0, (0.0, 0.0, 0.0), dead_s)
    assert margin == pytest.approx(90.0 - math.degrees(0.15 * 270.0 * dead_s), abs=0.6)
    assert phase_margin_deg((1e-6, 0.0, 0.0, 0.0), 270.0, (0.0, 0.0, 0.0), dead_s) == 180.0


def scipys_margin_deg(airframe: Vehicle, axis: int, name: str, params: Params, k: float) -> float:
    """Phase margin of the loop as a transfer function of SciPy's, with 50 ms of lag and 20 ms of dead time."""
    p, i, d = (k * params.get(f"MC_{name}_{part}") for part in "PID")
    d_s = 1.0 / (2.0 * math.pi * params.get("IMU_DGYRO_CUTOFF"))
    gyro_s = math.sqrt(2.0) / (2.0 * math.pi * params.get("IMU_GYRO_CUTOFF"))
    over = float(angular_acceleration_per_torque(airframe)[axis])
    pid = np.polyadd([d, 0.0, 0.0], np.polymul([p, i], [d_s, 1.0]))
    plant = np.polymul(np.polymul([1.0, 0.0, 0.0], [d_s, 1.0]), np.polymul([0.05, 1.0], [gyro_s, 1.0]))
    w = np.geomspace(1.0, 200.0, 20_000)
    _, magnitude_db, phase_deg = signal.bode((over * pid, plant), w)
    at = int(np.flatnonzero(magnitude_db >= 0.0)[-1])
    return float(180.0 + phase_deg[at] - np.degrees(0.02 * w[at]))


def test_gains_are_tuned_on_what_flies_until_it_does_not_ring() -> None:
    """20 ms of dead time beside 50 ms of rotor lag: with PX4's defaults the rate loop swings against its limits."""
    quad = vehicle("quad-x")
    late = {"motor_lag": {"time_constant_s": 0.05}, "transport_delay": {"delay_s": 0.02}}
    params = airframe_params(quad, with_effects(quad, late))
    for axis, name in enumerate(("ROLLRATE", "PITCHRATE")):
        assert params.get(GAINS[axis]) < 1.0
        assert scipys_margin_deg(quad, axis, name, params, params.get(GAINS[axis])) == pytest.approx(35.0, abs=1.5)
        assert scipys_margin_deg(quad, axis, name, params, 1.0) < 25.0
    assert params.get(GAINS[2]) == 1.0, "yaw is slow enough"
    slow = with_effects(quad, {"motor_lag": {"time_constant_s": 0.08}})
    assert [airframe_params(quad, slow).get(name) for name in GAINS] == [1.0, 1.0, 1.0]


def test_hover_command_carries_the_weight_on_any_thrust_curve() -> None:
    for f in (0.0, 0.3, 1.0):
        v = replace(SIH, rotors=replace(SIH.rotors, thrust_model_factor=f))
        u = hover_command(v)
        assert 4.0 * 5.0 * (f * u * u + (1.0 - f) * u) == pytest.approx(9.80665)


def test_the_same_samples_give_the_same_bytes() -> None:
    noise = np.random.default_rng(1).standard_normal((50, 3))
    results = []
    for _ in range(2):
        control = loop()
        control.set_target((0.3, -0.2, 0.1), 0.6, armed=True, hold_integral=False)
        for sample in noise:
            control.step(sample)
        results.append(control.motor_command.tobytes())
    assert results[0] == results[1]
