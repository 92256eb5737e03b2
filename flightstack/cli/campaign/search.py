"""`[search]`: instead of drawing, look for the worst flight over the same ranges, and an adversary beside them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from flightstack.cli.campaign.adversary import Adversary
from flightstack.cli.campaign.design import at_shares
from flightstack.cli.campaign.optimisers import make
from flightstack.cli.campaign.plan import Plan
from flightstack.cli.campaign.result import replay_name
from flightstack.cli.campaign.searching import Search
from flightstack.cli.campaign.statistics import metric
from flightstack.errors import InputError
from flightstack.types import F64

if TYPE_CHECKING:
    from flightstack.cli.campaign.run import Campaign


def search(work: Campaign) -> tuple[dict[str, Any], Callable[[int], Plan]]:
    """Fly generation after generation; (what was found, flight -> its plan)."""
    spec = work.spec
    wanted = spec.search
    assert wanted is not None
    adversary = Adversary(work.planner) if wanted.adversary else None
    dimensions = len(spec.factors) + (adversary.dimensions if adversary else 0)
    if dimensions == 0:
        raise InputError(f"{spec.path}: search has nothing to move: vary something, or adversary = true")
    method = make(wanted, dimensions, spec.design_seed)
    plans: list[Plan] = []
    best: tuple[float, int] | None = None
    first: int | None = None
    while not method.finished and not work.stopped:
        points = method.ask()
        if len(plans) + len(points) > spec.count:
            break
        batch = [_plan(work, adversary, len(plans) + k, point) for k, point in enumerate(points)]
        plans += batch
        work.fly(batch)
        if work.stopped:
            break
        margins = _margins(work.journal.entries, batch, wanted)
        method.tell(margins)
        k = int(np.argmin(margins))
        if best is None or margins[k] < best[0]:
            best = float(margins[k]), batch[k].flight
        limit = -wanted.below if wanted.maximise else wanted.below
        if first is None and bool(np.any(margins < limit)):
            first = batch[int(np.argmax(margins < limit))].flight
            if wanted.stop:
                break
    flown = sum(plan.flight in work.journal.entries for plan in plans)
    return _found(wanted, flown, best, first, method.summary()), plans.__getitem__


def _plan(work: Campaign, adversary: Adversary | None, flight: int, point: F64) -> Plan:
    spec = work.spec
    shares = np.minimum(point, np.nextafter(1.0, 0.0)).tolist()
    values = at_shares(spec.factors, shares[: len(spec.factors)])
    values |= {factor.name: factor.values[0] for factor in spec.fixed}
    plan = work.planner.plan(flight, values, spec.seed_of(flight))
    return plan if adversary is None else adversary.against(plan, shares[len(spec.factors) :])


def _margins(entries: Mapping[int, Mapping[str, Any]], batch: list[Plan], wanted: Search) -> F64:
    values = [metric(entries[plan.flight], wanted.target) for plan in batch]
    sign = -1.0 if wanted.maximise else 1.0
    return np.array([math.inf if value is None else sign * value for value in values])


def _found(
    wanted: Search, flown: int, best: tuple[float, int] | None, first: int | None, own: dict[str, Any]
) -> dict[str, Any]:
    sign = -1.0 if wanted.maximise else 1.0
    known = best is not None and math.isfinite(best[0])
    return {
        "method": wanted.method,
        "target": wanted.target,
        "flights": flown,
        "found": first is not None,
        "first_failure": first,
        "worst": sign * best[0] if best is not None and known else None,
        "flight": best[1] if best is not None and known else None,
        "replay": replay_name(best[1]) if best is not None and known else None,
        **own,
    }
