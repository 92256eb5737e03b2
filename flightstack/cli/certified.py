"""The figures of an exploration: how large the certified region became, and how large physics would let it be.

mu speaks of the published family h_mu: 1 / mu = limit * braking.  `mu_final` counts the braking that the certificate
proves, less every margin that is no matter of knowledge; `mu_physics` counts what the truth brakes with, less the same
margins.  So mu_final is above mu_physics exactly where the certificate claims no more than is true.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from flightstack.barrier import viability
from flightstack.barrier.design import slice_area, worst_slice_area
from flightstack.barrier.physics import PhysicalPlant, mu_physics
from flightstack.barrier.published import of_authority
from flightstack.barrier.records import AxisCertificate, Budget, Certificate
from flightstack.barrier.sampling import Claim, ClaimSamples, adaptive, crossed, thinned, uniform
from flightstack.barrier.shapes import Quadratic
from flightstack.cli.flight import Setup
from flightstack.model import Model
from flightstack.types import STANDARD_GRAVITY_MPS2

DOWN = 2
KNOWLEDGE = ("gp_error", "thrust_gain")
"""Margins that learning makes smaller; the others stay however well the vehicle is known."""

_MORE_MU = (1.2, 1.35, 1.5, 2.0)
"""Shares of the least mu, tried in this order."""


@dataclass(frozen=True, slots=True)
class CertifiedFigures:
    """Of the vertical axis."""

    mu_initial: float | None
    mu_final: float | None
    mu_physics: float | None
    area_initial_m2ps: float | None
    area_m2ps: float | None
    """On the slice of zero commanded acceleration."""
    area_worst_m2ps: float | None
    """On the worst slice."""
    area_kernel_m2ps: float | None
    """Of the exact viability kernel with the same margins, cut to the accelerations that the certificate counts on."""
    area_kernel_vehicle_m2ps: float | None
    """Of the same with all the thrust that the vehicle may give in this flight."""
    share_kernel: float | None
    """Of the certified area in the first."""
    share_kernel_vehicle: float | None
    """Of the certified area in the second."""
    samples: int | None
    """That a certificate by the published sampling takes where they are placed adaptively."""
    samples_uniform: int | None
    """On a uniform grid, for the same guarantee."""
    margins: dict[str, float]
    """m/s^2."""

    @staticmethod
    def nothing() -> dict[str, Any]:
        """All of them null."""
        return {part.name: None for part in fields(CertifiedFigures)}

    def as_json(self) -> dict[str, Any]:
        """The JSON's part; what is not finite is null."""
        finite = {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in asdict(self).items()
        }
        return finite


def vertical(certificate: Certificate) -> AxisCertificate | None:
    """Its vertical axis."""
    return next((axis for axis in certificate.axes if axis.axis == DOWN), None)


def counted_mps2(axis: AxisCertificate) -> tuple[float, float]:
    """Accelerations that are certain at every speed of the region, after all margins: least (braking) and greatest."""
    other = sum(margin.mps2 for margin in axis.margins if margin.name not in KNOWLEDGE)
    _, _, slow, fast = axis.barrier.box
    reaches = [axis.authority.reach(float(v)) for v in np.linspace(slow, fast, 49)]
    low = max(reach.u_low + reach.error_low for reach in reaches)
    high = min(reach.u_high - reach.error_high for reach in reaches)
    return low + other, high - other


def vehicle_mps2(
    axis: AxisCertificate, budget: Budget, setup: Setup, counted: tuple[float, float]
) -> tuple[float, float]:
    """The same with all the thrust that the flight allows: what lies beyond the certificate's range counts in full.

    With the certificate's own gain and bounds, which are as good there as at its range's ends.
    """
    flight = setup.flight
    model, gain = flight.stack.model, float(axis.authority.gain.min())
    least, greatest = (n / model.mass_kg for n in model.thrust_range_n(flight.scenario.limits))
    low, high = counted
    return low - gain * max(greatest - budget.high_mps2, 0.0), high + gain * max(budget.low_mps2 - least, 0.0)


def figures_of(adopted: list[Certificate], setup: Setup) -> CertifiedFigures:
    """From the certificates of a flight, the first and the last."""
    region = setup.flight.scenario.region
    first, last = vertical(adopted[0]), vertical(adopted[-1])
    assert region is not None
    limit = region.semi_axes_m[DOWN]
    mu_initial = region.semi_axes_mps[DOWN] ** -2
    if last is None or first is None:
        return CertifiedFigures(**{**CertifiedFigures.nothing(), "mu_initial": mu_initial, "margins": {}})
    published = adopted[-1].mode != "sound"
    low, high = counted_mps2(last)
    other = 0.0 if published else sum(m.mps2 for m in last.margins if m.name not in KNOWLEDGE)
    proven = 1.0 / (limit * -low) if low < 0.0 else math.inf
    mu_final = last.barrier.p22 if published and isinstance(last.barrier, Quadratic) else proven
    reach = last.authority.reach(0.0)
    samples = _samples(last, limit, mu_final)
    area = slice_area(last.barrier, last.response, inner=last.setting.inner)
    kernel = viability.area(-limit, limit, low, high)
    whole = viability.area(-limit, limit, *vehicle_mps2(last, adopted[-1].budget, setup, (low, high)))
    return CertifiedFigures(
        mu_initial=mu_initial,
        mu_final=mu_final,
        mu_physics=mu_physics(plant_of(setup), region, (0.0, 0.0, other), lateral=False),
        area_initial_m2ps=slice_area(first.barrier, first.response, inner=first.setting.inner),
        area_m2ps=area,
        area_worst_m2ps=worst_slice_area(last.barrier, last.response, reach.u_low, reach.u_high, last.setting.inner),
        area_kernel_m2ps=kernel,
        area_kernel_vehicle_m2ps=whole,
        share_kernel=area / kernel,
        share_kernel_vehicle=area / whole,
        samples=samples[0],
        samples_uniform=samples[1],
        margins={margin.name: margin.mps2 for margin in last.margins},
    )


def plant_of(setup: Setup) -> PhysicalPlant:
    """What flies, seen from what is believed."""
    flight, truth = setup.flight, setup.truth
    believed, true = flight.stack.model, Model.from_vehicle(truth)
    force = truth.effects.get("constant_force", {})
    weight = true.mass_kg * STANDARD_GRAVITY_MPS2
    north, east, down = (force.get(f"{name}_n", 0.0) / weight for name in ("north", "east", "down"))
    greatest = believed.thrust_range_n(flight.scenario.limits)[1] / believed.weight_n
    delivered = greatest * true.max_thrust_n / believed.max_thrust_n
    return PhysicalPlant(
        true.mass_kg / believed.mass_kg, (north, east, down), delivered, flight.scenario.limits.tilt_max_rad,
        STANDARD_GRAVITY_MPS2,
    )  # fmt: skip


def strict_claim(axis: AxisCertificate, limit_m: float, mu: float) -> Claim | None:
    """What samples of the published kind can prove under the certificate's bounds; None where too little is known.

    The barrier has a cross term and a fifth more mu than the least, or as much as its speeds are known for; the
    published one takes infinitely many.
    """
    bounds = of_authority(axis.authority)
    shapes = [crossed(limit_m, share * mu, share * mu) for share in _MORE_MU] if math.isfinite(mu) else []
    known = [each for each in shapes if bounds.v_mps[0] <= min(each.box[2:]) and max(each.box[2:]) <= bounds.v_mps[-1]]
    return Claim(known[0], axis.setting.gamma_ps, bounds) if known else None


def placed(claim: Claim) -> ClaimSamples:
    """Samples for a claim, placed where they are needed, and no more of them."""
    return thinned(claim, adaptive(claim, local=True, depth=12))


def _samples(axis: AxisCertificate, limit_m: float, mu: float) -> tuple[int | None, int | None]:
    """How many samples prove the strict claim: placed adaptively, and on a uniform grid."""
    claim = strict_claim(axis, limit_m, mu)
    if claim is None:
        return None, None
    sparse = placed(claim)
    if not sparse.closed:
        return None, None
    grid = uniform(claim)
    return len(sparse.points), len(grid.points) if grid.closed else None
