"""The design: residuals of all flights and every candidate's columns at one vehicle, whitened and stacked in rows.

Where residuals and columns come from is behind `Bench`: the simulator in earnest, arrays in tests.  A row is one
channel of one flight at one time; the noise of every channel of every flight has a model of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.cores import on_cores
from flightstack.gap.naming.candidates import Candidate, candidates, trifle
from flightstack.gap.naming.evidence import Gram, robust
from flightstack.gap.naming.whitening import Mask, Whitener, fit, plain, whiten, whole_windows
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
    rows: list[list[NDArray[np.int64]]]
    """By flight and channel: numbers of the samples that the filters reach whole."""
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
        stacked = np.empty((len(self.at), *values[0].shape[2:]))
        flat, begin = stacked.reshape(len(stacked), -1), 0
        parts = []
        for flight, whiteners, rows_of in zip(values, self.whiteners, self.rows, strict=True):
            each = np.ascontiguousarray(flight).reshape(*flight.shape[:2], -1)
            for c, (whitener, rows) in enumerate(zip(whiteners, rows_of, strict=True)):
                if whitener.usable:
                    own = flat[begin : begin + len(rows)]
                    parts.append(partial(whiten, whitener.taps / whitener.sigma, each, c, rows, own))
                    begin += len(rows)
        on_cores(lambda part: part(), parts)
        return stacked


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
    _known: dict[str, Any] = field(default_factory=dict, repr=False)
    """What was asked for once."""

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

    def gram(self) -> Gram:
        """Robust normal equations over the rows to learn from."""
        if "gram" not in self._known:
            x, xx = self.learned()
            y = self.y[self.fit_rows()]
            whole = robust(xx, x.T @ y, float(y @ y), float(len(y)), self.sizes)
            n = len(self.slots)
            self._known["gram"] = Gram(whole.k[:n, :n], whole.b[:n], whole.c, whole.rows)
        gram: Gram = self._known["gram"]
        return gram

    def learned(self) -> tuple[F64, F64]:
        """Columns of effects and nuisance in the rows to learn from, and their products with one another."""
        if "learned" not in self._known:
            chosen = self.fit_rows()
            x = np.hstack([self.x[chosen], self.nuisance[chosen]])
            self._known["learned"] = x, x.T @ x
        x, xx = self._known["learned"]
        return x, xx

    @property
    def sizes(self) -> F64:
        """(n + k,) the negligible sizes and those of the nuisance."""
        return np.concatenate([self.negligible, self.nuisance_size])


@dataclass(frozen=True, slots=True, eq=False)
class RawDesign:
    """All candidates at one vehicle before any whitening: (N, channels), with a last axis where there are columns."""

    vehicle: Vehicle
    candidates: tuple[Candidate, ...]
    slots: tuple[Slot, ...]
    residual: list[F64]
    columns: list[F64]
    nuisance: tuple[list[F64], F64, Mask]


def design(bench: Bench, vehicle: Vehicle, start: Vehicle) -> RawDesign:
    """All candidates at `vehicle`; `start` is the vehicle in which nothing has been named yet."""
    group = candidates(vehicle)
    slots = tuple(
        _slot(m, candidate, parameter, trifle(candidate.effect, bench.trifles) * size, vehicle, start)
        for m, candidate in enumerate(group)
        for parameter, size in zip(candidate.parameters, candidate.negligible, strict=True)
    )
    knobs = [FreeParameter(group[s.candidate].effect, s.parameter, group[s.candidate].variant) for s in slots]
    columns = [np.nan_to_num(x, copy=False) for x in bench.columns(vehicle, knobs)]
    return RawDesign(vehicle, group, slots, bench.residual(vehicle), columns, bench.nuisance(vehicle))


def linearise(bench: Bench, vehicle: Vehicle, start: Vehicle, *, layout: Layout | None = None) -> Linearised:
    """All candidates' columns at `vehicle`; `start` is the vehicle in which nothing has been named yet."""
    return whitened(bench, design(bench, vehicle, start), at_start=vehicle is start, layout=layout)


def whitened(bench: Bench, raw: RawDesign, *, at_start: bool, layout: Layout | None = None) -> Linearised:
    """A design in rows of unit noise; `at_start`: the noise's colour may hold means (`_learn_layout`)."""
    if layout is None:
        sizes = np.array([slot.negligible for slot in raw.slots])
        layout = _learn_layout(bench, raw.residual, raw.columns, sizes, at_start)
    x = layout.stack(raw.columns)
    unknown, sizes, told = raw.nuisance
    nuisance = layout.stack([np.nan_to_num(columns) for columns in unknown])
    rest = layout.stack(raw.residual)
    moved = np.array([slot.value - slot.origin for slot in raw.slots])
    return Linearised(raw.vehicle, raw.candidates, raw.slots, layout, x, nuisance, sizes, told, rest + x @ moved, rest)


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
    rows: list[list[NDArray[np.int64]]] = []
    flight, channel, at, held, keep = [], [], [], [], []
    learned = [f for f, mask in enumerate(bench.fit) if mask.any()]
    for f, e in enumerate(errors):
        row_whiteners, row_numbers = [], []
        each = np.ascontiguousarray(e)[:, :, None]
        source = [f] if f in learned else learned  # a flight that was kept is whitened as the others are
        for c in range(channels):
            good = ok[f][:, c]
            whitener = (fit if c in coloured else plain)(
                [errors[g][:, c] for g in source], [ok[g][:, c] & bench.fit[g] for g in source]
            )
            fit_window = whole_windows(good & bench.fit[f], whitener.order)
            window = fit_window | whole_windows(good & bench.holdout[f], whitener.order)
            number = np.flatnonzero(window)
            row_whiteners.append(whitener)
            row_numbers.append(number)
            if not whitener.usable:
                continue
            white = np.empty((len(number), 1))
            whiten(whitener.taps / whitener.sigma, each, c, number, white)
            flight.append(np.full(len(number), f))
            channel.append(np.full(len(number), c))
            at.append(number)
            held.append(~fit_window[number])
            keep.append(np.abs(white[:, 0]) <= _OUTLIER)
        whiteners.append(row_whiteners)
        rows.append(row_numbers)
    none = [np.empty(0, dtype=np.int64)]
    return Layout(
        ok,
        whiteners,
        rows,
        np.concatenate(flight or none),
        np.concatenate(channel or none),
        np.concatenate(at or none),
        np.concatenate(held or none).astype(bool),
        np.concatenate(keep or none).astype(bool),
    )
