"""Algorithm 1 in flight: where to fly next so that the certified region grows, and when to stop.

A round: see where the present certificate is limited most, fly through the nearest state that can be reached and left
again inside it, wait until what was learned is certified.  What limits: of the states on the boundary of the next
larger candidate (the present region, `grow` times as fast) that with the greatest

    |dh/dv| E - q

q the condition's margin there, E what the acceleration may be off at the command that the condition needs: what
certainty could win back, less what there is.  One can't stop at a speed, so a state is flown *through*: an arc from
rest to rest (`arcs`) which accelerates to the state and then brakes as hard as the certificate allows, all of it at
commands that the filter would let pass.  A state that was flown through without making E smaller is not flown again.

It stops when the bound is narrow over the whole region and several rounds brought no growth, when nothing that is left
can be reached, or after `rounds_max`: each axis in turn, the vertical first.

Source: L. Wang, E. Theodorou, M. Egerstedt, "Safe Learning of Quadrotor Dynamics Using Barrier Certificates", 2018,
Algorithm 1; it flies to the state of greatest sigma and stops after one step that brings no growth.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from flightstack import arcs
from flightstack.barrier.records import AXES, AxisCertificate, Certificate
from flightstack.targets import TargetSearch, limits, reachable, transit
from flightstack.trajectory import Polynomial
from flightstack.types import F64, FlatOutput

FALSIFIED = "falsified"
"""Key of Certificate.knowledge that is true where an observation lay beyond its bound."""


@dataclass(frozen=True, slots=True)
class ExploreConfig:
    """Constants of the exploration."""

    identify_s: float = 5.0
    """At the start the vehicle hovers, going up and down a little, so that mass and force can be told apart."""
    identify_mps: tuple[float, float] = (0.4, 0.3)
    """Sideways, and up and down."""
    identify_mps2: tuple[float, float] = (1.2, 0.8)
    """Gentle up and down: quick changes of thrust would show how well its lag is known, not how much there is.  Leaning
    is measured; more of it leaves less to extrapolate to."""
    identify_at: tuple[tuple[int, float], ...] = ((2, 0.0), (0, 0.0), (1, 0.0), (2, 0.3), (2, -0.3), (2, 0.0))
    """Axis and distance from the middle (m), one after the other until something is certified."""
    identify_first: int = 3
    """So many of them in any case: how a force from aside shows along a leaning thrust axis is learned by leaning."""
    settle_s: float = 1.3
    """Rest after each arc, in which what was flown is certified."""
    axes: tuple[int, ...] = (2, 0, 1)
    epsilon_mps2: float = 0.25
    """Width of the bound, from its middle, that is narrow enough."""
    calm_rounds: int = 3
    growth: float = 0.01
    """Share of the area that counts as growth."""
    rounds_max: int = 24
    """Of each axis."""
    better: float = 0.9
    """A bound that is smaller by this factor is better."""
    repeats: int = 2
    """A speed that was flown so often without making the bound better is not flown again."""
    search: TargetSearch = field(default_factory=TargetSearch)


class Visit(NamedTuple):
    """What was flown, and how large the bound was before at that speed."""

    axis: int
    v_mps: float
    error_mps2: float


@dataclass(frozen=True, slots=True)
class Round:
    """One round, as the result lists it."""

    axis: int
    t_s: float
    """Mission time at which its certificate was looked at."""
    version: int
    area_m2ps: float
    width_mps2: float
    """Largest bound over the region's speeds."""
    target: tuple[float, float] | None
    """(e, v) flown through next."""
    limit: tuple[float, float] | None
    """The candidate's state that it stands for."""


@dataclass(frozen=True, slots=True)
class ExploreState:
    """What an exploration remembers."""

    centre_ned_m: F64
    """Where the region's centre lies in the reference's coordinates, (3,)."""
    start_s: float
    next_s: float
    """Nothing to decide before this mission time."""
    identified: int = 0
    """Legs of the identification flown."""
    turn: int = 0
    """Index into `ExploreConfig.axes`."""
    rounds_here: int = 0
    calm: int = 0
    best_m2ps: float = 0.0
    visits: tuple[Visit, ...] = ()
    rounds: tuple[Round, ...] = ()
    why: str = ""
    """Why the axes before this one are done."""
    ended: str = ""
    """Why it ended; empty while it goes on."""
    failed: bool = False
    """It ended without what it was flown for."""


class Explorer:
    """Decides from the certificate alone; pure, holds only constants."""

    __slots__ = ("config",)

    def __init__(self, config: ExploreConfig | None = None) -> None:
        self.config = config or ExploreConfig()

    def init(self, t_s: float, centre_ned_m: F64) -> ExploreState:
        """The state at mission time `t_s`, hovering at the region's centre (3,), in the reference's coordinates."""
        return ExploreState(centre_ned_m.copy(), t_s, t_s)

    def step(
        self, state: ExploreState, t_s: float, certificate: Certificate | None, reference: FlatOutput
    ) -> tuple[ExploreState, Polynomial | None]:
        """What to fly from `t_s` on (None: go on as it is); `reference` is what is flown now."""
        if state.ended:
            return state, None
        if certificate is not None and certificate.knowledge.get(FALSIFIED):
            return replace(state, ended="an observation lay beyond its bound: handed over", failed=True), None
        if t_s < state.next_s:
            return state, None
        first, most = self.config.identify_first, len(self.config.identify_at)
        if state.identified < first or (certificate is None and state.identified < most):
            leg = self._identification(state, reference)
            return replace(state, next_s=t_s + leg.duration_s, identified=state.identified + 1), leg
        if certificate is None:
            return replace(state, ended="nothing could be certified", failed=True), None
        return self._round(state, t_s, certificate, reference)

    def _identification(self, state: ExploreState, reference: FlatOutput) -> Polynomial:
        """To and fro about a place, slow enough for any first region, but with some thrust."""
        config = self.config
        axis, place = config.identify_at[state.identified]
        along = int(axis == 2)
        ramp, push, speed = config.search.ramp_s[along], config.identify_mps2[along], config.identify_mps[along]
        _, there = arcs.fly_through(place, speed, push, push, 0.5 * ramp, ramp)
        _, again = arcs.fly_through(place, -speed, push, push, 0.5 * ramp, ramp)
        rest, start = float(reference.pos_ned_m[axis] - state.centre_ned_m[axis]), float(there[0, arcs.PLACE])
        slow = max(2.0 * ramp, 4.0 * abs(start - rest))  # 0.2 m/s at most
        levels = (start - rest) / slow**2 * np.array([0.0, 1.0, -1.0, 0.0])
        to, back = (
            arcs.from_rest(*way) for way in ((rest, np.full(3, slow), levels), (start, np.full(3, slow), -levels))
        )
        once = arcs.duration_s(there) + arcs.duration_s(again)
        times = max(1, int((config.identify_s - config.settle_s - 6.0 * slow) / once))
        zero = reference.pos_ned_m.copy()
        zero[axis] = state.centre_ned_m[axis]
        tables = [to, *([there, again] * times), back, arcs.at_rest(rest, config.settle_s)]
        return arcs.path(tables, axis, zero, reference.yaw_rad)

    def _round(
        self, state: ExploreState, t_s: float, certificate: Certificate, reference: FlatOutput
    ) -> tuple[ExploreState, Polynomial | None]:
        """At the end of a leg: count the round, then the next target of this axis, or of the next one."""
        axes = {axis.axis: axis for axis in certificate.axes}
        while state.turn < len(self.config.axes):
            number = self.config.axes[state.turn]
            why = ""
            if number in axes:
                state = self._count(state, t_s, axes[number], certificate.version)
                why = self._enough(state)
                if not why:
                    state, leg = self._next(state, t_s, axes[number], reference)
                    if leg is not None:
                        return state, leg
                    why = f"{AXES[number]}: nothing is left that limits the region and can be reached"
            why = "; ".join(part for part in (state.why, why) if part)
            state = replace(state, turn=state.turn + 1, rounds_here=0, calm=0, best_m2ps=0.0, why=why)
        return replace(state, ended=state.why or "nothing to explore", failed=not state.rounds), None

    def _count(self, state: ExploreState, t_s: float, axis: AxisCertificate, version: int) -> ExploreState:
        area = axis.barrier.area_m2ps
        grown = area > (1.0 + self.config.growth) * state.best_m2ps
        row = Round(axis.axis, t_s, version, area, width_mps2(axis), None, None)
        return replace(
            state,
            calm=0 if grown else state.calm + 1,
            best_m2ps=max(area, state.best_m2ps),
            rounds_here=state.rounds_here + 1,
            rounds=(*state.rounds, row),
        )

    def _enough(self, state: ExploreState) -> str:
        """Why this axis is done, or nothing."""
        config, row = self.config, state.rounds[-1]
        name = AXES[row.axis]
        if row.width_mps2 <= config.epsilon_mps2 and state.calm >= config.calm_rounds:
            return (
                f"{name}: the bound is {row.width_mps2:.2f} m/s^2 over the region and {state.calm} rounds brought "
                "no growth"
            )
        return f"{name}: {config.rounds_max} rounds were flown" if state.rounds_here > config.rounds_max else ""

    def _next(
        self, state: ExploreState, t_s: float, axis: AxisCertificate, reference: FlatOutput
    ) -> tuple[ExploreState, Polynomial | None]:
        """The leg through the best target; None where there is none."""
        rest = float(reference.pos_ned_m[axis.axis] - state.centre_ned_m[axis.axis])
        for limit in limits(axis, self.config.search):
            arc = reachable(axis, limit, self.config.search)
            if arc is None:
                continue
            visit = Visit(axis.axis, arcs.peak(arc)[1], error_at(axis, arcs.peak(arc)[1]))
            if sum(_in_vain(visit, before, self.config.better) for before in state.visits) >= self.config.repeats:
                continue
            way = transit(axis, rest, float(arc[0, arcs.PLACE]), self.config.search)
            if way is None:
                continue
            before = arcs.at_rest(float(arc[0, arcs.PLACE]), 0.2)
            after = arcs.at_rest(arcs.at(arc, arcs.duration_s(arc))[0], self.config.settle_s)
            zero = reference.pos_ned_m.copy()  # the other axes stay where they rest
            zero[axis.axis] = state.centre_ned_m[axis.axis]
            leg = arcs.path([way, before, arc, after], axis.axis, zero, reference.yaw_rad)
            last = replace(state.rounds[-1], target=arcs.peak(arc), limit=(limit.e_m, limit.v_mps))
            return replace(
                state,
                next_s=t_s + leg.duration_s,
                visits=(*state.visits, visit),
                rounds=(*state.rounds[:-1], last),
            ), leg
        return state, None


def _in_vain(visit: Visit, before: Visit, better: float) -> bool:
    """Flown before, at such a speed or faster, and the bound has not become better since."""
    same = visit.axis == before.axis and visit.v_mps * before.v_mps > 0.0
    return same and abs(visit.v_mps) < 1.05 * abs(before.v_mps) and visit.error_mps2 > better * before.error_mps2


def error_at(axis: AxisCertificate, v_mps: float) -> float:
    """The bound at a speed and the command that brakes it."""
    reach = axis.authority.reach(v_mps)
    return reach.error_low if v_mps > 0.0 else reach.error_high


def width_mps2(axis: AxisCertificate) -> float:
    """The largest bound over the speeds of the region."""
    _, _, slow, fast = axis.barrier.box
    v = axis.authority.v_mps
    inside = (v >= slow - 1e-9) & (v <= fast + 1e-9)
    inside = inside if inside.any() else np.ones_like(inside)
    errors = np.maximum(axis.authority.error_low_mps2, axis.authority.error_high_mps2)
    return float(errors[inside].max())
