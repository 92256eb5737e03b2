"""What the workflow found, whole, and the machine-readable file that it becomes (`flightstack.gap/1`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from flightstack.gap.records import (
    Across,
    ChannelResidual,
    Estimate,
    Figures,
    Gap,
    IdentifiedEffect,
    Rejected,
    Unexplained,
)
from flightstack.gap.report import GapReport
from flightstack.gap.report.record import Shown
from flightstack.vehicle import Vehicle

SCHEMA = "flightstack.gap/1"
NOTHING = Figures(None, None, None)


@dataclass(frozen=True, slots=True, eq=False)
class GapResult:
    """One run of the workflow."""

    logs: tuple[str, ...]
    vehicle: str
    where: tuple[ChannelResidual, ...]
    found: tuple[IdentifiedEffect, ...]
    gap: Gap
    unexplained: Unexplained
    rejected: tuple[Rejected, ...]
    corrected: Vehicle
    report: GapReport

    @property
    def across(self) -> tuple[Across, ...]:
        """Of several flights: what each says alone."""
        return self.report.across

    @property
    def sentence(self) -> str:
        """What was found, how sure, and what would settle the rest."""
        return self.report.sentence


def as_json(result: GapResult) -> dict[str, Any]:
    """The fields of the contract; what is not known is null."""
    return {
        "schema": SCHEMA,
        "logs": list(result.logs),
        "vehicle": result.vehicle,
        "sentence": result.sentence,
        "where": [_where(row) for row in result.where],
        "effects": [_found(found) for found in result.found],
        "gap": {
            "before": _figures(result.gap.before),
            "after": _figures(result.gap.after),
            "noise_floor": _figures(result.gap.noise_floor),
            "closed": _known(result.gap.closed),
        },
        "unexplained": {
            "significant": result.unexplained.significant,
            "depends_on": list(result.unexplained.depends_on),
            "fraction": _known(result.unexplained.fraction),
            "shown": result.unexplained.shown,
        },
        "untold": result.report.untold,
        "flights": [_across(row) for row in result.across],
        "rejected": [_rejected(row) for row in result.rejected],
        "shown": [_shown(row) for row in result.report.shown],
        "data": [_log(log) for log in result.report.logs],
    }


def _where(row: ChannelResidual) -> dict[str, Any]:
    return {
        "signal": row.signal,
        "rms": _known(row.rms),
        "unit": row.unit,
        "expected_noise": _known(row.expected_noise),
        "worst_regime": row.worst_regime,
        "correlates_with": row.correlates_with,
    }


def _found(found: IdentifiedEffect) -> dict[str, Any]:
    return {
        "name": found.name,
        "parameters": {name: _estimate(value) for name, value in found.parameters.items()},
        "evidence": {
            "delta_bic": _known(found.delta_bic),
            "holdout_gain": _known(found.holdout_gain),
            "p_value": _known(found.p_value),
        },
        "indistinguishable_from": list(found.indistinguishable_from),
        "manoeuvre": found.manoeuvre,
    }


def _across(row: Across) -> dict[str, Any]:
    values = [
        {"log": log, "estimate": _known(e.estimate), "ci95": [_known(e.low), _known(e.high)]} for log, e in row.flights
    ]
    return {
        "effect": row.effect,
        "parameter": row.parameter,
        "same": row.same,
        "p_value": _known(row.p_value),
        "values": values,
    }


def _estimate(value: Estimate) -> dict[str, Any]:
    return {
        "before": _known(value.before),
        "estimate": _known(value.estimate),
        "ci95": [_known(value.low), _known(value.high)],
        "told": value.told,
    }


def _rejected(row: Rejected) -> dict[str, Any]:
    return {"name": row.name, "delta_bic": _known(row.delta_bic), "reason": row.reason}


def _shown(row: Shown) -> dict[str, Any]:
    sizes = {parameter: _known(size) for parameter, size in row.sizes.items()}
    return {"effect": row.effect, "level": row.level, "smallest": sizes, "share_of_file": _known(row.share)}


def _figures(figures: Figures) -> dict[str, float | None]:
    return {
        "one_step_mps2": _known(figures.one_step_mps2),
        "one_step_radps2": _known(figures.one_step_radps2),
        "rollout_1s_m": _known(figures.rollout_1s_m),
    }


def _log(log: Any) -> dict[str, Any]:
    return {
        "name": log.name,
        "kind": log.kind,
        "used_s": _known(log.seconds),
        "findings": [{"name": f.name, "level": f.level, "text": f.text} for f in log.findings],
        "offsets": [
            {"signal": o.signal, "offset_s": _known(o.offset_s), "ci95": [_known(o.low_s), _known(o.high_s)]}
            for o in log.offsets
        ],
        "notes": list(log.notes),
    }


def _known(value: float | None) -> float | None:
    """A finite number, or null."""
    return None if value is None or not math.isfinite(value) else float(value)
