"""What else is missing beside the names that a poor model has kept: looked for once others have been taken back.

A search takes what explains most together; where one of its names turns out to stand for something else, what it
stood for is open again.  One candidate joins the others: of those with the evidence of a name, fitted in earnest, the
one that makes most of what is left smaller across the rows to learn from (on each quarter by what the others say), if
held-out rows say the same (`gap.naming.trifles`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from flightstack.gap.decisions import CLEARLY, LINE_ERROR
from flightstack.gap.naming.candidates import members
from flightstack.gap.naming.design import linearise
from flightstack.gap.naming.estimate import Estimates, estimate
from flightstack.gap.naming.evidence import fit_subsets, score
from flightstack.gap.naming.metric import metric_of
from flightstack.gap.naming.search import Fit, SelectionState, effects_at_bound, fit_subset, judged_fit
from flightstack.gap.naming.trifles import mse_increase
from flightstack.vehicle import Vehicle


def forward_selection_step(
    state: SelectionState, made: Estimates, effects: Mapping[str, Mapping[str, float]], of: Collection[str]
) -> tuple[SelectionState, Fit] | None:
    """The named effects (all in `made`) and one more, one of `of`, in a search of their own; None if none earns it."""
    fresh = _searched_at(state, made.vehicle)
    point = fresh.point
    now = judged_fit(fresh, effects, made.vehicle, point.rest, len(made.slots))
    base = members(point.candidates, effects)
    own = [m for m, c in enumerate(point.candidates) if c.effect in set(of) - set(effects) - state.excluded]
    subsets = [tuple(sorted((*base, m))) for m in own]
    gram, count = point.gram(), len(point.candidates)
    found = [s for s in fit_subsets(gram, subsets, point.columns, point.low, point.high) if np.isfinite(s.gain)]
    promised = [gram.c + float(score(s.gain, s.used, len(s.members), gram.rows, count)) for s in found]
    best: tuple[float, Fit] | None = None
    for i in np.argsort(promised):
        if promised[i] > now.score + LINE_ERROR:
            break
        fit = fit_subset(fresh, found[i])
        (new,) = set(fit.effects) - set(effects)
        if fit.score >= now.score or effects_at_bound(state.start, fit, state.rope_most_m):
            continue
        across, held = mse_increase(fresh, estimate(fresh, fit.effects), list(fit.effects), new)
        if min(across, held) >= CLEARLY and (best is None or across > best[0]):
            best = across, fit
    if best is None:
        return None
    there = _searched_at(fresh, best[1].vehicle)
    return there, judged_fit(there, best[1].effects, best[1].vehicle, best[1].rows, best[1].used)


def _searched_at(state: SelectionState, vehicle: Vehicle) -> SelectionState:
    """A search with its columns at this vehicle, and the other's model of the noise."""
    point = linearise(state.bench, vehicle, state.start, layout=state.point.layout)
    return SelectionState(
        state.bench, state.start, point, metric_of(point), excluded=state.excluded, rope_most_m=state.rope_most_m
    )
