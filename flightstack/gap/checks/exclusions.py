"""What is left out of a flight: ground contact and stopped rotors.

What the ground does to a vehicle that touches it is no gap of its model.  A motion capture's origin of the body may lie
above the feet: where the vehicle stands before and after its flight, the log itself shows how high.  An estimator's
height may be off by half a metre: that the ground carries, the thrust shows, which falls while the same force is felt.

A driven rotor follows its command by what its motor can do, up as well as down.  Without current (or below the
controller's least command) it runs down by its own drag, more and more slowly, and has to be caught again: no lag of
first order describes it.  On a recorded quadrotor whose throttle is cut, lag and delay come out as 65 ms from lift and
from torques alike where the rotors are driven, and as 85 and 45 ms with the cuts among the data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.checks.flying import rotor_thrust
from flightstack.gap.decisions import (
    AROUND_S,
    CLEAR_SHARE,
    HALF,
    LAGS,
    LEAST_THRUST,
    SPIKE_SPREADS,
    STOPPED,
    TOUCHING_M,
)
from flightstack.gap.records import Finding, Samples, Signal
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle

_STANDING_S = 0.5
_MAD = 0.6745


def standing_m(signals: Mapping[str, Signal], vehicle: Vehicle, span: tuple[float, float], ground_d_m: float) -> float:
    """Height of the body's origin over ground while the vehicle stands on it, rotors idle, before or after its flight.

    0 where the log doesn't show it, or shows more than the vehicle's own width: that is a table, or a hand.
    """
    if not {"pos_ned_m", "motor"} <= signals.keys():
        return 0.0
    position, motor = signals["pos_ned_m"], signals["motor"]
    commands = np.stack([np.interp(position.t_s, motor.t_s, column) for column in motor.value.T], axis=1)
    idle = rotor_thrust(vehicle, commands).sum(axis=1) < LEAST_THRUST * vehicle.weight_n
    width = 2.0 * float(np.max(np.linalg.norm(vehicle.rotors.position_m[:, :2], axis=1)) + vehicle.rotors.radius_m)
    lowest = 0.0
    for away in (position.t_s < span[0], position.t_s > span[1]):
        stands = idle & away
        if stands.any() and np.ptp(position.t_s[stands]) > _STANDING_S:
            height = ground_d_m - float(np.median(position.value[stands, 2]))
            if 0.0 < height < width:
                lowest = min(lowest, height) if lowest else height
    return lowest


def exclude_ground_contact(samples: Samples, vehicle: Vehicle, stands_m: float = 0.0) -> tuple[Samples, list[Finding]]:
    """The samples without those in which a rotor is at the ground, and a word on it where there are any.

    `stands_m`: of `standing_m`.
    """
    x, y = vehicle.rotors.position_m[:, 0], vehicle.rotors.position_m[:, 1]
    w, i, j, k = samples.q_ned_frd.T
    down_x, down_y = 2.0 * (i * k - w * j), 2.0 * (j * k + w * i)
    lowest = samples.height_m - np.max(np.outer(down_x, x) + np.outer(down_y, y), axis=1)
    touching = samples.valid & ((lowest < stands_m + TOUCHING_M) | _carried(samples, vehicle))
    if not touching.any():
        return samples, []
    reach = max(1, round(AROUND_S / samples.dt_s))
    near = np.convolve(touching, np.ones(2 * reach + 1), mode="same") > 0.5
    seconds = float(np.sum(samples.valid & near)) * samples.dt_s
    kept = replace(samples, valid=samples.valid & ~near)
    return kept, [Finding("ground", "ok", f"{seconds:.1f} s at the ground were left out")]


def _carried(samples: Samples, vehicle: Vehicle) -> NDArray[np.bool_]:
    """(N,) the end of the flight, from an impact on or where more is felt for the thrust than before: by a third.

    Means over half a second tell the latter, which motors at 10 Hz have, too.
    """
    out = np.zeros(len(samples.t_s), np.bool_)
    thrust, felt = rotor_thrust(vehicle, samples.motor).sum(axis=1), -samples.accel_frd_mps2[:, 2]
    rows = np.flatnonzero(samples.valid & np.isfinite(thrust) & np.isfinite(felt))
    window = round(_STANDING_S / samples.dt_s)
    if len(rows) < 4 * window or "accel_frd_mps2" in samples.derived:
        return out
    out[rows[_impact(thrust[rows], felt[rows], 4 * window, round(AROUND_S / samples.dt_s)) :]] = True
    thrust, felt = (np.convolve(each[rows], np.ones(window) / window, mode="same") for each in (thrust, felt))
    more = CLEAR_SHARE * felt > np.median(felt / np.maximum(thrust, 1e-6)) * thrust
    free = np.flatnonzero(~more[: len(rows) - window // 2])  # beyond, the mean is not whole
    if len(free) and len(rows) - free[-1] > window:
        out[rows[free[-1] + 1] :] = True
    return out


def _impact(thrust: F64, felt: F64, last: int, reach: int) -> int:
    """Index of the first of the last samples at which feet meet the ground; their number without such a sample.

    An autopilot says so half a second later, whatever height it believes.  More is felt then than the rotors gave at
    any of the samples that they may still follow (`reach`), by half a weight and by far more than noise.
    """
    ratio = float(np.median(felt / np.maximum(thrust, 1e-6)))
    off = felt - ratio * thrust
    spread = float(np.median(np.abs(off - np.median(off)))) / _MAD
    around = np.lib.stride_tricks.sliding_window_view(np.pad(thrust, reach, mode="edge"), 2 * reach + 1)
    most = ratio * around.max(axis=1)
    hits = np.flatnonzero((felt - most)[-last:] > max(SPIKE_SPREADS * spread, HALF * STANDARD_GRAVITY_MPS2))
    return len(off) - min(last, len(off)) + int(hits[0]) if len(hits) else len(off)


def exclude_stopped_rotors(samples: Samples, vehicle: Vehicle) -> tuple[Samples, list[Finding]]:
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
