"""The design: residuals of all flights and every candidate's columns at one vehicle, whitened and stacked in rows.

Where residuals and columns come from is behind `Bench`: the simulator in earnest, arrays in tests.  A row is one
channel of one flight at one time; the noise of every channel of every flight has a model of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.naming.candidates import Candidate, candidates, trifle
from flightstack.gap.naming.evidence import Gram, robust
from flightstack.gap.naming.whitening import Mask, Whitener, apply, fit, plain, whole_windows
from flightstack.gap.simulate import FreeParameter, value
from flightstack.types import F64, InputError
from flightstack.vehicle import Vehicle

_WHITENINGS = 2
_ALL, _TORQUES = range(12), range(3, 6)
"""Channels whose noise has colour."""
_OUTLIER = 6.0


class Bench(Protocol):
    """What the flights say against a vehicle: arrays of (N, channels) for each flight."""

    def residual(self, vehicle: Vehicle) -> list[F64]:
        """Measured minus simulated; NaN where a channel can't be had."""

    def columns(self, vehicle: Vehicle, knobs: Sequence[FreeParameter]) -> list[F64]:
        """Derivatives of the simulated by these parameters at the vehicle: (N, channels, K) for each flight."""

    def nuisance(self, vehicle: Vehicle) -> tuple[list[F64], F64, Mask]:
        """Columns (N, channels, K) of what is neither known nor an effect, the size (K,) of each, whether it is fitted.

        Fitted as something of that size: else it would bend the effects.  What is an effect under another name is
        never fitted: it only widens the intervals.
        """

    def rate(self, flight: int) -> float:
        """Rows a second of one flight."""

    @property
    def trifles(self) -> float:
        """Of the candidates' negligible sizes, the share at which each is taken to be there (`candidates.trifle`)."""

    @property
    def fit(self) -> list[Mask]:
        """(N,) rows to learn from, for each flight."""

    @property
    def holdout(self) -> list[Mask]:
        """(N,) rows to judge by."""


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Which rows there are, and the noise of each channel."""

    ok: list[Mask]
    """(N, channels) for each flight: measured and in use."""
    whiteners: list[list[Whitener]]
    """By flight and channel."""
    windows: list[list[Mask]]
    """By flight and channel: rows that the filters reach whole."""
    flight: NDArray[np.int64]
    """(R,) of each row."""
    channel: NDArray[np.int64]
    at: NDArray[np.int64]
    """(R,) sample number in its flight."""
    held: Mask
    """(R,) row belongs to the held-out part."""
    keep: Mask
    """(R,) row counts: no outlier."""

    def stack(self, values: Sequence[F64]) -> F64:
        """Whitened rows (R,) of (N, channels) in each flight, or (R, K) of (N, channels, K)."""
        parts = []
        for f, flight in enumerate(values):
            moving = np.any(flight, axis=0)
            for c, whitener in enumerate(self.whiteners[f]):
                if not whitener.usable:
                    continue
                rows, seen = flight[:, c], moving[c]
                white = np.zeros(rows.shape)
                if rows.ndim == 1 or seen.all():
                    white = apply(whitener, rows, self.ok[f][:, c])
                elif seen.any():  # most columns are nothing in most channels
                    white[:, seen] = apply(whitener, rows[:, seen], self.ok[f][:, c])
                parts.append(white[self.windows[f][c]])
        return np.concatenate(parts) if parts else np.empty(0)


@dataclass(frozen=True, slots=True, eq=False)
class Slot:
    """One column: its candidate, parameter, where it is linearised, its bounds and its negligible size."""

    candidate: int
    parameter: str
    value: float
    """Of the parameter in the vehicle at which the columns are."""
    origin: float
    """Of the parameter where nothing is named; a fit's coefficients count from here."""
    minimum: float
    maximum: float
    negligible: float


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """All candidates at one vehicle: rows y = x theta + unit noise, theta counted from each slot's origin."""

    vehicle: Vehicle
    candidates: tuple[Candidate, ...]
    slots: tuple[Slot, ...]
    layout: Layout
    x: F64
    """(R, n)."""
    nuisance: F64
    """(R, k) columns of what is neither known nor an effect."""
    nuisance_size: F64
    """(k,) its standard deviation."""
    nuisance_fitted: Mask
    """(k,) which of it is fitted beside the effects; the others widen their intervals."""
    y: F64
    """(R,) as if every named effect were at its origin, to first order."""
    rest: F64
    """(R,) the residual at the vehicle itself."""

    @property
    def columns(self) -> list[NDArray[np.int64]]:
        """Column numbers of each candidate."""
        return [
            np.array([i for i, slot in enumerate(self.slots) if slot.candidate == m], dtype=np.int64)
            for m in range(len(self.candidates))
        ]

    @property
    def low(self) -> F64:
        """(n,) least allowed coefficient: the sign is strict, the far end twice as far (straight lines overshoot)."""
        return np.array([2.0 * (slot.minimum - slot.origin) for slot in self.slots])

    @property
    def high(self) -> F64:
        """(n,) greatest allowed coefficient."""
        return np.array([2.0 * (slot.maximum - slot.origin) for slot in self.slots])

    @property
    def negligible(self) -> F64:
        """(n,)."""
        return np.array([slot.negligible for slot in self.slots])

    def fit_rows(self) -> Mask:
        """(R,) rows to learn from."""
        return self.layout.keep & ~self.layout.held

    def gram(self, rows: Mask | None = None) -> Gram:
        """Robust normal equations over these rows (default: all to learn from)."""
        chosen = self.fit_rows() if rows is None else rows
        x, y = np.hstack([self.x[chosen], self.nuisance[chosen]]), self.y[chosen]
        sizes = np.concatenate([self.negligible, self.nuisance_size])
        whole = robust(x.T @ x, x.T @ y, float(y @ y), float(len(y)), sizes)
        n = len(self.slots)
        return Gram(whole.k[:n, :n], whole.b[:n], whole.c, whole.rows)


def linearise(bench: Bench, vehicle: Vehicle, start: Vehicle, *, layout: Layout | None = None) -> Linearised:
    """All candidates' columns at `vehicle`; `start` is the vehicle in which nothing has been named yet."""
    raw_y = bench.residual(vehicle)
    group = candidates(vehicle)
    slots = tuple(
        _slot(m, candidate, parameter, trifle(candidate.effect, bench.trifles) * size, vehicle, start)
        for m, candidate in enumerate(group)
        for parameter, size in zip(candidate.parameters, candidate.negligible, strict=True)
    )
    knobs = [FreeParameter(group[s.candidate].effect, s.parameter, group[s.candidate].variant) for s in slots]
    raw_x = [np.nan_to_num(x) for x in bench.columns(vehicle, knobs)]
    if layout is None:
        layout = _learn_layout(bench, raw_y, raw_x, np.array([slot.negligible for slot in slots]), vehicle is start)
    x = layout.stack(raw_x)
    raw_nuisance, sizes, told = bench.nuisance(vehicle)
    nuisance = layout.stack([np.nan_to_num(columns) for columns in raw_nuisance])
    rest = layout.stack(raw_y)
    moved = np.array([slot.value - slot.origin for slot in slots])
    return Linearised(vehicle, group, slots, layout, x, nuisance, sizes, told, rest + x @ moved, rest)


def _slot(m: int, candidate: Candidate, parameter: str, size: float, vehicle: Vehicle, start: Vehicle) -> Slot:
    spec = candidate.spec(parameter)
    now, origin = value(vehicle, candidate.effect, parameter), value(start, candidate.effect, parameter)
    return Slot(m, parameter, now, origin if np.isfinite(origin) else now, spec.minimum, spec.maximum, size)


def _learn_layout(bench: Bench, raw_y: list[F64], raw_x: list[F64], negligible: F64, at_start: bool) -> Layout:
    """Noise models from what even all candidates together leave, by turns with the fit itself.

    A noise model of a residual from which nothing has been taken yet takes its mean and its drift for colour, and
    looks away from them ever after.  At the vehicle as its file has it that is wanted: straight lines don't reach
    as far as it may be off.  Elsewhere it would let a weight go uncarried, and the turns begin without colour.  Not
    for torques: a rate loop answers a slow disturbance with its own opposite, so that commands and disturbance are
    alike and the turning is small; without colour that would pass for torques that hardly act (Soderstrom and
    Ljung, Automatica 1977: in a closed loop only a rich enough model of the noise saves the direct method).
    """
    ok = _measured(bench, raw_y)
    errors = [np.where(good, y, 0.0) for y, good in zip(raw_y, ok, strict=True)]
    if not at_start:  # a torque that never changes is no disturbance that a loop answers
        errors = [e - np.sum(e, axis=0) / np.maximum(good.sum(axis=0), 1) for e, good in zip(errors, ok, strict=True)]
    layout = _layout(bench, errors, ok, _ALL if at_start else _TORQUES)
    if not (layout.keep & ~layout.held).any():
        raise InputError(
            "the logs hold too little in one piece that a simulation can be compared with; record half a minute in "
            "the air: motors, gyro and accelerometer at 100 Hz or more, attitude and velocity"
        )
    for coloured in (*([] if at_start else [_TORQUES]), *([_ALL] * _WHITENINGS)):
        theta = _saturated(layout, raw_y, raw_x, negligible)
        errors = [y - x @ theta for y, x in zip(raw_y, raw_x, strict=True)]
        layout = _layout(bench, errors, ok, coloured)
    return layout


def layout_of(bench: Bench, raw_y: list[F64], *, coloured: bool) -> Layout:
    """Rows by the noise that this residual is: with colour, or each channel in units of its size only."""
    ok = _measured(bench, raw_y)
    errors = [np.where(good, y, 0.0) for y, good in zip(raw_y, ok, strict=True)]
    return _layout(bench, errors, ok, _ALL if coloured else range(0))


def _measured(bench: Bench, raw_y: list[F64]) -> list[Mask]:
    """(N, channels) for each flight: known, and in use."""
    return [
        np.isfinite(y) & (fit_rows | held)[:, None]
        for y, fit_rows, held in zip(raw_y, bench.fit, bench.holdout, strict=True)
    ]


def _saturated(layout: Layout, raw_y: list[F64], raw_x: list[F64], negligible: F64) -> F64:
    """Coefficients of all candidates at once; a very wide prior keeps alike columns apart."""
    x, y = layout.stack(raw_x), layout.stack(raw_y)
    chosen = layout.keep & ~layout.held
    x, y = x[chosen], y[chosen]
    wide = 1.0 / (_WIDE * negligible)
    scaled = (x.T @ x) / np.outer(wide, wide) + np.eye(len(wide))
    return np.linalg.solve(scaled, (x.T @ y) / wide) / wide


_WIDE = 1000.0


def _layout(bench: Bench, errors: list[F64], ok: list[Mask], coloured: range) -> Layout:
    """Noise models of these errors; channels not in `coloured` have white noise."""
    channels = errors[0].shape[1]
    whiteners: list[list[Whitener]] = []
    windows: list[list[Mask]] = []
    flight, channel, at, held, keep = [], [], [], [], []
    learned = [f for f, rows in enumerate(bench.fit) if rows.any()]
    for f, e in enumerate(errors):
        row_whiteners, row_windows = [], []
        source = [f] if f in learned else learned  # a flight that was kept is whitened as the others are
        for c in range(channels):
            good = ok[f][:, c]
            whitener = (fit if c in coloured else plain)(
                [errors[g][:, c] for g in source], [ok[g][:, c] & bench.fit[g] for g in source]
            )
            fit_window = whole_windows(good & bench.fit[f], whitener.order)
            window = fit_window | whole_windows(good & bench.holdout[f], whitener.order)
            row_whiteners.append(whitener)
            row_windows.append(window)
            if not whitener.usable:
                continue
            number = np.flatnonzero(window)
            flight.append(np.full(len(number), f))
            channel.append(np.full(len(number), c))
            at.append(number)
            held.append(~fit_window[number])
            keep.append(np.abs(apply(whitener, e[:, c], good)[window]) <= _OUTLIER)
        whiteners.append(row_whiteners)
        windows.append(row_windows)
    none = [np.empty(0, dtype=np.int64)]
    return Layout(
        ok,
        whiteners,
        windows,
        np.concatenate(flight or none),
        np.concatenate(channel or none),
        np.concatenate(at or none),
        np.concatenate(held or none).astype(bool),
        np.concatenate(keep or none).astype(bool),
    )
