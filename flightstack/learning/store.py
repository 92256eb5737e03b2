"""A store: the points of one Gaussian process, what replaces what, and how far its bound can be trusted.

Windows of samples become points; their noise is measured (`hear`).  When the store is full the oldest point leaves
(`relevance` names another rule).  Each new point first tests the prediction made without it, which calibrates
the bound:

    sigma^2 = INFLATION^2 (posterior variance + excess)
    excess  = max(floor^2, fast - 2.5 s_f, slow - 2.5 s_s, outlier)
    fast    = mean over the last windows of (error^2 - posterior variance - noise)
    slow    = mean over the last blocks of 8 windows of (mean error^2 - posterior variance - noise / 8)

s_f and s_s are what noise alone makes of these two means (chi squared: noise sqrt(2 / windows)): what it explains is no
doubt of the model, and in blocks a slow error shows through noise eight times as strong.  A single error beyond four
deviations of noise and three of the bound widens it at once, and is forgotten over a dozen seconds unless more follow.

Beside this *tracking set*, which follows the flight, the points since the last noticed change are pooled; from the
pool `certificate_set` chooses those that a certificate may rest on.  When the pool is full, the older three quarters
are thinned to a third that reaches as far as all of them: what was seen once, far out, is not forgotten in flight.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flightstack.gp import Kernel, RecursiveGP, least_relevant, spread
from flightstack.gp.relevance import Spread
from flightstack.jit import Entry, njit
from flightstack.learning.priors import StorePrior
from flightstack.types import F64, I64

Relevance = Literal["oldest", "kernel"]
Span = tuple[int, int]
"""Stamps of a window's first and last sample, us."""
Point = tuple[F64, F64]
"""Input (D,) and target (P,)."""

INFLATION = 1.05
"""What the rule above still lacks: the mean over time is less than the error in a manoeuvre.  Set on simulated flights
(docs/learning.md says which), whose seeds no reported coverage uses."""
_MEMORY_WINDOWS = 250
_RENEW_SHARE = 0.5
"""A noticed change widens sigma to this share of it: three of them hold it with room."""
_BLOCK = 8
"""Windows whose mean error tells slow errors from noise: half a second."""
_MEMORY_BLOCKS = _MEMORY_WINDOWS // _BLOCK
_NOISE_SIGMAS = 2.5
_OUTLIER_SIGMAS = 4.0
"""Noise does this once in 16,000 windows."""
_OUTLIER_KEPT = 1.0 - 1.0 / 200.0
"""Share of an outlier's variance that is left a window later."""
_NOISE_FACTOR = 1.5
_NOISE_EVERY = 50
_CARRIED = 3
"""Points that a tick takes over."""
_FEW = 30
"""Points with which rebuilding costs nothing."""
_NOISE_LEAST = 1e-4
_TOLERANCE = 1e-3
"""Of a variance, by which a prediction may be off for being worked out in half the time."""
_POOL = 2000
"""Two minutes of windows."""
_THINNED, _KEPT = 1500, 500
_BOUND_SIGMAS = 3.0
_ORIGIN = np.zeros(16)
_FAST, _SLOW, _OUTLIER, _CALM, _EXCESS, _LEVELS = range(6)


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a certificate rests on: a store's pool, prior and calibration as of one moment."""

    kernel: Kernel
    noise_var: float
    capacity: int
    excess: F64
    """(P,) variance that the kernel does not know."""
    places: F64
    """(N, D), the oldest first."""
    values: F64
    """(N, P)."""
    spans_us: I64
    """(N, 2) stamps of the first and the last sample of each point's window."""
    force: Kernel | None = None
    """As `StorePrior`."""

    def chosen(self, count: int) -> I64:
        """Indices of `count` pooled points that reach as far as all of them."""
        return spread(self.places, count) if len(self.places) else np.arange(0)

    def is_where(self, other: Evidence) -> bool:
        """Whether as many points are chosen at the same places."""
        return self.capacity == other.capacity and np.array_equal(self.places, other.places)

    def pooled(self, newest: int = _POOL) -> tuple[F64, F64]:
        """Places (N, D) and values (N, P) of the newest pooled points, the oldest of them first."""
        return self.places[-newest:], self.values[-newest:]

    def evidence(self) -> Evidence:
        """As a store's: itself."""
        return self


class _Successor:
    """A store's points with another noise: taken over some at a time, and what came and went meanwhile after them."""

    __slots__ = ("_done", "_moves", "_x", "_y", "gp")

    def __init__(self, before: RecursiveGP, gp: RecursiveGP, noise_var: float) -> None:
        """`gp`: a process of the same kind, whose points are forgotten."""
        gp.restart(noise_var)
        self.gp, self._x, self._y, self._done = gp, before.x, before.y, 0
        self._moves: deque[tuple[int, F64, F64, bool]] = deque()

    def note(self, dropped: int, x: F64, y: F64, taken: bool) -> None:
        """The store let a point go (-1: none), and took another or refused it."""
        self._moves.append((dropped, x.copy(), y.copy(), taken))

    def carry_on(self) -> bool:
        """Some points more; whether all are here, at the store's own indices."""
        done, held = self._done, len(self._x)
        if done < held:
            self._done = min(done + _CARRIED, held)
            for i in range(done, self._done):
                self.gp.add(self._x[i], self._y[i])
        elif self._moves:  # a window brings one, and there are ticks enough between two
            dropped, x, y, taken = self._moves.popleft()
            if dropped >= 0:
                self.gp.remove(dropped)
            if taken:
                self.gp.add(x, y)
        return self._done == held and not self._moves


class Store:
    """Points and calibration of one Gaussian process with outputs that share its factorisation; mutable."""

    __slots__ = (
        "_age", "_block", "_choice", "_force", "_fresh", "_heard", "_least_noise_var", "_levels", "_next", "_places",
        "_pooled", "_spans", "_spare", "_successor", "_values", "_wanted", "calm_excess", "excess", "floor", "gp",
        "outputs", "relevance",
    )  # fmt: skip

    def __init__(
        self,
        prior: StorePrior,
        *,
        inputs: int,
        outputs: int,
        capacity: int,
        floor: float,
        relevance: Relevance = "oldest",
    ) -> None:
        self.outputs, self.relevance, self._force = outputs, relevance, prior.force
        self.gp, self._spare = (
            RecursiveGP(
                prior.kernel, prior.noise_var, input_dim=inputs, output_dim=outputs, capacity=capacity,
                tolerance=_TOLERANCE,
            )
            for _ in range(2)
        )  # fmt: skip
        self._least_noise_var = _NOISE_LEAST * self.gp.prior_variance(_ORIGIN[:inputs])
        self.floor = floor * floor
        self._levels = np.zeros((_LEVELS, outputs))
        self.excess, self.calm_excess = self._levels[_EXCESS], self._levels[_CALM]
        """Variance beyond the posterior's; and without what single errors have widened: what a sudden change must be
        compared with, for the first window that it falls into widens the bound by as much."""
        self._levels[_CALM:] = self.floor
        self._block = np.zeros(outputs + 2)
        """Sums of the present block: errors, posterior variance, windows."""
        self._age = np.zeros(capacity, dtype=np.int64)
        self._next = 0
        self._heard = -_NOISE_EVERY
        self._successor: _Successor | None = None
        self._wanted = 0
        self._fresh: list[tuple[F64, F64, Span, Point | None]] = []
        self._places, self._values = np.zeros((_POOL, inputs)), np.zeros((_POOL, outputs))
        self._spans = np.zeros((_POOL, 2), np.int64)
        self._pooled = 0
        """Points in the pool."""
        self._choice: Spread | None = None
        """Which of its older points stay when it is full: made up a little with every point from `_THINNED` on."""

    @property
    def renewing(self) -> bool:
        """A change was noticed and the points that will replace the old ones are still being collected."""
        return self._wanted > 0

    def expect(self, x: F64) -> tuple[F64, float]:
        """Mean (P,) and posterior variance at `x` (D,)."""
        mean, variance = self.gp.predict(x)
        return mean, float(variance[0])

    def bound(self, variance: float, i: int) -> float:
        """Calibrated variance of output `i` for a posterior variance."""
        return INFLATION * INFLATION * (variance + float(self.excess[i]))

    def renew(self, error: F64, points: int) -> None:
        """What was learned is no longer so, by `error` (P,): widen the bound now, forget after `points` new points."""
        self._wanted = points
        self._fresh.clear()
        np.maximum(self.excess, (_RENEW_SHARE * error) ** 2, out=self.excess)
        self._block[:] = 0.0

    def hear(self, noise_var: float) -> None:
        """Take over a window's noise as measured, where it is far from what the points were taken with.

        Never below 1e-4 of the prior's variance, where the recursion would lose digits.  That costs a factorisation, so
        a store with many points does it rarely, and some points at a time (`carry_on`).
        """
        noise_var = max(noise_var, self._least_noise_var)
        ratio = noise_var / self.gp.noise_var
        few = len(self.gp) < _FEW
        known = 1.0 / _NOISE_FACTOR < ratio < _NOISE_FACTOR or self._successor is not None
        if known or (not few and self._next < self._heard + _NOISE_EVERY):
            return
        self._heard = self._next
        self._successor = _Successor(self.gp, self._spare, noise_var)
        if few:
            while self._successor is not None:
                self.carry_on()

    def carry_on(self) -> None:
        """A few points more with the noise as measured; once all have it, it counts."""
        successor = self._successor
        if successor is not None and successor.carry_on():
            self.gp, self._spare, self._successor = successor.gp, self.gp, None

    def take(self, x: F64, y: F64, span_us: Span = (0, 0), seen: Point | None = None) -> None:
        """A new point of a window between two stamps: test the prediction with it, then learn it.

        `seen`: the window's mean as a log has it, where the point is another one: evidence in its place.
        """
        if self.renewing:
            self._fresh.append((x.copy(), y.copy(), span_us, seen))
            if len(self._fresh) < self._wanted:
                return
            self._wanted = 0
            self._successor = None
            self.gp.clear()
            self._pooled, self._choice = 0, None
            self._levels[_OUTLIER] = 0.0
            self.excess[:] = self.calm_excess
            for point in self._fresh:
                self._add(*point)
            return
        if len(self.gp):
            mean, variance = self.expect(x)
            _CALIBRATE.call(y - mean, variance, self.gp.noise_var, self.floor, self._levels, self._block)
        self._add(x, y, span_us, seen)

    def evidence(self) -> Evidence:
        """What a certificate needs of it, as of now; learning on does not change it."""
        places, values = self._places[: self._pooled].copy(), self._values[: self._pooled].copy()
        spans = self._spans[: self._pooled].copy()
        gp = self.gp
        return Evidence(gp.kernel, gp.noise_var, gp.capacity, self.excess.copy(), places, values, spans, self._force)

    def _add(self, x: F64, y: F64, span_us: Span, seen: Point | None) -> None:
        dropped = self._drop(x) if len(self.gp) >= self.gp.capacity else -1
        taken = bool(self.gp.add(x, y))
        if self._successor is not None:
            self._successor.note(dropped, x, y, taken)
        if taken:
            self._age[len(self.gp) - 1] = self._next
            self._next += 1
            pooled = self._pooled
            self._places[pooled], self._values[pooled] = seen or (x, y)
            self._spans[pooled] = span_us
            self._pooled += 1
            if self._pooled == _THINNED:
                self._choice = Spread(self._places[:_THINNED], _KEPT)
            elif self._choice is not None and not self._choice.carry_on() and self._pooled >= _POOL:
                self._thin(self._choice)

    def _thin(self, choice: Spread) -> None:
        kept = np.concatenate([choice.chosen(), np.arange(_THINNED, self._pooled)])
        self._pooled, self._choice = len(kept), None
        for held in (self._places, self._values, self._spans):
            held[: self._pooled] = held[kept]

    def _drop(self, query: F64) -> int:
        held = len(self.gp)
        index = least_relevant(self.gp, query) if self.relevance == "kernel" else int(np.argmin(self._age[:held]))
        self.gp.remove(index)
        self._age[index] = self._age[held - 1]  # the last point moved into the slot
        return index


@njit
def _calibrate(error: F64, variance: float, noise: float, floor: float, levels: F64, block: F64) -> None:
    """The rule of the header on one more window, into `levels` (5, P) and the present `block` (P + 2).

    In the calm level without single errors beyond the bound, which may be a change.
    """
    outputs = error.shape[0]
    fast_noise = noise * math.sqrt(2.0 / (2 * _MEMORY_WINDOWS))
    slow_noise = noise / _BLOCK * math.sqrt(2.0 / (2 * _MEMORY_BLOCKS))
    block[outputs] += variance
    block[outputs + 1] += 1.0
    full = block[outputs + 1] >= _BLOCK
    slowly = block[outputs] / _BLOCK + noise / _BLOCK
    for i in range(outputs):
        squared, known = error[i] * error[i], variance + noise
        most = _BOUND_SIGMAS**2 * (known + levels[_CALM, i])
        levels[_FAST, i] += (min(squared, most) - known - levels[_FAST, i]) / _MEMORY_WINDOWS
        block[i] += error[i]
        if full:
            most = _BOUND_SIGMAS**2 * (slowly + levels[_CALM, i])
            mean = block[i] / _BLOCK
            levels[_SLOW, i] += (min(mean * mean, most) - slowly - levels[_SLOW, i]) / _MEMORY_BLOCKS
        told = max(levels[_FAST, i] - _NOISE_SIGMAS * fast_noise, levels[_SLOW, i] - _NOISE_SIGMAS * slow_noise)
        levels[_CALM, i] = max(told, floor)
        beyond = (squared - _OUTLIER_SIGMAS**2 * noise) / _BOUND_SIGMAS**2 - variance
        levels[_OUTLIER, i] *= _OUTLIER_KEPT
        levels[_OUTLIER, i] = max(levels[_OUTLIER, i], beyond if beyond > levels[_EXCESS, i] else 0.0)
        levels[_EXCESS, i] = max(levels[_CALM, i], levels[_OUTLIER, i])
    if full:
        block[:] = 0.0


_CALIBRATE = Entry(_calibrate, "f8[::1], f8, f8, f8, f8[:, ::1], f8[::1]")
