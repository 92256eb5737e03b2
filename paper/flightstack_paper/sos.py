"""Sum-of-squares programmes for polynomial systems of two states: the largest ellipse that nothing leaves, with proof.

    h = h0 + g^T x - x^T P x,    hdot - lambda h - t = z^T Q z,    Q >= 0

gives hdot >= t on h = 0 (`exact`).  The area of {h >= 0} is pi h_max / sqrt(det P): the logarithm of det P is
minimised, not the trace of P.  The identity is bilinear in (h, lambda), so it is solved as a sequence of semidefinite
programmes, each from the last ellipse and its multiplier:

    1. both free, the product linearised about them, within a trust region: gives lambda
    2. h free, lambda fixed: the identity is linear, the new ellipse meets it exactly

log det P is replaced by its tangent tr(P0^-1 P), which lies above it, and h by its value at the last centre, which
lies below h_max: the area never falls.  Several starts, each a small ellipse of the linearised system, guard against
local optima; they cannot exclude one.

The states should be scaled so that the region is of the order of one.  Needs the extra `sos` (CVXPY with Clarabel).

Source: A. Papachristodoulou, S. Prajna, "On the construction of Lyapunov functions using the sum of squares
decomposition", IEEE Conference on Decision and Control 2002; H. Peyrl, P. Parrilo, Theoretical Computer Science 409
(2008), for the way from floating-point to rational Gram matrices.
"""

from __future__ import annotations

import importlib
import math
import warnings
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from flightstack.types import F64, InputError
from flightstack_paper.exact import (
    ExactPolynomial,
    Exponents,
    Field,
    Matrix,
    Proof,
    along,
    as_ellipse,
    check,
    ellipse,
    gram_form,
    identity_gap,
    monomials,
)

_QUADRATIC = monomials(2)
"""1, x1, x2, x1^2, x1 x2, x2^2: the coefficients of h in this order."""
_RESERVE = 1.1
"""The search asks for this much more rate than the proof: room for an inner Gram matrix and for rounding."""
_MOST_STEPS = 150
_STALL = 1e-9
"""Relative gain of area below which a search ends."""
_START = 0.3
"""Longest semi-axis of the ellipses that searches start from."""
_ENDLESS = 1e4
"""Area beyond which there is no largest region, with states of the order of one."""
_DIGITS = 5
"""Decimals of a found ellipse's P and centre."""
_SOLVER = {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}


@dataclass(frozen=True, slots=True)
class EllipseFound:
    """An ellipse found, its proof and how it was found."""

    proof: Proof
    area: float
    areas: tuple[float, ...]
    """What each start reached."""


def _cvxpy() -> Any:
    try:
        importlib.import_module("clarabel")
        return importlib.import_module("cvxpy")
    except ImportError as error:
        raise InputError(
            f'sum-of-squares programmes need CVXPY with Clarabel ({error}); install "flightstack[sos]"'
        ) from None


def region_of_attraction(field: Field, rate_ps: Fraction, *, starts: int = 4, seed: int = 0) -> EllipseFound:
    """The largest {V <= 1} of a quadratic form V that falls by at least rate V in all of it, and so by rate at V = 1.

    InputError where the origin is no stable equilibrium or no start leads to a region with proof.
    """
    return _largest(field, rate_ps, centred=True, starts=starts, seed=seed)


def invariant_ellipse(field: Field, rate_ps: Fraction, *, starts: int = 6, seed: int = 0) -> EllipseFound:
    """The largest ellipse of any centre with hdot >= rate on its boundary, h = 1 at its centre; grown from the origin.

    InputError as `region_of_attraction`.
    """
    return _largest(field, rate_ps, centred=False, starts=starts, seed=seed)


def prove(field: Field, h: ExactPolynomial, rate_ps: Fraction, *, falling: bool = False) -> Proof:
    """An exact proof of hdot >= rate on h = 0, with `falling` also that 1 - h falls inside; else InputError.

    `falling` needs h = 1 - V, V a form about the origin.
    """
    as_ellipse(h)
    programme = _Programme(field, float(rate_ps), centred=falling)
    solved = programme.deepest(_vector(h, _QUADRATIC))
    if solved is not None:
        for digits in range(8, 17):
            proof = _rational(field, h, rate_ps, solved, programme.maps, digits)
            if not check(proof, field):
                return proof
    raise InputError(f"no sum of squares found that proves a rate of {float(rate_ps):.3g} 1/s for {h}")


@dataclass(frozen=True, slots=True)
class _Solved:
    multiplier: F64
    gram: F64
    falling: F64 | None


class _Maps:
    """The identity's coefficients, on all monomials of `rows`, as linear maps of h, lambda and Q."""

    def __init__(self, field: Field, *, centred: bool) -> None:
        half = max(2, math.ceil((1 + max(part.degree for part in field)) / 2))
        self.basis = monomials(half, 1 if centred else 0)
        self.inner = monomials(half - 1, 1)
        self.multipliers = monomials(2 * half - 2)
        self.rows = monomials(2 * half)
        self.rates = np.array(
            [_vector(along(ExactPolynomial({powers: 1}), field), self.rows) for powers in _QUADRATIC]
        ).T
        self.products = np.array(
            [[[float(_sum(a, b) == row) for b in self.multipliers] for a in _QUADRATIC] for row in self.rows]
        )
        self.squares = _sums(self.basis, self.rows)
        self.inner_squares = _sums(self.inner, self.multipliers)


class _Programme:
    """The programmes of one system: built once, solved with new parameters each time."""

    def __init__(self, field: Field, rate_ps: float, *, centred: bool) -> None:
        self.cp = cp = _cvxpy()
        self.maps = maps = _Maps(field, centred=centred)
        self.centred, self.rate_ps = centred, rate_ps
        self.h, self.multiplier = cp.Variable(len(_QUADRATIC)), cp.Variable(len(maps.multipliers))
        self.gram = cp.Variable((len(maps.basis),) * 2, PSD=True)
        self.fallen = cp.Variable((len(maps.inner),) * 2, PSD=True)
        self.slack = cp.Variable()
        self.with_h = cp.Parameter((len(maps.rows), len(maps.multipliers)))
        self.with_multiplier = cp.Parameter((len(maps.rows), len(_QUADRATIC)))
        self.both, self.h_rate = cp.Parameter(len(maps.rows)), cp.Parameter(len(maps.rows))
        self.tangent, self.at_centre = cp.Parameter(3), cp.Parameter(len(_QUADRATIC))
        self.near, self.trust = cp.Parameter(len(_QUADRATIC)), cp.Parameter(nonneg=True)
        self.both_free, self.multiplier_fixed, self.h_fixed = self._searches(), self._exact_step(), self._deepest()

    def _identity(self, left: Any, slack: Any = 0.0) -> Any:
        """left - t = z^T (Q + slack I) z."""
        vec = self.cp.vec(self.gram, order="C")
        inner = self.maps.squares @ np.eye(len(self.maps.basis)).ravel()
        return left - self.rate_ps * _first(len(self.maps.rows)) == self.maps.squares @ vec + slack * inner

    def _falls(self, slack: Any = 0.0) -> list[Any]:
        """lambda + t = m^T (S + slack I) m, where that is asked for."""
        if not self.centred:
            return []
        inner = self.maps.inner_squares @ np.eye(len(self.maps.inner)).ravel()
        form = self.maps.inner_squares @ self.cp.vec(self.fallen, order="C") + slack * inner
        return [self.multiplier + self.rate_ps * _first(len(self.maps.multipliers)) == form]

    def _shape(self) -> list[Any]:
        cp, h = self.cp, self.h
        square_e, cross, square_v = h[3:]
        shape = [self.at_centre @ h == 1.0, cp.bmat([[-square_e, -cross / 2], [-cross / 2, -square_v]]) >> 0]
        return [*shape, h[1:3] == 0.0] if self.centred else shape

    def _searches(self) -> Any:
        product = self.with_h @ self.multiplier + self.with_multiplier @ self.h - self.both
        within = self.cp.abs(self.h - self.near) <= self.trust
        constraints = [self._identity(self.maps.rates @ self.h - product), within, *self._shape(), *self._falls()]
        return self.cp.Problem(self.cp.Minimize(self.tangent @ self.h[3:]), constraints)

    def _exact_step(self) -> Any:
        identity = self._identity(self.maps.rates @ self.h - self.with_multiplier @ self.h)
        return self.cp.Problem(self.cp.Minimize(self.tangent @ self.h[3:]), [identity, *self._shape()])

    def _deepest(self) -> Any:
        identity = self._identity(self.h_rate - self.with_h @ self.multiplier, self.slack)
        return self.cp.Problem(self.cp.Maximize(self.slack), [identity, *self._falls(self.slack), self.slack <= 1.0])

    def _solve(self, problem: Any) -> bool:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # an inaccurate end is seen by the status
                problem.solve(solver="CLARABEL", **_SOLVER)
        except self.cp.SolverError:
            return False
        return problem.status in ("optimal", "optimal_inaccurate")

    def deepest(self, h: F64) -> _Solved | None:
        """Multiplier and Gram matrix of greatest least eigenvalue for a given h; None if there is none at all."""
        self.with_h.value, self.h_rate.value = self.maps.products.transpose(0, 2, 1) @ h, self.maps.rates @ h
        if not self._solve(self.h_fixed) or self.slack.value <= 0.0:
            return None
        shift = float(self.slack.value)
        gram = self.gram.value + shift * np.eye(len(self.maps.basis))
        falling = self.fallen.value + shift * np.eye(len(self.maps.inner)) if self.centred else None
        return _Solved(self.multiplier.value, gram, falling)

    def improve(self, h: F64, multiplier: F64, trust: float) -> tuple[F64, F64] | None:
        """One step from (h, lambda): the next pair, h scaled to 1 at its centre; None where the step finds nothing."""
        p, centre, _ = _shape_of(h)
        inverse = np.linalg.inv(p)
        self.tangent.value = -np.array([inverse[0, 0], inverse[0, 1], inverse[1, 1]])
        self.at_centre.value = np.array([centre[0] ** i * centre[1] ** j for i, j in _QUADRATIC])
        self.with_h.value = self.maps.products.transpose(0, 2, 1) @ h
        self.with_multiplier.value = self.maps.products @ multiplier
        self.both.value = self.with_multiplier.value @ h
        self.near.value, self.trust.value = h, trust * float(np.abs(h).max())
        if not self._solve(self.both_free):
            return None
        multiplier = np.asarray(self.multiplier.value)
        self.with_multiplier.value = self.maps.products @ multiplier
        if not self._solve(self.multiplier_fixed):
            return None
        found = np.asarray(self.h.value)
        p, _, level = _shape_of(found)
        return (found / level, multiplier) if np.linalg.eigvalsh(p)[0] > 0.0 and level > 0.0 else None


def _largest(field: Field, rate_ps: Fraction, *, centred: bool, starts: int, seed: int) -> EllipseFound:
    programme = _Programme(field, _RESERVE * float(rate_ps), centred=centred)
    ends = [_grown(programme, start) for start in _starts(field, starts, seed)]
    grown = [h for h in ends if h is not None]
    if not grown:
        raise InputError(f"no start led to a region with a rate of {float(rate_ps):.3g} 1/s")
    best = max(grown, key=_area)
    proof = prove(field, _rounded(best, centred=centred), rate_ps, falling=centred)
    return EllipseFound(proof, as_ellipse(proof.h).area, tuple(_area(h) for h in grown))


def _grown(programme: _Programme, h: F64) -> F64 | None:
    """The ellipse that the steps end at; None where the start itself has no proof."""
    solved = programme.deepest(h)
    if solved is None:
        return None
    multiplier, trust = solved.multiplier, 0.3
    for _ in range(_MOST_STEPS):
        step = programme.improve(h, multiplier, trust)
        gain = -1.0 if step is None else _area(step[0]) / _area(h) - 1.0
        if step is not None and gain > 0.0:
            h, multiplier = step
            trust = min(2.0 * trust, 1.0)
        else:
            trust *= 0.25
        if _area(h) > _ENDLESS:
            raise InputError("the region grows without end: there is no largest one")
        if 0.0 < gain < _STALL or trust < 1e-7:
            break
    return h


def _starts(field: Field, count: int, seed: int) -> list[F64]:
    """Small ellipses about the origin that the linearised system stays in, each for another random weight."""
    jacobian = np.array([[float(part[powers]) for powers in ((1, 0), (0, 1))] for part in field])
    if any(part[0, 0] for part in field) or np.linalg.eigvals(jacobian).real.max() >= 0.0:
        raise InputError("the origin is no equilibrium with a stable linearisation: there is no region to grow from")
    rng = np.random.default_rng(seed)
    starts = []
    for _ in range(count):
        root = rng.standard_normal((2, 2))
        p = solve_continuous_lyapunov(jacobian.T, -(root @ root.T + 0.3 * np.eye(2)))
        p *= 1.0 / (_START * _START * np.linalg.eigvalsh(p)[0])
        starts.append(np.array([1.0, 0.0, 0.0, -p[0, 0], -2.0 * p[0, 1], -p[1, 1]]))
    return starts


def _rational(field: Field, h: ExactPolynomial, rate_ps: Fraction, solved: _Solved, maps: _Maps, digits: int) -> Proof:
    """Everything rounded to decimals, what the identity then lacks spread over the Gram entries of each monomial."""
    multiplier = ExactPolynomial(dict(zip(maps.multipliers, _decimals(solved.multiplier, digits), strict=True)))
    falling = None
    if solved.falling is not None:
        falling = _symmetric(solved.falling, digits)
        multiplier = gram_form(maps.inner, falling) - rate_ps
    rounded = Proof(h, rate_ps, multiplier, maps.basis, _symmetric(solved.gram, digits), falling)
    gap = identity_gap(rounded, field)
    places: dict[Exponents, int] = {}
    for a in maps.basis:
        for b in maps.basis:
            places[_sum(a, b)] = places.get(_sum(a, b), 0) + 1
    gram = tuple(
        tuple(
            value + gap[_sum(a, b)] / places[_sum(a, b)] for b, value in zip(maps.basis, row, strict=True)
        ) for a, row in zip(maps.basis, rounded.gram, strict=True)
    )  # fmt: skip
    return replace(rounded, gram=gram)


def _decimals(values: F64, digits: int) -> list[Fraction]:
    return [Fraction(round(Fraction(float(value)) * 10**digits), 10**digits) for value in values]


def _symmetric(matrix: F64, digits: int) -> Matrix:
    return tuple(tuple(_decimals(row, digits)) for row in 0.5 * (matrix + matrix.T))


def _rounded(h: F64, *, centred: bool) -> ExactPolynomial:
    """The ellipse with five decimals of P and its centre: short enough to be printed whole."""
    p, centre, level = _shape_of(h)
    p11, p12, p22 = _decimals(np.array([p[0, 0], p[0, 1], p[1, 1]]) / level, _DIGITS)
    c1, c2 = (Fraction(0), Fraction(0)) if centred else _decimals(centre, _DIGITS)
    return ellipse(p11, p12, p22, c1, c2)


def _shape_of(h: F64) -> tuple[F64, F64, float]:
    """P, centre and greatest value of h = h0 + g^T x - x^T P x."""
    square_e, cross, square_v = h[3:]
    p = np.array([[-square_e, -0.5 * cross], [-0.5 * cross, -square_v]])
    centre = 0.5 * np.linalg.pinv(p) @ h[1:3]
    return p, centre, float(h[0] + 0.5 * h[1:3] @ centre)


def _area(h: F64) -> float:
    p, _, level = _shape_of(h)
    return float(math.pi * level / math.sqrt(max(np.linalg.det(p), 1e-300)))


def _vector(polynomial: ExactPolynomial, powers: tuple[Exponents, ...]) -> F64:
    return np.array([float(polynomial[power]) for power in powers])


def _first(size: int) -> F64:
    return np.asarray(np.eye(size)[0])


def _sum(a: Exponents, b: Exponents) -> Exponents:
    return a[0] + b[0], a[1] + b[1]


def _sums(basis: tuple[Exponents, ...], rows: tuple[Exponents, ...]) -> F64:
    """(rows, len(basis)^2): the coefficients of z^T Q z from Q row by row."""
    return np.array([[float(_sum(a, b) == row) for a in basis for b in basis] for row in rows])
