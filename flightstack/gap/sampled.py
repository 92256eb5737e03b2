"""What the sampling of the motors' commands leaves: a part of the noise floor.

A rate loop faster than the log passes its gyro's noise to the motors; the log keeps one command of several, and what
the others did shows as a disagreement that no simulator can know.  The white noise on the logged commands tells how
large they were; the simulator itself says what such noise does to forces and torques, and what commands do that act a
little beside their stamps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.compare import path_change
from flightstack.gap.decisions import TIMING_SHARE
from flightstack.gap.records import SIGNALS, Figures, Samples
from flightstack.gap.simulate import predict, timing
from flightstack.gap.track import track
from flightstack.types import F64
from flightstack.vehicle import Vehicle

_THIRD = np.sqrt(20.0)  # of the white noise in its third differences
_MAD = 0.6745
_TIMING_S = 0.0005
"""How far commands may have acted beside their stamps, beside the share of a sample (one sigma)."""
_QUIET = 0.009
"""Of full thrust: ULogs at 250 Hz have 0.008, a Crazyflie 0.001 to 0.008, MAVLink's streams of PX4 0.01 to 0.02."""
_JUMP = 1.0 / 24.0
"""Variance of a command's mean between stamps for each squared second difference: a twelfth of a jump's, over two."""


def command_noise(samples: Samples) -> F64:
    """(4,) standard deviation of the white noise on each motor's commands; robust against steps."""
    motor = samples.motor[samples.valid & np.isfinite(samples.motor).all(axis=1)]
    if len(motor) < 8:
        return np.zeros(samples.motor.shape[1])
    return np.asarray(np.median(np.abs(np.diff(motor, n=3, axis=0)), axis=0) / _MAD / _THIRD)


def loop_noise(samples: Samples) -> float:
    """Variance of the white noise on the commands, 0 where it is too small to bend what they seem to do."""
    noise = float(np.mean(command_noise(samples)))
    return noise**2 if noise > _QUIET else 0.0


def unknown_commands(samples: Samples) -> F64:
    """(N, 4) standard deviation of what each motor did round each stamp beyond what the log's commands say."""
    motor = samples.motor
    jumps = np.zeros_like(motor)
    jumps[1:-1] = np.nan_to_num(np.diff(motor, n=2, axis=0))
    return np.asarray(np.sqrt(np.maximum(command_noise(samples) ** 2, _JUMP * jumps**2)))


def open_gains(shown: F64, change: F64, rows: NDArray[np.bool_]) -> F64:
    """(3,) of each torque, how much more than half of its power (0 to 1) is commands that sampling folds in.

    `shown` is the prediction (N, 12) through the low-pass, `change` what the commands without that noise make of it.
    What a loop answers to its own noise is left even then, so that nobody knows how much of the commands acted.
    """
    power, calm = (np.mean(np.nan_to_num(x[rows, 3:6]) ** 2, axis=0) for x in (shown, shown + change))
    return np.asarray(np.clip(1.0 - 2.0 * calm / np.maximum(power, 1e-300), 0.0, 1.0))


def timing_s(period_s: float) -> float:
    """Standard deviation of when commands really acted, beside their stamps, in a log of this period."""
    return _TIMING_S + TIMING_SHARE * period_s


def sampling_floor(vehicle: Vehicle, samples: Samples, mask: NDArray[np.bool_]) -> Figures:
    """What the commands that a log doesn't hold leave of each figure."""
    spread = unknown_commands(samples)
    flight = track(samples)
    if "motor" in flight.missing:
        return Figures(0.0, 0.0, 0.0)
    noise = np.random.default_rng(0).standard_normal(samples.motor.shape) * spread
    other = replace(samples, motor=np.clip(samples.motor + noise, 0.0, 1.0))
    change = flight.lowpass(predict(vehicle, other) - predict(vehicle, samples))[:, : len(SIGNALS)]
    late = timing_s(samples.dt_s) * timing(vehicle, samples)[:, : len(SIGNALS)]
    used = mask & flight.usable
    if not used.any():
        return Figures(0.0, 0.0, 0.0)
    power = np.nan_to_num(np.mean(change[used] ** 2 + late[used] ** 2, axis=0))
    path = path_change(vehicle, samples, other, mask)
    return Figures(float(np.sqrt(power[:3].sum())), float(np.sqrt(power[3:].sum())), path)
