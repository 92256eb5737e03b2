"""Several effects of the file that are off by one and the same factor: mass and thrust that are off by its inverse.

Mass, thrust, inertia and all that acts by the air times one factor fly alike.  Where a file has too much thrust, a load
and inertias too large explain the flights, and everything else that the file has, drags and dampings, is then too small
by the same factor: many false names for one thrust.  Where it has too much of both mass and thrust, its drags alone are
false.  A search that exchanges one effect at a time never comes there.
"""

from __future__ import annotations

import numpy as np

from flightstack.gap.decisions import ALIKE_EVIDENCE
from flightstack.gap.naming.candidates import has
from flightstack.gap.naming.search import Fit, SelectionState, effects_at_bound, fit_from, members
from flightstack.gap.simulate import value, with_value

_OTHERS = ("payload", "inertia", "thrust_scale", "thrust_curve", "motor_lag", "transport_delay", "battery_sag")
"""What carries the scale itself, and what has none."""
_NOTHING = 0.02
"""A load or an inertia off by a smaller share is not tried: it would be too thin to be named."""


def by_one_scale(state: SelectionState, best: Fit) -> Fit | None:
    """The fit with a thrust scale and a load for two or more effects of the file that are off by one factor.

    None if no better.

    Of as good fits the one with fewer names is the better, and the one that leaves alone what the file knows where it
    only guesses mass and thrust.
    """
    open_ones = {c.effect for c in state.point.candidates} - state.excluded
    if "thrust_scale" in best.effects or not {"thrust_scale", "payload"} <= open_ones:
        return None
    own = [e for e in best.effects if e not in _OTHERS and has(state.start, e)]
    pairs = [(value(state.start, e, p), now) for e in own for p, now in best.effects[e].items()]
    factors = np.array([now / was for was, now in pairs if np.isfinite(was) and was != 0.0])
    if len(own) < 2 or len(factors) < 2 or np.any(factors <= 0.0):
        return None
    factor = float(np.median(factors))
    effects = {e: dict(values) for e, values in best.effects.items() if e not in own}
    effects["thrust_scale"] = {"scale": 1.0 / factor}
    mass, load = state.start.mass_kg, best.effects.get("payload", {}).get("mass_kg", 0.0)
    effects["payload"] = {"mass_kg": (mass + load) / factor - mass}
    if abs(effects["payload"]["mass_kg"]) < _NOTHING * mass:
        del effects["payload"]
    if "inertia" in open_ones:
        inertia = best.effects.get("inertia", {f"scale_{axis}": 1.0 for axis in "xyz"})
        effects["inertia"] = {p: scale / factor for p, scale in inertia.items()}
        if all(abs(scale - 1.0) < _NOTHING for scale in effects["inertia"].values()):
            del effects["inertia"]
    is_guessed = {"body.mass_kg", "rotors.max_thrust_n"} <= set(state.start.ranges)
    if len(effects) > len(best.effects) and not is_guessed:
        return None
    vehicle = state.start
    for effect, values in effects.items():
        vehicle = with_value(vehicle, effect, values)
    group = [state.point.candidates[m] for m in members(state.point.candidates, effects)]
    fit = fit_from(state, group, vehicle)
    worse = fit.chi2 - best.chi2 if is_guessed else fit.score - best.score
    if worse > ALIKE_EVIDENCE or effects_at_bound(state.start, fit, state.rope_most_m):
        return None
    return fit
