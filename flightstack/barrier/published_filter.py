"""The published safety filter: one row on the thrust, for the record.

    min (T - T_wanted)^2   with   L_f h + L_g h T + h_v m - sum_i |h_v,i| k sigma_i >= -gamma h   and T in its range

h is the certificate's ellipsoid over all axes, m and sigma the learned residual of the state.  One variable and one
row: the answer is the nearest end of an interval, in closed form; no solver is needed.

What is known of it, and why it is not the default: it moves only the thrust, along the present body axis, so that the
lateral parts of h may fall with nothing to hold them; at rest its row vanishes, so that a sampled vehicle creeps
outward by g dt / 2 (4.9 dt m/s) and finds the row infeasible; the residual is taken not to depend on thrust; delay
and lags are neglected.  Where no thrust meets the row, the best one goes out, with status 4.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.barrier.records import Certificate
from flightstack.barrier.shapes import Quadratic
from flightstack.frames import quat_to_matrix
from flightstack.governor import GovernorLimits
from flightstack.model import Limits, Model
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Command, Filtered, FlatOutput, Learned, Measurement

ENGAGE_H = 0.05
ENGAGE_US = 500_000
"""It engages once h has been at least ENGAGE_H for this long."""
_NOT_CERTIFIED, _WAITING, _PASSED, _CHANGED, _INFEASIBLE, _UNSOLVED = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0

_GRAVITY = np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
_ZERO = np.zeros(3)


class LinearConstraint(NamedTuple):
    """The condition slope T + rest >= 0 at one state, T in newton, in 1/s."""

    slope: float
    rest: float
    h: float


class PublishedState(NamedTuple):
    """What the filter remembers."""

    origin_ned_m: F64
    certificate: Certificate | None
    since_us: int
    """Since when h has been at least ENGAGE_H; -1: it is not."""
    engaged: bool


class PublishedFilter:
    """The filter of one believed vehicle; final, holds only constants."""

    __slots__ = ("_drag_ps", "_thrust_range_n", "limits", "model")
    enabled = True

    def __init__(self, model: Model, limits: Limits | None = None) -> None:
        self.model = model
        self.limits = limits or Limits()
        self._drag_ps = np.array(model.drag_kgps) / model.mass_kg
        self._thrust_range_n = model.thrust_range_n(self.limits)

    def init(self, origin_ned_m: F64) -> PublishedState:
        """Nothing is certified yet."""
        return PublishedState(origin_ned_m.copy(), None, -1, False)

    def bend(self, state: PublishedState, setpoint: FlatOutput) -> FlatOutput:
        """As published the reference stays as it is."""
        return setpoint

    def governed(self, state: PublishedState) -> GovernorLimits | None:
        """Nothing: the paper knows no torque."""
        return None

    def in_force(self, state: PublishedState) -> F64 | None:
        """Nothing: the paper knows no age of samples."""
        return None

    def adopt(self, state: PublishedState, certificate: Certificate) -> PublishedState:
        """From now on this region; one that is not made of quadratics is not taken."""
        if all(isinstance(axis.barrier, Quadratic) for axis in certificate.axes):
            return state._replace(certificate=certificate)
        return state

    def step(
        self, state: PublishedState, measurement: Measurement, command: Command, sent: Command, learned: Learned
    ) -> tuple[PublishedState, Command, Filtered]:
        """The command with the nearest thrust that meets the row."""
        certificate = state.certificate
        if certificate is None:
            return state, command, _filtered(_NOT_CERTIFIED, command)
        row = self.row(certificate, state.origin_ned_m, measurement, learned)
        if not math.isfinite(row.slope + row.rest + row.h + command.thrust_n):  # for the guard to judge
            return state, command, _filtered(_UNSOLVED if state.engaged else _WAITING, command, row)
        state = _engaged(state, row.h, measurement.t_us)
        if not state.engaged:
            return state, command, _filtered(_WAITING, command, row)
        thrust, feasible = nearest(command.thrust_n, row, self._thrust_range_n)
        changed = thrust != command.thrust_n
        if changed:
            command, wanted = command._replace(thrust_n=thrust, thrust_norm=self.model.norm_of(thrust)), command
        else:
            wanted = command
        status = _INFEASIBLE if not feasible else _CHANGED if changed else _PASSED
        filtered = _filtered(status, wanted, row)
        filtered.row[Filtered.margin_ps.place] = row.slope * thrust + row.rest
        filtered.row[Filtered.version.place] = certificate.version
        filtered.row[Filtered.intervened.place] = float(changed)
        down = quat_to_matrix(measurement.q_ned_frd)[:, 2] / self.model.mass_kg
        filtered.row[Filtered.wanted_acc_ned_mps2.place] = _GRAVITY - wanted.thrust_n * down
        filtered.row[Filtered.safe_acc_ned_mps2.place] = _GRAVITY - thrust * down
        return state, command, filtered

    def row(
        self, certificate: Certificate, origin_ned_m: F64, measurement: Measurement, learned: Learned
    ) -> LinearConstraint:
        """The condition at a measured state; a residual that is not known counts as none."""
        body = quat_to_matrix(measurement.q_ned_frd)
        residual, sigma = _or_zero(learned.residual_frd_mps2), _or_zero(learned.sigma_frd_mps2)
        drag = self._drag_ps * (measurement.vel_ned_mps @ body)
        known = (body @ (residual - drag) + _GRAVITY).tolist()
        doubt = (certificate.k_sigma * np.sqrt(body * body @ (sigma * sigma))).tolist()
        e = (measurement.pos_ned_m - origin_ned_m - certificate.centre_ned_m).tolist()
        vel, down = measurement.vel_ned_mps.tolist(), body[:, 2].tolist()
        slope, rest, h = 0.0, 0.0, 1.0
        for part in certificate.axes:
            i, shape = part.axis, part.barrier
            assert isinstance(shape, Quadratic)  # `adopt` takes no other
            de, dv = e[i] - shape.centre_m, vel[i] - shape.centre_mps
            along_e, along_v = shape.p11 * de + shape.p12 * dv, shape.p12 * de + shape.p22 * dv
            h -= de * along_e + dv * along_v
            slope += 2.0 * along_v * down[i] / self.model.mass_kg
            rest -= 2.0 * (along_e * vel[i] + along_v * known[i] + abs(along_v) * doubt[i])
        return LinearConstraint(slope, rest + certificate.axes[0].setting.gamma_ps * h, h)


def _or_zero(values: F64) -> F64:
    """(3,) as they are; zero where they are not known, which is NaN."""
    return _ZERO if math.isnan(values[0]) else values


def nearest(wanted_n: float, row: LinearConstraint, thrust_range_n: tuple[float, float]) -> tuple[float, bool]:
    """The thrust in range nearest to `wanted_n` that meets the row; where none does, the best one and False."""
    low, high = thrust_range_n
    thrust = min(max(wanted_n, low), high)
    if row.slope * thrust + row.rest >= 0.0:
        return thrust, True
    if row.slope == 0.0:
        return thrust, False
    edge = -row.rest / row.slope
    best = high if row.slope > 0.0 else low
    if row.slope * best + row.rest < 0.0:
        return best, False
    return min(max(edge, low), high), True


def _engaged(state: PublishedState, h: float, now_us: int) -> PublishedState:
    if state.engaged:
        return state
    if not h >= ENGAGE_H:
        return state._replace(since_us=-1)
    since = state.since_us if state.since_us >= 0 else now_us
    return state._replace(since_us=since, engaged=now_us - since >= ENGAGE_US)


def _filtered(status: float, wanted: Command, row: LinearConstraint | None = None) -> Filtered:
    """What the filter says, all else NaN."""
    filtered = Filtered(np.full(len(Filtered.nothing().row), np.nan))
    filtered.row[Filtered.status.place] = status
    filtered.row[Filtered.intervened.place] = 0.0
    filtered.row[Filtered.wanted_thrust_n.place] = wanted.thrust_n
    if row is not None:
        filtered.row[Filtered.h.place] = filtered.row[Filtered.h_state.place] = row.h
    return filtered
