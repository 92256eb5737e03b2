"""Site files: `flightstack.site/1` (TOML), fences of QGroundControl's `.plan`, polygons of GeoJSON; docs/site.md.

What a file does not say: no floor is the ground (0 m), no ceiling is 120 m.  A hole of a polygon is a keep-out.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flightstack.checked import load_toml, number, only, shown
from flightstack.geodesy import LocalFrame
from flightstack.site.shape import FAR_M, MOST_EDGES, KeepOut, Site, checked
from flightstack.types import F64, InputError

SCHEMA = "flightstack.site/1"
MOST_BYTES = 2_000_000
_CEILING_M = 120.0
_HEIGHT_M = 10_000.0
_FOREIGN = ("kml", "kmz", "gpx", "shp", "gpkg", "dxf", "waypoints", "mission", "fence", "csv", "txt", "wkt")
_LIKE_OURS = re.compile(r"(floor|ceiling)(m|ft|feet|foot|met(er|re)s?|alt(itude)?|height|agl|amsl|msl)*|keepouts?")
_MOST = 1e9
"""Of a coordinate: beyond what any map's metres need."""
_LEAST_M = 0.1
_ROUND_CORNERS = 64
"""A round fence to stay in is taken as the regular polygon inside it."""


def parse_site(text: str, source: str) -> Site:
    """The site of a file's text; `source` is its path, whose ending says what it is.  InputError, one line."""
    if len(text) > MOST_BYTES:
        raise InputError(f"{source}: {len(text)} bytes hold more than {MOST_EDGES} edges, the most that are taken")
    ending, text = source.lower().rpartition(".")[2], text.removeprefix("\ufeff")
    if ending in _FOREIGN or text.lstrip()[:1] == "<":
        raise InputError(
            f"{source}: a site is .toml, a QGroundControl .plan or GeoJSON (.geojson, .json); export it as one of them"
        )
    try:
        if ending in ("plan", "geojson", "json"):
            return checked(_from_json(text, source))
        return _require_metres(checked(_from_toml(text, source)))
    except RecursionError:
        raise InputError(f"{source}: nested too deeply") from None


def _from_toml(text: str, source: str) -> Site:
    known = ("frame", "floor_m", "ceiling_m", "inside", "keep_out", "chute")
    data = load_toml(text, source, SCHEMA, known)
    frame = data.get("frame", "local")
    if frame not in ("local", "global"):
        raise InputError(f'{source}: frame = {shown(frame)} is not known; it must be "local" or "global"')
    keep_outs = data.get("keep_out", [])
    if not isinstance(keep_outs, list):
        raise InputError(f"{source}: keep_out must be a list of tables: [[keep_out]]")
    return Site(
        source,
        frame == "global",
        _corners(data.get("inside"), f"{source}: inside"),
        _height(data, "floor_m", 0.0, source),
        _height(data, "ceiling_m", _CEILING_M, source),
        tuple(_keep_out(each, f"keep_out {i}", source) for i, each in enumerate(keep_outs)),
        _chute(data.get("chute"), source),
    )


def _require_metres(site: Site) -> Site:
    """The site itself; InputError where its corners are degrees that were not said to be."""
    wide = float(np.ptp(site.inside, axis=0).max())
    if not site.is_global and wide < _LEAST_M:
        raise InputError(f'{site.source}: inside is {wide:.2g} m wide; corners in degrees need frame = "global"')
    return site


def _chute(value: object, source: str) -> float | None:
    if value is None:
        return None
    if not isinstance(value, Mapping):
        raise InputError(f"{source}: chute must be a table with radius_m")
    only(value, ("radius_m",), f"{source}: chute")
    return number(value.get("radius_m"), f"{source}: chute.radius_m", 0.1, 1000.0)


def _keep_out(value: object, name: str, source: str) -> KeepOut:
    where = f"{source}: {name}"
    if not isinstance(value, Mapping):
        raise InputError(f"{where} must be a table")
    only(value, ("polygon", "centre", "radius_m", "floor_m", "ceiling_m"), where)
    floor, ceiling = _height(value, "floor_m", -math.inf, where), _height(value, "ceiling_m", math.inf, where)
    if ("polygon" in value) == ("centre" in value):
        raise InputError(f"{where} must have either polygon or centre with radius_m")
    if "polygon" in value:
        if "radius_m" in value:
            raise InputError(f"{where}.radius_m belongs to centre, not to polygon")
        return KeepOut(name, _corners(value["polygon"], f"{where}.polygon"), floor_m=floor, ceiling_m=ceiling)
    centre = value["centre"]
    if not isinstance(centre, Sequence) or isinstance(centre, str) or len(centre) not in (2, 3):
        raise InputError(f"{where}.centre = {shown(centre)} must be 2 numbers, or 3 (with the height) of a sphere")
    places = [number(part, f"{where}.centre", -2.0 * FAR_M, 2.0 * FAR_M) for part in centre]
    radius = number(value.get("radius_m"), f"{where}.radius_m", 1e-3, FAR_M)
    if len(places) == 3 and ("floor_m" in value or "ceiling_m" in value):
        raise InputError(f"{where}: a sphere (centre of 3 numbers) has no floor_m and ceiling_m")
    height = places[2] if len(places) == 3 else math.nan
    return KeepOut(name, None, (places[0], places[1]), radius, floor, ceiling, height)


def _height(table: Mapping[str, object], key: str, missing: float, where: str) -> float:
    given = table.get(key)
    return missing if given is None else number(given, f"{where}: {key}", -_HEIGHT_M, _HEIGHT_M)


def _switch(table: Mapping[str, object], key: str, missing: bool, where: str) -> bool:
    given = table.get(key, missing)
    if not isinstance(given, bool):
        raise InputError(f"{where}: {key} = {shown(given)} must be true or false")
    return given


def _corners(value: object, where: str) -> F64:
    """(n, 2); a corner that repeats the one before it, or the first at the end, is dropped."""
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise InputError(f"{where} must be a list of corners, each 2 numbers")
    if len(value) > MOST_EDGES + 1:
        raise InputError(f"{where}: {len(value)} edges, at most {MOST_EDGES} are taken: simplify it")
    found: list[list[float]] = []
    for i, corner in enumerate(value):
        if not isinstance(corner, Sequence) or isinstance(corner, str) or len(corner) < 2:
            raise InputError(f"{where}: corner {i} = {shown(corner)} must be 2 numbers")
        place = [number(part, f"{where}: corner {i}", -_MOST, _MOST) for part in corner[:2]]
        if not found or place != found[-1]:
            found.append(place)
    if len(found) > 1 and found[0] == found[-1]:
        found.pop()
    return np.array(found, dtype=np.float64).reshape(-1, 2)


def _from_json(text: str, source: str) -> Site:
    try:
        data = json.loads(text)
    except ValueError as error:
        raise InputError(f"{source}: not valid JSON: {error}") from None
    if not isinstance(data, Mapping):
        raise InputError(f"{source}: neither a QGroundControl plan nor GeoJSON")
    if data.get("fileType") == "Plan" or "geoFence" in data:
        return _from_plan(data, source)
    return _from_geojson(data, source)


def _from_plan(data: Mapping[str, Any], source: str) -> Site:
    """The fence of a plan: one polygon or circle to stay in, any number to keep out of.

    Version 1 of a fence, which ground stations wrote until 2018, is one polygon to stay in.
    """
    fence = data.get("geoFence")
    if not isinstance(fence, Mapping):
        raise InputError(f"{source}: the plan has no fence (geoFence)")
    inside: list[F64] = []
    out: list[KeepOut] = []
    if fence.get("polygon") and "polygons" not in fence:
        inside.append(_corners(fence["polygon"], f"{source}: fence polygon"))
    for i, each in enumerate(_listed(fence, "polygons", source)):
        polygon = _corners(each.get("polygon"), f"{source}: fence polygon {i}")
        if _switch(each, "inclusion", True, f"{source}: fence polygon {i}"):
            inside.append(polygon)
        else:
            out.append(KeepOut(f"fence polygon {i}", polygon))
    for i, each in enumerate(_listed(fence, "circles", source)):
        circle, where = each.get("circle"), f"{source}: fence circle {i}"
        if not isinstance(circle, Mapping):
            raise InputError(f"{where} has no circle")
        centre = _corners([circle.get("center")], f"{where}: center")[0].tolist()
        radius = number(circle.get("radius"), f"{where}: radius", 1e-3, FAR_M)
        if _switch(each, "inclusion", True, where):
            inside.append(_round(centre, radius))
        else:
            out.append(KeepOut(f"fence circle {i}", None, (centre[0], centre[1]), radius))
    if len(inside) != 1:
        raise InputError(f"{source}: the fence has {len(inside)} areas to stay in; exactly one is taken")
    return Site(source, True, inside[0], 0.0, _CEILING_M, tuple(out))


def _listed(fence: Mapping[str, Any], key: str, source: str) -> list[Mapping[str, Any]]:
    found = fence.get(key, [])
    if not isinstance(found, list) or not all(isinstance(each, Mapping) for each in found):
        raise InputError(f"{source}: geoFence.{key} must be a list of objects")
    return found


def _round(centre: Sequence[float], radius_m: float) -> F64:
    """(64, 2) degrees: the regular polygon whose corners lie on the circle."""
    frame, found = LocalFrame(centre[0], centre[1], 0.0), []
    for angle in np.linspace(0.0, 2.0 * math.pi, _ROUND_CORNERS, endpoint=False).tolist():
        lat, lon = frame.to_globe(radius_m * math.cos(angle), radius_m * math.sin(angle))
        found.append((lat, math.remainder(lon, 360.0)))
    return np.array(found)


def _from_geojson(data: Mapping[str, Any], source: str) -> Site:
    """One polygon to stay in; further features with "keep_out": true are kept out of."""
    kind = data.get("type")
    _require_wgs84(data, source)
    features = data.get("features") if kind == "FeatureCollection" else [data]
    if not isinstance(features, list):
        raise InputError(f"{source}: neither a QGroundControl plan nor GeoJSON")
    inside: list[tuple[F64, float, float]] = []
    out: list[KeepOut] = []
    for i, feature in enumerate(features):
        where = f"{source}: feature {i}"
        polygons, said = _geometry(feature, where)
        for k, polygon in enumerate(polygons):
            part = where if len(polygons) == 1 else f"{where}: polygon {k}"
            rings = _rings(polygon, part)
            name = part.removeprefix(f"{source}: ")
            if _switch(said, "keep_out", False, where):
                floor, ceiling = _height(said, "floor_m", -math.inf, where), _height(said, "ceiling_m", math.inf, where)
                out.append(KeepOut(name, rings[0], floor_m=floor, ceiling_m=ceiling))
                continue
            inside.append(
                (rings[0], _height(said, "floor_m", 0.0, where), _height(said, "ceiling_m", _CEILING_M, where))
            )
            out.extend(KeepOut(f"{name}: hole {k}", ring) for k, ring in enumerate(rings[1:]))
    if len(inside) != 1:
        raise InputError(
            f'{source}: {len(inside)} polygons to stay in, exactly one is taken ("keep_out": true marks the others)'
        )
    return Site(source, True, *inside[0], tuple(out))


def _require_wgs84(part: Mapping[str, Any], where: str) -> None:
    """Of an older GeoJSON's reference system (`crs`): InputError where it is not what GeoJSON's places are in today."""
    given = part.get("crs")
    if given is None:
        return
    said = given.get("properties") if isinstance(given, Mapping) else given
    name = said.get("name") if isinstance(said, Mapping) else said
    if not isinstance(name, str) or not name.upper().endswith((":CRS84", ":4326")):
        raise InputError(
            f"{where}: crs = {shown(name)} is not taken, only longitude and latitude of WGS 84 (EPSG:4326)"
        )


def _geometry(feature: object, where: str) -> tuple[list[Any], Mapping[str, Any]]:
    """The polygons (each a list of rings) of a feature or a bare geometry, and what its properties say."""
    if not isinstance(feature, Mapping):
        raise InputError(f"{where} is no GeoJSON object")
    _require_wgs84(feature, where)
    is_feature = feature.get("type") == "Feature"
    shape = feature.get("geometry") if is_feature else feature
    said = feature.get("properties") if is_feature else {}
    kind = shape.get("type") if isinstance(shape, Mapping) else shape
    if is_feature and shape is None:
        raise InputError(f"{where} has no geometry: only a Polygon or a MultiPolygon is taken")
    if not isinstance(shape, Mapping) or kind not in ("Polygon", "MultiPolygon"):
        raise InputError(f"{where}: {shown(kind)} is not taken, only a Polygon or a MultiPolygon is")
    _require_wgs84(shape, where)
    found = shape.get("coordinates")
    if not isinstance(found, list):
        raise InputError(f"{where}: a {kind} needs coordinates")
    said = said if isinstance(said, Mapping) else {}
    for key in said:
        plain = "".join(filter(str.isalnum, key.lower()))
        if _LIKE_OURS.fullmatch(plain) and key not in ("floor_m", "ceiling_m", "keep_out"):
            raise InputError(
                f"{where}: property {shown(key)} is not known; floor_m and ceiling_m (metres) and keep_out (true or "
                "false) are"
            )
    return ([found] if kind == "Polygon" else found), said


def _rings(polygon: object, where: str) -> list[F64]:
    """The rings of a polygon, each (n, 2): latitude, longitude of GeoJSON's longitude, latitude."""
    if not isinstance(polygon, list) or not polygon:
        raise InputError(f"{where} is empty: it has no ring")
    return [_corners(ring, f"{where}: ring {k}")[:, ::-1].copy() for k, ring in enumerate(polygon)]
