"""Whether a named effect is the same in each of several flights: its estimate by each of them alone.

An effect of the vehicle has one size, whatever flight shows it.  The flights' own estimates are compared by Cochran's
Q, a tenth of the change and a negligible size allowed (a vehicle differs by some per cent from flight to flight).  What
differs more is no effect of the vehicle; what differs less has intervals that reach as far as the flights differ
(DerSimonian and Laird, Controlled Clinical Trials 1986).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flightstack.gap.decisions import RARE_P
from flightstack.gap.naming.design import layout_of
from flightstack.gap.naming.estimate import (
    CI,
    Estimates,
    covariance_of,
    inverse,
    same,
    variation,
    without_nuisance,
)
from flightstack.gap.naming.search import SelectionState
from flightstack.gap.records import Across, Estimate
from flightstack.gap.simulate import value
from flightstack.vehicle import Vehicle

_FEWEST_ROWS = 10
"""For each coefficient."""

Told = Mapping[tuple[str, str], Estimate]
"""What one flight says of (effect, parameter)."""


def by_rows(state: SelectionState, made: Estimates) -> list[Told]:
    """What each flight says alone by one step at a time; empty where it says too little."""
    layout = state.point.layout
    rows = without_nuisance(state, made.rows, layout.keep)
    left = layout_of(state.bench, state.bench.residual(made.vehicle), coloured=True)
    out: list[Told] = []
    for f in range(len(state.bench.fit)):
        mine = layout.keep & (layout.flight == f)
        if mine.sum() < _FEWEST_ROWS * len(made.slots):
            out.append({})
            continue
        x = made.x[mine]
        values = made.values + inverse(x.T @ x) @ (x.T @ rows[mine])
        reach = CI * np.sqrt(np.maximum(np.diag(covariance_of(state, made.x, rows, mine, left)), 0.0))
        each = zip(made.slots, values.tolist(), reach.tolist(), strict=True)
        out.append({slot: Estimate(float("nan"), v, v - r, v + r) for slot, v, r in each})
    return out


def across(start: Vehicle, vehicle: Vehicle, told: Mapping[str, Told]) -> tuple[Across, ...]:
    """Of each parameter that two flights or more (by log) tell: their estimates and the p-value of their being one."""
    out = []
    for effect, parameter in dict.fromkeys(slot for flight in told.values() for slot in flight):
        slot = (effect, parameter)
        mine = {log: flight[slot] for log, flight in told.items() if slot in flight}
        if len(mine) < 2:
            continue
        theta = np.array([[e.estimate] for e in mine.values()])
        variance = np.array([[(0.5 * (e.high - e.low) / CI) ** 2] for e in mine.values()])
        now = np.array([value(vehicle, effect, parameter)])
        p_value = float(same(theta, variance, variation(start, vehicle, [slot], now))[0][0])
        out.append(Across(effect, parameter, p_value, p_value >= RARE_P, tuple(mine.items())))
    return tuple(out)


def differing(rows: Sequence[Across]) -> tuple[str, ...]:
    """Effects that are not the same in each flight, the clearest first."""
    return tuple(dict.fromkeys(a.effect for a in sorted(rows, key=lambda a: a.p_value) if not a.same))


def confirmed(rows: Sequence[Across]) -> set[str]:
    """Effects that each of several flights shows alone, the same in all."""
    return {a.effect for a in rows} - set(differing(rows))
