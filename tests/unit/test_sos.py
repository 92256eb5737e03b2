"""Sum-of-squares searches on systems whose largest region is known in closed form."""

from __future__ import annotations

import math
import sys
from fractions import Fraction

import pytest

from flightstack.types import InputError
from flightstack_paper import sos
from flightstack_paper.exact import ExactPolynomial, Field, check, ellipse


def disc(power: int, turn: int = 0) -> Field:
    """r' = -r (1 - r^(2 power)), turning at a constant rate: everything in the unit disc ends at its centre."""
    r2 = ExactPolynomial({(2, 0): 1, (0, 2): 1})
    shrink = ExactPolynomial({(0, 0): -1}) + (r2 if power == 1 else r2 * r2)
    x1, x2 = ExactPolynomial({(1, 0): 1}), ExactPolynomial({(0, 1): 1})
    return shrink * x1 - x2 * turn, shrink * x2 + x1 * turn


@pytest.mark.parametrize(("power", "turn"), [(1, 0), (1, 2), (2, 0)])
def test_the_disc_is_found_less_the_rate_asked_for(power: int, turn: int) -> None:
    # V = r^2 / R^2 falls by 2 V (1 - r^(2 power)), at r = R by the rate t: R^(2 power) = 1 - t / 2
    rate = Fraction(1, 10)
    field = disc(power, turn)
    for search in (sos.region_of_attraction, sos.invariant_ellipse):
        found = search(field, rate, starts=2)
        assert check(found.proof, field) == []
        assert found.proof.rate_ps == rate
        best = math.pi * (1.0 - float(rate) / 2.0) ** (1.0 / power)
        reserved = math.pi * (1.0 - 1.1 * float(rate) / 2.0) ** (1.0 / power)
        assert reserved - 1e-4 < found.area < best


def test_the_same_seed_finds_the_same_proof() -> None:
    first, second = (sos.region_of_attraction(disc(1), Fraction(1, 10), starts=2, seed=3) for _ in range(2))
    assert first == second


def test_nothing_false_is_proven() -> None:
    for radius in ("1.0001", "1.5"):
        h = ellipse(1 / Fraction(radius) ** 2, 0, 1 / Fraction(radius) ** 2)
        with pytest.raises(InputError, match="no sum of squares found"):
            sos.prove(disc(1), h, Fraction(1, 10**6))
    with pytest.raises(InputError, match="no ellipse"):
        sos.prove(disc(1), ExactPolynomial({(1, 0): 1}), Fraction(1, 10))


def test_a_region_just_inside_is_proven_both_ways() -> None:
    h = ellipse("1.01", 0, "1.01")  # rate 2 (1 - 1 / 1.01) = 0.0198
    for falling in (False, True):
        assert check(sos.prove(disc(1), h, Fraction(19, 1000), falling=falling), disc(1)) == []
        with pytest.raises(InputError):
            sos.prove(disc(1), h, Fraction(20, 1000), falling=falling)


def test_what_has_no_region_is_refused() -> None:
    x1, x2 = ExactPolynomial({(1, 0): 1}), ExactPolynomial({(0, 1): 1})
    with pytest.raises(InputError, match="no equilibrium with a stable linearisation"):
        sos.invariant_ellipse((x1, x2), Fraction(1, 100))
    with pytest.raises(InputError, match="no equilibrium with a stable linearisation"):
        sos.invariant_ellipse((-x1 + 1, -x2), Fraction(1, 100))
    with pytest.raises(InputError, match="grows without end"):
        sos.region_of_attraction((-x1, -x2), Fraction(1, 100), starts=1)
    with pytest.raises(InputError, match="no start led to a region"):
        sos.region_of_attraction(disc(1), Fraction(3), starts=1)


def test_without_the_extra_the_message_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for missing in ("cvxpy", "clarabel"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, missing, None)
            with pytest.raises(InputError, match=r'install "flightstack\[sos\]"'):
                sos.region_of_attraction(disc(1), Fraction(1, 10))
