"""Kernels against scikit-learn's, closed forms and finite differences; what they refuse."""

from __future__ import annotations

import json
import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import ArrayLike
from sklearn.gaussian_process import kernels as sk

from flightstack.gp import (
    Constant,
    Kernel,
    Linear,
    Matern,
    Product,
    SquaredExponential,
    Sum,
    affine_in,
    kernel_from_dict,
    program,
)
from flightstack.gp.gram import alike, linear_columns, lower_triangle, parts
from flightstack.types import F64, InputError

X = np.random.default_rng(1).normal(size=(30, 4))
Y = np.random.default_rng(2).normal(size=(7, 4))
SCALES = (0.5, 1.0, 2.0, 1.5)


def part(kernel: sk.Kernel, columns: list[int]) -> Callable[[F64, F64], F64]:
    """scikit-learn's kernel on some of the columns."""
    return lambda a, b: np.asarray(kernel(a[:, columns], b[:, columns]))


def linear(column: int) -> Callable[[F64, F64], F64]:
    return lambda a, b: np.outer(a[:, column], b[:, column])


ORACLES: list[tuple[Kernel, Callable[[F64, F64], F64]]] = [
    (SquaredExponential(1.3, SCALES), lambda a, b: 1.3 * sk.RBF(SCALES)(a, b)),
    (SquaredExponential(1.0, 0.7), sk.RBF(0.7)),
    (SquaredExponential(2.0, (0.4, 3.0), columns=(3, 1)), lambda a, b: 2.0 * part(sk.RBF([0.4, 3.0]), [3, 1])(a, b)),
    (Matern(0.5, 0.8, SCALES), lambda a, b: 0.8 * sk.Matern(SCALES, nu=0.5)(a, b)),
    (Matern(1.5, 0.8, SCALES), lambda a, b: 0.8 * sk.Matern(SCALES, nu=1.5)(a, b)),
    (Matern(2.5, 0.8, 0.6, columns=(2,)), lambda a, b: 0.8 * part(sk.Matern(0.6, nu=2.5), [2])(a, b)),
    (Constant(0.4), lambda a, b: np.full((len(a), len(b)), 0.4)),
    (Linear(0.3, 2), lambda a, b: 0.3 * linear(2)(a, b)),
    (
        SquaredExponential(1.0, 0.7) + Matern(1.5, 0.5, SCALES) + Constant(0.1),
        lambda a, b: sk.RBF(0.7)(a, b) + 0.5 * sk.Matern(SCALES, nu=1.5)(a, b) + 0.1,
    ),
    (
        (Constant(2.0) + Linear(0.5, 0)) * SquaredExponential(1.0, 0.7) * Matern(0.5, 1.0, 2.0),
        lambda a, b: (2.0 + 0.5 * linear(0)(a, b)) * sk.RBF(0.7)(a, b) * sk.Matern(2.0, nu=0.5)(a, b),
    ),
    (
        affine_in(1, SquaredExponential(0.5, 1.0, columns=(0,)), SquaredExponential(2.0, 3.0, columns=(0, 2, 3))),
        lambda a, b: 0.5 * part(sk.RBF(1.0), [0])(a, b) + linear(1)(a, b) * 2.0 * part(sk.RBF(3.0), [0, 2, 3])(a, b),
    ),
]  # fmt: skip


@pytest.mark.parametrize(("kernel", "oracle"), ORACLES)
def test_covariances_are_those_of_scikit_learn(kernel: Kernel, oracle: Callable[[F64, F64], F64]) -> None:
    np.testing.assert_allclose(kernel.matrix(X, Y), oracle(X, Y), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(kernel.matrix(X), oracle(X, X), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(kernel.diagonal(X), np.diag(oracle(X, X)), rtol=1e-12)


@pytest.mark.parametrize(("kernel", "oracle"), ORACLES)
def test_triangles_and_parts_are_of_the_same_covariances(kernel: Kernel, oracle: Callable[[F64, F64], F64]) -> None:
    for x in (X, X[:1], np.tile(X, (3, 1))):
        triangle = lower_triangle(kernel, x)
        assert triangle.flags.f_contiguous
        np.testing.assert_array_equal(triangle, np.tril(kernel.matrix(x)))  # to the last bit
        root, smooth = parts(kernel, x)
        np.testing.assert_allclose(np.tril(root @ root.T) + smooth, np.tril(oracle(x, x)), rtol=1e-12, atol=1e-15)


def test_a_kernels_part_of_rank_one_is_what_has_no_stationary_leaf() -> None:
    named, smooth = Constant(2.0) + Linear(3.0, 1) * Linear(0.5, 2), Linear(0.7, 0) * SquaredExponential(0.5, 1.0)
    found = parts(named + smooth, X)
    np.testing.assert_allclose(found.root, np.stack([0.0 * X[:, 0] + 2.0**0.5, 1.5**0.5 * X[:, 1] * X[:, 2]], axis=1))
    np.testing.assert_array_equal(found.smooth, np.tril(smooth.matrix(X)))
    assert parts(smooth, X).root.shape == (len(X), 0)
    assert not parts(named, X).smooth.any()


@pytest.mark.parametrize(("kernel", "oracle"), ORACLES)
def test_the_rate_along_a_motion_is_the_slope_of_the_covariance(
    kernel: Kernel, oracle: Callable[[F64, F64], F64]
) -> None:
    flat, points, step = kernel.program(4), np.ascontiguousarray(X.T), 1e-6
    x, rate = np.array([0.3, -0.2, 0.9, -1.1]), np.array([1.0, -2.0, 0.5, 3.0])
    work, value, slope = np.empty((program.WORK_ROWS, len(X))), np.empty(len(X)), np.empty(len(X))
    program.row((flat.ints, flat.floats), points, len(X), (x, rate), work, (value, slope), True)
    ahead, behind = oracle((x + step * rate)[None], X)[0], oracle((x - step * rate)[None], X)[0]
    np.testing.assert_allclose(value, oracle(x[None], X)[0], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(slope, (ahead - behind) / (2 * step), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(("kernel", "oracle"), ORACLES)
def test_the_gradient_by_theta_is_the_slope_of_a_weighted_sum(
    kernel: Kernel, oracle: Callable[[F64, F64], F64]
) -> None:
    weights = np.random.default_rng(3).normal(size=(len(X), len(X)))
    weights += weights.T
    step, slopes = 1e-6, []
    for shift in step * np.eye(kernel.size):
        ahead, behind = (kernel.with_theta(kernel.theta + side * shift).matrix(X) for side in (1, -1))
        slopes.append(np.sum(weights * (ahead - behind)) / (2 * step))
    found = program.gradient(kernel.program(4), X, weights)
    np.testing.assert_allclose(found, slopes, rtol=1e-6, atol=1e-6)


def test_columns_that_a_kernel_has_in_terms_of_their_own_alone() -> None:
    kernel = (
        Constant(2.0) + Linear(3.0, 1) + Linear(0.5, 2) * Linear(0.1, 0) + Linear(4.0, 1) + Matern(1.5, 1.0, 2.0, (3,))
    )
    columns, variances = linear_columns(kernel.program(6), 6)
    assert columns.tolist() == [1, 4, 5]
    assert variances.tolist() == [7.0, 0.0, 0.0]


def test_rows_that_are_alike_but_for_some_columns() -> None:
    x = np.array([[1.0, 2.0, 3.0], [1.0, 2.5, 3.0], [1.0, 2.0, 4.0], [1.0 + 1e-15, 0.0, 3.0], [1.0 + 1e-9, 0.0, 3.0]])
    places, first = alike(x, np.array([1]))
    assert places.tolist() == [0, 0, 1, 0, 2]
    assert first.tolist() == [0, 2, 4]


def test_a_motion_through_a_held_point_has_finite_rates() -> None:
    for nu in (0.5, 1.5, 2.5):
        flat, points = Matern(nu, 1.0, 1.0).program(4), np.ascontiguousarray(X.T)
        work, value, slope = np.empty((program.WORK_ROWS, len(X))), np.empty(len(X)), np.empty(len(X))
        program.row((flat.ints, flat.floats), points, len(X), (X[4], np.ones(4)), work, (value, slope), True)
        assert value[4] == 1.0
        assert slope[4] == 0.0
        assert np.isfinite(slope).all()


@pytest.mark.parametrize("distance", [0.0, 1e-9, 0.3, 1.0, 7.0, 21.0])
def test_the_exponential_is_good_to_its_last_bits(distance: float) -> None:
    found = SquaredExponential(1.0, 1.0).matrix(np.zeros((1, 1)), np.full((1, 1), distance))[0, 0]
    assert found == pytest.approx(math.exp(-0.5 * distance * distance), rel=5e-16, abs=0.0)


@pytest.mark.parametrize("kernel", [SquaredExponential(3.0, 1.0), Matern(0.5, 3.0, 1.0), Matern(2.5, 3.0, 1.0)])
@pytest.mark.parametrize("distance", [1e3, 1e9, 1e200])
def test_far_away_nothing_is_left(kernel: Kernel, distance: float) -> None:
    assert 0.0 <= kernel.matrix(np.zeros((1, 1)), np.full((1, 1), distance))[0, 0] < 1e-80


def test_theta_is_the_logarithm_of_the_hyper_parameters_from_left_to_right() -> None:
    kernel = SquaredExponential(2.0, (3.0, 4.0)) + Linear(5.0, 0) * Matern(1.5, 6.0, 7.0)
    np.testing.assert_allclose(np.exp(kernel.theta), [2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
    assert kernel.size == 6
    changed = kernel.with_theta(np.log([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    np.testing.assert_allclose(np.exp(changed.theta), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert isinstance(changed, Sum)
    assert isinstance(changed.right, Product)
    with pytest.raises(InputError, match="6 hyper-parameters"):
        kernel.with_theta([0.0])


def test_equal_expressions_are_equal_and_hash_alike() -> None:
    a = SquaredExponential(1.0, np.array([1.0, 2.0])) + Constant(1)  # type: ignore[arg-type]
    b = SquaredExponential(1.0, (1.0, 2.0)) + Constant(1.0)
    assert a == b
    assert hash(a) == hash(b)
    assert a != SquaredExponential(1.0, (1.0, 2.5)) + Constant(1.0)


@pytest.mark.parametrize(("kernel", "oracle"), ORACLES)
def test_a_kernel_survives_json(kernel: Kernel, oracle: object) -> None:
    assert kernel_from_dict(json.loads(json.dumps(kernel.to_dict()))) == kernel


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (3, "must be a table"),
        ({"kernel": "cosine"}, "kernel.kernel = 'cosine' is not known; known are"),
        ({"kernel": ["constant"]}, "is not known"),
        ({"kernel": "constant"}, "kernel.variance is missing"),
        ({"kernel": "constant", "variance": "1"}, "variance = '1' is not allowed"),
        ({"kernel": "constant", "variance": 1.0, "mean": 0.0}, "unknown key mean"),
        ({"kernel": "linear", "variance": 1.0, "column": 0.5}, "column = 0.5"),
        ({"kernel": "matern", "nu": 2, "variance": 1.0, "lengthscales": 1.0}, "0.5, 1.5 or 2.5"),
        ({"kernel": "squared_exponential", "variance": 1.0, "lengthscales": "ab"}, "lengthscales"),
        ({"kernel": "squared_exponential", "variance": 1.0, "lengthscales": 1.0, "columns": 3}, "columns = 3"),
        ({"kernel": "sum", "left": {"kernel": "constant", "variance": 1.0}}, "kernel.right is missing"),
        ({"kernel": "sum", "left": {"kernel": "constant", "variance": 0}, "right": {}}, "kernel.left: Constant"),
    ],
)
def test_a_wrong_table_is_refused_in_one_line_that_names_the_place(data: object, words: str) -> None:
    with pytest.raises(InputError) as caught:
        kernel_from_dict(data)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


BAD: list[ArrayLike] = [math.nan, math.inf, 0.0, -1.0]


@pytest.mark.parametrize("bad", BAD)
def test_hyper_parameters_that_are_not_positive_numbers_are_refused(bad: float) -> None:
    for make in (
        lambda: Constant(bad),
        lambda: Linear(bad, 0),
        lambda: SquaredExponential(bad, 1.0),
        lambda: SquaredExponential(1.0, bad),
        lambda: SquaredExponential(1.0, (1.0, bad)),
        lambda: Matern(1.5, 1.0, bad),
    ):
        with pytest.raises(InputError, match="is not allowed"):
            make()


def test_columns_and_lengthscales_must_fit_each_other_and_the_input() -> None:
    with pytest.raises(InputError, match="2 lengthscales for 1 columns"):
        SquaredExponential(1.0, (1.0, 2.0), columns=(0,))
    with pytest.raises(InputError, match="name each column once"):
        SquaredExponential(1.0, 1.0, columns=(1, 1))
    with pytest.raises(InputError, match="lengthscales is empty"):
        SquaredExponential(1.0, ())
    with pytest.raises(InputError, match="column number"):
        Linear(1.0, -1)
    with pytest.raises(InputError, match="column 5 is not there; inputs have 4"):
        Linear(1.0, 5).matrix(X)
    with pytest.raises(InputError, match="2 given for 4 input columns"):
        SquaredExponential(1.0, (1.0, 2.0)).matrix(X)
