"""Barriers written again from their definitions, and authorities to try them with."""

from __future__ import annotations

import numpy as np

from flightstack.barrier.records import Authority
from flightstack.barrier.shapes import Barrier, Quadratic
from flightstack.types import F64

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
