"""What is left out or not named: stopped rotors, ground contact, a voltage that mirrors commands, a made attitude."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from flightstack.gap import voltage
from flightstack.gap.checks.exclusions import exclude_ground_contact, exclude_stopped_rotors, standing_m
from flightstack.gap.checks.flying import rotor_thrust
from flightstack.gap.decisions import AROUND_S
from flightstack.gap.name import name
from flightstack.gap.naming.candidates import at_end, plausible
from flightstack.gap.naming.search import Fit, effects_at_bound, pressed_beyond
from flightstack.gap.records import Samples, Signal
from flightstack.gap.simulate import confounded_with_attitude, with_value
from flightstack.types import F64
from flightstack.vehicle import parse_vehicle, vehicle_to_toml
from tests import gap_batch as batch
from tests.gap_flights import as_samples, fly, quad, wander

CUT_S = 0.4


@pytest.fixture(scope="module")
def flown() -> Samples:
    return as_samples(fly(quad(), quad(), wander(), seconds=20.0, seed=3))


def cut(samples: Samples, begin_s: float) -> Samples:
    """The same with one rotor's command cut for a while."""
    motor = samples.motor.copy()
    t_s = samples.t_s - samples.t_s[0]
    motor[(t_s >= begin_s) & (t_s < begin_s + CUT_S), 2] = 0.0
    return replace(samples, motor=motor)


def test_a_stopped_rotor_is_left_out_until_five_time_constants_after(flown: Samples) -> None:
    vehicle = replace(quad(), rotors=replace(quad().rotors, time_constant_s=0.1))
    kept, findings = exclude_stopped_rotors(cut(flown, 10.0), vehicle)
    t_s = kept.t_s - kept.t_s[0]
    gone = t_s[flown.valid & ~kept.valid]
    assert gone.min() == pytest.approx(10.0, abs=2.0 * kept.dt_s)
    assert gone.max() == pytest.approx(10.0 + CUT_S + 0.5, abs=2.0 * kept.dt_s)
    assert [finding.name for finding in findings] == ["rotors"]


def test_a_flight_whose_rotors_never_stop_is_as_it_was(flown: Samples) -> None:
    assert exclude_stopped_rotors(flown, quad()) == (flown, [])


def test_a_vehicle_that_stops_its_rotors_all_the_time_is_taken_as_it_is(flown: Samples) -> None:
    motor = flown.motor.copy()
    motor[::50] = 0.0
    kept, findings = exclude_stopped_rotors(replace(flown, motor=motor), quad())
    assert np.array_equal(kept.valid, flown.valid)
    assert findings[0].level == "warning"


STANDS_M = 0.05
"""Height of the body's origin over its feet."""


def log_of(height_m: np.ndarray, motor: np.ndarray) -> dict[str, Signal]:
    """Position and four equal motors at 100 Hz."""
    t_s: F64 = 0.01 * np.arange(len(height_m), dtype=np.float64)
    position = np.stack([0.0 * t_s, 0.0 * t_s, -height_m], axis=1)
    return {"pos_ned_m": Signal(t_s, position, "pose"), "motor": Signal(t_s, np.tile(motor, (4, 1)).T, "motors")}


@pytest.mark.parametrize(
    ("before_m", "after_m", "stands_m"),
    [
        (STANDS_M, STANDS_M, STANDS_M),
        (0.9, STANDS_M, STANDS_M),  # from a table
        (0.9, 0.9, 0.0),
        (-0.02, -0.02, 0.0),  # a drift
    ],
)
def test_the_log_shows_how_high_the_body_s_origin_stands(before_m: float, after_m: float, stands_m: float) -> None:
    flying = np.arange(3000) // 1000 == 1
    height = np.where(flying, 1.5, np.where(np.arange(3000) < 1000, before_m, after_m))
    log = log_of(height, np.where(flying, 0.5, 0.0))
    assert standing_m(log, quad(), (10.0, 20.0), 0.0) == pytest.approx(stands_m)
    assert standing_m({"motor": log["motor"]}, quad(), (10.0, 20.0), 0.0) == 0.0


def test_a_touchdown_is_left_out_where_the_origin_stands_high(flown: Samples) -> None:
    """A bounce at 12 s that never comes below 5 cm: a quarter of a second before and after it is gone."""
    t_s = flown.t_s - flown.t_s[0]
    height = np.where(np.abs(t_s - 12.0) < 0.02, STANDS_M, 2.0)
    level = replace(flown, height_m=height, q_ned_frd=np.tile([1.0, 0.0, 0.0, 0.0], (len(t_s), 1)))
    assert exclude_ground_contact(level, quad()) == (level, [])
    kept, findings = exclude_ground_contact(level, quad(), STANDS_M)
    gone = t_s[flown.valid & ~kept.valid]
    assert gone.min() == pytest.approx(12.0 - 0.02 - AROUND_S, abs=2.0 * flown.dt_s)
    assert gone.max() == pytest.approx(12.0 + 0.02 + AROUND_S, abs=2.0 * flown.dt_s)
    assert [finding.name for finding in findings] == ["ground"]


@pytest.mark.parametrize("derived", [(), ("motor",)])
def test_what_the_ground_carries_is_left_out_where_the_height_is_wrong(
    flown: Samples, derived: tuple[str, ...]
) -> None:
    """PX4's height was 0.4 m off when it landed: it stood there for a second at 0.6 of the thrust.

    Motors at 10 Hz, which say no more than their mean, say so as well.
    """
    flown = replace(flown, derived=derived)
    stands = flown.t_s > flown.t_s[-1] - 1.0
    motor = np.where(stands[:, None], 0.6 * np.median(flown.motor, axis=0), flown.motor)
    noise = 0.5 * np.random.default_rng(1).standard_normal((len(stands), 3))
    accel = np.where(stands[:, None], noise - np.array([0.0, 0.0, 9.80665]), flown.accel_frd_mps2)
    kept, findings = exclude_ground_contact(replace(flown, motor=motor, accel_frd_mps2=accel), quad())
    gone = flown.t_s[~kept.valid]
    assert kept.t_s[-1] - 1.75 < gone.min() < kept.t_s[-1] - 1.0
    assert len(gone) == round((flown.t_s[-1] - gone.min()) / flown.dt_s) + 1
    assert [finding.name for finding in findings] == ["ground"]
    assert exclude_ground_contact(flown, quad()) == (flown, [])


def test_from_its_impact_on_a_landing_is_left_out(flown: Samples) -> None:
    """A PX4 met the ground 0.7 s before it said so, its motors still at three quarters: twice its weight for 15 ms."""
    at_s = flown.t_s[-1] - 0.7
    hit = (flown.t_s >= at_s) & (flown.t_s < at_s + 0.015)
    accel = flown.accel_frd_mps2 + 0.5 * np.random.default_rng(2).standard_normal(flown.accel_frd_mps2.shape)
    noisy = replace(flown, accel_frd_mps2=accel)
    assert exclude_ground_contact(noisy, quad()) == (noisy, [])
    accel = np.where(hit[:, None], accel - np.array([0.0, 0.0, 2.0 * 9.80665]), accel)
    kept, findings = exclude_ground_contact(replace(flown, accel_frd_mps2=accel), quad())
    gone = flown.t_s[~kept.valid]
    assert gone.min() == pytest.approx(at_s - AROUND_S, abs=2.0 * flown.dt_s)
    assert gone.max() == flown.t_s[-1]
    assert [finding.name for finding in findings] == ["ground"]


def test_a_throttle_that_is_cut_where_a_log_ends_is_no_landing(flown: Samples) -> None:
    """A climb at twice the thrust is cut to a third a second before the end; rotors follow with 50 ms."""
    left_s = flown.t_s[-1] - flown.t_s
    asked = np.where(left_s < 1.0, 0.6, np.where(left_s < 1.4, 1.4, 1.0))[:, None] * flown.motor
    share = rotor_thrust(quad(), asked).sum(axis=1) / rotor_thrust(quad(), flown.motor).sum(axis=1)
    keep = np.exp(-flown.dt_s / 0.05)
    followed = lfilter([1.0 - keep], [1.0, -keep], share, zi=[keep])[0]
    accel = flown.accel_frd_mps2 * np.stack([np.ones_like(share), np.ones_like(share), followed], axis=1)
    cut_off = replace(flown, motor=asked, accel_frd_mps2=accel)
    assert exclude_ground_contact(cut_off, quad()) == (cut_off, [])


def test_an_attitude_out_of_the_acceleration_tells_no_side_force_and_no_lag(flown: Samples) -> None:
    """It is the one at which there is no side force: linear drag F = -d v would be its own null."""
    made = replace(flown, derived=("q_ned_frd",))
    for effect in ("linear_drag", "steady_wind", "blade_flapping", "angular_damping", "motor_lag"):
        assert confounded_with_attitude(made, effect)
        assert not confounded_with_attitude(flown, effect)
    for effect in ("rotor_fault", "com_offset", "thrust_scale", "payload"):
        assert not confounded_with_attitude(made, effect)


def with_voltage(samples: Samples, volts: np.ndarray) -> Samples:
    return replace(samples, battery_v=volts, derived=())


def test_a_voltage_that_mirrors_the_commands_tells_nothing(flown: Samples) -> None:
    collective = np.nan_to_num(flown.motor).mean(axis=1)
    mirrored = with_voltage(flown, 16.0 - 4.0 * (collective - collective.mean()))
    assert voltage.own_span(mirrored) == pytest.approx(0.0, abs=1e-9)
    assert not voltage.tells(mirrored, 0.01)


@pytest.mark.parametrize(("fall", "tells"), [(0.04, False), (0.06, True)])
def test_beside_a_poor_model_a_voltage_tells_from_a_twentieth_on(flown: Samples, fall: float, tells: bool) -> None:
    falling = with_voltage(flown, 16.0 * (1.0 + 0.5 * fall - fall * np.linspace(0.0, 1.0, len(flown.t_s))))
    assert voltage.tells(falling, 5.0) == tells
    assert voltage.tells(falling, 0.1)


def test_plausible_ranges_come_from_the_vehicle() -> None:
    vehicle = quad()
    arm = float(np.max(np.hypot(*vehicle.rotors.position_m[:, :2].T)))
    assert plausible(vehicle, "com_offset", "x_m") == (-arm, arm)
    assert plausible(vehicle, "payload", "mass_kg")[0] == -0.5 * vehicle.mass_kg
    assert plausible(vehicle, "thrust_scale", "scale") == (0.0, 3.0)


def test_no_effect_is_no_end_of_a_range() -> None:
    assert not at_end(quad(), "linear_drag", "d_x_kgps", 0.0)
    assert at_end(quad(), "inertia", "scale_x", 3.0)
    assert at_end(quad(), "payload", "mass_kg", -0.5 * quad().mass_kg)
    assert not at_end(quad(), "com_offset", "z_m", 1.0)


@pytest.mark.parametrize("factor", [0.0, 1.0])
def test_where_the_true_value_may_lie_at_the_end_it_is_no_stand_in(factor: float) -> None:
    """It is one only where the flights want to go beyond: a fit to a real Crazyflie stood at 0 for a shifted mass."""
    effects = {"thrust_curve": {"thrust_model_factor": factor}}
    assert effects_at_bound(quad(), Fit(effects, quad(), np.empty(0), 0.0, 1, 0.0)) == set()
    pressed = Fit(effects, quad(), np.empty(0), 0.0, 1, 0.0, frozenset({"thrust_curve"}))
    assert effects_at_bound(quad(), pressed) == {"thrust_curve"}


def test_a_rope_longer_than_the_flight_was_high_is_none() -> None:
    """Its load would have lain on the ground all the time."""
    hung = Fit({"slung_load": {"mass_kg": 0.06, "length_m": 5.0}}, quad(), np.empty(0), 0.0, 2, 0.0)
    assert effects_at_bound(quad(), hung) == set()
    assert effects_at_bound(quad(), hung, 5.5) == set()
    assert effects_at_bound(quad(), hung, 4.0) == {"slung_load"}


def test_a_thrust_that_is_the_command_s_square_is_found_from_a_file_that_says_half() -> None:
    """A file with 0.5 for a true 1.0 was answered with a force and a wind."""
    half = with_value(quad(), "thrust_curve", {"thrust_model_factor": 0.5})
    samples = batch.fly(quad(), [{"thrust_curve": {"thrust_model_factor": 1.0}}])[0]
    at = samples.t_s - samples.t_s[0]
    verdict = name(half, [samples], [at < 18.0], [at > 20.0])
    assert [found.name for found in verdict.found] == ["thrust_curve"]
    assert verdict.found[0].parameters["thrust_model_factor"].estimate == pytest.approx(1.0, abs=0.01)
    assert not verdict.unexplained.significant


@pytest.mark.parametrize(("pull", "beyond"), [(3.0, []), (5.0, [0]), (-5.0, [])])
def test_the_pull_beyond_an_end_is_told_with_the_others_solved_again(pull: float, beyond: list[int]) -> None:
    """Least squares of unit noise whose first coefficient is best `pull` standard deviations beyond its end (numpy)."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(400, 3)) @ np.array([[1.0, 0.4, 0.0], [0.0, 1.0, 0.3], [0.0, 0.0, 1.0]])
    k = x.T @ x
    best = np.array([pull * np.sqrt(np.linalg.inv(k)[0, 0]), 0.2, -0.1])
    assert pressed_beyond(k, k @ best, np.array([1, 0, 0])) == beyond


@pytest.mark.parametrize(
    ("effect", "values", "kept"),
    [
        ("transport_delay", {"delay_s": 0.406}, {"delay_s": 0.25}),
        ("slung_load", {"mass_kg": 0.2, "length_m": 109.6}, {"mass_kg": 0.2, "length_m": 100.0}),
        ("ground_effect", {"strength": -0.3}, {"strength": 0.0}),
    ],
)
def test_no_value_of_the_workflow_is_refused_by_the_vehicle_file(
    effect: str, values: dict[str, float], kept: dict[str, float]
) -> None:
    changed = with_value(quad(), effect, values)
    assert dict(changed.effects[effect]) == kept
    assert parse_vehicle(vehicle_to_toml(changed), "made").effects[effect] == kept
