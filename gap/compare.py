"""The disagreement: one step (measured minus simulated) and over a second (simulated path against the measured one)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from flightstack.types import F64
from flightstack.vehicle import Vehicle
from gap.records import Figures, Residual, Samples
from gap.simulate import predict, rollout
from gap.track import track

HORIZON_S = 1.0
EVERY_S = 0.5


def residual(vehicle: Vehicle, samples: Samples) -> Residual:
    """Measured minus simulated, both through the common low-pass; NaN rows where the samples are not usable."""
    flight = track(samples)
    y = flight.lowpass(flight.measured - predict(vehicle, samples))
    y[~flight.usable] = np.nan
    return Residual(y, sensor_noise(samples), np.full(12, 0.5 / flight.cutoff_hz))


def sensor_noise(samples: Samples) -> F64:
    """(12,) standard deviation that the sensors' white noise leaves in each column of the residual."""
    flight = track(samples)
    dt = samples.dt_s
    impulse = np.zeros((2 * round(2.0 / flight.cutoff_hz / dt) + 1, 1))
    impulse[len(impulse) // 2] = 1.0
    shape = flight.lowpass(impulse)
    plain, slope = math.sqrt(float(np.sum(shape**2))), math.sqrt(float(np.sum(np.gradient(shape, dt, axis=0) ** 2)))

    def white(name: str, signal: F64) -> float:
        return samples.noise[name] if name in samples.noise else _white(signal)

    accel, gyro = white("accel_frd_mps2", samples.accel_frd_mps2), white("rate_frd_radps", samples.rate_frd_radps)
    velocity, attitude = white("vel_ned_mps", samples.vel_ned_mps), 2.0 * white("q_ned_frd", samples.q_ned_frd)
    kinematic = math.hypot(slope * velocity, plain * accel)
    force = slope * velocity if flight.averaged[0] else plain * accel
    turn = math.hypot(slope * attitude, plain * gyro)
    return np.repeat([force, slope * gyro, turn, kinematic], 3)


def _white(x: F64) -> float:
    """Standard deviation of white noise on a smooth signal: third differences leave little else."""
    d = np.diff(x[np.isfinite(x).all(axis=1)], n=3, axis=0)
    return float(np.sqrt(np.mean(d**2) / 20.0)) if len(d) else 0.0


def figures(vehicle: Vehicle, samples: Samples, mask: NDArray[np.bool_]) -> Figures:
    """Rms over the masked samples: one step, three axes together; position after rollouts of 1 s from every 0.5 s."""
    y = residual(vehicle, samples).y[mask]
    return Figures(_rms(y[:, 0:3]), _rms(y[:, 3:6]), _rms(rollout_error(vehicle, samples, mask)))


def rollout_starts(samples: Samples, mask: NDArray[np.bool_], horizon_s: float = HORIZON_S) -> NDArray[np.int64]:
    """Samples from which to simulate: every 0.5 s, where everything up to the horizon is masked and usable."""
    good = mask & track(samples).usable
    steps, stride = round(horizon_s / samples.dt_s), max(1, round(EVERY_S / samples.dt_s))
    at = np.arange(0, len(good) - steps, stride)
    bad = np.concatenate([[0], np.cumsum(~good)])
    return np.asarray(at[bad[at + steps + 1] == bad[at]])


def rollout_error(vehicle: Vehicle, samples: Samples, mask: NDArray[np.bool_], horizon_s: float = HORIZON_S) -> F64:
    """(S, 3) simulated minus measured position after the horizon, m, NED; empty without position or velocity."""
    flight = track(samples)
    starts = rollout_starts(samples, mask, horizon_s)
    if len(starts) == 0 or {"vel_ned_mps", "q_ned_frd"} & flight.missing:
        return np.empty((0, 3))
    flown = rollout(vehicle, samples, starts, horizon_s)
    steps = flown.pos_ned_m.shape[1] - 1
    moved = flight.path_ned_m[starts + steps] - flight.path_ned_m[starts]
    return np.asarray(flown.pos_ned_m[:, -1] - flown.pos_ned_m[:, 0] - moved)


def _rms(x: F64) -> float | None:
    """Root of the mean squared length of the rows; None where there is none."""
    rows = x[np.isfinite(x).all(axis=1)]
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1)))) if len(rows) else None
