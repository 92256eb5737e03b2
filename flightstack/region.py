"""The region a scenario wants the vehicle to stay in: data, and its barrier value h (at least 0 inside)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flightstack.types import F64, Tuple3


@dataclass(frozen=True, slots=True)
class Region:
    """Ellipses in (position, velocity), relative to the start: one for each axis, or one ellipsoid over all of them.

    With e = position - centre: `axes` has h = min_i (1 - e_i^2 / a_i^2 - v_i^2 / b_i^2), `ellipsoid` has
    h = 1 - sum_i (e_i^2 / a_i^2 + v_i^2 / b_i^2), the paper's h_mu with b_z = 1 / sqrt(mu).
    """

    kind: str
    """axes or ellipsoid."""
    centre_ned_m: Tuple3
    semi_axes_m: Tuple3
    semi_axes_mps: Tuple3

    def value(self, pos_ned_m: F64, vel_ned_mps: F64) -> float:
        """h at a position relative to the start (3,) and a velocity (3,)."""
        return float(self.values(pos_ned_m, vel_ned_mps))

    def values(self, pos_ned_m: F64, vel_ned_mps: F64) -> F64:
        """(...,) h at many: positions relative to the start and velocities, (..., 3) each."""
        terms = ((pos_ned_m - np.array(self.centre_ned_m)) / np.array(self.semi_axes_m)) ** 2
        terms = terms + (vel_ned_mps / np.array(self.semi_axes_mps)) ** 2
        return np.asarray(1.0 - (terms.max(axis=-1) if self.kind == "axes" else terms.sum(axis=-1)))
