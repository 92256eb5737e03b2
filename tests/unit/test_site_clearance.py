"""Distances to what a site forbids: by hand, and by brute force over points of its edges."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flightstack.site.clearance import CHUTE, clear_of, edge_name, packed
from flightstack.site.file import parse_site
from flightstack.site.shape import Site

TEXT = """schema = "flightstack.site/1"
floor_m = 0.5
ceiling_m = 6.0
inside = [[-10.0, -8.0], [10.0, -8.0], [10.0, 8.0], [2.0, 8.0], [2.0, 3.0], [-2.0, 3.0], [-2.0, 8.0], [-10.0, 8.0]]
[[keep_out]]
polygon = [[4.0, -4.0], [6.0, -4.0], [6.0, -2.0], [4.0, -2.0]]
ceiling_m = 3.0
[[keep_out]]
centre = [-6.0, -4.0]
radius_m = 1.0
[[keep_out]]
centre = [-6.0, 4.0, 3.0]
radius_m = 1.0
"""


@pytest.fixture(scope="module")
def site() -> Site:
    return parse_site(TEXT, "site.toml")


def clearance(site: Site, north: float, east: float, height: float, across: float = 0.0, half: float = 0.0) -> float:
    flat = packed(site, np.zeros((1, 2)), 1.5)
    return clear_of(flat, np.array([[north, east, height, across, half]]), 1, 100.0)[0]


@pytest.mark.parametrize(
    ("place", "metres"),
    [
        ((0.0, 0.0, 2.0), 1.5),  # the floor, which counts outside of the chute only when it is left: the ceiling is 4
        ((9.0, 0.0, 3.25), 1.0),  # the north wall
        ((0.0, 2.0, 3.25), 1.0),  # the notch's east wall
        ((2.6, 4.0, 3.25), 0.6),  # beside the notch
        ((3.0, -3.0, 2.0), 1.0),  # beside the low block
        ((5.0, -3.0, 4.2), 1.2),  # above the low block
        ((-6.0, -2.0, 3.25), 1.0),  # beside the mast
        ((-6.0, 4.0, 5.5), 0.5),  # above the sphere: ceiling nearer than the sphere's 1.5
        ((-4.0, 4.0, 3.0), 1.0),  # beside the sphere
        ((0.0, 0.0, 5.9), 0.1),
    ],
)
def test_by_hand(site: Site, place: tuple[float, float, float], metres: float) -> None:
    if place[:2] == (0.0, 0.0) and place[2] == 2.0:
        flat = packed(site, np.zeros((1, 2)), 1.5)
        flat[CHUTE] = -1.0
        assert clear_of(flat, np.array([[*place, 0.0, 0.0]]), 1, 100.0)[0] == pytest.approx(metres)
        return
    assert clearance(site, *place) == pytest.approx(metres)


@pytest.mark.parametrize(
    "place",
    [
        (11.0, 0.0, 3.0),
        (0.0, 5.0, 3.0),
        (5.0, -3.0, 2.0),
        (-6.0, -4.5, 3.0),
        (-6.0, 4.2, 3.5),
        (5.0, 5.0, 0.3),
        (0.0, 0.0, 7.0),
    ],
)
def test_what_is_forbidden_is_negative(site: Site, place: tuple[float, float, float]) -> None:
    assert clearance(site, *place) < 0.0


def test_the_floor_does_not_bind_in_the_chute_as_long_as_it_is_open(site: Site) -> None:
    flat, disc = packed(site, np.zeros((1, 2)), 1.5), np.array([[0.5, 0.0, 0.0, 0.5, 0.1]])
    assert clear_of(flat, disc, 1, 100.0)[0] > 0.0
    assert clear_of(flat, disc + np.array([[0.6, 0.0, 0.0, 0.0, 0.0]]), 1, 100.0)[0] < 0.0
    flat[CHUTE] = -1.0
    assert clear_of(flat, disc, 1, 100.0)[0] < 0.0


def test_against_points_of_the_edges(site: Site) -> None:
    """A disc is clear of the walls by the distance of its centre to the nearest of many points, less the rim."""
    rng = np.random.default_rng(3)
    corners = site.inside
    share = np.linspace(0.0, 1.0, 4001)[:, None]
    walls = np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    compared = 0
    for north, east in rng.uniform([-10.0, -8.0], [10.0, 8.0], (400, 2)):
        if -2.0 <= north <= 2.0 and east >= 3.0:
            continue
        wall = float(np.hypot(*(walls - [north, east]).T).min())
        if wall < 0.9 and clearance(site, north, east, 3.25) < 0.95:  # nothing else is that near
            assert clearance(site, north, east, 3.25, 0.2) == pytest.approx(wall - 0.2, abs=2e-3)
            compared += 1
    assert compared > 40


def test_names_of_edges(site: Site) -> None:
    flat = packed(site, np.zeros((1, 2)), 1.5)
    for place, name in (
        ((9.5, 0.0, 3.0), "edge 1"),
        ((3.8, -3.0, 2.0), "keep_out 0: edge 3"),
        ((-4.9, -4.0, 3.0), "keep_out 1"),
    ):
        code = clear_of(flat, np.array([[*place, 0.0, 0.0]]), 1, 100.0)[1]
        assert edge_name(site, code) == name
    assert math.isfinite(flat[CHUTE])
