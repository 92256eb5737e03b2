"""How good the vehicle's estimate was, apart from how well the stack flew by it."""

from __future__ import annotations

from typing import Any

import numpy as np

from flightstack.cli.column import Column
from flightstack.estimate_observer import POOR_MPS
from flightstack.types import F64, Tuple3

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


class EstimateScore:
    """Sums of a flight, tick by tick on the track."""

    def __init__(self) -> None:
        self._disagreements, self._errors, self._control = Column(3), Column(3), Column()

    def add(self, disagreement_ned_mps: F64, from_reference_m: float, error_ned_m: Tuple3 | None) -> None:
        """One tick; `error_ned_m`: estimate less truth, each relative to where the flight began."""
        self._disagreements.extend_bytes(disagreement_ned_mps)
        self._control.append(from_reference_m)
        if error_ned_m is not None:
            self._errors.extend(error_ned_m)

    def summary(self) -> dict[str, Any]:
        """The JSON's `estimator`."""
        if not len(self._control):
            return dict(NO_ESTIMATE)
        disagreement = _rms(self._disagreements.table())
        control = self._control.table()
        return {
            "disagreement_rms_mps": disagreement.tolist(),
            "poor": bool(disagreement.max() > POOR_MPS),
            "error_rms_m": _rms(self._errors.table()).tolist() if len(self._errors) else None,
            "control_rmse_m": float(_rms(control)),
            "control_rmse_settled_m": float(_rms(control[len(control) // 2 :])),
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
