"""What the 3-D view shows, in Foxglove's well-known schemas: vehicle, flown path, reference, ground and safe region.

Everything is given in NED and FRD and leaves in `world` (ENU) and `body` / `body_true` (FLU).  Both changes are linear
in position and quaternion, so the signs of `flightstack.frames` are read off once, as one matrix, from unit vectors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from foxglove import messages as fox

from flightstack.frames import frd_to_flu, ned_to_enu, q_ned_frd_to_enu_flu
from flightstack.types import F64, TickRecord, Tuple3, Tuple4
from flightstack_logs import outlines

WORLD = "world"
BODY = "body"
BODY_TRUE = "body_true"

POSE_PERIOD_US = 40_000
_PATH_POINT_US = 200_000
_PATH_PERIOD_US, _PATH_GROWTH = 1_000_000, 8
"""The path flown so far is written once a second, later each time that it has grown by an eighth."""
_FINENESS = 2.0**20
"""Poses are drawn to a millionth: what is rounded so compresses to half."""
_STAMPED_PERIOD_US = 200_000
"""Of the pose on its own, which /tf has at its full rate."""
_PATH_POINTS = 600

_LEVELS = {
    "debug": fox.LogLevel.Debug,
    "info": fox.LogLevel.Info,
    "warning": fox.LogLevel.Warning,
    "error": fox.LogLevel.Error,
    "fatal": fox.LogLevel.Fatal,
}

_IDENTITY = fox.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
_GREY = fox.Color(r=0.5, g=0.5, b=0.5, a=0.6)
_BLUE = fox.Color(r=0.2, g=0.5, b=1.0, a=1.0)
_ORANGE = fox.Color(r=1.0, g=0.6, b=0.1, a=0.9)
_RED = fox.Color(r=0.9, g=0.2, b=0.2, a=0.9)
_REGION = fox.Color(r=0.2, g=0.9, b=0.4, a=0.15)
_CERTIFIED = fox.Color(r=0.5, g=0.4, b=0.9, a=0.2)
_WANTED = fox.Color(r=1.0, g=0.6, b=0.1, a=0.8)
_SAFE = fox.Color(r=0.2, g=0.8, b=0.3, a=0.9)

ENGAGED = 2.0
"""From this status on the barrier filter says what it does with the wanted acceleration."""
_ARROW_M_PER_MPS2 = 0.1


View = tuple[str, bytes]
"""A topic and the encoded message for it."""


@dataclass(frozen=True, slots=True)
class SceneRegion:
    """The part of space that the flight must keep to: an upright box or an ellipsoid."""

    shape: str
    """box or ellipsoid."""
    center_ned_m: Tuple3
    half_size_m: Tuple3
    """Half the edges, or the semi-axes, along north, east, down."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What doesn't move, and the looks of what does."""

    rotor_position_frd_m: F64
    """(n, 3) from the centre of mass."""
    rotor_radius_m: float
    ground_down_m: float = 0.0
    """Where the ground lies, along down."""
    region: SceneRegion | None = None
    reference_ned_m: F64 | None = None
    """(N, 3) the whole reference path, where it is known beforehand."""
    site_ned_m: tuple[F64, ...] = ()
    """(n, 3) lines of the site that the flight must stay in, and of what it must keep away from."""
    truth: bool = False
    """Whether the true vehicle is shown too (in simulation)."""


@dataclass(frozen=True, slots=True, eq=False)
class StoppingWay:
    """The way out that the site filter has committed itself to."""

    pos_ned_m: F64
    """(n, 3)."""


Shown = Scene | SceneRegion | StoppingWay
"""What the 3-D view is told: all that doesn't move, a new certificate's region of positions, a new stopping way."""


def _pose_matrix() -> F64:
    """(7, 7): (position NED, q_ned_frd) -> (position ENU, q_enu_flu as w, x, y, z)."""
    matrix = np.zeros((7, 7))
    matrix[:3, :3] = ned_to_enu(np.eye(3)).T
    matrix[3:, 3:] = q_ned_frd_to_enu_flu(np.eye(4)).T
    return matrix


_POSE_MATRIX = _pose_matrix()


def timestamp(t_us: int) -> fox.Timestamp:
    """Vehicle time as Foxglove's time stamp."""
    t_us = min(max(t_us, 0), _LATEST_US)  # a vehicle's stamp is what it says, and may be absurd
    return fox.Timestamp(sec=t_us // 1_000_000, nsec=t_us % 1_000_000 * 1000)


_LATEST_US = (2**32 - 1) * 1_000_000
"""Foxglove's seconds have 32 bits."""


def _points(ned_m: F64) -> list[fox.Point3]:
    return [fox.Point3(x=x, y=y, z=z) for x, y, z in ned_to_enu(ned_m).reshape(-1, 3).tolist()]


def log_line(t_us: int, level: str, name: str, text: str) -> bytes:
    """A `foxglove.Log` message; an unknown level counts as unknown."""
    return fox.Log(
        timestamp=timestamp(t_us), level=_LEVELS.get(level, fox.LogLevel.Unknown), name=name, message=text
    ).encode()


def location(t_us: int, latitude_deg: float, longitude_deg: float, altitude_m: float) -> bytes:
    """A `foxglove.LocationFix` message."""
    return fox.LocationFix(
        timestamp=timestamp(t_us), frame_id=BODY, latitude=latitude_deg, longitude=longitude_deg, altitude=altitude_m
    ).encode()


class Posed(Protocol):
    """What has a pose: a measurement, the truth."""

    @property
    def pos_ned_m(self) -> F64 | Tuple3:
        """Position."""

    @property
    def q_ned_frd(self) -> F64 | Tuple4:
        """Attitude (w, x, y, z), body to world."""


class VehicleTrail:
    """Pose, transform and flown path of one vehicle (estimated or true): `poses` says what to log at `t_us`.

    The path has a point every 0.2 s and never more than 600: a full path drops every other point and goes on half as
    fine.  `/scene/path` is the same path drawn as a line, whatever the viewer makes of `foxglove.PosesInFrame`.
    """

    def __init__(self, *, truth: bool) -> None:
        self._prefix = "/truth" if truth else ""
        self._frame = BODY_TRUE if truth else BODY
        self._truth = truth
        self._state = np.empty(7)
        self._points: list[fox.Pose] = []
        self._corners: list[Tuple3] = []
        self._line: list[fox.Point3] = []
        """The corners as they are drawn."""
        self._point_period_us = _PATH_POINT_US
        self._due_us = 0
        self._point_due_us = 0
        self._path_due_us = 0
        self._pose_due_us = 0
        self._from_us = -1

    def is_due(self, t_us: int) -> bool:
        """Whether it is time for the next pose."""
        return not self._due_us - POSE_PERIOD_US <= t_us < self._due_us

    def poses(self, t_us: int, of: Posed) -> list[View]:
        """Messages for the pose at `t_us`."""
        self._due_us = t_us - t_us % POSE_PERIOD_US + POSE_PERIOD_US
        state = self._state
        state[:3] = of.pos_ned_m
        state[3:] = of.q_ned_frd
        x, y, z, qw, qx, qy, qz = (np.rint(_POSE_MATRIX @ state * _FINENESS) / _FINENESS).tolist()
        stamp = timestamp(t_us)
        place = fox.Vector3(x=x, y=y, z=z)
        turn = fox.Quaternion(x=qx, y=qy, z=qz, w=qw)
        move = fox.FrameTransform(
            timestamp=stamp, parent_frame_id=WORLD, child_frame_id=self._frame, translation=place, rotation=turn
        )
        pose = fox.Pose(position=place, orientation=turn)
        views = [(f"{self._prefix}/tf", fox.FrameTransforms(transforms=[move]).encode())]
        if t_us >= self._pose_due_us:
            self._pose_due_us = t_us + _STAMPED_PERIOD_US
            views.append((f"{self._prefix}/pose", fox.PoseInFrame(timestamp=stamp, frame_id=WORLD, pose=pose).encode()))
        if t_us >= self._point_due_us and math.isfinite(x + y + z):
            self._add_point(t_us, pose, (x, y, z))
        if t_us >= self._path_due_us and self._points:
            self._from_us = t_us if self._from_us < 0 else self._from_us
            self._path_due_us = t_us + max(_PATH_PERIOD_US, (t_us - self._from_us) // _PATH_GROWTH)
            path = fox.PosesInFrame(timestamp=stamp, frame_id=WORLD, poses=self._points)
            views.append((f"{self._prefix}/path", path.encode()))
            if not self._truth:
                line = _line(stamp, "path", self._line, _BLUE)
                views.append(("/scene/path", fox.SceneUpdate(entities=[line]).encode()))
                views.append(("/outline/path", outlines.cloud(stamp, WORLD, np.array(self._corners))))
        return views

    def _add_point(self, t_us: int, pose: fox.Pose, corner: Tuple3) -> None:
        self._point_due_us = t_us + self._point_period_us
        self._points.append(pose)
        self._corners.append(corner)
        if not self._truth:
            self._line.append(fox.Point3(x=corner[0], y=corner[1], z=corner[2]))
        if len(self._points) >= _PATH_POINTS:
            del self._points[1::2]
            del self._corners[1::2]
            del self._line[1::2]
            self._point_period_us *= 2


def _disc(center: list[float], radius_m: float, color: fox.Color) -> fox.CylinderPrimitive:
    position = fox.Vector3(x=center[0], y=center[1], z=center[2])
    size = fox.Vector3(x=2.0 * radius_m, y=2.0 * radius_m, z=0.01)
    pose = fox.Pose(position=position, orientation=_IDENTITY)
    return fox.CylinderPrimitive(pose=pose, size=size, bottom_scale=1.0, top_scale=1.0, color=color)


def _vehicle(stamp: fox.Timestamp, scene: Scene, *, truth: bool) -> fox.SceneEntity:
    """Arms and rotor discs, front rotors orange; the estimated vehicle is a pale double of the true one."""
    rotors = frd_to_flu(scene.rotor_position_frd_m).tolist()
    pale = scene.truth and not truth
    color = _GREY if pale else _BLUE
    front = _GREY if pale else _ORANGE
    center = fox.Point3(x=0.0, y=0.0, z=0.0)
    ends = [point for x, y, z in rotors for point in (center, fox.Point3(x=x, y=y, z=z))]
    arms = fox.LinePrimitive(type=fox.LinePrimitiveLineType.LineList, thickness=0.02, points=ends, color=color)
    discs = [_disc(rotor, scene.rotor_radius_m, front if rotor[0] > 0.0 else color) for rotor in rotors]
    frame, name = (BODY_TRUE, "vehicle_true") if truth else (BODY, "vehicle")
    return fox.SceneEntity(timestamp=stamp, frame_id=frame, id=name, frame_locked=True, lines=[arms], cylinders=discs)


def _ground(stamp: fox.Timestamp, down_m: float) -> fox.SceneEntity:
    """A grid of 1 m cells, 20 m by 20 m."""
    half = 10
    ends = [
        end
        for k in range(-half, half + 1)
        for end in ((k, -half, down_m), (k, half, down_m), (-half, k, down_m), (half, k, down_m))
    ]
    grid = fox.LinePrimitive(
        type=fox.LinePrimitiveLineType.LineList,
        thickness=1.0,
        scale_invariant=True,
        points=_points(np.array(ends, dtype=np.float64)),
        color=_GREY,
    )
    return fox.SceneEntity(timestamp=stamp, frame_id=WORLD, id="ground", frame_locked=True, lines=[grid])


def _line(stamp: fox.Timestamp, name: str, points: list[fox.Point3], color: fox.Color) -> fox.SceneEntity:
    line = fox.LinePrimitive(
        type=fox.LinePrimitiveLineType.LineStrip, thickness=2.0, scale_invariant=True, points=points, color=color
    )
    return fox.SceneEntity(timestamp=stamp, frame_id=WORLD, id=name, frame_locked=True, lines=[line])


def _region(
    stamp: fox.Timestamp, region: SceneRegion, name: str = "region", color: fox.Color = _REGION
) -> fox.SceneEntity:
    """A translucent box or ellipsoid."""
    x, y, z = ned_to_enu(np.array(region.center_ned_m)).tolist()
    dx, dy, dz = (2.0 * np.abs(ned_to_enu(np.array(region.half_size_m)))).tolist()
    pose = fox.Pose(position=fox.Vector3(x=x, y=y, z=z), orientation=_IDENTITY)
    size = fox.Vector3(x=dx, y=dy, z=dz)
    boxes = [fox.CubePrimitive(pose=pose, size=size, color=color)] if region.shape == "box" else []
    balls = [fox.SpherePrimitive(pose=pose, size=size, color=color)] if region.shape != "box" else []
    return fox.SceneEntity(timestamp=stamp, frame_id=WORLD, id=name, frame_locked=True, cubes=boxes, spheres=balls)


def views_of(t_us: int, shown: Shown) -> list[View]:
    """The messages for any of them."""
    if isinstance(shown, Scene):
        return _scene_views(t_us, shown)
    if isinstance(shown, SceneRegion):
        return _certified_views(t_us, shown)
    stamp = timestamp(t_us)
    line = _line(stamp, "way", _points(shown.pos_ned_m), _ORANGE)
    outline = ("/outline/way", outlines.cloud(stamp, WORLD, ned_to_enu(shown.pos_ned_m)))
    return [("/scene/way", fox.SceneUpdate(entities=[line]).encode()), outline]


def _certified_views(t_us: int, region: SceneRegion) -> list[View]:
    """The positions that a certificate allows, inside the region that the scenario asks for."""
    stamp = timestamp(t_us)
    entity = _region(stamp, region, "certified", _CERTIFIED)
    outline = ("/outline/certified", outlines.cloud(stamp, WORLD, _edges(region)))
    return [("/scene/region", fox.SceneUpdate(entities=[entity]).encode()), outline]


def _edges(region: SceneRegion) -> F64:
    """(N, 3), ENU, m."""
    return ned_to_enu(outlines.of_region(region.shape, region.center_ned_m, region.half_size_m))


def arrow_views(t_us: int, record: TickRecord) -> list[View]:
    """The acceleration that was wanted and the one that is sent, as arrows at the vehicle, 0.1 m for each m/s^2."""
    stamp, at, filtered = timestamp(t_us), record.measurement.pos_ned_m.tolist(), record.filtered
    entities = [
        fox.SceneEntity(timestamp=stamp, frame_id=WORLD, id=name, frame_locked=True, arrows=[_arrow(at, acc, color)])
        for name, acc, color in (
            ("wanted", filtered.wanted_acc_ned_mps2.tolist(), _WANTED),
            ("safe", filtered.safe_acc_ned_mps2.tolist(), _SAFE),
        )
        if all(map(math.isfinite, (*acc, *at)))
    ]
    return [("/scene/filter", fox.SceneUpdate(entities=entities).encode())] if entities else []


def _arrow(at_ned_m: list[float], acc_ned_mps2: list[float], color: fox.Color) -> fox.ArrowPrimitive:
    (y, x, down), (dy, dx, down_mps2) = at_ned_m, acc_ned_mps2
    z, dz = -down, -down_mps2
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    # Half way between +x and the wanted direction lies the axis of half a turn from one to the other.
    half = (dx + length, dy, dz) if dx > -0.999999 * length else (0.0, 1.0, 0.0)
    norm = math.sqrt(sum(part * part for part in half)) or 1.0
    turn = fox.Quaternion(x=half[0] / norm, y=half[1] / norm, z=half[2] / norm, w=0.0) if length > 0.0 else _IDENTITY
    shown = _ARROW_M_PER_MPS2 * length
    return fox.ArrowPrimitive(
        pose=fox.Pose(position=fox.Vector3(x=x, y=y, z=z), orientation=turn),
        shaft_length=0.8 * shown,
        shaft_diameter=0.015,
        head_length=0.2 * shown,
        head_diameter=0.04,
        color=color,
    )


def _scene_views(t_us: int, scene: Scene) -> list[View]:
    """The messages of a scene: all of it in one, since a viewer that jumps in time asks for the last one only."""
    stamp = timestamp(t_us)
    entities = [_ground(stamp, scene.ground_down_m), _vehicle(stamp, scene, truth=False)]
    views = [
        (
            "/outline/vehicle",
            outlines.cloud(
                stamp,
                BODY_TRUE if scene.truth else BODY,
                outlines.of_vehicle(scene.rotor_position_frd_m, scene.rotor_radius_m),
            ),
        )
    ]
    if scene.truth:
        entities.append(_vehicle(stamp, scene, truth=True))
    if scene.region is not None:
        entities.append(_region(stamp, scene.region))
        views.append(("/outline/region", outlines.cloud(stamp, WORLD, _edges(scene.region))))
    if scene.site_ned_m:
        lines = enumerate(scene.site_ned_m)
        entities += [_line(stamp, f"site {k}", _points(line), _ORANGE) for k, line in lines]
        cloud = np.concatenate([outlines.of_line(line) for line in scene.site_ned_m])
        views.append(("/outline/site", outlines.cloud(stamp, WORLD, ned_to_enu(cloud))))
    if scene.reference_ned_m is not None:
        entities.append(_line(stamp, "reference", _points(scene.reference_ned_m), _RED))
        poses = [
            fox.Pose(position=fox.Vector3(x=x, y=y, z=z), orientation=_IDENTITY)
            for x, y, z in ned_to_enu(scene.reference_ned_m).tolist()
        ]
        views.append(("/outline/reference", outlines.cloud(stamp, WORLD, ned_to_enu(scene.reference_ned_m))))
        views.append(("/reference/path", fox.PosesInFrame(timestamp=stamp, frame_id=WORLD, poses=poses).encode()))
    views.append(("/scene", fox.SceneUpdate(entities=entities).encode()))
    return views
