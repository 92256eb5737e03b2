"""Every premise that a flight can see: noticed at the first tick of breach, ended after 20 ms of it, never before.

What comes late (commands, messages) ends a certificate where the vehicle was not inside afterwards, or after 0.2 s of
lapses.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from measured import measured as measured_at

from flightstack.barrier.estimate_bounds import BENCH, does_not_fit, estimate_bounds
from flightstack.barrier.premise_watch import (
    NAMES,
    RATE_GAINS,
    Seen,
    WatchState,
    ended_by,
    is_inside,
    watch,
    watched,
)
from flightstack.barrier.premises import Premises
from flightstack.cli.sensors import error_statistics
from flightstack.frames import quat_from_euler, quat_to_matrix
from flightstack.region import Region
from flightstack.types import Command, Filtered, Learned, Measurement, changed
from flightstack_sim.grade import load_grade

MASS_KG = 1.2
PREMISES = Premises(
    "mocap", "", BENCH, ((-0.5, 0.5), (-0.4, 0.4), (-1.5, 1.5)), ((-0.1, 0.2), (-0.2, 0.1)), (5.0, 15.0), (0.97, 1.03),
    (0.6, 0.8), (0.0, 0.01), 0.002, 0.004, 0.004, (14.0, 16.8),
)  # fmt: skip


def measured(**changes: Any) -> Measurement:
    """Hovering, everything fresh; the battery at 15 V."""
    given: dict[str, Any] = {
        "t_us": 0, "pos_ned_m": np.array([0.1, 0.2, -1.0]), "vel_ned_mps": np.zeros(3),
        "q_ned_frd": np.array([1.0, 0.0, 0.0, 0.0]), "rate_frd_radps": np.zeros(3),
        "specific_force_frd_mps2": np.array([0.0, 0.0, -9.8]), "motor_command": np.full(4, math.nan),
        "position_age_us": 4000, "attitude_age_us": 2000, "imu_age_us": 1000,
    }  # fmt: skip
    battery_v = changes.pop("battery_v", 15.0)
    made = measured_at(**(given | changes))
    made.battery_v = battery_v
    return made


def seen(**changes: Any) -> Seen:
    """10 m/s^2 commanded 4 ms ago, a gain of 0.7 learned."""
    learned = changed(Learned.nothing(), stage=2.0, thrust_gain=0.7, latency_s=0.005)
    learned = changed(learned, **{key: changes.pop(key) for key in ("thrust_gain", "latency_s") if key in changes})
    thrust = changes.pop("thrust_mps2", 10.0) * MASS_KG
    given = {
        "sent": Command(0, thrust, 0.5, np.zeros(3)),
        "learned": learned,
        "applied_ratio": 1.0,
        "interval_s": 0.004,
    }
    return Seen(**(given | changes))


def run(ticks: int, state: WatchState, measurement: Measurement, tick: Seen) -> WatchState:
    for _ in range(ticks):
        state = watch(state, measurement, tick, MASS_KG, 0.0)
    return state


BREACHES: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("speed north", {"vel_ned_mps": np.array([0.51, 0.0, 0.0])}, {}),
    ("speed east", {"vel_ned_mps": np.array([0.0, -0.41, 0.0])}, {}),
    ("speed down", {"vel_ned_mps": np.array([0.0, 0.0, -1.6])}, {}),
    ("lean north", {"q_ned_frd": quat_from_euler(0.0, 0.22, 0.0)}, {}),
    ("lean east", {"q_ned_frd": quat_from_euler(-0.12, 0.0, 0.0)}, {}),
    ("lean north", {"q_ned_frd": quat_from_euler(0.0, -0.12, 0.0)}, {}),
    ("lean east", {"q_ned_frd": quat_from_euler(0.22, 0.0, 0.0)}, {}),
    ("thrust", {}, {"thrust_mps2": 4.9}),
    ("thrust", {}, {"thrust_mps2": 15.2}),
    ("applied thrust", {}, {"applied_ratio": 0.93}),
    ("thrust gain", {}, {"thrust_gain": 0.55}),
    ("delay", {}, {"latency_s": 0.03}),
    ("battery", {"battery_v": 13.2}, {}),
]


@pytest.mark.parametrize(("name", "measurement", "tick"), BREACHES)
def test_a_breach_is_told_at_once_and_ends_the_certificate_after_20_ms(
    name: str, measurement: dict[str, Any], tick: dict[str, Any]
) -> None:
    state = run(50, watched(1, PREMISES), measured(), seen())
    assert (state.broken, state.ended, state.rest) == (0, 0, None)
    bad, when = measured(**measurement), seen(**tick)
    state = run(1, state, bad, when)
    assert NAMES[state.broken] == name
    assert not state.ended
    ticks = math.ceil(0.02 / when.interval_s) - 1
    state = run(ticks, state, bad, when)
    assert NAMES[state.ended] == name
    assert state.rest is not None
    np.testing.assert_array_equal(state.rest.vel_ned_mps, np.zeros(3))
    state = run(100, state, measured(), seen())
    assert NAMES[state.ended] == name, "what ended it does not come back by itself"


def test_what_the_link_takes_counts_where_the_imu_shows_no_latency() -> None:
    """30 ms there and back by its round trips, where the certificate counts on commands much sooner; a link quicker
    than that says nothing of the rest of their way."""
    unknown, late, quick = seen(latency_s=math.nan), measured(), measured()
    late.late_us, quick.late_us = 30_000, 2_500
    assert run(50, watched(1, PREMISES), quick, unknown).broken == 0
    assert run(50, watched(1, PREMISES), measured(), unknown).broken == 0
    assert NAMES[run(50, watched(1, PREMISES), late, unknown).ended] == "delay"


LAPSES: list[tuple[str, dict[str, Any], dict[str, Any], int]] = [
    ("link", {"position_age_us": 20_000}, {}, 50),
    ("link", {"attitude_age_us": 10_000}, {}, 50),
    ("link", {"imu_age_us": 9_000}, {}, 50),
    ("link", {"position_age_us": 5_000, "attitude_age_us": 5_000, "imu_age_us": 5_000}, {}, 50),
    ("command interval", {}, {"interval_s": 0.009}, 40),
]
"""Name, what is late, and after how many such ticks 0.2 s of it are reached: of an interval what is beyond 4 ms."""


@pytest.mark.parametrize(("name", "measurement", "tick", "ticks"), LAPSES)
def test_what_comes_late_is_told_at_once_and_ends_the_certificate_after_a_fifth_of_a_second(
    name: str, measurement: dict[str, Any], tick: dict[str, Any], ticks: int
) -> None:
    late, when = measured(**measurement), seen(**tick)
    state = run(1, watched(1, PREMISES), late, when)
    assert NAMES[state.broken] == name
    state = run(ticks - 2, state, late, when)
    assert not state.ended
    state = run(2, state, late, when)  # a sum of so many floating-point numbers may be a hair below
    assert NAMES[state.ended] == name
    assert state.rest is not None


@pytest.mark.parametrize("interval_s", [0.013, 0.03, 0.1])
def test_one_late_command_ends_nothing_where_the_vehicle_is_inside_at_the_next_tick(interval_s: float) -> None:
    state = run(1, watched(1, PREMISES), measured(), seen(interval_s=interval_s))
    assert (NAMES[state.broken], state.ended) == ("command interval", 0)
    inside, outside = run(1, state, measured(), seen()), run(1, state, measured(), seen(is_inside=False))
    assert (inside.broken, inside.ended, inside.rest) == (0, 0, None)
    assert NAMES[outside.ended] == "command interval"
    assert outside.rest is not None


def test_a_gap_so_long_that_nothing_was_promised_for_a_fifth_of_a_second_ends_it_at_once() -> None:
    assert NAMES[run(1, watched(1, PREMISES), measured(), seen(interval_s=0.205)).ended] == "command interval"


def test_outside_where_nothing_was_late_is_for_the_filter_to_judge() -> None:
    assert not run(50, watched(1, PREMISES), measured(), seen(is_inside=False)).ended


def test_late_ticks_are_paid_back_by_a_quarter_of_the_time_between() -> None:
    state, late = watched(1, PREMISES), seen(interval_s=0.008)
    for _ in range(200):  # 4 ms beyond, four ticks that give back 1 ms each
        state = run(4, run(1, state, measured(), late), measured(), seen())
    assert not state.ended
    for _ in range(200):
        state = run(3, run(1, state, measured(), late), measured(), seen())
    assert NAMES[state.ended] == "command interval"


@pytest.mark.parametrize(
    ("status", "h", "h_state", "inside"),
    [(2.0, 0.1, 0.05, True), (3.0, 0.05, 0.3, True), (2.0, 0.049, 0.3, False), (2.0, 0.3, 0.049, False),
     (4.0, 0.3, 0.3, False), (5.0, 0.3, 0.3, False), (1.0, 0.3, 0.3, False), (2.0, math.nan, 0.3, False)],
)  # fmt: skip
def test_inside_is_where_the_filter_engages_and_has_a_command(
    status: float, h: float, h_state: float, inside: bool
) -> None:
    assert is_inside(changed(Filtered.nothing(), status=status, h=h, h_state=h_state)) is inside


def test_single_ticks_now_and_then_end_nothing() -> None:
    state = watched(1, PREMISES)
    for _ in range(100):
        state = run(1, state, measured(imu_age_us=9_000), seen())
        state = run(4, state, measured(), seen())
    assert not state.ended


def test_what_is_not_known_breaks_nothing() -> None:
    state = run(50, watched(1, PREMISES), measured(battery_v=math.nan), seen(latency_s=0.0))
    assert (state.broken, state.ended) == (0, 0)


def test_a_narrower_premise_is_broken_by_what_the_wider_one_allows() -> None:
    lax = replace(PREMISES, leans=((-0.3, 0.3), (-0.3, 0.3)))
    leaning = measured(q_ned_frd=quat_from_euler(0.0, 0.25, 0.0))
    assert not run(50, watched(1, lax), leaning, seen()).ended
    assert run(50, watched(1, PREMISES), leaning, seen()).ended


def test_gps_does_not_fit_the_papers_regions_and_fits_a_large_one() -> None:
    gps, mocap = (estimate_bounds(error_statistics(load_grade(name))) for name in ("gps", "mocap"))
    small = Region("ellipsoid", (0.0, 0.0, -0.8), (0.4, 0.4, 0.6), (0.5, 0.5, 0.4))
    large = Region("ellipsoid", (0.0, 0.0, -12.0), (8.0, 8.0, 8.0), (4.0, 4.0, 4.0))
    said = does_not_fit(gps, small, (2,))
    assert "position down is known to 0.89 m (4.3 sigma)" in said
    assert does_not_fit(mocap, small, (2,)) == ""
    assert does_not_fit(gps, large, (0, 1, 2)) == ""


GREATEST, BOUND, FLOWN = 15.0, 0.4, 13.0
DOWN_SAYS = np.array([[-1.5, 1.5], [9.6, 10.0], [0.7, 0.7], [-1.0, -1.0], [6.0, 6.0], [BOUND, BOUND], [BOUND, BOUND]])
"""Gravity and a drag of 0.133 /s upwards of it; a gain of 0.7 that is known to 0.4 m/s^2 at 5 and at 15 m/s^2."""
HELD_GAIN = replace(PREMISES, thrust_gain=(0.7 - BOUND / GREATEST, 0.7 + BOUND / GREATEST))


def knows(gain: float, constant_mps2: float, applied_mps2: float = FLOWN) -> Seen:
    """A learner that says: acceleration down = g + constant - gain * thrust, while so much thrust acts."""
    residual = np.array([0.0, 0.0, (1.0 - gain) * applied_mps2 + constant_mps2])
    applied_n = applied_mps2 * MASS_KG
    learned = changed(seen().learned, thrust_gain=gain, applied_thrust_n=applied_n, residual_frd_mps2=residual)
    return seen()._replace(learned=learned)


def ended(tick: Seen, premises: Premises = HELD_GAIN, **measurement: Any) -> str:
    """What ends a certificate of DOWN_SAYS."""
    drag = (0.05, 0.06, 0.1)
    return NAMES[run(50, watched(1, premises, DOWN_SAYS, drag), measured(**measurement), tick).ended]


MIDDLE = 9.8 - 9.80665
"""What DOWN_SAYS has beside gravity at rest."""


def test_slope_and_constant_that_trade_against_each_other_end_nothing() -> None:
    for gain in (0.66, 0.74):  # beyond the range by themselves; off by 0.4 * 10 / 13 = 0.31 m/s^2 at 5 m/s^2
        assert not HELD_GAIN.thrust_gain[0] <= gain <= HELD_GAIN.thrust_gain[1]
        assert not ended(knows(gain, MIDDLE + (gain - 0.7) * FLOWN))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_thrust_that_changes_by_a_share_is_noticed_where_it_leaves_the_bound(sign: float) -> None:
    edge = BOUND / (0.7 * GREATEST)  # 3.8 %: the certificate's bound at the greatest thrust
    for share, name in ((0.98 * edge, ""), (1.02 * edge, "thrust gain")):
        assert ended(knows(0.7 * (1.0 + sign * share), MIDDLE)) == name
    # taken for a constant it is as much at every thrust: the slope alone would never tell
    for off, name in ((0.98 * BOUND, ""), (1.02 * BOUND, "thrust gain")):
        assert ended(knows(0.7, MIDDLE + sign * off)) == name


@pytest.mark.parametrize("end", [5.0, 15.0])
def test_a_slope_is_noticed_where_it_leaves_the_bound_at_either_end(end: float) -> None:
    for share, name in ((0.98, ""), (1.02, "thrust gain")):
        flown = 20.0 - end  # the other end
        off = share * BOUND / (end - flown)
        assert ended(knows(0.7 + off, MIDDLE + off * flown, flown)) == name


def test_lean_speeds_and_believed_drag_are_counted_with() -> None:
    """A truth of the certificate's own, leaning and moving: nothing is apart, by vectors written out here."""
    narrow = replace(PREMISES, thrust_gain=(0.7 - 1e-6, 0.7 + 1e-6))
    q, vel = quat_from_euler(0.1, -0.15, 0.7), np.array([0.3, -0.2, 1.2])
    turn = np.array(quat_to_matrix(q))
    said_down = np.interp(vel[2], [-1.5, 1.5], [9.6, 10.0]) - 0.7 * FLOWN * turn[2, 2]
    specific_ned = np.array([0.3, -0.1, said_down - 9.80665])
    residual = turn.T @ specific_ned + np.array([0.0, 0.0, FLOWN]) + np.array([0.05, 0.06, 0.1]) * (turn.T @ vel)
    tick = knows(0.7, 0.0)
    tick = tick._replace(learned=changed(tick.learned, residual_frd_mps2=residual))
    assert not ended(tick, narrow, q_ned_frd=q, vel_ned_mps=vel)
    off = changed(tick.learned, residual_frd_mps2=residual + np.array([0.0, 0.0, 1e-4]))
    assert ended(tick._replace(learned=off), narrow, q_ned_frd=q, vel_ned_mps=vel) == "thrust gain"


def test_what_the_learner_cannot_say_leaves_the_slope_to_be_compared() -> None:
    lost = seen(thrust_gain=0.55)
    assert ended(lost) == "thrust gain"
    assert not ended(seen())


def test_other_rate_gains_end_a_certificate_at_once_and_for_good() -> None:
    """PX4 tells of them; no tick shows them."""
    still = seen()
    before = run(5, watched(3, PREMISES), measured(), still)
    moving = measured(vel_ned_mps=np.array([0.4, 0.0, -0.2]), q_ned_frd=quat_from_euler(0.0, 0.0, 0.7))
    after = ended_by(before, moving, RATE_GAINS)
    assert NAMES[after.ended] == "rate gains"
    assert after.rest is not None
    np.testing.assert_allclose(after.rest.row[:3], [0.1 + 0.3 * 0.4, 0.2, -1.0 - 0.3 * 0.2])
    assert after.rest.yaw_rad == pytest.approx(0.7)
    later = run(100, after, measured(), still)
    assert (later.ended, later.rest) == (RATE_GAINS, after.rest)
    assert ended_by(later, moving, RATE_GAINS) is later
    assert ended_by(WatchState(), moving, RATE_GAINS).ended == 0, "nothing is in force"
