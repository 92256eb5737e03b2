"""Whether what a certificate says of the acceleration is so, as measured.

The acceleration as measured (specific force and gravity) less the certificate's mean at the thrust that acted, as a
mean of 40 ms, must keep within the certificate's bound and what the sensor may be off; beyond it for 32 ms, the
certificate is falsified.  Whoever issued it finds a smaller one, or hands over: the filter stops changing commands,
which it would do by a model that is wrong, and the flight brakes and lands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from flightstack.barrier.initial import DOWN
from flightstack.barrier.records import AXES, AxisCertificate, Certificate
from flightstack.frames import quat_to_matrix
from flightstack.model import Model
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Learned, Measurement

HAND_OVER = "hand_over"
"""Key of Certificate.knowledge that is true where nothing is left to keep to."""
_MEAN_SHARE = 0.1
"""Forgetting of the acceleration's short mean, a tick: 40 ms at 250 Hz."""
_BEYOND_TICKS = 8
_NOISE_MPS2 = 0.15
"""What the short mean of the accelerometer, with its bias, may be off by itself."""


@dataclass(slots=True)
class Witness:
    """Compares tick by tick; changed in place."""

    error_mps2: F64 = field(default_factory=lambda: np.zeros(3))
    """Short mean of the acceleration as measured less the certificate's, NED."""
    beyond: int = 0
    """Ticks in a row that it has been beyond the bound."""

    def observe(
        self, certificate: Certificate, model: Model, measurement: Measurement, learned: Learned
    ) -> tuple[str, F64]:
        """Why the certificate is falsified (empty where it is not), and by how much, (3,) m/s^2, at least 0."""
        observed = observed_error(certificate, model, measurement, learned)
        if np.isfinite(observed).all():
            self.error_mps2 += _MEAN_SHARE * (observed - self.error_mps2)
        bound = np.full(3, math.inf)
        for each in certificate.axes:
            bound[each.axis] = doubt(each)
        excess = np.abs(self.error_mps2) - bound - _NOISE_MPS2
        self.beyond = self.beyond + 1 if (excess > 0.0).any() else 0
        if self.beyond < _BEYOND_TICKS:
            return "", np.zeros(3)
        axis = int(np.argmax(excess))
        reason = (
            f"{AXES[axis]}: acceleration off by {self.error_mps2[axis]:.2f} m/s^2, "
            f"certified within {bound[axis]:.2f} m/s^2"
        )
        self.beyond = 0
        self.error_mps2[:] = 0.0
        return reason, np.maximum(excess, 0.0)


def observed_error(certificate: Certificate, model: Model, measurement: Measurement, learned: Learned) -> F64:
    """(3,) NED acceleration as measured less what the certificate's means say at the thrust that acted, m/s^2."""
    turn = quat_to_matrix(measurement.q_ned_frd)
    measured = turn @ measurement.specific_force_frd_mps2
    measured[DOWN] += STANDARD_GRAVITY_MPS2
    thrust = learned.applied_thrust_n / model.mass_kg * turn[:, DOWN]
    error = np.zeros(3)
    down = next((each.authority for each in certificate.axes if each.axis == DOWN), None)
    vel = measurement.vel_ned_mps
    gain = 1.0 if down is None else float(np.interp(vel[DOWN], down.v_mps, down.gain))
    for each in certificate.axes:
        i, table = each.axis, each.authority
        error[i] = measured[i] - (float(np.interp(vel[i], table.v_mps, table.offset_mps2)) - gain * thrust[i])
    return error


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
