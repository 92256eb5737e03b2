"""Site files: what is read, and one line for whatever is wrong."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from flightstack.geodesy import LocalFrame
from flightstack.site.file import parse_site
from flightstack.types import InputError

BOX = "[[-6.0, -5.0], [6.0, -5.0], [6.0, 5.0], [-6.0, 5.0]]"
HEAD = 'schema = "flightstack.site/1"\nfloor_m = 0.3\nceiling_m = 5.0\n'


def test_the_contract_s_example() -> None:
    text = f'{HEAD}frame = "local"\ninside = {BOX}\n[[keep_out]]\npolygon = [[1.0, 1.0], [2.0, 1.0], [2.0, 2.0]]\n'
    text += "[[keep_out]]\ncentre = [3.0, 3.0]\nradius_m = 0.5\nceiling_m = 2.0\n"
    text += "[[keep_out]]\ncentre = [3.0, -3.0, 2.0]\nradius_m = 0.5\n[chute]\nradius_m = 1.0\n"
    site = parse_site(text, "box.toml")
    assert not site.is_global
    assert (site.floor_m, site.ceiling_m, site.edges, site.chute_m) == (0.3, 5.0, 7, 1.0)
    cylinder, sphere = site.keep_outs[1:]
    assert (cylinder.centre, cylinder.radius_m, cylinder.ceiling_m) == ((3.0, 3.0), 0.5, 2.0)
    assert math.isnan(cylinder.height_m)
    assert sphere.height_m == 2.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"{HEAD}inside = [[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 4.0]]", "crosses itself: edges 0 and 2"),
        (f"{HEAD}inside = [[0.0, 0.0], [4.0, 0.0], [2.0, 0.0], [2.0, 3.0]]", "crosses itself: edges 0 and 1"),
        (f"{HEAD}inside = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 0.0], [0.0, 4.0]]", "crosses itself"),
        (f"{HEAD}inside = []", "inside is empty"),
        (f"{HEAD}", "inside must be a list"),
        (f"{HEAD}inside = [[0.0, 0.0], [1.0, 1.0]]", "at least 3"),
        (f"{HEAD}inside = [[0.0, 0.0], [0.0, 0.0], [1.0, 1.0]]", "is empty: 2 corners"),
        (f"{HEAD}inside = [[0.0, 0.0], [nan, 1.0], [1.0, 1.0]]", "corner 1"),
        (f"{HEAD}inside = [[0.0, 0.0], [inf, 1.0], [1.0, 1.0]]", "corner 1"),
        (f'{HEAD}inside = [[0.0, 0.0], ["x", 1.0], [1.0, 1.0]]', "corner 1"),
        (f'schema = "flightstack.site/1"\nfloor_m = 5.0\nceiling_m = 2.0\ninside = {BOX}', "floor_m = 5"),
        (f"{HEAD}inside = {BOX}\nwidth = 3", "unknown key width"),
        (f'schema = "flightstack.site/2"\ninside = {BOX}', "flightstack.site/1"),
        (f'{HEAD}frame = "utm"\ninside = {BOX}', "frame"),
        (f'{HEAD}frame = "global"\ninside = [[151.2, -33.8], [151.3, -33.8], [151.3, -33.9]]', "swapped"),
        (f"{HEAD}inside = {BOX}\n[[keep_out]]\nradius_m = 1.0", "either polygon or centre"),
        (f"{HEAD}inside = {BOX}\n[[keep_out]]\ncentre = [0.0, 0.0]", "radius_m"),
        (f"{HEAD}inside = {BOX}\n[[keep_out]]\ncentre = [0.0, 0.0]\nradius_m = nan", "radius_m"),
        (f"{HEAD}inside = {BOX}\nkeep_out = 3", "list of tables"),
        (f"{HEAD}inside = [" + "[0.0, 1.0], " * 1_002 + "]", "at most 1000"),
        ("x" * 2_100_000, "more than 1000 edges"),
        ("not = [toml", "not valid TOML"),
        (f"{HEAD}inside = [[{'9' * 5000}, 0.0], [4.0, 0.0], [4.0, 4.0]]", "not valid TOML"),
        (f"{HEAD}inside = [[0x{'f' * 5000}, 0.0], [4.0, 0.0], [4.0, 4.0]]", "corner 0"),
        (f"{HEAD}inside = [[1{'0' * 400}, 0.0], [4.0, 0.0], [4.0, 4.0]]", "corner 0"),
        (f"{HEAD}inside = [[0x{'f' * 5000}], [4.0, 0.0], [4.0, 4.0]]", "corner 0"),
    ],
)
def test_a_bad_site_is_one_line(text: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        parse_site(text, "site.toml")
    assert said in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300


def _plan(polygons: list[object], circles: list[object] | None = None) -> str:
    fence = {"version": 2, "polygons": polygons, "circles": circles or []}
    return json.dumps({"fileType": "Plan", "version": 1, "geoFence": fence})


SQUARE = [[47.0, 8.0], [47.001, 8.0], [47.001, 8.001], [47.0, 8.001]]


def test_a_plan_s_fence() -> None:
    circle = {"inclusion": False, "circle": {"center": [47.0005, 8.0005], "radius": 10.0}}
    site = parse_site(_plan([{"inclusion": True, "polygon": SQUARE}], [circle]), "field.plan")
    assert site.is_global
    assert len(site.inside) == 4
    assert site.keep_outs[0].radius_m == 10.0
    flat = site.local(47.0, 8.0)
    # PX4's local frame, on a sphere of 6371 km: 0.001 degree is 111.195 m, times cos 47.001 degrees to the east
    np.testing.assert_allclose(flat.inside[2], [111.195, 75.834], atol=0.002)


def test_a_plan_that_lost_its_file_type_is_a_plan_all_the_same() -> None:
    fence = {"polygons": [{"inclusion": True, "polygon": SQUARE}], "circles": []}
    assert len(parse_site(json.dumps({"geoFence": fence}), "field.plan").inside) == 4
    with pytest.raises(InputError, match=r"geoFence\.polygons must be a list of objects"):
        parse_site('{"geoFence": {"polygons": "x"}}', "field.plan")


@pytest.mark.parametrize("place", [(0.0, 180.0), (12.0, -180.0), (89.999, 20.0), (-90.0, 0.0), (-89.9995, -170.0)])
def test_a_field_across_the_antimeridian_or_a_pole(place: tuple[float, float]) -> None:
    """A box of 200 x 100 m round a place, by Snyder's inverse formulas, comes out as drawn."""
    frame, box = LocalFrame(*place, 0.0), [(-100.0, -50.0), (100.0, -50.0), (100.0, 50.0), (-100.0, 50.0)]
    corners = [(lat, math.remainder(lon, 360.0)) for lat, lon in (frame.to_globe(*corner) for corner in box)]
    circle = {"inclusion": False, "circle": {"center": list(corners[2]), "radius": 10.0}}
    for shape in ([{"inclusion": True, "polygon": corners}], [{"inclusion": True, "polygon": corners[::-1]}]):
        flat = parse_site(_plan(list(shape), [circle]), "field.plan").local(*place)
        np.testing.assert_allclose(np.sort(flat.inside, axis=0), np.sort(box, axis=0), atol=1e-3)
        np.testing.assert_allclose(flat.keep_outs[0].centre, box[2], atol=1e-3)
    round_one = {"inclusion": True, "circle": {"center": list(place), "radius": 100.0}}
    flat = parse_site(_plan([], [round_one]), "field.plan").local(*place)
    np.testing.assert_allclose(np.hypot(*flat.inside.T), 100.0, atol=1e-3)


def test_a_round_fence_is_the_polygon_inside_it() -> None:
    circle = {"inclusion": True, "circle": {"center": [47.0, 8.0], "radius": 100.0}}
    flat = parse_site(_plan([], [circle]), "field.plan").local(47.0, 8.0)
    reach = np.hypot(*flat.inside.T)
    assert len(flat.inside) == 64
    np.testing.assert_allclose(reach, 100.0, atol=1e-3)


def test_geojson_with_a_hole_and_a_keep_out() -> None:
    ring = [[b, a] for a, b in [*SQUARE, SQUARE[0]]]
    hole = [[8.0004, 47.0004], [8.0006, 47.0004], [8.0006, 47.0006], [8.0004, 47.0004]]
    feature = {
        "type": "Feature",
        "properties": {"ceiling_m": 30.0},
        "geometry": {"type": "Polygon", "coordinates": [ring, hole]},
    }
    mast = {"type": "Feature", "properties": {"keep_out": True}, "geometry": {"type": "Polygon", "coordinates": [hole]}}
    site = parse_site(json.dumps({"type": "FeatureCollection", "features": [feature, mast]}), "field.geojson")
    assert site.ceiling_m == 30.0
    assert site.edges == 4 + 3 + 3
    assert site.inside[1].tolist() == SQUARE[1]


def test_a_multipolygon_of_one_polygon_with_holes() -> None:
    """As geographic information systems write them; several areas to stay in are told apart by their number."""
    ring = [[b, a] for a, b in [*SQUARE, SQUARE[0]]]
    hole = [[8.0004, 47.0004], [8.0006, 47.0004], [8.0006, 47.0006], [8.0004, 47.0004]]
    far = [[x + 0.01, y] for x, y in ring]
    site = parse_site(json.dumps({"type": "MultiPolygon", "coordinates": [[ring, hole, hole]]}), "field.geojson")
    assert [each.name for each in site.keep_outs] == ["feature 0: hole 0", "feature 0: hole 1"]
    both = {"type": "MultiPolygon", "coordinates": [[ring], [far]]}
    with pytest.raises(InputError, match="2 polygons to stay in"):
        parse_site(json.dumps(both), "field.geojson")
    blocks = {"type": "Feature", "properties": {"keep_out": True}, "geometry": both}
    field = {"type": "Feature", "properties": None, "geometry": {"type": "Polygon", "coordinates": [ring]}}
    site = parse_site(json.dumps({"type": "FeatureCollection", "features": [field, blocks]}), "field.geojson")
    assert [each.name for each in site.keep_outs] == ["feature 1: polygon 0", "feature 1: polygon 1"]


@pytest.mark.parametrize(
    ("text", "name", "said"),
    [
        ('{"type": "MultiPolygon", "coordinates": [[], 3]}', "a.geojson", "polygon 0 is empty"),
        ('{"type": "MultiPolygon", "coordinates": []}', "a.geojson", "0 polygons"),
        ('{"type": "MultiPolygon"}', "a.geojson", "needs coordinates"),
        (_plan([]), "a.plan", "0 areas"),
        (_plan([{"inclusion": True, "polygon": SQUARE}] * 2), "a.plan", "2 areas"),
        (_plan([{"inclusion": True, "polygon": [[47.0, None], [1.0, 2.0], [2.0, 3.0]]}]), "a.plan", "corner 0"),
        ('{"fileType": "Plan"}', "a.plan", "no fence"),
        ("[1]", "a.geojson", "neither"),
        ('{"type": "Point", "coordinates": [1, 2]}', "a.geojson", "only a Polygon"),
        ("{", "a.geojson", "not valid JSON"),
        ("[" * 100_000, "a.geojson", "nested too deeply"),
    ],
)
def test_a_bad_import_is_one_line(text: str, name: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        parse_site(text, name)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "is_taken"),
    [
        ("urn:ogc:def:crs:OGC:1.3:CRS84", True),
        ("EPSG:4326", True),
        ("urn:ogc:def:crs:EPSG::4326", True),
        ("urn:ogc:def:crs:EPSG::4267", False),  # NAD27, in degrees: up to 200 m from WGS 84
        ("EPSG:3857", False),
        (4326, False),
    ],
)
@pytest.mark.parametrize("place", ["top", "feature", "geometry"])
def test_coordinates_of_another_reference_system_are_refused(name: object, is_taken: bool, place: str) -> None:
    feature = _feature({})
    collection = {"type": "FeatureCollection", "features": [feature]}
    where = {"top": collection, "feature": feature, "geometry": feature["geometry"]}[place]
    where["crs"] = {"type": "name", "properties": {"name": name}}  # type: ignore[index]
    if is_taken:
        assert parse_site(json.dumps(collection), "a.geojson").edges == 4
        return
    with pytest.raises(InputError, match=f"crs = .*{name}.*longitude and latitude of WGS 84"):
        parse_site(json.dumps(collection), "a.geojson")


def test_a_site_elsewhere_and_swapped_coordinates() -> None:
    site = parse_site(_plan([{"inclusion": True, "polygon": SQUARE}]), "field.plan")
    with pytest.raises(InputError, match="km from the vehicle"):
        site.local(40.0, 8.0)
    swapped = parse_site(_plan([{"inclusion": True, "polygon": [[b, a] for a, b in SQUARE]}]), "field.plan")
    with pytest.raises(InputError, match="swapped"):
        swapped.local(47.0, 8.0)


def _feature(said: dict[str, object], size: float = 1e-3, kind: str = "Polygon") -> dict[str, object]:
    ring = [[8.0, 47.0], [8.0 + size, 47.0], [8.0 + size, 47.0 + size], [8.0, 47.0 + size], [8.0, 47.0]]
    return {"type": "Feature", "properties": said, "geometry": {"type": kind, "coordinates": [ring]}}


def test_whether_to_stay_in_or_out_is_said_by_true_or_false_only() -> None:
    """The text "false" was taken for a keep-out, and null in a plan for one as well."""
    for said in ("false", 0, None):
        collection = {"type": "FeatureCollection", "features": [_feature({}), _feature({"keep_out": said}, 1e-4)]}
        with pytest.raises(InputError, match=r"^a\.geojson: feature 1: keep_out = .* must be true or false$"):
            parse_site(json.dumps(collection), "a.geojson")
        fence = {"polygons": [{"polygon": [[47.0, 8.0], [47.001, 8.0], [47.0, 8.001]], "inclusion": said}]}
        with pytest.raises(InputError, match=r"^a\.plan: fence polygon 0: inclusion = .* must be true or false$"):
            parse_site(json.dumps({"fileType": "Plan", "geoFence": fence}), "a.plan")


def test_a_height_that_is_null_is_not_given() -> None:
    site = parse_site(json.dumps(_feature({"floor_m": None, "ceiling_m": None})), "a.geojson")
    assert (site.floor_m, site.ceiling_m) == (0.0, 120.0)


def test_a_byte_order_mark_is_no_fault() -> None:
    assert parse_site("\ufeff" + json.dumps(_feature({})), "a.geojson").edges == 4


def test_a_polygon_without_area_is_empty() -> None:
    with pytest.raises(InputError, match=r"^a\.toml: inside is empty: its corners lie on one line$"):
        parse_site(f"{HEAD}inside = [[0.0, 0.0], [2.0, 2.0], [4.0, 4.0]]", "a.toml")


def test_solids_count_as_edges() -> None:
    """Each is looked at as an edge is, in every tick; 2,000 of them passed."""
    solids = "[[keep_out]]\ncentre = [3.0, 3.0]\nradius_m = 0.5\n" * 1000
    with pytest.raises(InputError, match=r"^a\.toml: 1004 edges in all, at most 1000 are taken"):
        parse_site(f"{HEAD}inside = {BOX}\n{solids}", "a.toml")
