"""The search in flight: what it finds keeps its own ledger, and a certificate is made again for what is known now."""

from __future__ import annotations

import numpy as np
import pytest
from barriers import h, whole
from measured import measured

from flightstack.barrier.condition import interval
from flightstack.barrier.design import SafeSet
from flightstack.barrier.flown import FlownPath, planned_of
from flightstack.barrier.margins import Accuracy, Ledger
from flightstack.barrier.records import Authority, AxisCertificate, Response
from flightstack.barrier.search import Axis, largest_steps
from flightstack.region import Region
from flightstack.trajectory import Sinusoid
from flightstack.types import Measurement

SLOW = Response(0.06, 0.0, 0.035)
"""Rotors and a link as bad as a flight may have them."""


def asked(error: float, low: float = -3.2, high: float = 2.8) -> tuple[Axis, Ledger]:
    v, one = np.linspace(-1.4, 1.4, 8), np.ones(8)
    authority = Authority(v, high * one, one, low * one, high * one, error * one, error * one)

    needs = Ledger(2, authority, SLOW, gamma_ps=0.5, dt_s=0.012, inside_ps=20.0)
    return Axis(2, SafeSet(0.6, 1.4), authority, SLOW), needs


def proven(axis: Axis, needs: Ledger, found: AxisCertificate) -> None:
    """Its own ledger asks no more than it was made with, and on a fine grid there is a command everywhere."""
    own, _ = needs(found.barrier)
    assert own.eta <= found.setting.eta
    assert own.off_m <= found.setting.off_m
    assert own.off_mps <= found.setting.off_mps
    assert own.inner <= found.setting.inner
    e_low, e_high, v_low, v_high = found.barrier.box
    e, v = (each.ravel() for each in np.meshgrid(np.linspace(e_low, e_high, 61), np.linspace(v_low, v_high, 61)))
    inside = h(found.barrier, e, v) >= found.setting.inner - found.setting.eta
    margins = [
        interval(found.barrier.rows, x, y, found.setting, axis.authority.reach(y))[2]
        for x, y in zip(e[inside], v[inside], strict=True)
    ]
    assert len(margins) > 1000
    assert min(margins) >= 0.0


def test_slow_rotors_and_a_late_link_leave_a_region_of_a_fair_size() -> None:
    axis, needs = asked(0.5)
    found = whole(largest_steps(axis, needs))
    assert found is not None
    proven(axis, needs, found[0])
    assert found[0].barrier.area_m2ps > 0.5 * np.pi * 0.6 * 1.1  # half of the ellipse that 2 m/s^2 brake in 0.6 m


def test_without_enough_braking_there_is_none() -> None:
    axis, needs = asked(0.5)
    first = whole(largest_steps(axis, needs))
    assert first is not None
    axis, needs = asked(1.2, low=-1.0, high=1.0)
    assert whole(largest_steps(axis, needs)) is None


NORTH = SafeSet(2.0, 1.8)
REGION = Region("axes", (0.0, 0.0, -1.5), (2.0, 1.5, 1.0), (1.8, 1.8, 0.9))


def at(t_s: float, north_m: float, north_mps: float) -> Measurement:
    return measured(
        int(1e6 * t_s), np.array([north_m, 0.0, -1.5]), np.array([north_mps, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0]),
        np.zeros(3), np.zeros(3), np.full(4, np.nan), 0, 0, 0,
    )  # fmt: skip


def path() -> FlownPath:
    """The paper's to north: 1.5 m, 0.6 rad/s, 12 s of it."""
    flown = FlownPath()
    for t_s in np.arange(0.0, 12.0, 0.1):
        flown.take(at(float(t_s), 1.5 * np.sin(0.6 * t_s), 0.9 * np.cos(0.6 * t_s)), REGION, np.zeros(3))
    return flown


def to_north() -> tuple[Axis, Ledger]:
    """With the bounds of some 12 s of learning: 0.6 of 2 m/s^2."""
    v, one = np.linspace(-1.8, 1.8, 8), np.ones(8)
    authority = Authority(v, 0.0 * v, 0.0 * v, -2.0 * one, 2.0 * one, 0.6 * one, 0.6 * one)
    response = Response(0.154, 0.007, 0.005)

    needs = Ledger(
        0, authority, response, gamma_ps=0.5, dt_s=0.004, inside_ps=20.0,
        accuracy=Accuracy(0.022, 0.045, 0.13), coupling_mps=0.02,
    )  # fmt: skip
    return Axis(0, NORTH, authority, response), needs


def test_a_search_for_the_room_of_a_path_finds_more_of_it_than_the_largest_region_has() -> None:
    axis, needs = to_north()
    worth = path().worth(axis, needs, 0.0, 0.0)
    largest, roomy = whole(largest_steps(axis, needs)), whole(largest_steps(axis, needs, worth=worth))
    assert largest is not None
    assert roomy is not None
    proven(axis, needs, roomy[0])
    assert worth(roomy[0].barrier) > worth(largest[0].barrier)
    t_s = np.arange(0.0, 12.0, 0.01)
    e, v = 1.5 * np.sin(0.6 * t_s), 0.9 * np.cos(0.6 * t_s)
    ahead = axis.response.c1_s + axis.response.delay_s
    off = needs(roomy[0].barrier)[0].off_mps
    there = [h(roomy[0].barrier, e + ahead * v, v + sign * off) for sign in (-1.0, 1.0)]
    found = np.minimum(h(roomy[0].barrier, e, v), np.minimum(*there))
    assert worth(roomy[0].barrier) == pytest.approx(np.min(found), abs=0.02)


def test_what_was_flown_before_the_edge_was_near_is_forgotten() -> None:
    axis, needs = to_north()
    found = whole(largest_steps(axis, needs))
    assert found is not None
    flown, area = path(), found[0].barrier.area_m2ps
    assert flown.worth(axis, needs, 0.0, 0.0)(found[0].barrier) < 1.0
    flown.take(at(20.0, 1.8, 0.0), REGION, np.zeros(3))
    assert flown.worth(axis, needs, 0.0, 0.0)(found[0].barrier) == area


def to_north_by(amplitude_m: float) -> Sinusoid:
    rows = ([0.0, 0.0, -1.5], [amplitude_m, 0.0, 0.0], [0.6, 0.6, 0.6], [0.0, 0.0, 0.0])
    return Sinusoid(np.array(rows))


def test_what_is_planned_counts_before_it_is_flown_and_with_what_was() -> None:
    axis, needs = to_north()
    planned = planned_of(to_north_by(1.5), 12.0, REGION)
    assert planned[:, 0] == pytest.approx(1.5 * np.sin(0.6 * np.arange(0.0, 12.0, 0.25)))
    assert planned[:, 3] == pytest.approx(0.9 * np.cos(0.6 * np.arange(0.0, 12.0, 0.25)))
    found = whole(largest_steps(axis, needs))
    assert found is not None
    flown = FlownPath(planned)
    asked = path().worth(axis, needs, 0.0, 0.0)(found[0].barrier)
    assert flown.worth(axis, needs, 0.0, 0.0)(found[0].barrier) == pytest.approx(asked, abs=0.02)
    assert flown.worth(axis, needs, 0.0, 7.0)(found[0].barrier) == flown.worth(axis, needs, 0.0, 0.0)(found[0].barrier)
    for number in range(20):  # slower than the plan
        flown.take(at(0.1 * number, 0.1, 0.0), REGION, np.zeros(3))
    assert flown.worth(axis, needs, 0.0, 0.0)(found[0].barrier) == pytest.approx(asked, abs=0.02)


def test_what_is_planned_near_the_edge_of_what_was_asked_for_does_not_count() -> None:
    planned = planned_of(to_north_by(1.9), 60.0, REGION)
    assert 0 < len(planned) < 120
    assert ((planned[:, 0] / 2.0) ** 2 + (planned[:, 3] / 1.8) ** 2).max() <= 0.7
    outside = to_north_by(1.5).moved(np.array([9.0, 0.0, 0.0]))
    assert planned_of(outside, 60.0, REGION).shape == (0, 6)
