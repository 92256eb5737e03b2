"""How far ways out are left by the loop that follows them, worked out anew; shares no code.

North and east are one complex number.  A way and the loop beside it are integrated in steps of 10 ms; a force, what no
sensor shows, and errors of place and velocity, each of any course within its size, are driven to where they move the
vehicle furthest from all places of the way: by the adjoint of a run, from four first courses for each of four moments,
all of a certificate's ways side by side.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .intervals import F64

_C = NDArray[np.complex128]
_STEP_S, _STILL_S, _OBSERVER_S, _LONGEST = 0.01, 2.5, 0.1, 768
_ASKED_SHARE, _TURN_SHARE, _SEEN_SHARE, _LEAD_S = 0.5, 0.5, 0.85, 0.05
_LEAN_GAIN_PS, _JERK_GAIN_PS = 8.0, 20.0
_MOMENTS, _COURSES = (0.19, 0.25, 0.35, 0.5, 0.72), ((0.0, 0.0), (0.0, 0.5), (0.5, 0.35), (0.75, 0.6))
"""Shares of a way's time; first courses: half turns of a direction, share of the time until the force turns round."""
_STOP_SHARE = 0.75
"""Of the snap, what stops a turning that is faster than a way's own."""
_ROUNDS, _SHARES, _SMALL = 8, (1.0, 0.4, 0.15), 1e-6


class Loop(NamedTuple):
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
    """How a way is laid out, and how far it may be left: with little motion at first, and with any."""

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


def _cut(z: Any, most: Any) -> Any:
    """z, no longer than that."""
    return z * np.minimum(1.0, most / np.maximum(np.abs(z), 1e-9))


def _laid_out(way: Way, loop: Loop, v: complex, a: complex) -> _C:
    """(n, 4) place, velocity, lean, rate that is asked for; at rest for a while at its end; empty: it does not rest."""
    p, j, s, asked, rows = 0j, 0j, 0j, 0j, []
    late = max(loop.lag_s, 2.0 * _STEP_S)
    for _ in range(_LONGEST):
        rows.append((p, v, a, asked))
        if abs(v) < 0.03 and abs(a) < 0.15:
            break
        speed = max(abs(v), 1e-9)
        brake = min(way.across_mps2 / speed, way.fade_ps, way.ease / speed ** (1.0 / 3.0))
        hurry = min(max(2.0 * (speed / way.fast_mps - 1.0), 0.0), 1.0)
        stops = min(max(2.0 * (abs(j) / np.sqrt(way.slow_mps4 * way.across_mps2) - 0.8), 0.0), 1.0)
        most = max(
            way.slow_mps4 + hurry * (way.fast_mps4 - way.slow_mps4),
            way.slow_mps4 + stops * (_STOP_SHARE * loop.snap_mps4 - way.slow_mps4),
        )
        short = -brake * v - a - late * (j + loop.rotors_s * s)
        size = max(abs(short), 1e-9)
        turn = min(_LEAN_GAIN_PS * size, way.stoppable * np.sqrt(2.0 * most * size), way.jerk_mps3) / size
        asked += _STEP_S * complex(_cut(_JERK_GAIN_PS * (turn * short - asked), most))
        s += (1.0 - np.exp(-_STEP_S / loop.rotors_s)) * ((asked - j) / loop.lag_s - s)
        j += _STEP_S * s
        p, v = p + _STEP_S * (v + 0.5 * _STEP_S * a), v + _STEP_S * (a + 0.5 * _STEP_S * j)
        a += _STEP_S * j * (1.0 + (abs(a) / 9.80665) ** 2)
    else:
        return np.zeros((0, 4), dtype=np.complex128)
    return np.array(rows + [(p, 0.0, 0.0, 0.0)] * round(_STILL_S / _STEP_S))


def _snap(x: _C, u: _C, at: _C, loop: Loop) -> _C:
    """What the snap goes to; x (6, ...): place, velocity, lean, its rate, its snap, what is seen of the force."""
    late = 1.0 + _LEAD_S * loop.rotors_s / loop.lag_s**2
    late_s = loop.lag_s * late / (1.0 + _LEAD_S / loop.lag_s) + loop.rotors_s / late
    back = (loop.vel_ps2 * (at[1] - x[1] - u[3]) + loop.pos_ps3 * (at[0] - x[0] - u[2])) / loop.acc_ps
    speed = np.abs(back) * loop.acc_ps / loop.vel_ps2
    back = _cut(back, _ASKED_SHARE * np.cbrt(loop.snap_mps4) * np.cbrt(speed) ** 2)
    short = _cut(at[2] + back - _SEEN_SHARE * x[5], loop.lean_mps2) - x[2]
    size, share = np.maximum(np.abs(short), 1e-9), _TURN_SHARE * loop.snap_mps4
    turn = np.sqrt((share * late_s) ** 2 + 2.0 * share * size) - share * late_s
    turn = np.minimum(np.minimum(turn, loop.acc_ps * size), loop.fastest_mps3)
    wanted = (1.0 + _LEAD_S / loop.lag_s) * (at[3] + turn / size * short - x[3])
    asked: _C = _cut((wanted - _LEAD_S * loop.rotors_s / loop.lag_s * x[4]) / loop.lag_s, loop.snap_mps4)
    return asked


def _run(ways: _C, inputs: _C, first: _C, loop: Loop) -> _C:
    """(n + 1, 6, lanes) states; ways (n, 4, lanes), inputs (n, 4, lanes), first (3, lanes): seen, place, velocity."""
    x = np.zeros((len(ways) + 1, 6, ways.shape[2]), dtype=np.complex128)
    x[0, 0], x[0, 1], x[0, 2] = ways[0, 0] + first[1], ways[0, 1] + first[2], ways[0, 2] - first[0]
    x[0, 5], follows = first[0], 1.0 - np.exp(-_STEP_S / loop.rotors_s)
    for k, (u, at) in enumerate(zip(inputs, ways, strict=True)):
        p, v, a, j, s, seen = x[k]
        after = s + follows * (_snap(x[k], u, at, loop) - s)
        x[k + 1] = (
            p + _STEP_S * v, v + _STEP_S * (a + u[0] + u[1]), a + _STEP_S * j, j + _STEP_S * after, after,
            seen + _STEP_S / _OBSERVER_S * (u[0] - seen),
        )  # fmt: skip
    return x


def _uphill(ways: _C, inputs: _C, x: _C, toward: _C, last: NDArray[np.int64], loop: Loop) -> tuple[_C, _C]:
    """By each input, and by the first state, the way in which the place at `last` grows along `toward`."""
    g, up, follows = np.zeros_like(x[0]), np.zeros_like(inputs), 1.0 - np.exp(-_STEP_S / loop.rotors_s)
    lanes = len(last)
    moved = np.zeros((6, 12, 1), dtype=np.complex128)
    moved[np.arange(12) // 2, np.arange(12), 0] = np.where(np.arange(12) % 2 == 0, _SMALL, 1j * _SMALL)
    for k in range(len(ways) - 1, -1, -1):
        g[0] += np.where(k + 1 == last, toward, 0.0)
        by = follows * (g[4] + _STEP_S * g[3])
        up[k, 0], up[k, 1] = _STEP_S * (g[1] + g[5] / _OBSERVER_S), _STEP_S * g[1]
        g[4] = (1.0 - follows) * (g[4] + _STEP_S * g[3])
        for i in (3, 2, 1):
            g[i] += _STEP_S * g[i - 1]
        g[5] *= 1.0 - _STEP_S / _OBSERVER_S
        states = np.concatenate([x[k][:, None], x[k][:, None] + moved], axis=1)
        asked = _snap(states, inputs[k][:, None], ways[k][:, None], loop)
        change = np.real(np.conj(by) * (asked[1:] - asked[0])) / _SMALL
        felt = change[0::2] + 1j * change[1::2]
        g += felt.reshape(6, lanes)
        up[k, 2], up[k, 3] = felt[0], felt[1]
    return up, g


def _begun(last: NDArray[np.int64], sizes: F64, steps: int, copies: int) -> tuple[_C, _C]:
    """First courses, and the states that they begin with, of `copies` ways at each moment."""
    half_turns, turned = np.tile(np.array(_COURSES).T, copies)
    along = np.exp(1j * np.pi * half_turns)
    signs = np.where(np.arange(steps)[:, None] >= (turned * last)[None, :], 1.0, -1.0)
    inputs = signs[:, None] * along * (sizes * np.array([1.0, 1.0, -1.0, -1.0]))[None, :, None]
    return inputs, along * np.array([-sizes[0], sizes[2], sizes[3]])[:, None]


def left(way: Way, loop: Loop, sizes: F64, motions: list[tuple[complex, complex]]) -> F64:
    """How far the ways from motions (velocity, lean) are left; sizes: force, what no sensor shows, place, velocity.
    0 where there is no way."""
    laid_out = [_laid_out(way, loop, *motion) for motion in motions]
    laid = [each for each in laid_out if len(each)]
    if not laid:
        return np.zeros(len(motions))
    steps, copies = max(map(len, laid)), len(_MOMENTS) * len(_COURSES)
    whole = np.stack([np.concatenate([w, np.repeat(w[-1:], steps - len(w), axis=0)]) for w in laid], axis=2)
    ways = np.repeat(whole, copies, axis=2)
    last = np.concatenate([np.repeat(np.array(_MOMENTS) * len(w), len(_COURSES)) for w in laid]).astype(np.int64)
    inputs, first = _begun(last, sizes, steps, len(last) // len(_COURSES))
    lanes, best = np.arange(len(last)), np.full(len(last), -1.0)

    def away(x: _C) -> _C:
        off = x[last, 0, lanes][None, :] - ways[:, 0]
        found: _C = off[np.argmin(np.abs(off), axis=0), lanes]
        return found

    x = _run(ways, inputs, first, loop)
    for _ in range(_ROUNDS):
        toward = away(x)
        best = np.maximum(best, np.abs(toward))
        up, g = _uphill(ways, inputs, x, toward / np.maximum(np.abs(toward), 1e-9), last, loop)
        begun = np.stack([g[5] - g[2], g[0], g[1]])
        up = up / np.maximum(np.abs(up), 1e-12) * sizes[None, :, None]
        begun = begun / np.maximum(np.abs(begun), 1e-12) * sizes[[0, 2, 3], None]
        is_more = np.zeros(len(last), dtype=bool)
        kept = inputs, first, x
        for share in _SHARES:
            tried = kept[0] + share * (up - kept[0]), kept[1] + share * (begun - kept[1])
            run = _run(ways, *tried, loop)
            better = (np.abs(away(run)) > best) & ~is_more
            inputs, first = np.where(better, tried[0], inputs), np.where(better, tried[1], first)
            x, is_more = np.where(better, run, x), is_more | better
            if is_more.all():
                break
        if not is_more.any():
            break
    best = np.maximum(best, np.abs(away(x)))
    found = np.zeros(len(motions))
    found[[len(each) > 0 for each in laid_out]] = best.reshape(len(laid), copies).max(axis=1)
    return found
