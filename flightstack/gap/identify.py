"""The identifiability map: which effects could these flights have named, how small, and what to fly for the others.

The Fisher information of the whitened columns against the noise of these flights, beside what is named, with every
other candidate a little there and the commands' timing unknown, bounds what any unbiased estimator can do (Cramer and
Rao).  Nothing of it needs the effect to be present.  A size is named for sure where it exceeds what a name needs by two
standard errors.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.gap.chances import chi2_limit
from flightstack.gap.decisions import ALIKE_COSINE, NAME_EVIDENCE, NAME_P, SURE_ERRORS
from flightstack.gap.naming.candidates import has
from flightstack.gap.naming.design import Linearised
from flightstack.gap.naming.evidence import score
from flightstack.gap.naming.proportion import priced
from flightstack.gap.simulate import natural_scale
from flightstack.types import F64
from flightstack.vehicle import Vehicle

IN_PROPORTION = ""
"""In place of a parameter: all of an effect that the file has, off by one factor; its sizes are shares."""


@dataclass(frozen=True, slots=True)
class Identifiable:
    """One parameter of one effect against one set of flights."""

    effect: str
    parameter: str
    error: float
    """Its standard error at best, in the parameter's unit; inf: nothing of it shows."""
    smallest: float
    """Smallest change that these flights would have named, in the parameter's unit; inf: none."""
    matters: float
    """A change that moves the motion by some percent."""
    shown: bool
    """Whether a change that matters would have been seen."""
    like: str
    """The effect whose columns come closest, "" where none is near."""
    cosine: float
    """How close: 1 is the same."""
    manoeuvre: str
    """What would show it better."""


def identify(point: Linearised, start: Vehicle, named: Collection[str]) -> tuple[Identifiable, ...]:
    """The map at one design, in table order; of an effect in several variants the best seen one.

    `start` is the vehicle as its file has it; what is `named` is fitted beside.
    """
    gram = point.gram()
    size = np.sqrt(np.maximum(np.diag(gram.k), 1e-300))
    cosine = np.abs(gram.k / np.outer(size, size))
    found: dict[tuple[str, str], Identifiable] = {}
    effects = [point.candidates[slot.candidate].effect for slot in point.slots]
    for i, (slot, effect) in enumerate(zip(point.slots, effects, strict=True)):
        beside = [j for j, e in enumerate(effects) if e in named and e != effect]
        information = _information(gram.k, np.eye(len(size))[i], beside)
        matters = natural_scale(point.vehicle, effect, slot.parameter)
        informed = information * matters**2 > 1e-6
        error = 1.0 / np.sqrt(information) if informed else float("inf")
        count = sum(s.candidate == slot.candidate for s in point.slots)
        price = float(score(0.0, count, 1, gram.rows, len(point.candidates)))
        smallest = error * _errors_of_a_name(price, count)
        others = [j for j, e in enumerate(effects) if e != effect]
        nearest = max(others, key=lambda j: cosine[i, j]) if informed else -1
        near = float(cosine[i, nearest]) if informed else 0.0
        like = effects[nearest] if near > ALIKE_COSINE else ""
        manoeuvre = EFFECTS[effect].manoeuvre
        shown = smallest < 2.0 * matters
        row = Identifiable(effect, slot.parameter, error, smallest, matters, shown, like, near, manoeuvre)
        key = (effect, slot.parameter)
        if key not in found or row.smallest < found[key].smallest:
            found[key] = row
    return (*found.values(), *_of_the_file(point, start, effects, named))


def _of_the_file(
    point: Linearised, start: Vehicle, effects: Sequence[str], named: Collection[str]
) -> list[Identifiable]:
    """What the file has and is not named, each as one factor on all of it."""
    gram, rows = point.gram(), list[Identifiable]()
    for effect in dict.fromkeys(effects):
        if effect in named or not has(start, effect):
            continue
        own = np.array([slot.origin * (e == effect) for slot, e in zip(point.slots, effects, strict=True)])
        beside = [j for j, e in enumerate(effects) if e in named]
        information = _information(gram.k, own, beside)
        error = 1.0 / np.sqrt(information) if information > 1e-6 else float("inf")
        smallest = error * (float(np.sqrt(priced(point, start).least_gain)) + SURE_ERRORS)
        manoeuvre = EFFECTS[effect].manoeuvre
        rows.append(Identifiable(effect, IN_PROPORTION, error, smallest, 1.0, smallest < 1.0, "", 0.0, manoeuvre))
    return rows


def _information(k: F64, along: F64, beside: Sequence[int]) -> float:
    """Of a coefficient along (n,) these columns, those beside fitted again."""
    own = along @ k @ along
    if not beside:
        return max(float(own), 0.0)
    cross = k[beside] @ along
    return max(float(own - cross @ np.linalg.pinv(k[np.ix_(beside, beside)], hermitian=True) @ cross), 0.0)


def _errors_of_a_name(price: float, coefficients: int) -> float:
    """Standard errors that a change must have to be named for sure."""
    least = max(price + NAME_EVIDENCE, chi2_limit(max(coefficients, 1), NAME_P / len(EFFECTS)))
    return float(np.sqrt(least)) + SURE_ERRORS
