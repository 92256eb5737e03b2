"""The exact kernel, against a grid on which the game is played backwards (Hamilton-Jacobi, semi-Lagrangian)."""

from __future__ import annotations

import numpy as np
import pytest
from barriers import in_kernel
from scipy.ndimage import map_coordinates

from flightstack.barrier import viability
from flightstack.types import F64


def hj_grid(limit_m: float, u_low: float, u_high: float, error: float, p: F64, v: F64) -> F64:
    """(len(p), len(v)) value: the least distance to the strip's edge that the best command keeps to for ever.

    V <- min(l, max_u min_d V(one step later)), to its fixed point.
    """
    dt = 0.02  # steps of several cells: each one interpolates, and that is what smears the edge
    grid_p, grid_v = np.meshgrid(p, v, indexing="ij")
    edge = limit_m - np.abs(grid_p)
    worth = edge.copy()
    while True:
        best = np.full_like(worth, -np.inf)
        for u in (u_low, u_high):
            worst = np.full_like(worth, np.inf)
            for d in (-error, error):
                next_p, next_v = grid_p + dt * grid_v + 0.5 * dt * dt * (u + d), grid_v + dt * (u + d)
                at = [(next_p - p[0]) / (p[1] - p[0]), (next_v - v[0]) / (v[1] - v[0])]
                worst = np.minimum(worst, map_coordinates(worth, at, order=1, mode="constant", cval=-1.0))
            best = np.maximum(best, worst)
        new = np.minimum(edge, best)
        if np.abs(new - worth).max() < 1e-4:
            return new
        worth = new


def test_known_areas() -> None:
    assert viability.area(-0.6, 0.6, -2.80286, 9.81) == pytest.approx(5.957, abs=5e-4)
    assert viability.area(-0.6, 0.6, 0.0, 9.81) == 0.0
    assert viability.area(0.6, -0.6, -1.0, 1.0) == 0.0


def test_area_is_that_of_its_states() -> None:
    p, v = np.linspace(-0.5, 0.7, 801), np.linspace(-4.0, 4.0, 801)
    inside = np.array([[in_kernel(x, y, -0.4, 0.6, -2.0, 5.0) for y in v] for x in p])
    counted = inside.sum() * (p[1] - p[0]) * (v[1] - v[0])
    assert viability.area(-0.4, 0.6, -2.0, 5.0) == pytest.approx(counted, rel=5e-3)


@pytest.mark.parametrize("error", [0.0, 0.5])
def test_kernel_against_the_game_on_a_grid(error: float) -> None:
    """The worst disturbance costs as much as a range narrower by it at both ends."""
    u_low, u_high = -2.80286, 9.81
    p, v = np.linspace(-0.66, 0.66, 133), np.linspace(-5.4, 3.0, 169)
    worth = hj_grid(0.6, u_low, u_high, error, p, v)
    played = (worth >= 0.0).sum() * (p[1] - p[0]) * (v[1] - v[0])
    assert played == pytest.approx(viability.area(-0.6, 0.6, u_low + error, u_high - error), rel=0.03)
    for i in range(0, len(p), 4):
        for j in range(0, len(v), 4):  # the grid smears the kernel's edge, most at its pointed ends
            if in_kernel(p[i], v[j], -0.54, 0.54, 0.9 * (u_low + error), 0.9 * (u_high - error)):
                assert worth[i, j] > 0.0
            if not in_kernel(p[i], v[j], -0.63, 0.63, 1.05 * (u_low + error), 1.05 * (u_high - error)):
                assert worth[i, j] < 0.0
