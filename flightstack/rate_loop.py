"""A model of PX4's body-rate loop on a vehicle: what torque it asks for on the rates that are commanded.

    torque = P e + I - D w' + FF w_sp,  e = w_sp - w      (w: gyro through its low-pass, w' through one of its own)
    mixed torque = torque, yaw's through a first-order low-pass; nothing saturates where the governor keeps its word
    delivered' = (torque - delivered) / tau               (rotors' lag, which acts on each rotor's command alike)
    w'_axis = alpha(u) delivered - damping w + gyroscopic coupling,   u: collective command through the same lag
    alpha(u) = alpha_1 (2 f u + 1 - f) / (2 F u + 1 - F)  (f: the rotors' curve, F: THR_MDL_FAC)

Nobody knows alpha and tau exactly.  `MODELS` copies run side by side, the model as believed and the four corners of
what it may be off by (SPREAD), three axes each: what holds for all of them holds nearly for what lies between.

States lie in rows of `LANES` numbers, roll of all copies, then pitch, then yaw, so that one loop steps all of them.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.autopilot import autopilot_of, torque_per_slope
from flightstack.autopilot_params import AXES
from flightstack.jit import njit
from flightstack.types import F64
from flightstack.vehicle import Vehicle

STEP_S = 0.001
SPREAD = 0.2
"""Share that alpha and tau may be off by."""
MODELS = 5
LANES = 3 * MODELS
_SIGNS = np.array([[0.0, 0.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
"""Of the doubt of alpha and of tau, for each copy."""
FADE_RADPS = math.radians(400.0)
"""PX4's integrator shrinks with the error and stands still from here on."""
Z1, Z2, RATE, ACC, INTEGRAL, TORQUE, DELIVERED, BODY, LAGGED = range(9)
"""Rows of a state: gyro filter (2), filtered rate and acceleration, integrator, torque, delivered torque, body rate;
collective command after the rotors' lag (roll's lanes)."""
STATE = 9
(
    GAIN_P, GAIN_I, GAIN_D, GAIN_FF, LIMIT, ALPHA, LEFT, DAMPING, COUPLING, B0, B1, B2, A1, A2, ACC_WEIGHT,
    TORQUE_WEIGHT, CURVE, UNDONE,
) = range(18)  # fmt: skip
"""Rows of the constants: gains with K, alpha_1, what the rotors' lag leaves of an error in a step, damping (1/s),
gyroscopic coupling, gyro filter (5), weights of the new sample in the low-passes of acceleration and torque, f, F."""
CONSTANTS = 18
_INT_LIMITS = ("mc_rr_int_lim", "mc_pr_int_lim", "mc_yr_int_lim")


def butterworth2(cutoff_hz: float, sample_hz: float) -> tuple[float, float, float, float, float]:
    """(b0, b1, b2, a1, a2) of a second-order Butterworth low-pass (bilinear, prewarped); no filter at 0 Hz."""
    if cutoff_hz <= 0.0 or cutoff_hz >= 0.5 * sample_hz:
        return 1.0, 0.0, 0.0, 0.0, 0.0
    k = math.tan(math.pi * cutoff_hz / sample_hz)
    norm = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
    b0 = k * k * norm
    return b0, 2.0 * b0, b0, 2.0 * (k * k - 1.0) * norm, (1.0 - math.sqrt(2.0) * k + k * k) * norm


def first_order_alpha(cutoff_hz: float, dt_s: float) -> float:
    """Weight of the new sample in a first-order low-pass; 1 (no filter) at 0 Hz."""
    return 1.0 if cutoff_hz <= 0.0 else dt_s / (dt_s + 1.0 / (2.0 * math.pi * cutoff_hz))


def constants_of(vehicle: Vehicle, *, step_s: float = STEP_S) -> F64:
    """(CONSTANTS, LANES) of the believed vehicle."""
    autopilot, effects = autopilot_of(vehicle), vehicle.effects
    alpha = torque_per_slope(vehicle)
    scales = effects.get("inertia", {})
    inertia = np.asarray(vehicle.inertia_kgm2) * [scales.get(f"scale_{axis}", 1.0) for axis in "xyz"]
    lag_s = effects.get("motor_lag", {}).get("time_constant_s", vehicle.rotors.time_constant_s)
    damping = effects.get("angular_damping", {})
    c = np.zeros((CONSTANTS, 3, MODELS))
    for axis, name in enumerate(AXES):
        k = autopilot[f"mc_{name}rate_k"]
        for row, part in ((GAIN_P, "p"), (GAIN_I, "i"), (GAIN_D, "d")):
            c[row, axis] = k * autopilot[f"mc_{name}rate_{part}"]
        c[GAIN_FF, axis], c[LIMIT, axis] = autopilot[f"mc_{name}rate_ff"], autopilot[_INT_LIMITS[axis]]
        c[ALPHA, axis] = alpha[axis] * (1.0 + SPREAD * _SIGNS[:, 0])
        lags = lag_s * (1.0 + SPREAD * _SIGNS[:, 1])
        c[LEFT, axis] = np.exp(-step_s / lags) if lag_s > 0.0 else 0.0
        c[DAMPING, axis] = damping.get(f"k_{'xyz'[axis]}_nms", 0.0) / inertia[axis]
        c[COUPLING, axis] = (inertia[(axis + 1) % 3] - inertia[(axis + 2) % 3]) / inertia[axis]
        yaw_hz = autopilot["mc_yaw_tq_cutoff"] if axis == 2 else 0.0
        c[TORQUE_WEIGHT, axis] = first_order_alpha(yaw_hz, step_s)
    for row, value in zip((B0, B1, B2, A1, A2), butterworth2(autopilot["imu_gyro_cutoff"], 1.0 / step_s), strict=True):
        c[row] = value
    c[ACC_WEIGHT] = first_order_alpha(autopilot["imu_dgyro_cutoff"], step_s)
    c[CURVE] = effects.get("thrust_curve", {}).get("thrust_model_factor", vehicle.rotors.thrust_model_factor)
    c[UNDONE] = autopilot["thr_mdl_fac"]
    return np.ascontiguousarray(c.reshape(CONSTANTS, LANES))


def steepness(norm: float, curve: float, undone: float) -> float:
    """Thrust gained per unit of a mixed command at a collective command, over max_thrust_n."""
    return (2.0 * curve * norm + 1.0 - curve) / max(2.0 * undone * norm + 1.0 - undone, 0.05)


@njit
def step_lanes(
    state: F64, constants: F64, target: F64, coupling: F64, norm: float, lanes: int, step_s: float
) -> None:  # fmt: skip
    """One step of so many lanes with held rates (lanes,) and collective command, in place.

    state (STATE * lanes,), constants (CONSTANTS * lanes,): rows one after the other, of this step's length; coupling
    (lanes,) rad/s^2: what the other axes' rates accelerate.
    """
    s, c, n = state, constants, lanes
    for j in range(lanes):
        y = c[B0 * n + j] * s[BODY * n + j] + s[Z1 * n + j]
        s[Z1 * n + j] = c[B1 * n + j] * s[BODY * n + j] - c[A1 * n + j] * y + s[Z2 * n + j]
        s[Z2 * n + j] = c[B2 * n + j] * s[BODY * n + j] - c[A2 * n + j] * y
        s[ACC * n + j] += c[ACC_WEIGHT * n + j] * ((y - s[RATE * n + j]) / step_s - s[ACC * n + j])
        s[RATE * n + j] = y
        error = target[j] - y
        wanted = c[GAIN_P * n + j] * error + s[INTEGRAL * n + j]
        wanted += c[GAIN_FF * n + j] * target[j] - c[GAIN_D * n + j] * s[ACC * n + j]
        torque = s[TORQUE * n + j] + c[TORQUE_WEIGHT * n + j] * (wanted - s[TORQUE * n + j])
        s[TORQUE * n + j] = torque
        fade = max(1.0 - error * error / (FADE_RADPS * FADE_RADPS), 0.0)
        integral = s[INTEGRAL * n + j] + c[GAIN_I * n + j] * error * fade * step_s
        s[INTEGRAL * n + j] = min(max(integral, -c[LIMIT * n + j]), c[LIMIT * n + j])
        delivered = torque + c[LEFT * n + j] * (s[DELIVERED * n + j] - torque)
        s[DELIVERED * n + j] = delivered
        u = norm + c[LEFT * n + j] * (s[LAGGED * n + j] - norm)
        s[LAGGED * n + j] = u
        f, undone = c[CURVE * n + j], c[UNDONE * n + j]
        gain = c[ALPHA * n + j] * (2.0 * f * u + 1.0 - f) / max(2.0 * undone * u + 1.0 - undone, 0.05)
        s[BODY * n + j] += step_s * (gain * delivered - c[DAMPING * n + j] * s[BODY * n + j] + coupling[j])


@njit
def couple(state: F64, constants: F64, coupling: F64) -> None:
    """The gyroscopic acceleration of each of the LANES into `coupling`."""
    for m in range(MODELS):
        p, q, r = MODELS + m, 2 * MODELS + m, BODY * LANES
        x, y, z = state[r + m], state[r + p], state[r + q]
        coupling[m] = constants[COUPLING * LANES + m] * y * z
        coupling[p] = constants[COUPLING * LANES + p] * z * x
        coupling[q] = constants[COUPLING * LANES + q] * x * y
