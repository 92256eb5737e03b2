"""What speaks against a vehicle file by itself: one line for each contradiction."""

from __future__ import annotations

import numpy as np

from flightstack.vehicle import Vehicle

_LEAST_THRUST_TO_WEIGHT = 1.2
_CENTRE_SHARE = 0.25
"""Share of the mean arm by which the rotors' centre may lie beside the centre of mass."""
_INERTIA_SHARES = (0.02, 2.0)
"""Of mass times the mean arm squared: a point mass between the arms, and all of it beyond the rotors."""
_TORQUE_SHARE = 0.5
"""Of the mean arm: a rotor's reaction torque is that of a force at this lever at most."""


def implausible(vehicle: Vehicle) -> list[str]:
    """Why no quadrotor is like this, one line each; empty where nothing speaks against it."""
    rotors, lines = vehicle.rotors, []
    lift = vehicle.max_total_thrust_n / vehicle.weight_n
    if lift < _LEAST_THRUST_TO_WEIGHT:
        lines.append(f"rotors.max_thrust_n: all rotors together lift {lift:.2f} times the weight")
    turns = np.sign(rotors.torque_ratio_m)
    if turns.sum() != 0.0:
        lines.append("rotors.torque_ratio_m: as many rotors must turn one way as the other")
    places = rotors.position_m[:, :2]
    arm_m = float(np.linalg.norm(places, axis=1).mean())
    off_m = float(np.linalg.norm(places.mean(axis=0)))
    if off_m > _CENTRE_SHARE * arm_m:
        lines.append(f"rotors.position_m: the rotors' centre lies {off_m:.3g} m from the centre of mass")
    if float(np.abs(rotors.torque_ratio_m).max()) > _TORQUE_SHARE * arm_m:
        lines.append(f"rotors.torque_ratio_m: greater than {_TORQUE_SHARE:g} of the mean arm of {arm_m:.3g} m")
    shares = vehicle.inertia_kgm2 / (vehicle.mass_kg * arm_m**2)
    low, high = _INERTIA_SHARES
    for axis, share in zip("xyz", shares.tolist(), strict=True):
        if not low <= share <= high:
            lines.append(
                f"body.inertia_kgm2: about {axis} it is {share:.2g} times mass times arm squared ({low:g} to {high:g})"
            )
    return lines
