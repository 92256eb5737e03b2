"""How far ways out are left by the loop that follows them, worked out anew; shares no code.

North and east are one complex number.  A way and the loop beside it are integrated in steps of 10 ms; a force, what no
sensor shows, and errors of place and velocity, each of any course within its size, are driven to where they move the
vehicle furthest from all places of the way: by the adjoint of a run, from some first courses for each of some moments,
all of a certificate's ways side by side; then from what was worst a moment before and after.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .intervals import F64, I64

_C = NDArray[np.complex128]
_STEP_S, _STILL_S, _OBSERVER_S, _LONGEST = 0.01, 2.5, 0.1, 768
_ASKED_SHARE, _TURN_SHARE, _SEEN_SHARE, _LEAD_S = 0.5, 0.5, 0.85, 0.05
_LEAN_GAIN_PS, _JERK_GAIN_PS = 8.0, 20.0
(_P, _V, _A, _J, _S, _O), _EP, _EV = range(6), 2, 3
"""Place, velocity, lean, its rate, its snap, force that is seen; of inputs, errors of place and velocity."""
_MOMENTS = (0.12, 0.19, 0.26, 0.33, 0.4, 0.47, 0.54, 0.64)
_COURSES, _OFF_RAD = ((0.0, 0.0), (1.0, 0.0), (0.5, 0.3), (0.75, 0.6), (0.25, 0.5), (1.25, 0.2)), 0.2
"""Shares of a way's time; first courses: half turns of a direction, share of the time until the force turns round."""
_STOP_SHARE = 0.75  # of the snap, what stops a turning that is faster than a way's own
_LITTLE_MPS, _MUCH_MPS, _LEANT_S, _LITTLE_MPS2 = 2.0, 4.0, 0.4, 1.0
"""Motion with which a way is left no further than one from rest, and the furthest; what lean adds to it; the lean
beyond what brakes that adds nothing by itself."""
_QUICK_MPS3, _FASTEST_BEGUN_MPS3, _LOST_MPS2 = 8.0, 25.0, 1e6
"""Turning beyond which a tube grows with its square; what no way begins with more than; a lean that is never brought
back, well before its numbers overflow."""
_SIDE_BY_SIDE, _AT_ONCE = 21_000, 32
"""Steps of all ways looked at side by side, and copied at once: more would not fit into memory."""
_ROUNDS, _SHARES, _ENOUGH, _PASSED_ON = 6, (1.0, 0.4, 0.15), 0.9, 2


class ClosedLoop(NamedTuple):
    """What follows a way, and what it has to turn with; as the file names it."""

    acc_ps: float
    vel_ps2: float
    pos_ps3: float
    lag_s: float
    rotors_s: float
    snap_mps4: float
    lean_mps2: float
    fastest_mps3: float


class Way(NamedTuple):
    """How a way is laid out, and how far it may be left: with little motion at first, with much, and by how much
    further for a lean."""

    across_mps2: float
    lean_mps2: float
    jerk_mps3: float
    slow_mps4: float
    fast_mps4: float
    fast_mps: float
    ease: float
    fade_ps: float
    stoppable: float
    rest_radius_m: float
    most_radius_m: float
    per_lean_s2: float
    per_turn_s6pm: float

    def brakes(self, v: complex) -> complex:
        """The lean that it asks for."""
        speed = max(abs(v), 1e-9)
        share: float = min(self.across_mps2 / speed, self.fade_ps, self.ease / speed ** (1.0 / 3.0))
        return -share * v

    def claimed_m(self, laid: _C) -> float:
        """Radius of the tube of a way: the most of its parts until its first turning has been stopped, and what that
        turning adds."""
        j = laid[:, 4]
        stopped = np.nonzero((j[1:] * np.conj(j[0])).real <= 0.0)[0]
        most = max(self._wide_m(v, a) for _, v, a, *_ in laid[: stopped[0] + 1].tolist())
        turning = float(abs(j[0]))
        return most + self.per_turn_s6pm * turning * (turning + _QUICK_MPS3)

    def _wide_m(self, v: complex, a: complex) -> float:
        """The radius by a velocity and a lean."""
        share = min(max((abs(v + _LEANT_S * a) - _LITTLE_MPS) / (_MUCH_MPS - _LITTLE_MPS), 0.0), 1.0)
        leant = min(abs(a), abs(a - self.brakes(v))) - _LITTLE_MPS2
        return self.rest_radius_m + max(share * (self.most_radius_m - self.rest_radius_m), self.per_lean_s2 * leant)


def _cut(z: complex, most: float) -> complex:
    """z, no longer than that."""
    return z * min(1.0, most / max(abs(z), 1e-9))


def laid_out(way: Way, loop: ClosedLoop, v: complex, a: complex, j: complex = 0j) -> _C:
    """(n, 5) place, velocity, lean, rate that is asked for, the one that there is (at first both are j); at rest for a
    while at its end; empty: it does not rest, or turns too fast."""
    p, s, asked, rows = 0j, 0j, j, []
    late, follows = max(loop.lag_s, 2.0 * _STEP_S), 1.0 - math.exp(-_STEP_S / loop.rotors_s)
    turns = math.sqrt(way.slow_mps4 * way.across_mps2)
    if abs(j) > _FASTEST_BEGUN_MPS3:
        return np.zeros((0, 5), dtype=np.complex128)
    for _ in range(_LONGEST):
        rows.append((p, v, a, asked, j))
        if abs(v) < 0.03 and abs(a) < 0.15:
            break
        if not abs(a) < _LOST_MPS2:
            return np.zeros((0, 5), dtype=np.complex128)
        hurry = min(max(2.0 * (abs(v) / way.fast_mps - 1.0), 0.0), 1.0)
        stops = min(max(2.0 * (abs(j) / turns - 0.8), 0.0), 1.0)
        most = max(
            way.slow_mps4 + hurry * (way.fast_mps4 - way.slow_mps4),
            way.slow_mps4 + stops * (_STOP_SHARE * loop.snap_mps4 - way.slow_mps4),
        )
        short = way.brakes(v) - a - late * (j + loop.rotors_s * s)
        size = max(abs(short), 1e-9)
        turn = min(_LEAN_GAIN_PS * size, way.stoppable * math.sqrt(2.0 * most * size), way.jerk_mps3) / size
        asked += _STEP_S * _cut(_JERK_GAIN_PS * (turn * short - asked), most)
        s += follows * ((asked - j) / loop.lag_s - s)
        j += _STEP_S * s
        p, v = p + _STEP_S * (v + 0.5 * _STEP_S * a), v + _STEP_S * (a + 0.5 * _STEP_S * j)
        a += _STEP_S * j * (1.0 + (abs(a) / 9.80665) ** 2)
    else:
        return np.zeros((0, 5), dtype=np.complex128)
    return np.array(rows + [(p, 0.0, 0.0, 0.0, 0.0)] * round(_STILL_S / _STEP_S))


class _Lanes(NamedTuple):
    """Courses side by side, of which those that end last come first."""

    laid: _C
    """(n, 5, ways)."""
    way: I64
    last: I64
    """Of each lane its way, and the step at which it ends."""
    running: I64
    """How many lanes there are at each step."""

    def of(self, some: I64) -> _Lanes:
        """Some of them, in order."""
        last = self.last[some]
        running = np.searchsorted(-last, -np.arange(len(self.laid)), side="left")
        return _Lanes(self.laid, self.way[some], last, running)


class _Courses(NamedTuple):
    """Inputs (steps, 4, lanes); what is seen at first of the force, errors of place and velocity (3, lanes)."""

    inputs: _C
    first: _C

    def between(self, share: float, bounds: _Courses, lanes: I64) -> _Courses:
        """For some lanes, a share of the way to other ones; step by step, for all of them at once are large."""
        found = bounds.of(lanes)
        for part, mine in zip(found, self, strict=True):
            for some in _steps(part):
                here = mine[some].take(lanes, axis=-1)
                part[some] -= here
                part[some] *= share
                part[some] += here
        return found

    def of(self, lanes: I64) -> _Courses:
        """Those of some lanes."""
        return _Courses(self.inputs.take(lanes, axis=-1), self.first.take(lanes, axis=-1))

    def take(self, lanes: I64, other: _Courses, which: I64) -> None:
        """Some of other ones for some lanes, in place."""
        for mine, theirs in zip(self, other, strict=True):
            _take(mine, lanes, theirs, which)


def _steps(of: _C) -> Iterator[slice]:
    return (slice(k, k + _AT_ONCE) for k in range(0, len(of), _AT_ONCE))


def _take(mine: _C, lanes: I64, theirs: _C, which: I64) -> None:
    for some in _steps(mine):
        mine[some][..., lanes] = theirs[some].take(which, axis=-1)


def _sizes(z: Any) -> Any:
    size = np.abs(z)
    return np.maximum(size, 1e-9, out=size)


class _Part(NamedTuple):
    """A vector, how long it is, and the share of it that is let through."""

    z: _C
    size: F64
    share: F64

    def cut(self, falls: float = 1.0) -> F64:
        """How the share changes by the size, over the size, where it falls with that power of it."""
        return np.where(self.share < 1.0, -self.share / (falls * self.size**2), 0.0)


class _Snap(NamedTuple):
    """What the snap goes to, and every vector on the way there."""

    asked: _C
    back: _Part
    leant: _Part
    short: _Part
    stopped: F64
    """Turning from which what is short can still be stopped."""
    wanted: _Part


def _bounded(z: _C, most: float) -> _Part:
    size = _sizes(z)
    return _Part(z, size, np.minimum(1.0, most / size))


def _gains(loop: ClosedLoop) -> tuple[float, float, float, float, float]:
    """Lean by place and by velocity; what missing turning and the snap that there is ask for; how late it is."""
    late = 1.0 + _LEAD_S * loop.rotors_s / loop.lag_s**2
    late_s = loop.lag_s * late / (1.0 + _LEAD_S / loop.lag_s) + loop.rotors_s / late
    lead = (1.0 + _LEAD_S / loop.lag_s) / loop.lag_s
    return (
        loop.pos_ps3 / loop.acc_ps, loop.vel_ps2 / loop.acc_ps, lead, _LEAD_S * loop.rotors_s / loop.lag_s**2, late_s
    )  # fmt: skip


def _snap(x: _C, u: _C, at: _C, loop: ClosedLoop) -> _Snap:
    """x (6, lanes)."""
    by_place, by_velocity, lead, damped, late_s = _gains(loop)
    back = by_velocity * (at[_V] - x[_V] - u[_EV]) + by_place * (at[_P] - x[_P] - u[_EP])
    size, most = _sizes(back), _ASKED_SHARE**3 * loop.snap_mps4 / by_velocity**2
    backs = _Part(back, size, np.minimum(1.0, np.cbrt(most / size)))
    leant = _bounded(at[_A] + backs.share * back - _SEEN_SHARE * x[_O], loop.lean_mps2)
    short = leant.share * leant.z - x[_A]
    size, most = _sizes(short), _TURN_SHARE * loop.snap_mps4
    stopped = np.sqrt((most * late_s) ** 2 + 2.0 * most * size) - most * late_s
    turn = np.minimum(np.minimum(stopped, loop.acc_ps * size), loop.fastest_mps3)
    shorts = _Part(short, size, turn / size)
    wanted = _bounded(lead * (at[_J] + shorts.share * short - x[_J]) - damped * x[_S], loop.snap_mps4)
    return _Snap(wanted.share * wanted.z, backs, leant, shorts, stopped, wanted)


def _turning_slope(snap: _Snap, loop: ClosedLoop) -> F64:
    """`_Part.cut` of what is short."""
    _, size, share = snap.short
    most, late_s = _TURN_SHARE * loop.snap_mps4, _gains(loop)[-1]
    grows = np.where(snap.stopped < loop.acc_ps * size, most / (snap.stopped + most * late_s), loop.acc_ps)
    turn = np.minimum(np.minimum(snap.stopped, loop.acc_ps * size), loop.fastest_mps3)
    slope: F64 = (np.where(turn < loop.fastest_mps3, grows, 0.0) - share) / size**2
    return slope


def _felt(of: _Part, slope: F64, g: _C) -> _C:
    """A gradient by what is let through of a vector, by the vector itself."""
    z = of.z
    felt: _C = of.share * g + slope * (z.real * g.real + z.imag * g.imag) * z
    return felt


def _run(lanes: _Lanes, courses: _Courses, loop: ClosedLoop) -> _C:
    """(steps + 1, 6, lanes) states; after a lane's end they are not worked out."""
    x = np.zeros((len(courses.inputs) + 1, 6, len(lanes.way)), dtype=np.complex128)
    begins, first = lanes.laid[0][:, lanes.way], courses.first
    x[0, _P], x[0, _V], x[0, _A] = begins[_P] + first[1], begins[_V] + first[2], begins[_A] - first[0]
    x[0, _J], x[0, _O], follows = begins[_J], first[0], 1.0 - np.exp(-_STEP_S / loop.rotors_s)
    for k in range(int(lanes.last.max())):
        m = int(lanes.running[k])
        u, here, after = courses.inputs[k, :, :m], x[k, :, :m], x[k + 1, :, :m]
        way = lanes.laid[k].take(lanes.way[:m], axis=1)
        after[_S] = here[_S] + follows * (_snap(here, u, way, loop).asked - here[_S])
        after[_P] = here[_P] + _STEP_S * here[_V]
        after[_V] = here[_V] + _STEP_S * (here[_A] + u[0] + u[1])
        after[_A] = here[_A] + _STEP_S * here[_J]
        after[_J] = here[_J] + _STEP_S * after[_S]
        after[_O] = here[_O] + _STEP_S / _OBSERVER_S * (u[0] - here[_O])
    return x


def _uphill(lanes: _Lanes, courses: _Courses, x: _C, toward: _C, loop: ClosedLoop) -> _Courses:
    """By each input, and by what is so at first, the way in which the place at a lane's end grows along `toward`."""
    g, up, follows = np.zeros_like(x[0]), np.zeros_like(courses.inputs), 1.0 - np.exp(-_STEP_S / loop.rotors_s)
    by_place, by_velocity, lead, damped, _ = _gains(loop)
    for k in range(int(lanes.last.max()) - 1, -1, -1):
        m = int(lanes.running[k])
        h, u = g[:, :m], courses.inputs[k, :, :m]
        h[_P] = np.where(lanes.last[:m] == k + 1, toward[:m], h[_P])
        snap = _snap(x[k, :, :m], u, lanes.laid[k].take(lanes.way[:m], axis=1), loop)
        by_snap = follows * (h[_S] + _STEP_S * h[_J])
        up[k, 0, :m], up[k, 1, :m] = _STEP_S * (h[_V] + h[_O] / _OBSERVER_S), _STEP_S * h[_V]
        h[_S] = (1.0 - follows) * (h[_S] + _STEP_S * h[_J])
        for i in (_J, _A, _V):
            h[i] += _STEP_S * h[i - 1]
        h[_O] *= 1.0 - _STEP_S / _OBSERVER_S
        by_wanted = _felt(snap.wanted, snap.wanted.cut(), by_snap)
        by_short = _felt(snap.short, _turning_slope(snap, loop), lead * by_wanted)
        by_leant = _felt(snap.leant, snap.leant.cut(), by_short)
        by_back = _felt(snap.back, snap.back.cut(3.0), by_leant)
        up[k, _EP, :m], up[k, _EV, :m] = -by_place * by_back, -by_velocity * by_back
        h[_P] -= by_place * by_back
        h[_V] -= by_velocity * by_back
        h[_A] -= by_short
        h[_J] -= lead * by_wanted
        h[_S] -= damped * by_wanted
        h[_O] -= _SEEN_SHARE * by_leant
    return _Courses(up, np.stack([g[_O] - g[_A], g[_P], g[_V]]))


def _away(lanes: _Lanes, x: _C) -> _C:
    """From the nearest place of its way to where each lane ends."""
    off = x[lanes.last, 0, np.arange(len(lanes.way))][None, :] - lanes.laid[:, 0][:, lanes.way]
    found: _C = off[np.argmin(np.abs(off), axis=0), np.arange(len(lanes.way))]
    return found


def _driven(lanes: _Lanes, courses: _Courses, sizes: F64, loop: ClosedLoop) -> tuple[F64, _Courses]:
    """How far lanes are driven from where their courses begin, uphill, and the courses that do it, in place."""
    x = _run(lanes, courses, loop)
    away = _away(lanes, x)
    for _ in range(_ROUNDS):
        best, still = np.abs(away), np.arange(len(away))
        bounds = _uphill(lanes, courses, x, away / np.maximum(best, 1e-9), loop)
        for toward, most in zip(bounds, (sizes[None, :, None], sizes[[0, _EP, _EV], None]), strict=True):
            toward /= np.maximum(np.abs(toward), 1e-12)
            toward *= most
        for share in _SHARES:
            part, tried = lanes.of(still), courses.between(share, bounds, still)
            run = _run(part, tried, loop)
            found = _away(part, run)
            better = np.abs(found) > best[still]
            taken, still = still[better], still[~better]
            away[taken] = found[better]
            _take(x, taken, run, np.nonzero(better)[0])
            courses.take(taken, tried, np.nonzero(better)[0])
            del tried, run
            if len(still) < (1.0 - _ENOUGH) * len(away):
                break
        if len(still) == len(away):
            break
    return np.abs(away), courses


def _lanes(laid: _C, lengths: I64, copies: int) -> _Lanes:
    """Some for each moment of each way; a moment's lie side by side, way by way within them."""
    last = (np.array(_MOMENTS)[:, None, None] * lengths[None, :, None]).astype(np.int64)
    last = np.broadcast_to(last, (len(_MOMENTS), len(lengths), copies)).reshape(-1)
    ways = np.broadcast_to(np.arange(len(lengths))[None, :, None], (len(_MOMENTS), len(lengths), copies)).reshape(-1)
    return _Lanes(laid, ways, last, np.array([]))


def _sorted(lanes: _Lanes) -> tuple[_Lanes, I64]:
    """Those that end last first, and the order."""
    order = np.argsort(-lanes.last, kind="stable")
    return lanes.of(order), order


def _first_courses(lanes: _Lanes, sizes: F64) -> _Courses:
    """Along a direction, or nearly against it until a moment; the estimate errs off it: no gradient leaves a line."""
    half_turns, turned = np.tile(np.array(_COURSES).T, len(lanes.last) // len(_COURSES))
    along, off = np.exp(1j * np.pi * half_turns), np.exp(1j * (np.pi * half_turns + _OFF_RAD))
    after = np.arange(lanes.last.max())[:, None] >= (turned * lanes.last)[None, :]
    force = np.where(after, along, -along * np.exp(-1j * _OFF_RAD))
    inputs: _C = np.stack([force, force, *2 * [np.broadcast_to(-off, force.shape)]], axis=1)
    first = np.stack([-sizes[0] * along, sizes[_EP] * off, sizes[_EV] * off]).astype(np.complex128)
    return _Courses(inputs * sizes[None, :, None], first)


def left(ways: list[_C], loop: ClosedLoop, sizes: F64) -> F64:
    """How far some ways (`laid_out`) are left; sizes: force, what no sensor shows, place, velocity.  0 where there is
    no way.  Long ways, as of a vehicle with GPS, some at a time, or they would not fit into the checker's memory."""
    result, there = np.zeros(len(ways)), np.array([k for k, each in enumerate(ways) if len(each)], dtype=np.int64)
    if len(there):
        most = max(_SIDE_BY_SIDE // max(map(len, ways)), 1)
        for some in np.array_split(there, -(-len(there) // most)):
            result[some] = _left([ways[k] for k in some], loop, sizes)
    return result


def _left(rows: list[_C], loop: ClosedLoop, sizes: F64) -> F64:
    """The same of as many as are looked at side by side."""
    lengths = np.array([len(each) for each in rows])
    laid = np.stack([np.concatenate([w, np.repeat(w[-1:], lengths.max() - len(w), axis=0)]) for w in rows], axis=2)
    greatest, shape = np.zeros(len(rows)), (len(_MOMENTS), len(rows))
    plain = _lanes(laid, lengths, len(_COURSES))
    courses = _first_courses(plain, sizes)
    for _ in range(1 + _PASSED_ON):
        lanes, order = _sorted(plain)
        courses = courses.of(order)
        found, driven = _driven(lanes, courses, sizes, loop)
        back = np.argsort(order)
        found = found[back].reshape(*shape, -1)
        greatest = np.maximum(greatest, found.max(axis=(0, 2)))
        best = np.argmax(found, axis=2) + np.arange(found.size).reshape(found.shape)[:, :, 0]
        before, after = (best[np.clip(np.arange(len(best)) + step, 0, len(best) - 1)] for step in (-1, 1))
        taken = np.stack([before, after], axis=2).reshape(-1)  # what is worst a moment before, and after
        plain, courses = _lanes(laid, lengths, 2), driven.of(back[taken])
    return greatest
