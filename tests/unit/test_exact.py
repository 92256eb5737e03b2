"""Rational polynomials and the exact check of a sum of squares; oracles: NumPy, closed forms, and proofs spoiled."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import polynomial as npp

from flightstack.types import InputError
from flightstack_paper.exact import (
    ExactPolynomial,
    Matrix,
    Proof,
    along,
    as_ellipse,
    check,
    ellipse,
    gram_form,
    leading_minors,
    leaves_between,
    monomials,
    positive_definite,
    proof_from_dict,
    proof_to_dict,
)

DISC = (ExactPolynomial({(1, 0): -1, (3, 0): 1, (1, 2): 1}), ExactPolynomial({(0, 1): -1, (2, 1): 1, (0, 3): 1}))
"""r' = -r (1 - r^2) along every ray: the open unit disc is the region of attraction of the origin."""

fractions = st.fractions(min_value=-4, max_value=4, max_denominator=64)
polynomials = st.dictionaries(st.tuples(st.integers(0, 4), st.integers(0, 4)), fractions, max_size=8).map(
    ExactPolynomial
)
points = st.tuples(fractions, fractions)


def array(polynomial: ExactPolynomial) -> np.ndarray:
    """Coefficients as NumPy's polynomial functions want them."""
    coefficients = np.zeros((10, 10))
    for (i, j), value in polynomial.terms.items():
        coefficients[i, j] = float(value)
    return coefficients


def at(polynomial: ExactPolynomial, x: tuple[Fraction, Fraction]) -> float:
    return float(npp.polyval2d(float(x[0]), float(x[1]), array(polynomial)))


@given(polynomials, polynomials, points)
def test_arithmetic_is_that_of_values(p: ExactPolynomial, q: ExactPolynomial, x: tuple[Fraction, Fraction]) -> None:
    assert (p + q)(*x) == p(*x) + q(*x)
    assert (p - q)(*x) == p(*x) - q(*x)
    assert (p * q)(*x) == p(*x) * q(*x)
    size = sum(abs(float(v)) * 4.0 ** (i + j) for (i, j), v in p.terms.items()) + 1.0
    assert float(p(*x)) == pytest.approx(at(p, x), abs=1e-12 * size)


@given(polynomials, polynomials)
def test_derivatives_are_numpys_and_products_have_the_right_degree(p: ExactPolynomial, q: ExactPolynomial) -> None:
    for state in (0, 1):
        expected = npp.polyder(array(p), axis=state)
        got = array(p.derivative(state))
        np.testing.assert_allclose(got[: expected.shape[0], : expected.shape[1]], expected, rtol=1e-15)
    if p.terms and q.terms:
        assert (p * q).degree == p.degree + q.degree
    assert (p - p).terms == {}


@given(st.lists(st.integers(-9, 9), min_size=16, max_size=16), st.integers(0, 20))
def test_leading_minors_are_determinants(numbers: list[int], shift: int) -> None:
    square = np.array(numbers).reshape(4, 4)
    floats = (square + square.T + 2 * shift * np.eye(4)) / 7.0
    matrix = tuple(tuple(Fraction(round(7.0 * value), 7) for value in row) for row in floats)
    for k, minor in enumerate(leading_minors(matrix), 1):
        assert float(minor) == pytest.approx(np.linalg.det(floats[:k, :k]), rel=1e-9, abs=1e-9)
    least = np.linalg.eigvalsh(floats)[0]
    if abs(least) > 1e-9:
        assert positive_definite(matrix) == (least > 0.0)


def test_minors_of_the_hilbert_matrix_are_exact() -> None:
    # Hilbert 1894: det H_n = c_n^4 / c_2n, c_n = prod i!
    def c(n: int) -> int:
        return math.prod(math.factorial(i) for i in range(1, n))

    hilbert = tuple(tuple(Fraction(1, i + j + 1) for j in range(8)) for i in range(8))
    assert leading_minors(hilbert) == [Fraction(c(n) ** 4, c(2 * n)) for n in range(1, 9)]


def test_a_singular_or_unsymmetric_matrix_is_not_positive_definite() -> None:
    one, two = Fraction(1), Fraction(2)
    assert not positive_definite(((one, one), (one, one)))
    assert not positive_definite(((two, one), (Fraction(0), two)))
    assert not positive_definite(((Fraction(0),),))
    assert positive_definite(((two, one), (one, two)))


def test_gram_form_of_all_ones_is_the_square_of_the_sum() -> None:
    basis = monomials(2)
    ones: Matrix = tuple(tuple(Fraction(1) for _ in basis) for _ in basis)
    total = ExactPolynomial(dict.fromkeys(basis, 1))
    assert gram_form(basis, ones) == total * total
    assert len(basis) == 6


def test_decimal_text_is_taken_as_written() -> None:
    assert ExactPolynomial({(0, 0): "0.1"})[0, 0] == Fraction(1, 10)
    with pytest.raises(ValueError, match="below 0"):
        ExactPolynomial({(-1, 0): 1})


def test_ellipse_and_its_shape_agree() -> None:
    h = ellipse("1.5", "0.25", 2, "0.5", "-0.75") * 3
    shape = as_ellipse(h)
    assert shape.centre == (Fraction(1, 2), Fraction(-3, 4))
    assert shape.level == 3
    assert shape.area == pytest.approx(math.pi / math.sqrt(1.5 * 2 - 0.25**2), rel=1e-14)
    for flat in (ExactPolynomial({(2, 0): -1, (0, 0): 1}), ExactPolynomial({(3, 0): 1}), ellipse(1, 0, 1) - 1):
        with pytest.raises(InputError):
            as_ellipse(flat)


def disc_proof() -> Proof:
    """By hand, for h = 1 - 2 r^2: hdot = 4 r^2 (1 - r^2), and lambda = -3/4 + 9/4 r^2, t = 1/2 leave squares.

    With lambda = a + b r^2: hdot - lambda h - t = (4 - b + 2 a) r^2 + (2 b - 4) r^4 - a - t = 1/4 + r^2 / 4 + r^4 / 2.
    """
    h = ExactPolynomial({(0, 0): 1, (2, 0): -2, (0, 2): -2})
    multiplier = ExactPolynomial({(0, 0): "-3/4", (2, 0): "9/4", (0, 2): "9/4"})
    half, quarter = Fraction(1, 2), Fraction(1, 4)
    diagonal = [quarter, quarter, quarter, half, Fraction(3, 5), half]
    gram = [[diagonal[i] if i == j else Fraction(0) for j in range(6)] for i in range(6)]
    gram[3][5] = gram[5][3] = Fraction(1, 5)  # 2 / 5 + 3 / 5 = 1, the part of x1^2 x2^2 in (x1^2 + x2^2)^2 / 2
    return Proof(h, half, multiplier, monomials(2), tuple(tuple(row) for row in gram))


def test_a_proof_by_hand_is_accepted() -> None:
    assert check(disc_proof(), DISC) == []


@pytest.mark.parametrize(("i", "j"), [(i, j) for i in range(6) for j in range(i + 1)])
def test_a_gram_entry_off_by_any_amount_is_rejected(i: int, j: int) -> None:
    proof = disc_proof()
    rows = [list(row) for row in proof.gram]
    rows[i][j] += Fraction(1, 10**30)
    assert check(replace(proof, gram=tuple(tuple(row) for row in rows)), DISC)
    rows[j][i] = rows[i][j]
    assert any("identity" in fault for fault in check(replace(proof, gram=tuple(map(tuple, rows))), DISC))


def test_other_numbers_spoiled_are_rejected() -> None:
    proof, tiny = disc_proof(), Fraction(1, 10**30)
    for spoiled in (
        replace(proof, rate_ps=proof.rate_ps + tiny),
        replace(proof, multiplier=proof.multiplier + tiny),
        replace(proof, h=proof.h + tiny),
        replace(proof, basis=proof.basis[::-1]),
        replace(proof, basis=proof.basis[:5]),
        replace(proof, gram=proof.gram[:5]),
        replace(proof, falling=((tiny,),)),
        replace(proof, falling=((tiny, tiny), (tiny, tiny))),
    ):
        assert check(spoiled, DISC)
    assert check(proof, (DISC[0], DISC[1] + tiny))


def test_an_identity_that_holds_without_a_definite_gram_matrix_is_rejected() -> None:
    # hdot - lambda h - t = z^T Q z always has a Q, here for a disc that is not invariant: r = 2
    h = ExactPolynomial({(0, 0): 1, (2, 0): "-1/4", (0, 2): "-1/4"})
    rest = along(h, DISC) - Fraction(1, 100)
    basis = monomials(2)
    gram = [[Fraction(0)] * 6 for _ in basis]
    for i, a in enumerate(basis):
        for j, b in enumerate(basis):
            powers = (a[0] + b[0], a[1] + b[1])
            gram[i][j] = rest[powers] / sum((a2[0] + b2[0], a2[1] + b2[1]) == powers for a2 in basis for b2 in basis)
    proof = Proof(h, Fraction(1, 100), ExactPolynomial({}), basis, tuple(map(tuple, gram)))
    assert check(proof, DISC) == ["the Gram matrix is not symmetric with positive leading minors"]


def test_a_rate_of_nothing_proves_nothing() -> None:
    assert any("rate" in fault for fault in check(replace(disc_proof(), rate_ps=Fraction(0)), DISC))


def test_falling_needs_the_origin_and_the_sum_of_squares() -> None:
    proof = disc_proof()
    falling = ((Fraction(9, 4), Fraction(0)), (Fraction(0), Fraction(9, 4)))
    assert any("multiplier and rate" in fault for fault in check(replace(proof, falling=falling), DISC))
    # lambda + t = (9/4) r^2 with t = 3/4 leaves the constant 0, so the Gram matrix about z = (x1, ..., x2^2)
    inner = tuple(row[1:] for row in proof.gram[1:])
    good = Proof(proof.h, Fraction(3, 4), proof.multiplier, monomials(2, 1), inner, falling)
    assert check(good, DISC) == []
    moved = replace(good, h=ellipse(2, 0, 2, "0.01"))
    assert any("about the origin" in fault for fault in check(moved, DISC))
    negative = tuple(tuple(-value for value in row) for row in falling)
    assert any("multiplier's Gram" in fault for fault in check(replace(good, falling=negative), DISC))


def test_leaving_is_proven_only_where_it_happens() -> None:
    inside, outside = (Fraction("0.999"), Fraction(0)), (Fraction("1.001"), Fraction(0))
    disc = ellipse(1, 0, 1)
    away = (ExactPolynomial({(1, 0): 1}), ExactPolynomial({(0, 1): 1}))
    assert leaves_between(disc, away, inside, outside)
    assert not leaves_between(disc, (-away[0], -away[1]), inside, outside)
    assert not leaves_between(disc, away, outside, inside)
    # on this field hdot changes its sign along the segment: nothing is proven
    assert not leaves_between(disc, DISC, (Fraction(1, 2), Fraction(0)), (Fraction(2), Fraction(0)))


def test_a_proof_survives_its_text_and_bad_text_is_named() -> None:
    proof = disc_proof()
    data = proof_to_dict(proof)
    assert proof_from_dict(data, "f") == proof
    for spoiled in (
        {},
        {**data, "gram": None},
        {**data, "rate_ps": 0.5},
        {**data, "rate_ps": "1/0"},
        {**data, "h": [[0, 0]]},
        {**data, "basis": [[-1, 0]]},
        {**data, "multiplier": [[-1, 0, "1"]]},
    ):
        with pytest.raises(InputError, match="f: no sum-of-squares proof"):
            proof_from_dict(spoiled, "f")
