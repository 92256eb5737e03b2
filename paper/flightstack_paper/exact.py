"""Exact proofs that an ellipse is invariant: rational polynomials of two states and the check of a sum of squares.

For x' = f(x) and h quadratic, the identity

    hdot - lambda h - t = z^T Q z,   z a vector of monomials, Q positive definite, t > 0

gives hdot >= t wherever h = 0, so that no motion leaves {h >= 0}.  Where lambda + t is a sum of squares as well and h
is 1 - V with V a positive definite form, hdot = (lambda + t) h + t V + z^T Q z >= t V in the whole region: V is a
Lyapunov function that falls at least as fast as exp(-t time), and the region is one of attraction to the origin.

Every number is a fraction and every step exact: a rounding error anywhere makes the check fail.  Nothing here knows
how the identity was found (`sos`), and nothing but the standard library is needed.

Source: H. Peyrl, P. Parrilo, "Computing sum of squares decompositions with rational coefficients", Theoretical
Computer Science 409 (2008), for Gram matrices over the rationals; E. Bareiss, "Sylvester's identity and multistep
integer-preserving Gaussian elimination", Mathematics of Computation 22 (1968), for the minors.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flightstack.types import InputError

Exponents = tuple[int, int]
"""Powers of x1 and x2."""
Matrix = tuple[tuple[Fraction, ...], ...]
Number = Fraction | int | str
"""What becomes a fraction as it is: decimal text ("0.8", "3/7") or an integer; a float would bring its binary tail."""


class ExactPolynomial:
    """A polynomial of two states with rational coefficients; zero terms are not kept."""

    __slots__ = ("terms",)

    def __init__(self, terms: Mapping[Exponents, Number]) -> None:
        if any(i < 0 or j < 0 for i, j in terms):
            raise ValueError("powers below 0 make no polynomial")
        exact = {powers: Fraction(value) for powers, value in terms.items()}
        self.terms: dict[Exponents, Fraction] = {powers: value for powers, value in exact.items() if value}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ExactPolynomial) and self.terms == other.terms

    def __hash__(self) -> int:
        return hash(frozenset(self.terms.items()))

    def __repr__(self) -> str:
        return "Polynomial({" + ", ".join(f"{p}: '{v}'" for p, v in sorted(self.terms.items())) + "})"

    def __add__(self, other: ExactPolynomial | Number) -> ExactPolynomial:
        total = dict(self.terms)
        for powers, value in _polynomial(other).terms.items():
            total[powers] = total.get(powers, Fraction(0)) + value
        return ExactPolynomial(total)

    def __neg__(self) -> ExactPolynomial:
        return ExactPolynomial({powers: -value for powers, value in self.terms.items()})

    def __sub__(self, other: ExactPolynomial | Number) -> ExactPolynomial:
        return self + -_polynomial(other)

    def __mul__(self, other: ExactPolynomial | Number) -> ExactPolynomial:
        total: dict[Exponents, Fraction] = {}
        for (i, j), left in self.terms.items():
            for (k, m), right in _polynomial(other).terms.items():
                total[i + k, j + m] = total.get((i + k, j + m), Fraction(0)) + left * right
        return ExactPolynomial(total)

    def __call__(self, x1: Fraction, x2: Fraction) -> Fraction:
        """Value at a point, exact for fractions."""
        return sum((value * x1**i * x2**j for (i, j), value in self.terms.items()), Fraction(0))

    def __getitem__(self, powers: Exponents) -> Fraction:
        """Coefficient of one monomial, 0 where there is none."""
        return self.terms.get(powers, Fraction(0))

    @property
    def degree(self) -> int:
        """Greatest sum of powers; 0 for a constant."""
        return max((i + j for i, j in self.terms), default=0)

    def derivative(self, state: int) -> ExactPolynomial:
        """Partial derivative along state 0 (x1) or 1 (x2)."""
        lower = (1, 0) if state == 0 else (0, 1)
        return ExactPolynomial(
            {
                (i - lower[0], j - lower[1]): value * (i, j)[state]
                for (i, j), value in self.terms.items()
                if (i, j)[state]
            }
        )


Point = tuple[Fraction, Fraction]
Field = tuple[ExactPolynomial, ExactPolynomial]
"""x1' and x2'."""


def _polynomial(value: ExactPolynomial | Number) -> ExactPolynomial:
    return value if isinstance(value, ExactPolynomial) else ExactPolynomial({(0, 0): value})


def along(h: ExactPolynomial, field: Field) -> ExactPolynomial:
    """hdot: the derivative of h along the field."""
    return h.derivative(0) * field[0] + h.derivative(1) * field[1]


def monomials(degree: int, lowest: int = 0) -> tuple[Exponents, ...]:
    """All powers of degree `lowest` to `degree`, by degree: 1, x1, x2, x1^2, x1 x2, x2^2, ..."""
    return tuple((total - j, j) for total in range(lowest, degree + 1) for j in range(total + 1))


def gram_form(basis: Iterable[Exponents], gram: Matrix) -> ExactPolynomial:
    """z^T Q z as a polynomial."""
    powers = tuple(basis)
    total: dict[Exponents, Fraction] = {}
    for (i, j), row in zip(powers, gram, strict=True):
        for (k, m), value in zip(powers, row, strict=True):
            total[i + k, j + m] = total.get((i + k, j + m), Fraction(0)) + value
    return ExactPolynomial(total)


def leading_minors(matrix: Matrix) -> list[Fraction]:
    """The determinants of the upper left blocks, smallest block first, until one is not positive (it is the last)."""
    rows = [list(row) for row in matrix]
    minors: list[Fraction] = []
    previous = Fraction(1)
    for k in range(len(rows)):
        pivot = rows[k][k]
        minors.append(pivot)
        if pivot <= 0:
            break
        for i in range(k + 1, len(rows)):
            for j in range(k + 1, len(rows)):
                rows[i][j] = (rows[i][j] * pivot - rows[i][k] * rows[k][j]) / previous
        previous = pivot
    return minors


def positive_definite(matrix: Matrix) -> bool:
    """Symmetric with all leading minors above 0 (Sylvester)."""
    size = len(matrix)
    if any(len(row) != size for row in matrix):
        return False
    symmetric = all(matrix[i][j] == matrix[j][i] for i in range(size) for j in range(i))
    minors = leading_minors(matrix)
    return symmetric and len(minors) == size and minors[-1] > 0


@dataclass(frozen=True, slots=True)
class Ellipse:
    """What h = level - (x - centre)^T P (x - centre) is made of, exactly."""

    p: Matrix
    """(2, 2)."""
    centre: Point
    level: Fraction
    """The greatest value of h."""

    @property
    def area(self) -> float:
        """Of {h >= 0}: pi level / sqrt(det P)."""
        return math.pi * float(self.level) / math.sqrt(self.p[0][0] * self.p[1][1] - self.p[0][1] ** 2)


def ellipse(p11: Number, p12: Number, p22: Number, c1: Number = 0, c2: Number = 0) -> ExactPolynomial:
    """The polynomial 1 - (x - c)^T P (x - c)."""
    x1, x2 = ExactPolynomial({(1, 0): 1, (0, 0): -Fraction(c1)}), ExactPolynomial({(0, 1): 1, (0, 0): -Fraction(c2)})
    form = x1 * x1 * p11 + x1 * x2 * (2 * Fraction(p12)) + x2 * x2 * p22
    return -form + 1


def as_ellipse(h: ExactPolynomial) -> Ellipse:
    """Shape of a quadratic h; InputError unless {h >= 0} is an ellipse with an inside."""
    p: Matrix = ((-h[2, 0], -h[1, 1] / 2), (-h[1, 1] / 2, -h[0, 2]))
    if h.degree > 2 or not positive_definite(p):
        raise InputError("h is no quadratic with a negative definite form: its region is no ellipse")
    det = p[0][0] * p[1][1] - p[0][1] * p[0][1]
    g1, g2 = h[1, 0] / 2, h[0, 1] / 2
    centre = (p[1][1] * g1 - p[0][1] * g2) / det, (p[0][0] * g2 - p[0][1] * g1) / det
    level = h[0, 0] + centre[0] * g1 + centre[1] * g2
    if level <= 0:
        raise InputError("h is nowhere positive: its region is empty")
    return Ellipse(p, centre, level)


@dataclass(frozen=True, slots=True)
class Proof:
    """The claim hdot >= rate on h = 0 with what shows it; `check` decides whether it does."""

    h: ExactPolynomial
    rate_ps: Fraction
    """t; h has no unit."""
    multiplier: ExactPolynomial
    """lambda, 1/s."""
    basis: tuple[Exponents, ...]
    """The monomials z."""
    gram: Matrix
    """Q."""
    falling: Matrix | None = None
    """S with lambda + t = m^T S m, m all monomials of degree 1 and up that fit: claims that 1 - h falls everywhere."""


def identity_gap(proof: Proof, field: Field) -> ExactPolynomial:
    """What the identity lacks: hdot - lambda h - t - z^T Q z, zero in a proof."""
    return along(proof.h, field) - proof.multiplier * proof.h - proof.rate_ps - gram_form(proof.basis, proof.gram)


def check(proof: Proof, field: Field) -> list[str]:
    """What is wrong with a proof, in words; empty where the claim is proven for this field."""
    faults = []
    try:
        as_ellipse(proof.h)
    except InputError as error:
        faults.append(str(error))
    if proof.rate_ps <= 0:
        faults.append(f"the rate {proof.rate_ps} is not above 0")
    if len(proof.gram) != len(proof.basis) or any(len(row) != len(proof.basis) for row in proof.gram):
        return [*faults, f"the Gram matrix is not {len(proof.basis)} by {len(proof.basis)}"]
    gap = identity_gap(proof, field)
    if gap.terms:
        worst = max(gap.terms.items(), key=lambda term: abs(term[1]))
        faults.append(f"the identity fails at x1^{worst[0][0]} x2^{worst[0][1]} by {float(worst[1]):.3g}")
    if not positive_definite(proof.gram):
        faults.append("the Gram matrix is not symmetric with positive leading minors")
    if proof.falling is not None:
        faults += _not_falling(proof, proof.falling)
    return faults


def _not_falling(proof: Proof, falling: Matrix) -> list[str]:
    if proof.h[0, 0] != 1 or proof.h[1, 0] or proof.h[0, 1]:
        return ["h is not 1 less a form about the origin"]
    basis = falling_basis(len(falling))
    if len(basis) != len(falling) or any(len(row) != len(basis) for row in falling):
        return [f"no monomials fit a Gram matrix of {len(falling)} rows"]
    if not positive_definite(falling):
        return ["the multiplier's Gram matrix is not symmetric with positive leading minors"]
    if proof.multiplier + proof.rate_ps != gram_form(basis, falling):
        return ["multiplier and rate are not the sum of squares that is given"]
    return []


def falling_basis(size: int) -> tuple[Exponents, ...]:
    """The monomials of degree 1 and up that a Gram matrix of `size` rows stands for: 2, 5, 9, ... rows."""
    degree = 1
    while len(monomials(degree, 1)) < size:
        degree += 1
    return monomials(degree, 1)


def leaves_between(h: ExactPolynomial, field: Field, inside: Point, outside: Point) -> bool:
    """Whether a motion leaves {h >= 0} on the segment, proven: h changes sign along it and hdot < 0 on all of it.

    hdot on the segment is a polynomial of one variable; its Bernstein coefficients bound it.
    """
    if h(*inside) <= 0 or h(*outside) >= 0:
        return False
    ways = [ExactPolynomial({(0, 0): a, (1, 0): b - a}) for a, b in zip(inside, outside, strict=True)]
    rate = ExactPolynomial({})
    for (i, j), value in along(h, field).terms.items():
        rate += _power(ways[0], i) * _power(ways[1], j) * value
    n = rate.degree
    bernstein = [
        sum((rate[i, 0] * Fraction(math.comb(k, i), math.comb(n, i)) for i in range(k + 1)), Fraction(0))
        for k in range(n + 1)
    ]
    return max(bernstein) < 0


def _power(base: ExactPolynomial, exponent: int) -> ExactPolynomial:
    return math.prod([base] * exponent, start=ExactPolynomial({(0, 0): 1}))


def proof_to_dict(proof: Proof) -> dict[str, Any]:
    """Plain JSON; every number as text, so that none is rounded."""

    def terms(polynomial: ExactPolynomial) -> list[list[Any]]:
        return [[i, j, str(value)] for (i, j), value in sorted(polynomial.terms.items())]

    def rows(matrix: Matrix | None) -> list[list[str]] | None:
        return None if matrix is None else [[str(value) for value in row] for row in matrix]

    return {
        "h": terms(proof.h),
        "rate_ps": str(proof.rate_ps),
        "multiplier": terms(proof.multiplier),
        "basis": [list(powers) for powers in proof.basis],
        "gram": rows(proof.gram),
        "falling": rows(proof.falling),
    }


def proof_from_dict(data: Mapping[str, Any], source: str) -> Proof:
    """The inverse of `proof_to_dict`; InputError that names the source where it isn't one."""

    def terms(name: str) -> ExactPolynomial:
        return ExactPolynomial({(int(i), int(j)): _fraction(value) for i, j, value in data[name]})

    def rows(name: str) -> Matrix:
        return tuple(tuple(_fraction(value) for value in row) for row in data[name])

    try:
        basis = tuple((int(i), int(j)) for i, j in data["basis"])
        if any(min(powers) < 0 for powers in basis):
            raise ValueError("powers below 0 make no polynomial")
        falling = None if data["falling"] is None else rows("falling")
        return Proof(terms("h"), _fraction(data["rate_ps"]), terms("multiplier"), basis, rows("gram"), falling)
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise InputError(f"{source}: no sum-of-squares proof: {type(error).__name__} {error}") from None


def _fraction(text: object) -> Fraction:
    if not isinstance(text, str):
        raise TypeError(f"{text!r} is no fraction in quotes")
    return Fraction(text)
