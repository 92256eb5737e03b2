"""Example 1 of the paper: two safe regions of a polynomial system, as published, repaired and enlarged.

    x1' = x2 + 0.8 x2^2,    x2' = -x1 - x2 + x1^2 x2

The published regions V* <= 1 and h* >= 0 are given to four digits.  With these digits neither is invariant: on a small
part of each boundary the motion points outward, which `exact.leaves_between` proves at one point each.  Both become
strictly invariant when their level is lowered a little (`LOWERED`).  Our own, larger regions come from `sos` with a
rate of at least 1/2000 on the whole boundary.  What is claimed to be invariant has an exact proof (`proofs`), shipped
with the package and checked each time; finding the proofs anew (`find_proofs`) needs the extra `sos`.

Source: L. Wang, E. Theodorou, M. Egerstedt, "Safe Learning of Quadrotor Dynamics Using Barrier Certificates", 2018,
Example 1.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from fractions import Fraction
from importlib import resources

import numpy as np
from scipy.integrate import solve_ivp

from flightstack.types import F64, InputError
from flightstack_paper import sos
from flightstack_paper.exact import (
    ExactPolynomial,
    Proof,
    along,
    as_ellipse,
    check,
    leaves_between,
    proof_from_dict,
    proof_to_dict,
)

FIELD = (ExactPolynomial({(0, 1): 1, (0, 2): "0.8"}), ExactPolynomial({(1, 0): -1, (0, 1): -1, (2, 1): 1}))
V_PUBLISHED = ExactPolynomial({(2, 0): "1.343", (1, 1): "0.5155", (0, 2): "1.152"})
H_PUBLISHED = ExactPolynomial(
    {(0, 0): 1, (1, 0): "-0.4254", (0, 1): "-0.3248", (0, 2): "-0.7549", (2, 0): "-0.8616", (1, 1): "-0.2846"}
)
LOWERED = {"lyapunov": Fraction("5.7e-4"), "barrier": Fraction("4.7e-4")}
"""By how much the level of V* and of h* is lowered to make its region strictly invariant."""
RATE_PS = Fraction(1, 2000)
"""The least hdot that our own regions have on their boundary."""
_LOWERED_RATES = {"lyapunov": Fraction(1, 10**6), "barrier": Fraction(2, 10**8)}
SCHEMA = "flightstack.example1/1"
NAMES = ("lyapunov-lowered", "barrier-lowered", "lyapunov", "barrier")
"""The proofs: the published regions lowered, and our own."""
_POINTS = 200_000
_LEFT = 1e-9
"""h below minus this counts as outside: two orders above the error of the integration."""


@dataclass(frozen=True, slots=True)
class ExampleRegion:
    """One region {h >= 0} with what was measured on its boundary and what is proven."""

    name: str
    h: ExactPolynomial
    area: float
    least_rate: float
    """Least hdot on the boundary, sampled; below 0 where motions leave."""
    least_rate_at: tuple[float, float]
    outward_share: float
    """Part of the boundary, by the ellipse's own angle, on which hdot < 0."""
    proven_rate: Fraction | None
    """hdot is at least this on h = 0, exactly; None where nothing is proven."""
    refuted: bool
    """Proven, exactly, that a motion leaves at some point of the boundary."""
    boundary: F64
    """(n, 2) closed, for a figure."""


@dataclass(frozen=True, slots=True)
class Flow:
    """Motions from points on a region's boundary."""

    starts: int
    left: int
    """Motions that were outside at some time."""
    worst_h: float
    """The least h of all motions at all times."""
    converged: int
    """Motions that ended within 1e-3 of the origin."""


@dataclass(frozen=True, slots=True)
class Example1:
    """All that was measured."""

    published_lyapunov: ExampleRegion
    published_barrier: ExampleRegion
    lowered_lyapunov: ExampleRegion
    lowered_barrier: ExampleRegion
    lyapunov: ExampleRegion
    barrier: ExampleRegion
    flow_lyapunov: Flow
    """From the boundary of the published V*."""
    flow_barrier: Flow
    flow_found: Flow
    """From the boundary of our own ellipse."""
    motions: F64
    """(n, times, 2) some motions from the boundary of our own ellipse, for a figure."""

    @property
    def ratio_published(self) -> float:
        """Area of the published barrier's region over that of the published Lyapunov function's."""
        return self.published_barrier.area / self.published_lyapunov.area

    @property
    def ratio(self) -> float:
        """The same of our own regions."""
        return self.barrier.area / self.lyapunov.area


def evaluate(*, starts: int = 1000, duration_s: float = 60.0) -> Example1:
    """Check the shipped proofs exactly, measure all six regions, and follow motions from three boundaries."""
    known = proofs()
    v_star, h_star = (
        measured("published-lyapunov", -V_PUBLISHED + 1, None), measured("published-barrier", H_PUBLISHED, None)
    )  # fmt: skip
    lower_v, lower_h, lyapunov, barrier = (measured(name, known[name].h, known[name]) for name in NAMES)
    flows = [flow(region.h, starts, duration_s) for region in (v_star, h_star, barrier)]
    shown = motions(boundary(barrier.h, 24), np.linspace(0.0, 20.0, 801))
    return Example1(
        v_star, h_star, lower_v, lower_h, lyapunov, barrier, flows[0], flows[1], flows[2], shown
    )  # fmt: skip


def measured(name: str, h: ExactPolynomial, proof: Proof | None) -> ExampleRegion:
    """A region's area and boundary; InputError if the proof given does not hold."""
    if proof is not None and (faults := check(proof, FIELD)):
        raise InputError(f"{name}: {'; '.join(faults)}")
    points = boundary(h, _POINTS)
    rates = values(along(h, FIELD), points)
    worst = points[rates.argmin()]
    return ExampleRegion(
        name, h, as_ellipse(h).area, float(rates.min()), (float(worst[0]), float(worst[1])),
        float((rates < 0.0).mean()), None if proof is None else proof.rate_ps, _refuted(h, worst), boundary(h, 400),
    )  # fmt: skip


def _refuted(h: ExactPolynomial, point: F64) -> bool:
    """The exact refutation, tried across the boundary at a point near it."""
    slope = np.array([values(h.derivative(state), point[None])[0] for state in (0, 1)])
    step = 1e-7 * slope / np.linalg.norm(slope)
    inside, outside = (tuple(Fraction(float(part)) for part in end) for end in (point + step, point - step))
    return leaves_between(h, FIELD, (inside[0], inside[1]), (outside[0], outside[1]))


def boundary(h: ExactPolynomial, count: int) -> F64:
    """(count, 2) points on h = 0, evenly by the ellipse's own angle; the first is not repeated."""
    shape = as_ellipse(h)
    root = np.linalg.cholesky(float(shape.level) * np.linalg.inv(np.array(shape.p, dtype=float)))
    angle = 2.0 * np.pi * np.arange(count) / count
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(np.array(shape.centre, dtype=float) + (root @ circle).T)


def values(polynomial: ExactPolynomial, points: F64) -> F64:
    """Values at (..., 2) points in floating point."""
    x1, x2 = points[..., 0], points[..., 1]
    total = np.zeros(points.shape[:-1])
    for (i, j), coefficient in polynomial.terms.items():
        total = total + float(coefficient) * x1**i * x2**j
    return total


def flow(h: ExactPolynomial, starts: int, duration_s: float) -> Flow:
    """What becomes of motions from the boundary, looked at each millisecond of the first second, then each 0.1 s."""
    times = np.concatenate([np.arange(0.0, 1.0, 0.001), np.arange(1.0, duration_s + 1e-9, 0.1)])
    followed = motions(boundary(h, starts), times)
    least = values(h, followed).min(axis=1)
    near = np.hypot(*followed[:, -1].T) < 1e-3
    return Flow(starts, int((least < -_LEFT).sum()), float(least.min()), int(near.sum()))


def motions(starts: F64, times_s: F64) -> F64:
    """(n, times, 2) from (n, 2) starts, all integrated at once (Dormand-Prince 8(5,3), relative tolerance 1e-10)."""
    count = len(starts)

    def slope(_: float, flat: F64) -> F64:
        points = flat.reshape(2, count).T
        return np.concatenate([values(part, points) for part in FIELD])

    span = (float(times_s[0]), float(times_s[-1]))
    solved = solve_ivp(slope, span, starts.T.ravel(), "DOP853", t_eval=times_s, rtol=1e-10, atol=1e-13)
    return np.asarray(solved.y.reshape(2, count, -1).transpose(1, 2, 0))


def proofs() -> dict[str, Proof]:
    """The shipped proofs by name (`NAMES`), not yet checked."""
    source = "example1.json"
    text = resources.files(__package__).joinpath(source).read_text(encoding="utf-8")
    return proofs_from_json(text, source)


def find_proofs(*, seed: int = 0) -> dict[str, Proof]:
    """Search all proofs anew (seconds; needs the extra `sos`): the same seed gives the same regions."""
    level = 1 - LOWERED["lyapunov"]
    return {
        "lyapunov-lowered": sos.prove(
            FIELD, -V_PUBLISHED * (1 / level) + 1, _LOWERED_RATES["lyapunov"], falling=True
        ),
        "barrier-lowered": sos.prove(FIELD, H_PUBLISHED - LOWERED["barrier"], _LOWERED_RATES["barrier"]),
        "lyapunov": sos.region_of_attraction(FIELD, RATE_PS, seed=seed).proof,
        "barrier": sos.invariant_ellipse(FIELD, RATE_PS, seed=seed).proof,
    }  # fmt: skip


def proofs_to_json(found: dict[str, Proof]) -> str:
    """Text of the shipped file; write `proofs_to_json(find_proofs())` to make it anew."""
    return json.dumps({"schema": SCHEMA, **{name: proof_to_dict(found[name]) for name in NAMES}}, indent=1) + "\n"


def proofs_from_json(text: str, source: str) -> dict[str, Proof]:
    """The inverse; InputError that names the source."""
    try:
        data = json.loads(text)
    except ValueError as error:
        raise InputError(f"{source}: no JSON: {error}") from None
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise InputError(f"{source}: no {SCHEMA} file")
    missing = [name for name in NAMES if not isinstance(data.get(name), dict)]
    if missing:
        raise InputError(f"{source}: the proof {missing[0]} is missing")
    return {name: proof_from_dict(data[name], f"{source}: {name}") for name in NAMES}
