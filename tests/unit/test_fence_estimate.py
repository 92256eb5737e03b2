"""The attack on the estimate errs by what is declared, no less and no more, away from what is nearest."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.fence_estimate import ErringEstimate, Truth
from flightstack.barrier.estimate_bounds import EstimateBounds
from flightstack.site.clearance import packed
from flightstack.site.shape import Site
from flightstack.types import Measurement

DECLARED = EstimateBounds((0.02, 0.03, 0.04), (0.05, 0.06, 0.07), (0.1, 0.2, 0.3), 4.3)
BOX = Site("box", False, np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]]), floor_m=0.0, ceiling_m=6.0)


def made(place: tuple[float, float, float]) -> tuple[np.ndarray, Truth]:
    erring = ErringEstimate(DECLARED, packed(BOX, np.zeros((1, 2)), 1.0))
    q = Rotation.from_euler("ZYX", [0.7, -0.2, 0.1]).as_quat(scalar_first=True)
    truth = Truth(1000, np.array(place), np.array([1.0, -2.0, 0.5]), q)
    erring.saw(Truth(900, np.zeros(3), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
    erring.saw(truth)
    row = np.full(20, 7.0)
    return erring.made(Measurement(1000, row, 0, 0, 0), np.zeros(3), np.array([0.5, 0.0, 0.0])).row, truth


def test_the_estimate_is_off_by_all_that_is_declared_away_from_the_wall() -> None:
    row, truth = made((2.5, 0.0, -3.0))
    np.testing.assert_allclose(row[:3] - truth.pos_ned_m, [0.5 - 0.02, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(row[3:6] - truth.vel_ned_mps, [-0.05, 0.0, 0.0], atol=1e-9)
    up = np.array([0.0, 0.0, -9.80665])
    believed, true = (Rotation.from_quat(q, scalar_first=True) for q in (row[6:10], truth.q_ned_frd))
    angle = (believed * true.inv()).magnitude()
    np.testing.assert_allclose(9.80665 * angle, 0.1, rtol=1e-6)
    seems = (believed * true.inv()).apply(up) - up
    np.testing.assert_allclose(seems, [-0.1, 0.0, 0.0], atol=1e-3)
    assert (row[10:] == 7.0).all()


def test_below_a_ceiling_it_seems_lower() -> None:
    row, truth = made((0.0, 0.0, -5.8))
    np.testing.assert_allclose(row[:3] - truth.pos_ned_m, [0.5, 0.0, 0.04], atol=1e-9)
