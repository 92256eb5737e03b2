"""How many samples a certificate takes: the paper's adaptive sampling against a uniform grid, for the same guarantee.

The proposition of section III.A: where the left side phi of the sampling condition is at least L r at a sample, the
condition holds within r of it; L = L_hdot + gamma L_h.  So samples may lie far apart where much margin is left, and
must be dense only where little is.  Here the samples are the centres of square cells, r half a diagonal; a centre
outside the region is replaced by the region's nearest point, which is no farther from any state of the cell that
counts, since a projection on a convex set brings nothing further apart.  Hence the whole region is covered, its
boundary too, and constants over the region suffice.

    uniform    all cells alike, as large as the condition allows; L over the region
    adaptive   a cell that fails is cut in four; L over the region
    local      the same with what phi can lose in each cell's own ball instead of L r
    thinned    each local sample with the largest ball that it proves; of these the fewest that a greedy choice finds to
               hold every cell, the cells cut in four once more

All of it is in closed form: for a given acceleration phi is quadratic, so within r it loses at most |gradient| r +
|Hessian| r^2 / 2, and L is the greatest gradient over the region.  For the published h_mu no covering ends: phi is 0 at
the tips.  Samples are dense where phi is small: near the boundary, and there more for a descent, which only the thrust
beyond weight can brake, than for a climb, which gravity does.

Source: L. Wang, E. Theodorou, M. Egerstedt, "Safe Learning of Quadrotor Dynamics Using Barrier Certificates", 2018,
lemma III.1 and the proposition after it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flightstack.barrier.published import Bounds, left_side, lipschitz
from flightstack.barrier.shapes import Quadratic
from flightstack.types import F64, InputError

_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
_PROJECTION_STEPS = 64
_MOST_CELLS = 2_000_000


@dataclass(frozen=True, slots=True)
class Claim:
    """What is to be proven by samples: that h can be kept, everywhere in its region."""

    barrier: Quadratic
    gamma_ps: float
    bounds: Bounds

    def __post_init__(self) -> None:
        _, _, slowest, fastest = self.barrier.box
        if not self.bounds.v_mps[0] <= slowest <= fastest <= self.bounds.v_mps[-1]:
            raise InputError(f"claim: speeds {slowest:.3g} to {fastest:.3g} m/s go beyond what the bounds know")

    @property
    def modulus(self) -> float:
        """L = L_hdot + gamma L_h over the region."""
        of_h, of_rate = lipschitz(self.barrier, self.bounds)
        return of_rate + self.gamma_ps * of_h

    def left(self, points: F64) -> F64:
        """phi (n,) at points (n, 2)."""
        return left_side(self.barrier, self.gamma_ps, self.bounds, points[:, 0], points[:, 1])


@dataclass(frozen=True, slots=True, eq=False)
class ClaimSamples:
    """Samples that carry a claim, and what they could not reach."""

    points: F64
    """(n, 2) e, v."""
    radius: F64
    """(n,) the condition holds within this distance of each."""
    left: F64
    """(n,) phi there."""
    evaluated: int
    """Times that phi was computed, samples that did not suffice included."""
    open: F64
    """(m, 2) middles of the cells left uncertified; none: the claim is proven."""
    centres: F64
    """(n, 2) middles of the samples' cells: a sample is the region's nearest point to one."""

    @property
    def closed(self) -> bool:
        """Whether the whole region is covered."""
        return len(self.open) == 0


def crossed(limit_m: float, mu: float, cross: float) -> Quadratic:
    """h = 1 - P11 e^2 - 2 c e v - mu v^2 with |e| <= limit, P11 = 1 / limit^2 + c^2 / mu: strict for c well chosen."""
    return Quadratic(0.0, 0.0, 1.0 / (limit_m * limit_m) + cross * cross / mu, cross, mu)


def adaptive(claim: Claim, *, depth: int = 20, local: bool = False) -> ClaimSamples:
    """Cells from the region's box down to `depth` halvings of it."""
    low_e, high_e, low_v, high_v = claim.barrier.box
    half = 0.5 * max(high_e - low_e, high_v - low_v)
    centres = np.array([[0.5 * (low_e + high_e), 0.5 * (low_v + high_v)]])
    points: list[F64] = []
    radii: list[F64] = []
    lefts: list[F64] = []
    middles: list[F64] = []
    evaluated = 0
    for level in range(depth + 1):
        centres, samples = _touching(claim.barrier, centres, half)
        radius = half * math.sqrt(2.0)
        left = claim.left(samples)
        enough = (local_margin(claim, samples, radius) if local else left - claim.modulus * radius) >= 0.0
        evaluated += len(samples)
        points.append(samples[enough])
        radii.append(np.full(int(enough.sum()), radius))
        lefts.append(left[enough])
        middles.append(centres[enough])
        centres = centres[~enough]
        if len(centres) == 0 or level == depth or 4 * len(centres) > _MOST_CELLS:
            break
        half *= 0.5
        centres = (centres[:, None, :] + half * _CORNERS).reshape(-1, 2)
    places, reach, phi, cells = (np.concatenate(each) for each in (points, radii, lefts, middles))
    return ClaimSamples(places, reach, phi, evaluated, centres, cells)


def thinned(claim: Claim, samples: ClaimSamples) -> ClaimSamples:
    """Fewer of these samples that carry the same claim; as they are where they don't carry it."""
    if not samples.closed:
        return samples
    reach = _farthest(claim, samples)
    half = samples.radius / math.sqrt(2.0)
    cells = (samples.centres[:, None, :] + 0.5 * half[:, None, None] * _CORNERS).reshape(-1, 2)
    corners = cells[:, None, :] + 0.5 * np.repeat(half, 4)[:, None, None] * _CORNERS
    held = np.zeros((len(reach), len(cells)), dtype=bool)
    for i, radius in enumerate(reach):  # a ball about the sample, or of the same size about what it is nearest to
        for middle in (samples.points[i], samples.centres[i]):
            held[i] |= np.hypot(*np.moveaxis(corners - middle, 2, 0)).max(axis=1) <= radius
    left, chosen = np.ones(len(cells), dtype=bool), list[int]()
    while left.any():
        best = int(np.argmax(held @ left))
        chosen.append(best)
        left &= ~held[best]
    return ClaimSamples(
        samples.points[chosen], reach[chosen], samples.left[chosen], samples.evaluated, samples.open,
        samples.centres[chosen],
    )  # fmt: skip


def _farthest(claim: Claim, samples: ClaimSamples) -> F64:
    """(n,) the radius that each sample proves: its cell's at least, found by halving."""
    low, high = samples.radius.copy(), 16.0 * samples.radius
    for _ in range(30):
        middle = 0.5 * (low + high)
        holds = local_margin(claim, samples.points, middle) >= 0.0
        low, high = np.where(holds, middle, low), np.where(holds, high, middle)
    return low


def uniform(claim: Claim, *, local: bool = False, twofold: bool = False, finest: int = 1024) -> ClaimSamples:
    """The coarsest grid that proves the claim; at most `finest` cells along the box's longer side.

    `twofold`: as the lemma words it, with tau on the right although every state lies within tau / 2 of a sample.
    """
    closes, fails = 1, 0
    found = _grid(claim, closes, local, twofold)
    while not found.closed and closes < finest:
        closes, fails = min(2 * closes, finest), closes
        found = _grid(claim, closes, local, twofold)
    while found.closed and closes - fails > 1:
        trial = (closes + fails) // 2
        coarser = _grid(claim, trial, local, twofold)
        if coarser.closed:
            closes, found = trial, coarser
        else:
            fails = trial
    return found


def local_margin(claim: Claim, points: F64, radius: F64 | float) -> F64:
    """phi less what it may lose within `radius` of points (n, 2), (n,): the best of both ends of thrust.

    One end is used in the whole ball, so its phi is smooth there; bounds that change with speed are charged besides.
    """
    b, gamma, slope = claim.barrier, claim.gamma_ps, claim.bounds.slope_ps
    e, v = points[:, 0] - b.centre_m, points[:, 1] - b.centre_mps
    along_e, along_v = b.p11 * e + b.p12 * v, b.p12 * e + b.p22 * v
    h, rate = 1.0 - e * along_e - v * along_v, points[:, 1]
    p = np.array([[b.p11, b.p12], [b.p12, b.p22]])
    bend = np.array([[0.0, b.p11], [b.p11, 2.0 * b.p12]])
    norm = 2.0 * float(np.linalg.norm(bend + gamma * p, 2))
    steep = 2.0 * math.hypot(b.p12, b.p22)  # of h_v
    best = np.full(len(points), -np.inf)
    for u in claim.bounds.at(points[:, 1]):
        phi = -2.0 * (along_e * rate + along_v * u) + gamma * h
        by_e = -2.0 * (b.p11 * rate + b.p12 * u + gamma * along_e)
        by_v = -2.0 * (along_e + b.p12 * rate + b.p22 * u + gamma * along_v)
        moving = slope * (2.0 * np.abs(along_v) + steep * radius)
        loss = (np.hypot(by_e, by_v) + 0.5 * norm * radius + moving) * radius
        best = np.fmax(best, phi - loss)
    return best


def project(barrier: Quadratic, points: F64) -> F64:
    """The region's points (n, 2) nearest to `points` (n, 2); those inside stay.

    The nearest point is (I + s P)^-1 y with the s >= 0 that puts it on the boundary, found by halving; what comes out
    lies inside.
    """
    middle = np.array([barrier.centre_m, barrier.centre_mps])
    size, axes = np.linalg.eigh(np.array([[barrier.p11, barrier.p12], [barrier.p12, barrier.p22]]))
    y = (points - middle) @ axes
    outside = np.sum(size * y * y, axis=1) > 1.0
    out = y[outside]
    low = np.zeros(len(out))
    high = np.sqrt(np.sum(out * out, axis=1) / size[0])  # s P y_p = y - y_p, |P y_p| >= sqrt(least eigenvalue)
    for _ in range(_PROJECTION_STEPS):
        s = 0.5 * (low + high)
        still = np.sum(size * np.square(out / (1.0 + s[:, None] * size)), axis=1) > 1.0
        low, high = np.where(still, s, low), np.where(still, high, s)
    found = points.copy()
    found[outside] = (out / (1.0 + high[:, None] * size)) @ axes.T + middle
    return found


def _touching(barrier: Quadratic, centres: F64, half: float) -> tuple[F64, F64]:
    """Centres of the square cells that may touch the region, and their samples."""
    radius = half * math.sqrt(2.0) * (1.0 + 1e-9)
    e, v = centres[:, 0] - barrier.centre_m, centres[:, 1] - barrier.centre_mps
    along_e, along_v = barrier.p11 * e + barrier.p12 * v, barrier.p12 * e + barrier.p22 * v
    # h is concave: within the radius it is at most this, so what is dropped here needs no projection.
    centres = centres[1.0 - e * along_e - v * along_v + 2.0 * radius * np.hypot(along_e, along_v) >= 0.0]
    samples = project(barrier, centres)
    touches = np.hypot(*(samples - centres).T) <= radius
    return centres[touches], samples[touches]


def _grid(claim: Claim, count: int, local: bool, twofold: bool) -> ClaimSamples:
    """A grid of `count` cells along the longer side of the box."""
    low_e, high_e, low_v, high_v = claim.barrier.box
    half = 0.5 * max(high_e - low_e, high_v - low_v) / count
    radius = half * math.sqrt(2.0)
    lines = [
        0.5 * (low + high) + half * (2.0 * np.arange(cells) - cells + 1.0)
        for low, high in ((low_e, high_e), (low_v, high_v))
        for cells in (math.ceil((high - low) / (2.0 * half) - 1e-9),)
    ]
    centres = np.stack([each.ravel() for each in np.meshgrid(*lines)], axis=1)
    centres, samples = _touching(claim.barrier, centres, half)
    left = claim.left(samples)
    reach = 2.0 * radius if twofold else radius
    margin = local_margin(claim, samples, reach) if local else left - claim.modulus * reach
    enough = margin >= 0.0
    radii = np.full(int(enough.sum()), radius)
    return ClaimSamples(samples[enough], radii, left[enough], len(samples), centres[~enough], centres[enough])
