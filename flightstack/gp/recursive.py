"""An exact Gaussian process over a bounded set of points that may come and go at flight rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flightstack.checked import number
from flightstack.gp import store, update
from flightstack.gp.kernels import Kernel
from flightstack.gp.panel import aligned, padded, triangle
from flightstack.gp.program import prior
from flightstack.gp.rebuild import rebuild
from flightstack.types import F64, InputError

_CAPACITY_MAX = 100_000


class Health(NamedTuple):
    """What a recursive process tells of itself."""

    rejected: int
    """Points that weren't finite, or had no finite prior variance."""
    rebuilt: int
    """Times that the inverse was computed from nothing."""
    drift: float
    """Largest residual seen since then."""
    worst_drift: float
    """Largest residual seen at all."""
    clipped: int
    """Predictions whose variance came out below what so many points can tell."""
    jitter: float
    """Most that was ever added to the noise to invert the matrix; 0 where the points and the noise sufficed."""


class RecursiveGP:
    """The exact process of zero mean on the points it holds: the same numbers as a refit, at one pass over A.

    Several outputs share kernel, noise and factorisation.  `add`, `remove` and `predict` may come in any order; what
    they cost is least where a prediction at x is followed by `remove(index)`, `add(x, y)` and the next prediction.
    After construction nothing raises on the values of numbers, only on the wrong shape of arrays.  Final.

    Source of the recursion and its numerics: `flightstack.gp.update`.
    """

    __slots__ = (
        "_arrays", "_count", "_leaving", "_program", "_query", "_real", "_rows", "_state", "_value",
        "_x_shape", "_y_shape", "capacity", "input_dim", "kernel", "noise_var", "output_dim",
    )  # fmt: skip

    def __init__(
        self,
        kernel: Kernel,
        noise_var: float,
        *,
        input_dim: int,
        output_dim: int,
        capacity: int = 300,
        drift_limit: float = 0.1,
        rebuild_steps: int = 5000,
        tolerance: float = 0.0,
    ) -> None:
        """Raises InputError on what is out of range.

        `noise_var` is the variance of the noise on each value; `capacity` the most points held: one more, and the
        oldest goes.  The inverse is computed anew where a residual exceeds `drift_limit`, and every `rebuild_steps`
        points that entered.  Where the noise is small every answer is bettered by its residual, for half as much again;
        `tolerance`: a residual, in shares of the variance, up to which only every 16th is.
        """
        self.kernel = kernel
        self.input_dim = int(number(input_dim, "input_dim", 1, 4096))
        self.output_dim = int(number(output_dim, "output_dim", 1, 4096))
        self.capacity = int(number(capacity, "capacity", 1, _CAPACITY_MAX))
        self._program = program = kernel.program(self.input_dim)
        d, p, size = self.input_dim, self.output_dim, padded(self.capacity)
        self._rows = aligned(store.rows_needed(d, p), size)
        self._state = np.zeros(store.ORDER + 2 * self.capacity + len(program.ints), np.int64)
        self._real = np.zeros(store.reals_needed(d, p) + len(program.floats))
        self._state[[store.CAPACITY, store.INPUTS, store.OUTPUTS]] = self.capacity, d, p
        self._state[store.PERIOD] = int(number(rebuild_steps, "rebuild_steps", 1, 1e12))
        self._state[store.ORDER + 2 * self.capacity :] = program.ints
        self._real[store.LIMIT] = number(drift_limit, "drift_limit", 0.0, 1e9)
        self._real[store.TOLERANCE] = number(tolerance, "tolerance", 0.0, 1e9)
        self._real[store.reals_needed(d, p) :] = program.floats
        self._arrays = (aligned(2, triangle(size)), self._rows, self._state, self._real)
        parts = np.split(self._real[store.QUERY : store.reals_needed(d, p)], np.cumsum([d, d, d]))
        self._query, _, _, self._value = parts
        self._x_shape, self._y_shape = (d,), (p,)
        self.restart(noise_var)

    def __len__(self) -> int:
        return self._count

    @property
    def x(self) -> F64:
        """(N, D) the points, by index; a copy."""
        return self._held(store.POINTS, self.input_dim)

    @property
    def y(self) -> F64:
        """(N, P) their values, by index; a copy."""
        return self._held(store.POINTS + self.input_dim, self.output_dim)

    @property
    def health(self) -> Health:
        """Counters and residuals since construction."""
        s, r = self._state, self._real
        return Health(
            int(s[store.REJECTED]), int(s[store.REBUILT]), float(r[store.DRIFT]), float(r[store.WORST]),
            int(s[store.CLIPPED]), float(r[store.JITTER]),
        )  # fmt: skip

    def restart(self, noise_var: float) -> None:
        """Forget all points and go on with another noise; the counters stay."""
        self.noise_var = self._real[store.NOISE] = number(noise_var, "noise_var", 1e-50, 1e50)
        self.clear()

    def clear(self) -> None:
        """Forget all points; the counters stay."""
        self._count, self._leaving = 0, -1
        self._state[
            [store.COUNT, store.HIGH, store.PENDING, store.KNOWN, store.UNCHECKED, store.STEPS, store.ALARM]
        ] = 0
        self._state[store.ORDER : store.ORDER + self.capacity] = np.arange(self.capacity)
        self._real[[store.DRIFT, store.LATEST]] = 0.0, math.inf
        self._rows[:] = 0.0

    def add(self, x: F64 | Sequence[float], y: F64 | Sequence[float] | float) -> int:
        """Take one point x (D,) with y (P,), or M points (M, D) with (M, P); how many were taken.

        A point that isn't finite is left out and counted in `health.rejected`.  Where the store is full the oldest
        point goes first.  A point held already is held twice, as two measurements.
        """
        if (
            type(x) is not np.ndarray
            or type(y) is not np.ndarray
            or x.shape != self._x_shape
            or y.shape != self._y_shape
        ):
            return self._add_any(np.asarray(x, np.float64), np.asarray(y, np.float64))
        self._query[:] = x
        self._value[:] = y
        leaving, self._leaving = self._leaving, -1
        taken = bool(update.ENTER.call(*self._arrays, leaving))
        self._count += taken and self._count < self.capacity
        return int(taken)

    def remove(self, index: int | Sequence[int]) -> None:
        """Let one point go, or several; raises InputError where there is none.

        The last point takes the index of the one that left.  Several indices mean the points as they stand before.
        """
        if not isinstance(index, (int, np.integer)):
            for each in sorted({int(i) for i in index}, reverse=True):
                self.remove(each)
            return
        if not 0 <= index < self._count:
            raise InputError(f"remove: index {index} is not held; there are {self._count} points, from index 0")
        if self._leaving >= 0:
            self._settle()
        self._leaving = int(index)  # waits: with the next point it leaves in one pass
        self._count -= 1

    def predict(self, x: F64 | Sequence[float]) -> tuple[F64, F64]:
        """Mean and latent variance (without the noise), (P,) each at x (D,), or (M, P) each at (M, D).

        Without points, or far from them, that is zero and the prior variance.  NaN where x isn't finite.
        """
        if type(x) is np.ndarray and x.shape == self._x_shape:
            answer = np.empty((2, self.output_dim))
            answer[1] = self.predict_into(np.ascontiguousarray(x, np.float64), answer[0])
            return answer[0], answer[1]
        xs = np.asarray(x, np.float64)
        if xs.ndim == 1:
            return self.predict(self._shaped(xs, self._x_shape, "x"))
        pairs = [self.predict(each) for each in xs]
        shape = (len(xs), self.output_dim)
        mean, variance = (np.reshape([pair[i] for pair in pairs], shape) for i in (0, 1))
        return mean, variance

    def predict_into(self, x: F64, mean: F64) -> float:
        """`predict` for callers in a hurry: the mean at x (D,) into `mean` (P,), both contiguous; the variance."""
        if self._leaving >= 0:
            self._settle()
        variance: float = update.PREDICT.call(x, mean, *self._arrays)
        return variance

    def predict_along(self, x: F64 | Sequence[float], x_rate: F64 | Sequence[float]) -> tuple[F64, F64]:
        """Mean (P,) at x (D,), and its time derivative (P,) where x moves at x_rate (D,); much cheaper than `predict`.

        NaN where either isn't finite.
        """
        mean, mean_rate = np.empty((2, self.output_dim))
        at, along = self._shaped(x, self._x_shape, "x"), self._shaped(x_rate, self._x_shape, "x_rate")
        self.predict_along_into(np.ascontiguousarray(at), np.ascontiguousarray(along), mean, mean_rate)
        return mean, mean_rate

    def predict_along_into(self, x: F64, x_rate: F64, mean: F64, mean_rate: F64) -> None:
        """`predict_along` for callers in a hurry: into `mean` and `mean_rate` (P,), all four contiguous."""
        if self._leaving >= 0:
            self._settle()
        update.ALONG.call(x, x_rate, mean, mean_rate, self._rows, self._state, self._real)

    def prior_variance(self, x: F64 | Sequence[float]) -> float:
        """k(x, x): the variance at x (D,) before any point."""
        self._query[:] = self._shaped(x, self._x_shape, "x")
        return float(prior(self._program.ints, self._program.floats, self._query))

    def least_covariant(self, x: F64 | Sequence[float]) -> int:
        """Index of the point with the least |k(point, x)|, x (D,); of equals the oldest; 0 where nothing is held."""
        if self._leaving >= 0:
            self._settle()
        self._query[:] = self._shaped(x, self._x_shape, "x")
        return int(update.least_covariant(self._rows, self._state, self._real))

    def oldest(self) -> int:
        """Index of the point that entered first; 0 where nothing is held."""
        if self._leaving >= 0:
            self._settle()
        return int(store.oldest(self._state))

    def rebuild(self) -> None:
        """Compute the inverse from nothing now; it happens by itself when it is needed."""
        if self._leaving >= 0:
            self._settle()
        rebuild(*self._arrays)

    def _add_any(self, x: F64, y: F64) -> int:
        """`add` of what isn't arrays of a point's own shape."""
        if x.ndim == 1:
            return self.add(self._shaped(x, self._x_shape, "x"), self._shaped(np.atleast_1d(y), self._y_shape, "y"))
        if y.ndim == 1 and self.output_dim == 1:
            y = y[:, None]
        if x.ndim != 2 or y.ndim != 2 or len(x) != len(y):
            raise InputError(f"add: x {x.shape} and y {y.shape} don't fit; give (D,) and (P,), or (M, D) and (M, P)")
        self._shaped(x[:1].ravel() if len(x) else self._query, self._x_shape, "x")
        return sum(self.add(point, value) for point, value in zip(x, y, strict=True))

    def _settle(self) -> None:
        """Carry out a removal that waits."""
        update.leave(*self._arrays, self._leaving)
        self._leaving = -1

    def _held(self, first: int, count: int) -> F64:
        if self._leaving >= 0:
            self._settle()
        places = self._state[store.ORDER : store.ORDER + self._count]
        return np.ascontiguousarray(self._rows[first : first + count, places].T)

    def _shaped(self, values: F64 | Sequence[float], shape: tuple[int], name: str) -> F64:
        if type(values) is np.ndarray and values.shape == shape and values.dtype == np.float64:
            return values
        if np.shape(values) != shape:
            raise InputError(f"{name}: shape {np.shape(values)} does not fit; {shape} is wanted")
        return np.asarray(values, np.float64)
