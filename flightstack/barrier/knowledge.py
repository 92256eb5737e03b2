"""From what is known to what a certificate may count on: each axis' `Authority`, the shared `Budget`, and k_sigma.

Two sources, both intervals of true acceleration: the knowledge before take-off (`initial`), which needs no data, and
the learner's Gaussian processes (`posterior`), mean +- k sigma.  Where both speak, both are true, and the narrower
counts; where they contradict each other, their hull does.

**The thrust.**  Thrust vectors f (believed newton per believed kilogram, NED, thrust is -f) have a direction b whose
parts along north and east each lie in a range of their own, [l_n, m_n] and [l_e, m_e], and a down part from low to high
(`budgets.budget`).  All that is certified holds for them.

**The queries.**  Along axis i the speeds v_i are the nodes; the other inputs vary over their ranges.  With signs
s1..s4 in {-1, 1} (outermost first), V_j(s) the least or greatest speed of axis j, b_d = sqrt(1 - b_n^2 - b_e^2) and
f = b F / b_d:

    down     b = (B_n(s1), B_e(s2)),      v = (V_n(s3), V_e(s4), node)     end low: F = high, end high: F = low
    north    b = (m_n or l_n, B_e(s1)),   v = (node, V_e(s3), V_d(s4))     end low: m, end high: l;
    east     b = (B_n(s1), m_e or l_e),   v = (V_n(s3), node, V_d(s4))         F = high where s2 = 1, else low

B_j(s) the least or greatest lean along axis j.  To these comes first the *centre* query with the signs' b and speeds 0
(or the range's nearest), F of a lateral one the thrust of hover.  On the `slice` there is only this.  near is that of
the greatest height in all: what the ground does below is not extrapolated from the data but bounded, as it only ever
adds thrust, by at most g = 2 near(least height) F (twice Cheeseman and Bennett's): lo - g along down, lo - g max(m, 0)
and hi + g max(-l, 0) across.  Corners are representative: between them nothing is taken to be further off.

A `last` certificate asks along down at the least height as well, where its prior lets the ground do half of Cheeseman
and Bennett's or more: lo is mean - k sigma there, less what is not linear in near, g near / (1 - near).  What is
learned is linear in near: the less of both ends' lo holds between, and counts where it is more than lo - g.

**The bound.**  For each query and end [lo, hi] = mean -+ k_a sigma of the acceleration along the axis, cut with the
initial interval (of -f - drag v) there; k_a is that of the axis' queries together (`hull_sigmas`; on the slice and in
a `last` certificate k).  A lateral one is taken without what thrust explains: + gain_d(v_d) f_i, gain_d
linear between the vertical nodes.  The node's interval is the hull over its queries, for lateral axes over both ends.
Half its width and its middle give

    down     u_low, u_high: the middles; gain = (u_high - u_low) / (high - low), offset = u_high + gain low
    lateral  offset: the middle; u_low = offset - F0 min(gain_d (m - spare)), u_high = offset - F0 max(gain_d (l +
             spare)), over the nodes' gains: what either end of the leans that the filter keeps (`Budget.kept`) gives,
             F0 = max(hover, (low + high) / 2) the thrust that the filter steers with: where thrust differs from it,
             the filter leans further or less

    error at a node = max over it and its neighbours of (half width + |its middle - this one's|) + k bend + widen + t

t: what torque does to thrust (`torque`) times the greatest gain, sideways times the sine of the greatest lean;
so the bound holds also where the vehicle's speed is a node's spacing from the one that the filter counts with.  `bend`
is the prior's standard deviation of the middle of a gap between two nodes, given as deviation from their mean (a
second difference: constants, drag and thrust, linear in v, have none); a gap is a small part of any length scale, so
between two nodes the deviation is a parabola with its greatest value there.

**The kernels** are the learner's, but for the size of the smooth remainder, of which nothing is known but what the
flight shows: of the sizes (standard deviation) prior / 2^i, i = 0..5, the largest whose likelihood of the points is
within a factor of 7 (exp 1.92) of the best one's, so an upper confidence bound of 97.5 %; the likelihood is that with
the likeliest noise (`posterior`: as measured or half as much again, and drift over 2 s of none, a quarter or all of
it), a profile likelihood.  With the sizes it is asked whether there is a force up or down: the likelier counts.  All
else keeps its prior.  Source: Capone, Lederer, Hirche, "GP uniform error bounds with unknown hyperparameters", 2022.

**k_sigma.**  Each bound is two-sided and Gaussian; the union over all of them (`statements`: queries and gaps) fails
with probability delta_n at most: k = Phi^-1(1 - delta_n / (2 statements)), delta_n = 6 delta / (pi n)^2 for the n-th
certificate, n from 1, so that all that are ever issued fail with delta at most.  One after which none is issued
(`last`) may spend what is left: delta_n + delta_n+1 + ... = delta (1 - sum over k < n of 6 / (pi k)^2).  Which one is
issued is chosen after the data were seen.  That costs nothing: the bounds are posterior ones, so given the data each
fails with its chance, whichever is chosen.

`as_json` holds all that these sentences use; `sha256` is over x, then y of the lateral store, then of the vertical one
(little-endian doubles, row by row).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri, zeta

from flightstack.barrier.hull_sigmas import Sides, sigmas
from flightstack.barrier.initial import DOWN, InitialKnowledge, require_authority, vertical_authority_weights
from flightstack.barrier.posterior import Accelerations
from flightstack.barrier.queries import (
    Envelope,
    Steering,
    furthest,
    ground_mps2,
    ground_rest_mps2,
    lifted,
    queries,
    statements,
)  # fmt: skip
from flightstack.barrier.query_inputs import proximity
from flightstack.barrier.records import Authority, Budget
from flightstack.learning.sampler import THRUST, V_X
from flightstack.model import Model
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

__all__ = [
    "Envelope", "InitialKnowledge", "Knowledge", "confidence", "require_authority",
    "vertical_authority_weights",
]  # fmt: skip

_G = STANDARD_GRAVITY_MPS2
_CHUNK = 128
"""Queries evaluated at one go, most of them in pairs: about a millisecond with 300 points."""


@dataclass(frozen=True, slots=True)
class Knowledge:
    """Bounds of the true acceleration, axis by axis."""

    authorities: Mapping[int, Authority]
    """By axis, those asked for."""
    gain_part_mps2: Mapping[int, float]
    """How much of the error at u_low is the thrust gain's doubt, at the worst node."""
    torque_part_mps2: Mapping[int, float]
    """How much of the error is what torque does to thrust (`torque`)."""
    budget: Budget
    delta: float
    """Chance that any bound of any certificate fails."""
    k_sigma: float
    """Of the union over all single bounds."""
    k_queries: tuple[float, float, float]
    """Of each axis' queries, which need fewer together; of an axis that is not asked for, k_sigma."""
    version: int
    """Of the certificate, from 1."""
    hover_mps2: float
    """Specific thrust of hover."""
    request: Request

    def as_json(self) -> dict[str, object]:
        """Everything that the bounds are made of, as plain numbers, lists and tables."""
        return {**_as_json(self.request), "k_queries": list(self.k_queries)}

    @classmethod
    def of(cls, request: Request) -> Knowledge:
        """All of it in one go; without a learner what is known before any data."""
        *_, last = cls.steps(request)
        assert last is not None
        return last

    @classmethod
    def steps(cls, request: Request) -> Iterator[Knowledge | None]:
        """The same in pieces of about a millisecond: None after each, the knowledge after the last."""
        for hulls in _all_steps(request):
            yield None if hulls is None else _finish(request, hulls)


class Request(NamedTuple):
    """All that a bound depends on."""

    learned: Accelerations | None
    """The learner's processes, live or frozen; None: before take-off."""
    model: Model
    envelope: Envelope
    box: Budget
    """`budgets.budget`; it does not lean where the vertical axis is meant alone."""
    initial: InitialKnowledge | None = None
    delta: float = 0.05
    version: int = 1
    last: bool = False
    """No certificate will be issued after this one."""
    widen_mps2: F64 = np.zeros(3)
    """Added to each axis' error, (3,); `attitude_mps2` besides."""
    attitude_mps2: F64 = np.zeros(3)
    """What the attitude's error puts thrust off by, (3,)."""
    torque_mps2: float = 0.0
    """Specific thrust that torque may add or take."""

    @property
    def k(self) -> float:
        """Sigmas of each bound."""
        if self.learned is None:
            return 0.0
        return confidence(self.delta, self.version, statements(self.envelope, self.last), self.last)

    @property
    def widen(self) -> F64:
        """All that is added to each axis' error."""
        return self.widen_mps2 + self.attitude_mps2


class _Hull(NamedTuple):
    """Intervals of one axis' acceleration at its nodes, at both ends of the command."""

    v: F64
    low: F64
    """(n, 2) least true acceleration; columns: end low, end high."""
    high: F64
    bend: float
    wanted: tuple[float, float]
    """W of a lateral axis."""
    k: float
    """Sigmas of its queries (`hull_sigmas`)."""


def confidence(delta: float, version: int, statements: int, last: bool = False) -> float:
    """k_sigma for the `version`-th certificate (from 1), whose bounds are so many two-sided Gaussian statements.

    `last`: with all that those before it have left of delta.
    """
    share = 6.0 * delta / (math.pi * version) ** 2
    if last:
        share = 6.0 * delta / math.pi**2 * float(zeta(2.0, version))
    return float(-ndtri(0.5 * share / statements))


def _all_steps(request: Request) -> Iterator[dict[int, _Hull] | None]:
    """None after each piece of the work, the hulls after the last."""
    hulls: dict[int, _Hull] = {}
    for axis in (DOWN, *(i for i in request.envelope.axes if i != DOWN)):
        steering = None if axis == DOWN else _steering(hulls[DOWN], request.box)
        for hull in _hull_steps(request, axis, steering):
            if hull is not None:
                hulls[axis] = hull
            yield None
    yield hulls


def _steering(down: _Hull, box: Budget) -> Steering:
    middle = 0.5 * (down.low + down.high)
    gain = np.maximum((middle[:, 1] - middle[:, 0]) / max(box.high_mps2 - box.low_mps2, 1e-9), 1e-3)
    at = int(np.argmin(np.abs(down.v)))
    hover = float(middle[at, 1] / gain[at]) + box.low_mps2
    return Steering(down.v, gain, min(max(hover, box.low_mps2), box.high_mps2))


def _hull_steps(request: Request, axis: int, steering: Steering | None) -> Iterator[_Hull | None]:
    """None after each piece of the work, the axis' hull after the last."""
    asked = queries(request.envelope, request.box, request.model.rotor_radius_m, axis, steering)
    shape = asked.speed_mps.shape[:3]
    speed, thrust = asked.speed_mps.reshape(-1, 3), asked.thrust_mps2.reshape(-1, 3)
    near = np.broadcast_to(asked.near, shape).reshape(-1)
    learned = np.zeros((3, len(near)))
    size = len(near) if request.learned is None else _CHUNK
    for start in range(0, len(near), size):
        part = asked.order[start : start + size]
        if request.learned is not None:
            learned[:, part] = request.learned.at(axis, speed[part], thrust[part], near[part])
        yield None
    ground = ground_mps2(request.envelope, request.model.rotor_radius_m, thrust)
    explained = asked.explained_mps2.reshape(-1)
    against, along = lifted(request.box, axis)
    sides = Sides(
        *_learned_and_sure(request, axis, (speed, thrust), learned),
        explained - ground * against,
        explained + ground * along,
    )
    k = request.k
    if request.learned is not None and not (request.last or request.envelope.slice_only):
        groups = shape[0] * (2 if axis == DOWN else 1)
        k = sigmas(sides.grouped(groups), k)
    bounds = sides.at(k)
    low, high = bounds[0] + sides.below, bounds[1] + sides.above
    if axis == DOWN and request.last and request.learned is not None:
        low = np.maximum(low, np.minimum(bounds[0], _near_ground(request, speed, thrust)))
    yield _Hull(
        asked.v_mps, low.reshape(shape).min(axis=2), high.reshape(shape).max(axis=2), _bend(request, axis, asked.v_mps),
        asked.wanted_mps2, k,
    )  # fmt: skip


def _learned_and_sure(request: Request, axis: int, at: tuple[F64, F64], learned: F64) -> tuple[F64, F64, F64, F64, F64]:
    """The first five parts of `Sides`, of mean, sigma and rest (3, n) at speeds and thrusts (n, 3)."""
    model, known, (speed, thrust) = request.model, request.initial, at
    none = np.full(len(speed), math.inf)
    low, high = -none, none
    if known is not None:
        drag = max(model.drag_kgps) / model.mass_kg
        low, high = known.interval(axis, -thrust[:, axis] - drag * speed[:, axis])
    mean, sigma, rest = learned
    if request.learned is None:
        return -none, none, sigma, low, high
    return mean - rest, mean + rest, sigma, low, high


def _near_ground(request: Request, speed: F64, thrust: F64) -> F64:
    """Least true acceleration along down at the least height, as learned; minus infinity by a learner without it."""
    assert request.learned is not None
    envelope, radius_m = request.envelope, request.model.rotor_radius_m
    near = proximity(radius_m, envelope.heights_m[0])
    if not request.learned.knows_ground(near):
        return np.full(len(thrust), -math.inf)
    mean, sigma, rest = request.learned.at(DOWN, speed, thrust, np.full(len(thrust), near))
    least: F64 = mean - request.k * sigma - rest - ground_rest_mps2(envelope, radius_m, thrust)
    return least


def _bend(request: Request, axis: int, nodes: F64) -> float:
    """Standard deviation of the residual half-way between two nodes, about their mean, before any data."""
    if request.learned is None or len(nodes) < 2:
        return 0.0
    x = np.zeros((3, 7))
    x[:, V_X + axis] = [nodes[0], 0.5 * (nodes[0] + nodes[1]), nodes[1]]
    x[:, THRUST] = 1.0
    weights = np.array([-0.5, 1.0, -0.5])
    variances = [
        float(weights @ p.process.kernel.matrix(x) @ weights) * float(p.process.colour.inflation.max()) ** 2
        for p in (request.learned.lateral, request.learned.vertical)
    ]
    return math.sqrt(max(*variances, 0.0))


def _finish(request: Request, hulls: Mapping[int, _Hull]) -> Knowledge:
    """Authorities from the hulls, by the module's rule."""
    torque = _torque(request, hulls[DOWN])
    authorities = {axis: _authority(request, axis, hull, torque[axis]) for axis, hull in hulls.items()}
    doubt, hover = _gain_doubt(request), _steering(hulls[DOWN], request.box).hover_mps2
    parts = {
        axis: doubt
        * (request.box.high_mps2 - hover if axis == DOWN else request.box.high_mps2 * furthest(request.box, axis))
        for axis in hulls
    }
    parts = {
        axis: min(part, float(authorities[axis].error_low_mps2.max() - request.attitude_mps2[axis]) - torque[axis])
        for axis, part in parts.items()
    }
    north, east, down = (hulls[axis].k if axis in hulls else request.k for axis in range(3))
    return Knowledge(
        authorities, parts, torque, request.box, request.delta, request.k, (north, east, down), request.version, hover,
        request,
    )  # fmt: skip


def _torque(request: Request, down: _Hull) -> dict[int, float]:
    """By axis, what torque may do to the acceleration: along the thrust, leaning as far as the budget allows."""
    most = request.torque_mps2 * float(_steering(down, request.box).gain.max())
    across = most * math.sin(request.box.tilt_max_rad)
    return {0: across, 1: across, DOWN: most}


def _authority(request: Request, axis: int, hull: _Hull, torque_mps2: float) -> Authority:
    middle, half = 0.5 * (hull.low + hull.high), 0.5 * (hull.high - hull.low)
    if axis == DOWN:
        span = max(request.box.high_mps2 - request.box.low_mps2, 1e-9)
        gain = (middle[:, 1] - middle[:, 0]) / span
        offset = middle[:, 1] + gain * request.box.low_mps2
        ends = middle
    else:
        least, most = hull.low.min(axis=1), hull.high.max(axis=1)
        offset, gain = 0.5 * (least + most), np.zeros(len(hull.v))
        ends = offset[:, None] + np.array(hull.wanted)
        half = np.repeat(0.5 * (most - least)[:, None], 2, axis=1)
        middle = np.repeat(offset[:, None], 2, axis=1)
    more = request.k * hull.bend + float(request.widen[axis]) + torque_mps2
    error = np.array([_around(middle[:, i], half[:, i]) for i in range(2)]) + more
    return Authority(hull.v, offset, gain, ends[:, 0].copy(), ends[:, 1].copy(), error[0], error[1])


def _around(middle: F64, half: F64) -> F64:
    """(n,) half width that holds each node's and its neighbours' intervals about the node's own middle."""
    out = half.copy()
    apart = np.abs(np.diff(middle))
    out[1:] = np.maximum(out[1:], half[:-1] + apart)
    out[:-1] = np.maximum(out[:-1], half[1:] + apart)
    return out


def _gain_doubt(request: Request) -> float:
    """Bound of the thrust gain's error at rest."""
    doubt = math.inf
    if request.initial is not None:
        least, most = request.initial.gain
        doubt = 0.5 * (most - least)
    if request.learned is None:
        return doubt
    x = np.zeros((3, 7))
    x[:, THRUST] = [0.0, 1.0, 2.0]
    none, one, two = request.learned.vertical.at(x)[
        1
    ].tolist()  # a variance is quadratic in thrust: its bend the slope's
    sigma = float(request.learned.vertical.process.colour.inflation[0]) * math.sqrt(
        max(0.5 * (none - 2.0 * one + two), 0.0)
    )
    return min(doubt, request.k * sigma / _G)


def _as_json(request: Request) -> dict[str, object]:
    model, envelope, known = request.model, request.envelope, request.initial
    data: dict[str, object] = {
        "kind": "initial" if request.learned is None else "learned",
        "initial": None if known is None else {
            "mass_ratio": list(known.mass_ratio), "force_weights": known.force_weights,
        },
        "gravity_mps2": _G,
        "drag_per_s": [each / model.mass_kg for each in model.drag_kgps],
        "rotor_radius_m": model.rotor_radius_m,
        "speeds_mps": [list(each) for each in envelope.speeds_mps],
        "heights_m": list(envelope.heights_m),
        "nodes": envelope.nodes, "slice_only": envelope.slice_only, "axes": list(envelope.axes),
        "delta": request.delta, "version": request.version, "k_sigma": request.k,
        "statements": 0 if request.learned is None else statements(envelope, request.last),
        "widen_mps2": request.widen.tolist(), "torque_mps2": request.torque_mps2,
    }  # fmt: skip
    if request.last:
        data["last"] = True
    if request.learned is not None:
        lateral, vertical = (each.process for each in (request.learned.lateral, request.learned.vertical))
        data["lateral"], data["vertical"] = lateral.as_json(), vertical.as_json()
        data["sha256"] = hashlib.sha256(lateral.bytes + vertical.bytes).hexdigest()
    return data
