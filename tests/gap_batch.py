"""Many short flights at once for the gap workflow's tests: one batched plant, one vectorised controller.

Every vehicle of the batch believes the same file and hides something else.  The flight has what an identification
flight has: runs on several headings, hard turns, rate doublets, a thrust chirp, a fast descent and a low pass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle, with_effects
from gap.records import Samples
from sim.plant import BatchPlant

_G = np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
TICK_S = 0.004
EVERY = 2
NOISE = {"pos": 0.002, "vel": 0.01, "q": 0.0006, "rate": 0.002, "accel": 0.03, "battery": 0.005}


def multiply(a: F64, b: F64) -> F64:
    """Hamilton products row by row."""
    w, x, y, z = a.T
    W, X, Y, Z = b.T
    return np.stack(
        [w * W - x * X - y * Y - z * Z, w * X + x * W + y * Z - z * Y, w * Y - x * Z + y * W + z * X, w * Z + x * Y - y * X + z * W],
        axis=1,
    )  # fmt: skip


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
    plant.pos_ned_m[:] = _path(0.0)[0]
    plant.motor_u[:] = np.sqrt(believed.mass_kg * _G[2] / 4.0 / believed.rotors.max_thrust_n)
    rows = []
    integral, turn_integral = np.zeros((count, 3)), np.zeros((count, 3))
    bias = _sensor(truths, "accelerometer_bias"), _sensor(truths, "gyro_bias")
    tilt = _misalignment(truths)
    for tick in range(round(seconds / TICK_S)):
        t = tick * TICK_S
        pos, vel, acc, yaw, doublet, chirp = _path(t)
        q = multiply(plant.q_ned_frd, tilt)
        rate = plant.rate_frd_radps + bias[1]
        error = pos - plant.pos_ned_m
        integral = np.clip(integral + 1.5 * TICK_S * error, -4.0, 4.0)
        lift = acc + 4.0 * np.clip(error, -1.5, 1.5) + 3.0 * (vel - plant.vel_ned_mps) + integral - _G
        z = _column(q, 2)
        thrust = believed.mass_kg * np.maximum(-(lift * z).sum(axis=1), 2.0) + believed.mass_kg * chirp
        wanted = 9.0 * _tilt_error(q, lift, yaw) * np.array([1.0, 1.0, 0.4]) + doublet
        rate_error = wanted - rate
        turn_integral = np.clip(turn_integral + 40.0 * TICK_S * rate_error, -30.0, 30.0)
        torque = believed.inertia_kgm2 * (18.0 * rate_error * np.array([1.0, 1.0, 0.5]) + turn_integral)
        each = np.column_stack([thrust, torque]) @ unmix.T
        motor = np.sqrt(np.clip(each / believed.rotors.max_thrust_n, 0.003, 1.0))
        if tick % EVERY == 0:
            rows.append(
                np.hstack(
                    [plant.pos_ned_m, plant.vel_ned_mps, q, rate, plant.specific_force_frd_mps2 + bias[0], motor, plant.battery_v[:, None]]
                )
            )  # fmt: skip
        for _ in range(4):
            plant.step(motor)
    table = np.array(rows).transpose(1, 0, 2)
    return [_samples(f"flight-{i}", part, rng) for i, part in enumerate(table)]


def _path(t: float) -> tuple[F64, F64, F64, float, F64, float]:
    """Position, velocity and acceleration (by differences), yaw, added body rates, added specific thrust."""
    h = 0.01
    here = [_position(t + k * h) for k in (-1, 0, 1)]
    vel, acc = (here[2] - here[0]) / (2 * h), (here[2] - 2 * here[1] + here[0]) / h**2
    doublet = np.zeros(3)
    phase = (t - 15.0) / 0.32
    if 0.0 <= phase < 12.0:
        axis, step = int(phase) % 3, phase % 1.0
        doublet[axis] = (1.6 if axis < 2 else 1.0) * (1.0 if step < 0.5 else -1.0)
    chirp = 3.0 * np.sin(2 * np.pi * (0.8 + 0.45 * (t - 19.0)) * (t - 19.0)) if 19.0 <= t < 23.0 else 0.0
    return here[1], vel, acc, 0.8 * t if t < 15.0 else 12.0 + 0.2 * np.sin(t), doublet, chirp


def _position(t: float) -> F64:
    """Loops of up to 5 m/s, a climb, a fast descent to just over the ground, a low stretch and up again."""
    s = 1.0 - np.exp(-((t / 1.5) ** 2))
    height = np.interp(t, [0, 2, 6, 8.5, 11.0, 12.5, 14.5, 30.0], [3.0, 3.0, 9.0, 8.0, 0.35, 0.35, 3.0, 3.0])
    smooth = np.mean(
        [np.interp(t + d, [0, 2, 6, 8.5, 11.0, 12.5, 14.5, 30.0], [3.0, 3.0, 9.0, 8.0, 0.35, 0.35, 3.0, 3.0]) for d in np.linspace(-0.35, 0.35, 15)]
    )  # fmt: skip
    del height
    return np.array([3.2 * s * np.sin(1.35 * t), 2.4 * s * np.sin(0.9 * t + 0.4) - 2.4 * s * np.sin(0.4), -smooth])


def _column(q: F64, axis: int) -> F64:
    """(N, 3) body axis in the world."""
    w, x, y, z = q.T
    return (
        np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)
        if axis == 0
        else np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)
    )


def _tilt_error(q: F64, lift: F64, yaw: float) -> F64:
    """(N, 3) body rotation towards the attitude whose thrust points along `lift` with this yaw, small angles."""
    z = -lift / np.linalg.norm(lift, axis=1, keepdims=True)
    y = np.cross(z, [np.cos(yaw), np.sin(yaw), 0.0])
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    wanted = np.stack([np.cross(y, z), y, z], axis=2)
    x_now, z_now = _column(q, 0), _column(q, 2)
    now = np.stack([x_now, np.cross(z_now, x_now), z_now], axis=2)
    r = np.einsum("nji,njk->nik", now, wanted)
    return 0.5 * np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], axis=1)


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
