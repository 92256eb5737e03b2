"""A thrust that only drifts with time, against a battery whose voltage falls."""

from __future__ import annotations

import numpy as np

from flightstack.types import F64
from gap.naming.estimate import Estimates
from gap.naming.search import Search
from gap.simulate import Knob

_DRIFT_MARGIN = 10.0
"""Chi-square by which the voltage must do better than time."""


def drifts_as_well(state: Search, made: Estimates, moved: F64) -> bool:
    """Whether a thrust that only drifts with time explains the flights as well as the battery's voltage does."""
    layout = state.point.layout
    thrust = state.bench.columns(made.vehicle, [Knob("thrust_scale", "scale")])
    drift = [np.concatenate([np.nan_to_num(x), _along(len(x)) * np.nan_to_num(x)], axis=2) for x in thrust]
    sag = [i for i, (e, _) in enumerate(made.slots) if e == "battery_sag"]
    others = [i for i in range(len(made.slots)) if i not in sag]
    without = made.rows + made.x[:, sag] @ moved[sag]
    k, b = state.metric.normal(np.hstack([layout.stack(drift), made.x[:, others]]), without)
    explained = state.metric.chi2(without) - float(b @ np.linalg.lstsq(k, b, rcond=1e-10)[0])
    return explained < state.metric.chi2(made.rows) + _DRIFT_MARGIN


def _along(count: int) -> F64:
    """(N, 1, 1) from -1 to 1 along a flight."""
    return np.linspace(-1.0, 1.0, count)[:, None, None]
