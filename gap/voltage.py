"""Whether a flight can show what the battery's voltage does to thrust, apart from what the motors do to the voltage."""

from __future__ import annotations

import numpy as np

from flightstack.types import STANDARD_GRAVITY_MPS2
from gap.records import Samples

_SPAN = 0.05
"""Share of itself, spanned beside what follows the motors' commands, from which on a voltage always tells."""
_SQUARE = 2.0
"""Thrust goes with the square of the voltage, and more is no battery's doing."""
_FROM, _TO = 5.0, 95.0
"""Percentiles, between which a steady fall does nine tenths of its way."""
_FEWEST = 10


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
    return own >= _SPAN or (own > 0.0 and lift_off_mps2 <= _SQUARE * own * STANDARD_GRAVITY_MPS2)
