"""Whether a flight can show what the battery's voltage does to thrust, apart from what the motors do to the voltage."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from gap.records import Samples

_SPAN = 0.05
"""Share of itself that the voltage must span beside what follows the motors' commands."""
_FROM, _TO = 5.0, 95.0
"""Percentiles, between which a steady fall does nine tenths of its way."""
_FEWEST = 10


@lru_cache(maxsize=16)
def tells(samples: Samples) -> bool:
    """Whether the voltage moves by itself: a twentieth of it that is neither current nor a command's mirror.

    Under load a battery sags by its resistance, and a loop that holds the height raises its commands as the voltage
    falls: both ways voltage and command say the same, and what the one does to thrust is a matter of the other's
    curve.  What a straight line and a parabola in the mean command leave of the voltage is what tells.
    """
    chosen = samples.valid & (samples.battery_v > 0.0) & np.isfinite(samples.motor).all(axis=1)
    if chosen.sum() < _FEWEST:
        return False
    volts, motor = samples.battery_v[chosen], samples.motor[chosen]
    x = np.stack([np.ones(len(volts)), motor.mean(axis=1), np.mean(motor**2, axis=1)], axis=1)
    own = volts - x @ np.linalg.lstsq(x, volts, rcond=None)[0]
    return bool(np.percentile(own, _TO) - np.percentile(own, _FROM) >= 0.01 * (_TO - _FROM) * _SPAN * np.median(volts))
