"""How good the vehicle's estimate was, apart from how well the stack flew by it."""

from __future__ import annotations

from typing import Any

import numpy as np

from flightstack.estimate_observer import POOR_MPS
from flightstack.types import F64

NO_ESTIMATE: dict[str, Any] = {
    "disagreement_rms_mps": None,
    "poor": None,
    "error_rms_m": None,
    "control_rmse_m": None,
    "control_rmse_settled_m": None,
}
"""disagreement_rms_mps: [north, east, down] of d(position)/dt - velocity while the scenario was tracked, `poor` where
one of them exceeds 0.15; error_rms_m: [north, east, down] of estimated less true position, null without a truth;
control_rmse_m: of the position as estimated from the reference that was followed (in a site, the bent one), `_settled`
its second half."""


def estimate_summary(disagreement_ned_mps: F64, control_m: F64, error_ned_m: F64 | None) -> dict[str, Any]:
    """The JSON's `estimator`, of the ticks of the track: (n, 3), distance (n,) from the reference to the estimate,
    estimate less truth (n, 3), each relative to where the flight began."""
    if not len(control_m):
        return dict(NO_ESTIMATE)
    disagreement = _rms(disagreement_ned_mps)
    return {
        "disagreement_rms_mps": disagreement.tolist(),
        "poor": bool(disagreement.max() > POOR_MPS),
        "error_rms_m": None if error_ned_m is None else _rms(error_ned_m).tolist(),
        "control_rmse_m": float(_rms(control_m)),
        "control_rmse_settled_m": float(_rms(control_m[len(control_m) // 2 :])),
    }


def _rms(values: F64) -> F64:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def estimate_words(estimate: dict[str, Any]) -> str:
    """The JSON's `estimator` in one line."""
    north, east, down = estimate["disagreement_rms_mps"]
    parts = [f"velocity and position disagree by {north:.2f}, {east:.2f}, {down:.2f} m/s rms (north, east, down)"]
    if estimate["poor"]:
        parts[0] += f", more than {POOR_MPS:g}: a poor estimate"
    parts.append(f"control error {estimate['control_rmse_settled_m']:.3f} m (settled, of the estimate)")
    if estimate["error_rms_m"] is not None:
        parts.append("error of the estimate {:.3f}, {:.3f}, {:.3f} m".format(*estimate["error_rms_m"]))
    return "; ".join(parts)
