"""The statement that a certificate makes of its bounds, and the colour of its windows' residuals, anew.

    |a(q) - m(q)| <= k sqrt(i_B^2 s(q)^2 + g^2) + rho (1 + sum_j |w_j(q)|)

The statement and the formula are this checker's own words: a file that says something else is refused.  i_B, rho and
g^2 are `inflation`, `remainder_mps2` and `excess` of each process.  With a log, all windows' residuals r, in the order
of time, have the spectrum

    S(f) = c_0 + 2 sum over l < 10 of min(1, 2 - l / 5) c_l cos(2 pi f l),   c_l their mean product l windows apart

and i_B^2 s_r^2 + g^2 must be at least its peak, but for what 500 windows leave open of it (97.5 %).  Of the means of
ten windows in a row as many as 1 % may lie beyond what i_B, rho and mean k sigma allow.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .intervals import F64, I64
from .reading import Refused, Unreadable, number, table_of

STATEMENT = (
    "If the true function is a draw of the stated kernel, noise is Gaussian and sampling does not depend on past "
    "noise, the remainder is at most rho and noise correlation ends within a block, all bounds of all certificates of "
    "this flight hold with probability 1 - delta; changes after the data are watched, not promised."
)
FORMULA = (
    "a(q) in the hull, over its node's queries p, of m(p) +- (k_a sqrt(i_B^2 s(p)^2 + g^2) + rho (1 + sum_j |w_j(p)|))"
)
BLOCK = 10
_GAP = 2
"""Samples between windows that follow each other, at most."""
_OPEN = 1.96 * math.sqrt(4.0 * BLOCK / (3.0 * 500.0))


def check_confidence(value: Any, delta: float, k: float) -> None:
    """Refused where a file does not say just this of its bounds."""
    table = table_of(value, ("statement", "formula", "probability", "k"), "confidence")
    if not isinstance(table["statement"], str) or not isinstance(table["formula"], str):
        raise Unreadable("confidence: statement and formula must be words")
    if (table["statement"], table["formula"]) != (STATEMENT, FORMULA):
        raise Refused("confidence: the statement is not the one that is checked")
    if not abs(number(table["probability"], "confidence.probability") - (1.0 - delta)) <= 1e-12:
        raise Refused("confidence.probability is not 1 - delta")
    if number(table["k"], "confidence.k") != k:
        raise Refused("confidence.k is not k_sigma")


def peak(residual: F64, last: I64) -> float:
    """Of the spectrum of residuals (n,) of windows that end with these samples."""
    runs = np.concatenate([[0], np.cumsum(np.diff(last) > 15 + _GAP)])
    products = []
    for lag in range(BLOCK):
        end = len(residual) - lag
        together = runs[lag:] == runs[:end]
        products.append(float((residual[lag:] * residual[:end])[together].mean()) if together.any() else 0.0)
    lags = np.arange(1, BLOCK)
    waves = np.cos(2.0 * math.pi * np.linspace(0.0, 0.5, 41)[:, None] * lags)
    found = products[0] + 2.0 * waves @ (np.minimum(1.0, 2.0 - 2.0 * lags / BLOCK) * np.array(products[1:]))
    return float(found.max())


def check_colour(residual: F64, last: I64, noise_var: float, inflation: float, excess: float) -> float:
    """The spectrum's peak; refused where noise and inflation do not reach it."""
    most = peak(residual, last)
    if not noise_var * inflation**2 + excess >= most * (1.0 - _OPEN):
        raise Refused(
            f"noise of {math.sqrt(noise_var):.3g} m/s^2 times {inflation:.3g} is stated, the windows show "
            f"{math.sqrt(most):.3g}"
        )
    return most
