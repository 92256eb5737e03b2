"""What a certificate's bounds are worth: the statement, and the two figures that each process' residuals give it.

    a(q) in the hull, over its node's queries p, of m(p) +- (k_a sqrt(i_B^2 s(p)^2 + g^2) + rho (1 + sum_j |w_j(p)|))

k_a that of an axis (`hull_sigmas`), m, s posterior mean and standard deviation at residual noise s_r, w_j the posterior
weights of the points, g^2 the part of the error that no kernel knows (`learning.store`: excess, with its own
inflation), along an axis all of it summed over the process' outputs.  i_B and rho come from the residuals r of the
windows in the order of time (mean 0 by the model):

    c_l     mean of r_i r_i+l over windows that follow each other without a gap
    S(f)    c_0 + 2 sum over l < B of min(1, 2 - 2 l / B) c_l cos(2 pi f l), the spectrum by a lag window with a flat
            top, which takes little from its peaks; B = 10, or three correlation times where that is more
    i_B^2   1.21 max(1, max over f of S(f) / s_r^2): noise with this spectrum moves any weighted mean of the points by
            no more than white noise of that variance does
    rho     max over blocks of B windows of |mean r| beyond z i_B s_r / sqrt(B), at least 0; z: of all blocks together
            5 % would lie beyond by noise alone

1.21 pays for S being estimated.  Source of the lag window: D. Politis and J. Romano, "Bias-corrected nonparametric
spectral estimation", Journal of Time Series Analysis 16, 1995.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from flightstack.jit import njit_called
from flightstack.types import F64, I64

STATEMENT = (
    "If the true function is a draw of the stated kernel, noise is Gaussian and sampling does not depend on past "
    "noise, the remainder is at most rho and noise correlation ends within a block, all bounds of all certificates of "
    "this flight hold with probability 1 - delta; changes after the data are watched, not promised."
)
FORMULA = (
    "a(q) in the hull, over its node's queries p, of m(p) +- (k_a sqrt(i_B^2 s(p)^2 + g^2) + rho (1 + sum_j |w_j(p)|))"
)
ALLOWANCE = 1.21
LEAST_INFLATION = math.sqrt(ALLOWANCE)
BLOCK, LONGEST_BLOCK = 10, 40
_GAP_US = 30_000
"""Between windows that follow each other there is one sample period."""
_BEYOND = 0.05


class Colour(NamedTuple):
    """i_B and rho of a process' outputs."""

    inflation: F64
    """(P,) at least `LEAST_INFLATION`."""
    remainder_mps2: F64
    """(P,)."""

    @classmethod
    def white(cls, outputs: int) -> Colour:
        """Of white noise and no remainder."""
        return cls(np.full(outputs, LEAST_INFLATION), np.zeros(outputs))


def colour(residual: F64, spans_us: I64, noise_var: float) -> Colour:
    """From residuals (n, P) of windows with their stamps (n, 2), in the order of time."""
    if len(residual) < 2 * BLOCK:  # too few to say anything of their colour
        return Colour.white(residual.shape[1])
    breaks = spans_us[1:, 0] - spans_us[:-1, 1] > _GAP_US
    runs = np.concatenate([[0], np.cumsum(breaks)])
    found = [_of_one(np.ascontiguousarray(residual[:, i]), runs, noise_var) for i in range(residual.shape[1])]
    return Colour(np.array([each[0] for each in found]), np.array([each[1] for each in found]))


def _of_one(residual: F64, runs: I64, noise_var: float) -> tuple[float, float]:
    longest = min(LONGEST_BLOCK, len(residual) - 1)
    covariance = _lagged(residual, runs, longest)
    share = covariance / max(covariance[0], 1e-300)
    small = np.flatnonzero(share < 2.0 / math.sqrt(len(residual)))
    correlated = 0.5 + float(share[1 : small[0] if len(small) else longest].sum())
    block = min(max(BLOCK, math.ceil(3.0 * correlated)), longest)
    lags = np.arange(1, block)
    waves = np.cos(2.0 * math.pi * np.linspace(0.0, 0.5, 2 * block + 1)[:, None] * lags)
    spectrum = covariance[0] + 2.0 * waves @ (np.minimum(1.0, 2.0 - 2.0 * lags / block) * covariance[1:block])
    inflation = math.sqrt(ALLOWANCE * max(1.0, float(spectrum.max()) / noise_var))
    means = _block_means(residual, runs, block)
    if not len(means):
        return inflation, 0.0
    z = float(-ndtri(0.5 * _BEYOND / len(means)))
    return inflation, max(0.0, float(np.abs(means).max()) - z * inflation * math.sqrt(noise_var / block))


@njit_called
def _lagged(residual: F64, runs: I64, lags: int) -> F64:
    """(lags,) mean product of residuals so many windows apart; 0 where there are none."""
    found = np.zeros(lags)
    for lag in range(lags):
        total, count = 0.0, 0
        for i in range(len(residual) - lag):
            if runs[i + lag] == runs[i]:
                total += residual[i + lag] * residual[i]
                count += 1
        found[lag] = total / count if count else 0.0
    return found


def _block_means(residual: F64, runs: I64, block: int) -> F64:
    """Of blocks of windows without a gap, one after the other."""
    starts = np.arange(0, len(residual) - block + 1, block)
    whole = starts[runs[starts] == runs[starts + block - 1]]
    means: F64 = residual[whole[:, None] + np.arange(block)].mean(axis=1)
    return means


def confidence_table(delta: float, k_sigma: float) -> dict[str, object]:
    """What a file says of its bounds; i_B, rho and the points are in its knowledge."""
    return {"statement": STATEMENT, "formula": FORMULA, "probability": 1.0 - delta, "k": k_sigma}
