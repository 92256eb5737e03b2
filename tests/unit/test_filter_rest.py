"""Where an engaged filter lets the vehicle rest, by h itself; and whose governor's limits hold, and when."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from shipped import load_vehicle
from test_safety_filter import LIMITS, MODEL, QUAD, certified

from flightstack.barrier.assess import ENGAGED
from flightstack.barrier.response import M_GOOD_SINCE, M_MODE
from flightstack.barrier.shapes import value
from flightstack.barrier.torque import governor_terms
from flightstack.safety_filter import BarrierFilter
from flightstack.types import FlatOutput

ORIGIN, CENTRE = np.array([5.0, 6.0, 7.0]), np.array([0.3, -0.2, -1.0])
OFF_M, ROOM_H = 0.01, 0.05
MADE = dataclasses.replace(
    certified(4000),
    centre_ned_m=tuple(CENTRE),
    axes=tuple(
        dataclasses.replace(axis, setting=axis.setting._replace(off_m=OFF_M, inner=0.15))
        for axis in certified(4000).axes
    ),
)


def furthest(axis: int, sign: float) -> float:
    """Of 101 places across the barrier's box the furthest with room at rest, wherever within its doubts it is."""
    own = MADE.axes[axis]
    offs = [(x, y) for x in (-OFF_M, OFF_M) for y in (-own.setting.off_mps, own.setting.off_mps)]
    low, high = own.barrier.box[:2]
    good = [
        e for e in np.linspace(low, high, 101)
        if min(value(own.barrier, e + x, y) for x, y in offs) - own.setting.inner >= ROOM_H
    ]  # fmt: skip
    return float(max(good) if sign > 0.0 else min(good))


def output(pos: np.ndarray) -> FlatOutput:
    return FlatOutput.of(pos, *(k * np.array([1.0, 2.0, 3.0]) for k in (1.0, 10.0, 100.0, 1000.0)), 0.7, 0.1)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_while_engaged_a_reference_outside_is_brought_to_the_furthest_place_of_rest(axis: int, sign: float) -> None:
    safety = BarrierFilter(MODEL, LIMITS)
    state = safety.adopt(safety.init(ORIGIN), MADE)
    middle = output(ORIGIN + CENTRE)
    away = output(ORIGIN + CENTRE + 9.0 * sign * np.eye(3)[axis])
    assert safety.bend(state, away) is away  # not engaged yet
    state.memory[0, M_MODE] = ENGAGED
    assert safety.bend(state, middle) is middle
    bent = safety.bend(state, away)
    wanted = ORIGIN + CENTRE + furthest(axis, sign) * np.eye(3)[axis]
    np.testing.assert_allclose(bent.row[:3], wanted, atol=1e-12)
    moves = away.row[3:15].reshape(4, 3).copy()
    moves[:, axis] = 0.0  # it rests along this axis, and flies on along the others
    np.testing.assert_array_equal(bent.row[3:15].reshape(4, 3), moves)
    np.testing.assert_array_equal(bent.row[15:], away.row[15:])
    assert safety.bend(state._replace(handed_over=True), away) is away


def test_along_an_axis_that_is_not_certified_the_reference_goes_anywhere() -> None:
    safety, down = BarrierFilter(MODEL, LIMITS), certified(4000, (2,))
    state = safety.adopt(safety.init(ORIGIN), down)
    state.memory[0, M_MODE] = ENGAGED
    away = output(ORIGIN + np.array([900.0, -900.0, down.centre_ned_m[2]]))
    assert safety.bend(state, away) is away


def test_the_governors_limits_are_the_certificates_in_force_and_end_with_it() -> None:
    safety = BarrierFilter(MODEL, LIMITS)
    terms = governor_terms(load_vehicle("quad-x"), QUAD, LIMITS, (1e-3, 1e-3, 7e-4))
    state = safety.init(ORIGIN)
    assert safety.governed(state) is None
    assert safety.in_force(state) is None
    bare = safety.adopt(state, MADE)
    assert safety.governed(bare) is None  # it has no governor
    assert safety.in_force(bare) is bare.packed
    state = safety.adopt(state, dataclasses.replace(MADE, governor=terms))
    assert safety.governed(state) is None, "not before the filter is about to engage"
    state.memory[0, M_GOOD_SINCE] = 0.0
    assert safety.governed(state) == terms.limits
    ended = safety.adopt(state, dataclasses.replace(MADE, governor=terms, knowledge={"hand_over": True}))
    assert safety.governed(ended) is None
    assert safety.in_force(ended) is None


def test_where_no_place_has_room_it_rests_in_the_middle() -> None:
    axes = tuple(dataclasses.replace(axis, setting=axis.setting._replace(inner=0.99)) for axis in MADE.axes)
    safety = BarrierFilter(MODEL, LIMITS)
    state = safety.adopt(safety.init(ORIGIN), dataclasses.replace(MADE, axes=axes))
    state.memory[0, M_MODE] = ENGAGED
    bent = safety.bend(state, output(ORIGIN + CENTRE + [0.2, -0.2, 0.1]))
    np.testing.assert_allclose(bent.row[:3], ORIGIN + CENTRE, atol=1e-12)
