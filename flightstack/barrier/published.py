"""The published certificate, for the record: h_mu, its sampling condition and its search for mu.

    h_mu = 1 - sum_i e_i^2 / a_i^2 - v_n^2 / b_n^2 - v_e^2 / b_e^2 - mu v_d^2

is a `Region` of kind ellipsoid with b_d = 1 / sqrt(mu); on the vertical line it is the `Quadratic` without cross term.
The sampling condition (lemma III.1) at a point x of a grid whose points lie within tau / 2 of every state:

    max_u {h_v g u} + h_v m - k sigma |h_v| + h_e v + h_v f + gamma h  >=  (L_hdot + gamma L_h) tau

None can meet it.  At the tips e = +-a, v = 0 gradient by v, h and so the whole left side are 0; a grid point within
tau / 2 of a tip has at most half of the right side there.  (Where that point lies outside the region, which the paper
skips, the tip is covered by nothing.)  This holds for every mu, gamma, tau > 0, with any model.

As published, then, mu counts as accepted where the left side alone is 0 or more at every grid point of the region.
A plain grid misses the strip between its outermost points and the boundary, where the condition is hardest, and would
accept less than physics allows; so the boundary's own points are part of the grid, and at the tips, where the left
side is 0 by itself, it must not fall on either side.

Source: L. Wang, E. Theodorou, M. Egerstedt, "Safe Learning of Quadrotor Dynamics Using Barrier Certificates", 2018,
lemma III.1 and section V.B.  What is wrong with it: `flightstack.barrier.sampling` covers a strict barrier instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from flightstack.barrier.condition import Setting
from flightstack.barrier.records import Authority, AxisCertificate, Budget, Certificate, Response
from flightstack.barrier.shapes import Quadratic
from flightstack.region import Region
from flightstack.types import F64, InputError

MU_INITIAL = 6.3
"""The paper's conservative start."""
NOT_ROBUST = (
    "as published: accepted where the left side of the sampling condition is not negative at the grid's points; its "
    "right side cannot be met by any mu (at the tips the left side is 0), so this region is not robustly certified"
)
_FAR_MPS = 1e6
_BOUNDARY_POINTS = 720
_HALF_TURN = 4096
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Bounds:
    """How the vertical acceleration can be bounded at both ends of thrust, by speed; linear between the nodes."""

    v_mps: F64
    """(n,) increasing; beyond them nothing is known."""
    braking_mps2: F64
    """(n,) what it is at most at full thrust: mean + k sigma; below 0 where the vehicle can climb."""
    falling_mps2: F64
    """(n,) what it is at least at least thrust: mean - k sigma."""

    def at(self, v_mps: F64) -> tuple[F64, F64]:
        """Both at any speeds (...,); NaN beyond the nodes."""
        known = (v_mps >= self.v_mps[0]) & (v_mps <= self.v_mps[-1])
        braking, falling = (np.interp(v_mps, self.v_mps, each) for each in (self.braking_mps2, self.falling_mps2))
        return np.where(known, braking, np.nan), np.where(known, falling, np.nan)

    @property
    def slope_ps(self) -> float:
        """Their Lipschitz constant in speed."""
        steps = [np.abs(np.diff(each) / np.diff(self.v_mps)) for each in (self.braking_mps2, self.falling_mps2)]
        return float(np.max(steps))


def constant(braking_mps2: float, falling_mps2: float) -> Bounds:
    """The same at every speed."""
    ends = np.array([-_FAR_MPS, _FAR_MPS])
    return Bounds(ends, np.full(2, braking_mps2), np.full(2, falling_mps2))


def learned(
    acceleration: Callable[[F64, float], tuple[F64, F64]], thrust_mps2: tuple[float, float], k_sigma: float, v_mps: F64
) -> Bounds:
    """From a posterior of the vertical acceleration: mean and sigma (n,) at speeds (n,) and a specific thrust.

    `thrust_mps2`: least and greatest.  Learned as a function of the state alone the acceleration at full thrust is a
    claim that no data back (`physics.state_only`); learned affine in thrust it is not.
    """
    mean_least, sigma_least = acceleration(v_mps, thrust_mps2[0])
    mean_full, sigma_full = acceleration(v_mps, thrust_mps2[1])
    return Bounds(v_mps, mean_full + k_sigma * sigma_full, mean_least - k_sigma * sigma_least)


def of_authority(authority: Authority) -> Bounds:
    """From an axis' authority, which holds between nodes: each node takes the worse of the stretches beside it."""
    middles = 0.5 * (authority.v_mps[:-1] + authority.v_mps[1:])
    reaches = [authority.reach(float(v)) for v in middles]
    braking = np.array([reach.u_low + reach.error_low for reach in reaches])
    falling = np.array([reach.u_high - reach.error_high for reach in reaches])

    def beside(stretches: F64) -> tuple[F64, F64]:
        return np.concatenate([stretches[:1], stretches]), np.concatenate([stretches, stretches[-1:]])

    return Bounds(authority.v_mps, np.maximum(*beside(braking)), np.minimum(*beside(falling)))


def with_mu(region: Region, mu: float) -> Region:
    """The region's ellipsoid with this mu."""
    if not mu > 0.0:
        raise InputError(f"mu = {mu!r} is not allowed; it must be above 0")
    north, east, _ = region.semi_axes_mps
    return replace(region, kind="ellipsoid", semi_axes_mps=(north, east, 1.0 / math.sqrt(mu)))


def on_the_vertical(limit_m: float, mu: float) -> Quadratic:
    """h_mu on the vertical line."""
    return Quadratic(0.0, 0.0, 1.0 / (limit_m * limit_m), 0.0, mu)


def left_side(barrier: Quadratic, gamma_ps: float, bounds: Bounds, e_m: F64, v_mps: F64) -> F64:
    """Left side of the sampling condition at points (...,); minus infinity where nothing is known."""
    de, dv = e_m - barrier.centre_m, v_mps - barrier.centre_mps
    along_e, along_v = barrier.p11 * de + barrier.p12 * dv, barrier.p12 * de + barrier.p22 * dv
    h, h_e, h_v = 1.0 - de * along_e - dv * along_v, -2.0 * along_e, -2.0 * along_v
    braking, falling = bounds.at(v_mps)
    best = np.where(h_v < 0.0, h_v * braking, h_v * falling)
    return np.nan_to_num(h_e * v_mps + best + gamma_ps * h, nan=-np.inf)


def lipschitz(barrier: Quadratic, bounds: Bounds) -> tuple[float, float]:
    """(L_h, L_hdot) over the region: the greatest gradients of h and of its rate at the best thrust.

    For a given acceleration the rate is quadratic, its gradient affine, and the norm of that is greatest on the
    boundary's half on which that end of thrust is the best.  L_h is exact, L_hdot from above to 1e-3 of itself.
    Distance is sqrt(e^2 + v^2), metres and metres per second alike, as the paper's.
    """
    p = np.array([[barrier.p11, barrier.p12], [barrier.p12, barrier.p22]])
    size, axes = np.linalg.eigh(p)
    ball = axes @ np.diag(size**-0.5) @ axes.T  # (e, v) - centre = ball @ u, |u| <= 1
    turn = -2.0 * np.array([[0.0, p[0, 0]], [p[0, 0], 2.0 * p[0, 1]]]) @ ball
    half = np.linspace(0.0, np.pi, _HALF_TURN + 1)
    braking_from = math.atan2(*(axes @ np.diag(size**0.5) @ axes.T)[1, ::-1]) - 0.5 * np.pi  # there h_v <= 0
    rate = 0.0
    for start, ends in ((braking_from, bounds.braking_mps2), (braking_from + np.pi, bounds.falling_mps2)):
        arc = turn @ np.stack([np.cos(start + half), np.sin(start + half)])
        for u in (float(ends.min()), float(ends.max())):
            middle = -2.0 * u * p[1] - 2.0 * barrier.centre_mps * p[0]
            rate = max(rate, float(np.max(np.hypot(*(arc + middle[:, None])))))
    between = float(np.linalg.norm(turn, 2)) * 0.5 * np.pi / _HALF_TURN  # what the arc's points may miss
    return 2.0 * math.sqrt(size[-1]), rate + between + 2.0 * math.sqrt(barrier.p22) * bounds.slope_ps


def right_side(barrier: Quadratic, gamma_ps: float, bounds: Bounds, tau: float) -> float:
    """Right side of the sampling condition."""
    of_h, of_rate = lipschitz(barrier, bounds)
    return (of_rate + gamma_ps * of_h) * tau


class Tip(NamedTuple):
    """Why no mu can be certified: the grid's point nearest to a tip."""

    e_m: float
    v_mps: float
    inside: bool
    """Where it is not, the paper skips it, and nothing covers the tip."""
    left: float
    right: float


def tip(limit_m: float, mu: float, gamma_ps: float, bounds: Bounds, tau: float) -> Tip:
    """The counter-example of the grid through the centre, spacing tau / sqrt(2): left is at most half of right."""
    step = tau / math.sqrt(2.0)
    e = np.array([round(limit_m / step) * step])
    barrier = on_the_vertical(limit_m, mu)
    left = float(left_side(barrier, gamma_ps, bounds, e, np.zeros(1))[0])
    return Tip(float(e[0]), 0.0, bool(e[0] <= limit_m), left, right_side(barrier, gamma_ps, bounds, tau))


def grid(barrier: Quadratic, tau: float) -> tuple[F64, F64]:
    """Points (n,) of the region: squares of side tau / sqrt(2) through the centre, and the boundary."""
    low_e, high_e, low_v, high_v = barrier.box
    step = tau / math.sqrt(2.0)
    e, v = (
        middle + step * np.arange(math.ceil((low - middle) / step), math.floor((high - middle) / step) + 1)
        for low, middle, high in ((low_e, barrier.centre_m, high_e), (low_v, barrier.centre_mps, high_v))
    )
    ee, vv = (each.ravel() for each in np.meshgrid(e, v))
    de, dv = ee - barrier.centre_m, vv - barrier.centre_mps
    inside = barrier.p11 * de * de + 2.0 * barrier.p12 * de * dv + barrier.p22 * dv * dv <= 1.0
    angle = np.linspace(0.0, 2.0 * np.pi, _BOUNDARY_POINTS, endpoint=False)
    half = math.sqrt(barrier.p11 * barrier.p22 - barrier.p12**2)
    edge_v = np.sqrt(barrier.p11) / half * np.sin(angle)
    edge_e = (np.cos(angle) - barrier.p12 / math.sqrt(barrier.p11) * edge_v) / math.sqrt(barrier.p11)
    return (
        np.concatenate([ee[inside], barrier.centre_m + edge_e]),
        np.concatenate([vv[inside], barrier.centre_mps + edge_v]),
    )


def accepted(limit_m: float, mu: float, gamma_ps: float, bounds: Bounds, tau: float) -> bool:
    """Whether the left side is nowhere negative on the grid, and falls at neither tip."""
    braking, falling = bounds.at(np.zeros(1))
    need = 1.0 / limit_m  # left / (2 |v|) at the tips: mu |a| - 1 / limit
    if not (mu * -braking[0] >= need and mu * falling[0] >= need):
        return False
    barrier = on_the_vertical(limit_m, mu)
    return bool(np.all(left_side(barrier, gamma_ps, bounds, *grid(barrier, tau)) >= -_ROUNDING))


def least_mu(
    limit_m: float, gamma_ps: float, bounds: Bounds, tau: float, *, start: float = MU_INITIAL, tolerance: float = 1e-6
) -> float:
    """The search as published: from `start` down while accepted, then halved to `tolerance`; inf: not even `start` is.

    Never below what physics allows for the same bounds (`physics.mu_physics`), by the tips.
    """
    if not accepted(limit_m, start, gamma_ps, bounds, tau):
        return math.inf
    good, bad = start, 0.0
    while good - bad > tolerance:
        trial = max(0.95 * good, 0.5 * (good + bad))
        if accepted(limit_m, trial, gamma_ps, bounds, tau):
            good = trial
        else:
            bad = trial
    return good


@dataclass(frozen=True, slots=True)
class Basis:
    """What a published certificate says of itself beside its region."""

    gamma_ps: float
    k_sigma: float
    delta: float
    authorities: tuple[Authority, Authority, Authority]
    budget: Budget
    knowledge: dict[str, object] = field(default_factory=dict)


def certificate(region: Region, basis: Basis, version: int = 0) -> Certificate:
    """h_mu as a certificate, one quadratic an axis: without margins, and without cells, since nothing covers it."""
    setting, response = Setting(basis.gamma_ps, 0.0, 0.0, 0.0), Response(0.0, 0.0, 0.0)
    axes = tuple(
        AxisCertificate(
            axis,
            Quadratic(0.0, 0.0, region.semi_axes_m[axis] ** -2, 0.0, region.semi_axes_mps[axis] ** -2),
            setting,
            response,
            basis.authorities[axis],
            (),
            np.zeros((0, 6)),
        )
        for axis in range(3)
    )
    knowledge = {"note": NOT_ROBUST, **basis.knowledge}
    mode, centre = "as-published", region.centre_ned_m
    return Certificate(mode, centre, axes, basis.budget, basis.delta, basis.k_sigma, knowledge, version)
