"""When a vehicle flies: by its own landing detector, its height, its motors and what its accelerometer feels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.decisions import CLEAR_M, EDGE_S, LEAST_THRUST, STANDING_MPS, TOUCHING_M
from flightstack.types import F64
from flightstack.vehicle import Vehicle


def rotor_thrust(vehicle: Vehicle, motor: F64) -> F64:
    """Thrust of each rotor in newton at these commands, by the vehicle file's curve."""
    f = vehicle.rotors.thrust_model_factor
    u = np.clip(motor, 0.0, 1.0)
    return np.asarray(vehicle.rotors.max_thrust_n * (f * u * u + (1.0 - f) * u))


def flying(
    vehicle: Vehicle,
    step_s: float,
    motor: F64 | None,
    landed: F64 | None,
    height_m: F64 | None,
    speed_mps: F64 | None = None,
) -> NDArray[np.bool_]:
    """(N,) of the grid: in the air, without a margin at both ends of each stretch."""
    rows = next(len(column) for column in (motor, landed, height_m) if column is not None)
    up = np.ones(rows, np.bool_)
    if motor is not None:
        share = rotor_thrust(vehicle, np.nan_to_num(motor)).sum(axis=1) / vehicle.weight_n
        up &= _smoothed(share, round(0.3 / step_s)) > LEAST_THRUST
    if landed is not None:
        up &= landed < 0.5
    if height_m is not None and landed is not None:
        up &= ~(height_m < CLEAR_M)
    if height_m is not None and speed_mps is not None:
        up &= ~((np.abs(height_m) < 2.0 * TOUCHING_M) & (speed_mps < STANDING_MPS))
    return _trimmed(_bridged(up, round(2.0 * EDGE_S / step_s)), round(EDGE_S / step_s))


def _smoothed(values: F64, window: int) -> F64:
    window = max(1, min(window, len(values)))
    return np.convolve(
        np.pad(values, (window // 2, window - 1 - window // 2), mode="edge"), np.ones(window) / window, "valid"
    )


def _bridged(up: NDArray[np.bool_], longest: int) -> NDArray[np.bool_]:
    """Low thrust for a moment between two stretches in the air is a manoeuvre, not a landing."""
    out = up.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[True], up, [True]]).astype(np.int8)))
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if begin > 0 and end < len(up) and end - begin <= longest:
            out[begin:end] = True
    return out


def _trimmed(up: NDArray[np.bool_], margin: int) -> NDArray[np.bool_]:
    """Stretches that begin or end within the log lose `margin` rows there."""
    out = up.copy()
    edges = np.flatnonzero(np.diff(up.astype(np.int8)))
    for edge in edges.tolist():
        if up[edge + 1]:
            out[edge + 1 : edge + 1 + margin] = False
        else:
            out[max(0, edge + 1 - margin) : edge + 1] = False
    return out
