"""Outlines as points, for viewers that draw no SceneUpdate: arrays in, `foxglove.PointCloud` out."""

from __future__ import annotations

import math

import numpy as np
from foxglove import messages as fox

from flightstack.frames import frd_to_flu
from flightstack.types import F64, Tuple3

_IDENTITY = fox.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
_XYZ = [
    fox.PackedElementField(name=name, offset=4 * k, type=fox.PackedElementFieldNumericType.Float32)
    for k, name in enumerate("xyz")
]
_EDGE_POINTS, _CIRCLE_POINTS, _DISC_POINTS = 41, 128, 16


def of_region(shape: str, center_ned_m: Tuple3, half_size_m: Tuple3) -> F64:
    """(N, 3), NED, m: a region's boundary as points: a box's edges, an ellipsoid's three great circles."""
    turns = np.linspace(0.0, 2.0 * math.pi, _CIRCLE_POINTS, endpoint=False)
    circle = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(_CIRCLE_POINTS)])
    along = np.linspace(-1.0, 1.0, _EDGE_POINTS)
    ends = [np.full(_EDGE_POINTS, end) for end in (-1.0, 1.0)]
    lines = [np.column_stack([along, a, b]) for a in ends for b in ends] if shape == "box" else [circle]
    unit = np.concatenate([np.roll(line, shift, axis=1) for shift in range(3) for line in lines])
    outline: F64 = np.array(center_ned_m) + unit * np.array(half_size_m)
    return outline


def of_line(line: F64) -> F64:
    """(N, 3): points on every leg of a line (n, 3)."""
    share = np.linspace(0.0, 1.0, _EDGE_POINTS)[:, None, None]
    spread: F64 = np.reshape((1.0 - share) * line[:-1] + share * line[1:], (-1, 3))
    return spread


def cloud(stamp: fox.Timestamp, frame: str, points: F64) -> bytes:
    """`points` (N, 3), in the axes of `frame` (ENU or FLU), for viewers that draw no SceneUpdate."""
    data = points.astype("<f4")
    message = fox.PointCloud(
        timestamp=stamp,
        frame_id=frame,
        pose=fox.Pose(position=fox.Vector3(x=0.0, y=0.0, z=0.0), orientation=_IDENTITY),
        point_stride=data.itemsize * data.shape[1],
        fields=_XYZ,
        data=data.tobytes(),
    )
    return message.encode()


def of_vehicle(rotor_position_frd_m: F64, rotor_radius_m: float) -> F64:
    """(N, 3), FLU, m: the rotors' discs and the arms to them."""
    turns = np.linspace(0.0, 2.0 * math.pi, _DISC_POINTS, endpoint=False)
    disc = rotor_radius_m * np.column_stack([np.cos(turns), np.sin(turns), np.zeros(_DISC_POINTS)])
    arm = np.linspace(0.0, 1.0, _DISC_POINTS)[:, None]
    rotors = frd_to_flu(rotor_position_frd_m)
    return np.concatenate([part for rotor in rotors for part in (rotor + disc, arm * rotor)])
