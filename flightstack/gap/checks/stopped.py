"""Stopped rotors: a rotor that is commanded to nothing coasts, and no first-order lag describes it; it is left out.

A driven rotor follows its command by what its motor can do, up as well as down.  Without current (or below the
controller's least command) it runs down by its own drag, more and more slowly, and has to be caught again.  On a
recorded quadrotor whose throttle is cut, lag and delay come out as 65 ms from lift and from torques alike where
the rotors are driven, and as 85 and 45 ms with the cuts among the data.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flightstack.gap.records import Finding, Samples
from flightstack.vehicle import Vehicle

STOPPED = 0.01
"""Command from which on a rotor is driven."""
_LAGS = 5.0
"""Time constants after which less than a hundredth of the stop is remembered."""
_LEAST_S = 0.25
"""Time left out after a stop, at least: a rotor that stands is caught more slowly than a turning one follows."""
_MOST = 0.5
"""Share of a flight that may be left out; a vehicle that stops its rotors all the time must be taken as it is."""
_FEWEST_S = 0.1


def leave_out(samples: Samples, vehicle: Vehicle) -> tuple[Samples, list[Finding]]:
    """The samples without those in which a rotor is stopped or just was, and a word on it where there are any."""
    stopped = samples.valid & (np.nan_to_num(samples.motor, nan=1.0).min(axis=1) < STOPPED)
    if not stopped.any():
        return samples, []
    lag_s = vehicle.effects.get("motor_lag", {}).get("time_constant_s", vehicle.rotors.time_constant_s)
    reach = max(1, round(max(_LEAST_S, _LAGS * lag_s) / samples.dt_s))
    count = np.concatenate([[0], np.cumsum(stopped)])
    at = np.arange(len(stopped)) + 1
    lately = count[at] > count[np.maximum(at - 1 - reach, 0)]
    lost, whole = int(np.sum(samples.valid & lately)), int(np.sum(samples.valid))
    text = f"rotors are stopped in {100.0 * stopped.sum() / whole:.1f} % of the time"
    if lost > _MOST * whole:
        return samples, [Finding("rotors", "warning", f"{text}: their lag is none of the first order there")]
    kept = replace(samples, valid=samples.valid & ~lately)
    if lost * samples.dt_s < _FEWEST_S:
        return kept, []
    return kept, [Finding("rotors", "ok", f"{text}; with what follows {lost * samples.dt_s:.1f} s were left out")]
