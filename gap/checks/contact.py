"""Ground contact: what the ground does to a vehicle that touches it is no gap of its model; it is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flightstack.vehicle import Vehicle
from gap.records import Finding, Samples

CLEAR_M = 0.03
"""Least distance of the lowest rotor from the ground."""
AROUND_S = 0.25
"""What is left out before and after a contact: the low-pass carries it there."""
_FEWEST_S = 0.1


def leave_out(samples: Samples, vehicle: Vehicle) -> tuple[Samples, list[Finding]]:
    """The samples without those in which a rotor is at the ground, and a word on it where there are any."""
    x, y = vehicle.rotors.position_m[:, 0], vehicle.rotors.position_m[:, 1]
    w, i, j, k = samples.q_ned_frd.T
    down_x, down_y = 2.0 * (i * k - w * j), 2.0 * (j * k + w * i)
    lowest = samples.height_m - np.max(np.outer(down_x, x) + np.outer(down_y, y), axis=1)
    touching = samples.valid & (lowest < CLEAR_M)
    if not touching.any():
        return samples, []
    reach = max(1, round(AROUND_S / samples.dt_s))
    near = np.convolve(touching, np.ones(2 * reach + 1), mode="same") > 0.5
    seconds = float(np.sum(samples.valid & near)) * samples.dt_s
    kept = replace(samples, valid=samples.valid & ~near)
    if seconds < _FEWEST_S:
        return kept, []
    return kept, [Finding("ground", "ok", f"{seconds:.1f} s at the ground were left out")]
