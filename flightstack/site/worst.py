"""How far a way out can be left: the loop that follows it, driven to its worst along its gradient.

The loop north and east as `backup.follow` closes it, with the snap that is sure (cut as the governor cuts it), the lean
that thrust has, the rates that are let through and the lags of `turning`.  The force, what no sensor shows of it and
the errors of the estimate are vectors of any course within their bounds.  The distance from the way, the nearest of all
its places, is driven up at some moments: a run, its adjoint, each input towards its bound where the adjoint points,
again and again from some first courses.  For a linear loop that ends at the worst there is; for this one at the worst
that was found.  Compiled.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.jit import njit, njit_called
from flightstack.rows import ACC_E, ACC_N, VEL_E, VEL_N
from flightstack.site import backup as b
from flightstack.site.law import LEAD_S, SEEN_SHARE, TURN_SHARE, asked, led_lags, snap_asked, turn_towards
from flightstack.site.tube import OBSERVER_S
from flightstack.types import F64

STEP_S = 0.01
STARTS = 6
_LEAST_SHARE, _LESS, _GAIN = 0.02, 0.4, 1.002
"""Of a step to the bounds, the least that is tried, and how fast it shrinks; what a step has to gain to go on."""
_STATE = 12
"""Place, velocity, lean, its rate, its snap, what the observer saw: north and east of each."""
_P, _V, _A, _J, _S, _O = range(0, _STATE, 2)
_INPUTS = 8
"""Force, what no sensor shows, errors of place and of velocity: north and east of each."""
_FORCE, _REST, _EP, _EV = range(0, _INPUTS, 2)
_TURN = _J
"""Of a way, whose rows begin as a state does."""
_ROTORS_S = 4
_MOST_EV = 3
"""Of a `Loop` as compiled functions take it; of the greatest sizes."""
Spare = tuple[F64, F64, F64, F64, F64, F64]
"""Of `_driven`: bounds and inputs that are tried, states, a direction, first states."""
_KICKED, _OFF_RAD = 2, 0.2
_STILL_S = 2.0


class Held(NamedTuple):
    """What the loop has to turn with, and against what."""

    snap_mps4: float
    """`Turning.sure_mps4`."""
    lean_mps2: float
    fastest_mps3: float
    """Turning that is let through."""
    force_mps2: float
    """Half of the greatest step of force, as an acceleration."""
    rest_mps2: float
    eps_p_m: float
    eps_v_mps: float


class Loop(NamedTuple):
    """Of the feedback, and its lags."""

    vel_ps: float
    """Lean by speed; and by place."""
    pos_ps2: float
    turn_ps: float
    lag_s: float
    rotors_s: float
    late_s: float

    @classmethod
    def of(cls, gains: tuple[float, float, float], lags_s: tuple[float, float]) -> Loop:
        """`tube.Gains` and `Turning`'s lags."""
        acc_ps, vel_ps2, pos_ps3 = gains
        return cls(vel_ps2 / acc_ps, pos_ps3 / acc_ps, acc_ps, *lags_s, sum(led_lags(*lags_s)))


class Closed(NamedTuple):
    """A closed loop, as compiled functions take it."""

    loop: F64
    """`Loop`."""
    held: F64
    """`Held`."""
    here: F64
    """(12,) the state in which it begins; not a number: the worst one at the way's beginning."""


@njit
def _snap_asked(
    x: F64, u: F64, at: F64, loop: tuple[float, float, float, float, float, float], held: tuple[float, float, float]
) -> tuple[float, float]:  # fmt: skip
    """What the snap goes to (north, east), within what there is; of `Loop` and `Held` the numbers themselves, which
    what is written to states can't change: their powers and quotients are worked out once for all steps."""
    vel_ps, pos_ps2, turn_ps, lag, rotors, late = loop
    snap, lean, fastest = held
    north = vel_ps * (at[_V] - x[_V] - u[_EV]) + pos_ps2 * (at[_P] - x[_P] - u[_EP])
    east = vel_ps * (at[_V + 1] - x[_V + 1] - u[_EV + 1]) + pos_ps2 * (at[_P + 1] - x[_P + 1] - u[_EP + 1])
    share = asked(math.sqrt(north * north + east * east), vel_ps, snap)
    north, east = at[_A] + share * north - SEEN_SHARE * x[_O], at[_A + 1] + share * east - SEEN_SHARE * x[_O + 1]
    cut = min(1.0, lean / max(math.sqrt(north * north + east * east), 1e-9))
    north, east = cut * north - x[_A], cut * east - x[_A + 1]
    short = max(math.sqrt(north * north + east * east), 1e-9)
    turn = min(turn_towards(short, turn_ps, snap, late), fastest) / short
    return snap_asked(
        (at[_TURN] + turn * north, at[_TURN + 1] + turn * east),
        (x[_J], x[_J + 1]),
        (x[_S], x[_S + 1]),
        snap,
        (lag, rotors),
    )


@njit
def _run(way: F64, inputs: F64, loop: F64, held: F64, states: F64) -> None:
    """From states[0] on, in steps of STEP_S."""
    follows = 1.0 - math.exp(-STEP_S / loop[_ROTORS_S])
    of, within = (loop[0], loop[1], loop[2], loop[3], loop[4], loop[5]), (held[0], held[1], held[2])
    for k in range(len(inputs)):
        x, y, u = states[k], states[k + 1], inputs[k]
        snap = _snap_asked(x, u, way[k], of, within)
        for i in range(2):
            y[_S + i] = x[_S + i] + follows * (snap[i] - x[_S + i])
            y[_O + i] = x[_O + i] + STEP_S / OBSERVER_S * (u[i] - x[_O + i])
            y[_P + i] = x[_P + i] + STEP_S * x[_V + i]
            y[_V + i] = x[_V + i] + STEP_S * (x[_A + i] + u[_FORCE + i] + u[_REST + i])
            y[_A + i] = x[_A + i] + STEP_S * x[_J + i]
            y[_J + i] = x[_J + i] + STEP_S * y[_S + i]


@njit
def _through(x: tuple[float, float], share: float, slope: float, g: tuple[float, float]) -> tuple[float, float]:
    """A gradient by share(|x|) x taken back to x; slope: share'(|x|) / |x|."""
    along = slope * (x[0] * g[0] + x[1] * g[1])
    return share * g[0] + along * x[0], share * g[1] + along * x[1]


@njit
def _cut(x: tuple[float, float], most: float) -> tuple[float, float]:
    """What no more than `most` leaves of x, as a share, and its slope (`_through`)."""
    size = math.sqrt(x[0] * x[0] + x[1] * x[1])
    return (1.0, 0.0) if size <= most else (most / size, -most / size**3)


@njit
def _snap_climbed(
    x: F64, u: F64, at: F64, loop: tuple[float, float, float, float, float, float], held: tuple[float, float, float],
    g: tuple[float, float], out: F64,
) -> None:  # fmt: skip
    """The gradient by `_snap_asked` (2,) taken back to its state, into `out` (12,): every step is along a vector."""
    vel_ps, pos_ps2, turn_ps, lag, rotors, late = loop
    snap, lean, fastest = held
    lin = (
        vel_ps * (at[_V] - x[_V] - u[_EV]) + pos_ps2 * (at[_P] - x[_P] - u[_EP]),
        vel_ps * (at[_V + 1] - x[_V + 1] - u[_EV + 1]) + pos_ps2 * (at[_P + 1] - x[_P + 1] - u[_EP + 1]),
    )
    size = max(math.sqrt(lin[0] * lin[0] + lin[1] * lin[1]), 1e-9)
    share = asked(size, vel_ps, snap)
    back = share, (-share / (3.0 * size * size) if share < 1.0 else 0.0)
    leant = (
        at[_A] + share * lin[0] - SEEN_SHARE * x[_O],
        at[_A + 1] + share * lin[1] - SEEN_SHARE * x[_O + 1],
    )
    cut = _cut(leant, lean)
    short = cut[0] * leant[0] - x[_A], cut[0] * leant[1] - x[_A + 1]
    size, most = max(math.sqrt(short[0] * short[0] + short[1] * short[1]), 1e-9), TURN_SHARE * snap
    turned, steepness = turn_towards(size, turn_ps, snap, late), turn_ps
    if turned < turn_ps * size:
        steepness = most / (turned + most * late)
    if turned > fastest:
        turned, steepness = fastest, 0.0
    turn = turned / size, (steepness - turned / size) / (size * size)
    lead, damped = (1.0 + LEAD_S / lag) / lag, LEAD_S * rotors / (lag * lag)
    wanted = (
        lead * (at[_TURN] + turn[0] * short[0] - x[_J]) - damped * x[_S],
        lead * (at[_TURN + 1] + turn[0] * short[1] - x[_J + 1]) - damped * x[_S + 1],
    )
    g = _through(wanted, *_cut(wanted, snap), g)
    g_short = _through(short, *turn, (lead * g[0], lead * g[1]))
    g_leant = _through(leant, *cut, g_short)
    g_lin = _through(lin, *back, g_leant)
    for i in range(2):
        out[_P + i], out[_V + i], out[_A + i] = -pos_ps2 * g_lin[i], -vel_ps * g_lin[i], -g_short[i]
        out[_J + i], out[_S + i], out[_O + i] = -lead * g[i], -damped * g[i], -SEEN_SHARE * g_leant[i]


@njit
def _climbed(way: F64, inputs: F64, loop: F64, held: F64, states: F64, toward: F64, uphill: F64) -> F64:
    """The gradient of the place along `toward` (2,) after the last row of `uphill`, by each input there into it (n, 8),
    and by the first state, returned (12,): backwards in time."""
    follows, seen = 1.0 - math.exp(-STEP_S / loop[_ROTORS_S]), STEP_S / OBSERVER_S
    of, within = (loop[0], loop[1], loop[2], loop[3], loop[4], loop[5]), (held[0], held[1], held[2])
    g, change = np.zeros(_STATE), np.empty(_STATE)
    g[_P], g[_P + 1] = toward[0], toward[1]
    for k in range(len(uphill) - 1, -1, -1):
        by_snap = follows * (g[_S] + STEP_S * g[_J]), follows * (g[_S + 1] + STEP_S * g[_J + 1])
        for i in range(2):
            uphill[k, i] = STEP_S * g[_V + i] + seen * g[_O + i]
            uphill[k, 2 + i] = STEP_S * g[_V + i]
            g[_S + i] = (1.0 - follows) * (g[_S + i] + STEP_S * g[_J + i])
            g[_J + i] += STEP_S * g[_A + i]
            g[_A + i] += STEP_S * g[_V + i]
            g[_V + i] += STEP_S * g[_P + i]
            g[_O + i] *= 1.0 - seen
        _snap_climbed(states[k], inputs[k], way[k], of, within, by_snap, change)
        for i in range(_STATE):
            g[i] += change[i]
        uphill[k, 4:8] = change[:_A]  # an error of the estimate is felt as that of the state
    return g


@njit
def _to_bound(g: F64, most: float, out: F64) -> None:
    """The vector (2,) of that size along g."""
    size = math.sqrt(g[0] * g[0] + g[1] * g[1])
    if size > 1e-12:
        out[0], out[1] = most * g[0] / size, most * g[1] / size


@njit
def _begin(way: F64, first: F64, here: F64, start: F64) -> None:
    """The state at first: `here` (12,), or on the way's first point; first: what the observer saw, errors of place and
    velocity (2 each)."""
    if not math.isnan(here[0]):
        start[:] = here
        return
    for i in range(2):
        start[_P + i], start[_V + i] = way[0, i] + first[2 + i], way[0, 2 + i] + first[4 + i]
        start[_A + i], start[_J + i] = way[0, 4 + i] - first[i], way[0, 6 + i]
        start[_S + i], start[_O + i] = 0.0, first[i]


@njit
def _course(kind: int, drawn: F64, steps: int, most: F64, inputs: F64, first: F64) -> None:
    """A first course: along a direction, or nearly against it until a moment; drawn (2,): 0 to 1.

    The estimate errs in a direction a little off: on one line the gradient would never leave that line.
    """
    angle = math.pi * kind if kind < _KICKED else 0.25 * math.pi * int(8.0 * drawn[0])
    turned = 0 if kind < _KICKED else int(0.8 * steps * drawn[1])
    for i in range(2):
        back = -0.5 * math.pi * i
        along, off = math.cos(angle + back), math.cos(angle + _OFF_RAD + back)
        before = -math.cos(angle - _OFF_RAD + back)
        first[i], first[2 + i], first[4 + i] = -most[0] * along, most[2] * off, most[_MOST_EV] * off
        for k in range(len(inputs)):
            force = along if k >= turned else before
            inputs[k, i], inputs[k, 2 + i] = force * most[0], force * most[1]
            inputs[k, _EP + i], inputs[k, _EV + i] = -most[2] * off, -most[_MOST_EV] * off


@njit
def _away(way: F64, places: F64, inputs: F64, first: F64, of: Closed, states: F64, toward: F64) -> float:
    """How far from all of some places a course ends, and which way, into `toward` (2,)."""
    last = len(inputs)
    _begin(way, first, of.here, states[0])
    _run(way, inputs, of.loop, of.held, states)
    n, e, nearest = states[last, 0], states[last, 1], np.inf
    for k in range(len(places)):
        away = (n - places[k, 0]) ** 2 + (e - places[k, 1]) ** 2
        if away < nearest:
            nearest, toward[0], toward[1] = away, n - places[k, 0], e - places[k, 1]
    away = math.sqrt(nearest)
    for i in range(2):
        toward[i] /= max(away, 1e-9)
    return away


@njit
def _driven(
    way: F64, places: F64, of: Closed, rounds: int, inputs: F64, first: F64, spare: Spare
) -> float:  # fmt: skip
    """How far a course (inputs and first, in place) is driven from all places at its end, uphill."""
    bounds, tried, states, toward, ends, begun = spare
    last, most = len(inputs), of.held[3:7]
    away, share = _away(way, places, inputs, first, of, states, toward), 0.0
    for _ in range(rounds):
        if share < _LEAST_SHARE:  # uphill from here
            if share > 0.0:
                break
            _away(way, places, inputs, first, of, states, toward)
            g = _climbed(way, inputs, of.loop, of.held, states, toward, bounds[:last])
            for k in range(last):
                for at in range(0, _INPUTS, 2):
                    _to_bound(bounds[k, at : at + 2], most[at // 2], bounds[k, at : at + 2])
            _to_bound(g[_O : _O + 2] - g[_A : _A + 2], most[0], ends[:2])
            _to_bound(g[_P : _P + 2], most[2], ends[2:4])
            _to_bound(g[_V : _V + 2], most[_MOST_EV], ends[4:6])
            share = 1.0
        tried[:last] = (1.0 - share) * inputs + share * bounds[:last]
        begun[:] = (1.0 - share) * first + share * ends
        found = _away(way, places, tried[:last], begun, of, states, toward)
        if found > away:
            is_done = found < _GAIN * away
            away, share = found, 0.0
            inputs[:], first[:] = tried[:last], begun
            if is_done:
                break
        else:
            share *= _LESS
    return away


@njit_called
def search(
    way: F64, places: F64, of: Closed, steps: F64, rounds: int, drawn: F64, out: F64, course: F64
) -> None:  # fmt: skip
    """The greatest distance from places (n, 2) of a way that is found at each of some steps, into `out`; drawn (steps,
    first courses, 2): 0 to 1; the inputs that lead to the last of them into `course` (n, 8).

    What is worst at a moment is a first course of the next one, and then, backwards, of the one before.
    way (n, 8): place, velocity, acceleration, rate of turning asked for (north and east of each)."""
    n, many = len(way), len(steps)
    courses, begins, inputs, first = (
        np.zeros((many, n, _INPUTS)),
        np.zeros((many, 6)),
        np.zeros((n, _INPUTS)),
        np.zeros(6),
    )
    spare = (
        np.zeros((n, _INPUTS)), np.zeros((n, _INPUTS)), np.zeros((n + 1, _STATE)), np.zeros(2), np.zeros(6), np.zeros(6)
    )  # fmt: skip
    for turn in range(2 * many - 1):
        m = min(turn, 2 * many - 2 - turn)
        kinds, beside = drawn.shape[1] if turn < many else 0, m - 1 if turn < many else m + 1
        last = int(steps[m])
        for kind in range(kinds + (1 if beside >= 0 else 0)):
            if kind < kinds:
                _course(kind, drawn[m, kind], last, of.held[3:7], inputs, first)
            else:
                inputs[:], first[:] = courses[beside], begins[beside]
            away = _driven(way, places, of, rounds, inputs[:last], first, spare)
            if away > out[m]:
                out[m] = away
                courses[m, :last], begins[m] = inputs[:last], first
                for k in range(last, n):
                    courses[m, k] = inputs[last - 1]
    course[:] = courses[-1]


def course_of(points: F64, still_s: float = _STILL_S) -> F64:
    """(n, 8) of `search`: a way out (`backup.roll`), at rest at its end for a while."""
    t = np.arange(0.0, b.STEP_S * (len(points) - 1) + 1e-9, STEP_S)
    columns, at = [0, 1, VEL_N, VEL_E, ACC_N, ACC_E, 11, 12], b.STEP_S * np.arange(len(points))
    way: F64 = np.stack([np.interp(t, at, points[:, column]) for column in columns], axis=1)
    still = np.concatenate([way[-1, :2], np.zeros(6)])
    return np.vstack([way, np.tile(still, (round(still_s / STEP_S), 1))])


def worst(
    loop: Loop, held: Held, way: F64, until_s: tuple[float, ...], rounds: int = 30, here: F64 | None = None,
    gone: int = 0, starts: int = STARTS,
) -> tuple[float, F64]:  # fmt: skip
    """How far from a way (n, 8) it is driven by one of some moments, and (k, 2) the force that does it at the last,
    m/s^2, in steps of STEP_S; from the worst state at the way's beginning, else from a state (12,) after `gone` steps.
    `starts`: first courses at each moment, beside the one that was worst a moment before.
    """
    places, way = way[:, :2].copy(), way[gone:]
    here = np.full(_STATE, np.nan) if here is None else here
    steps = np.minimum(np.round(np.array(until_s) / STEP_S), float(len(way) - 1))
    found, course = np.zeros(len(steps)), np.zeros((len(way), _INPUTS))
    drawn = np.random.default_rng(1).uniform(size=(len(steps), starts, 2))
    search(way, places, Closed(np.array(loop), np.array(held), here), steps, rounds, drawn, found, course)
    return float(found.max()), course[: int(steps[-1]), :2]
