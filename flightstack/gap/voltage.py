"""The battery's voltage without its sensor's noise, and whether a flight can show what it does to thrust."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from flightstack.gap.checks.grid import period_s
from flightstack.gap.decisions import GAP_FROM, SMALL_SHARE
from flightstack.gap.filters import both_ways, lowpass, through, white_noise
from flightstack.gap.records import Samples, Signal
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

_SQUARE = 2.0
"""Thrust goes with the square of the voltage, and more is no battery's doing."""
_FROM, _TO = 5.0, 95.0
"""Percentiles, between which a steady fall does nine tenths of its way."""
_FEWEST = 10
_SLOW_HZ = 0.5
"""Below, a battery's voltage goes its own way; above, it follows the power that the rotors draw."""
_RARE_S = 0.1
"""Between samples: beyond, a sensor can't show what the rotors draw."""
_UNLIKE = 3.0
"""Standard errors by which neighbouring samples' errors may go together and count as a sensor's noise."""
_PAD = 9
"""Rows by which the voltage is continued at both ends."""
_LAGS_S = (0.0, 0.01, 0.02, 0.04, 0.08)
"""Of that power behind the commands: the rotors'."""


def on_grid(signal: Signal, t_s: F64, motor: F64, dt_s: float) -> F64:
    """(N,) the voltage at these times: between rare samples what is slow goes on, and what is fast follows the power.

    A straight line from sample to sample misses what the rotors draw in between, and keeps the sensor's noise: beside a
    drift of thrust with time it made a poor regressor of a battery that truly sagged.
    """
    straight = np.interp(t_s, signal.t_s, signal.value)
    chosen = (signal.t_s >= t_s[0]) & (signal.t_s <= t_s[-1])
    at_s, volts = signal.t_s[chosen], signal.value[chosen]
    silent_s = float(np.diff(at_s, prepend=t_s[0], append=t_s[-1]).max())
    rare = period_s(signal) >= _RARE_S and len(volts) >= 2 * _FEWEST
    if not rare or silent_s > _FEWEST * period_s(signal) or not np.isfinite(motor).all():
        return quiet(straight, motor, dt_s)
    span_s = t_s[-1] - t_s[0]
    order = 2 + min(int(span_s / 60.0), _FEWEST // 2)
    slow = np.polynomial.chebyshev.chebvander(2.0 * (t_s - t_s[0]) / span_s - 1.0, order)
    best, least = straight, np.inf
    for drawn in (np.zeros((len(t_s), 0)), *_powers(motor, dt_s)):
        columns = np.column_stack([slow, drawn])
        seen = np.column_stack([np.interp(at_s, t_s, column) for column in columns.T])
        share = np.linalg.lstsq(seen, volts, rcond=None)[0]
        rest = volts - seen @ share
        left, alike = float(rest @ rest), float(rest[1:] @ rest[:-1])
        white = abs(alike) <= _UNLIKE * left / math.sqrt(len(rest))
        if left < least and white and np.all(share[order + 1 :] < 0.0):
            best, least = columns @ share, left
    return best


def _powers(motor: F64, dt_s: float) -> Iterator[F64]:
    """(N,) each: the power that the rotors draw, commands cubed, behind them by this lag and that."""
    power = np.mean(motor**3, axis=1)
    for lag_s in _LAGS_S:
        keep = np.exp(-dt_s / lag_s) if lag_s > 0.0 else 0.0
        yield through(np.array([1.0 - keep]), np.array([1.0, -keep]), power, float(power[0]))


def quiet(battery_v: F64, motor: F64, dt_s: float) -> F64:
    """(N,) the voltage less its sensor's noise, which would pass through a sag for noise of the thrust.

    What is slow is kept; what is fast is what follows the power drawn, commands cubed and lagged.  Where that is not
    all but the white noise (steps of a coarse sensor, another load), the voltage is left as it is measured.
    """
    noise = float(white_noise(battery_v[:, None])[0]) if len(battery_v) > _FEWEST else 0.0
    if not (noise > 0.0 and np.isfinite(battery_v).all() and np.isfinite(motor).all()):
        return battery_v
    low = lowpass(_SLOW_HZ, dt_s)
    slow = both_ways(low, battery_v, _PAD)
    best, least = battery_v, GAP_FROM * noise
    for drawn in _powers(motor, dt_s):
        fast = drawn - both_ways(low, drawn, _PAD)
        share = float(fast @ (battery_v - slow)) / max(float(fast @ fast), 1e-300)
        made = slow + share * fast
        off = float(np.std(battery_v - made))
        if off < least:
            best, least = made, off
    return best


def own_span(samples: Samples) -> float:
    """Share of itself by which the voltage moves apart from the motors' commands.

    Under load a battery sags by its resistance, and a loop that holds the height raises its commands as the voltage
    falls: both ways voltage and command say the same, and what the one does to thrust is a matter of the other's
    curve.  What a straight line and a parabola in the mean command leave of the voltage is its own.
    """
    chosen = samples.valid & (samples.battery_v > 0.0) & np.isfinite(samples.motor).all(axis=1)
    if chosen.sum() < _FEWEST:
        return 0.0
    volts, motor = samples.battery_v[chosen], samples.motor[chosen]
    x = np.stack([np.ones(len(volts)), motor.mean(axis=1), np.mean(motor**2, axis=1)], axis=1)
    own = volts - x @ np.linalg.lstsq(x, volts, rcond=None)[0]
    spread = np.percentile(own, _TO) - np.percentile(own, _FROM)
    return float(spread / np.median(volts) / (0.01 * (_TO - _FROM)))


def tells(samples: Samples, lift_off_mps2: float) -> bool:
    """Whether the voltage moves enough by itself.

    `lift_off_mps2`: rms by which the model is off along body z.  Where that is more than so small a movement could
    ever do, what goes with the voltage goes with something else.
    """
    own = own_span(samples)
    return own >= SMALL_SHARE or (own > 0.0 and lift_off_mps2 <= _SQUARE * own * STANDARD_GRAVITY_MPS2)
