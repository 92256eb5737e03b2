"""Chi-square's tail and limit and Student's t, in closed form: importing `scipy.special` takes as long as a search."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from flightstack.types import F64

_SURE = 1e5
_HALVINGS = 60
_STEPS = 400


def chi2_tail(freedom: int, x: float) -> float:
    """Probability that a chi-square with this many degrees of freedom (1 or more) is greater than x."""
    half = min(0.5 * x, _SURE)
    if half <= 0.0:
        return 1.0
    total = math.erfc(math.sqrt(half)) if freedom % 2 else 0.0
    power = 0.5 * (freedom % 2)
    while power < 0.5 * freedom:
        total += math.exp(power * math.log(half) - half - math.lgamma(power + 1.0))
        power += 1.0
    return total


def chi2_limit(freedom: int, chance: float) -> float:
    """What a chi-square with this many degrees of freedom is greater than with this probability."""
    low, high = 0.0, 1.0
    while chi2_tail(freedom, high) > chance:
        low, high = high, 2.0 * high
    return _root(lambda x: chi2_tail(freedom, x) > chance, low, high)


@lru_cache(maxsize=64)
def t_limit(freedom: float) -> float:
    """What Student's t with so many degrees of freedom (1 or more) stays below in 97.5 % of cases.

    With t = sqrt(f) tan(u) the density is a power of cos(u), by Simpson's rule.
    """
    scale = 2.0 * math.exp(math.lgamma(0.5 * freedom + 0.5) - math.lgamma(0.5 * freedom)) / math.sqrt(math.pi)

    def short(angle: float) -> bool:
        values = np.cos(np.linspace(0.0, angle, _STEPS + 1)) ** (freedom - 1.0)
        inside = values[0] + values[-1] + 4.0 * values[1::2].sum() + 2.0 * values[2:-1:2].sum()
        return bool(scale * inside * angle / (3.0 * _STEPS) < 0.95)

    narrow = math.atan(13.0 / math.sqrt(freedom))  # t is 12.7 at one degree of freedom, less above
    return math.sqrt(freedom) * math.tan(_root(short, 0.0, narrow))


def chi2_tails(freedom: int, x: F64) -> F64:
    """`chi2_tail` of each."""
    return np.array([chi2_tail(freedom, each) for each in x.tolist()])


def _root(below: Callable[[float], bool], low: float, high: float) -> float:
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if below(middle) else (low, middle)
    return 0.5 * (low + high)
