"""The scenarios that excite: flown, they show what they are named for; the bounds stand in their descriptions."""

from __future__ import annotations

import functools
import math
from itertools import pairwise

import numpy as np
import pytest
from shipped import load_scenario, load_vehicle

from flightstack.moves import moves
from flightstack.types import F64, InputError
from flightstack_sim.plant import Truth
from tests.closed_loop import fly

QUAD = load_vehicle("quad-x")
G = 9.80665


@functools.cache
def flown(name: str) -> tuple[Truth, ...]:
    """What truly happened, every 4 ms from the beginning of the track."""
    flight = fly(load_scenario(name), QUAD, seed=1)
    return tuple(flight.truths[-len(flight.errors_m) :])


def column(name: str, field: str) -> F64:
    return np.array([getattr(truth, field) for truth in flown(name)])


def heading(name: str) -> F64:
    w, x, y, z = column(name, "q_ned_frd").T
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def body_power(values: F64, low_hz: float, high_hz: float) -> float:
    """Rms of the part of a signal sampled at 250 Hz that lies between two frequencies."""
    spectrum = np.fft.rfft((values - values.mean()) * np.hanning(len(values)))
    at = np.fft.rfftfreq(len(values), 0.004)
    band = (at >= low_hz) & (at < high_hz)
    return float(
        np.sqrt(2.0 * np.sum(np.abs(spectrum[band]) ** 2) / len(values) / np.sum(np.hanning(len(values)) ** 2))
    )


def test_yaw_at_speed_flies_both_ways_along_two_lines_each_with_two_headings() -> None:
    name = "excite-yaw-at-speed"
    vel, yaw = column(name, "vel_ned_mps"), heading(name)
    for axis in (0, 1):
        for sign in (1.0, -1.0):
            fast = sign * vel[:, axis] > 4.0
            assert 0.004 * np.count_nonzero(fast) > 3.0  # seconds, over both headings
            apart = np.abs(np.angle(np.exp(1j * (yaw[fast][:, None] - yaw[fast][None, ::50]))))
            assert np.degrees(apart.max()) > 85.0


def test_rate_doublets_turn_hard_both_ways_about_every_axis_and_little_else() -> None:
    name = "excite-rate-doublets"
    rate, turning = column(name, "rate_frd_radps"), column(name, "angular_acceleration_frd_radps2")
    for axis, least in enumerate((1.0, 1.0, 0.7)):
        assert rate[:, axis].max() > least
        assert rate[:, axis].min() < -least
        slow, quick = body_power(turning[:, axis], 0.0, 0.4), body_power(turning[:, axis], 0.4, 8.0)
        assert quick > 2.0 * slow, f"axis {axis}: {quick:.2f} against {slow:.2f} rad/s^2"
    assert np.abs(column(name, "vel_ned_mps")).max() < 1.5


def test_the_thrust_chirp_has_thrust_at_every_frequency_to_6_hz_and_stands_still_sideways() -> None:
    name = "excite-thrust-chirp"
    thrust = column(name, "rotor_thrust_n").sum(axis=1) / QUAD.weight_n * G
    for low, high in pairwise((0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)):
        assert body_power(thrust, low, high) > 0.1, f"{low} to {high} Hz"
    assert np.abs(column(name, "pos_ned_m")[:, :2]).max() < 0.1
    u = column(name, "motor_u")
    assert u.max() - u.min() > 0.25  # of the command's range: the curve shows


def test_the_low_pass_meets_the_ground_many_times_at_heights_that_speed_does_not_tell() -> None:
    name = "excite-low-pass"
    height = -column(name, "pos_ned_m")[:, 2]
    radius = QUAD.rotors.radius_m
    assert height.min() / radius < 1.6
    assert height.max() / radius > 8.0
    low = height < 2.0 * radius
    assert np.count_nonzero(np.diff(low.astype(int)) == 1) >= 6  # passes
    vel = column(name, "vel_ned_mps")
    share = (radius / (4.0 * np.maximum(height, radius))) ** 2
    for other in (np.linalg.norm(vel[:, :2], axis=1), vel[:, 2], np.arange(len(height), dtype=float)):
        assert abs(np.corrcoef(share, other)[0, 1]) < 0.3


def test_a_move_peaks_as_its_polynomial_says_and_stays_where_it_ends() -> None:
    """Over d in T: speed 35/16 d/T at the middle; d and the turn are reached, then it stands."""
    path = moves([[2.0, 1.0, 3.0, 0.0, -1.0, 0.5], [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]], (0.0, 0.0, -1.0), 0.1, "here")
    assert path.duration_s == pytest.approx(4.0)
    assert path.at(1.0).vel_ned_mps[0] == pytest.approx(35.0 / 16.0 * 3.0 / 2.0)
    for t in (2.0, 2.7, 3.0):
        np.testing.assert_allclose(path.at(t).pos_ned_m, [3.0, 0.0, -2.0], atol=1e-12)
        np.testing.assert_allclose(path.at(t).vel_ned_mps, 0.0, atol=1e-12)
        assert path.at(t).yaw_rad == pytest.approx(0.6)
    np.testing.assert_allclose(path.at(99.0).pos_ned_m, [3.0, 1.0, -2.0], atol=1e-12)


@pytest.mark.parametrize(
    ("value", "complaint"),
    [
        ([], "must be a list of 1 to 200 moves"),
        ([[1.0, 0.0, 0.0]], "move 1"),
        ([[1.0, 0.0, 1.0, 0.0, 0.0, 0.0], [0.01, 0.0, 1.0, 0.0, 0.0, 0.0]], "move 2: move_s"),
        ([[1.0, 0.0, math.nan, 0.0, 0.0, 0.0]], "move 1: north_m"),
    ],
)
def test_what_is_wrong_with_a_list_of_moves_is_named(value: object, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        moves(value, (0.0, 0.0, -1.0), 0.0, "here")
