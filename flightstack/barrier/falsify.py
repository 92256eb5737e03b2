"""Whether what a certificate says of the acceleration is so, as measured.

The acceleration as measured (specific force and gravity) less the certificate's mean at the thrust that acted must keep
within the certificate's bound and what the sensor may be off.  When thrust acts is known to the ledger's doubts of lag
and delay only, so a hard command may put it off for a moment, by no more than velocity may be: what is beyond the bound
is summed up, each way for itself and never below 0, and where the sum, a velocity, is more than twice the certificate's
offset (at the sum's beginning and at its end), the certificate is falsified.  (A cumulative sum: E. Page, "Continuous
inspection schemes", Biometrika 41, 1954.)  Whoever issued it finds a smaller one, or hands over: the filter stops
changing commands, which it would do by a model that is wrong, and the flight brakes and lands.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from flightstack.barrier.assess import column_at
from flightstack.barrier.initial import DOWN
from flightstack.barrier.records import AXES, AxisCertificate, Certificate
from flightstack.frames import quat_to_matrix
from flightstack.jit import Entry, njit
from flightstack.model import Model
from flightstack.rows import FORCE_X, FORCE_Y, FORCE_Z, L_APPLIED
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Learned, Measurement

HAND_OVER = "hand_over"
"""Key of Certificate.knowledge that is true where nothing is left to keep to."""
_MEAN_SHARE = 0.1
"""Forgetting of the acceleration's short mean, a tick: 40 ms at 250 Hz; it says by how much the bound was missed."""
_NOISE_MPS2 = 0.15
"""What the accelerometer, with its bias, may be off by itself over some time."""
_LEAST_MPS = 0.03
"""Of the sum, whatever the ledger says: white noise adds up to a third of it."""
_GAP_MAX_S = 0.05
_NOTHING = np.empty((7, 0))
_NO_EXCESS = np.zeros(3)


class Witness:
    """Compares tick by tick; changed in place."""

    __slots__ = ("_allowed", "_bound", "_certificate", "_error", "_seen_us", "_sums", "_tables")

    def __init__(self) -> None:
        self._certificate: Certificate | None = None
        self._tables = (_NOTHING, _NOTHING, _NOTHING)
        self._bound = np.full(3, math.inf)
        self._error = np.zeros(3)
        self._sums = np.zeros((2, 3))
        self._allowed = np.full(3, math.inf)
        self._seen_us = -1

    def observe(
        self, certificate: Certificate, model: Model, measurement: Measurement, learned: Learned
    ) -> tuple[str, F64]:
        """Why the certificate is falsified (empty where it is not), and by how much, (3,) m/s^2, at least 0."""
        if certificate is not self._certificate:
            self._take(certificate)
        thrust_mps2 = learned.row.item(L_APPLIED) / model.mass_kg
        dt_s = min(1e-6 * (measurement.t_us - self._seen_us), _GAP_MAX_S) if self._seen_us >= 0 else 0.0
        self._seen_us = measurement.t_us
        over = _COMPARE.call(
            measurement.row, thrust_mps2, max(dt_s, 0.0), self._tables, self._bound, self._allowed, self._error,
            self._sums,
        )  # fmt: skip
        if not over:
            return "", _NO_EXCESS
        excess = np.abs(self._error) - self._bound - _NOISE_MPS2
        axis = int(np.argmax(self._sums.max(axis=0) - self._allowed))
        reason = (
            f"{AXES[axis]}: acceleration off by {self._error[axis]:.2f} m/s^2, "
            f"certified within {self._bound[axis]:.2f} m/s^2"
        )
        self._sums[:] = 0.0
        self._error[:] = 0.0
        return reason, np.maximum(excess, 0.0)

    def _take(self, certificate: Certificate) -> None:
        """What to compare with from now on; the mean so far goes on."""
        tables, self._certificate = [_NOTHING] * 3, certificate
        self._bound[:] = self._allowed[:] = math.inf
        for each in certificate.axes:
            tables[each.axis] = np.ascontiguousarray(each.authority.table)
            self._bound[each.axis] = doubt(each)
            self._allowed[each.axis] = max(2.0 * each.setting.off_mps, _LEAST_MPS)
        self._tables = (tables[0], tables[1], tables[2])


@njit
def _compare(
    row: F64, thrust_mps2: float, dt_s: float, tables: tuple[F64, F64, F64], bound: F64, allowed: F64, mean: F64,
    sums: F64,
) -> bool:  # fmt: skip
    """Take a tick's acceleration error into its short mean and its sums; whether one is more than allowed.

    `row`: a Measurement's; `tables`: each axis' `Authority.table`, empty where nothing is certified; `sums` (2, 3):
    beyond the bound on the one side and on the other, m/s.
    """
    turn = quat_to_matrix(row[6:10])
    gain = column_at(tables[DOWN], 2, row[3 + DOWN]) if tables[DOWN].size else 1.0
    error = np.zeros(3)
    for i in range(3):
        if tables[i].size:
            measured = turn[i, 0] * row[FORCE_X] + turn[i, 1] * row[FORCE_Y] + turn[i, 2] * row[FORCE_Z]
            if i == DOWN:
                measured += STANDARD_GRAVITY_MPS2
            error[i] = measured - column_at(tables[i], 1, row[3 + i]) + gain * thrust_mps2 * turn[i, 2]
    if math.isfinite(error[0] + error[1] + error[2]):
        mean += _MEAN_SHARE * (error - mean)
        for i in range(3):
            if tables[i].size:
                for k in range(2):
                    beyond = (error[i] if k == 0 else -error[i]) - bound[i] - _NOISE_MPS2
                    sums[k, i] = max(sums[k, i] + beyond * dt_s, 0.0)
    over = False
    for i in range(3):
        over = over or sums[0, i] > allowed[i] or sums[1, i] > allowed[i]
    return over


_COMPARE = Entry(_compare, "f8[::1], f8, f8, UniTuple(f8[:, ::1], 3), f8[::1], f8[::1], f8[::1], f8[:, ::1]")


def prepare() -> None:
    """Compile what `Witness.observe` calls: no tick waits for it."""
    _COMPARE.prepare()


def doubt(axis: AxisCertificate) -> float:
    """The greatest bound of an axis' acceleration, m/s^2."""
    return float(max(axis.authority.error_low_mps2.max(), axis.authority.error_high_mps2.max()))


def marked(certificate: Certificate, reason: str, *, hand_over: bool, version: int | None = None) -> Certificate:
    """The certificate with the reason why it does not hold; `hand_over`: nothing else is there to keep to."""
    knowledge = {**certificate.knowledge, "falsified": reason, HAND_OVER: hand_over}
    return replace(certificate, knowledge=knowledge, version=certificate.version if version is None else version)
