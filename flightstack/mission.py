"""A flight as one reference over time: climb, settle, run-up, track, and how to stop.

From the ground the vehicle climbs straight up to the height at which the trajectory starts, turning to its yaw (by more
than the climb has time for afterwards, in a high climb at a steady speed: on the ground it can't), waits a moment, then
runs up by one minimum-snap segment to the trajectory's whole first state (position to jerk), so that tracking begins
without a step.  After the trajectory the reference brakes and stands still; by then the companion has been told "done"
and lands.  Time is seconds since take-off began; coordinates are those of the vehicle's estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from flightstack.scenario import Scenario
from flightstack.trajectory import Boundary, Polynomial, Trajectory, hover, minimum_snap
from flightstack.types import F64, FlatOutput, InputError, changed

_CLIMB_MPS = 1.2
_YAW_RATE_RADPS = 0.7
_REST_TO_REST_PEAK = 2.1875  # peak speed of the rest-to-rest segment, in mean speeds
_HIGH_M = 3.5
"""A higher climb gathers speed first: one segment from rest to rest would take ten seconds to rise by half a metre,
over which a vehicle stands on the ground with nearly the thrust that lifts it."""
_GATHER_S = 2.0
"""To the climb's speed, and from it to rest."""
_SETTLE_S = 1.5
RUN_UPS_S = (*(3.0 * 1.15**k for k in range(22)), *(3.0 / 1.15**k for k in range(1, 10)))
"""Durations tried in their order: 3 s, longer ones up to a minute for fast starts, shorter ones where one would have to
come from below the ground."""
LEAST_RISE = 0.5
"""Share of the first climb's height that a flight has to reach."""
_LEAST_HEIGHT_M = 0.4
_LEAST_CLIMB_S = 1.5
_ACC_MAX_MPS2 = 4.0
_SPEED_MAX_MPS = 4.0
_PEAKS_S = 60.0
_PEAKS_POINTS = 601
_REJOINS_S = (1.5, 2.25, 3.4, 5.0, 7.0)
"""Durations of the way back to the reference, tried in their order."""
_REJOIN_ACC_MPS2 = 2.5
"""At most, where the reference itself asks for less: drag comes on top, and both are tilt."""
_REJOIN_SPEED_MPS = 2.0
_REJOIN_SINK_M = 0.1
"""It may lead so far below both of its ends."""
_BRAKE_MPS2 = 2.5
_SHORTEST_BRAKE_S = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class _Leg:
    """A part of the mission: from `start_s` on, `trajectory` at (t - start_s)."""

    phase: str
    start_s: float
    trajectory: Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Mission:
    """The reference of one flight; `plan` makes it, `stop` cuts it short."""

    legs: tuple[_Leg, ...]
    ground_down_m: float
    """Down coordinate of the ground at the start."""
    takeoff_end_s: float
    """The climb is over."""
    track_start_s: float
    """From here on the scenario's trajectory is flown (and its clock runs)."""
    track_end_s: float
    """Land from here on."""
    detour: _Leg | None = None
    """Flown instead of the legs while it lasts."""

    def reference(self, t_s: float) -> FlatOutput:
        """Flat outputs at `t_s` seconds since take-off began."""
        leg = self.detour
        if leg is None or not leg.start_s <= t_s < leg.start_s + leg.trajectory.duration_s:
            leg = self._leg(t_s)
        return leg.trajectory.at(max(t_s - leg.start_s, 0.0))

    def phase(self, t_s: float) -> str:
        """One of takeoff, approach, track, done."""
        return self._leg(t_s).phase

    def _leg(self, t_s: float) -> _Leg:
        for leg in reversed(self.legs):
            if leg.start_s <= t_s:
                return leg
        return self.legs[0]

    def then(self, t_s: float, trajectory: Trajectory) -> Mission:
        """The same mission, with `trajectory` (in the coordinates of `reference`) flown from `t_s` on, up to
        `track_end_s`."""
        before = tuple(leg for leg in self.legs if leg.start_s < t_s)
        after = tuple(leg for leg in self.legs if leg.start_s >= max(t_s, self.track_end_s))
        return replace(self, legs=(*before, _Leg("track", t_s, trajectory), *after))

    def rejoin(self, t_s: float, state: FlatOutput) -> Mission:
        """The same mission from where the vehicle is at `t_s`: a smooth way back to its reference, no shorter than
        comfortable; phases and times stay."""
        whole = replace(self, detour=None)
        path = None
        for duration in _REJOINS_S:
            goal = whole.reference(t_s + duration)
            yaw = goal.yaw_rad + math.remainder(state.yaw_rad - goal.yaw_rad, 2.0 * math.pi)
            ends = np.stack([np.append(state.pos_ned_m, yaw), np.append(goal.pos_ned_m, goal.yaw_rad)])
            times = np.array([0.0, duration])
            path = minimum_snap(ends, times, start=Boundary.of(state), end=Boundary.of(goal))
            if _is_comfortable(path, state, goal):
                break
        return replace(self, detour=None if path is None else _Leg("rejoin", t_s, path))

    def stop(self, t_s: float, state: FlatOutput | None = None) -> Mission:
        """The same mission, broken off at `t_s`: brake smoothly from `state` (default: the reference) and hover."""
        kept = tuple(leg for leg in self.legs if leg.start_s < t_s) or self.legs[:1]
        brake = _Leg("done", t_s, _braking(state or self.reference(t_s), self.ground_down_m))
        return replace(
            self,
            detour=None,
            legs=(*kept, brake),
            takeoff_end_s=min(self.takeoff_end_s, t_s),
            track_start_s=min(self.track_start_s, t_s),
            track_end_s=min(self.track_end_s, t_s),
        )


class RunUp(NamedTuple):
    """The way from above the start to the trajectory's first state; the same wherever the vehicle stands."""

    path: Polynomial | None
    """None: the trajectory begins there."""
    is_comfortable: bool
    """False: none is, and this is the shortest."""


def run_up_of(scenario: Scenario) -> RunUp:
    """The run-up of a scenario; takes some 20 ms, too long for a tick."""
    first = scenario.trajectory.at(0.0)
    return _run_up(_above(scenario, first), first, scenario.run_up_s, *_peaks(scenario))


def plan(scenario: Scenario, start_pos_ned_m: F64, start_yaw_rad: float = 0.0, run_up: RunUp | None = None) -> Mission:
    """The mission that flies `scenario` from where the vehicle stands (3,) with its present heading.

    `run_up`: of `run_up_of`, where it was worked out before.
    """
    start = np.array(start_pos_ned_m, dtype=np.float64)
    first = scenario.trajectory.at(0.0)
    turn = math.remainder(first.yaw_rad - start_yaw_rad, 2.0 * math.pi)
    above = _above(scenario, first)
    ground = np.array([0.0, 0.0, 0.0, first.yaw_rad - turn])
    legs, ready_s, climb_s = list[_Leg](), 0.0, 0.0
    for phase, part in _climb(ground, above):
        legs.append(_Leg(phase, ready_s, part.moved(start)))
        ready_s += part.duration_s
        climb_s = ready_s if phase == "takeoff" else climb_s
    path = (run_up or run_up_of(scenario)).path
    _, _, down, yaw = above
    settled = hover((0.0, 0.0, float(down)), yaw_rad=float(yaw))
    legs.append(_Leg("approach", ready_s, settled.moved(start)))
    ready_s += _SETTLE_S
    track_start_s = ready_s if path is None else ready_s + path.duration_s
    if path is not None:
        legs.append(_Leg("approach", ready_s, path.moved(start)))
    legs.append(_Leg("track", track_start_s, scenario.trajectory.moved(start)))
    track_end_s = track_start_s + scenario.duration_s
    braking = _braking(scenario.trajectory.at(scenario.duration_s), 0.0)
    legs.append(_Leg("done", track_end_s, braking.moved(start)))
    return Mission(tuple(legs), float(start[2]), climb_s, track_start_s, track_end_s)


def _climb(ground: F64, above: F64) -> list[tuple[str, Polynomial]]:
    """From rest on the ground to rest above, (4,) each, place and yaw: phases and their paths."""
    rise_m, turn_s = abs(float(above[2])), _REST_TO_REST_PEAK * abs(float(above[-1] - ground[-1])) / _YAW_RATE_RADPS
    if rise_m <= _HIGH_M:
        climb_s = max(_LEAST_CLIMB_S, _REST_TO_REST_PEAK * rise_m / _CLIMB_MPS)
        if turn_s <= climb_s:
            return [("takeoff", minimum_snap(np.stack([ground, above]), np.array([0.0, climb_s])))]
        over = np.append(above[:3], ground[-1])
        climb = minimum_snap(np.stack([ground, over]), np.array([0.0, climb_s]))
        return [("takeoff", climb), ("approach", minimum_snap(np.stack([over, above]), np.array([0.0, turn_s])))]
    speed_mps = min(_CLIMB_MPS, rise_m / (turn_s + _GATHER_S))
    gathered = np.array([0.0, 0.0, -0.5 * _GATHER_S * speed_mps, 0.0])
    places = np.stack([ground, ground + gathered, above - gathered, above])
    steady = Boundary(np.array([0.0, 0.0, -speed_mps, 0.0]), np.zeros(4), np.zeros(4))
    ends = (None, steady, steady, None)
    spans_s = (_GATHER_S, rise_m / speed_mps - _GATHER_S, _GATHER_S)
    return [
        ("takeoff", minimum_snap(places[k : k + 2], np.array([0.0, spans_s[k]]), start=ends[k], end=ends[k + 1]))
        for k in range(3)
    ]


def never_flew(rose_m: float | None, climb_m: float) -> str:
    """Why a vehicle that rose no higher has not flown, one line."""
    rose = "its height is not known" if rose_m is None else f"it rose {max(rose_m, 0.0):.2f} m"
    return f"never flew: {rose} of the {climb_m:.2f} m of its first climb (at least half counts)"


def stands(rose_m: float, asked_m: float) -> str:
    """Why a vehicle that is left behind by its first climb is not flying, one line."""
    return f"never flew: it rose {max(rose_m, 0.0):.2f} m where its first climb is {asked_m:.2f} m high already"


def first_height_m(scenario: Scenario) -> float:
    """Height above the start at which the first climb ends."""
    return -float(_above(scenario, scenario.trajectory.at(0.0))[2])


def _above(scenario: Scenario, first: FlatOutput) -> F64:
    """(4,) where the climb ends, and the heading."""
    down_m = float(first.pos_ned_m[2]) if scenario.climb_to_m is None else -scenario.climb_to_m
    return np.array([0.0, 0.0, min(down_m, -_LEAST_HEIGHT_M), first.yaw_rad])


def peak_speed_mps(scenario: Scenario) -> float:
    """Greatest speed of the track."""
    return _peaks(scenario)[0]


def _peaks(scenario: Scenario) -> tuple[float, float]:
    """Greatest speed and acceleration of the track: what the run-up may use too, where the track is fast."""
    points = [scenario.trajectory.at(t) for t in np.linspace(0.0, min(scenario.duration_s, _PEAKS_S), _PEAKS_POINTS)]
    speed = max(float(np.linalg.norm(p.vel_ned_mps)) for p in points)
    return speed, max(float(np.linalg.norm(p.acc_ned_mps2)) for p in points)


def require_run_up(scenario: Scenario) -> None:
    """InputError in one line where no run-up reaches the trajectory's first state in the air and within limits."""
    first = scenario.trajectory.at(0.0)
    if not run_up_of(scenario).is_comfortable:
        speed, height = float(np.linalg.norm(first.vel_ned_mps)), -float(first.pos_ned_m[2])
        raise InputError(
            f"scenario {scenario.name}: no run-up reaches its start ({speed:.3g} m/s at a height of {height:.3g} m) "
            "without touching the ground or its limits; begin higher or slower"
        )


def _is_comfortable(path: Polynomial, start: FlatOutput, goal: FlatOutput) -> bool:
    """Whether a way back is gentle, or no harder than its ends, and does not sink below them."""
    ends = (start, goal)
    speed_max = max(_REJOIN_SPEED_MPS, *(1.1 * float(np.linalg.norm(end.vel_ned_mps)) for end in ends))
    acc_max = max(_REJOIN_ACC_MPS2, *(1.02 * float(np.linalg.norm(end.acc_ned_mps2)) for end in ends))
    lowest = max(float(end.pos_ned_m[2]) for end in ends) + _REJOIN_SINK_M
    return all(
        float(np.linalg.norm(point.vel_ned_mps)) <= speed_max
        and float(np.linalg.norm(point.acc_ned_mps2)) <= acc_max
        and point.pos_ned_m[2] <= lowest
        for point in map(path.at, np.linspace(0.0, path.duration_s, 31))
    )


def _run_up(above: F64, first: FlatOutput, least_s: float, speed_mps: float, acc_mps2: float) -> RunUp:
    """From hovering at `above` (4,) to the trajectory's first state, no shorter than comfortable or than `least_s`."""
    goal = np.append(first.pos_ned_m, first.yaw_rad)
    end = Boundary.of(first)
    moving = max(float(np.abs(part).max()) for part in (end.velocity, end.acceleration, end.jerk))
    if moving < 1e-9 and np.allclose(goal, above, atol=1e-9):
        return RunUp(None, True)
    speed_max = max(_SPEED_MAX_MPS, 1.2 * speed_mps)
    acc_max = max(_ACC_MAX_MPS2, acc_mps2)
    lowest = max(-_LEAST_HEIGHT_M + 1e-6, first.pos_ned_m[2])
    shortest = None
    for duration in (tried_s for tried_s in RUN_UPS_S if tried_s >= least_s):
        path = minimum_snap(np.stack([above, goal]), np.array([0.0, duration]), end=end)
        points = [path.at(t) for t in np.linspace(0.0, duration, 61)]
        if all(
            float(np.linalg.norm(p.vel_ned_mps)) <= speed_max
            and float(np.linalg.norm(p.acc_ned_mps2)) <= acc_max
            and p.pos_ned_m[2] <= lowest
            for p in points
        ):
            return RunUp(path, True)
        shortest = path
    return RunUp(shortest, False)


def _braking(state: FlatOutput, ground_down_m: float) -> Polynomial:
    """From any state to rest, straight on; a descent ends above the least height, or where it is if that is lower."""
    speed = float(np.linalg.norm(state.vel_ned_mps))
    duration = max(1.0, _REST_TO_REST_PEAK * speed / _BRAKE_MPS2, float(np.linalg.norm(state.acc_ned_mps2)) / 2.0)
    lowest = max(ground_down_m - _LEAST_HEIGHT_M, float(state.pos_ned_m[2]))
    sinking = float(state.vel_ned_mps[2])
    if sinking > 0.0:  # stopping takes half the duration times the speed
        duration = min(duration, max(_SHORTEST_BRAKE_S, 2.0 * (lowest - float(state.pos_ned_m[2])) / sinking))
    goal = state.pos_ned_m + 0.5 * duration * state.vel_ned_mps
    goal[2] = min(goal[2], lowest) if sinking > 0.0 else goal[2]
    start = Boundary.of(changed(state, yaw_rate_radps=0.0))
    points = np.stack([np.append(state.pos_ned_m, state.yaw_rad), np.append(goal, state.yaw_rad)])
    return minimum_snap(points, np.array([0.0, duration]), start=start)
