"""The barrier of one axis and the condition that a command must meet, anew from the mathematics, in intervals.

u: commanded acceleration; dt: longest time to the next one; E: how far the true one may be off, a chord
over the range of u; U, Emax: the largest |u| and E; h concave with gradient (he, hv) and curvature at most K:

    q = he v + hv u + c - dt/2 (Kee v^2 + 2 Kev v u + (Kvv + |Kev| dt + Kee dt^2/4) u^2) - dt^2/2 Kee |v| U
        - (|hv| + |he| dt/2 + kappa) E + alpha(h - inner - doubt) - b - off
    doubt = |he| x + |hv| y + (Kee x^2 + 2 |Kev| x y + Kvv y^2) / 2,  x, y: offsets of e and v
    alpha(x) = gamma x + inside max(x - 0.05, 0)
    c = chord over the range of u of min(0, he u dt/2)
    off = x |Kee v + Kev u| + y |he - Kev v - Kvv u| + Kee x y + |Kev| y^2 + x ke + y kv;
        of a stopping distance y (|he| + Kvv |u|) in place of the first two
    ke = Kee U dt/2 + (|Kev| + Kee dt/2) Emax
    kv = dt (Kee (|v| + y) + |Kev| U) + dt/2 (Kee dt + |Kev|) U + (Kvv + |Kev| dt/2 + dt (Kee dt/2 + |Kev|)) Emax
    kappa = dt ((Kee dt/2 + |Kev|) (|v| + U dt/2) + (|Kev| dt/2 + Kvv) U) + dt/2 (Kvv + |Kev| dt + Kee dt^2/4) Emax

To second order in time it bounds the fall of h over any t in (0, dt], divided by t.  For a fixed u, and away from the
kinks of a stopping distance, each second derivative of q along e or along v is at most a constant, which is 0 or less
but for a steep cross term.  So the least q of a box is at a corner, less (that constant) width^2 / 8.  A corner outside
{h >= edge}, edge = inner - eta, doesn't count: q - l (h - edge), l >= 0, is at most q inside, and it is tried too; then
the box is split.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .intervals import F64, Interval, Mask

SLACK = 1e-9
"""What two correct computations in float64 may differ by: in q (1/s), in h, in accelerations (m/s^2)."""
NEAR_H = 0.05
"""Beyond it alpha has its steep line."""


_SIGN, _LIMIT, _REACTION, _BRAKE, _SCALE = range(5)
"""Of a stopping piece."""
E_LOW, E_HIGH, V_LOW, V_HIGH = range(4)
"""Of a box."""


@dataclass
class Piece:
    """One concave piece of h.  Quadratic: (ce, cv, p11, p12, p22); stopping: (sign, limit, reaction, brake, scale)."""

    quadratic: bool
    p: tuple[float, ...]

    def at(self, e: Any, v: Any) -> tuple[Interval, Interval, Interval]:
        """h, dh/de, dh/dv."""
        if self.quadratic:
            ce, cv, p11, p12, p22 = self.p
            de, dv = Interval(e) - ce, Interval(v) - cv
            ae, av = de * p11 + dv * p12, de * p12 + dv * p22
            return 1.0 - de * ae - dv * av, ae * -2.0, av * -2.0
        sign, limit, reaction, brake, scale = self.p
        toward = Interval(np.asarray(v) * sign).at_least(-(Interval(brake) * reaction))
        way = toward * reaction + toward * toward / (2.0 * brake)
        slope = (toward / brake + reaction).at_least(0.0)
        he = Interval(np.full(np.shape(e), -sign)) / scale
        return (limit - Interval(e) * sign - way) / scale, he, slope * -sign / scale

    def curvature(self) -> tuple[Interval, Interval, Interval]:
        """Kee, Kev, Kvv, with -hessian <= K."""
        if self.quadratic:
            kee, kev, kvv = (Interval(2.0 * number) for number in self.p[2:])
            return kee, kev, kvv
        return Interval(0.0), Interval(0.0), Interval(1.0) / self.p[_BRAKE] / self.p[_SCALE]

    def kinks(self) -> list[float]:
        """Speeds at which the gradient has a bend (rounded: SLACK holds what that costs)."""
        return [] if self.quadratic else [-self.p[_SIGN] * self.p[_BRAKE] * self.p[_REACTION]]

    def highest(self, boxes: F64) -> F64:
        """(k,) h is at most this on each box: a tangent plane at the highest point (about) lies above it."""
        e0, e1, v0, v1 = boxes.T
        if self.quadratic:
            ce, cv, p11, p12, p22 = self.p
            e, v = np.clip(ce, e0, e1), np.clip(cv, v0, v1)
            for _ in range(60):
                e = np.clip(ce - p12 / p11 * (v - cv), e0, e1)
                v = np.clip(cv - p12 / p22 * (e - ce), v0, v1)
        else:
            e, v = (e0, v0) if self.p[_SIGN] > 0.0 else (e1, v1)
        h, he, hv = self.at(e, v)
        plane: Interval = h + he * (Interval(e0, e1) - e) + hv * (Interval(v0, v1) - v)
        return plane.hi


@dataclass
class Condition:
    """One axis' barrier and the constants of its condition."""

    pieces: list[Piece]
    gamma: float
    eta: float
    rate: float
    dt: float
    off_m: float
    inner: float
    inside: float
    off_mps: float

    @property
    def edge(self) -> float:
        """Least h of a predicted state whose true one is inside."""
        return self.inner - self.eta

    def reach_m(self) -> tuple[float, float]:
        """Least and greatest e of the region h >= 0."""
        first = self.pieces[0]
        if first.quadratic:
            ce, _, p11, p12, p22 = first.p
            half = float(np.sqrt(p22 / (p11 * p22 - p12 * p12)))
            return ce - half, ce + half
        ends = [piece.p[_LIMIT] + 0.5 * piece.p[_BRAKE] * piece.p[_REACTION] ** 2 for piece in self.pieces]
        return -ends[1], ends[0]

    def fastest(self) -> float:
        """Greatest speed of the region h >= 0 of stopping distances."""
        return 0.0 if self.pieces[0].quadratic else max(self.fastest_of(piece) for piece in self.pieces)

    def fastest_of(self, piece: Piece) -> float:
        """The same towards one limit."""
        other = self.pieces[1] if piece is self.pieces[0] else self.pieces[0]
        _, _, reaction, brake, _ = piece.p
        way = self.pieces[0].p[_LIMIT] + self.pieces[1].p[_LIMIT] + 0.5 * other.p[_BRAKE] * other.p[_REACTION] ** 2
        return brake * (
            float(np.sqrt(reaction**2 + 2.0 * way / brake)) - reaction
        )  # way = reaction v + v^2 / (2 brake)

    def margin(
        self, piece: Piece, e: Any, v: Any, u: Any, reach: F64, line: bool | None = None
    ) -> tuple[Interval, Interval]:
        """q and h of one piece; `reach` (4, ...): least and greatest command, and the error at each.

        `line`: alpha's steep line alone, or its flat one; either is at most alpha, so its q proves.
        """
        low, high, error_low, error_high = reach
        half = 0.5 * self.dt
        (h, he, hv), (kee, kev, kvv) = piece.at(e, v), piece.curvature()
        most, worst = np.maximum(abs(low), abs(high)), np.maximum(error_low, error_high)
        v, u, dt = Interval(v), Interval(u), self.dt
        wide = high > low
        share = (u - low) / (Interval(np.where(wide, high, 1.0)) - np.where(wide, low, 0.0))
        share = Interval(np.where(wide, share.lo, 0.0), np.where(wide, share.hi, 0.0))
        error = Interval(np.where(wide, error_low, worst)) * (1.0 - share) + Interval(error_high) * share
        turn = kvv + abs(kev) * dt + kee * half * half
        kappa = dt * ((kee * half + abs(kev)) * (abs(v) + most * half) + (abs(kev) * half + kvv) * most)
        kappa = kappa + half * worst * turn
        early = -(-(he * half * low)).at_least(0.0) * (1.0 - share) - (-(he * half * high)).at_least(0.0) * share
        bent = (kee * v * v + 2.0 * kev * v * u + turn * u * u + dt * kee * abs(v) * most) * half
        q = he * v + hv * u + early - bent - (abs(hv) + abs(he) * half + kappa) * error
        x = h - self.inner - self._doubt(piece, he, hv)
        beyond = (x - NEAR_H) * self.inside
        if line is None or line:
            q = q + (beyond if line else beyond.at_least(0.0))
        return q + x * self.gamma - self.rate - self._off(piece, he, v, u, (most, worst)), h

    def _doubt(self, piece: Piece, he: Interval, hv: Interval) -> Interval:
        """By how much h may be less where the state is off."""
        (kee, kev, kvv), x, y = piece.curvature(), self.off_m, self.off_mps
        bent = (kee * (x * x) + kvv * (y * y)) * 0.5 + abs(kev) * (x * y)
        return abs(he) * x + abs(hv) * y + bent

    def _off(self, piece: Piece, he: Interval, v: Interval, u: Interval, ends: tuple[F64, F64]) -> Interval:
        """By how much q may be less where the state is off."""
        (kee, kev, kvv), (most, worst), (x, y) = piece.curvature(), ends, (self.off_m, self.off_mps)
        half, cross = 0.5 * self.dt, abs(kev)
        along_e = kee * half * most + (cross + kee * half) * worst
        along_v = (kee * (abs(v) + y) + cross * most) * self.dt + (kee * self.dt + cross) * half * most
        along_v = along_v + (kvv + cross * half + (kee * half + cross) * self.dt) * worst
        rest = along_e * x + along_v * y + kee * x * y + cross * y * y
        if piece.quadratic:
            return rest + abs(kee * v + kev * u) * x + abs(he - kev * v - kvv * u) * y
        return rest + (abs(he) + kvv * abs(u)) * y

    def _steepest(self, piece: Piece, helper: Piece, weight: float, slope: float) -> tuple[Interval, Interval]:
        """Most of d2/de2 and d2/dv2 of q - weight (h of helper - edge), where it is smooth."""
        kee, _, kvv = (k * weight for k in helper.curvature())
        if not piece.quadratic:
            return kee, kvv
        p11, p12, p22 = (Interval(number) for number in piece.p[2:])
        return kee - p11 * 2.0 * slope, kvv - p22 * 2.0 * slope - p12 * 4.0 - p11 * 2.0 * self.dt

    def lowest(self, boxes: F64, u: F64, reach: F64) -> F64:
        """(k,) q of every piece is at least this where h >= edge in each box."""
        e, v = boxes[:, [0, 0, 1, 1]], boxes[:, [2, 3, 2, 3]]
        wide_e, wide_v = Interval(boxes[:, E_HIGH]) - boxes[:, E_LOW], Interval(boxes[:, V_HIGH]) - boxes[:, V_LOW]
        found = np.full(len(boxes), np.inf)
        for piece in self.pieces:
            best = np.full(len(boxes), -np.inf)
            for line in (False, True) if self.inside > 0.0 else (False,):
                q, _ = self.margin(piece, e, v, u[:, None], reach[:, :, None], line)
                slope = self.gamma + (self.inside if line else 0.0)
                for helper in self.pieces:
                    doubt = helper.at(e, v)[0] - self.edge
                    for weight in (0.0, 0.3 * self.gamma, self.gamma, 3.0 * self.gamma):
                        bend_e, bend_v = (b.at_least(0.0) for b in self._steepest(piece, helper, weight, slope))
                        corners = q - doubt * weight
                        sag = (bend_e * wide_e * wide_e + bend_v * wide_v * wide_v) * 0.125
                        best = np.maximum(best, (Interval(corners.lo.min(axis=1)) - sag).lo)
            found = np.minimum(found, best)
        return found

    def outside(self, boxes: F64) -> Mask:
        """(k,) whether no point of a box has h >= edge."""
        highest = np.min([piece.highest(boxes) for piece in self.pieces], axis=0)
        return np.asarray(highest < self.edge + SLACK)
