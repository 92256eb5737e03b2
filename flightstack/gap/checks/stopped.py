"""Stopped rotors: a rotor that is commanded to nothing coasts, and no first-order lag describes it; it is left out.

A driven rotor follows its command by what its motor can do, up as well as down.  Without current (or below the
controller's least command) it runs down by its own drag, more and more slowly, and has to be caught again.  On a
recorded quadrotor whose throttle is cut, lag and delay come out as 65 ms from lift and from torques alike where
the rotors are driven, and as 85 and 45 ms with the cuts among the data.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flightstack.gap.decisions import AROUND_S, HALF, LAGS, STOPPED
from flightstack.gap.records import Finding, Samples
from flightstack.vehicle import Vehicle


def leave_out(samples: Samples, vehicle: Vehicle) -> tuple[Samples, list[Finding]]:
    """The samples without those in which a rotor is stopped or just was, and a word on it where there are any."""
    stopped = samples.valid & (np.nan_to_num(samples.motor, nan=1.0).min(axis=1) < STOPPED)
    if not stopped.any():
        return samples, []
    lag_s = vehicle.effects.get("motor_lag", {}).get("time_constant_s", vehicle.rotors.time_constant_s)
    reach = max(1, round(max(AROUND_S, LAGS * lag_s) / samples.dt_s))
    count = np.concatenate([[0], np.cumsum(stopped)])
    at = np.arange(len(stopped)) + 1
    lately = count[at] > count[np.maximum(at - 1 - reach, 0)]
    lost, whole = int(np.sum(samples.valid & lately)), int(np.sum(samples.valid))
    text = f"rotors are stopped in {100.0 * stopped.sum() / whole:.1f} % of the time"
    if lost > HALF * whole:
        return samples, [Finding("rotors", "warning", f"{text}: their lag is none of the first order there")]
    kept = replace(samples, valid=samples.valid & ~lately)
    return kept, [Finding("rotors", "ok", f"{text}; with what follows {lost * samples.dt_s:.1f} s were left out")]
