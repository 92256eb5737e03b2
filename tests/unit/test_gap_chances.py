"""Chi-square and Student's t against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import chdtrc, chdtri, stdtrit

from flightstack.gap.chances import chi2_limit, chi2_tail, chi2_tails, t_limit


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 7, 12, 39, 100, 301])
def test_the_tail_is_scipys(freedom: int) -> None:
    x = np.array([0.0, 1e-6, 0.01, 0.5, 1.0, 3.0, 10.0, 50.0, 300.0, 900.0])
    np.testing.assert_allclose(chi2_tails(freedom, x), chdtrc(freedom, x), rtol=1e-11, atol=1e-300)


def test_a_tail_of_nothing_is_nothing_and_of_the_unknown_unknown() -> None:
    assert chi2_tail(3, np.inf) == 0.0
    assert np.isnan(chi2_tail(3, np.nan))


@pytest.mark.parametrize("freedom", [1, 2, 5, 30])
@pytest.mark.parametrize("chance", [0.5, 0.05, 0.001])
def test_the_limit_is_scipys(freedom: int, chance: float) -> None:
    assert chi2_limit(freedom, chance) == pytest.approx(chdtri(freedom, chance), rel=1e-12)


@pytest.mark.parametrize("freedom", [1.0, 1.3, 2.0, 3.0, 7.7, 20.0, 133.3, 5000.0])
def test_students_limit_is_scipys(freedom: float) -> None:
    assert t_limit(freedom) == pytest.approx(stdtrit(freedom, 0.975), rel=1e-9)
