"""What a vehicle that flew tells of names: one heading all the time makes one class of all that pushes, one of the
four at most is named, and no order of a drag is told beside more."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from shipped import load_vehicle

from flightstack.gap.check import check
from flightstack.gap.classes import beside_a_poor_model
from flightstack.gap.one_heading import on_one_heading
from flightstack.gap.records import Estimate, IdentifiedEffect, Samples
from flightstack_logs.turn import headings, multiply
from tests.flown import flown


@cache
def samples() -> Samples:
    """Its yaw goes to and fro by 0.4 rad."""
    vehicle = load_vehicle("quad-x")
    found = check(flown(vehicle), vehicle).samples
    assert found is not None
    return found


def turned(by_rad: float) -> Samples:
    """The same, turned about the vertical by so much from begin to end."""
    flight = samples()
    half = 0.5 * by_rad * np.linspace(0.0, 1.0, len(flight.t_s))
    about_down = np.column_stack([np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)])
    return replace(flight, q_ned_frd=multiply(about_down, flight.q_ned_frd))


def named(*names: str) -> tuple[IdentifiedEffect, ...]:
    return tuple(IdentifiedEffect(name, {"x": Estimate(0.0, 1.0, 0.9, 1.1)}, -50.0, 0.1, 1e-9) for name in names)


@pytest.mark.parametrize(("by_rad", "one"), [(0.0, True), (0.6, True), (math.pi, False), (4.0 * math.pi, False)])
def test_a_push_has_its_class_for_as_long_as_the_vehicle_keeps_its_heading(by_rad: float, one: bool) -> None:
    drag, tilt = on_one_heading(named("linear_drag", "attitude_misalignment"), [turned(by_rad)])
    assert drag.indistinguishable_from == ()
    assert set(tilt.indistinguishable_from) == (
        {"constant_force", "steady_wind", "accelerometer_bias"} if one else set()
    )
    assert bool(tilt.manoeuvre) is one


def test_what_is_named_beside_is_no_twin() -> None:
    force, wind = on_one_heading(named("constant_force", "steady_wind"), [samples()])
    assert set(force.indistinguishable_from) == {"accelerometer_bias", "attitude_misalignment"}
    assert set(wind.indistinguishable_from) == {"accelerometer_bias", "attitude_misalignment"}


def test_headings_are_yaw_from_north_to_east() -> None:
    """A quarter turn about down takes the nose from north to east."""
    quarter = np.array([[math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4)], [1.0, 0.0, 0.0, 0.0]])
    assert headings(quarter) == pytest.approx([math.pi / 2, 0.0])


@pytest.mark.parametrize(("name", "twin"), [("linear_drag", "rotor_drag"), ("rotor_drag", "linear_drag")])
def test_beside_a_poor_model_no_order_of_a_drag_is_told(name: str, twin: str) -> None:
    (drag,) = named(name)
    assert beside_a_poor_model(drag).indistinguishable_from == (twin,)
    assert "three airspeeds" in beside_a_poor_model(drag).manoeuvre
    (sensor,) = named("gyro_bias")
    assert beside_a_poor_model(sensor) is sensor
