"""How honest a learner is: what it should have said, how often the truth lies within its bounds, a conformal check.

Only scoring: nothing in the stack calls it, because nothing in the stack knows the truth.

Conformal check.  With scores s_i = |y_i - m_i| / sqrt(sigma_i^2 + noise^2) of n calibration windows, the k-th smallest,
with k = ceil((1 - alpha)(n + 1)), covers a further exchangeable window with probability at least 1 - alpha (Vovk,
Gammerman and Shafer, "Algorithmic Learning in a Random World", 2005).  Windows of one flight are not exchangeable, so
the held-out half is scored with it and says how far the promise holds.  y is the mean of WINDOW measurements; its noise
is measured as the learner does (`learning.watch`), so that an honest quantile is 3 whatever the accelerometer's noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flightstack.frames import quat_to_matrix
from flightstack.learning.watch import LAGS
from flightstack.model import Model
from flightstack.types import F64, Mask

STAGES = ("nothing learned", "calculable", "valid", "used", "used but frozen")
"""What `Learned.stage` 0..4 means."""
BOUND_SIGMAS = 3.0
"""Standard deviations in the bound that a learner stands for."""
ALPHA = 0.0027
"""Share that may lie outside: that of a normal distribution beyond `BOUND_SIGMAS`, so that an honest quantile is 3."""
WINDOW = 15
"""Samples of a window: the learner's."""


@dataclass(frozen=True, slots=True)
class Coverage:
    """Shares within the bound, 0..1; None where nothing is known."""

    share: float | None
    """Of all pairs of tick and axis."""
    axes: tuple[float | None, float | None, float | None]
    """Of the ticks, for each body axis."""
    simultaneous: float | None
    """Of the ticks, all three axes at once."""


@dataclass(frozen=True, slots=True)
class Conformal:
    """The conformal check of a flight's own windows: calibrated on its first half, tried on its second."""

    quantile_sigma: float
    """So many sigmas, of residual and a window's noise, hold 1 - alpha of the windows."""
    coverage_heldout: float
    """Share of the held-out windows within them."""
    alpha: float


def true_residual_frd_mps2(
    model: Model, specific_force_frd_mps2: F64, motor_u: F64, vel_ned_mps: F64, q_ned_frd: F64
) -> F64:
    """What a learner of `model` should have said: true specific force less the model's, (n, 3), body FRD.

    The model's is -T / m along z, with T of the delivered motor state `motor_u` (n, 4) (normalised commands after
    their lag), and -D v_body / m of its own drag.  Specific force (n, 3), velocity (n, 3) and attitude (n, 4) are the
    true ones.
    """
    factor = model.thrust_model_factor
    thrust_n = model.max_thrust_n * (factor * motor_u**2 + (1.0 - factor) * motor_u).mean(axis=1)
    residual = np.array(specific_force_frd_mps2, dtype=np.float64)
    residual[:, 2] += thrust_n / model.mass_kg
    drag = np.asarray(model.drag_kgps)
    if drag.any():
        to_world = np.array([quat_to_matrix(q) for q in np.asarray(q_ned_frd, dtype=np.float64)]).reshape(-1, 3, 3)
        residual += drag / model.mass_kg * np.einsum("nji,nj->ni", to_world, vel_ned_mps)
    return residual


def coverage(truth: F64, mean: F64, sigma: F64, sigmas: float = BOUND_SIGMAS) -> Coverage:
    """How often `truth` lies within `sigmas` times `sigma` of `mean`, all (n, 3); what is not finite doesn't count."""
    known = np.isfinite(truth) & np.isfinite(mean) & np.isfinite(sigma)
    with np.errstate(invalid="ignore"):
        inside: Mask = np.abs(truth - mean) <= sigmas * sigma
    whole = known.all(axis=1)
    x, y, z = (_share(inside[known[:, axis], axis]) for axis in range(3))
    return Coverage(_share(inside[known]), (x, y, z), _share(np.all(inside[whole], axis=1)))


def conformal_quantile(scores: F64, alpha: float = ALPHA) -> float | None:
    """The ceil((1 - alpha)(n + 1))-th smallest of n scores; None where n is too small to promise 1 - alpha."""
    place = math.ceil((1.0 - alpha) * (len(scores) + 1) - 1e-9)
    if place > len(scores) or place < 1:
        return None
    return float(np.partition(scores, place - 1)[place - 1])


def conformal_check(measured: F64, mean: F64, sigma: F64, alpha: float = ALPHA) -> Conformal | None:
    """Calibrate on the windows of the first half of the samples (n, 3), in the order of time, and try it on the second.

    Samples that are not finite are left out; every pair of window and axis is a score; None where there are too few.
    """
    known = (np.isfinite(measured) & np.isfinite(mean) & np.isfinite(sigma)).all(axis=1)
    error, sigma = (measured - mean)[known], sigma[known]
    count = len(error) // WINDOW
    if len(error) <= LAGS or count == 0:
        return None
    shape = (count, WINDOW, 3)
    variance = np.square(sigma[: count * WINDOW]).reshape(shape).mean(axis=1) + _noise_variance(error)
    with np.errstate(invalid="ignore", divide="ignore"):
        scores = np.abs(error[: count * WINDOW].reshape(shape).mean(axis=1)) / np.sqrt(variance)
    scores = scores[np.isfinite(scores)]
    half = len(scores) // 2
    quantile = conformal_quantile(scores[:half], alpha)
    if quantile is None:
        return None
    return Conformal(quantile, float(np.mean(scores[half:] <= quantile)), alpha)


def _noise_variance(error: F64) -> F64:
    """(3,) of the noise of a window's mean, by the structure function of the samples (`learning.watch`)."""
    structure = np.array([0.5 * np.square(error[lag:] - error[:-lag]).mean(axis=0) for lag in range(1, LAGS + 1)])
    whole = (2.0 * LAGS - 1.0) * structure[-1] - 2.0 * structure[:-1].sum(axis=0)
    noise: F64 = np.maximum(whole, 0.1 * structure[-1]) / WINDOW
    return noise


def _share(inside: Mask) -> float | None:
    return float(inside.mean()) if inside.size else None
