"""Flights for the gap workflow's tests: the native plant under PX4-like rate and attitude loops, sampled by sensors.

The autopilot believes the vehicle file without the effects that the truth has.  `fly` gives what happened and what
was measured; `as_samples` the same as the workflow's own records, on a uniform grid.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flightstack.autopilot import autopilot_of, hover_command
from flightstack.autopilot_params import AUTOPILOT_PARAMS
from flightstack.effects.row import S_POS, S_RATE
from flightstack.frames import quat_from_euler
from flightstack.gap.records import Samples
from flightstack.model import thrust_to_norm
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle, parse_vehicle, with_effects
from flightstack_sim.autopilot.attitude_control import AttitudeControl
from flightstack_sim.autopilot.params import Params
from flightstack_sim.autopilot.rate_control import RateControl
from flightstack_sim.fused import FusedRun
from flightstack_sim.grade import load_grade
from flightstack_sim.plant import NativePlant
from flightstack_sim.sensors import Sensors

VEHICLES = Path(__file__).resolve().parent.parent / "flightstack/data/vehicles"
Reference = Callable[[float], tuple[F64, F64, F64, float]]
"""Time -> position (NED), velocity, acceleration, yaw."""


def quad() -> Vehicle:
    """The default vehicle."""
    return parse_vehicle((VEHICLES / "quad-x.toml").read_text("utf-8"), "quad-x.toml")


def hidden(believed: Vehicle, effects: dict[str, dict[str, float]]) -> Vehicle:
    """What really flies."""
    return with_effects(believed, effects, source="hidden")


def wander(speed: float = 3.0, height: float = 8.0, seed: int = 0) -> Reference:
    """A smooth path of incommensurate sines that goes through all headings at up to about `speed`."""
    rng = np.random.default_rng(seed)
    omega = np.array([[0.5, 0.93], [0.61, 1.07], [0.43, 1.29]])
    amplitude = np.array([[0.8, 0.3], [0.7, 0.3], [0.25, 0.12]]) * speed / omega
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 2))
    axes = [
        list(zip(*rows, strict=True)) for rows in zip(omega.tolist(), amplitude.tolist(), phase.tolist(), strict=True)
    ]
    at_rest = (0.0, 0.0, -height)

    def at(t: float) -> tuple[F64, F64, F64, float]:
        ease = 1.0 - math.exp(-t / 2.0)
        pos, vel, acc = np.empty(3), np.empty(3), np.empty(3)
        for axis, waves in enumerate(axes):
            place = speed = turn = 0.0
            for w, size, p in waves:  # in plain floats: a tenth of what numpy takes for so few
                sine = math.sin(w * t + p)
                place += size * (sine - math.sin(p))
                speed += size * w * math.cos(w * t + p)
                turn -= size * w**2 * sine
            pos[axis], vel[axis], acc[axis] = place * ease + at_rest[axis], speed * ease, turn * ease
        return pos, vel, acc, 1.5 * math.sin(0.35 * t) + 0.25 * t

    return at


def hover(height: float = 5.0) -> Reference:
    """Standing still, facing north."""
    zero = np.zeros(3)
    return lambda _: (np.array([0.0, 0.0, -height]), zero, zero, 0.0)


@dataclass(frozen=True)
class Flown:
    """One flight on a uniform grid: measured columns and, beside them, the truth."""

    t_s: F64
    dt_s: float
    pos: F64
    vel: F64
    q: F64
    rate: F64
    accel: F64
    motor: F64
    battery_v: F64
    true_pos: F64
    true_vel: F64
    true_q: F64
    true_rate: F64
    true_u: F64
    true_force: F64
    true_angular: F64


def fly(
    truth: Vehicle,
    believed: Vehicle,
    reference: Reference,
    *,
    seconds: float = 30.0,
    seed: int = 0,
    grade: str = "mocap",
    every_ms: int = 8,
    dither: float = 0.15,
) -> Flown:
    """Closed loop at 250 Hz over rates at 1 kHz, from the reference's own start in the air; logged every `every_ms`.

    `dither`: amplitude (rad) of pseudo-random roll, pitch and yaw doublets (0.4 s) on the attitude wanted: excitation.
    """
    rng = np.random.default_rng([seed, 77])
    plant = NativePlant(truth, seed=seed, ground=True)
    sensors = Sensors(load_grade(grade), seed=seed + 1)
    params = Params()
    for key, value in autopilot_of(believed).items():
        params.set(AUTOPILOT_PARAMS[key].name, value)
    rates, attitude = RateControl(believed, params), AttitudeControl(params)
    loop = FusedRun(plant, rates, sensors)
    plant.pos_ned_m[:] = reference(0.0)[0]
    plant.motor_u[:] = hover_command(believed)
    integral, most_n = [0.0, 0.0, 0.0], believed.max_total_thrust_n
    rows, commands = [], []
    signs = np.zeros(3)
    for tick in range(round(seconds * 250)):
        t = tick * 0.004
        pos, vel, acc, yaw = reference(t)
        if tick == 0:
            state = np.concatenate([plant.pos_ned_m, plant.vel_ned_mps, plant.q_ned_frd])
        else:
            state = sensors.state
        lift = []
        for axis in range(3):
            error = float(pos[axis] - state[axis])
            integral[axis] = _clip(integral[axis] + 0.004 * 0.8 * error, 4.0)
            climb = float(vel[axis] - state[3 + axis])
            lift.append(float(acc[axis]) + _clip(4.0 * error, 6.0) + 2.8 * climb + integral[axis])
        lift = [_clip(lift[0], 8.0), _clip(lift[1], 8.0), min(lift[2] - STANDARD_GRAVITY_MPS2, -2.0)]
        norm = thrust_to_norm(believed.mass_kg * math.hypot(*lift), most_n, believed.rotors.thrust_model_factor)
        if tick % 100 == 0:
            signs = rng.choice([-1.0, 0.0, 1.0], 3)
        twist = dither * math.sin(2.0 * math.pi * (tick % 100) / 100.0) * signs
        attitude.step(state[6:10], _attitude(lift, yaw, twist), 0.0)
        p, q, r = attitude.rate_setpoint_frd_radps.tolist()
        rates.set_target((p, q, r), norm, armed=True, hold_integral=False)
        for _ in range(4):
            loop.run(1)
            commands.append(rates.motor_command.copy())
        if (tick * 4 + 4) % every_ms == 0:
            rows.append(
                np.concatenate(
                    [
                        sensors.state[:10],
                        sensors.mean_imu,
                        [plant.battery_v],
                        plant.state_row[S_POS : S_RATE + 3],
                        plant.motor_u,
                        plant.specific_force_frd_mps2,
                        plant.angular_acceleration_frd_radps2,
                    ]
                )
            )
    table = np.array(rows)
    cuts = np.cumsum([3, 3, 4, 3, 3, 1, 3, 3, 4, 3, 4, 3])
    parts = np.split(table, cuts, axis=1)
    parts[5] = parts[5][:, 0]
    dt = 0.001 * every_ms
    parts.insert(5, _means(np.array(commands), every_ms))
    return Flown(dt * (1.0 + np.arange(len(table))), dt, *parts)


def _means(commands: F64, every_ms: int) -> F64:
    """What each sample stands for: the commands' mean over the log's period round it."""
    total = np.vstack([np.zeros(4), np.cumsum(commands, axis=0)])
    at = np.arange(every_ms, len(commands) + 1, every_ms)
    low, high = at - every_ms // 2, np.minimum(at + every_ms // 2, len(commands))
    return (total[high] - total[low]) / (high - low)[:, None]


def _clip(value: float, most: float) -> float:
    return max(-most, min(most, value))


def _attitude(lift: Sequence[float], yaw: float, twist: F64) -> F64:
    """Attitude whose thrust points along `lift` with this yaw, turned by small roll, pitch and yaw."""
    long = math.hypot(*lift)
    north, east, down = (-part / long for part in lift)
    c, s = math.cos(yaw), math.sin(yaw)
    ahead, right = north * c + east * s, east * c - north * s
    roll, pitch = math.asin(max(-1.0, min(1.0, -right))), math.atan2(ahead, down)
    return quat_from_euler(roll + twist[0], pitch + twist[1], yaw + twist[2])


def as_samples(flown: Flown, name: str = "flight", *, exact: bool = False) -> Samples:
    """The workflow's records of it; `exact`: the truth in place of every measurement."""
    height = -(flown.true_pos if exact else flown.pos)[:, 2]
    return Samples(
        name=name,
        t_s=flown.t_s,
        dt_s=flown.dt_s,
        pos_ned_m=flown.true_pos if exact else flown.pos,
        vel_ned_mps=flown.true_vel if exact else flown.vel,
        q_ned_frd=flown.true_q if exact else flown.q,
        rate_frd_radps=flown.true_rate if exact else flown.rate,
        accel_frd_mps2=flown.true_force if exact else flown.accel,
        motor=flown.motor,
        battery_v=flown.battery_v,
        height_m=height,
        valid=np.ones(len(flown.t_s), dtype=bool),
        bandwidth_hz=0.5 / flown.dt_s,
    )
