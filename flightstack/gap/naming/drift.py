"""A thrust that only drifts with time, against a battery whose voltage falls."""

from __future__ import annotations

import numpy as np

from flightstack.gap.naming.estimate import Estimates
from flightstack.gap.naming.search import SelectionState
from flightstack.gap.simulate import Knob
from flightstack.types import F64


def drifts_better(state: SelectionState, made: Estimates, moved: F64) -> bool:
    """Whether a thrust that only drifts with time explains the flights better than the battery's voltage does."""
    layout = state.point.layout
    thrust = state.bench.columns(made.vehicle, [Knob("thrust_scale", "scale")])
    drift = [np.concatenate([np.nan_to_num(x), _along(len(x)) * np.nan_to_num(x)], axis=2) for x in thrust]
    sag = [i for i, (e, _) in enumerate(made.slots) if e == "battery_sag"]
    others = [i for i in range(len(made.slots)) if i not in sag]
    without = made.rows + made.x[:, sag] @ moved[sag]
    k, b = state.metric.normal(np.hstack([layout.stack(drift), made.x[:, others]]), without)
    explained = state.metric.chi2(without) - float(b @ np.linalg.lstsq(k, b, rcond=1e-10)[0])
    price = np.log(max(float(state.metric.rows.sum()), 2.0))  # a drift begins somewhere: a coefficient more
    return explained + float(price) < state.metric.chi2(made.rows)


def _along(count: int) -> F64:
    """(N, 1, 1) from -1 to 1 along a flight."""
    return np.linspace(-1.0, 1.0, count)[:, None, None]
