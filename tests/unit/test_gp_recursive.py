"""The recursive process on given cases; scikit-learn's exact process is the oracle."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF

from flightstack.gp import Constant, Kernel, Linear, Matern, RecursiveGP, SquaredExponential, affine_in
from flightstack.types import F64, InputError

SCALES = np.linspace(1.0, 2.0, 9)
SMOOTH = SquaredExponential(1.0, tuple(SCALES))


def path(count: int) -> tuple[F64, F64]:
    """(count, 9) inputs and (count, 6) values of a smooth flight, sampled at 250 Hz."""
    t = np.arange(count)[:, None] / 250.0
    pace = np.array([0.6, 0.9, 0.6, 0.7, 0.45, 1.1, 0.8, 0.33, 0.5])
    x = 1.5 * np.sin(pace * t + np.arange(9)) + 0.5 * np.sin(2.3 * pace * t)
    return x, np.sin(x[:, :6]) + 0.3 * np.roll(x, -1, axis=1)[:, :6]


def exact(gp: RecursiveGP, query: F64) -> tuple[F64, F64]:
    """Mean (P,) and variance by scikit-learn on the points that `gp` holds."""
    regressor = GaussianProcessRegressor(RBF(SCALES), alpha=gp.noise_var, optimizer=None).fit(gp.x, gp.y)
    mean, sigma = regressor.predict(query[None], return_std=True)
    return np.ravel(mean), np.ravel(sigma)[0] ** 2


def dense(gp: RecursiveGP, query: F64) -> tuple[F64, float]:
    """The same for any kernel, by plain linear algebra."""
    gram = gp.kernel.matrix(gp.x) + gp.noise_var * np.eye(len(gp))
    k = gp.kernel.matrix(query[None], gp.x)[0]
    return k @ np.linalg.solve(gram, gp.y), float(gp.kernel.diagonal(query[None])[0] - k @ np.linalg.solve(gram, k))


def small(capacity: int = 10, kernel: Kernel | None = None, noise_var: float = 1e-2, outputs: int = 2) -> RecursiveGP:
    kernel = kernel or SquaredExponential(2.0, 1.0)
    return RecursiveGP(kernel, noise_var, input_dim=3, output_dim=outputs, capacity=capacity)


def draws(count: int, seed: int = 0) -> tuple[F64, F64]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 3)), rng.normal(size=(count, 2))


@pytest.mark.parametrize(("noise_var", "mean_rtol", "variance_rtol"), [(1e-2, 1e-9, 1e-7), (1e-4, 1e-9, 1e-8)])
def test_after_many_exchanges_on_a_flight_the_numbers_are_those_of_a_fresh_fit(
    noise_var: float, mean_rtol: float, variance_rtol: float
) -> None:
    x, y = path(12_002)
    gp = RecursiveGP(SMOOTH, noise_var, input_dim=9, output_dim=6, capacity=150)
    least = np.inf
    for i in range(12_000):
        gp.add(x[i], y[i])
        least = min(least, gp.predict(x[i + 1])[1][0])
        if i % 1000 == 999:
            for query in (x[i + 1], x[i + 1] + 0.3):
                mean, variance = gp.predict(query)
                true_mean, true_variance = exact(gp, query)
                np.testing.assert_allclose(mean, true_mean, rtol=0.0, atol=mean_rtol * np.abs(true_mean).max())
                np.testing.assert_allclose(variance, true_variance, rtol=variance_rtol)
    assert least > 0.0
    assert gp.health.clipped == 0


def test_with_hardly_any_noise_it_stays_well_defined() -> None:
    x, y = path(5_002)
    gp = RecursiveGP(SMOOTH, 1e-6, input_dim=9, output_dim=6, capacity=150)
    for i in range(5_000):
        gp.add(x[i], y[i])
        mean, variance = gp.predict(x[i + 1])
        assert variance[0] > 0.0
    true_mean, true_variance = exact(gp, x[5_000])
    np.testing.assert_allclose(mean, true_mean, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(variance, true_variance, rtol=1e-3)


def test_a_residual_that_is_tolerated_puts_no_variance_off_by_more() -> None:
    x, y = path(4_002)
    gp = RecursiveGP(SMOOTH, 1e-5, input_dim=9, output_dim=6, capacity=150, tolerance=1e-3)
    for i in range(4_000):
        gp.add(x[i], y[i])
        mean, variance = gp.predict(x[i + 1])
        if i % 211 == 210:
            true_mean, true_variance = exact(gp, x[i + 1])
            np.testing.assert_allclose(mean, true_mean, rtol=0.0, atol=1e-5)
            np.testing.assert_allclose(variance, true_variance, rtol=1.1e-3)
    assert 1e-9 < gp.health.worst_drift < 1e-3


def test_begun_anew_with_another_noise_nothing_of_before_is_left() -> None:
    x, y = path(400)
    used, fresh = (RecursiveGP(SMOOTH, noise, input_dim=9, output_dim=6, capacity=100) for noise in (1e-2, 1e-3))
    used.add(x[:250], y[:250])
    used.remove([3, 50, 98])
    used.restart(1e-3)
    for i in range(130):
        for gp in (used, fresh):
            gp.add(x[i], y[i])
        np.testing.assert_array_equal(used.predict(x[i + 1]), fresh.predict(x[i + 1]))
    assert used.noise_var == 1e-3


def test_an_inverse_that_is_spoilt_is_noticed_and_mended() -> None:
    x, y = path(3_000)
    gp = RecursiveGP(SMOOTH, 1e-2, input_dim=9, output_dim=6, capacity=100)
    gp.add(x[:500], y[:500])
    gp.predict(x[500])
    gp._arrays[0][0, :4000] *= 1.0 + 1e-3 * np.random.default_rng(0).normal(size=4000)
    for i in range(500, 520):
        gp.add(x[i], y[i])
        mean, variance = gp.predict(x[i + 1])
    true_mean, true_variance = exact(gp, x[520])
    assert gp.health.rebuilt == 1
    np.testing.assert_allclose(mean, true_mean, atol=1e-9)
    np.testing.assert_allclose(variance, true_variance, rtol=1e-6)


def test_the_inverse_is_computed_anew_after_so_many_points() -> None:
    x, y = draws(100)
    gp = RecursiveGP(Constant(1.0), 0.1, input_dim=3, output_dim=2, capacity=8, rebuild_steps=10)
    gp.add(x, y)
    assert gp.health.rebuilt == 9
    np.testing.assert_allclose(gp.predict(x[0])[0], y[-8:].sum(0) / (8 + 0.1))  # mean of a constant, by hand


def test_without_points_it_is_the_prior() -> None:
    gp = small(kernel=SquaredExponential(2.0, 1.0) + Linear(0.5, 0))
    mean, variance = gp.predict(np.array([2.0, 0.0, 0.0]))
    assert mean.tolist() == [0.0, 0.0]
    assert variance.tolist() == [4.0, 4.0]
    assert gp.prior_variance(np.array([2.0, 0.0, 0.0])) == 4.0
    np.testing.assert_array_equal(gp.predict_along(np.ones(3), np.ones(3)), np.zeros((2, 2)))
    assert (len(gp), gp.x.shape, gp.y.shape) == (0, (0, 3), (0, 2))


def test_far_from_all_points_it_is_the_prior() -> None:
    gp = small()
    gp.add(*draws(10))
    mean, variance = gp.predict(np.full(3, 1e6))
    np.testing.assert_allclose(mean, 0.0, atol=1e-80)
    np.testing.assert_array_equal(variance, 2.0)


def test_one_point_is_the_closed_form() -> None:
    gp = small()
    gp.add(np.zeros(3), np.array([1.0, -2.0]))
    k = 2.0 * np.exp(-0.5)
    mean, variance = gp.predict(np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(mean, k / 2.01 * np.array([1.0, -2.0]), rtol=1e-14)
    np.testing.assert_allclose(variance, 2.0 - k * k / 2.01, rtol=1e-14)


def test_the_last_point_takes_the_index_of_the_one_that_leaves() -> None:
    gp, (x, y) = small(), draws(6)
    gp.add(x, y)
    gp.remove(1)
    assert len(gp) == 5
    np.testing.assert_array_equal(gp.x, x[[0, 5, 2, 3, 4]])
    np.testing.assert_array_equal(gp.y, y[[0, 5, 2, 3, 4]])
    gp.add(x[1], y[1])
    np.testing.assert_array_equal(gp.x, x[[0, 5, 2, 3, 4, 1]])
    gp.remove([0, 5])  # as they stand: points 0 and 1
    assert sorted(gp.x[:, 0]) == sorted(x[[2, 3, 4, 5], 0])
    gp.rebuild()
    assert sorted(gp.x[:, 0]) == sorted(x[[2, 3, 4, 5], 0])


def test_a_full_store_lets_its_oldest_point_go_first() -> None:
    gp, (x, y) = small(capacity=4), draws(7)
    assert gp.add(x, y) == 7
    assert len(gp) == 4
    assert {tuple(row) for row in gp.x} == {tuple(row) for row in x[3:]}


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_left_out_and_counted(bad: float) -> None:
    gp, (x, y) = small(), draws(3)
    gp.add(x, y)
    before = gp.predict(x[0])
    assert gp.add(np.array([0.0, bad, 0.0]), y[0]) == 0
    assert gp.add(x[0], np.array([bad, 0.0])) == 0
    assert gp.add(np.array([[0.5, 0.5, 0.5], [bad, 0.0, 0.0]]), y[:2]) == 1
    assert (gp.health.rejected, len(gp)) == (3, 4)
    for answer in (gp.predict(np.array([bad, 0.0, 0.0])), gp.predict_along(np.zeros(3), np.array([bad, 0.0, 0.0]))):
        assert np.isnan(answer).all()
    gp.remove(3)
    np.testing.assert_allclose(gp.predict(x[0]), before, rtol=1e-12)


def test_a_point_left_out_takes_nobody_s_place() -> None:
    gp, (x, y) = small(capacity=3), draws(3)
    gp.add(x, y)
    assert gp.add(np.full(3, np.nan), y[0]) == 0
    np.testing.assert_array_equal(gp.x, x)
    gp.remove(0)
    assert gp.add(np.full(3, np.nan), y[0]) == 0
    np.testing.assert_array_equal(gp.x, x[[2, 1]])
    np.testing.assert_allclose(gp.predict(x[0])[0], dense(gp, x[0])[0], rtol=1e-12)


def test_a_point_whose_prior_variance_overflows_is_left_out() -> None:
    gp = small(kernel=Linear(1e50, 0))
    assert gp.add(np.array([1e200, 0.0, 0.0]), np.zeros(2)) == 0
    assert gp.health.rejected == 1


def test_a_point_added_twice_counts_as_two_measurements() -> None:
    gp, point = small(), np.array([0.1, 0.2, 0.3])
    for _ in range(8):
        gp.add(point, np.array([1.0, 3.0]))
    mean, variance = gp.predict(point)
    np.testing.assert_allclose(mean, np.array([1.0, 3.0]) * 2.0 / (2.0 + 1e-2 / 8), rtol=1e-12)
    np.testing.assert_allclose(variance, 2.0 * (1e-2 / 8) / (2.0 + 1e-2 / 8), rtol=1e-9)


def test_copies_of_a_point_without_noise_to_speak_of_do_no_harm() -> None:
    gp = small(capacity=50, noise_var=1e-18)
    for i in range(200):
        assert gp.add(np.full(3, 0.1 * (i % 3)), np.array([1.0, 2.0])) == 1
        mean, variance = gp.predict(np.full(3, 0.1))
        assert variance[0] > 0.0
        assert np.isfinite(mean).all()
    gp.rebuild()
    np.testing.assert_allclose(gp.predict(np.full(3, 0.1))[0], [1.0, 2.0], rtol=1e-3)
    assert gp.health.jitter > 0.0


@pytest.mark.parametrize(
    "kernel",
    [
        SquaredExponential(1.0, 1.0) + Constant(0.5),
        Matern(2.5, 1.0, 0.8) * Linear(1.0, 1),
        affine_in(2, SquaredExponential(0.5, 1.0, columns=(0, 1)), Matern(1.5, 1.0, 2.0, columns=(0,))),
    ],
)
def test_the_rate_of_the_mean_is_its_slope_along_the_motion(kernel: Kernel) -> None:
    gp, rate, step = small(30, kernel), np.array([0.4, -1.0, 2.0]), 1e-5
    gp.add(*draws(40))
    gp.remove(3)
    x = np.array([0.2, 0.5, -0.3])
    mean, mean_rate = gp.predict_along(x, rate)
    np.testing.assert_allclose(mean, dense(gp, x)[0], rtol=1e-9)
    slope = (dense(gp, x + step * rate)[0] - dense(gp, x - step * rate)[0]) / (2 * step)
    np.testing.assert_allclose(mean_rate, slope, rtol=1e-6, atol=1e-8)


def test_outputs_that_share_a_factorisation_are_those_of_separate_processes() -> None:
    (x, y), together = draws(25), small(12)
    apart = [small(12, outputs=1) for _ in range(2)]
    for i in range(25):
        together.add(x[i], y[i])
        for p, gp in enumerate(apart):
            gp.add(x[i], y[i, p : p + 1])
    mean, variance = together.predict(x[7])
    for p, gp in enumerate(apart):
        alone = gp.predict(x[7])
        np.testing.assert_allclose([mean[p], variance[p]], np.ravel(alone), rtol=1e-12)


def test_many_queries_are_the_same_as_one_by_one() -> None:
    gp, (x, y) = small(), draws(10)
    gp.add(x, y)
    mean, variance = gp.predict(x)
    assert mean.shape == variance.shape == (10, 2)
    np.testing.assert_allclose(mean[4], gp.predict(x[4])[0], rtol=1e-13)
    assert gp.predict(np.empty((0, 3)))[0].shape == (0, 2)


def test_any_array_of_the_right_shape_will_do() -> None:
    gp, (x, y) = small(), draws(4)
    frozen = x.copy()
    frozen.setflags(write=False)
    gp.add(frozen[0], y[0])
    gp.add(x.T.copy().T[1], np.asfortranarray(y)[1])
    gp.add(x[2].astype(np.float32), [1, 2])
    gp.add([0.0, 1, 2], (3, 4.0))
    np.testing.assert_allclose(gp.x[:2], x[:2])
    np.testing.assert_allclose(gp.predict(frozen[0]), gp.predict(list(x[0])))
    one = small(outputs=1)
    assert one.add(x[0], 2.0) == 1
    assert one.add(x, y[:, 0]) == 4


def test_clearing_forgets_the_points() -> None:
    gp, (x, y) = small(), draws(10)
    gp.add(x, y)
    gp.remove(2)
    gp.clear()
    assert len(gp) == 0
    assert gp.predict(x[0])[1][0] == 2.0
    gp.add(x[:4], y[:4])
    np.testing.assert_allclose(gp.predict(x[5])[0], dense(gp, x[5])[0], rtol=1e-12)


def test_the_same_calls_give_the_same_bytes() -> None:
    results = []
    for _ in range(2):
        gp, (x, y) = small(20), draws(200)
        gp.add(x, y)
        results.append(np.array(gp.predict(x)).tobytes())
    assert results[0] == results[1]


@pytest.mark.parametrize("name", ["noise_var", "input_dim", "output_dim", "capacity"])
@pytest.mark.parametrize("bad", [0, -1, np.nan, np.inf])
def test_a_process_that_makes_no_sense_is_refused(name: str, bad: float) -> None:
    settings = {"noise_var": 1e-2, "input_dim": 3, "output_dim": 2, "capacity": 5, name: bad}
    with pytest.raises(InputError, match=f"{name} = .* is not allowed"):
        RecursiveGP(Constant(1.0), settings.pop("noise_var"), **settings)  # type: ignore[arg-type]


def test_arrays_of_the_wrong_shape_are_refused() -> None:
    gp, (x, y) = small(), draws(4)
    gp.add(x, y)
    for call in (
        lambda: gp.add(x[0, :2], y[0]),
        lambda: gp.add(x[0], y[0, :1]),
        lambda: gp.add(x, y[:3]),
        lambda: gp.add(x[:, :2], y),
        lambda: gp.predict(x[0, :2]),
        lambda: gp.predict(x[:, :2]),
        lambda: gp.predict_along(x[0], x[0, :2]),
    ):
        with pytest.raises(InputError, match=r"fit"):
            call()
    for index in (-1, 4):
        with pytest.raises(InputError, match="is not held"):
            gp.remove(index)
    assert len(gp) == 4
