"""Trajectories as flat outputs with exact derivatives up to snap, and the paper's pole-placement nominal.

`Sinusoid` (also hover and figure-8) and `Polynomial` (minimum snap through waypoints) are `Trajectory`: `at(t_s)` gives
position, velocity, acceleration, jerk, snap, yaw and yaw rate at `t_s` seconds since the trajectory's own start.

Minimum snap: on every segment a polynomial of degree 7 (what the Euler-Lagrange equation of int |snap|^2 leaves), given
positions at the knots, given velocity, acceleration and jerk at both ends, derivatives 1..6 continuous at inner knots
(the first three because the path must be smooth, the others because the cost is stationary): 8 linear equations
per segment (D. Mellinger, V. Kumar, "Minimum snap trajectory generation and control for quadrotors", 2011).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flightstack.jit import Entry, njit
from flightstack.rows import YAW, YAW_RATE
from flightstack.types import F64, FlatOutput, Tuple3

_ORDER = 8
_DERIVATIVES = 5
_FLAT = 17
"""Numbers of a FlatOutput."""


class Trajectory(Protocol):
    """A reference over time, in whatever coordinates its maker chose."""

    @property
    def duration_s(self) -> float:
        """Length; infinite where the trajectory goes on for ever."""
        ...

    def at(self, t_s: float) -> FlatOutput:
        """Flat outputs at `t_s` seconds since the start; finite for every finite time."""
        ...

    def moved(self, offset_ned_m: F64) -> Trajectory:
        """The same with every position moved by `offset_ned_m` (3,)."""
        ...

    def slowed(self, share: float) -> Trajectory:
        """The same path, flown at `share` of its speed."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Sinusoid:
    """centre + amplitude * sin(rate * t + phase) on each axis, constant yaw."""

    table: F64
    """(4, 3): centre m, amplitude m, rate rad/s, phase rad; NED."""
    yaw_rad: float = 0.0

    @property
    def duration_s(self) -> float:
        """It goes on for ever."""
        return math.inf

    def at(self, t_s: float) -> FlatOutput:
        """Flat outputs at `t_s`."""
        row = np.empty(_FLAT)
        _SINUSOID.call(t_s, self.table, self.yaw_rad, row)
        return FlatOutput(row)

    def moved(self, offset_ned_m: F64) -> Sinusoid:
        """The same with every position moved by `offset_ned_m` (3,)."""
        table = self.table.copy()
        table[_CENTRE] += offset_ned_m
        return Sinusoid(table, self.yaw_rad)

    def slowed(self, share: float) -> Sinusoid:
        """The same path, flown at `share` of its speed."""
        table = self.table.copy()
        table[_RADPS] *= share
        return Sinusoid(table, self.yaw_rad)


def sinusoid(
    centre_ned_m: Tuple3,
    amplitude_ned_m: Tuple3,
    rate_radps: Tuple3,
    phase_rad: Tuple3 = (0.0, 0.0, 0.0),
    *,
    yaw_rad: float = 0.0,
) -> Sinusoid:
    """A sinusoid per axis; the paper's tracking path is (0, 0, -1.5), (1.5, 1, 0.5), (0.6, 0.9, 0.6)."""
    table = np.array([centre_ned_m, amplitude_ned_m, rate_radps, phase_rad], dtype=np.float64)
    table.setflags(write=False)
    return Sinusoid(table, yaw_rad)


def hover(pos_ned_m: Tuple3, *, yaw_rad: float = 0.0) -> Sinusoid:
    """Standing still at a point."""
    still = (0.0, 0.0, 0.0)
    return sinusoid(pos_ned_m, still, still, yaw_rad=yaw_rad)


def figure8(*, length_m: float, width_m: float, period_s: float, height_m: float, yaw_rad: float = 0.0) -> Sinusoid:
    """x = length sin wt, y = width sin 2wt, `height_m` above the start; one lap in `period_s`."""
    w = 2.0 * math.pi / period_s
    return sinusoid((0.0, 0.0, -height_m), (length_m, width_m, 0.0), (w, 2.0 * w, 0.0), yaw_rad=yaw_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Polynomial:
    """Piecewise polynomials of degree 7 for north, east, down and yaw; stands still before and after."""

    knots_s: F64
    """(n + 1,) increasing, first 0."""
    coefficients: F64
    """(n, 4, 8): segment, axis (north, east, down, yaw), ascending powers of the share s = 0..1 of the segment."""

    @property
    def duration_s(self) -> float:
        """The last knot."""
        return float(self.knots_s[-1])

    def at(self, t_s: float) -> FlatOutput:
        """Flat outputs at `t_s`."""
        row = np.empty(_FLAT)
        _POLYNOMIAL.call(t_s, self.knots_s, self.coefficients, row)
        return FlatOutput(row)

    def moved(self, offset_ned_m: F64) -> Polynomial:
        """The same with every position moved by `offset_ned_m` (3,)."""
        coefficients = self.coefficients.copy()
        coefficients[:, :3, 0] += offset_ned_m
        return Polynomial(self.knots_s, coefficients)

    def slowed(self, share: float) -> Polynomial:
        """The same path, flown at `share` of its speed."""
        return Polynomial(self.knots_s / share, self.coefficients)


@dataclass(frozen=True, slots=True, eq=False)
class Boundary:
    """State at an end of a polynomial path, (4,) each: north, east, down, yaw."""

    velocity: F64
    acceleration: F64
    jerk: F64

    @classmethod
    def at_rest(cls) -> Boundary:
        """Standing still."""
        return cls(np.zeros(4), np.zeros(4), np.zeros(4))

    @classmethod
    def of(cls, point: FlatOutput) -> Boundary:
        """The state of a flat output (yaw acceleration and jerk zero)."""
        return cls(
            np.append(point.vel_ned_mps, point.yaw_rate_radps),
            np.append(point.acc_ned_mps2, 0.0),
            np.append(point.jerk_ned_mps3, 0.0),
        )


def minimum_snap(
    points: F64, times_s: F64, *, start: Boundary | None = None, end: Boundary | None = None
) -> Polynomial:
    """Minimum-snap path through `points` (n + 1, 4: NED m and yaw rad) at `times_s` (n + 1,), at rest at open ends."""
    points = np.asarray(points, dtype=np.float64)
    times = np.asarray(times_s, dtype=np.float64)
    count = len(times) - 1
    if points.shape != (count + 1, 4) or count < 1 or not np.all(np.diff(times) > 0.0):
        raise ValueError(f"points {points.shape} must be (n + 1, 4) for n + 1 = {count + 1} increasing times")
    spans = np.diff(times)
    matrix = np.zeros((_ORDER * count, _ORDER * count))
    right = np.zeros((_ORDER * count, 4))
    row = 0
    for segment, share, boundary in ((0, 0.0, start), (count - 1, 1.0, end)):
        given = boundary or Boundary.at_rest()
        for order, value in enumerate((given.velocity, given.acceleration, given.jerk), start=1):
            matrix[row, _ORDER * segment : _ORDER * (segment + 1)] = _basis(share, order)
            right[row] = value * spans[segment] ** order
            row += 1
    for segment in range(count):
        for share in (0.0, 1.0):
            matrix[row, _ORDER * segment : _ORDER * (segment + 1)] = _basis(share, 0)
            right[row] = points[segment + round(share)]
            row += 1
    for segment in range(count - 1):
        ratio = spans[segment] / spans[segment + 1]
        for order in range(1, 7):
            matrix[row, _ORDER * segment : _ORDER * (segment + 1)] = _basis(1.0, order)
            matrix[row, _ORDER * (segment + 1) : _ORDER * (segment + 2)] = -_basis(0.0, order) * ratio**order
            row += 1
    solution = np.linalg.solve(matrix, right).reshape(count, _ORDER, 4)
    return Polynomial(times - times[0], np.ascontiguousarray(solution.transpose(0, 2, 1)))


def _basis(share: float, order: int) -> F64:
    """(8,) derivative of the powers of s at `share`, not yet divided by the span to the order."""
    return np.array([math.perm(n, order) * share ** (n - order) if n >= order else 0.0 for n in range(_ORDER)])


_CENTRE, _AMPLITUDE, _RADPS, _PHASE = range(4)
"""Of a Sinusoid's table."""


@njit
def _sinusoid(t: float, table: F64, yaw: float, row: F64) -> None:
    """`table` (4, 3) as in Sinusoid; `row` (17,) as in FlatOutput."""
    for i in range(3):
        w = table[_RADPS, i]
        angle = w * t + table[_PHASE, i]
        s, c = table[_AMPLITUDE, i] * math.sin(angle), table[_AMPLITUDE, i] * math.cos(angle)
        row[i] = table[_CENTRE, i] + s
        row[3 + i] = w * c
        row[6 + i] = -w * w * s
        row[9 + i] = -w * w * w * c
        row[12 + i] = w * w * w * w * s
    row[YAW] = yaw
    row[YAW_RATE] = 0.0


@njit
def _polynomial(t: float, knots: F64, coefficients: F64, row: F64) -> None:
    """Knots and coefficients as in Polynomial; `row` (17,) as in FlatOutput."""
    count = len(knots) - 1
    within = min(max(t, knots[0]), knots[count])
    segment = min(max(np.searchsorted(knots, within, side="right") - 1, 0), count - 1)
    span = knots[segment + 1] - knots[segment]
    share = (within - knots[segment]) / span
    moving = within == t
    for axis in range(4):
        scale = 1.0
        for order in range(_DERIVATIVES):
            value = 0.0
            if order == 0 or moving:
                for power in range(_ORDER - 1, order - 1, -1):
                    factor = 1.0
                    for k in range(order):
                        factor *= power - k
                    value = value * share + factor * coefficients[segment, axis, power]
            if axis < 3:
                row[3 * order + axis] = value * scale
            elif order < 2:
                row[15 + order] = value * scale
            scale /= span


_SINUSOID = Entry(_sinusoid, "f8, f8[:, ::1], f8, f8[::1]")
_POLYNOMIAL = Entry(_polynomial, "f8, f8[::1], f8[:, :, ::1], f8[::1]")


@dataclass(frozen=True, slots=True)
class NominalGains:
    """The nominal's gains: one triple pole per axis (north, east, down), and how far its acceleration may go."""

    pole_radps: Tuple3 = (4.8, 4.8, 4.8)
    """K = (p^3, 3 p^2, 3 p).  The inner loops (rate lag 45-80 ms, sampling and link 10 ms) leave about 45 degrees of
    phase at 4.8 rad/s; a stronger pole buys stiffness p^2/3 with margin that slow rotors do not have."""
    correction_max_mps2: Tuple3 = (5.0, 5.0, 6.0)
    """Clamp of the acceleration that tracking errors may add to the reference's (27 degrees of tilt)."""


@njit
def nominal_step(
    correction: F64, pole: F64, correction_max: F64, reference: tuple[F64, F64, F64, F64], present: tuple[F64, F64],
    dt: float, acc_out: F64, jerk_out: F64,
) -> None:  # fmt: skip
    """One step of the paper's pole-placement nominal, Section V.A, per axis:

        jerk_d = jerk_ref - K [r - r_ref, v - v_ref, a - a_ref]

    r, v are the vehicle's (estimated), a is the nominal's own: the integral of jerk_d.  Written for c = a - a_ref,
    c' = -K1 (r - r_ref) - K2 (v - v_ref) - K3 c, whose step is exact for errors held over `dt`.  `correction` (3,) is
    c, changed in place; `acc_out`, `jerk_out` (3,) receive a_d and jerk_d.  `reference`: position to jerk;
    `present`: position and velocity.
    """
    (place, speed, _, jerk), (pos, vel) = reference, present
    for i in range(3):
        p = pole[i]
        drive = -p * p * p * (pos[i] - place[i]) - 3.0 * p * p * (vel[i] - speed[i])
        keep = math.exp(-3.0 * p * dt)
        c = keep * correction[i] + (1.0 - keep) * drive / (3.0 * p)
        limit = correction_max[i]
        rate = drive - 3.0 * p * c
        if c >= limit or c <= -limit:
            c = min(max(c, -limit), limit)
            rate = 0.0
        correction[i] = c
        acc_out[i] = reference[2][i] + c
        jerk_out[i] = jerk[i] + rate
