"""Motor commands without the noise that sampling folds into them.

A rate loop at 1 kHz passes its gyro's noise to the motors; a log that keeps every fourth or tenth command folds that
noise into the band that is looked at, as if the rotors had done what they never did.  Least squares on such inputs
finds everything too small (errors in variables).  If a share of the noise floor is folded in, the expectation of what
the rotors did given the log is the command less that share of a Wiener filter's correction, and a regression on
expectations is not biased (Berkson, J. Am. Stat. Assoc. 1950).  The share is fitted beside the effects.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flightstack.gap.filters import spectrum as density
from flightstack.gap.naming.whitening import Mask
from flightstack.gap.records import Samples
from flightstack.types import F64
from flightstack.vehicle import Vehicle

_SEGMENT_S = 4.0
_FLOOR_FROM = 0.6
"""Share of the Nyquist frequency above which a logged command is taken for noise."""


def with_smooth_commands(samples: Samples, vehicle: Vehicle) -> Samples:
    """The same flight with its commands filtered, collective, roll, pitch and yaw each by its own signal to noise."""
    finite: Mask = np.asarray(np.isfinite(samples.motor).all(axis=1))
    if finite.sum() < 2 * _SEGMENT_S / samples.dt_s:
        return samples
    at = np.arange(len(finite))
    motor = np.stack([np.interp(at, at[finite], column[finite]) for column in samples.motor.T], axis=1)
    modes = _modes(vehicle)
    mixed = motor @ modes.T
    chosen = samples.valid & finite
    smooth = np.stack([_wiener(column, chosen, samples.dt_s) for column in mixed.T], axis=1)
    out = np.clip(smooth @ np.linalg.inv(modes).T, 0.0, 1.0)
    out[~finite] = np.nan
    return replace(samples, motor=out)


def with_sharp_commands(samples: Samples) -> Samples:
    """The same flight with its commands curved between their stamps as a faster loop's are, not straight.

    A straight line between samples T apart passes the share 1 - (omega T)^2 / 12 of a wave; taking a twelfth of the
    second difference away gives it back.
    """
    motor = samples.motor.copy()
    motor[1:-1] -= np.diff(samples.motor, n=2, axis=0) / 12.0
    return replace(samples, motor=np.clip(motor, 0.0, 1.0))


def _modes(vehicle: Vehicle) -> F64:
    """(4, 4) collective, roll, pitch and yaw from the motors, of unit length; the motors themselves if that fails."""
    x, y = vehicle.rotors.position_m[:, 0], vehicle.rotors.position_m[:, 1]
    modes = np.stack([np.ones(4), -np.sign(y), np.sign(x), np.sign(vehicle.rotors.torque_ratio_m)]) / 2.0
    return modes if abs(np.linalg.det(modes)) > 0.5 else np.eye(4)


def _wiener(u: F64, chosen: Mask, dt_s: float) -> F64:
    """Expectation of a noisy input (N,): at each frequency the share of its power that stands above the floor."""
    segment = round(_SEGMENT_S / dt_s)
    within = np.where(chosen, u, u[chosen].mean() if chosen.any() else u.mean())
    frequency, power = density(within, within, dt_s, min(segment, len(u)), linear=True)
    floor = float(np.median(power[frequency >= _FLOOR_FROM * 0.5 / dt_s]))
    gain = np.clip(1.0 - floor / np.maximum(power, 1e-300), 0.0, 1.0)
    gain[:2] = 1.0
    pad = segment
    padded = np.concatenate([2.0 * u[0] - u[pad:0:-1], u, 2.0 * u[-1] - u[-2 : -pad - 2 : -1]])
    spectrum = np.fft.rfft(padded)
    shape = np.interp(np.fft.rfftfreq(len(padded), dt_s), frequency, gain)
    return np.fft.irfft(spectrum * shape, len(padded))[pad : pad + len(u)]
