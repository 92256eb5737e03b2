"""Barrier functions of one axis: h(e, v) >= 0 is the safe side, e the distance from the centre (m), v its rate (m/s).

Every barrier is the least of one or more concave, continuously differentiable *pieces*, so its region is convex, and
each piece's curvature is bounded by a constant matrix.  Both facts are used: a state that follows a safe one through
lags stays in a convex region (`response`), and the end of a hold is bounded in closed form (`condition`).

    Quadratic   h = 1 - (z - c)^T P (z - c), z = (e, v): with a cross term and a free centre.  The published
                h_mu = 1 - e^2 / a^2 - mu v^2 is the case c = 0, p12 = 0.
    Stopping    h = (limit - e - s(v)) / scale towards either limit, s(v) = t v + v^2 / (2 a): the way that a reaction
                time t and a braking a take.  Below v = -a t the way is constant, so that h stays smooth.

Source: L. Wang, E. Theodorou, M. Egerstedt, "Safe Learning of Quadrotor Dynamics Using Barrier Certificates", 2018,
equation (8) for h_mu; the stopping distance is kinematics.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flightstack.jit import njit, njit_called
from flightstack.types import F64, InputError

ROW = 9
"""Numbers of a piece's row: kind, five parameters, and the bound of its curvature (ee, ev, vv), -H <= K."""
KIND, K_EE, K_EV, K_VV = 0, 6, 7, 8
CENTRE_E, CENTRE_V, P11, P12, P22 = 1, 2, 3, 4, 5
"""Of a quadratic's."""
SIGN, LIMIT, REACTION, BRAKE, SCALE = 1, 2, 3, 4, 5
"""Of a stopping piece's."""
_QUADRATIC, STOPPING = 0.0, 1.0


@dataclass(frozen=True, slots=True)
class Quadratic:
    """An ellipse in (e, v)."""

    centre_m: float
    centre_mps: float
    p11: float
    """1 / m^2."""
    p12: float
    """s / m^2."""
    p22: float
    """s^2 / m^2: the paper's mu."""

    def __post_init__(self) -> None:
        if not (self.p11 > 0.0 and self.p11 * self.p22 > self.p12 * self.p12):
            raise InputError(f"quadratic barrier: P = [{self.p11:g} {self.p12:g}; . {self.p22:g}] is no ellipse")

    @property
    def rows(self) -> F64:
        """(1, ROW) the piece for compiled code."""
        k = (2.0 * self.p11, 2.0 * self.p12, 2.0 * self.p22)
        return np.array([[_QUADRATIC, self.centre_m, self.centre_mps, self.p11, self.p12, self.p22, *k]])

    @property
    def area_m2ps(self) -> float:
        """Area in the (e, v) plane: pi / sqrt(det P)."""
        return math.pi / math.sqrt(self.p11 * self.p22 - self.p12 * self.p12)

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Least and greatest e, least and greatest v of the region."""
        det = self.p11 * self.p22 - self.p12 * self.p12
        e, v = math.sqrt(self.p22 / det), math.sqrt(self.p11 / det)
        return self.centre_m - e, self.centre_m + e, self.centre_mps - v, self.centre_mps + v


@dataclass(frozen=True, slots=True)
class Stopping:
    """Room to stop before either limit; `low_*` is towards negative e."""

    low_m: float
    high_m: float
    reaction_s: float
    brake_high_mps2: float
    """Braking counted on when moving towards `high_m`."""
    brake_low_mps2: float

    def __post_init__(self) -> None:
        if not (self.low_m < self.high_m and min(self.reaction_s, self.brake_high_mps2, self.brake_low_mps2) > 0.0):
            raise InputError("stopping barrier: limits must be in order, reaction time and braking above 0")

    @property
    def rows(self) -> F64:
        """(2, ROW) towards high_m, towards low_m; scaled so that h is 1 in the middle at rest."""
        scale = 0.5 * (self.high_m - self.low_m)
        high = [STOPPING, 1.0, self.high_m, self.reaction_s, self.brake_high_mps2, scale]
        low = [STOPPING, -1.0, -self.low_m, self.reaction_s, self.brake_low_mps2, scale]
        return np.array([[*row, 0.0, 0.0, 1.0 / (row[BRAKE] * scale)] for row in (high, low)])

    @property
    def area_m2ps(self) -> float:
        """Area in the (e, v) plane, integrated over v."""
        _, _, slowest, fastest = self.box
        v = np.linspace(slowest, fastest, 4001)
        return float(np.trapezoid(np.maximum(_edge(self.rows[0], v) + _edge(self.rows[1], v), 0.0), v))

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Least and greatest e, least and greatest v of the region."""
        room = self.high_m - self.low_m
        t = self.reaction_s

        def fastest(brake: float, other: float) -> float:  # room + a_o t^2 / 2 = t v + v^2 / (2 a)
            most = room + 0.5 * other * t * t
            return brake * (math.sqrt(t * t + 2.0 * most / brake) - t)

        high, low = self.brake_high_mps2, self.brake_low_mps2
        reach = 0.5 * t * t
        return self.low_m - low * reach, self.high_m + high * reach, -fastest(low, high), fastest(high, low)


Barrier = Quadratic | Stopping


def _edge(row: F64, v: F64) -> F64:
    """The greatest sign * e that one stopping piece allows at each v."""
    toward = row[SIGN] * v
    slow = np.maximum(toward, -row[BRAKE] * row[REACTION])
    return np.asarray(row[LIMIT] - (row[REACTION] * slow + slow * slow / (2.0 * row[BRAKE])))


def value(barrier: Barrier, e_m: float, v_mps: float) -> float:
    """h, 1 at most, 0 on the boundary."""
    return float(values_at(barrier.rows, np.array([[e_m, v_mps]]))[0])


@njit_called
def values_at(rows: F64, points: F64) -> F64:
    """(n,) h at points (n, 2) of e and v."""
    found = np.full(points.shape[0], np.inf)
    for i in range(points.shape[0]):
        for j in range(rows.shape[0]):
            h, _, _ = piece_at(rows[j], points[i, 0], points[i, 1])
            found[i] = min(h, found[i])
    return found


def gradient(barrier: Barrier, e_m: float, v_mps: float) -> tuple[float, float]:
    """(dh/de, dh/dv) of the piece that is least here, 1/m and s/m."""
    _, h_e, h_v = min(piece_at(row, e_m, v_mps) for row in barrier.rows)
    return h_e, h_v


@njit
def piece_at(row: F64, e: float, v: float) -> tuple[float, float, float]:
    """Value and gradient (h, dh/de, dh/dv) of one piece."""
    if row[KIND] == _QUADRATIC:
        de, dv = e - row[CENTRE_E], v - row[CENTRE_V]
        along_e, along_v = row[P11] * de + row[P12] * dv, row[P12] * de + row[P22] * dv
        return 1.0 - de * along_e - dv * along_v, -2.0 * along_e, -2.0 * along_v
    toward = max(row[SIGN] * v, -row[BRAKE] * row[REACTION])
    way = row[REACTION] * toward + toward * toward / (2.0 * row[BRAKE])
    slope = row[REACTION] + toward / row[BRAKE]
    return (row[LIMIT] - row[SIGN] * e - way) / row[SCALE], -row[SIGN] / row[SCALE], -row[SIGN] * slope / row[SCALE]
