"""Where a certificate's bounds are asked for: the box of thrust vectors, and the queries in it.

`knowledge` states the rule.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flightstack.barrier.initial import DOWN
from flightstack.barrier.query_inputs import proximity
from flightstack.barrier.records import Budget
from flightstack.types import F64, I64

_SIGNS = np.array([[a, b, c, d] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1) for d in (-1, 1)], np.float64)
_BY_THRUST = np.concatenate([[0], 1 + np.lexsort(_SIGNS[:, [1, 3, 2, 0]].T)])
"""A lateral axis' queries in an order in which the sign of the thrust changes most often."""


class Envelope(NamedTuple):
    """What the bounds are asked for: the certified region's reach, relative to the start."""

    speeds_mps: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    """Least and greatest speed along north, east, down."""
    heights_m: tuple[float, float]
    """Least and greatest height above the place of take-off."""
    nodes: int = 12
    """Speeds along each axis at which the bound is worked out."""
    slice_only: bool = False
    """Only the slice without speed and thrust across each axis."""
    axes: tuple[int, ...] = (0, 1, 2)
    """Axes asked for; down (2) among them: its gain serves the others."""


GROUND_STRENGTH = 2.0
"""Of the ground effect, at most: twice what Cheeseman and Bennett give."""


def ground_mps2(envelope: Envelope, rotor_radius_m: float, thrust_mps2: F64) -> F64:
    """The most that the ground adds to thrust vectors (..., 3), m/s^2 along them, at the least height."""
    near = proximity(rotor_radius_m, envelope.heights_m[0])
    size: F64 = np.sqrt(np.einsum("...i,...i->...", thrust_mps2, thrust_mps2))
    return GROUND_STRENGTH * near * size


def ground_rest_mps2(envelope: Envelope, rotor_radius_m: float, thrust_mps2: F64) -> F64:
    """The most of the same that is not linear in near: a learner that knows `near` leaves so much out."""
    near = proximity(rotor_radius_m, envelope.heights_m[0])
    rest: F64 = ground_mps2(envelope, rotor_radius_m, thrust_mps2) * near / (1.0 - near)
    return rest


def lifted(box: Budget, axis: int) -> tuple[float, float]:
    """How much of what is added to thrust acts against an axis and along it."""
    if axis == DOWN:
        return 1.0, 0.0
    least, most = box.leans[axis]
    return max(most, 0.0), max(-least, 0.0)


def furthest(box: Budget, axis: int) -> float:
    """Greatest lean along a lateral axis."""
    least, most = box.leans[axis]
    return max(-least, most)


class Steering(NamedTuple):
    """What lateral queries need of the vertical axis."""

    v_mps: F64
    """(n,) its nodes."""
    gain: F64
    """(n,) its gain there."""
    hover_mps2: float
    """Specific thrust of hover."""


class Queries(NamedTuple):
    """The inputs at which one axis is asked, q of them at each end of each node."""

    v_mps: F64
    """(n,) nodes."""
    speed_mps: F64
    """(n, 2, q, 3) NED."""
    thrust_mps2: F64
    """(n, 2, q, 3) thrust vectors f."""
    near: F64
    """(q,)."""
    explained_mps2: F64
    """(n, 2, q) what thrust does by the vertical gain, which a lateral offset leaves out."""
    wanted_mps2: tuple[float, float]
    """W of a lateral axis."""
    order: I64
    """(n 2 q,) of all in a row: those that differ in thrust alone stand side by side, which is quicker to answer."""


def statements(envelope: Envelope, ground: bool = False) -> int:
    """Bounds that the union counts: one for each query and one for each gap between nodes, at both ends.

    `ground`: the vertical queries are asked at the least height as well.
    """
    queries = 1 if envelope.slice_only else 1 + len(_SIGNS)
    each = 2 * (queries * envelope.nodes + envelope.nodes - 1)
    return len({DOWN, *envelope.axes}) * each + (2 * queries * envelope.nodes if ground else 0)


def queries(envelope: Envelope, box: Budget, rotor_radius_m: float, axis: int, steering: Steering | None) -> Queries:
    """One axis' queries; `steering` None for the vertical one."""
    ranges = np.array(envelope.speeds_mps)
    nodes = np.linspace(ranges[axis, 0], ranges[axis, 1], envelope.nodes)
    signs = np.zeros((0, 4)) if envelope.slice_only else _SIGNS
    count = 1 + len(signs)
    near = np.full(count, proximity(rotor_radius_m, envelope.heights_m[1]))
    others = [i for i in range(3) if i != axis]
    calm = np.clip(0.0, ranges[:, 0], ranges[:, 1])
    speed = np.empty((envelope.nodes, 2, count, 3))
    for column, i in zip((2, 3), others, strict=True):
        speed[..., :1, i] = calm[i]
        speed[..., 1:, i] = ranges[i][(signs[:, column] > 0.0).astype(int)]
    speed[..., axis] = nodes[:, None, None]
    axes = np.zeros((envelope.nodes, 2, count, 3))
    ends = np.full((envelope.nodes, 2, count), box.high_mps2)
    for i, (least, most) in enumerate(box.leans):
        axes[..., i] = min(max(0.0, least), most)
        if i != axis:
            axes[..., 1:, i] = np.where(signs[:, i if steering is None else 0] > 0.0, most, least)
    if steering is None:
        ends[:, 1] = box.low_mps2
    else:
        axes[:, 1, :, axis], axes[:, 0, :, axis] = (each for each in box.leans[axis])
        ends[..., :1] = steering.hover_mps2
        ends[..., 1:] = np.where(signs[:, 1] > 0.0, box.high_mps2, box.low_mps2)
    axes[..., DOWN] = np.sqrt(1.0 - axes[..., 0] ** 2 - axes[..., 1] ** 2)
    thrust = axes * (ends / axes[..., DOWN])[..., None]
    order = np.arange(ends.size).reshape(ends.shape)
    if steering is None:
        return Queries(nodes, speed, thrust, near, np.zeros(ends.shape), (0.0, 0.0), order.swapaxes(1, 2).ravel())
    explained = np.interp(speed[..., DOWN], steering.v_mps, steering.gain) * thrust[..., axis]
    lead, (least, most) = max(steering.hover_mps2, 0.5 * (box.low_mps2 + box.high_mps2)), box.kept[axis]
    gains = lead * float(steering.gain.min()), lead * float(steering.gain.max())
    wanted = -min(gain * most for gain in gains), -max(gain * least for gain in gains)
    return Queries(nodes, speed, thrust, near, explained, wanted, order[..., _BY_THRUST[:count]].ravel())
