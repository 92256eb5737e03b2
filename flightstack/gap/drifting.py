"""A gyro whose bias is another one from some moment on: neither force nor turning shows it, and no name is it.

Rates are compared with the attitude's derivative (no physics acts there), second by second; on either side of the
moment that parts them best the means must differ by more than chance, by the seconds' own scatter with its memory, and
by what a gyro bias is told from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flightstack.gap.compare import residual
from flightstack.gap.decisions import CLEAR_EVIDENCE
from flightstack.gap.name import Selection
from flightstack.gap.records import Samples, Unexplained
from flightstack.gap.simulate import natural_scale
from flightstack.gap.track import track
from flightstack.types import F64
from flightstack.vehicle import Vehicle

_BLOCK_S = 1.0
_FEWEST = 5
"""Seconds on either side."""
_MEMORY = 5
"""Seconds over which the scatter may remember its past (Newey and West, Econometrica 1987)."""
_TURN = slice(6, 9)
GYRO = "gyro_bias"


def with_changing_gyro(vehicle: Vehicle, naming: Selection, flights: Sequence[Samples]) -> Selection:
    """The verdict, in which a gyro that changes in flight is something that no effect explains."""
    at_s = gyro_changes_s(vehicle, flights)
    if at_s is None:
        return naming
    if any(found.name == GYRO for found in naming.found):
        naming = naming.without((GYRO,), "is not the same in the whole flight")
    rest = naming.unexplained
    drivers = ("time", *(driver for driver in rest.depends_on if driver != "time"))
    return replace(
        naming,
        unexplained=Unexplained(
            True,
            drivers,
            rest.fraction if naming.found or rest.significant else 1.0,
            f"gyro and attitude disagree otherwise from {at_s:.0f} s on",
        ),
    )


def gyro_changes_s(vehicle: Vehicle, flights: Sequence[Samples]) -> float | None:
    """When the gyro's bias becomes another one, in a flight's own seconds; None where it stays what it is."""
    for samples in flights:
        flight = track(samples)
        if {"rate_frd_radps", "q_ned_frd"} & flight.missing:
            continue
        size = max(1, round(_BLOCK_S / samples.dt_s))
        y = residual(vehicle, samples).y[:, _TURN]
        count = len(y) // size
        blocks = y[: count * size].reshape(count, size, 3)
        whole = np.isfinite(blocks).all(axis=(1, 2))
        at = _parted(blocks[whole].mean(axis=1), natural_scale(vehicle, GYRO, "x_radps"))
        if at is not None:
            return float(samples.t_s[int(np.flatnonzero(whole)[at]) * size] - samples.t_s[0])
    return None


def _parted(means: F64, least: float) -> int | None:
    """Where these means (B, 3) are best parted in two, None where no axis surely changes by `least`."""
    best, at = 0.0, None
    for k in range(_FEWEST, len(means) - _FEWEST + 1):
        sides = [means[:k], means[k:]]
        rest = [side - side.mean(axis=0) for side in sides]
        alike = _lasting(np.concatenate(rest)) * (1.0 / k + 1.0 / (len(means) - k))
        own = sum(_lasting(each) / len(each) for each in rest)  # some seconds of one side alone may be off (Welch 1947)
        moved = sides[1].mean(axis=0) - sides[0].mean(axis=0)
        error = np.maximum(np.maximum(alike, own), 1e-300)
        evidence = float(np.max(np.where(np.abs(moved) >= least, 0.5 * moved**2 / error, 0.0)))
        if evidence > max(best, CLEAR_EVIDENCE):
            best, at = evidence, k
    return at


def _lasting(rest: F64) -> F64:
    """(3,) of these deviations (B, 3) from their mean, the variance of which the mean's is a Bth."""
    own = np.mean(rest**2, axis=0)
    lags = range(1, min(_MEMORY, len(rest) - 1) + 1)
    weight = np.array([2.0 * (1.0 - lag / (_MEMORY + 1)) for lag in lags])
    past = np.array([np.sum(rest[lag:] * rest[:-lag], axis=0) / len(rest) for lag in lags])
    return np.asarray(np.maximum(own, own + weight @ past))
