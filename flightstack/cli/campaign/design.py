"""Which values flight i has: a pure function of the campaign file and i, so that any worker may fly any flight."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flightstack.cli.campaign.spec import GRID, SOBOL, CampaignSpec, Factor
from flightstack.types import F64


class Design:
    """The draws of one campaign; `shares(i)` are numbers in [0, 1), one for each factor."""

    def __init__(self, spec: CampaignSpec) -> None:
        self._spec = spec
        self._sobol: F64 | None = None
        if spec.design == SOBOL and spec.factors:
            from scipy.stats import qmc

            sequence = qmc.Sobol(len(spec.factors), scramble=True, rng=np.random.default_rng([18, spec.design_seed]))
            self._sobol = sequence.random_base2(max(0, (spec.count - 1).bit_length()))

    def values(self, flight: int) -> dict[str, Any]:
        """Name of each factor -> its value, fixed ones included."""
        spec = self._spec
        if spec.design == GRID:
            drawn = _grid(spec.factors, flight // spec.seeds)
        else:
            drawn = at_shares(spec.factors, self.shares(flight))
        return drawn | {factor.name: factor.values[0] for factor in spec.fixed}

    def shares(self, flight: int) -> Sequence[float]:
        """Of a random or a Sobol design."""
        if self._sobol is not None:
            return [float(each) for each in self._sobol[flight]]
        rng = np.random.default_rng([17, self._spec.design_seed, flight])
        return [float(each) for each in rng.random(len(self._spec.factors))]


def at_shares(factors: Sequence[Factor], shares: Sequence[float]) -> dict[str, Any]:
    """The factors' values at these shares of their ranges."""
    return {factor.name: factor.at(share) for factor, share in zip(factors, shares, strict=True)}


def _grid(factors: Sequence[Factor], place: int) -> dict[str, Any]:
    """The last factor changes fastest."""
    values = {}
    for factor in reversed(factors):
        place, at = divmod(place, len(factor.values))
        values[factor.name] = factor.values[at]
    return {factor.name: values[factor.name] for factor in factors}
