"""The two sets: one follows the flight, the other covers a region and stays."""

from __future__ import annotations

import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from flightstack.gp import SquaredExponential
from flightstack.learning.priors import Prior
from flightstack.learning.store import Store
from flightstack.types import F64

PRIOR = Prior(SquaredExponential(1.0, (1.0, 1.0)), 0.01)


def path(count: int) -> F64:
    """Out along a line for the first half, then at rest at its end."""
    t = np.minimum(np.linspace(0.0, 12.0, count), 6.0)
    return np.stack([t, 0.3 * np.sin(t)], axis=1)


def filled(count: int = 200, capacity: int = 40) -> Store:
    store = Store(PRIOR, inputs=2, outputs=1, capacity=capacity, floor=0.01)
    rng = np.random.default_rng(4)
    for x in path(count):
        store.take(x, np.array([np.sin(x[0])]) + rng.normal(scale=0.1, size=1))
    return store


def test_the_tracking_set_forgets_where_it_has_been_the_certificate_set_does_not() -> None:
    store, queries = filled(), path(50)
    certificate = store.certificate_set(queries, 30)
    assert len(certificate) == 30
    _, tracking_var = store.gp.predict(queries)
    _, certificate_var = certificate.predict(queries)
    assert tracking_var.max() > 0.9, "nothing is left of the way out"
    assert certificate_var.max() < 0.05


def test_the_certificate_set_is_an_exact_process_over_its_points() -> None:
    store, queries = filled(), path(20)
    certificate = store.certificate_set(queries, 25)
    oracle = GaussianProcessRegressor(ConstantKernel(1.0, "fixed") * RBF(1.0, "fixed"), alpha=0.01, optimizer=None)
    oracle.fit(certificate.x, certificate.y[:, 0])
    mean, std = oracle.predict(queries, return_std=True)
    ours, variance = certificate.predict(queries)
    np.testing.assert_allclose(ours[:, 0], mean, atol=1e-9)
    np.testing.assert_allclose(variance[:, 0], std**2, atol=1e-9)


def test_learning_on_does_not_change_a_certificate_set() -> None:
    store, queries = filled(), path(20)
    certificate = store.certificate_set(queries, 25)
    before, _ = certificate.predict(queries)
    for x in path(60):
        store.take(x + 0.3, np.array([5.0]))
    np.testing.assert_allclose(certificate.predict(queries)[0], before, atol=1e-12)


def test_after_a_change_the_pool_holds_only_what_came_since() -> None:
    store = filled()
    store.renew(np.array([2.0]), 3)
    for x in path(3):
        store.take(x, np.array([2.0]))
    assert len(store.certificate_set(path(10), 100)) == 3


def test_an_empty_pool_gives_the_prior() -> None:
    store = Store(PRIOR, inputs=2, outputs=1, capacity=10, floor=0.01)
    _, variance = store.certificate_set(path(5), 10).predict(path(5))
    np.testing.assert_allclose(variance, 1.0)
