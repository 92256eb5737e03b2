"""A force up or down that a flight shows is no reason to know little where it was not flown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from barriers import turns

from flightstack.barrier.posterior import Posterior, Process, sized_steps
from flightstack.learning.priors import default_priors
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

WINDOWS = 300
NOISE = {"lateral": 0.035, "vertical": 0.06}
"""Of a window's mean, m/s^2: as measured in flights with mocap and late links."""


def flown(rng: np.random.Generator, mass_ratio: float, force_mps2: F64) -> tuple[F64, F64]:
    """Inputs (N, 7) of a path as paper-tracking's, and corners of what its region asks for (16, 7)."""
    hover = mass_ratio * (1.0 + force_mps2[2] / STANDARD_GRAVITY_MPS2)
    t = np.linspace(0.0, 50.0, WINDOWS)
    x = np.zeros((WINDOWS, 7))
    x[:, 0], x[:, 1], x[:, 2] = 0.9 * np.cos(0.6 * t), 0.9 * np.cos(0.9 * t), 0.3 * np.cos(0.6 * t)
    x[:, :3] += np.cumsum(rng.normal(0.0, 0.02, (WINDOWS, 3)), axis=0)
    x[:20, :3] = rng.normal(0.0, 0.05, (20, 3)) + np.array([0.0, 0.0, -1.0])  # the climb
    x[:, 3:5] = rng.normal(0.0, 0.05, (WINDOWS, 2)) + force_mps2[:2] / STANDARD_GRAVITY_MPS2
    x[:, 5] = hover * (1.0 + rng.normal(0.0, 0.05, WINDOWS))
    signs = rng.choice([-1.0, 1.0], (16, 6))
    corners = np.zeros((16, 7))
    corners[:, :3] = signs[:, :3] * np.array([1.8, 1.8, 0.9])
    corners[:, 3:5] = 0.22 * signs[:, 3:5] + force_mps2[:2] / STANDARD_GRAVITY_MPS2
    corners[:, 5] = hover * (1.0 + 0.2 * signs[:, 5])
    return x, corners


def truth(x: F64, mass_ratio: float, force_mps2: F64) -> F64:
    """(M, 3) what a model of mass 1 leaves of the specific force, in tilt axes: Newton's second law."""
    found = np.einsum("mji,j->mi", turns(x[:, 3], x[:, 4]), force_mps2)
    found[:, 2] += STANDARD_GRAVITY_MPS2 * x[:, 5] * (1.0 - 1.0 / mass_ratio)
    return found


def known(name: str, x: F64, y: F64) -> Posterior:
    """As a certificate has it."""
    prior = getattr(default_priors(), name)
    process = Process(prior.kernel, NOISE[name] ** 2, x, y, np.full(y.shape[1], 1e-6), force=prior.force)
    *_, sized = sized_steps(process)
    assert sized is not None
    return sized


def linear_deviation(name: str, x: F64, corners: F64) -> F64:
    """(M,) of a prediction by all that is linear, in weight space (Rasmussen and Williams, section 2.1)."""
    one = np.ones((len(x), 1)), np.ones((len(corners), 1))
    columns = [0, 1, 2, 3, 4] if name == "lateral" else [2, 3, 4, 5]
    g = STANDARD_GRAVITY_MPS2
    prior = [1.0, 0.5, 0.5, 0.5, 1.0, 1.0] if name == "lateral" else [1.0, 0.3, 1.0, 1.0, 0.4 * g]
    design, asked = np.hstack([one[0], x[:, columns]]), np.hstack([one[1], corners[:, columns]])
    covariance = np.linalg.inv(design.T @ design / NOISE[name] ** 2 + np.diag(1.0 / np.square(prior)))
    return np.asarray(np.sqrt(np.einsum("mi,ij,mj->m", asked, covariance, asked)))


@pytest.mark.parametrize("down_mps2", [-0.9, 0.9])
def test_a_force_up_or_down_is_known_where_it_was_not_flown(down_mps2: float) -> None:
    wide: dict[str, list[float]] = {"lateral": [], "vertical": []}
    squared: dict[str, list[float]] = {"lateral": [], "vertical": []}
    for seed in range(6):
        rng = np.random.default_rng([5, seed])
        mass, force = rng.uniform(0.9, 1.4), np.array([*rng.uniform(-0.5, 0.5, 2), down_mps2])
        x, corners = flown(rng, mass, force)
        for name, columns in (("lateral", slice(0, 2)), ("vertical", slice(2, 3))):
            y = truth(x, mass, force)[:, columns]
            mean, variance = known(name, x, y + rng.normal(0.0, NOISE[name], y.shape)).at(corners)
            off = np.abs(mean - truth(corners, mass, force)[:, columns]) / np.sqrt(variance)[:, None]
            squared[name].append(float(np.mean(off * off)))
            wide[name].append(float(np.median(np.sqrt(variance) / linear_deviation(name, x, corners))))
    for name in squared:  # one, if deviations are what they say; of 12 independent corners 2.2 at most (99 %)
        assert np.mean(squared[name]) < 2.2, name
    assert np.mean(wide["lateral"]) < 3.2  # the rest is the smooth part, as large as is likely
    assert np.mean(wide["vertical"]) < 2.2


def test_without_such_a_force_it_is_as_if_nobody_had_asked() -> None:
    x, _ = flown(np.random.default_rng(3), 1.2, np.zeros(3))
    prior = default_priors().vertical
    y = truth(x, 1.2, np.zeros(3))[:, 2:] + np.random.default_rng(4).normal(0.0, 0.06, (len(x), 1))
    process = Process(prior.kernel, 0.06**2, x, y, np.full(1, 1e-6), force=prior.force)
    *_, sized = sized_steps(process)
    *_, without = sized_steps(replace(process, force=None))
    assert sized is not None
    assert without is not None
    assert sized.process.kernel == without.process.kernel
