"""The local frame on the globe, checked against spherical trigonometry written another way (haversine, bearing)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flightstack.geodesy import EARTH_RADIUS_M, PX4_SIH, LocalFrame


def haversine_m(a: tuple[float, float], b: tuple[float, float]) -> float:
    lat_a, lon_a, lat_b, lon_b = map(math.radians, (*a, *b))
    h = math.sin((lat_b - lat_a) / 2) ** 2 + math.cos(lat_a) * math.cos(lat_b) * math.sin((lon_b - lon_a) / 2) ** 2
    return 2.0 * EARTH_RADIUS_M * math.asin(math.sqrt(h))


def bearing_rad(a: tuple[float, float], b: tuple[float, float]) -> float:
    lat_a, lon_a, lat_b, lon_b = map(math.radians, (*a, *b))
    turn = lon_b - lon_a
    y = math.sin(turn) * math.cos(lat_b)
    return math.atan2(y, math.cos(lat_a) * math.sin(lat_b) - math.sin(lat_a) * math.cos(lat_b) * math.cos(turn))


PLACES = [
    *(np.random.default_rng(5).uniform(-5e3, 5e3, (20, 2)).tolist()),
    [0.0, 1e-3], [1e-3, 0.0], [-40.0, 0.0], [0.0, -40.0],
]  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("frame", [PX4_SIH, LocalFrame(-33.0, 179.999, 0.0), LocalFrame(0.0, 0.0, 0.0)])
def test_distance_and_bearing_from_the_origin_are_kept(frame: LocalFrame, place: list[float]) -> None:
    origin = (frame.latitude_deg, frame.longitude_deg)
    point = frame.to_globe(*place)
    assert haversine_m(origin, point) == pytest.approx(math.hypot(*place), abs=1e-4)
    turned = math.remainder(bearing_rad(origin, point) - math.atan2(place[1], place[0]), 2.0 * math.pi)
    assert turned * math.hypot(*place) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("place", PLACES)
def test_there_and_back_is_the_same_place(place: list[float]) -> None:
    assert PX4_SIH.to_local(*PX4_SIH.to_globe(*place)) == pytest.approx(tuple(place), abs=1e-6)


def test_the_origin_is_itself() -> None:
    assert PX4_SIH.to_globe(0.0, 0.0) == (47.397742, 8.545594)
    assert PX4_SIH.to_local(47.397742, 8.545594) == pytest.approx((0.0, 0.0), abs=1e-6)
