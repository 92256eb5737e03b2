"""Many short flights at once for the gap workflow's tests: one batched plant, one vectorised controller.

Every vehicle of the batch believes the same file and hides something else.  The flight has what an identification
flight has: runs on several headings, hard turns, rate doublets, a thrust chirp, a fast descent and a low pass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from flightstack.gap.records import Samples
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle, with_effects
from flightstack_sim.batch import BatchPlant

_G = np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
TICK_S = 0.004
EVERY = 2
NOISE = {"pos": 0.002, "vel": 0.01, "q": 0.0006, "rate": 0.002, "accel": 0.03, "battery": 0.005}


def multiply(a: F64, b: F64) -> F64:
    """Hamilton products row by row."""
    w, x, y, z = a.T
    W, X, Y, Z = b.T
    real = w * W - x * X - y * Y - z * Z
    i, j, k = w * X + x * W + y * Z - z * Y, w * Y - x * Z + y * W + z * X, w * Z + x * Y - y * X + z * W
    return np.stack([real, i, j, k], axis=1)


def fly(
    believed: Vehicle, hidden: Sequence[Mapping[str, Mapping[str, float]]], *, seconds: float = 24.0, seed: int = 0
) -> list[Samples]:
    """One flight for each set of hidden effects, all on the same reference, each with noise of its own."""
    count = len(hidden)
    truths = [with_effects(believed, effects) for effects in hidden]
    plant = BatchPlant(truths, seed=seed, dt_us=1000)
    rng = np.random.default_rng(seed)
    arms, ratio = believed.rotors.position_m, believed.rotors.torque_ratio_m
    unmix = np.linalg.inv(np.stack([np.ones(4), -arms[:, 1], arms[:, 0], ratio]))
    paths = _reference(seconds)
    plant.pos_ned_m[:] = paths[0][0]
    plant.motor_u[:] = np.sqrt(believed.mass_kg * _G[2] / 4.0 / believed.rotors.max_thrust_n)
    before = plant.motor_u.copy()  # the log holds the commands' mean round each sample
    rows = []
    integral, turn_integral = np.zeros((count, 3)), np.zeros((count, 3))
    bias = _sensor(truths, "accelerometer_bias"), _sensor(truths, "gyro_bias")
    tilt = _misalignment(truths)
    for tick, (pos, vel, acc, yaw, doublet, chirp) in enumerate(zip(*paths, strict=True)):
        q = multiply(plant.q_ned_frd, tilt)
        rate = plant.rate_frd_radps + bias[1]
        error = pos - plant.pos_ned_m
        integral = np.clip(integral + 1.5 * TICK_S * error, -4.0, 4.0)
        lift = acc + 3.0 * np.clip(error, -1.5, 1.5) + 2.5 * (vel - plant.vel_ned_mps) + integral - _G
        x, z = _column(q, 0), _column(q, 2)
        thrust = believed.mass_kg * np.maximum(-(lift * z).sum(axis=1), 2.0) + believed.mass_kg * chirp
        wanted = 6.5 * _tilt_error(x, z, lift, yaw) * np.array([1.0, 1.0, 0.4]) + doublet
        rate_error = wanted - rate
        turn_integral = np.clip(turn_integral + 25.0 * TICK_S * rate_error, -30.0, 30.0)
        torque = believed.inertia_kgm2 * (13.0 * rate_error * np.array([1.0, 1.0, 0.5]) + turn_integral)
        each = np.column_stack([thrust, torque]) @ unmix.T
        motor = np.sqrt(np.clip(each / believed.rotors.max_thrust_n, 0.003, 1.0))
        if tick % EVERY == 0:
            force, mean = plant.specific_force_frd_mps2 + bias[0], 0.5 * (motor + before)
            rows.append(np.hstack([plant.pos_ned_m, plant.vel_ned_mps, q, rate, force, mean, plant.battery_v[:, None]]))
        before = motor
        plant.run(motor, 4)
    table = np.array(rows).transpose(1, 0, 2)
    return [_samples(f"flight-{i}", part, rng) for i, part in enumerate(table)]


def _reference(seconds: float) -> tuple[F64, F64, F64, F64, F64, F64]:
    """At every tick: position, velocity, acceleration (T, 3), yaw (T,), added body rates (T, 3), specific thrust (T,).

    Loops of up to 5 m/s, a climb, a fast descent to just over the ground, a low stretch and up again; then doublets
    on each axis in turn and a thrust chirp.
    """
    t = np.arange(round(seconds / TICK_S)) * TICK_S
    height = np.interp(t, [0, 2, 6, 8.5, 11.0, 12.5, 14.5, 30.0], [3.0, 3.0, 9.0, 8.0, 0.5, 0.5, 3.0, 3.0])
    start = 1.0 - np.exp(-((t / 1.5) ** 2))
    east = 2.4 * start * (np.sin(0.9 * t + 0.4) - np.sin(0.4))
    pos = np.stack(
        [3.2 * start * np.sin(1.35 * t), east, -gaussian_filter1d(height, 0.2 / TICK_S, mode="nearest")], axis=1
    )
    vel = np.gradient(pos, TICK_S, axis=0)
    phase = (t - 15.0) / 0.32
    doublets = np.zeros((len(t), 3))
    for axis, size in enumerate((1.6, 1.6, 1.0)):
        on = (phase >= 0.0) & (phase < 12.0) & (phase.astype(int) % 3 == axis)
        doublets[on, axis] = np.where(phase[on] % 1.0 < 0.5, size, -size)
    s = np.clip(t - 19.0, 0.0, 4.0)
    chirp = np.where((s > 0.0) & (s < 4.0), 3.0 * np.sin(2.0 * np.pi * (0.8 + 0.45 * s) * s), 0.0)
    yaw = np.where(t < 15.0, 0.8 * t, 12.0)
    return pos, vel, np.gradient(vel, TICK_S, axis=0), yaw, doublets, chirp


def _column(q: F64, axis: int) -> F64:
    """(N, 3) body axis x or z in the world."""
    w, x, y, z = q.T
    if axis == 0:
        return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


def _tilt_error(x_now: F64, z_now: F64, lift: F64, yaw: float) -> F64:
    """(N, 3) body rotation from these body axes towards the attitude whose thrust points along `lift` with this yaw."""
    z = -lift / np.sqrt(_dot(lift, lift))[:, None]
    c, s = np.cos(yaw), np.sin(yaw)
    y = np.stack([-s * z[:, 2], c * z[:, 2], s * z[:, 0] - c * z[:, 1]], axis=1)
    y /= np.sqrt(_dot(y, y))[:, None]
    x, y_now = _cross(y, z), _cross(z_now, x_now)
    roll, pitch = _dot(z_now, y) - _dot(y_now, z), _dot(x_now, z) - _dot(z_now, x)
    return 0.5 * np.stack([roll, pitch, _dot(y_now, x) - _dot(x_now, y)], axis=1)


def _dot(a: F64, b: F64) -> F64:
    """(N,) row by row."""
    product: F64 = np.einsum("ni,ni->n", a, b)
    return product


def _cross(a: F64, b: F64) -> F64:
    """(N, 3) row by row; numpy's own takes four times as long for so few."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]


def _sensor(truths: Sequence[Vehicle], effect: str) -> F64:
    return np.array([list(v.effects[effect].values()) if effect in v.effects else [0.0] * 3 for v in truths])


def _misalignment(truths: Sequence[Vehicle]) -> F64:
    """(N, 4) small rotation after the true attitude, roll, pitch and yaw."""
    half = 0.5 * _sensor(truths, "attitude_misalignment")
    roll, pitch, yaw = (
        np.column_stack([np.cos(half[:, i]), *(np.sin(half[:, i]) if j == i else 0 * half[:, i] for j in range(3))])
        for i in range(3)
    )
    return multiply(multiply(yaw, pitch), roll)


def _samples(name: str, table: F64, rng: np.random.Generator) -> Samples:
    def noisy(columns: F64, key: str) -> F64:
        return columns + NOISE[key] * rng.standard_normal(columns.shape)

    pos, vel, q, rate, force, motor, volts = np.split(table, [3, 6, 10, 13, 16, 20], axis=1)
    q = noisy(q, "q")
    dt = EVERY * TICK_S
    return Samples(
        name=name,
        t_s=dt * np.arange(len(table)),
        dt_s=dt,
        pos_ned_m=noisy(pos, "pos"),
        vel_ned_mps=noisy(vel, "vel"),
        q_ned_frd=q / np.linalg.norm(q, axis=1, keepdims=True),
        rate_frd_radps=noisy(rate, "rate"),
        accel_frd_mps2=noisy(force, "accel"),
        motor=motor,
        battery_v=noisy(volts, "battery")[:, 0],
        height_m=-pos[:, 2],
        valid=np.ones(len(table), dtype=bool),
        bandwidth_hz=0.5 / dt,
    )
