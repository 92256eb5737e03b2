"""How far a certificate's thrust may lean: to each axis what balances its force, and as much to either side."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shipped import load_vehicle

from flightstack.barrier.budgets import budget
from flightstack.barrier.queries import Envelope, Steering, queries
from flightstack.model import Limits, Model

MODEL, LIMITS = Model.from_vehicle(load_vehicle("quad-x")), Limits()
HOVER = 13.7


@pytest.mark.parametrize("wind", [0.0, 0.7, -2.0])
@pytest.mark.parametrize("asked", [0.5, 1.5, 2.5])
def test_a_wind_to_the_north_leaves_the_lean_to_the_east_as_it_is(wind: float, asked: float) -> None:
    """At F0 the leans that are kept give the wind and what is asked for, to either side, whatever blows across."""
    sideways = (wind - asked, wind + asked), (-asked, asked)
    box = budget(MODEL, LIMITS, sideways_mps2=sideways, low_mps2=11.6, hover_mps2=HOVER, tilt_off=0.013)
    lead = max(HOVER, 0.5 * (box.low_mps2 + box.high_mps2))
    np.testing.assert_allclose(lead * np.array(box.kept), sideways, atol=1e-9)
    assert box.lean_spare == pytest.approx(0.013 * 1.05 * box.thrust_max_mps2 / HOVER, rel=1e-9)


@pytest.mark.parametrize("wind", [0.0, 2.0])
@pytest.mark.parametrize("most", [math.inf, 16.0])
def test_every_lean_is_within_the_cone_and_full_thrust_reaches_high_at_the_furthest(wind: float, most: float) -> None:
    for asked in (0.0, 0.5, 2.0, 4.0, 40.0):
        sideways = (wind - asked, wind + asked), (-asked, asked)
        box = budget(MODEL, LIMITS, sideways_mps2=sideways, low_mps2=6.0, high_mps2=most, hover_mps2=HOVER)
        corners = [math.asin(math.hypot(*corner)) for corner in itertools.product(*box.leans)]
        assert max(corners) == pytest.approx(box.tilt_max_rad, abs=1e-9)
        assert box.tilt_max_rad <= LIMITS.tilt_max_rad + 1e-9
        reached = [box.thrust_max_mps2 * math.cos(tilt) for tilt in corners]
        assert min(reached) == pytest.approx(box.high_mps2, rel=1e-9)
        assert box.thrust_max_mps2 * MODEL.mass_kg <= MODEL.thrust_range_n(LIMITS)[1] * (1.0 + 1e-9)


@given(
    st.floats(-1e3, 1e3), st.floats(0.0, 1e3), st.floats(-1e3, 1e3),
    st.sampled_from([-math.inf, -50.0, 0.0, 5.0, math.inf]), st.floats(-1e3, 1e3),
)  # fmt: skip
def test_what_a_tumbling_vehicle_teaches_of_its_hover_raises_nothing(wind, asked, low, high, hover) -> None:
    sideways = (wind - asked, wind + asked), (-asked, asked)
    box = budget(MODEL, LIMITS, sideways_mps2=sideways, low_mps2=low, high_mps2=high, hover_mps2=hover, tilt_off=0.01)
    assert 0.0 <= box.tilt_max_rad <= LIMITS.tilt_max_rad + 1e-9
    assert 0.0 < box.low_mps2 <= box.high_mps2 < math.inf
    for (least, most), (first, last) in zip(box.leans, box.kept, strict=True):
        assert least <= first <= last <= most


def test_bounds_are_asked_for_at_the_ends_of_each_axis_own_leans() -> None:
    """The corners of the box written out, at both ends of the command."""
    box = budget(
        MODEL, LIMITS, sideways_mps2=((-0.8, 2.2), (-1.5, 1.3)), low_mps2=11.6, hover_mps2=HOVER, tilt_off=0.01
    )
    envelope = Envelope(((-1.0, 1.0),) * 3, (0.5, 2.5), nodes=2)
    corners = set(itertools.product(*box.leans))
    steering = Steering(np.array([-1.0, 1.0]), np.array([0.7, 0.75]), HOVER)
    for axis in range(3):
        asked = queries(envelope, box, 0.1, axis, None if axis == 2 else steering).thrust_mps2
        b = asked / np.linalg.norm(asked, axis=-1, keepdims=True)
        for node, end in itertools.product(range(2), range(2)):
            found = {(round(n, 9), round(e, 9)) for n, e in b[node, end, 1:, :2]}
            wanted = corners if axis == 2 else {c for c in corners if c[axis] == box.leans[axis][1 - end]}
            assert found == {(round(n, 9), round(e, 9)) for n, e in wanted}


def test_the_authority_is_what_the_weakest_gain_gives_at_the_leans_that_are_kept() -> None:
    """At one end the weakest gain, at the other, where the wind still has to be balanced, the strongest."""
    box = budget(MODEL, LIMITS, sideways_mps2=((0.5, 3.5), (-1.5, 1.5)), low_mps2=11.6, hover_mps2=HOVER, tilt_off=0.01)
    steering = Steering(np.array([-1.0, 1.0]), np.array([0.7, 0.75]), HOVER)
    lead = max(HOVER, 0.5 * (box.low_mps2 + box.high_mps2))
    for axis in (0, 1):
        wanted = queries(Envelope(((-1.0, 1.0),) * 3, (0.5, 2.5), nodes=2), box, 0.1, axis, steering).wanted_mps2
        least, most = box.kept[axis]
        gives = [[-gain * lead * lean for gain in (0.7, 0.72, 0.75)] for lean in (most, least)]
        assert wanted == pytest.approx((max(gives[0]), min(gives[1])))
