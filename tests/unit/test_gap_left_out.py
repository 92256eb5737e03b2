"""What the data check leaves out or what a log can't show: stopped rotors, and a voltage that only mirrors commands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gap import voltage
from gap.checks import stopped
from gap.naming.candidates import at_end, plausible
from gap.records import Samples
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
    kept, findings = stopped.leave_out(cut(flown, 10.0), vehicle)
    t_s = kept.t_s - kept.t_s[0]
    gone = t_s[flown.valid & ~kept.valid]
    assert gone.min() == pytest.approx(10.0, abs=2.0 * kept.dt_s)
    assert gone.max() == pytest.approx(10.0 + CUT_S + 0.5, abs=2.0 * kept.dt_s)
    assert [finding.name for finding in findings] == ["rotors"]


def test_a_flight_whose_rotors_never_stop_is_as_it_was(flown: Samples) -> None:
    assert stopped.leave_out(flown, quad()) == (flown, [])


def test_a_vehicle_that_stops_its_rotors_all_the_time_is_taken_as_it_is(flown: Samples) -> None:
    motor = flown.motor.copy()
    motor[::50] = 0.0
    kept, findings = stopped.leave_out(replace(flown, motor=motor), quad())
    assert np.array_equal(kept.valid, flown.valid)
    assert findings[0].level == "warning"


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
