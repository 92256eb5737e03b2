"""The one condition that certificate and filter share: what a commanded acceleration must do to h until the next tick.

State z = (e, v) as `response` predicts it, so that z' = (v, u + d): u the commanded acceleration, held until the next
command, `dt` later at most; d what it may miss, |d| <= E(u).  E is convex in u where thrust enters affinely (a standard
deviation is), so the chord between its values at the ends of the range bounds it.  For a piece h with gradient (he, hv)
and curvature at most K, at every time t from 0 to dt,

    h(z(t)) >= h + t q0(u) - t (|hv| + |he| dt / 2 + kappa) E(u)
    q0(u)    = he v + hv u + c(u) - dt / 2 (Kee v^2 + 2 Kev v u + (Kvv + |Kev| dt + Kee dt^2 / 4) u^2)
               - dt^2 / 2 Kee |v| U
    c(u)     = chord of min(0, he u dt / 2) between the ends of the range: the next command may come early
    kappa    = dt ((Kee dt / 2 + |Kev|) (|v| + U dt / 2) + (|Kev| dt / 2 + Kvv) U)
               + dt / 2 (Kvv + |Kev| dt + Kee dt^2 / 4) E_max,         U = max |u|, E_max = max E

and the condition is

    q(u) = q0(u) - (|hv| + |he| dt / 2 + kappa) E(u) + alpha(x) - b - off(u) >= 0,     x = h - inner - doubt
    alpha(x) = gamma x + inside max(x - 0.05, 0)
    doubt    = |he| eps_e + |hv| eps_v + (Kee eps_e^2 + 2 |Kev| eps_e eps_v + Kvv eps_v^2) / 2
    off(u)   = eps_e |Kee v + Kev u| + eps_v |he - Kev v - Kvv u| + rest

z itself is known to (eps_e, eps_v), of estimate, delay and lag: `off` is by how much q0 and its doubt may be smaller at
the true state than at the known one, exact to first order on an ellipse (on a stopping way, whose slope has a kink,
eps_v (|he| + Kvv |u|)); rest holds the second order, Kee eps_e eps_v + |Kev| eps_v^2, and the small parts.  doubt: by
how much h of the known state may be above h of the true one; eta: the most of it anywhere, so known states lie in
{h >= inner - eta}.  b: what else may be wrong in q, 1/s.  inner: h that z keeps,
so that (p, v), off from means of z by what z leaves out, keeps h >= 0.  q is concave in u, so the commands that meet it
are an interval, in closed form, and concave along e and v as every term is.

Where q >= 0 holds, the true h - inner, which is x at least, falls in a time t by t alpha(x) at most, less than itself:
the true h never becomes negative, neither between two commands nor where they come early.  alpha is flat near the edge,
which the tips of a region need, where no command changes h at once, and steep inside, where something may move outwards
at a fair speed and a command far from the edge is left alone.  It is convex, the greater of two lines, so either line
proves.
The published form is dt = 0, E = k sigma, eta = inner = b = eps = inside = 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flightstack.barrier.shapes import K_EE, K_EV, K_VV, piece_at
from flightstack.jit import njit
from flightstack.types import F64

NEAR_H = 0.05
"""Within so much h of the edge alpha is flat."""


class Setting(NamedTuple):
    """The constants of one axis' condition."""

    gamma_ps: float
    """Class-K gain."""
    eta: float
    """Greatest doubt about h itself, anywhere in the region: so far outside it a known state may lie."""
    rate_ps: float
    """b: doubt about q in 1/s."""
    dt_s: float
    """Longest time between two commands."""
    off_m: float = 0.0
    """eps_e: doubt about e."""
    inner: float = 0.0
    """h that the predicted state keeps, for position and velocity to keep 0."""
    inside_ps: float = 0.0
    """How much steeper alpha is beyond NEAR_H."""
    off_mps: float = 0.0
    """eps_v: doubt about v."""


class Reach(NamedTuple):
    """What the command can do at one speed: the range of mean acceleration and the doubt at both ends, m/s^2."""

    u_low: float
    u_high: float
    error_low: float
    error_high: float


@njit
def coefficients(
    row: F64, e: float, v: float, setting: Setting, reach: Reach, steep: bool | None = None
) -> tuple[float, float, float, float, float, float, float]:
    """(A, B, C, k, m, l, n) of q(u) = A u^2 + B u + C - |k + m u| - |l + n u|, one piece's row at (e, v); A <= 0.

    `steep`: with one line of alpha only, the steep or the flat one; None: with the greater of them.
    """
    h, he, hv = piece_at(row, e, v)
    gamma, _, rate, dt, off_m, inner, inside, off_mps = setting
    u_low, u_high, error_low, error_high = reach
    kee, kev, kvv, half = row[K_EE], row[K_EV], row[K_VV], 0.5 * dt
    most = max(abs(u_low), abs(u_high))
    worst = max(error_low, error_high)
    kappa = dt * ((kee * half + abs(kev)) * (abs(v) + most * half) + (abs(kev) * half + kvv) * most)
    kappa += half * (kvv + abs(kev) * dt + kee * half * half) * worst
    doubt = abs(hv) + abs(he) * half + kappa
    span = u_high - u_low
    slope = (error_high - error_low) / span if span > 0.0 else 0.0
    start = error_low - slope * u_low if span > 0.0 else worst
    swing_low, swing_high = min(0.0, he * half * u_low), min(0.0, he * half * u_high)
    swing = (swing_high - swing_low) / span if span > 0.0 else 0.0
    a = -half * (kvv + abs(kev) * dt + kee * half * half)
    b = hv - dt * kev * v + swing - doubt * slope
    c = he * v - half * kee * abs(v) * (abs(v) + dt * most) - doubt * start - rate
    x = h - inner - doubt_of(row, he, hv, off_m, off_mps)
    if (x > NEAR_H) if steep is None else steep:
        c += inside * (x - NEAR_H)
    c += gamma * x
    c += swing_low - swing * u_low
    c -= _rest(row, abs(v), dt, (off_m, off_mps), most, worst)
    if row[0] == 0.0:
        return a, b, c, off_m * kee * v, off_m * kev, off_mps * (he - kev * v), -off_mps * kvv
    return a, b, c - off_mps * abs(he), 0.0, 0.0, 0.0, off_mps * kvv


@njit
def doubt_of(row: F64, he: float, hv: float, off_m: float, off_mps: float) -> float:
    """By how much h of the true state may be less than h of the known one, where its gradient is (he, hv)."""
    kee, kev, kvv = row[K_EE], abs(row[K_EV]), row[K_VV]
    bent = 0.5 * (kee * off_m * off_m + kvv * off_mps * off_mps) + kev * off_m * off_mps
    return abs(he) * off_m + abs(hv) * off_mps + bent  # type: ignore[no-any-return]


@njit
def _rest(row: F64, speed: float, dt: float, off: tuple[float, float], most: float, worst: float) -> float:
    """What an offset of the state may cost beyond the slopes of he v + hv u: by holding, by E, and to second order."""
    kee, kev, kvv, half = row[K_EE], abs(row[K_EV]), row[K_VV], 0.5 * dt
    off_m, off_mps = off
    along_e = kee * half * most + (kev + kee * half) * worst
    along_v = dt * (kee * (speed + off_mps) + kev * most) + half * (kee * dt + kev) * most
    along_v += (kvv + kev * half + dt * (kee * half + kev)) * worst
    return along_e * off_m + along_v * off_mps + kee * off_m * off_mps + kev * off_mps * off_mps  # type: ignore[no-any-return]


@njit
def margin_at(q: tuple[float, float, float, float, float, float, float], u: float) -> float:
    """q(u) of `coefficients`, 1/s."""
    a, b, c, k, m, l, n = q  # noqa: E741
    return (a * u + b) * u + c - abs(k + m * u) - abs(l + n * u)


@njit
def interval(rows: F64, e: float, v: float, setting: Setting, reach: Reach) -> tuple[float, float, float]:
    """Least and greatest command in reach that meets the condition of every piece, and the margin q of the best one.

    `rows` (n, ROW).  A negative margin: there is none, and both ends are the best command of the worst piece.  What is
    no number and a range that is empty give the margin minus infinity.
    """
    low, high = reach[0], reach[1]
    margin, best = np.inf, low
    if not low <= high:
        return low, low, -np.inf
    for i in range(rows.shape[0]):
        q, top, left, right = _concave(coefficients(rows[i], e, v, setting, reach), reach[0], reach[1])
        if np.isnan(q):
            return reach[0], reach[0], -np.inf
        if q < margin:
            margin, best = q, top
        if q < 0.0:
            continue
        low, high = max(low, left), min(high, right)
    if margin < 0.0:
        return best, best, margin
    if low > high:  # each piece has commands of its own, but none is common
        middle = 0.5 * (low + high)
        return middle, middle, high - low
    return low, high, margin


@njit
def _concave(
    q: tuple[float, float, float, float, float, float, float], low: float, high: float
) -> tuple[float, float, float, float]:
    """The best q on [low, high], its command, and the least and greatest command with q >= 0.

    Between the zeros of the two absolute values q is a parabola.
    """
    a, b, c, k, m, l, n = q  # noqa: E741
    one, two = (-k / m if m != 0.0 else low), (-l / n if n != 0.0 else low)
    one, two = min(max(one, low), high), min(max(two, low), high)
    one, two = min(one, two), max(one, two)
    best, top, first, last = -np.inf, low, np.inf, -np.inf
    for i in range(3):
        start = low if i == 0 else (one if i == 1 else two)
        stop = one if i == 0 else (two if i == 1 else high)
        if start >= stop and not (i == 2 and low == high):
            continue
        middle = 0.5 * (start + stop)
        s, t = (1.0 if k + m * middle >= 0.0 else -1.0), (1.0 if l + n * middle >= 0.0 else -1.0)
        found, at, left, right = _parabola(a, b - s * m - t * n, c - s * k - t * l, start, stop)
        if np.isnan(found):
            return found, at, left, right
        if found > best:
            best, top = found, at
        if found >= 0.0:
            first, last = min(first, left), max(last, right)
    if best < 0.0:
        return best, top, top, top
    return best, top, first, last


@njit
def _parabola(a: float, b: float, c: float, low: float, high: float) -> tuple[float, float, float, float]:
    """The same of a u^2 + b u + c, a <= 0."""
    top = high if b >= 0.0 else low
    if a < -1e-12:
        top = min(max(-0.5 * b / a, low), high)
    q = (a * top + b) * top + c
    if not q >= 0.0:
        return q, top, top, top
    left, right = _roots(a, b, c, low, high)
    return q, top, left, right


@njit
def _roots(a: float, b: float, c: float, low: float, high: float) -> tuple[float, float]:
    """The part of [low, high] where a u^2 + b u + c >= 0, a <= 0; known not to be empty."""
    if a > -1e-12:
        if b > 1e-12:
            return max(low, -c / b), high
        if b < -1e-12:
            return low, min(high, -c / b)
        return low, high
    root = np.sqrt(max(b * b - 4.0 * a * c, 0.0))
    far = -0.5 * (b + root) if b >= 0.0 else -0.5 * (b - root)  # the root without cancellation
    one, two = far / a, (c / far if far != 0.0 else 0.0)
    return max(low, min(one, two)), min(high, max(one, two))
