"""Example 1 of the paper as a part: its six regions and the motions in them (`flightstack_paper.example1`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flightstack.types import InputError
from flightstack_paper import example1, sos
from flightstack_paper.exact import ExactPolynomial
from flightstack_paper.example1 import ExampleRegion, Flow


def measure(starts: int) -> dict[str, Any]:
    """Regions with areas, rates and proofs, motions from `starts` points of each of three boundaries."""
    found = example1.evaluate(starts=starts)
    regions = {
        "published_lyapunov": found.published_lyapunov,
        "published_barrier": found.published_barrier,
        "lowered_lyapunov": found.lowered_lyapunov,
        "lowered_barrier": found.lowered_barrier,
        "lyapunov": found.lyapunov,
        "barrier": found.barrier,
    }
    flows = {"lyapunov": found.flow_lyapunov, "barrier": found.flow_barrier, "found": found.flow_found}
    return {
        "regions": {name: _region(region) for name, region in regions.items()},
        "flows": {name: _flow(flow) for name, flow in flows.items()},
        "ratio_published": found.ratio_published,
        "ratio": found.ratio,
        "solved": {"lyapunov": solved_area("lyapunov"), "barrier": solved_area("barrier")},
        "motions": found.motions[:, ::4].round(5).tolist(),
    }


def solved_area(name: str) -> dict[str, Any]:
    """The largest region that the sum-of-squares programme finds from the dynamics alone, no printed digit in it.

    Returns its `area` (`level_set_area`) and `anew`: solved now, or read from the shipped proof (no extra `sos`).
    """
    try:
        search = sos.region_of_attraction if name == "lyapunov" else sos.invariant_ellipse
        h, anew = search(example1.FIELD, example1.RATE_PS).proof.h, True
    except InputError:
        h, anew = example1.proofs()[name].h, False
    return {"area": level_set_area(h), "anew": anew}


def level_set_area(h: ExactPolynomial) -> float:
    """Area of {h >= 0}, star-shaped round the origin, by where h changes its sign along rays: no ellipse's formula."""
    angles = np.linspace(0.0, 2.0 * math.pi, 2000, endpoint=False)
    inside, outside = np.zeros_like(angles), np.full_like(angles, 10.0)
    for _ in range(60):
        middle = 0.5 * (inside + outside)
        holds = example1.values(h, np.column_stack((middle * np.cos(angles), middle * np.sin(angles)))) >= 0.0
        inside, outside = np.where(holds, middle, inside), np.where(holds, outside, middle)
    return float(0.5 * np.sum(inside * inside) * (angles[1] - angles[0]))


def _region(region: ExampleRegion) -> dict[str, Any]:
    return {
        "area": region.area,
        "level_set_area": level_set_area(region.h),
        "least_rate": region.least_rate,
        "least_rate_at": region.least_rate_at,
        "outward_share": region.outward_share,
        "proven_rate": None if region.proven_rate is None else str(region.proven_rate),
        "refuted": region.refuted,
        "boundary": region.boundary.round(6).tolist(),
    }


def _flow(flow: Flow) -> dict[str, Any]:
    return {"starts": flow.starts, "left": flow.left, "worst_h": flow.worst_h, "converged": flow.converged}
