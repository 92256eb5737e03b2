"""The autopilot that a vehicle flies with: PX4's rate gains, its filters, and its mixing matrix for these rotors.

What a vehicle file's `[autopilot]` states counts; the rest are PX4's defaults, K the airframe's (`airframe_gains`).

The mixing matrix is the pseudo-inverse of the rotors' effectiveness (all rotors alike), with PX4's normalisation: roll
and pitch share one scale, the larger root of a column's sum of squares over half the rotors; yaw's is its largest
entry; thrust's is its mean.  For a symmetric X that gives 0.707 for roll and pitch, 1 for yaw and 1 for thrust.

K.  PX4's gains are tuned for each airframe through it.  Angular acceleration per unit of torque alpha and total lag tau
(rotors, gyro filter, yaw's low-pass) make a loop s (tau s + 1) + K P alpha, whose damping falls with K P alpha tau.
K = min(1, c / (P alpha tau)) leaves PX4's defaults on ordinary vehicles and holds back agile ones.  Nobody flies a
vehicle that rings: where what really flies answers later than the file says (`flown`), K is the greatest that leaves
the loop 35 degrees of phase.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

import numpy as np

from flightstack.autopilot_params import AUTOPILOT_PARAMS, AXES
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, InputError, Tuple3
from flightstack.vehicle import Rotors, Vehicle

YAW = 2
THRUST = 3
LOOP_GAIN_MAX = (1.1, 1.1, 0.6)
"""Most P K alpha tau of roll, pitch, yaw that the default K allows; yaw has no D to damp it."""
PHASE_MARGIN_DEG = 35.0
"""Least of the default K.  A rotor lag of 80 ms leaves PX4's defaults 41 degrees, 20 ms of dead time beside it 15."""
_FREQUENCIES_RADPS = np.geomspace(0.5, 500.0, 600)


def autopilot_of(vehicle: Vehicle, flown: Vehicle | None = None) -> dict[str, float]:
    """Every key of `[autopilot]` with the value that flies, as PX4's 32-bit floats hold it."""
    values = {key: param.default for key, param in AUTOPILOT_PARAMS.items()} | dict(vehicle.autopilot)
    known = {key: value for key, value in values.items() if value is not None}
    known = {**airframe_gains(vehicle, known, flown), **known}
    return {key: float32(known[key]) for key in AUTOPILOT_PARAMS}


def float32(value: float) -> float:
    """The nearest value that PX4's 32-bit float can hold."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def effectiveness(rotors: Rotors) -> F64:
    """(4, N): roll, pitch, yaw moment (N m) and thrust (N) per newton of each rotor's thrust along body -z."""
    x, y = rotors.position_m[:, 0], rotors.position_m[:, 1]
    return np.stack([-y, x, np.asarray(rotors.torque_ratio_m), np.ones(len(x))])


def mixer(rotors: Rotors) -> F64:
    """(N, 4) motor commands per unit of roll, pitch, yaw torque and collective thrust."""
    mix = np.linalg.pinv(effectiveness(rotors))
    mix[np.abs(mix) < 1e-9 * np.abs(mix).max()] = 0.0
    count = np.count_nonzero(mix, axis=0)
    if count.min() == 0 or mix[:, THRUST].min() <= 0.0:
        raise InputError("rotors.position_m and torque_ratio_m: must give thrust and torque about all axes")
    spread = np.sqrt(np.sum(mix[:, :YAW] ** 2, axis=0) / (count[:YAW] / 2.0))
    mix[:, :YAW] /= spread.max()
    mix[:, YAW] /= np.abs(mix[:, YAW]).max()
    mix[:, THRUST] /= mix[:, THRUST].mean()
    return np.ascontiguousarray(mix)


def torque_per_slope(vehicle: Vehicle) -> F64:
    """(3,) rad/s^2 per unit of roll, pitch, yaw torque setpoint where a rotor's thrust rises by max_thrust_n a unit."""
    rotors = vehicle.rotors
    moment_nm = np.diag(effectiveness(rotors)[:3] @ mixer(rotors)[:, :3]) * rotors.max_thrust_n
    scales = vehicle.effects.get("inertia", {})
    inertia = np.asarray(vehicle.inertia_kgm2) * [scales.get(f"scale_{axis}", 1.0) for axis in "xyz"]
    found: F64 = moment_nm * vehicle.effects.get("thrust_scale", {}).get("scale", 1.0) / inertia
    return found


def hover_command(vehicle: Vehicle) -> float:
    """Motor command 0..1 at which the file's rotors carry the file's mass: f u^2 + (1 - f) u = m g / (4 T_max)."""
    rotors = vehicle.rotors
    load = vehicle.mass_kg * STANDARD_GRAVITY_MPS2 / (len(rotors.position_m) * rotors.max_thrust_n)
    f = rotors.thrust_model_factor
    u = load if f < 1e-9 else (math.sqrt((1.0 - f) ** 2 + 4.0 * f * load) - (1.0 - f)) / (2.0 * f)
    return min(u, 1.0)


def angular_acceleration_per_torque(vehicle: Vehicle) -> F64:
    """(3,) rad/s^2 per unit of roll, pitch, yaw torque setpoint, linearised at hover, effects not counted."""
    rotors = vehicle.rotors
    f = rotors.thrust_model_factor
    slope_n = rotors.max_thrust_n * (2.0 * f * hover_command(vehicle) + 1.0 - f)
    moment_nm = np.diag(effectiveness(rotors)[:3] @ mixer(rotors)[:, :3]) * slope_n
    return moment_nm / np.asarray(vehicle.inertia_kgm2)


def airframe_gains(vehicle: Vehicle, values: Mapping[str, float], flown: Vehicle | None = None) -> dict[str, float]:
    """mc_*rate_k for this airframe, as tuned on what is `flown` (see the module's text); by default the airframe.

    `values`: the other keys of `[autopilot]`.
    """
    gyro_hz, d_hz, yaw_hz = values["imu_gyro_cutoff"], values["imu_dgyro_cutoff"], values["mc_yaw_tq_cutoff"]
    gyro_s = math.sqrt(2.0) / (2.0 * math.pi * gyro_hz) if gyro_hz > 0.0 else 0.0
    d_s = 1.0 / (2.0 * math.pi * d_hz) if d_hz > 0.0 else 0.0
    effects = (flown or vehicle).effects
    lag_s = effects.get("motor_lag", {}).get("time_constant_s", vehicle.rotors.time_constant_s)
    dead_s = effects.get("transport_delay", {}).get("delay_s", 0.0)
    alpha = angular_acceleration_per_torque(vehicle)
    gains = {}
    for axis, name in enumerate(AXES):
        p, i, d = (float32(values[f"mc_{name}rate_{part}"]) for part in "pid")
        yaw_s = 1.0 / (2.0 * math.pi * yaw_hz) if axis == YAW and yaw_hz > 0.0 else 0.0
        loop = p * float(alpha[axis]) * (vehicle.rotors.time_constant_s + gyro_s + yaw_s)
        k = max(0.01, min(1.0, LOOP_GAIN_MAX[axis] / loop)) if loop > 0.0 else 1.0
        lags_s, rate = (lag_s, gyro_s, yaw_s), float(alpha[axis])
        while k > 0.01 and phase_margin_deg((k * p, k * i, k * d, d_s), rate, lags_s, dead_s) < PHASE_MARGIN_DEG:
            k *= 0.98
        gains[f"mc_{name}rate_k"] = k
    return gains


def phase_margin_deg(gains: tuple[float, float, float, float], alpha: float, lags_s: Tuple3, dead_s: float) -> float:
    """Of the loop (P + I / s + D s / (1 + s D_s)) alpha e^(-s dead) / (s (1 + s lag) ...), `gains` P, I, D, D_s.

    180 where its gain is below 1 throughout.
    """
    p, i, d, d_s = gains
    s = 1j * _FREQUENCIES_RADPS
    loop = (p + i / s + d * s / (1.0 + s * d_s)) * alpha / s
    for lag_s in lags_s:
        loop = loop / (1.0 + s * lag_s)
    above = np.flatnonzero(np.abs(loop) >= 1.0)
    if not above.size:
        return 180.0
    at = int(above[-1])
    return 180.0 + math.degrees(float(np.unwrap(np.angle(loop))[at]) - dead_s * float(_FREQUENCIES_RADPS[at]))
