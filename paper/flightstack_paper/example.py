"""Example 1 of the paper as a part: its six regions and the motions in them (`flightstack.barrier.example1`)."""

from __future__ import annotations

from typing import Any

from flightstack.barrier import example1
from flightstack.barrier.example1 import Flow, Region


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
        "motions": found.motions[:, ::4].round(5).tolist(),
    }


def _region(region: Region) -> dict[str, Any]:
    return {
        "area": region.area,
        "least_rate": region.least_rate,
        "least_rate_at": region.least_rate_at,
        "outward_share": region.outward_share,
        "proven_rate": None if region.proven_rate is None else str(region.proven_rate),
        "refuted": region.refuted,
        "boundary": region.boundary.round(6).tolist(),
    }


def _flow(flow: Flow) -> dict[str, Any]:
    return {"starts": flow.starts, "left": flow.left, "worst_h": flow.worst_h, "converged": flow.converged}
