"""The mission's reference: no steps from the ground to the landing, and where it must stay."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from shipped import load_scenario

from flightstack.mission import Mission, plan, require_run_up
from flightstack.types import F64, FlatOutput, InputError

NAMES = ["hover", "figure8", "minimum-snap", "paper-tracking", "paper-barrier", "gps-barrier"]
START = np.array([0.3, -0.7, -0.18])


def made(name: str, yaw: float = 0.0) -> Mission:
    return plan(load_scenario(name).with_duration(12.0), START, yaw)


def row(point: FlatOutput) -> F64:
    return np.stack([point.pos_ned_m, point.vel_ned_mps, point.acc_ned_mps2, point.jerk_ned_mps3])


@pytest.mark.parametrize("name", NAMES)
def test_position_to_jerk_and_yaw_have_no_step_anywhere(name: str) -> None:
    """A step of 1 ms may change each by no more than its own derivative times that."""
    mission, dt = made(name, 2.0), 1e-3
    times = np.arange(0.0, mission.track_end_s + 6.0, dt)
    points = [mission.reference(float(t)) for t in times]
    rows = np.array([row(p) for p in points])
    steps = np.abs(np.diff(rows, axis=0)).max(axis=(0, 2))
    derivatives = np.abs(rows).max(axis=(0, 2))
    snaps = max(float(np.abs(p.snap_ned_mps4).max()) for p in points)
    assert (steps[:3] <= 1.05 * dt * derivatives[1:] + 1e-9).all()
    inside = times[:-1] < mission.track_end_s - dt  # braking begins with the jerk it finds, and ends at rest
    assert np.abs(np.diff(rows[:, 3], axis=0))[inside].max() <= 1.05 * dt * snaps + 1e-6
    yaws = np.unwrap([p.yaw_rad for p in points])
    assert np.abs(np.diff(yaws)).max() <= 1.2 * dt


@pytest.mark.parametrize("name", NAMES)
def test_it_begins_on_the_ground_at_rest_and_ends_at_rest_in_the_air(name: str) -> None:
    mission = made(name)
    np.testing.assert_allclose(row(mission.reference(0.0)), np.stack([START, *np.zeros((3, 3))]), atol=1e-9)
    np.testing.assert_allclose(mission.reference(-1.0).pos_ned_m, START, atol=1e-9)
    end = row(mission.reference(mission.track_end_s + 30.0))
    np.testing.assert_allclose(end[1:], 0.0, atol=1e-6)
    assert end[0, 2] < START[2] - 0.3


@pytest.mark.parametrize("name", NAMES)
def test_once_climbed_it_stays_above_40_cm_and_runs_up_without_haste(name: str) -> None:
    mission = made(name)
    run_up = [mission.reference(float(t)) for t in np.arange(mission.takeoff_end_s, mission.track_start_s, 0.02)]
    assert all(p.pos_ned_m[2] <= START[2] - 0.4 + 1e-6 for p in run_up)
    assert max(float(np.linalg.norm(p.acc_ned_mps2)) for p in run_up) <= 4.01
    climb = [mission.reference(float(t)) for t in np.arange(0.0, mission.takeoff_end_s, 0.01)]
    assert max(-p.vel_ned_mps[2] for p in climb) <= 1.2 + 1e-6
    assert max(abs(p.vel_ned_mps[0]) for p in climb) < 1e-9, "straight up"


def test_a_high_climb_leaves_the_ground_at_once_and_turns_on_its_way() -> None:
    """Gathering speed evenly over two seconds it is 0.5 m v / T t^2 high; one segment to 20 m is 3 cm high by then."""
    mission = made("gps-barrier", 3.0)
    risen = [START[2] - mission.reference(t).pos_ned_m[2] for t in (1.0, 2.0)]
    assert risen[1] == pytest.approx(1.2, rel=1e-6)
    assert 0.1 < risen[0] < 0.3
    assert mission.takeoff_end_s == pytest.approx(20.0 / 1.2 + 2.0)
    times = np.linspace(0.0, mission.takeoff_end_s, 400)
    rates = np.array([abs(mission.reference(float(t)).yaw_rate_radps) for t in times])
    assert rates.max() <= 0.71
    assert rates[times < 2.0].max() < 1e-9
    assert {mission.phase(float(t)) for t in times[:-1]} == {"takeoff"}


def test_phases_come_in_order_and_the_track_lasts_as_long_as_the_scenario_says() -> None:
    mission = made("figure8")
    seen = [mission.phase(t) for t in np.arange(-1.0, mission.track_end_s + 1.0, 0.01).tolist()]
    order = list(dict.fromkeys(seen))
    assert order == ["takeoff", "approach", "track", "done"]
    assert mission.track_end_s - mission.track_start_s == pytest.approx(12.0)


def test_tracking_begins_with_the_scenarios_own_clock_at_the_start_position() -> None:
    scenario, mission = load_scenario("paper-tracking"), made("paper-tracking")
    for t in (0.0, 3.0, 11.9):
        np.testing.assert_allclose(
            mission.reference(mission.track_start_s + t).pos_ned_m, scenario.trajectory.at(t).pos_ned_m + START
        )


@pytest.mark.parametrize("yaw", [3.0, -3.0, 1.0])
def test_the_climb_turns_the_short_way_to_the_trajectorys_heading(yaw: float) -> None:
    mission = made("hover", yaw)
    yaws = [mission.reference(float(t)).yaw_rad for t in np.linspace(0.0, mission.track_start_s, 200)]
    assert math.remainder(yaws[0] - yaw, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert yaws[-1] == pytest.approx(0.0, abs=1e-9)
    assert sum(abs(np.diff(yaws))) == pytest.approx(abs(yaw), abs=1e-6)
    rates = [abs(mission.reference(float(t)).yaw_rate_radps) for t in np.linspace(0.0, mission.track_start_s, 200)]
    assert max(rates) <= 0.71


@pytest.mark.parametrize("t", [0.5, 2.0, 6.0, 10.0, 15.0])
def test_stop_takes_over_without_a_step_and_ends_hovering(t: float) -> None:
    mission = made("figure8")
    stopped = mission.stop(t)
    np.testing.assert_allclose(row(stopped.reference(t)), row(mission.reference(t)), atol=1e-6)
    assert stopped.phase(t - 0.01) == mission.phase(t - 0.01)
    assert stopped.phase(t) == "done"
    np.testing.assert_allclose(row(stopped.reference(t + 20.0))[1:], 0.0, atol=1e-6)
    path = [stopped.reference(t + s) for s in np.arange(0.0, 6.0, 0.02)]
    assert max(float(np.linalg.norm(p.acc_ned_mps2)) for p in path) < 6.0
    assert stopped.track_end_s <= t


def test_stop_from_a_measured_state_starts_there() -> None:
    zero = np.zeros(3)
    state = FlatOutput.of(np.array([1.0, 2.0, -3.0]), np.array([2.0, 0.0, 1.0]), zero, zero, zero, 0.4)
    stopped = made("hover").stop(8.0, state)
    np.testing.assert_allclose(stopped.reference(8.0).pos_ned_m, state.pos_ned_m)
    np.testing.assert_allclose(stopped.reference(8.0).vel_ned_mps, state.vel_ned_mps)
    assert stopped.reference(20.0).yaw_rad == pytest.approx(0.4)


def test_a_descent_is_stopped_above_the_ground() -> None:
    zero = np.zeros(3)
    state = FlatOutput.of(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.5]), zero, zero, zero)
    stopped = made("hover").stop(8.0, state)
    lowest = max(stopped.reference(8.0 + s).pos_ned_m[2] for s in np.arange(0.0, 5.0, 0.02))
    assert lowest <= START[2] - 0.4 + 0.05


@dataclasses.dataclass(frozen=True)
class _StraightUp:
    """Climbing at `speed_mps` from a height on."""

    height_m: float
    speed_mps: float

    def at(self, t_s: float) -> FlatOutput:
        still = np.zeros(3)
        up = np.array([0.0, 0.0, -self.speed_mps])
        return FlatOutput.of(np.array([0.0, 0.0, -self.height_m]) + up * t_s, up, still, still, still)


def test_a_start_that_no_run_up_reaches_is_refused_before_the_flight() -> None:
    """To climb at 4 m/s at half a metre one would have to come out of the ground; from 20 m there is room below."""
    hover = load_scenario("hover")
    low, high = (dataclasses.replace(hover, trajectory=_StraightUp(height, 4.0)) for height in (0.5, 20.0))  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"no run-up reaches its start \(4 m/s at a height of 0.5 m\)"):
        require_run_up(low)
    require_run_up(high)
