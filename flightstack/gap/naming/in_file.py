"""What the file has already: that a size of it is off in proportion is the least that can be wrong with a model.

Any effect may have some other size than the file says, and which of them is a choice among all candidates; all its
coefficients are paid for.  One that the vehicle is known to have need not be chosen first, and where all its parameters
are off by one factor (a drag of another day, another frame) that factor is the only coefficient.
"""

from __future__ import annotations

from flightstack.gap.decisions import ALIKE_EVIDENCE
from flightstack.gap.naming.candidates import members
from flightstack.gap.naming.evidence import fit_subsets
from flightstack.gap.naming.proportion import in_proportion, priced
from flightstack.gap.naming.search import Fit, SelectionState, effects_at_bound, fit_subset


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
    worth = [(in_proportion(state.point, state.start, base.effects, e), e) for e in outside if e in known]
    at = priced(state.point, state.start)
    return [(base.score - more, effect) for more, effect in worth if more >= at.least_gain - at.factor_price]


def _together(state: SelectionState, base: Fit, effect: str) -> Fit:
    point = state.point
    more = next(m for m, c in enumerate(point.candidates) if c.effect == effect)
    subset = tuple(sorted((*members(point.candidates, base.effects), more)))
    fitted = fit_subsets(point.gram(), [subset], point.columns, point.low, point.high)[0]
    return fit_subset(state, fitted)


def _is_fair(state: SelectionState, fit: Fit) -> bool:
    return not (state.excluded & set(fit.effects) or effects_at_bound(state.start, fit, state.rope_most_m))
