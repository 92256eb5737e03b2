"""The JSBSim plant against closed forms, with the gravity of JSBSim's own turning earth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fleet import QUAD, TYPICAL, quad
from oracle import State, accelerations
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from flightstack.effects import EFFECTS, ParamSpec
from flightstack.effects.ground_effect import factor
from flightstack.effects.row import P_EFFECTS, PLACES
from flightstack.types import F64, InputError
from flightstack.vehicle import Vehicle
from flightstack_sim.jsbsim import aircraft
from flightstack_sim.jsbsim.plant import JsbsimPlant
from flightstack_sim.parameters import parameter_row

pytest.importorskip("jsbsim", reason="no JSBSim here (wheels exist for x86-64 only)")
pytestmark = pytest.mark.jsbsim
OFF = np.zeros(4)
LATITUDE = math.radians(47.397742)
ALTITUDE_M = 489.4
UP = (0.0, 0.0, -200.0)
CLOSE = 0.001
"""A tenth of a percent: what every closed form is held to."""


def earth_gravity() -> float:
    """Gravitation with the oblateness J2, less what the turning earth takes; vectors from its centre, WGS 84."""
    gm, a, f, j2, turn = 3.986004418e14, 6378137.0, 1 / 298.257223563, 1.08262982e-3, 7.292115e-5
    n = a / math.sqrt(1 - f * (2 - f) * math.sin(LATITUDE) ** 2)
    x = (n + ALTITUDE_M) * math.cos(LATITUDE)
    z = (n * (1 - f) ** 2 + ALTITUDE_M) * math.sin(LATITUDE)
    r = math.hypot(x, z)
    j = 1.5 * j2 * (a / r) ** 2
    s = 5 * (z / r) ** 2
    gx = -gm * x / r**3 * (1 + j * (1 - s)) + turn**2 * x
    gz = -gm * z / r**3 * (1 + j * (3 - s))
    return math.hypot(gx, gz)


G = earth_gravity()


def hover_u(vehicle: Vehicle = QUAD, gravity: float = G) -> float:
    share = vehicle.total_mass_kg * gravity / vehicle.max_total_thrust_n
    return math.sqrt(share)


def high(vehicle: Vehicle = QUAD, u: float = 0.0, **state: object) -> JsbsimPlant:
    plant = JsbsimPlant(vehicle, seed=0)
    plant.place(pos_ned_m=UP, motor_u=(u,) * 4, **state)  # type: ignore[arg-type]
    return plant


def test_jsbsim_s_effective_gravity_is_neither_the_native_plant_s_nor_without_the_turning() -> None:
    sin2 = math.sin(LATITUDE) ** 2  # normal gravity at sea level (Somigliana) and its free-air gradient
    normal = 9.7803253359 * (1 + 0.00193185265241 * sin2) / math.sqrt(1 - 0.00669437999014 * sin2)
    assert pytest.approx(normal - 3.0855e-6 * ALTITUDE_M, rel=1e-5) == G
    plant = high(u=hover_u())
    plant.run(np.full(4, hover_u()), 100)
    assert plant.specific_force_frd_mps2 == pytest.approx([0, 0, -G], abs=1e-6)


def test_at_the_closed_form_s_command_it_hovers() -> None:
    """After 5 s less than a thousandth of g is missing: 12 mm; it stays within 1 mm."""
    plant = high(u=hover_u(gravity=G * (1 - 2 * 200 / 6.37e6)))
    plant.run(np.full(4, hover_u(gravity=G * (1 - 2 * 200 / 6.37e6))), 5000)
    assert plant.pos_ned_m == pytest.approx(UP, abs=1e-3)
    assert plant.vel_ned_mps == pytest.approx([0, 0, 0], abs=5e-4)


def test_it_falls_as_a_stone() -> None:
    plant = high()
    for t in (0.5, 1.0, 2.0, 3.0):
        plant.run(OFF, round(1e3 * t) - plant.t_us // 1000)
        assert plant.pos_ned_m[2] - UP[2] == pytest.approx(0.5 * G * t * t, rel=CLOSE)
        assert plant.vel_ned_mps[2] == pytest.approx(G * t, rel=CLOSE)
        assert plant.specific_force_frd_mps2 == pytest.approx([0, 0, 0], abs=1e-9)


def test_a_fall_drifts_east_by_the_turning_earth() -> None:
    """Coriolis: after t seconds (1/3) g Omega cos(latitude) t^3 to the east; 13 mm after 3 s... of 44 m."""
    plant = high()
    plant.run(OFF, 3000)
    east = G * 7.292115e-5 * math.cos(LATITUDE) * 27 / 3
    assert plant.pos_ned_m[1] == pytest.approx(east, rel=0.01)


def test_motors_follow_a_step_as_their_exponential() -> None:
    plant = high(u=0.5)
    for k in range(1, 101):
        plant.step(np.full(4, 0.8))
        expected = 0.8 - 0.3 * math.exp(-1e-3 * k / 0.02)
        assert plant.truth().motor_u == pytest.approx((expected,) * 4, abs=1e-12)


def test_a_thrust_step_climbs_as_the_closed_form_says() -> None:
    """v(t) = int g - 4 T u^2 / m, u the exponential of the lag: all in closed form."""
    before, after, tau = hover_u(), 0.8, 0.02
    scale = 4 * 6.6 / 1.2

    def speed(t: float) -> float:
        d = before - after
        squares = (
            after**2 * t + 2 * after * d * tau * -math.expm1(-t / tau) + d * d * tau / 2 * -math.expm1(-2 * t / tau)
        )
        return G * t - scale * squares

    plant = high(u=before)
    for ms in (50, 100, 300, 1000):
        plant.run(np.full(4, after), ms - plant.t_us // 1000)
        assert plant.vel_ned_mps[2] == pytest.approx(speed(1e-3 * ms), rel=CLOSE)


@pytest.mark.parametrize(
    ("axis", "signs", "gain"),
    [
        (0, (-1, 1, 1, -1), 4 * 0.16 * 6.6 / 0.012),
        (1, (1, -1, 1, -1), 4 * 0.13 * 6.6 / 0.013),
        (2, (1, 1, -1, -1), 4 * 0.015 * 6.6 / 0.022),
    ],
)
def test_a_torque_step_turns_as_the_closed_form_says(axis: int, signs: tuple[int, ...], gain: float) -> None:
    """Rate = gain times the integral of (u+^2 - u-^2) / 2, from the motors' exponentials; only the one axis turns."""
    u, step, tau = 0.7, 0.05, 0.02

    def rate(t: float) -> float:
        share = t - tau * -math.expm1(-t / tau)  # of the step, integrated
        return gain * 2 * u * step * share  # the step's square cancels between the pairs

    plant = high(u=u)
    for ms in (50, 100, 150):
        plant.run(u + step * np.array(signs), ms - plant.t_us // 1000)
        expected = np.zeros(3)
        expected[axis] = rate(1e-3 * ms)
        assert plant.rate_frd_radps == pytest.approx(expected, rel=CLOSE, abs=1e-5)


def test_a_fall_with_drag_approaches_terminal_velocity_as_the_closed_forms_say() -> None:
    d, c = 0.8, 0.05
    linear, square = high(quad(linear_drag={"d_z_kgps": d})), high(quad(parasitic_drag={"c_z_kg_per_m": c}))
    end, quick = 1.2 * G / d, math.sqrt(1.2 * G / c)
    for t in (1.0, 2.0, 3.0):
        linear.run(OFF, 1000)
        square.run(OFF, 1000)
        assert linear.vel_ned_mps[2] == pytest.approx(end * -math.expm1(-d / 1.2 * t), rel=CLOSE)
        assert square.vel_ned_mps[2] == pytest.approx(quick * math.tanh(G * t / quick), rel=CLOSE)


def test_a_gliding_vehicle_ends_up_moving_with_the_wind() -> None:
    drag = {"d_x_kgps": 2.0, "d_y_kgps": 2.0, "d_z_kgps": 2.0}
    wind = {"north_mps": 3.0, "east_mps": -2.0, "down_mps": 0.5}
    plant = high(quad(linear_drag=drag, steady_wind=wind, constant_force={"down_n": -1.2 * G}))
    plant.run(OFF, 8000)
    assert plant.vel_ned_mps == pytest.approx([3.0, -2.0, 0.5], rel=CLOSE)
    assert plant.truth().wind_ned_mps == pytest.approx((3.0, -2.0, 0.5))


def test_a_free_body_tumbles_as_eulers_equations_say() -> None:
    inertia = QUAD.inertia_kgm2

    def euler(t: float, w: F64) -> F64:
        return np.cross(inertia * w, w) / inertia

    plant = high(rate_frd_radps=(1.0, 4.0, 0.5))
    plant.run(OFF, 2000)
    expected = solve_ivp(euler, (0, 2), [1.0, 4.0, 0.5], rtol=1e-10, atol=1e-12).y[:, -1]
    assert plant.rate_frd_radps == pytest.approx(expected, rel=CLOSE, abs=4e-3)


MOVING = [
    name for name in TYPICAL
    if name not in (*aircraft.REFUSED, "turbulence", "motor_lag", "transport_delay", "accelerometer_bias", "gyro_bias",
                    "attitude_misalignment")
]  # fmt: skip


def test_an_effect_that_nobody_wrote_for_jsbsim_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new line of the table must not fly as if it were not there: the second physics would check nothing."""
    params = (ParamSpec("k", "kg", 0.0, 0.0, 1.0),)
    magnus = replace(EFFECTS["rotor_gyroscopic"], name="magnus", params=params, decay_rate=None)
    monkeypatch.setitem(PLACES, ("magnus", "k"), P_EFFECTS)
    monkeypatch.setitem(EFFECTS, "magnus", magnus)
    JsbsimPlant(replace(QUAD, effects={"magnus": {"k": 0.0}}), seed=0)
    with pytest.raises(InputError, match=r"effects\.magnus .*not written for JSBSim"):
        JsbsimPlant(replace(QUAD, effects={"magnus": {"k": 0.5}}), seed=0)


@pytest.mark.parametrize("strength", [4.0, 20.0])
def test_strong_ground_effects_are_those_of_the_documented_formula_on_both_plants(strength: float) -> None:
    """At 12 cm s (R / 4 z)^2 is 0.25 for 4 and would be 1.25 for 20: there it stays at 0.75."""
    vehicle = quad(ground_effect={"strength": strength})
    pos, u = np.array([0.0, 0.0, -0.12]), np.full(4, 0.5)
    state = State(pos, np.zeros(3), np.eye(3), np.zeros(3), u, np.zeros(3), 16.0)
    force, _ = accelerations(vehicle, state)
    plant = JsbsimPlant(vehicle, seed=0)
    plant.place(
        pos_ned_m=pos.tolist(), vel_ned_mps=[0.0] * 3, euler_rad=[0.0] * 3, rate_frd_radps=[0.0] * 3, motor_u=u.tolist()
    )
    assert plant.specific_force_frd_mps2 == pytest.approx(force, rel=1e-6)
    native = factor(parameter_row(vehicle, dt_us=1000), 1.0, (0.0, 0.0, 0.0), 0.12)
    assert native == pytest.approx(1.0 / (1.0 - min(strength / 16.0, 0.75)), rel=1e-12)


@pytest.mark.parametrize("name", MOVING)
def test_accelerations_in_any_state_are_those_of_the_documented_formulas(name: str) -> None:
    """Specific force and angular acceleration at random states, against a plain writing of docs/physics.md."""
    vehicle = quad(**{name: TYPICAL[name]})
    rng = np.random.default_rng(3)
    plant = JsbsimPlant(vehicle, seed=0)
    wind = np.array([TYPICAL[name].get(f"{d}_mps", 0.0) for d in ("north", "east", "down")])
    low = name == "ground_effect"
    for _ in range(3):
        euler = rng.uniform(-0.7, 0.7, 3)
        pos = np.array([1.0, -2.0, -0.5 if low else -20.0])
        velocity, rate = rng.uniform(-5, 5, 3), rng.uniform(-3, 3, 3)
        u = rng.uniform(0.4, 0.9, 4)
        plant.place(
            pos_ned_m=pos.tolist(), vel_ned_mps=velocity.tolist(), euler_rad=euler.tolist(),
            rate_frd_radps=rate.tolist(), motor_u=u.tolist(),
        )  # fmt: skip
        rotation = Rotation.from_euler("ZYX", euler[::-1])
        state = State(pos, velocity, rotation.as_matrix(), rate, u, wind, plant.battery_v)
        force, turning = accelerations(vehicle, state)
        assert plant.specific_force_frd_mps2 == pytest.approx(force, rel=1e-6, abs=1e-6)
        letters = zip("pqr", turning, strict=True)
        found = [plant._fdm.get(f"accelerations/{letter}dot-rad_sec2")() for letter, _ in letters]
        assert found == pytest.approx(turning, rel=1e-4, abs=2e-3)  # Coriolis' 1e-4 1/s times the rates


@pytest.mark.parametrize("delay_ms", [1, 7, 12.5, 250])
def test_delayed_commands_act_late_by_the_delay(delay_ms: float) -> None:
    vehicle = quad(motor_lag={"time_constant_s": 0.0}, transport_delay={"delay_s": delay_ms / 1e3})
    plant = high(vehicle)
    sent = np.random.default_rng(1).uniform(0.3, 0.9, (400, 4))
    past = np.concatenate([np.zeros((300, 4)), sent])
    for k in range(400):
        plant.step(sent[k])
        whole, part = int(delay_ms), delay_ms % 1
        expected = (1 - part) * past[300 + k - whole] + part * past[300 + k - whole - 1]
        assert plant.truth().motor_u == pytest.approx(expected, abs=1e-9)


def test_gusts_have_the_dryden_forms_spread_and_memory() -> None:
    """10 m/s past a length of 2 m: tau 0.2 s; then exp(-1) of the longitudinal gust is left, half of that across."""
    wind = {"north_mps": 10.0}
    vehicle = quad(turbulence={"sigma_mps": 1.5, "length_m": 2.0}, steady_wind=wind)
    plant = JsbsimPlant(vehicle, seed=4)
    gusts = np.empty((60_000, 3))
    reads = [plant._fdm.get(f"atmosphere/gust-{name}-fps") for name in ("north", "east", "down")]
    for k in range(len(gusts)):
        plant._fdm._exec.run()  # on the ground, motors off: the airspeed is the wind's
        gusts[k] = [0.3048 * read() for read in reads]
    assert gusts.std(axis=0) == pytest.approx([1.5] * 3, rel=0.12)
    left = [np.mean(g[200:] * g[:-200]) / np.mean(g * g) for g in gusts.T]
    assert left == pytest.approx([math.exp(-1), 0.5 * math.exp(-1), 0.5 * math.exp(-1)], abs=0.1)


def test_at_rest_it_stays_where_it_stands_against_a_tenth_of_its_weight() -> None:
    plant = JsbsimPlant(quad(constant_force={"north_n": 0.1 * 1.2 * G}), seed=0)
    plant.run(OFF, 1000)
    start = plant.pos_ned_m.copy()
    plant.run(OFF, 3000)
    assert plant.on_ground
    assert plant.pos_ned_m == pytest.approx(start, abs=1e-6)
    assert plant.pos_ned_m == pytest.approx([0, 0, 0], abs=1e-4)


def test_dropped_it_comes_to_rest_on_its_feet() -> None:
    plant = JsbsimPlant(QUAD, seed=0)
    plant.place(pos_ned_m=(0.0, 0.0, -0.5), euler_rad=(0.1, -0.05, 0.3))
    plant.run(OFF, 200)
    assert not plant.on_ground
    plant.run(OFF, 3000)
    assert plant.on_ground
    assert plant.pos_ned_m[2] == pytest.approx(0.0, abs=1e-4)
    assert plant.q_ned_frd[1:3] == pytest.approx([0, 0], abs=1e-3)


def test_a_payload_that_drops_leaves_the_state_and_takes_the_weight() -> None:
    plant = high(quad(payload={"mass_kg": 0.3}), u=0.7, vel_ned_mps=(2.0, -1.0, 0.5), euler_rad=(0.1, -0.2, 0.4))
    plant.run(np.full(4, 0.7), 50)
    before = plant.truth()
    plant.set_effect("payload", {"mass_kg": 0.0})
    after = plant.truth()
    assert after.pos_ned_m == pytest.approx(before.pos_ned_m, abs=1e-9)
    assert after.motor_u == pytest.approx(before.motor_u, abs=1e-12)
    force = plant.specific_force_frd_mps2[2] * 1.5
    plant.run(np.full(4, 0.7), 2)
    assert plant.vel_ned_mps == pytest.approx(before.vel_ned_mps, abs=0.05)
    assert plant.specific_force_frd_mps2[2] * 1.2 == pytest.approx(force, rel=1e-3)


def run_for(plant: JsbsimPlant, command: Callable[[int], F64], steps: int) -> None:
    for k in range(steps):
        plant.step(command(k))


def test_changing_an_effect_to_what_it_is_already_changes_nothing() -> None:
    """A fresh aircraft takes over the whole state: half a second later both have flown the same."""

    def command(k: int) -> F64:
        return 0.68 + 0.02 * np.sin(0.05 * k + np.arange(4))

    state = {"vel_ned_mps": (2.0, -1.0, 0.5), "euler_rad": (0.1, -0.2, 0.4), "rate_frd_radps": (0.3, -0.2, 0.1)}
    vehicle = quad(battery_sag={"thrust_loss_per_v": 0.06})
    one, other = high(vehicle, u=0.68, **state), high(vehicle, u=0.68, **state)
    for plant in (one, other):
        run_for(plant, command, 200)
    other.set_effect("payload", {"mass_kg": 0.0})
    for plant in (one, other):
        run_for(plant, command, 500)
    assert other.pos_ned_m == pytest.approx(one.pos_ned_m, abs=1e-4)
    assert other.rate_frd_radps == pytest.approx(one.rate_frd_radps, abs=1e-3)
    assert other.battery_v == pytest.approx(one.battery_v, abs=1e-6)
