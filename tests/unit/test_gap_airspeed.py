"""Errors of the velocity don't pass for no drag, nor commands that sampling folds in for torques that hardly act."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.gap_cases import Answer, Case, measure, write
from benchmarks.gap_flights import X_SIZE, Senses
from benchmarks.gap_flights import fly as fly_blind
from benchmarks.gap_pilot import Plan
from flightstack.cli.files import load_vehicle
from flightstack.gap.airspeed import doubt, lost, moves, share_of_motion
from flightstack.gap.records import Samples
from flightstack.gap.track import track
from flightstack.gap.workflow import analyse
from flightstack.types import F64
from flightstack.vehicle import with_effects
from tests.gap_flights import as_samples, fly, hidden, quad

DRAG = {"rotor_drag": {"k_d_kg_per_rad": 3e-4}}


def to_and_fro(t: float) -> tuple[F64, F64, F64, float]:
    """Along north, the nose with it: sideways nothing moves."""
    w, size = 2.0 * np.pi / 8.0, 4.0
    pos = np.array([size * np.sin(w * t), 0.0, -5.0])
    vel = np.array([size * w * np.cos(w * t), 0.0, 0.0])
    return pos, vel, np.array([-size * w * w * np.sin(w * t), 0.0, 0.0]), 0.0


def erring(samples: Samples, std_mps: float) -> Samples:
    """The flight with an estimator's slow error (4 s) on its velocity, and its integral kept near the position."""
    keep = np.exp(-samples.dt_s / 4.0)
    noise = np.random.default_rng(5).standard_normal(samples.vel_ned_mps.shape) * std_mps * np.sqrt(1.0 - keep**2)
    return replace(samples, vel_ned_mps=samples.vel_ned_mps + lfilter([1.0], [1.0, -keep], noise, axis=0))


@pytest.fixture(scope="module")
def flown() -> Samples:
    believed = hidden(quad(), DRAG)
    return erring(as_samples(fly(believed, believed, to_and_fro, seconds=45.0, seed=3)), 0.12)


def test_only_where_nothing_moves_the_velocity_is_all_error(flown: Samples) -> None:
    assert moves(flown)
    body = track(flown).vel_ned_mps
    assert float(np.std(body[:, 1])) < 3.0 * float(track(flown).vel_std_mps[1])
    change = doubt(hidden(quad(), DRAG), flown)
    assert np.sqrt(np.mean(change[:, 1, 1] ** 2)) > 5.0 * np.sqrt(np.mean(change[:, 0, 0] ** 2))


def test_the_share_of_an_error_is_that_of_the_motion_s_power(flown: Samples) -> None:
    """A sine of 4 m in 8 s along north, a little less: 3.14 m/s at most, half of its square in the mean."""
    share = share_of_motion(flown, flown.valid)
    north, east, _ = track(flown).vel_std_mps
    assert share[0] == pytest.approx(0.5 * (north**2 + east**2) / (0.5 * np.pi**2), rel=0.15)
    assert share[1] > 100.0 * share[0]
    assert not share_of_motion(flown, np.zeros(len(flown.t_s), np.bool_)).any()


def test_a_free_simulation_that_errs_by_more_than_it_moves_tells_no_drag(flown: Samples) -> None:
    linear = {"linear_drag": {f"d_{axis}_kgps": 0.3 for axis in "xyz"}}
    gone = lost(hidden(quad(), linear), [flown], [flown.valid], ["linear_drag", "payload"])
    assert gone == {("linear_drag", "d_y_kgps")}


def test_in_a_coarse_log_of_a_noisy_loop_torques_say_nothing_of_thrust(tmp_path: Path) -> None:
    """A log of every fiftieth of a second keeps one of twenty commands: roll and pitch follow 0.3 of what it says."""
    believed = load_vehicle("iris")[0]
    truth = with_effects(believed, {"thrust_curve": {"thrust_model_factor": 0.56}})
    plan = Plan()
    plan.hold(1.0, idle=True)
    plan.go(np.array([0.0, 0.0, -3.0]), 1.5)
    plan.hold(26.0)
    flown = fly_blind(believed, truth, plan.reference(), np.zeros(X_SIZE), seed=2, senses=Senses(0.003, 0.02, 0.006))
    table, notes = measure(flown, truth, np.random.default_rng(2), 1.0, 50)
    case = Case(believed, table, Answer({}, "", (), False, notes), truth, flown)
    log = write(case, tmp_path, "hover")[0]
    (found,) = analyse([log], believed).found
    assert found.name == "thrust_curve" or "thrust_curve" in found.indistinguishable_from
