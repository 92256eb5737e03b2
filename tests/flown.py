"""A flight in closed form for the log tests: smooth path, attitude along its thrust, rates and motors that fit.

No simulator is involved: sums of sines give position and all its derivatives; the specific force of a vehicle without
drag is along its own z axis; body rates come from a fine grid of attitudes; motors from inverse mixing, without lag.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flightstack.gap.records import Flight, Signal
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle
from flightstack_logs.turn import conjugate, multiply, rotate_inverse

HEADER = (
    "time_s,pos_n_m,pos_e_m,pos_d_m,vel_n_mps,vel_e_mps,vel_d_mps,q_w,q_x,q_y,q_z,rate_x_radps,rate_y_radps,"
    "rate_z_radps,accel_x_mps2,accel_y_mps2,accel_z_mps2,motor_1,motor_2,motor_3,motor_4,battery_v"
)
NOISE = {"pos_ned_m": 0.002, "vel_ned_mps": 0.01, "q_ned_frd": 5e-4, "rate_frd_radps": 0.01, "accel_frd_mps2": 0.05}
_LINES = ((0.9, 0.11), (0.5, 0.23), (0.2, 0.47), (0.06, 0.81), (0.012, 1.43))
"""Size (m) and frequency (Hz) of each sine."""


@dataclass(frozen=True, slots=True, eq=False)
class Path3:
    """Position and derivatives at times."""

    pos: F64
    vel: F64
    acc: F64


def path_at(t_s: F64, seed: int) -> Path3:
    """(N, 3) each: north, east and down, a metre round 2 m above ground."""
    rng = np.random.default_rng(seed)
    parts = [np.zeros((len(t_s), 3)) for _ in range(3)]
    for axis in range(3):
        for size, hz in _LINES:
            w = 2.0 * np.pi * hz * rng.uniform(0.8, 1.2)
            phase, a = rng.uniform(0.0, 6.28), size * (0.4 if axis == 2 else 1.0)
            parts[0][:, axis] += a * np.sin(w * t_s + phase)
            parts[1][:, axis] += a * w * np.cos(w * t_s + phase)
            parts[2][:, axis] -= a * w * w * np.sin(w * t_s + phase)
    parts[0][:, 2] -= 3.0
    return Path3(*parts)


def attitude_of(acc: F64, yaw: F64) -> tuple[F64, F64]:
    """(N, 4) attitude whose -z carries the thrust, and (N,) the thrust per mass."""
    force = acc - np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
    size = np.linalg.norm(force, axis=1)
    down = -force / size[:, None]
    ahead = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=1)
    right = np.cross(down, ahead)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    front = np.cross(right, down)
    r = np.stack([front, right, down], axis=2)
    w = 0.5 * np.sqrt(np.maximum(1.0 + r[:, 0, 0] + r[:, 1, 1] + r[:, 2, 2], 1e-12))
    xyz = np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], axis=1)
    return np.concatenate([w[:, None], xyz / (4.0 * w[:, None])], axis=1), size


def flown(
    vehicle: Vehicle,
    *,
    seconds: float = 40.0,
    hz: float = 125.0,
    seed: int = 0,
    noise: float = 1.0,
    drag_ps: float = 0.0,
) -> Flight:
    """The flight as a log would have it, white noise of NOISE times `noise` on it, all stamps right.

    `drag_ps`: force per mass against the velocity, 1/s, the same in all directions.
    """
    rng = np.random.default_rng(seed + 1000)
    fine = 1e-3
    t = np.arange(-0.02, seconds + 0.02, fine)
    path = path_at(t, seed)
    q, thrust = attitude_of(path.acc + drag_ps * path.vel, 0.4 * np.sin(0.5 * t))
    turn = multiply(conjugate(q[:-2]), q[2:])
    rate = np.concatenate([[turn[0, 1:]], turn[:, 1:], [turn[-1, 1:]]]) / fine
    turning = np.gradient(rate, fine, axis=0)
    rotors = vehicle.rotors
    mixing = np.stack([np.ones(4), -rotors.position_m[:, 1], rotors.position_m[:, 0], rotors.torque_ratio_m])
    torque = turning * vehicle.inertia_kgm2 + np.cross(rate, rate * vehicle.inertia_kgm2)
    each = np.linalg.solve(mixing, np.column_stack([thrust * vehicle.mass_kg, torque]).T).T / rotors.max_thrust_n
    f = rotors.thrust_model_factor
    each = np.maximum(each, 0.0)
    motor = each if f == 0.0 else (np.sqrt((1.0 - f) ** 2 + 4.0 * f * each) - (1.0 - f)) / (2.0 * f)
    rows = slice(20, len(t) - 20, round(1.0 / hz / fine))
    force = np.zeros((len(t), 3))
    force[:, 2] = -thrust
    force -= drag_ps * rotate_inverse(q, path.vel)
    exact = {"pos_ned_m": path.pos, "vel_ned_mps": path.vel, "q_ned_frd": q}
    exact |= {"rate_frd_radps": rate, "accel_frd_mps2": force}
    signals = {
        name: Signal(t[rows], value[rows] + noise * NOISE[name] * rng.normal(size=value[rows].shape), name)
        for name, value in exact.items()
    }
    signals["motor"] = Signal(t[rows], np.clip(motor[rows], 0.0, 1.0), "motor")
    signals["battery_v"] = Signal(t[rows], np.linspace(16.6, 15.9, len(t[rows])), "battery_v")
    return Flight("flown", "csv", signals)


def with_signal(flight: Flight, name: str, value: F64 | None = None, *, t_s: F64 | None = None) -> Flight:
    """The flight with one signal's values or stamps replaced."""
    old = flight.signals[name]
    new = Signal(old.t_s if t_s is None else t_s, old.value if value is None else value, old.source)
    return replace(flight, signals={**flight.signals, name: new})


def late(flight: Flight, name: str, by_s: float) -> Flight:
    """The flight with one topic's stamps late."""
    return with_signal(flight, name, t_s=flight.signals[name].t_s + by_s)


def write_csv(path: Path, flight: Flight) -> Path:
    """The flight as a CSV of CONTRACT's header (all its topics must share their stamps)."""
    names = ("pos_ned_m", "vel_ned_mps", "q_ned_frd", "rate_frd_radps", "accel_frd_mps2", "motor", "battery_v")
    t_s = flight.signals["motor"].t_s
    columns = [t_s[:, None], *(flight.signals[name].value.reshape(len(t_s), -1) for name in names)]
    np.savetxt(path, np.concatenate(columns, axis=1), delimiter=",", header=HEADER, comments="", fmt="%.9g")
    return path
