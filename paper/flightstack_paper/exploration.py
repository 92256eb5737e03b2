"""The paper's second example as parts: Algorithm 1 in flight, as published and sound (`flightstack certify`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flightstack.barrier.initial import require_authority
from flightstack.barrier.physics import mu_physics
from flightstack.barrier.published import on_the_vertical
from flightstack.barrier.records import AxisCertificate
from flightstack.barrier.sampling import Claim, ClaimSamples, adaptive
from flightstack.barrier.shapes import Quadratic
from flightstack.cli.certified import counted_mps2, placed, plant_of, strict_claim, vertical
from flightstack.cli.certified_page import path_of
from flightstack.cli.certify import CertifyResult, certify, prepare_certify
from flightstack.cli.flight import FlyOptions
from flightstack.explore import ExploreConfig
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack_logs.report.certified import kernel_outline
from flightstack_logs.report.phase_plane import boundary
from flightstack_paper.plan import PUBLISHED
from flightstack_paper.work import PartContext, PartFailed

DOWN = 2
_PATH_POINTS = 3000
_DEPTH = 8
_SMALLER = 0.9
"""The region before the last: the latest of at most so much of its area."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Exploration:
    """One exploration; None: as `certify` has it."""

    plant: str
    mode: str
    seed: int
    rounds_max: int | None = None
    duration_s: float | None = None


def explore(asked: Exploration, bench: PartContext) -> dict[str, Any]:
    """What `certify` finds, with the figures' lines; PartFailed where no region came out."""
    options = FlyOptions(
        scenario="paper-barrier", seed=asked.seed, plant=asked.plant, duration_s=asked.duration_s, out=bench.folder,
        as_published=asked.mode == PUBLISHED,
    )  # fmt: skip
    config = None if asked.rounds_max is None else ExploreConfig(axes=(DOWN,), rounds_max=asked.rounds_max)
    result = certify(options, stop_requested=bench.stop_requested, on_progress=bench.on_progress, config=config)
    if not result.flight.completed or result.figures is None or result.state is None:
        raise PartFailed(result.failure() or "nothing was certified")
    return {
        **{name: value for name, value in result.as_json().items() if name not in ("log", "report", "certificate")},
        **_physics(options),
        **lines(result),
        "min_h_truth": result.flight.barrier["min_h_truth"],
        "interventions": result.flight.barrier["interventions"],
        "files": {
            name: str(path)
            for name, path in (
                ("log", result.flight.log), ("report", result.report), ("certificate", result.certificate)
            )
            if path
        },
    }  # fmt: skip


def _physics(options: FlyOptions) -> dict[str, float]:
    """The least mu that the truth allows without any margin, and that all that may be true before take-off allows."""
    setup = prepare_certify(options)
    region = setup.flight.scenario.region
    assert region is not None
    plant, scenario = plant_of(setup), setup.flight.scenario
    assert scenario.knowledge is not None
    left_g = require_authority(scenario.knowledge, setup.flight.stack.model, scenario.limits)
    return {
        "limit_m": region.semi_axes_m[DOWN],
        "mu_knowledge": 1.0 / (region.semi_axes_m[DOWN] * left_g * STANDARD_GRAVITY_MPS2),
        "mu_physics_bare": mu_physics(plant, region, lateral=False),
        "mu_physics_ellipsoid": mu_physics(plant, region),
    }


def lines(result: CertifyResult) -> dict[str, Any]:
    """Regions, path and samples in the plane of e and v, down positive."""
    axes = [axis for each in result.adopted if (axis := vertical(each)) is not None]
    assert result.state is not None
    path = path_of(result)[:, [DOWN, 3 + DOWN]]
    last = axes[-1]
    low, high = counted_mps2(last)
    limit_m = max(abs(bound) for bound in last.barrier.box[:2])
    targets = [row.target for row in result.state.rounds if row.axis == DOWN and row.target is not None]
    return {
        "regions": [_line(boundary(axis.barrier)) for axis in _thinned(axes)],
        "areas_m2ps": [axis.barrier.area_m2ps for axis in axes],
        "path": _line(path[:: max(1, len(path) // _PATH_POINTS)]),
        "targets": [list(target) for target in targets],
        "kernel": _line(kernel_outline(limit_m, low, high)) if low < 0.0 < high else [],
        "braking_mps2": low,
        "falling_mps2": high,
        "sampling": sampling(axes, limit_m),
    }


def _thinned(axes: list[AxisCertificate], most: int = 12) -> list[AxisCertificate]:
    """The first, the last, and evenly what lies between."""
    if len(axes) <= most:
        return axes
    return [axes[round(k)] for k in np.linspace(0, len(axes) - 1, most)]


def sampling(axes: list[AxisCertificate], limit_m: float) -> dict[str, Any] | None:
    """Samples by the paper's proposition under the bounds that were learned, for the last mu; None where none is known.

    `published`: h without cross term, L over the region, down to `_DEPTH` halvings of its box; what is open then stays
    open at any depth.  `strict`: with a cross term and a little more mu, which closes.  The present region is the one
    before the last.
    """
    last = axes[-1]
    mu = proven_mu(last, limit_m)
    claim = strict_claim(last, limit_m, mu)
    if claim is None:
        return None
    before = [axis for axis in axes if axis.barrier.area_m2ps <= _SMALLER * last.barrier.area_m2ps]
    known = Claim(on_the_vertical(limit_m, mu), claim.gamma_ps, claim.bounds)
    found = adaptive(known, depth=_DEPTH)
    return {
        "published": _samples(known, found),
        "strict": _samples(claim, placed(claim)),
        "present": _line(boundary(on_the_vertical(limit_m, proven_mu(before[-1], limit_m)))) if before else [],
        "one_modulus": len(adaptive(claim).points),
    }


def _samples(claim: Claim, found: ClaimSamples) -> dict[str, Any]:
    return {
        "mu": claim.barrier.p22,
        "points": _line(found.points),
        "radius": [round(float(each), 6) for each in found.radius],
        "open": _line(found.open),
        "outline": _line(boundary(claim.barrier)),
        "density": density(claim, found),
    }


def proven_mu(axis: AxisCertificate, limit_m: float) -> float:
    """mu as `certify` counts it: the published form's own, else what the certified braking is worth."""
    if isinstance(axis.barrier, Quadratic) and not axis.margins:
        return axis.barrier.p22
    low, _ = counted_mps2(axis)
    return 1.0 / (limit_m * -low) if low < 0.0 else float("inf")


def density(claim: Claim, found: ClaimSamples) -> dict[str, float]:
    """Samples for each m^2/s: near the boundary (h < 0.3), about the centre (h > 0.7), at speeds down and up.

    Each as its own area has them, by counting a fine grid of the region.
    """
    low_e, high_e, low_v, high_v = claim.barrier.box
    e, v = np.meshgrid(np.linspace(low_e, high_e, 801), np.linspace(low_v, high_v, 801))
    cell = (high_e - low_e) * (high_v - low_v) / e.size
    fine, points = np.stack([e.ravel(), v.ravel()], axis=1), found.points

    def per_area(where: Any) -> float:
        inside = float(np.sum(where(fine) & (_h(claim.barrier, fine) >= 0.0))) * cell
        return float(np.sum(where(points))) / inside

    return {
        "boundary": per_area(lambda x: _h(claim.barrier, x) < 0.3),
        "centre": per_area(lambda x: _h(claim.barrier, x) > 0.7),
        "down": per_area(lambda x: x[:, 1] > 0.0),
        "up": per_area(lambda x: x[:, 1] < 0.0),
    }


def _h(barrier: Quadratic, points: F64) -> F64:
    de, dv = points[:, 0] - barrier.centre_m, points[:, 1] - barrier.centre_mps
    return np.asarray(1.0 - barrier.p11 * de * de - 2.0 * barrier.p12 * de * dv - barrier.p22 * dv * dv)


def _line(points: F64) -> list[list[float]]:
    return [[round(float(each), 5) for each in row] for row in points]
