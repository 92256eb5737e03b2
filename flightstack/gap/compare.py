"""The disagreement: one step (measured minus simulated) and over a second (simulated path against the measured one)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from flightstack.effects import accelerometer_bias, gyro_bias
from flightstack.gap.filters import spectrum, white_noise
from flightstack.gap.records import Figures, Residual, Samples
from flightstack.gap.remembered import Remembered
from flightstack.gap.rollouts import rollout
from flightstack.gap.run import ModelEvaluation, params_row, true_attitude
from flightstack.gap.simulate import predict, prediction_error
from flightstack.gap.sources import FREED
from flightstack.gap.track import COLUMNS, GRAVITY_NED_MPS2, derivative, track
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_logs.turn import multiply, rotate, turned

HORIZON_S = 1.0
EVERY_S = 0.5
_SEGMENT_S = 2.0
_NOISE_FROM = 0.6
_FOLDED = 1.5
"""Times what the top of the band shows, above which the differences of samples are no white noise: a log of white noise
has 0.9 to 1.1."""


def residual(vehicle: Vehicle, samples: Samples) -> Residual:
    """Measured minus simulated, both through the common low-pass; NaN rows where the samples are not usable.

    The kinematic columns hold no physics, so their own scatter is their noise.
    """
    return _RESIDUALS(lambda: _residual(vehicle, samples), vehicle, samples)


_RESIDUALS = Remembered[Residual](6)
_ROLLOUT_ERRORS = Remembered[F64](6)


def _residual(vehicle: Vehicle, samples: Samples) -> Residual:
    flight = track(samples)
    y, raw = prediction_error(vehicle, samples)
    y[~flight.usable] = np.nan
    noise = _noise_of(raw, samples, flight.usable)
    if flight.usable.any():
        noise[6:] = np.std(y[flight.usable, 6:], axis=0)
    for array in (y, noise):
        array.setflags(write=False)
    return Residual(y, noise)


def sensor_noise(samples: Samples) -> F64:
    """(12,) standard deviation that the sensors' white noise leaves in each column of the residual."""
    flight = track(samples)
    dt = samples.dt_s
    impulse = np.zeros((2 * round(2.0 / flight.cutoff_hz / dt) + 1, 1))
    impulse[len(impulse) // 2] = 1.0
    shape = flight.lowpass(impulse)
    plain, slope = math.sqrt(float(np.sum(shape**2))), math.sqrt(float(np.sum(derivative(shape, dt) ** 2)))
    accel, gyro, velocity = (_white(samples, name) for name in ("accel_frd_mps2", "rate_frd_radps", "vel_ned_mps"))
    turning = 2.0 * float(np.max(_white(samples, "q_ned_frd")))
    # The accelerometer carries the smoothed velocity at these frequencies; without it there is the velocity alone.
    force = slope * velocity if "accel_frd_mps2" in flight.missing else plain * accel
    angular = slope * (turning / dt / math.sqrt(2.0) if "rate_frd_radps" in flight.missing else gyro)
    turn = np.hypot(slope * turning, plain * gyro)
    kinematic = np.hypot(slope * np.mean(velocity), plain * accel)
    noise = np.concatenate([force, angular * np.ones(3), turn, kinematic])
    noise[flight.blind] = np.nan
    return noise


def expected_noise(vehicle: Vehicle, samples: Samples, mask: NDArray[np.bool_]) -> F64:
    """(12,) as `sensor_noise`, but not below what the top of the looked-at band shows.

    An autopilot filters what it logs, and then differences between samples say too little of the noise.  What is left
    of the residual from 0.6 of the cutoff on is taken for noise: of the same power at all lower frequencies for a
    force, of the power of a derivative for an angular acceleration (and for a force out of the velocity, unless a
    filter made that of its accelerometer).  Where that band shows clearly less than the samples' differences say, those
    hold vibration above the cutoff: the band counts.
    """
    return _noise_of(prediction_error(vehicle, samples)[1], samples, mask)


def _noise_of(raw: F64, samples: Samples, mask: NDArray[np.bool_]) -> F64:
    """`expected_noise` of a residual (N, 6) before the low-pass."""
    flight = track(samples)
    noise = sensor_noise(samples)
    y = raw[mask & flight.usable]
    per_segment = round(_SEGMENT_S / samples.dt_s)
    if len(y) < 2 * per_segment:
        return noise
    clean = np.nan_to_num(y)
    hz, power = spectrum(clean, clean, samples.dt_s, per_segment)
    gain = 1.0 / (1.0 + (hz / flight.cutoff_hz) ** 4) ** 2
    band = (hz >= _NOISE_FROM * flight.cutoff_hz) & (hz <= flight.cutoff_hz)
    for column in range(6):
        integrated = column < 3 and FREED in samples.derived
        shape = np.maximum(hz, hz[1]) ** 2 if flight.averaged[column] and not integrated else np.ones_like(hz)
        level = float(np.median(power[band, column] / shape[band]))
        shown = math.sqrt(level * float(np.trapezoid(shape * gain, hz)))
        noise[column] = shown if shown < noise[column] / _FOLDED else max(noise[column], shown)
    return noise


def _white(samples: Samples, name: str) -> F64:
    """(3,) standard deviation of a signal's white noise: what the data check found, else of its third differences."""
    keys = [f"{name}_{axis}" for axis in "xyz"]
    if all(key in samples.noise for key in keys):
        return np.array([samples.noise[key] for key in keys])
    if name in samples.noise:
        return np.full(3, samples.noise[name])
    return np.nan_to_num(white_noise(getattr(samples, name)[:, -3:]))


def figures(vehicle: Vehicle, samples: Samples, mask: NDArray[np.bool_]) -> Figures:
    """Rms over the masked samples: one step, all measured axes together; position after 1 s, from every 0.5 s."""
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
    """(S, 3) simulated minus measured position after the horizon, m, NED; empty without position or velocity.

    Not to be written to.
    """
    how = params_row(vehicle, samples.dt_s).tobytes() + np.float64(horizon_s).tobytes()
    return _ROLLOUT_ERRORS(lambda: _rollout_error(vehicle, samples, mask, horizon_s), samples, mask, depends=how)


def _rollout_error(vehicle: Vehicle, samples: Samples, mask: NDArray[np.bool_], horizon_s: float) -> F64:
    starts = rollout_starts(samples, mask, horizon_s)
    if not _can_roll(samples, starts):
        return np.empty((0, 3))
    flown = rollout(vehicle, samples, starts, horizon_s)
    steps = flown.pos_ned_m.shape[1] - 1
    return np.asarray(flown.pos_ned_m[:, -1] - flown.pos_ned_m[:, 0] - _moved(samples, starts, steps))


def noise_floor(vehicle: Vehicle, samples: Samples, mask: NDArray[np.bool_]) -> Figures:
    """What the figures of a simulator without any error would be: the sensors' noise alone.

    One step: the sensors' noise through the low-pass (`expected_noise`), and what an error of the smoothed velocity
    does through the vehicle's drag.  Rollouts: what the sensors' white noise at start and end does to a simulated path,
    or, with an accelerometer and where that is more, what is left of the path with the specific force and the rates
    that were measured in place of the simulated ones (less the vehicle's sensor biases), whatever its colour.
    """
    noise = np.hypot(expected_noise(vehicle, samples, mask), velocity_noise(vehicle, samples))
    return Figures(_rms(noise[None, 0:3]), _rms(noise[None, 3:6]), _path_noise(vehicle, samples, mask))


def _path_noise(vehicle: Vehicle, samples: Samples, mask: NDArray[np.bool_]) -> float | None:
    errors = [path_change(vehicle, samples, _noisier(samples), mask)]
    if "accel_frd_mps2" not in track(samples).missing:
        errors.append(_rms(strapdown_error(vehicle, samples, mask)))
    return max((e for e in errors if e is not None), default=None)


def path_change(vehicle: Vehicle, samples: Samples, other: Samples, mask: NDArray[np.bool_]) -> float | None:
    """Rms of how far `rollout_error` of the same flight measured otherwise is from its own; None without rollouts."""
    errors = [rollout_error(vehicle, each, mask) for each in (samples, other)]
    return _rms(errors[1] - errors[0])


def _noisier(samples: Samples) -> Samples:
    """The samples with as much white noise again on all that their sensors measure of the state."""
    rng = np.random.default_rng(0)
    names = {"pos_ned_m", "vel_ned_mps", "rate_frd_radps"} - set(samples.derived)
    noisy = {
        name: getattr(samples, name) + _white(samples, name) * rng.standard_normal((len(samples.t_s), 3))
        for name in sorted(names)
    }
    half = float(np.max(_white(samples, "q_ned_frd"))) * rng.standard_normal((len(samples.t_s), 3))
    q = multiply(samples.q_ned_frd, np.hstack([np.ones((len(half), 1)), half]))
    return replace(samples, q_ned_frd=q / np.linalg.norm(q, axis=1, keepdims=True), **noisy)


def velocity_noise(vehicle: Vehicle, samples: Samples) -> F64:
    """(12,) rms that the smoothed velocity's error leaves in what the simulator predicts."""
    flight = track(samples)
    total = np.zeros(COLUMNS)
    if not flight.vel_std_mps.any():
        return total
    p = params_row(vehicle, flight.step_s)
    base = predict(vehicle, samples)
    for axis in range(3):
        moved = flight.vel_ned_mps + flight.vel_std_mps[axis] * np.eye(3)[axis]
        change = ModelEvaluation(p, replace(flight, vel_ned_mps=moved)).shown(p) - base
        total += np.mean(change**2, axis=0)
    return np.sqrt(total)


def strapdown_error(vehicle: Vehicle, samples: Samples, mask: NDArray[np.bool_], horizon_s: float = HORIZON_S) -> F64:
    """(S, 3) error of the position after the horizon when measured specific force and rates are integrated, m, NED."""
    starts = rollout_starts(samples, mask, horizon_s)
    if not _can_roll(samples, starts):
        return np.empty((0, 3))
    flight, dt = track(samples), samples.dt_s
    p = params_row(vehicle, flight.step_s)
    rate = flight.rate_frd_radps - gyro_bias.bias(p)
    # A derived specific force is turned by the measured attitude as it is; an accelerometer's has its bias.
    derived = "accel_frd_mps2" in flight.missing
    force = flight.measured[:, 0:3] - (0.0 if derived else accelerometer_bias.bias(p))
    start = flight.q_ned_frd if derived else true_attitude(p, flight)
    q, vel = start[starts], flight.vel_ned_mps[starts]
    way = np.zeros_like(vel)
    steps = round(horizon_s / dt)
    for k in range(steps):
        now, then = starts + k, starts + k + 1
        after = multiply(q, turned(0.5 * dt * (rate[now] + rate[then])))
        acc = 0.5 * (rotate(q, force[now]) + rotate(after, force[then])) + GRAVITY_NED_MPS2
        way += dt * vel + 0.5 * dt * dt * acc
        vel, q = vel + dt * acc, after
    return np.asarray(way - _moved(samples, starts, steps))


def _can_roll(samples: Samples, starts: NDArray[np.int64]) -> bool:
    return len(starts) > 0 and not {"vel_ned_mps", "q_ned_frd", "motor"} & track(samples).missing


def _moved(samples: Samples, starts: NDArray[np.int64], steps: int) -> F64:
    path = track(samples).path_ned_m
    return np.asarray(path[starts + steps] - path[starts])


def _rms(x: F64) -> float | None:
    """Root of the mean squared length of the rows, of the columns that are measured; None where there is none."""
    x = x[:, np.isfinite(x).any(axis=0)] if x.size else x
    rows = x[np.isfinite(x).all(axis=1)]
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1)))) if rows.size else None
