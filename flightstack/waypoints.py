"""Waypoints as text (TOML or CSV) to a minimum-snap trajectory within stated limits.

TOML: `schema = "flightstack.waypoints/1"`, optional `speed_mps`, `acceleration_mps2`, and `waypoints`, a list of
[north_m, east_m, down_m], [..., yaw_rad] or [..., yaw_rad, time_s].  CSV: a header of the columns north_m, east_m,
down_m and optionally yaw_rad, time_s (or n, e, d, yaw, time), then a row a waypoint.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from flightstack.checked import load_toml, number
from flightstack.model import Limits
from flightstack.trajectory import Polynomial, minimum_snap
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, InputError

SCHEMA = "flightstack.waypoints/1"
_COLUMNS = ("north_m", "east_m", "down_m", "yaw_rad", "time_s")
_SHORT = {"n": "north_m", "e": "east_m", "d": "down_m", "yaw": "yaw_rad", "time": "time_s"}
_YAW = 3
_MOST = 100
_FARTHEST_M = 1000.0
_LEAST_HEIGHT_M = 0.3
_LEAST_SPAN_S = 0.4
_SAMPLES = 40


@dataclass(frozen=True, slots=True)
class Waypoints:
    """Points to fly through, relative to the start, and how fast."""

    points: tuple[tuple[float, float, float, float], ...]
    """(north m, east m, down m, yaw rad) each."""
    times_s: tuple[float, ...] | None = None
    """Time of each, first 0; None: from the speed and acceleration."""
    speed_mps: float = 2.0
    acceleration_mps2: float = 3.0


def parse_waypoints(text: str, source: str) -> Waypoints:
    """The waypoints of a TOML or CSV text (told by its content); InputError in one line."""
    first = next((line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")), "")
    if "=" in first or first.lstrip().startswith("["):
        return _parse_toml(text, source)
    return _parse_csv(text, source)


def _parse_toml(text: str, source: str) -> Waypoints:
    data = load_toml(text, source, SCHEMA, ("speed_mps", "acceleration_mps2", "waypoints"))
    return check_waypoints(
        data.get("waypoints"), source, data.get("speed_mps", 2.0), data.get("acceleration_mps2", 3.0)
    )


def _parse_csv(text: str, source: str) -> Waypoints:
    rows = [row for row in csv.reader(io.StringIO(text)) if row and not row[0].lstrip().startswith("#")]
    if not rows:
        raise InputError(f"{source}: no waypoints; give TOML, or CSV with a header such as {','.join(_COLUMNS)}")
    header = [_SHORT.get(name.strip(), name.strip()) for name in rows[0]]
    unknown = [name for name in header if name not in _COLUMNS]
    if unknown or len(set(header)) != len(header) or not set(_COLUMNS[:3]) <= set(header):
        raise InputError(
            f"{source}: header {','.join(rows[0])} is not understood; give {','.join(_COLUMNS[:3])}"
            " and if wanted yaw_rad,time_s"
        )
    listed: list[list[float]] = []
    for count, row in enumerate(rows[1:], start=1):
        try:
            values = dict(zip(header, (float(cell) for cell in row), strict=True))
        except ValueError:
            raise InputError(f"{source}: waypoint {count}: {','.join(row)} must be {len(header)} numbers") from None
        point = [values[name] for name in _COLUMNS[:3]] + [values.get("yaw_rad", 0.0)]
        listed.append([*point, values["time_s"]] if "time_s" in values else point)
    return check_waypoints(listed, source, 2.0, 3.0)


def check_waypoints(value: object, source: str, speed_mps: object, acceleration_mps2: object) -> Waypoints:
    """Waypoints from lists of 3 (position), 4 (and yaw) or 5 numbers (and time); InputError names the waypoint."""
    if not isinstance(value, Sequence) or isinstance(value, str) or not 2 <= len(value) <= _MOST:
        raise InputError(f"{source}: waypoints must be a list of 2 to {_MOST} waypoints, each {', '.join(_COLUMNS)}")
    points: list[tuple[float, float, float, float]] = []
    times: list[float] = []
    for count, item in enumerate(value, start=1):
        where = f"{source}: waypoint {count}"
        if not isinstance(item, Sequence) or isinstance(item, str) or not 3 <= len(item) <= 5:
            raise InputError(f"{where} = {item!r} must be a list of 3 to 5 numbers: {', '.join(_COLUMNS)}")
        numbers = [
            number(part, f"{where}: {name}", -_FARTHEST_M, _FARTHEST_M)
            for part, name in zip(item, _COLUMNS, strict=False)
        ]
        points.append((numbers[0], numbers[1], numbers[2], numbers[_YAW] if len(numbers) > _YAW else 0.0))
        if numbers[2] > -_LEAST_HEIGHT_M:
            raise InputError(f"{where}: down_m = {numbers[2]:g} is too low; it must be at most -{_LEAST_HEIGHT_M:g} m")
        if count > 1 and math.dist(points[-1][:3], points[-2][:3]) < 1e-3:
            raise InputError(f"{where} is where the one before it is; leave one of them out")
        times += numbers[4:]
    if times and len(times) != len(points):
        raise InputError(
            f"{source}: {len(times)} of {len(points)} waypoints have a time_s; give all of them one, or none"
        )
    for count, (before, after) in enumerate(pairwise(times), start=2):
        if after - before < _LEAST_SPAN_S:
            raise InputError(
                f"{source}: waypoint {count}: time_s = {after:g} must be at least {_LEAST_SPAN_S:g} s after {before:g}"
            )
    speed = number(speed_mps, f"{source}: speed_mps", 0.05, 30.0)
    acceleration = number(acceleration_mps2, f"{source}: acceleration_mps2", 0.05, 30.0)
    shifted = tuple(time - times[0] for time in times) if times else None
    return Waypoints(tuple(points), shifted, speed, acceleration)


def waypoint_trajectory(waypoints: Waypoints, source: str, limits: Limits) -> Polynomial:
    """Minimum snap through the waypoints, from rest to rest; InputError names the first leg that cannot be flown.

    Without times the legs get theirs from distance, speed and acceleration, and then all are stretched or shortened
    together until the path's peak speed or acceleration is the allowed one (exact: scaling time by k scales speed
    by 1/k and acceleration by 1/k^2).
    """
    points = np.array(waypoints.points)
    points[:, _YAW] = np.unwrap(points[:, _YAW])
    if waypoints.times_s is not None:
        path = minimum_snap(points, np.array(waypoints.times_s))
    else:
        spans = _spans(points, waypoints)
        path = minimum_snap(points, np.concatenate([[0.0], np.cumsum(spans)]))
        _, speeds, accelerations, _ = _sampled(path)
        stretch = max(
            float(speeds.max()) / waypoints.speed_mps,
            math.sqrt(float(accelerations.max()) / waypoints.acceleration_mps2),
        )
        path = minimum_snap(points, path.knots_s * stretch)
    _check_flyable(path, source, limits)
    return path


def _spans(points: F64, waypoints: Waypoints) -> F64:
    """Seconds for each leg: a trapezoid of speed from rest to rest; yaw at 1 rad/s at most on average."""
    distance = np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1)
    ramp = waypoints.speed_mps / waypoints.acceleration_mps2
    cruise = distance / waypoints.speed_mps + ramp
    short = 2.0 * np.sqrt(distance / waypoints.acceleration_mps2)
    spans = np.where(distance > waypoints.speed_mps * ramp, cruise, short)
    least: F64 = np.maximum(np.maximum(spans, np.abs(np.diff(points[:, _YAW]))), _LEAST_SPAN_S)
    return least


def _sampled(path: Polynomial) -> tuple[F64, F64, F64, list[int]]:
    """Down coordinate, speed and acceleration along the path, and the leg (from 1) of each sample."""
    times, legs = [], []
    for leg, (start, end) in enumerate(zip(path.knots_s[:-1], path.knots_s[1:], strict=True), start=1):
        times += np.linspace(start, end, _SAMPLES).tolist()
        legs += [leg] * _SAMPLES
    points = [path.at(t) for t in times]
    down = np.array([p.pos_ned_m[2] for p in points])
    speed = np.array([np.linalg.norm(p.vel_ned_mps) for p in points])
    return down, speed, np.array([np.linalg.norm(p.acc_ned_mps2) for p in points]), legs


def _check_flyable(path: Polynomial, source: str, limits: Limits) -> None:
    """Thrust and tilt that flatness asks for, without drag, and height; InputError names the waypoint."""
    for leg, (start, end) in enumerate(zip(path.knots_s[:-1], path.knots_s[1:], strict=True), start=1):
        where = f"{source}: on the way to waypoint {leg + 1}"
        for t in np.linspace(start, end, _SAMPLES):
            point = path.at(float(t))
            up = (STANDARD_GRAVITY_MPS2 - point.acc_ned_mps2[2]) / STANDARD_GRAVITY_MPS2
            sideways = math.hypot(point.acc_ned_mps2[0], point.acc_ned_mps2[1]) / STANDARD_GRAVITY_MPS2
            weights = math.hypot(up, sideways)
            if not limits.thrust_min_weights <= weights <= limits.thrust_max_weights:
                raise InputError(
                    f"{where} thrust would be {weights:.2f} weights; allowed are {limits.thrust_min_weights:g} to "
                    f"{limits.thrust_max_weights:g}: give more time or a lower acceleration_mps2"
                )
            tilt = math.atan2(sideways, up)
            if tilt > limits.tilt_max_rad:
                raise InputError(
                    f"{where} tilt would be {math.degrees(tilt):.0f} degrees; allowed are "
                    f"{math.degrees(limits.tilt_max_rad):.0f}: give more time or a lower acceleration_mps2"
                )
            if point.pos_ned_m[2] > -0.5 * _LEAST_HEIGHT_M:
                raise InputError(
                    f"{where} the path dips to {-point.pos_ned_m[2]:.2f} m above the start; add a waypoint"
                )
