"""The two sets: one follows the flight, the other covers a region and stays."""

from __future__ import annotations

import numpy as np
import pytest

from flightstack.gp import RecursiveGP, SquaredExponential, spread
from flightstack.gp.relevance import Spread
from flightstack.learning.priors import StorePrior
from flightstack.learning.store import Evidence, Store
from flightstack.types import F64

PRIOR = StorePrior(SquaredExponential(1.0, (1.0, 1.0)), 0.01)


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


def certificate_set(evidence: Evidence, count: int) -> tuple[F64, F64]:
    """Places and values of those pooled points that a certificate is made from."""
    chosen = evidence.chosen(count)
    return evidence.places[chosen], evidence.values[chosen]


def certificate(store: Store, count: int) -> RecursiveGP:
    gp = RecursiveGP(PRIOR.kernel, PRIOR.noise_var, input_dim=2, output_dim=1, capacity=max(count, 1))
    x, y = certificate_set(store.evidence(), count)
    if len(x):
        gp.add(x, y)
    return gp


def test_the_tracking_set_forgets_where_it_has_been_the_certificate_set_does_not() -> None:
    store, queries = filled(), path(50)
    gp = certificate(store, 40)
    assert len(gp) == 40
    _, tracking_var = store.gp.predict(queries)
    _, certificate_var = gp.predict(queries)
    assert tracking_var.max() > 0.9, "nothing is left of the way out"
    assert certificate_var.max() < 0.05


def test_a_certificate_set_is_of_what_was_taken() -> None:
    store = filled()
    places, values = store.evidence().pooled()
    held = {(*x, *y) for x, y in zip(places.tolist(), values.tolist(), strict=True)}
    x, y = certificate_set(store.evidence(), 25)
    assert {(*a, *b) for a, b in zip(x.tolist(), y.tolist(), strict=True)} <= held
    np.testing.assert_array_equal(store.evidence().pooled(3)[0], path(200)[-3:])


def test_what_was_seen_once_far_out_is_not_forgotten_however_long_it_hovers_after() -> None:
    store = Store(PRIOR, inputs=2, outputs=1, capacity=10, floor=0.01)
    rng = np.random.default_rng(6)
    near = rng.normal(scale=0.02, size=(6000, 2))
    near[:40] = rng.uniform(-1.0, 1.0, (40, 2))
    for x in near:
        store.take(x, np.zeros(1))
    places = store.evidence().pooled()[0]
    assert len(places) <= 2000
    for ends in (np.min, np.max):
        np.testing.assert_array_equal(ends(places, axis=0), ends(near, axis=0))
        np.testing.assert_array_equal(ends(certificate_set(store.evidence(), 100)[0], axis=0), ends(near, axis=0))
    np.testing.assert_array_equal(
        store.evidence().pooled(400)[0], near[-400:], err_msg="the newest are all there, in their order"
    )


def test_a_full_pool_is_thinned_a_little_with_every_point(monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[int] = []
    carry_on = Spread.carry_on
    monkeypatch.setattr(
        Spread, "carry_on", lambda self: (steps.append(len(store.evidence().places)), carry_on(self))[1]
    )
    store = Store(PRIOR, inputs=2, outputs=1, capacity=10, floor=0.01)
    near = np.random.default_rng(6).normal(size=(2000, 2))
    for x in near:
        store.take(x, np.zeros(1))
    places = store.evidence().pooled()[0]
    assert len(steps) > 3
    assert len(steps) == len(set(steps)), "two directions with one point"
    monkeypatch.undo()
    np.testing.assert_array_equal(places, np.concatenate([near[:1500][spread(near[:1500], 500)], near[1500:]]))


def test_learning_on_does_not_change_a_certificate_set() -> None:
    store = filled()
    x, y = certificate_set(store.evidence(), 25)
    before = x.copy(), y.copy()
    for place in path(60):
        store.take(place + 0.3, np.array([5.0]))
    np.testing.assert_array_equal(x, before[0])
    np.testing.assert_array_equal(y, before[1])


def test_evidence_is_as_of_its_time() -> None:
    store = filled()
    then, excess = store.evidence(), store.excess.copy()
    x, y = certificate_set(then, 25)
    for place in path(60):
        store.take(place + 0.3, np.array([5.0]))
    store.hear(2.0)
    assert store.excess[0] > 10.0 * excess[0]
    np.testing.assert_array_equal(then.excess, excess)
    for now, before in zip(certificate_set(then, 25), (x, y), strict=True):
        np.testing.assert_array_equal(now, before)
    assert then.noise_var == PRIOR.noise_var


def test_after_a_change_the_pool_holds_only_what_came_since() -> None:
    store = filled()
    store.renew(np.array([2.0]), 3)
    for x in path(3):
        store.take(x, np.array([2.0]))
    assert len(certificate_set(store.evidence(), 100)[0]) == 3


def test_an_empty_pool_gives_no_points() -> None:
    store = Store(PRIOR, inputs=2, outputs=1, capacity=10, floor=0.01)
    x, y = certificate_set(store.evidence(), 10)
    assert x.shape == (0, 2)
    assert y.shape == (0, 1)


def test_another_noise_is_taken_over_some_points_at_a_time_while_windows_come_and_go() -> None:
    """Against the exact posterior (NumPy) of the points held, which are those of a store that heard nothing."""
    store, deaf = filled(), filled()
    store.hear(0.04)
    fresh = np.random.default_rng(7).uniform(-1.0, 1.0, (3, 2))
    for turn in range(17):  # 40 points, 3 in each turn, then one in each of the 3 that came meanwhile
        assert store.gp.noise_var == 0.01
        if turn % 4 == 0 and turn < 10:
            for each in (store, deaf):
                each.take(fresh[turn // 4], np.array([0.3]))
        store.carry_on()
    assert store.gp.noise_var == 0.04
    for each in (store, deaf):  # goes on as before: the oldest leaves
        each.take(np.array([0.5, 0.5]), np.array([0.1]))
    np.testing.assert_array_equal(store.gp.x, deaf.gp.x)
    np.testing.assert_array_equal(store.gp.y, deaf.gp.y)
    x, query = store.gp.x, np.array([5.5, 0.1])

    def k(a: F64, b: F64) -> F64:
        return np.exp(-0.5 * ((a[:, None] - b[None]) ** 2).sum(axis=2))

    weights = np.linalg.solve(k(x, x) + 0.04 * np.eye(len(x)), k(x, query[None]))[:, 0]
    mean, variance = store.gp.predict(query)
    np.testing.assert_allclose(mean, weights @ store.gp.y, atol=1e-9)
    np.testing.assert_allclose(variance, 1.0 - weights @ k(x, query[None])[:, 0], atol=1e-9)


def test_a_change_noticed_meanwhile_leaves_the_old_points_behind() -> None:
    store = filled()
    store.hear(0.04)
    store.carry_on()
    store.renew(np.array([3.0]), points=2)
    for _ in range(2):
        store.take(np.array([1.0, 0.0]), np.array([4.0]))
    for _ in range(20):
        store.carry_on()
    assert len(store.gp) == 2
    store.hear(0.04)  # few points: at once
    assert store.gp.noise_var == 0.04
    assert len(store.gp) == 2
