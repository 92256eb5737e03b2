"""The identifiability map: which effects could this log have shown, how small, and what to fly for the others.

The Fisher information of the whitened columns against the noise of these flights, with every other candidate a little
there and the commands' timing unknown, bounds what any unbiased estimator can do (Cramer and Rao).  Nothing of it
needs the effect to be present.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.gap.decisions import ALIKE_COSINE, DETECTABLE
from flightstack.gap.naming.design import Linearised
from flightstack.gap.simulate import natural_scale


@dataclass(frozen=True, slots=True)
class Identifiable:
    """One parameter of one effect against one set of flights."""

    effect: str
    parameter: str
    smallest: float
    """Smallest change that these flights could have shown, in the parameter's unit; inf: none."""
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


def identify(point: Linearised) -> tuple[Identifiable, ...]:
    """The map at one design, in table order; of an effect in several variants the best seen one."""
    gram = point.gram()
    size = np.sqrt(np.maximum(np.diag(gram.k), 1e-300))
    cosine = np.abs(gram.k / np.outer(size, size))
    found: dict[tuple[str, str], Identifiable] = {}
    for i, slot in enumerate(point.slots):
        effect = point.candidates[slot.candidate].effect
        informed = gram.k[i, i] * natural_scale(point.vehicle, effect, slot.parameter) ** 2 > 1e-6
        smallest = DETECTABLE / float(size[i]) if informed else float("inf")
        matters = natural_scale(point.vehicle, effect, slot.parameter)
        others = [j for j, s in enumerate(point.slots) if point.candidates[s.candidate].effect != effect]
        nearest = max(others, key=lambda j: cosine[i, j]) if informed else -1
        near = float(cosine[i, nearest]) if informed else 0.0
        like = point.candidates[point.slots[nearest].candidate].effect if near > ALIKE_COSINE else ""
        row = Identifiable(
            effect, slot.parameter, smallest, matters, smallest < 2.0 * matters, like, near, EFFECTS[effect].manoeuvre
        )
        key = (effect, slot.parameter)
        if key not in found or row.smallest < found[key].smallest:
            found[key] = row
    return tuple(found.values())
