"""What the file has already: that a size of it is off in proportion is the least that can be wrong with a model.

Any effect may have some other size than the file says, and which of them is a choice among all candidates; all its
coefficients are paid for.  One that the vehicle is known to have need not be chosen first, and where all its parameters
are off by one factor (a drag of another day, another frame) that factor is the only coefficient.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flightstack.gap.decisions import ALIKE_EVIDENCE, NAME_EVIDENCE
from flightstack.gap.naming.candidates import has
from flightstack.gap.naming.evidence import fit_subsets
from flightstack.gap.naming.search import Fit, SelectionState, effects_at_bound, fit_subset, members


def in_proportion(state: SelectionState, effects: Mapping[str, Mapping[str, float]], effect: str) -> float:
    """Evidence of one factor on an effect of the file beside these effects (less itself); -inf: not in the file."""
    if not has(state.start, effect):
        return -np.inf
    point = state.point
    own = [i for i, slot in enumerate(point.slots) if point.candidates[slot.candidate].effect == effect]
    others = {e: values for e, values in effects.items() if e != effect}
    base = [int(i) for m in members(point.candidates, others) for i in point.columns[m]]
    gram = point.gram()
    origin = np.array([point.slots[i].origin for i in own])
    x = np.zeros((len(gram.b), len(base) + 1))
    x[base, np.arange(len(base))] = 1.0
    x[own, -1] = origin
    k, b = x.T @ gram.k @ x, x.T @ gram.b
    size = np.sqrt(np.maximum(np.diag(k), 1e-300))
    scaled = k / np.outer(size, size) + 1e-9 * np.eye(len(b))
    theta = np.linalg.solve(scaled, b / size) / size
    moved = theta[-1] * origin
    if not k[-1, -1] > 0.0 or np.any((moved < point.low[own]) | (moved > point.high[own])):
        return -np.inf
    without = np.linalg.solve(scaled[:-1, :-1], b[:-1] / size[:-1]) / size[:-1]
    return float(theta @ b - without @ b[:-1] - np.log(max(gram.rows, 2.0)))


def joined(state: SelectionState, best: Fit) -> Fit:
    """The best fit and an effect of the file that earns its place beside it; another such one where clearly better.

    The fit itself where none does.
    """
    own = _promised(state, best)
    least = min([best.score, *(score for score, _ in own)])
    tried = [(score, best, effect) for score, effect in own]
    for other in state.fits.values():
        if other is not best and len(other.effects) <= len(best.effects) and _is_fair(state, other):
            tried += [(score, other, effect) for score, effect in _promised(state, other)]
    for score, base, effect in sorted(tried, key=lambda each: each[0]):
        if base is best or score < least - ALIKE_EVIDENCE:
            fit = _together(state, base, effect)
            if _is_fair(state, fit) and fit.chi2 < base.chi2:
                return fit
    return best


def _promised(state: SelectionState, base: Fit) -> list[tuple[float, str]]:
    """Scores with one effect of the file more, where columns as they are show as much of it as a name needs."""
    outside = [e for e in state.start.effects if e not in state.excluded and e not in base.effects]
    known = {candidate.effect for candidate in state.point.candidates}
    worth = [(in_proportion(state, base.effects, e), e) for e in outside if e in known]
    return [(base.score - more, effect) for more, effect in worth if more >= NAME_EVIDENCE]


def _together(state: SelectionState, base: Fit, effect: str) -> Fit:
    point = state.point
    more = next(m for m, c in enumerate(point.candidates) if c.effect == effect)
    subset = tuple(sorted((*members(point.candidates, base.effects), more)))
    fitted = fit_subsets(point.gram(), [subset], point.columns, point.low, point.high)[0]
    return fit_subset(state, fitted)


def _is_fair(state: SelectionState, fit: Fit) -> bool:
    return not (state.excluded & set(fit.effects) or effects_at_bound(state.start, fit, state.rope_most_m))
