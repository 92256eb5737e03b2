"""Sites as other programs write them: each is the same field, or one line says what is wrong and where.

The field is 120 x 80 m round PX4's internal simulator's place; how clear a place is of it is known by hand.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from flightstack.geodesy import PX4_SIH
from flightstack.site.clearance import clear_of, packed
from flightstack.site.file import parse_site
from flightstack.site.shape import Site
from flightstack.types import InputError

FIELD = [(-60.0, -40.0), (60.0, -40.0), (60.0, 40.0), (-60.0, 40.0)]
PILLAR = [(20.0, 20.0), (30.0, 20.0), (30.0, 30.0), (20.0, 30.0)]
BOW = [FIELD[0], FIELD[2], FIELD[1], FIELD[3]]


def placed(corners: list[tuple[float, float]]) -> list[list[float]]:
    """Longitude, latitude, as GeoJSON has them."""
    return [list(PX4_SIH.to_globe(*corner)[::-1]) for corner in corners]


def ring(corners: list[tuple[float, float]], closing: int = 1) -> list[list[float]]:
    return [*placed(corners), *placed(corners[:1]) * closing]


def feature(rings: Any, kind: str = "Polygon", **said: object) -> dict[str, object]:
    return {"type": "Feature", "properties": said, "geometry": {"type": kind, "coordinates": rings}}


def collection(*features: object, **more: object) -> str:
    return json.dumps({"type": "FeatureCollection", **more, "features": features})


def fence(corners: list[list[float]], **more: object) -> str:
    """Of today's QGroundControl."""
    polygon = {"inclusion": True, "polygon": [each[::-1] for each in corners], "version": 1}
    return plan({"circles": [], "polygons": [polygon], "version": 2, **more})


def plan(geo_fence: dict[str, object]) -> str:
    mission = {"items": [], "plannedHomePosition": [47.4, 8.5, 490], "version": 2}
    return json.dumps({"fileType": "Plan", "geoFence": geo_fence, "mission": mission, "version": 1})


def read(text: str, name: str) -> Site:
    return parse_site(text, name).local(PX4_SIH.latitude_deg, PX4_SIH.longitude_deg)


TWICE = [*ring(FIELD, 0)[:2], *ring(FIELD)[1:]]
ROUNDED = [*ring(FIELD, 0), [placed(FIELD)[0][0] + 1e-12, placed(FIELD)[0][1]]]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.geojson", collection(feature([ring(FIELD)]), name="field", crs=None)),
        ("a.geojson", collection(feature([ring(FIELD[::-1])]))),
        ("a.geojson", collection(feature([ring(FIELD, 0)]))),
        ("a.geojson", collection(feature([ring(FIELD, 3)]))),
        ("a.geojson", collection(feature([TWICE]))),
        ("a.geojson", collection(feature([ROUNDED]))),
        ("a.geojson", collection(feature([[ring(FIELD)]], "MultiPolygon"), bbox=[8.0, 47.0, 9.0, 48.0])),
        ("a.geojson", collection(feature([[[*c, 488.1] for c in ring(FIELD)]], floors=3, fill="#f00", name=None))),
        ("a.JSON", json.dumps({"type": "Polygon", "coordinates": [ring(FIELD)]})),
        ("a.plan", fence(placed(FIELD))),
        ("a.plan", fence(placed(FIELD[::-1]), breachReturn=[47.0, 8.0])),
        ("a.plan", fence(ring(FIELD))),
        ("a.plan", plan({"polygon": [c[::-1] for c in placed(FIELD)], "breachReturn": [47.0, 8.0], "version": 1})),
        ("a.toml", f'schema = "flightstack.site/1"\ninside = {[list(c) for c in [*FIELD, FIELD[0]]]}'),
    ],
)
def test_the_field_is_the_same_however_it_was_drawn(name: str, text: str) -> None:
    flat = packed(read(text, name), np.zeros((1, 2)), 1.0)
    rng = np.random.default_rng(3)
    for north, east in rng.uniform([-59.0, -39.0], [59.0, 39.0], (50, 2)).tolist():
        clearance, _ = clear_of(flat, np.array([[north, east, 60.0, 0.0, 0.0]]), 1, 100.0)
        np.testing.assert_allclose(clearance, min(60.0 - abs(north), 40.0 - abs(east)), atol=1e-5)
    for north, east in ((60.1, 0.0), (0.0, -40.1)):
        assert clear_of(flat, np.array([[north, east, 60.0, 0.0, 0.0]]), 1, 100.0)[0] < 0.0


@pytest.mark.parametrize("turn", [1, -1])
@pytest.mark.parametrize("hole", [1, -1])
def test_a_hole_is_kept_out_of_whichever_way_rings_wind(turn: int, hole: int) -> None:
    site = read(collection(feature([ring(FIELD[::turn]), ring(PILLAR[::hole])])), "a.geojson")
    flat = packed(site, np.zeros((1, 2)), 1.0)
    for place, expected in (((25.0, 15.0), 5.0), ((16.0, 25.0), 4.0), ((35.0, 25.0), 5.0)):
        clearance, _ = clear_of(flat, np.array([[*place, 60.0, 0.0, 0.0]]), 1, 100.0)
        np.testing.assert_allclose(clearance, expected, atol=1e-5)
    assert clear_of(flat, np.array([[25.0, 25.0, 60.0, 0.0, 0.0]]), 1, 100.0)[0] < 0.0


UTM = [[465000.0, 5249000.0], [465100.0, 5249000.0], [465100.0, 5249100.0]]


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.geojson", collection(feature([ring(BOW)])), "inside crosses itself: edges 0 and 2"),
        (
            "a.geojson",
            collection(feature([ring(FIELD), ring([PILLAR[i] for i in (0, 2, 1, 3)])])),
            "hole 0: polygon cr",
        ),
        ("a.geojson", collection(feature([[c[::-1] for c in ring(FIELD)]])), "latitude and longitude are swapped"),
        ("a.plan", fence([c[::-1] for c in placed(FIELD)]), "latitude and longitude are swapped"),
        ("a.geojson", collection(feature([UTM])), "inside: corner 0 at 5249000, 465000 is not in degrees"),
        ("a.geojson", collection(feature([[ring(FIELD)], [ring(PILLAR)]], "MultiPolygon")), "2 polygons to stay in"),
        ("a.geojson", collection(feature([ring(FIELD)]), feature(placed(FIELD)[0], "Point")), "feature 1: 'Point'"),
        ("a.geojson", collection(feature(ring(FIELD), "LineString")), "feature 0: 'LineString'"),
        ("a.geojson", collection({"type": "Feature", "properties": {}, "geometry": None}), "feature 0 has no geometry"),
        ("a.geojson", collection(feature([ring(FIELD)], ceiling_ft=100)), "feature 0: property 'ceiling_ft'"),
        ("a.geojson", collection(feature([ring(FIELD)], Ceiling_m=30)), "feature 0: property 'Ceiling_m'"),
        ("a.geojson", collection(feature([ring(FIELD)], ceiling_m="30 ft")), "feature 0: ceiling_m = '30 ft'"),
        ("a.geojson", collection(feature([ring(FIELD)]), feature([ring(PILLAR)], keepout=True)), "property 'keepout'"),
        ("a.kml", "<?xml version='1.0'?><kml/>", "QGroundControl .plan or GeoJSON"),
        ("a.geojson", "<kml/>", "QGroundControl .plan or GeoJSON"),
        ("a.waypoints", "QGC WPL 110", "QGroundControl .plan or GeoJSON"),
        ("a.plan", plan({"version": 2, "circles": [], "polygons": []}), "0 areas to stay in"),
        ("a.plan", plan({"version": 1, "polygon": []}), "0 areas to stay in"),
        ("a.plan", plan({"version": 1, "polygon": [[47.0, 8.0], [47.1, 8.0]]}), "inside is empty: 2 corners"),
        (
            "a.toml",
            'schema = "flightstack.site/1"\ninside = [[47.397, 8.545], [47.399, 8.545], [47.399, 8.547]]',
            'corners in degrees need frame = "global"',
        ),
    ],
)
def test_what_is_no_field_is_one_line_that_says_where(name: str, text: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        read(text, name)
    assert str(error.value).startswith(f"{name}: ")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_field_whose_corners_are_all_far_away_is_no_other_site() -> None:
    """The vehicle stands in the middle of 25 km; beside it, it is elsewhere."""
    wide = [(-12_500.0, -12_500.0), (12_500.0, -12_500.0), (12_500.0, 12_500.0), (-12_500.0, 12_500.0)]
    text = collection(feature([ring(wide)]))
    np.testing.assert_allclose(read(text, "a.geojson").inside, wide, atol=1e-3)
    with pytest.raises(InputError, match="the site lies 12 km from the vehicle, which"):
        parse_site(text, "a.geojson").local(*PX4_SIH.to_globe(-25_000.0, 1_000.0))
    for far_m, is_taken in ((9_900.0, True), (10_100.0, False)):  # from the middle of its southern edge
        place = PX4_SIH.to_globe(-12_500.0 - far_m, 0.0)
        if not is_taken:
            with pytest.raises(InputError, match="the site lies 10 km from the vehicle"):
                parse_site(text, "a.geojson").local(*place)
            continue
        with pytest.raises(InputError, match=r"corner . is .* m away, at most 20000 m count"):
            parse_site(text, "a.geojson").local(*place)
