"""Barriers written again from their definitions, and authorities to try them with."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

import numpy as np

from flightstack.barrier.initial import DOWN
from flightstack.barrier.query_inputs import along
from flightstack.barrier.records import Authority
from flightstack.barrier.shapes import Barrier, Quadratic
from flightstack.types import F64

_T = TypeVar("_T")
PAPER = (-2.80286, 9.81)
"""Range of the true vertical acceleration: 1.8 / 1.4 - 1 g upwards, g downwards."""


def h(shape: Barrier, e: F64, v: F64) -> F64:
    """The definitions, for arrays."""
    if isinstance(shape, Quadratic):
        x, y = e - shape.centre_m, v - shape.centre_mps
        return np.asarray(1.0 - shape.p11 * x * x - 2.0 * shape.p12 * x * y - shape.p22 * y * y)

    def way(speed: F64, brake: float) -> F64:
        speed = np.maximum(speed, -brake * shape.reaction_s)
        return np.asarray(shape.reaction_s * speed + speed * speed / (2.0 * brake))

    high = shape.high_m - e - way(v, shape.brake_high_mps2)
    low = e - shape.low_m - way(-v, shape.brake_low_mps2)
    return np.asarray(np.minimum(high, low) / (0.5 * (shape.high_m - shape.low_m)))


def constant(u_low: float, u_high: float, error: float = 0.0, v_mps: F64 | None = None) -> Authority:
    """The same at every speed."""
    v = np.array([-6.0, 6.0]) if v_mps is None else v_mps
    one = np.ones(len(v))
    return Authority(v, 9.81 * one, one, u_low * one, u_high * one, error * one, error * one)


def changing(nodes: int = 13) -> Authority:
    """Less thrust and more doubt the faster it goes."""
    v = np.linspace(-4.0, 3.0, nodes)
    return Authority(v, 9.81 + 0 * v, 1 + 0 * v, -2.9 + 0.05 * v, 9.7 - 0.1 * v * v, 0.05 + 0.02 * v * v, 0.1 + 0 * v)


def cross_term(mu: float, c: float) -> Quadratic:
    """|e| <= 0.6 whatever the cross term."""
    return Quadratic(0.0, 0.0, 1.0 / 0.36 + c * c / mu, c, mu)


def in_kernel(
    p_m: float, v_mps: float, limit_low_m: float, limit_high_m: float, u_low_mps2: float, u_high_mps2: float
) -> bool:
    """Whether a state lies in the viability kernel of a double integrator on a strip (`viability.area`)."""
    if not limit_low_m <= p_m <= limit_high_m:
        return False
    if v_mps >= 0.0:
        return v_mps * v_mps <= -2.0 * u_low_mps2 * (limit_high_m - p_m)
    return v_mps * v_mps <= 2.0 * u_high_mps2 * (p_m - limit_low_m)


def inputs(speed: F64, thrust: F64, near: F64) -> F64:
    """(M, D) the sampler's columns."""
    return along(DOWN, speed, thrust, near, np.zeros(3))[0]


def turns(axis_n: F64, axis_e: F64) -> F64:
    """(M, 3, 3) tilt axes to NED of each thrust axis: `tilt.tilt_axes` for many."""
    down = np.sqrt(np.maximum(1.0 - axis_n**2 - axis_e**2, 0.0))
    share = 1.0 / (1.0 + down)
    cross = -share * axis_n * axis_e
    rows = [
        [1.0 - share * axis_n**2, cross, axis_n],
        [cross, 1.0 - share * axis_e**2, axis_e],
        [-axis_n, -axis_e, down],
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))


def whole(steps: Generator[None, None, _T]) -> _T:
    """What comes of a piece-wise search, without a pause."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: _T = end.value
            return result
