"""The simulator at the measured states: closed forms, finite differences, SciPy, and the plant that flew."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flightstack.effects import EFFECTS
from flightstack.frames import quat_from_euler, quat_to_matrix
from flightstack.gap import run
from flightstack.gap.records import Samples
from flightstack.gap.run import ModelEvaluation, params_row
from flightstack.gap.simulate import (
    FreeParameter,
    free_parameters,
    missing_signals,
    natural_scale,
    predict,
    sensitivities,
    timing,
    value,
    with_value,
)
from flightstack.gap.track import track
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle
from tests.gap_flights import as_samples, fly, hidden, quad, wander

G = STANDARD_GRAVITY_MPS2
DT = 0.004


def still(
    n: int = 1500, *, u: float = 0.6, vel: F64 | None = None, euler: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Samples:
    """Steady flight: constant attitude, velocity and commands; the accelerometer says that nothing accelerates."""
    vel = np.zeros(3) if vel is None else vel
    q = quat_from_euler(*euler)
    t = DT * np.arange(n)
    return Samples(
        name="still",
        t_s=t,
        dt_s=DT,
        pos_ned_m=np.array([0.0, 0.0, -20.0]) + t[:, None] * vel,
        vel_ned_mps=np.tile(vel, (n, 1)),
        q_ned_frd=np.tile(q, (n, 1)),
        rate_frd_radps=np.zeros((n, 3)),
        accel_frd_mps2=np.tile(quat_to_matrix(q).T @ np.array([0.0, 0.0, -G]), (n, 1)),
        motor=np.full((n, 4), u),
        battery_v=np.full(n, 16.6),
        height_m=np.full(n, 20.0),
        valid=np.ones(n, dtype=bool),
        bandwidth_hz=100.0,
    )


@pytest.fixture(scope="module")
def flown() -> tuple[Samples, Samples]:
    """A clean flight, exact and as measured."""
    flight = fly(quad(), quad(), wander(), seconds=8.0, seed=3)
    return as_samples(flight, exact=True), as_samples(flight)


def test_hover_with_a_payload_is_thrust_over_total_mass() -> None:
    vehicle = hidden(quad(), {"payload": {"mass_kg": 0.3}})
    shown = predict(vehicle, still(u=0.7))
    assert shown[:, 2] == pytest.approx(-4 * 6.6 * 0.7**2 / 1.5, rel=1e-12)
    assert np.abs(shown[:, [0, 1, 3, 4, 5]]).max() < 1e-9


def test_drag_at_constant_speed_acts_along_the_body_axes_against_the_turned_velocity() -> None:
    vehicle = hidden(quad(), {"linear_drag": {"d_x_kgps": 0.3, "d_y_kgps": 0.6, "d_z_kgps": 0.0}})
    samples = still(vel=np.array([4.0, 0.0, 0.0]), euler=(0.0, 0.0, np.radians(30.0)))
    shown = predict(vehicle, samples)
    assert shown[500, 0] == pytest.approx(-0.3 * 4.0 * np.cos(np.radians(30.0)) / 1.2, rel=1e-9)
    assert shown[500, 1] == pytest.approx(0.6 * 4.0 * np.sin(np.radians(30.0)) / 1.2, rel=1e-9)


def _run(vehicle: Vehicle, samples: Samples) -> ModelEvaluation:
    flight = track(samples)
    return ModelEvaluation(params_row(vehicle, flight.step_s), flight)


def test_rotors_follow_held_commands_with_their_lag_and_delay() -> None:
    vehicle = hidden(quad(), {"motor_lag": {"time_constant_s": 0.05}, "transport_delay": {"delay_s": 0.02}})
    samples = still(u=0.5)
    samples.motor[750:] = 0.7  # repeated values: the log holds its commands
    u = _run(vehicle, samples).u[:, 0]
    t = samples.t_s - samples.t_s[750] - 0.02
    assert u == pytest.approx(np.where(t > 0, 0.7 - 0.2 * np.exp(-np.maximum(t, 0.0) / 0.05), 0.5), abs=1e-9)


def test_rotors_follow_sampled_commands_as_an_integral_of_the_interpolation_does() -> None:
    samples = still()
    samples.motor[:] = 0.6 + 0.1 * np.sin(2.0 * np.pi * 2.0 * samples.t_s)[:, None]
    u = _run(quad(), samples).u[:, 0]
    tau, omega = 0.02, 2.0 * np.pi * 2.0
    phase = omega * samples.t_s - np.arctan(omega * tau)
    assert u[500:] == pytest.approx(0.6 + 0.1 / np.hypot(1.0, omega * tau) * np.sin(phase[500:]), abs=1e-4)


def test_a_load_at_rest_hangs_with_its_weight() -> None:
    vehicle = hidden(quad(), {"slung_load": {"mass_kg": 0.25, "length_m": 1.5}})
    u = np.sqrt(1.45 * G / (4 * 6.6))
    assert predict(vehicle, still(u=u))[:, 2] == pytest.approx(-G, rel=1e-9)


def test_what_is_felt_of_a_load_is_found_once_for_all_loads_and_ropes(
    monkeypatch: pytest.MonkeyPatch, flown: tuple[Samples, Samples]
) -> None:
    """It is the vehicle's without one; the search tries some hundred of either."""
    samples, beyond = replace(flown[0], name="own"), mock.Mock(wraps=run._felt_beyond)
    monkeypatch.setattr(run, "_felt_beyond", beyond)
    loads = [{"mass_kg": m, "length_m": x} for m, x in ((0.2, 1.0), (0.3, 1.0), (0.2, 2.0))]
    swung = [_run(hidden(quad(), {"slung_load": load}), samples).load for load in loads]
    assert beyond.call_count == 1
    assert len({load.tobytes() for load in swung}) == 3


def test_the_load_swings_under_the_measured_motion_as_a_driven_pendulum() -> None:
    vehicle = hidden(quad(), {"slung_load": {"mass_kg": 0.25, "length_m": 0.8}})
    samples = still(n=2000)
    push = 1.5 * np.sin(1.7 * samples.t_s)
    samples.accel_frd_mps2[:, 0] = push
    samples.valid[:] = False  # nothing is said of what the vehicle felt of it
    load = _run(vehicle, samples).load
    omega = np.sqrt(G / 0.8)

    def pendulum(t: float, y: F64) -> list[float]:
        # angle from the vertical, north positive, under a pivot that accelerates north; damper on the angle's rate
        drive = 1.5 * np.sin(1.7 * t)
        return [y[1], -(G * np.sin(y[0]) + drive * np.cos(y[0])) / 0.8 - 2 * 0.02 * omega * y[1]]

    angle = solve_ivp(pendulum, (0.0, 8.0), [0.0, 0.0], t_eval=samples.t_s, rtol=1e-9, atol=1e-10).y[0]
    assert np.abs(angle).max() > 0.1
    assert load[:, 0] == pytest.approx(np.sin(angle), abs=2e-4)


def test_a_height_of_the_position_s_own_is_as_smooth_as_the_path(flown: tuple[Samples, Samples]) -> None:
    exact, measured = flown
    off = track(measured).pos_ned_m[:, 2] - exact.pos_ned_m[:, 2]
    raw = -measured.height_m - exact.pos_ned_m[:, 2]
    inner = slice(100, -100)
    assert np.std(off[inner]) < 0.7 * np.std(raw[inner])
    ranged = replace(measured, height_m=measured.height_m + 0.01 * np.sin(3.0 * measured.t_s))
    assert track(ranged).pos_ned_m[:, 2] == pytest.approx(-ranged.height_m)


def test_how_a_load_swung_when_the_log_began_is_told_by_what_the_vehicle_feels() -> None:
    mass, carried, length = 1.2, 0.25, 0.8
    damping = 2.0 * 0.02 * np.sqrt(G / length)
    samples = still(n=2000)

    def push(angle: F64, rate: F64) -> F64:
        """Level acceleration of the free vehicle: momentum of the pair along north is kept."""
        inward = G * np.cos(angle) + length * rate**2
        pull = carried * np.sin(angle) * inward + carried * damping * length * rate * np.cos(angle)
        return np.asarray(pull / (mass + carried * np.sin(angle) ** 2))

    def swing(t: float, y: F64) -> list[float]:
        turn = -(G * np.sin(y[0]) + float(push(y[0], y[1])) * np.cos(y[0])) / length - damping * y[1]
        return [y[1], turn]

    angle, rate = solve_ivp(swing, (0.0, 8.0), [0.9, 0.0], t_eval=samples.t_s, rtol=1e-9, atol=1e-10).y
    turn = np.gradient(rate, DT)
    down = carried * (G + length * (turn * np.sin(angle) + rate**2 * np.cos(angle)))
    samples.accel_frd_mps2[:, 0] = push(angle, rate)
    samples.motor[:] = np.sqrt((mass * G + down) / (4 * 6.6))[:, None]  # it keeps its height
    vehicle = hidden(quad(), {"slung_load": {"mass_kg": carried, "length_m": length}})
    load = _run(vehicle, samples).load
    assert np.abs(load[:100, 0] - np.sin(angle[:100])).max() > 0.5  # it is taken to hang at first
    assert load[500:, 0] == pytest.approx(np.sin(angle[500:]), abs=0.03)


def test_sensor_effects_are_shown_where_their_sensors_show_them() -> None:
    samples = still(euler=(0.2, -0.1, 0.7))
    zero = predict(quad(), samples)
    bias = predict(hidden(quad(), {"accelerometer_bias": {"x_mps2": 0.3}}), samples) - zero
    assert bias[:, [0, 9]] == pytest.approx(0.3)
    assert np.abs(np.delete(bias, [0, 9], axis=1)).max() < 1e-12
    gyro = predict(hidden(quad(), {"gyro_bias": {"z_radps": 0.05}}), samples) - zero
    assert gyro[:, 8] == pytest.approx(0.05)
    assert np.abs(np.delete(gyro, [8], axis=1)).max() < 1e-6
    tilt = predict(hidden(quad(), {"attitude_misalignment": {"roll_rad": 1e-4}}), samples) - zero
    expected = np.cross([1e-4, 0.0, 0.0], samples.accel_frd_mps2[0])
    assert tilt[500, 9:12] == pytest.approx(expected, abs=1e-6)


def knob_range(effect: str, parameter: str) -> tuple[float, float]:
    spec = next(p for p in EFFECTS[effect].params if p.name == parameter)
    return spec.minimum, spec.maximum


@pytest.mark.parametrize("effect", [name for name in EFFECTS if name != "turbulence"])
def test_sensitivities_are_the_derivatives_of_the_prediction(effect: str, flown: tuple[Samples, Samples]) -> None:
    samples = flown[0]
    drag = {"linear_drag": {"d_x_kgps": 0.3, "d_y_kgps": 0.3, "d_z_kgps": 0.2}}
    vehicle = quad() if effect == "linear_drag" else hidden(quad(), drag)  # wind needs something to blow on
    at = {"rotor_fault": {"rotor": 2}, "slung_load": {"mass_kg": 0.2, "length_m": 1.0}}.get(effect, {})
    if effect in ("linear_drag", "parasitic_drag"):
        at = {p.name: 0.3 for p in EFFECTS[effect].params}
    flight, columns = track(samples), free_parameters(effect, at)
    got = sensitivities(vehicle, samples, columns)
    for k, knob in enumerate(columns):
        centre = with_value(vehicle, effect, at) if at else vehicle
        now = value(centre, effect, knob.parameter)
        step = 0.1 * natural_scale(vehicle, effect, knob.parameter)  # five times as far, and to one side only
        step = -step if now == knob_range(effect, knob.parameter)[1] else step
        moved = predict(with_value(centre, effect, {knob.parameter: now + step}), samples)
        expected = flight.lowpass(moved - predict(centre, samples)) / step
        scale = np.abs(expected).max()
        assert got[:, :, k] == pytest.approx(expected, abs=0.15 * scale + 1e-9), knob.parameter


def test_payload_and_drag_columns_are_the_textbook_s(flown: tuple[Samples, Samples]) -> None:
    samples = flown[0]
    flight = track(samples)
    thrust = -predict(quad(), samples)[:, 2] * 1.2
    assert sensitivities(quad(), samples, [FreeParameter("payload", "mass_kg")])[..., 0][:, 2] == pytest.approx(
        flight.lowpass(thrust[:, None])[:, 0] / 1.2**2, rel=1e-3
    )
    north = np.einsum("nij,ni->nj", np.array([quat_to_matrix(q) for q in flight.q_ned_frd]), flight.vel_ned_mps)
    column = sensitivities(quad(), samples, [FreeParameter("linear_drag", "d_x_kgps")])[..., 0][:, 0]
    assert column == pytest.approx(flight.lowpass(north[:, :1])[:, 0] / -1.2, abs=1e-6)


def test_every_th_row_is_the_same_row(flown: tuple[Samples, Samples]) -> None:
    columns = [FreeParameter("payload", "mass_kg"), FreeParameter("motor_lag", "time_constant_s")]
    whole = sensitivities(quad(), flown[1], columns)
    assert np.array_equal(sensitivities(quad(), flown[1], columns, every=3), whole[::3])


def test_a_fast_log_may_be_evaluated_at_fewer_samples() -> None:
    samples = as_samples(fly(quad(), quad(), wander(), seconds=6.0, seed=9, every_ms=4))
    columns = [
        *free_parameters("motor_lag"),
        *free_parameters("inertia"),
        *free_parameters("payload"),
        *free_parameters("slung_load", {"length_m": 0.5})[:1],
    ]
    whole, fewer = sensitivities(quad(), samples, columns)[::4], sensitivities(quad(), samples, columns, every=4)
    inside = slice(20, -20)
    for k, knob in enumerate(columns):
        off = np.std((whole - fewer)[inside, :6, k]) / np.std(whole[inside, :6, k])
        assert off < 0.01, knob


def test_later_commands_are_a_transport_delay(flown: tuple[Samples, Samples]) -> None:
    column = timing(quad(), flown[0])[200:-200, 3:6]
    delay = sensitivities(quad(), flown[0], [FreeParameter("transport_delay", "delay_s")])[..., 0][200:-200, 3:6]
    assert np.sum(column * delay) / np.sum(delay**2) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"rotor_drag": {"k_d_kg_per_rad": 3e-4}, "steady_wind": {"north_mps": 3.0}},
        {"payload": {"mass_kg": 0.3}, "com_offset": {"x_m": 0.01}},
        {"motor_lag": {"time_constant_s": 0.04}},
        {"slung_load": {"mass_kg": 0.2, "length_m": 1.0}},
    ],
)
def test_what_flew_is_predicted_from_a_log_of_every_eighth_millisecond(effects: dict[str, dict[str, float]]) -> None:
    truth = hidden(quad(), effects)
    samples = as_samples(fly(truth, quad(), wander(), seconds=6.0, seed=5), exact=True)
    flight = track(samples)
    left = flight.lowpass(flight.measured - predict(truth, samples))[flight.usable, :6]
    signal = np.std(flight.lowpass(flight.measured)[flight.usable, :6], axis=0)
    scale = np.array([0.3, 0.3, signal[2], *signal[3:]])
    assert (np.std(left, axis=0) / scale).max() < 0.02


def test_what_a_log_lacks_is_not_shown(flown: tuple[Samples, Samples]) -> None:
    nothing = np.full_like(flown[1].vel_ned_mps, np.nan)
    bare = replace(
        flown[1],
        vel_ned_mps=nothing,
        pos_ned_m=nothing,
        q_ned_frd=np.full_like(flown[1].q_ned_frd, np.nan),
        height_m=nothing[:, 0],
        battery_v=np.zeros(len(nothing)),
    )
    shown = predict(quad(), bare)
    assert np.isnan(shown[:, 6:]).all()
    assert np.isfinite(shown[:, :6]).all()
    assert missing_signals(bare, "linear_drag") == ("vel_ned_mps", "q_ned_frd")
    assert missing_signals(bare, "angular_damping") == ("vel_ned_mps", "q_ned_frd")  # drag at the hubs damps as well
    assert missing_signals(bare, "battery_sag") == ("battery_v",)
    assert not np.any(
        np.nan_to_num(sensitivities(quad(), bare, [FreeParameter("rotor_drag", "k_d_kg_per_rad")])[..., 0])
    )
    assert np.nanstd(sensitivities(quad(), bare, [FreeParameter("payload", "mass_kg")])[..., 0][:, 2]) > 0.0


def test_a_force_out_of_the_velocity_passes_what_its_derivative_does(flown: tuple[Samples, Samples]) -> None:
    without = replace(flown[0], accel_frd_mps2=np.full_like(flown[0].accel_frd_mps2, np.nan))
    flight = track(without)
    left = flight.lowpass(flight.measured - predict(quad(), without))[flight.usable, :3]
    assert np.std(left, axis=0).max() < 0.01
    assert flight.averaged[0]
    assert np.isnan(flight.measured[:, 9:]).all()
