"""Scenario files (TOML, `flightstack.scenario/1`): what is flown, in what world, and what counts as success.

A scenario names a trajectory, how the true vehicle differs from the believed one, the sensors' grade, the region to
stay in, timed events and checks in words.  Pure text; coordinates are relative to the position at arming, NED.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flightstack.barrier.initial import InitialKnowledge
from flightstack.checked import load_toml, number, only, table, vector, words
from flightstack.dotted import changed_vehicle, flattened
from flightstack.effects import check_effect
from flightstack.model import Limits
from flightstack.moves import moves
from flightstack.region import Region
from flightstack.trajectory import Trajectory, figure8, hover, sinusoid
from flightstack.types import InputError, Tuple3
from flightstack.vehicle import Vehicle, scaled, with_effects
from flightstack.waypoints import Waypoints, check_waypoints, waypoint_trajectory

SCHEMA = "flightstack.scenario/1"
_KEYS = (
    "name", "description", "duration_s", "sensors", "trajectory", "limits", "truth", "region", "knowledge", "events",
    "checks", "grade", "flight",
)  # fmt: skip
_SENSORS = ("mocap", "gps", "px4-sih", "px4-sih-ekf")
_DURATION_S = (1.0, 3600.0)
_FAR_M = 1000.0
_ENVELOPE_MARGIN_M, _REGION_MARGIN_M = 5.0, 1.0
"""Of the guard's envelope: beyond the path; beyond the region, what an estimated place may be off by with GPS."""
_LEAST_HEIGHT_M = 0.15

Effects = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class ScenarioTruth:
    """How the vehicle that really flies differs from the believed one."""

    mass_ratio: float = 1.0
    """True over believed mass."""
    constant_force_weights: Tuple3 = (0.0, 0.0, 0.0)
    """North, east, down, in true weights."""
    effects: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = ()
    """Effects set on top: (name, ((parameter, value), ...))."""
    changes: Mapping[str, object] = field(default_factory=dict)
    """Dotted keys of the vehicle's file and their values, set last: [truth.vehicle]."""


@dataclass(frozen=True, slots=True)
class TimedEvent:
    """An effect takes new values in flight."""

    time_s: float
    """Since the track began."""
    effect: str
    values: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class Check:
    """One condition on the flight's result."""

    metric: str
    """Dotted path in the flight's JSON, such as tracking.rmse_m."""
    below: float | None
    above: float | None
    words: str
    """What it means when it holds."""


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """One scenario, checked."""

    name: str
    description: str
    duration_s: float
    """Of the track, from the end of the run-up to the command to land."""
    sensors: str
    trajectory: Trajectory
    limits: Limits
    truth: ScenarioTruth
    region: Region | None
    events: tuple[TimedEvent, ...]
    checks: tuple[Check, ...]
    knowledge: InitialKnowledge | None = None
    """What is known of the true vehicle before take-off; None: nothing is claimed."""
    climb_to_m: float | None = None
    """Height above the start to climb to and settle at before the track; None: that of the trajectory's first point."""
    run_up_s: float = 0.0
    """The way to the track's beginning takes so long at least."""
    grade_changes: Mapping[str, object] = field(default_factory=dict)
    """Dotted keys of the sensors' grade and their values: what flies differs so from what is believed of it."""
    flight: Mapping[str, object] = field(default_factory=dict)
    """Options of `fly` that hold where the command line says nothing else."""

    def truth_vehicle(self, believed: Vehicle) -> Vehicle:
        """The vehicle that really flies: the believed one, heavier or lighter, with the truth's force and effects."""
        effects = {name: dict(values) for name, values in self.truth.effects}
        true = with_effects(scaled(believed, mass_ratio=self.truth.mass_ratio), effects, source=self.name)
        force = self.truth.constant_force_weights
        if any(force):
            north, east, down = (share * true.weight_n for share in force)
            true = with_effects(true, {"constant_force": {"north_n": north, "east_n": east, "down_n": down}})
        return changed_vehicle(true, self.truth.changes, self.name)

    def with_duration(self, duration_s: float) -> Scenario:
        """The same scenario with another length of the track; InputError outside 1 to 3600 s."""
        return replace(self, duration_s=number(duration_s, f"{self.name}: duration_s", *_DURATION_S))

    def slowed(self, share: float) -> Scenario:
        """The same path at `share` of its speed: one that ends takes so much longer, one that goes on for ever is flown
        for as long as it was."""
        duration_s = self.duration_s / (share if math.isfinite(self.trajectory.duration_s) else 1.0)
        return replace(self, trajectory=self.trajectory.slowed(share), duration_s=duration_s)


def parse_scenario(text: str, source: str) -> Scenario:
    """The scenario that `text` describes; InputError in one line names `source`, the key and what is allowed."""
    data = load_toml(text, source, SCHEMA, _KEYS)
    limits = _limits(table(data, "limits", source), source)
    trajectory = _trajectory(table(data, "trajectory", source), source, limits)
    duration = data.get("duration_s")
    if duration is None and math.isfinite(trajectory.duration_s):
        duration = trajectory.duration_s
    sensors = data.get("sensors", "mocap")
    if sensors not in _SENSORS:
        raise InputError(f"{source}: sensors = {sensors!r} is not known; known are {', '.join(_SENSORS)}")
    duration_s = number(duration, f"{source}: duration_s", *_DURATION_S)
    region = _region(table(data, "region", source), source) if "region" in data else None
    return Scenario(
        name=words(data.get("name"), f"{source}: name"),
        description=words(data.get("description"), f"{source}: description"),
        duration_s=duration_s,
        sensors=str(sensors),
        trajectory=trajectory,
        limits=_envelope(limits, table(data, "limits", source), trajectory, duration_s, region, source),
        truth=_truth(table(data, "truth", source), source),
        region=region,
        events=tuple(_event(item, f"{source}: event {i}") for i, item in enumerate(_tables(data, "events", source), 1)),
        checks=tuple(_check(item, f"{source}: check {i}") for i, item in enumerate(_tables(data, "checks", source), 1)),
        knowledge=_knowledge(table(data, "knowledge", source), source) if "knowledge" in data else None,
        grade_changes=flattened(table(data, "grade", source)),
        flight=table(data, "flight", source),
    )


def waypoints_scenario(waypoints: Waypoints, source: str) -> Scenario:
    """The scenario `waypoints FILE`: fly through them; the truth is what is believed."""
    limits = Limits()
    trajectory = waypoint_trajectory(waypoints, source, limits)
    return Scenario(
        name="waypoints",
        description=f"minimum-snap flight through the {len(waypoints.points)} waypoints of {source}",
        duration_s=number(trajectory.duration_s, f"{source}: the path's duration_s", *_DURATION_S),
        sensors="mocap",
        trajectory=trajectory,
        limits=_envelope(limits, {}, trajectory, trajectory.duration_s, None, source),
        truth=ScenarioTruth(),
        region=None,
        events=(),
        checks=(),
    )


def _trajectory(data: Mapping[str, object], source: str, limits: Limits) -> Trajectory:
    """One of the kinds below."""
    where = f"{source}: trajectory"
    kind = data.get("kind")
    if kind not in _TRAJECTORIES:
        raise InputError(f"{where}.kind = {kind!r} is not known; known are {', '.join(_TRAJECTORIES)}")
    required, optional = _TRAJECTORIES[str(kind)]
    only(data, ("kind", *required, *optional), where)

    def three(key: str, minimum: float, maximum: float, default: object = None) -> Tuple3:
        return vector(data.get(key, default), f"{where}.{key}", minimum, maximum)

    def one(key: str, minimum: float, maximum: float, default: object = None) -> float:
        return number(data.get(key, default), f"{where}.{key}", minimum, maximum)

    if kind == "waypoints":
        points = check_waypoints(
            data.get("waypoints"), where, data.get("speed_mps", 2.0), data.get("acceleration_mps2", 3.0)
        )
        return waypoint_trajectory(points, where, limits)
    yaw = one("yaw_rad", -math.pi, math.pi, 0.0)
    if kind == "hover":
        return hover(three("position_m", -_FAR_M, _FAR_M), yaw_rad=yaw)
    if kind == "moves":
        return moves(data.get("moves"), three("position_m", -_FAR_M, _FAR_M), yaw, f"{where}.moves")
    if kind == "figure8":
        return figure8(
            length_m=one("length_m", 0.01, 100.0),
            width_m=one("width_m", 0.0, 100.0),
            period_s=one("period_s", 0.5, 600.0),
            height_m=one("height_m", _LEAST_HEIGHT_M, 100.0),
            yaw_rad=yaw,
        )
    return sinusoid(
        three("centre_m", -_FAR_M, _FAR_M),
        three("amplitude_m", -100.0, 100.0),
        three("rate_radps", 0.0, 20.0),
        three("phase_rad", -10.0, 10.0, (0.0, 0.0, 0.0)),
        yaw_rad=yaw,
    )


_TRAJECTORIES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "hover": (("position_m",), ("yaw_rad",)),
    "sinusoid": (("centre_m", "amplitude_m", "rate_radps"), ("phase_rad", "yaw_rad")),
    "figure8": (("length_m", "width_m", "period_s", "height_m"), ("yaw_rad",)),
    "moves": (("position_m", "moves"), ("yaw_rad",)),
    "waypoints": (("waypoints",), ("speed_mps", "acceleration_mps2")),
}
"""Kind -> its keys, required and optional."""


def _limits(data: Mapping[str, object], source: str) -> Limits:
    """Limits that the scenario sets itself."""
    where = f"{source}: limits"
    only(data, ("thrust_max_weights", "tilt_max_rad", "radius_m", "height_m"), where)
    default = Limits()
    return replace(
        default,
        thrust_max_weights=number(
            data.get("thrust_max_weights", default.thrust_max_weights), f"{where}.thrust_max_weights", 1.1, 10.0
        ),
        tilt_max_rad=number(data.get("tilt_max_rad", default.tilt_max_rad), f"{where}.tilt_max_rad", 0.1, 1.3),
        radius_m=number(data.get("radius_m", default.radius_m), f"{where}.radius_m", 1.0, 10 * _FAR_M),
        height_m=number(data.get("height_m", default.height_m), f"{where}.height_m", 1.0, 10 * _FAR_M),
    )


def _envelope(
    limits: Limits, given: Mapping[str, object], trajectory: Trajectory, duration_s: float, region: Region | None,
    source: str,
) -> Limits:  # fmt: skip
    """The guard's envelope: given, or 5 m beyond the path and no less than the region, in which the vehicle may be
    anywhere (sideways where it is one of `axes`: of an ellipsoid down alone is certified); the path itself must stay
    above the ground."""
    points = [trajectory.at(t).pos_ned_m for t in np.linspace(0.0, duration_s, 2001)]
    lowest = float(min(-p[2] for p in points))
    if lowest < _LEAST_HEIGHT_M - 1e-9:
        raise InputError(
            f"{source}: trajectory comes down to {lowest:.2f} m above the start; "
            f"it must stay at least {_LEAST_HEIGHT_M:g} m above"
        )
    radius = max(math.hypot(p[0], p[1]) for p in points) + _ENVELOPE_MARGIN_M
    height = float(max(-p[2] for p in points)) + _ENVELOPE_MARGIN_M
    if region is not None:
        north, east, _ = (abs(c) + a for c, a in zip(region.centre_ned_m, region.semi_axes_m, strict=True))
        height = max(height, region.semi_axes_m[2] - region.centre_ned_m[2] + _REGION_MARGIN_M)
        radius = max(radius, math.hypot(north, east) + _REGION_MARGIN_M if region.kind == "axes" else 0.0)
    return replace(
        limits,
        radius_m=limits.radius_m if "radius_m" in given else radius,
        height_m=limits.height_m if "height_m" in given else height,
    )


def _truth(data: Mapping[str, object], source: str) -> ScenarioTruth:
    where = f"{source}: truth"
    only(data, ("mass_ratio", "constant_force_weights", "effects", "vehicle"), where)
    effects = table(data, "effects", where)
    checked = {name: check_effect(name, values, where) for name, values in effects.items()}
    return ScenarioTruth(
        mass_ratio=number(data.get("mass_ratio", 1.0), f"{where}.mass_ratio", 0.2, 5.0),
        constant_force_weights=vector(
            data.get("constant_force_weights", (0.0, 0.0, 0.0)), f"{where}.constant_force_weights", -1.0, 1.0
        ),
        effects=tuple((name, tuple(values.items())) for name, values in checked.items()),
        changes=flattened(table(data, "vehicle", where)),
    )


def _region(data: Mapping[str, object], source: str) -> Region:
    where = f"{source}: region"
    keys = ("kind", "centre_m", "semi_axes_m", "semi_axes_mps")
    only(data, keys, where)
    kind = data.get("kind")
    if kind not in ("axes", "ellipsoid"):
        raise InputError(f"{where}.kind = {kind!r} is not known; known are axes, ellipsoid")
    return Region(
        kind=str(kind),
        centre_ned_m=vector(data.get("centre_m"), f"{where}.centre_m", -_FAR_M, _FAR_M),
        semi_axes_m=vector(data.get("semi_axes_m"), f"{where}.semi_axes_m", 0.01, _FAR_M),
        semi_axes_mps=vector(data.get("semi_axes_mps"), f"{where}.semi_axes_mps", 0.01, _FAR_M),
    )


def _knowledge(data: Mapping[str, object], source: str) -> InitialKnowledge:
    where = f"{source}: knowledge"
    only(data, ("mass_ratio", "force_weights"), where)
    ratio = data.get("mass_ratio")
    if not isinstance(ratio, Sequence) or isinstance(ratio, str) or len(ratio) != 2:
        raise InputError(f"{where}.mass_ratio = {ratio!r} must be a list of 2 numbers, least and greatest")
    least, greatest = (number(each, f"{where}.mass_ratio", 0.2, 5.0) for each in ratio)
    if least > greatest:
        raise InputError(f"{where}.mass_ratio = {ratio!r} must begin with the least")
    return InitialKnowledge((least, greatest), number(data.get("force_weights"), f"{where}.force_weights", 0.0, 1.0))


def _tables(data: Mapping[str, object], key: str, source: str) -> list[Mapping[str, object]]:
    value = data.get(key, [])
    if not isinstance(value, list) or not all(isinstance(item, Mapping) for item in value):
        raise InputError(f"{source}: {key} must be a list of tables, written [[{key}]]")
    return value


def _event(data: Mapping[str, object], where: str) -> TimedEvent:
    only(data, ("time_s", "effect", "values"), where)
    name = words(data.get("effect"), f"{where}: effect")
    values = check_effect(name, data.get("values"), where)
    return TimedEvent(
        time_s=number(data.get("time_s"), f"{where}: time_s", 0.0, _DURATION_S[1]),
        effect=name,
        values=tuple(values.items()),
    )


def _check(data: Mapping[str, object], where: str) -> Check:
    only(data, ("metric", "below", "above", "words"), where)
    bounds = [
        None if data.get(key) is None else number(data[key], f"{where}: {key}", -1e9, 1e9) for key in ("below", "above")
    ]
    if bounds == [None, None]:
        raise InputError(f"{where}: give below, above or both")
    return Check(
        metric=words(data.get("metric"), f"{where}: metric"),
        below=bounds[0],
        above=bounds[1],
        words=words(data.get("words"), f"{where}: words"),
    )
