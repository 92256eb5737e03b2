"""Where a certificate's bounds are asked for: the box of thrust vectors, and the queries in it.

`knowledge` states the rule.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.barrier.initial import DOWN
from flightstack.barrier.posterior import proximity
from flightstack.barrier.records import Budget
from flightstack.model import Limits, Model
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

_SIGNS = np.array([[a, b, c, d] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1) for d in (-1, 1)], np.float64)
_EIGHT_SIDES = math.cos(math.pi / 8.0)
"""An eight-sided pyramid in a cone is this much narrower where it is narrowest."""


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
    wanted_mps2: float
    """W of a lateral axis."""


def budget(
    model: Model, limits: Limits, *, lateral_mps2: float = 0.0, low_mps2: float = 0.0, high_mps2: float = math.inf,
    hover_mps2: float | None = None,
) -> Budget:  # fmt: skip
    """Thrust of any length from `low` to the greatest, leaning as far as the lateral specific thrust asks for at F0.

    F0 = max(hover, (low + high) / 2) is the thrust that the filter steers with (`response`).  |b_n|, |b_e| <= beta =
    lateral / F0 is a square within the eight-sided pyramid in the tilt cone, sin(tilt) cos(pi/8) = sqrt(2) beta, and
    whatever the lean in the cone, thrust reaches down to `low` and up to high = greatest cos(tilt) along down; the
    greatest is the vehicle's, or what reaches up to `high_mps2`.  All is specific thrust as commanded, so it fits
    whatever the gain is.  Tilt is cut at the limit, lateral with it.
    """
    least, greatest = (n / model.mass_kg for n in model.thrust_range_n(limits))
    hover = max(hover_mps2 or STANDARD_GRAVITY_MPS2, least)  # a vehicle out of hand may teach that it needs none
    low = min(max(low_mps2, least), greatest)
    most = math.sin(limits.tilt_max_rad)
    lean, lead = 0.0, max(hover, 0.5 * (low + greatest))
    for _ in range(20):  # high and with it F0 fall a little with the lean: a contraction
        lean = min(math.sqrt(2.0) * lateral_mps2 / (lead * _EIGHT_SIDES), most)
        lead = max(hover, 0.5 * (low + min(greatest * math.sqrt(1.0 - lean * lean), high_mps2)))
    high = max(min(greatest * math.sqrt(1.0 - lean * lean), high_mps2), low)
    return Budget(lead * _square(lean), low, high, high / math.sqrt(1.0 - lean * lean), math.asin(lean))


def lean(box: Budget) -> float:
    """beta: how far the thrust axis may lean to north and to east at once, as a part of its length."""
    return _square(math.sin(box.tilt_max_rad))


def _square(lean: float) -> float:
    return lean * _EIGHT_SIDES / math.sqrt(2.0)


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
    beta = lean(box)
    axes = np.zeros((envelope.nodes, 2, count, 3))
    ends = np.full((envelope.nodes, 2, count), box.high_mps2)
    if steering is None:
        axes[..., 1:, :2] = beta * signs[:, :2]
        ends[:, 1] = box.low_mps2
    else:
        axes[:, 0, :, axis], axes[:, 1, :, axis] = beta, -beta
        axes[..., 1:, others[0]] = beta * signs[:, 0]
        ends[..., :1] = steering.hover_mps2
        ends[..., 1:] = np.where(signs[:, 1] > 0.0, box.high_mps2, box.low_mps2)
    axes[..., DOWN] = np.sqrt(1.0 - axes[..., 0] ** 2 - axes[..., 1] ** 2)
    thrust = axes * (ends / axes[..., DOWN])[..., None]
    if steering is None:
        return Queries(nodes, speed, thrust, near, np.zeros(ends.shape), 0.0)
    explained = np.interp(speed[..., DOWN], steering.v_mps, steering.gain) * thrust[..., axis]
    lead = max(steering.hover_mps2, 0.5 * (box.low_mps2 + box.high_mps2))
    return Queries(nodes, speed, thrust, near, explained, float(steering.gain.min()) * beta * lead)
