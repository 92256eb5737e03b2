"""Several effects of the file that are off by one and the same factor: thrust that is off by its inverse.

Mass, thrust, inertia and all that acts by the air times one factor fly alike.  Where a file has too much thrust, a load
and inertias too large explain the flights, and everything else that the file has, drags and dampings, is then too small
by the same factor: many false names for one thrust.  A search that exchanges one effect at a time never comes there.
"""

from __future__ import annotations

import numpy as np

from flightstack.gap.decisions import ALIKE_EVIDENCE, TENTH
from flightstack.gap.naming.candidates import has
from flightstack.gap.naming.search import Fit, SelectionState, effects_at_bound, fit_from, members
from flightstack.gap.simulate import value, with_value

_OTHERS = ("payload", "inertia", "thrust_scale", "thrust_curve", "motor_lag", "transport_delay", "battery_sag")
"""What carries the scale itself, and what has none."""


def by_one_scale(state: SelectionState, best: Fit) -> Fit | None:
    """The fit with a thrust scale for two or more effects of the file that are off by one factor; None if no better.

    Of as good fits the one with fewer names is the better.
    """
    if "thrust_scale" in best.effects or "thrust_scale" in state.excluded:
        return None
    own = [e for e in best.effects if e not in _OTHERS and has(state.start, e)]
    pairs = [(value(state.start, e, p), now) for e in own for p, now in best.effects[e].items()]
    factors = np.array([now / was for was, now in pairs if np.isfinite(was) and was != 0.0])
    if len(own) < 2 or len(factors) < 2 or np.any(factors <= 0.0):
        return None
    factor = float(np.median(factors))
    if np.any(np.abs(factors - factor) > TENTH * abs(factor - 1.0)):
        return None
    effects = {e: dict(values) for e, values in best.effects.items() if e not in own}
    if "payload" in effects:
        mass = state.start.mass_kg
        effects["payload"]["mass_kg"] = (mass + effects["payload"]["mass_kg"]) / factor - mass
    if "inertia" in effects:
        effects["inertia"] = {p: now / factor for p, now in effects["inertia"].items()}
    effects["thrust_scale"] = {"scale": 1.0 / factor}
    vehicle = state.start
    for effect, values in effects.items():
        vehicle = with_value(vehicle, effect, values)
    group = [state.point.candidates[m] for m in members(state.point.candidates, effects)]
    fit = fit_from(state, group, vehicle)
    if fit.score > best.score + ALIKE_EVIDENCE or effects_at_bound(state.start, fit, state.rope_most_m):
        return None
    return fit
