"""What a named effect does for rows that nothing was learned from, to first order."""

from __future__ import annotations

import numpy as np

from flightstack.gap.decisions import CLEAR_EVIDENCE
from flightstack.gap.naming.estimate import Estimates
from flightstack.gap.naming.search import SelectionState
from flightstack.gap.simulate import value
from flightstack.types import F64


def moved(state: SelectionState, made: Estimates) -> F64:
    """(n,) how far each coefficient is from where it started; 0 for one that started nowhere."""
    origin = np.array([value(state.start, *slot) for slot in made.slots])
    return np.where(np.isfinite(origin), made.values - np.nan_to_num(origin), 0.0)


def gain(state: SelectionState, made: Estimates, effect: str) -> float:
    """Share of the explainable held-out gap that falls when the effect joins the others: 0 or less where it does harm.

    NaN where held-out rows hardly hold it (a low pass that only the learned part has): they can't speak for or against.
    """
    layout = state.point.layout
    held = layout.keep & layout.held
    mine = [i for i, (e, _) in enumerate(made.slots) if e == effect]
    own = made.x[held][:, mine] @ moved(state, made)[mine]
    if float(own @ own) < CLEAR_EVIDENCE:
        return float("nan")
    before, after = layout.stack(state.bench.residual(state.start))[held], made.rows[held]
    whole = float(before @ before) - float(after @ after)
    lost = float((after + own) @ (after + own)) - float(after @ after)
    return lost / max(whole + 1e-9, lost, 1e-9)
