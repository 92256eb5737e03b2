"""Interval arithmetic on arrays: each operation rounds outward, so what holds of them holds of the numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Mask = NDArray[np.bool_]


class Interval:
    """Arrays of intervals [lo, hi]; each operation rounds outward."""

    __slots__ = ("hi", "lo")
    __array_ufunc__ = None

    def __init__(self, lo: Any, hi: Any = None) -> None:
        self.lo, self.hi = np.asarray(lo, np.float64), np.asarray(lo if hi is None else hi, np.float64)

    def __add__(self, other: Any) -> Interval:
        o = _interval(other)
        return _outward(self.lo + o.lo, self.hi + o.hi)

    def __neg__(self) -> Interval:
        return Interval(-self.hi, -self.lo)

    def __sub__(self, other: Any) -> Interval:
        return self + -_interval(other)

    def __rsub__(self, other: Any) -> Interval:
        return _interval(other) + -self

    def __mul__(self, other: Any) -> Interval:
        o = _interval(other)
        products = np.stack(np.broadcast_arrays(self.lo * o.lo, self.lo * o.hi, self.hi * o.lo, self.hi * o.hi))
        return _outward(products.min(axis=0), products.max(axis=0))

    def __truediv__(self, other: Any) -> Interval:
        """By what is positive."""
        o = _interval(other)
        return self * _outward(1.0 / o.hi, 1.0 / o.lo)

    def __abs__(self) -> Interval:
        ends = np.abs(self.lo), np.abs(self.hi)
        inside = (self.lo <= 0.0) & (self.hi >= 0.0)
        return Interval(np.where(inside, 0.0, np.minimum(*ends)), np.maximum(*ends))

    def at_least(self, least: Any) -> Interval:
        """The greater of it and `least`."""
        o = _interval(least)
        return Interval(np.maximum(self.lo, o.lo), np.maximum(self.hi, o.hi))

    __radd__, __rmul__ = __add__, __mul__


def _interval(value: Any) -> Interval:
    return value if isinstance(value, Interval) else Interval(value)


def _outward(lo: F64, hi: F64) -> Interval:
    return Interval(np.nextafter(lo, -np.inf), np.nextafter(hi, np.inf))
