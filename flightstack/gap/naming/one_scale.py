"""Several effects of the file that are off by one and the same factor: mass and thrust that are off by its inverse.

Mass, thrust, inertia and all that acts by the air times one factor fly alike.  Where a file has too much thrust, a load
and inertias too large explain the flights, and everything else that the file has, drags and dampings, is then too small
by the same factor: many false names for one thrust.  Where it has too much of both mass and thrust, its drags alone are
false.  A search that exchanges one effect at a time never comes there.
"""

from __future__ import annotations

import numpy as np

from flightstack.gap.decisions import ALIKE_EVIDENCE
from flightstack.gap.naming.candidates import has, members
from flightstack.gap.naming.search import Fit, SelectionState, effects_at_bound, fit_from
from flightstack.gap.simulate import value, with_value

_OTHERS = ("payload", "inertia", "thrust_scale", "thrust_curve", "motor_lag", "transport_delay", "battery_sag")
"""What carries the scale itself, and what has none."""
_NOTHING = 0.02
"""A load or an inertia off by a smaller share is not tried: it would be too thin to be named."""


def by_one_scale(state: SelectionState, best: Fit) -> Fit | None:
    """The fit with a thrust scale and a load for the effects of the file that are off by one factor; None if no better.

    Of as good fits the one with fewer names is the better.  Where the file only guesses mass and thrust, what it knows
    is left alone for one name more, but not for two: that mass, thrust and inertia are all off alike is less likely
    than that one drag is.
    """
    open_ones = {c.effect for c in state.point.candidates} - state.excluded
    is_guessed = {"body.mass_kg", "rotors.max_thrust_n"} <= set(state.start.ranges)
    own = [e for e in best.effects if e not in _OTHERS and has(state.start, e)]
    if len(own) < (1 if is_guessed else 2) or not {"thrust_scale", "payload"} <= open_ones:
        return None
    if "thrust_scale" in best.effects and not is_guessed:
        return None
    pairs = [(value(state.start, e, p), now) for e in own for p, now in best.effects[e].items()]
    factors = np.array([now / was for was, now in pairs if np.isfinite(was) and was != 0.0])
    if len(factors) < 2 or np.any(factors <= 0.0):
        return None
    effects = _scaled(state, best, own, float(np.median(factors)))
    if "inertia" not in open_ones:
        effects.pop("inertia", None)
    if len(effects) > len(best.effects) + (1 if is_guessed else 0):
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


def _scaled(state: SelectionState, best: Fit, own: list[str], factor: float) -> dict[str, dict[str, float]]:
    """The fit's effects but its own ones of the file, with mass, thrust and inertia as much smaller as those are too
    great; less what would then be too little to be named."""
    mass, load = state.start.mass_kg, best.effects.get("payload", {}).get("mass_kg", 0.0)
    scale = best.effects.get("thrust_scale", {}).get("scale", 1.0) / factor
    inertia = best.effects.get("inertia", {f"scale_{axis}": 1.0 for axis in "xyz"})
    tried = {
        "payload": {"mass_kg": (mass + load) / factor - mass},
        "thrust_scale": {"scale": scale},
        "inertia": {p: x / factor for p, x in inertia.items()},
    }
    off = {
        "payload": abs(tried["payload"]["mass_kg"]) / mass,
        "thrust_scale": abs(scale - 1.0),
        "inertia": max(abs(x - 1.0) for x in tried["inertia"].values()),
    }
    others = {e: dict(values) for e, values in best.effects.items() if e not in own and e not in tried}
    return others | {e: values for e, values in tried.items() if off[e] >= _NOTHING}
