"""A trajectory of moves from rest to rest: short ones are doublets of thrust or of body rate, long ones go places.

Each move is the minimum-snap segment 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7 (D. Mellinger, V. Kumar, "Minimum snap
trajectory generation and control for quadrotors", 2011): over the distance d in the time T its speed peaks at 2.19 d/T,
its acceleration, one period of about a sine, at 7.5 d/T^2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from flightstack.checked import number
from flightstack.trajectory import Polynomial
from flightstack.types import InputError, Tuple3

_KEYS = ("move_s", "rest_s", "north_m", "east_m", "down_m", "yaw_rad")
_REST_TO_REST = np.array([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
_MOST = 200
_FAR_M = 1000.0


def moves(value: object, start_m: Tuple3, yaw_rad: float, where: str) -> Polynomial:
    """The path of a list of [move_s, rest_s, north_m, east_m, down_m, yaw_rad], distances from where each begins.

    InputError names the move.
    """
    if not isinstance(value, Sequence) or isinstance(value, str) or not 1 <= len(value) <= _MOST:
        raise InputError(f"{where} must be a list of 1 to {_MOST} moves, each {', '.join(_KEYS)}")
    at = np.array([*start_m, yaw_rad])
    spans, rows = [], []
    for count, item in enumerate(value, start=1):
        if not isinstance(item, Sequence) or isinstance(item, str) or len(item) != len(_KEYS):
            raise InputError(f"{where}: move {count} = {item!r} must be {len(_KEYS)} numbers: {', '.join(_KEYS)}")
        ranges = ((0.1, 60.0), (0.0, 60.0), *[(-_FAR_M, _FAR_M)] * 3, (-2.0 * math.pi, 2.0 * math.pi))
        move_s, rest_s, *by = (
            number(part, f"{where}: move {count}: {key}", *limits)
            for part, key, limits in zip(item, _KEYS, ranges, strict=True)
        )
        row = np.outer(by, _REST_TO_REST)
        row[:, 0] = at
        at = at + np.array(by)
        spans.append(move_s)
        rows.append(row)
        if rest_s > 0.0:
            still = np.zeros((4, len(_REST_TO_REST)))
            still[:, 0] = at
            spans.append(rest_s)
            rows.append(still)
    return Polynomial(np.concatenate([[0.0], np.cumsum(spans)]), np.array(rows))
