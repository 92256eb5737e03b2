"""Whether what a certificate says of the acceleration is so, as measured.

The acceleration as measured (specific force and gravity) less the certificate's mean at the thrust that acted, as a
mean of 40 ms, must keep within the certificate's bound and what the sensor may be off; beyond it for 32 ms, the
certificate is falsified.  Whoever issued it finds a smaller one, or hands over: the filter stops changing commands,
which it would do by a model that is wrong, and the flight brakes and lands.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.barrier.assess import column_at
from flightstack.barrier.initial import DOWN
from flightstack.barrier.records import AXES, AxisCertificate, Certificate
from flightstack.frames import quat_to_matrix
from flightstack.jit import njit
from flightstack.model import Model
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Learned, Measurement

HAND_OVER = "hand_over"
"""Key of Certificate.knowledge that is true where nothing is left to keep to."""
_MEAN_SHARE = 0.1
"""Forgetting of the acceleration's short mean, a tick: 40 ms at 250 Hz."""
_BEYOND_TICKS = 8
_NOISE_MPS2 = 0.15
"""What the short mean of the accelerometer, with its bias, may be off by itself."""
_NOTHING = np.empty((7, 0))
_NO_EXCESS = np.zeros(3)


class Witness:
    """Compares tick by tick; changed in place."""

    __slots__ = ("_beyond", "_bound", "_certificate", "_error", "_tables")

    def __init__(self) -> None:
        self._certificate: Certificate | None = None
        self._tables = (_NOTHING, _NOTHING, _NOTHING)
        self._bound = np.full(3, math.inf)
        self._error = np.zeros(3)
        self._beyond = 0

    def observe(
        self, certificate: Certificate, model: Model, measurement: Measurement, learned: Learned
    ) -> tuple[str, F64]:
        """Why the certificate is falsified (empty where it is not), and by how much, (3,) m/s^2, at least 0."""
        if certificate is not self._certificate:
            self._take(certificate)
        thrust_mps2 = learned.applied_thrust_n / model.mass_kg
        over = _compare(measurement.row, thrust_mps2, self._tables, self._bound, self._error)
        self._beyond = self._beyond + 1 if over else 0
        if self._beyond < _BEYOND_TICKS:
            return "", _NO_EXCESS
        excess = np.abs(self._error) - self._bound - _NOISE_MPS2
        axis = int(np.argmax(excess))
        reason = (
            f"{AXES[axis]}: acceleration off by {self._error[axis]:.2f} m/s^2, "
            f"certified within {self._bound[axis]:.2f} m/s^2"
        )
        self._beyond = 0
        self._error[:] = 0.0
        return reason, np.maximum(excess, 0.0)

    def _take(self, certificate: Certificate) -> None:
        """What to compare with from now on; the mean so far goes on."""
        tables, self._certificate = [_NOTHING] * 3, certificate
        self._bound[:] = math.inf
        for each in certificate.axes:
            tables[each.axis] = each.authority.table
            self._bound[each.axis] = doubt(each)
        self._tables = (tables[0], tables[1], tables[2])


@njit
def _compare(row: F64, thrust_mps2: float, tables: tuple[F64, F64, F64], bound: F64, mean: F64) -> bool:
    """Take a tick's acceleration error into its short mean; whether that is beyond the bound on any axis.

    `row`: a Measurement's; `tables`: each axis' `Authority.table`, empty where nothing is certified.
    """
    turn = quat_to_matrix(row[6:10])
    gain = column_at(tables[DOWN], 2, row[3 + DOWN]) if tables[DOWN].size else 1.0
    error = np.zeros(3)
    for i in range(3):
        if tables[i].size:
            measured = turn[i, 0] * row[13] + turn[i, 1] * row[14] + turn[i, 2] * row[15]
            if i == DOWN:
                measured += STANDARD_GRAVITY_MPS2
            error[i] = measured - column_at(tables[i], 1, row[3 + i]) + gain * thrust_mps2 * turn[i, 2]
    if np.isfinite(error).all():
        mean += _MEAN_SHARE * (error - mean)
    return bool(np.any(np.abs(mean) - bound - _NOISE_MPS2 > 0.0))


def prepare() -> None:
    """Compile what `Witness.observe` calls: no tick waits for it."""
    _compare(np.eye(1, 20, 6)[0], 0.0, (_NOTHING, _NOTHING, np.zeros((7, 2))), np.zeros(3), np.zeros(3))


def doubt(axis: AxisCertificate) -> float:
    """The greatest bound of an axis' acceleration, m/s^2."""
    return float(max(axis.authority.error_low_mps2.max(), axis.authority.error_high_mps2.max()))


def marked(certificate: Certificate, reason: str, *, hand_over: bool, version: int | None = None) -> Certificate:
    """The certificate with the reason why it does not hold; `hand_over`: nothing else is there to keep to."""
    knowledge = {**certificate.knowledge, "falsified": reason, HAND_OVER: hand_over}
    return Certificate(
        certificate.mode, certificate.centre_ned_m, certificate.axes, certificate.budget, certificate.delta,
        certificate.k_sigma, knowledge, certificate.version if version is None else version,
    )  # fmt: skip
