"""What the learned processes say of the true acceleration: exact posteriors, frozen, for many queries at once.

A learner's store is copied once (`Process`) and factorised once (`Posterior`); then a query costs one triangular solve
(Rasmussen, Williams 2006, algorithm 2.1): K + noise I = L L', mean = k' (L L')^-1 y, variance k(x, x) - |L^-1 k|^2.

From residuals to accelerations.  A store's outputs are the specific force (m/s^2) that the model does not explain, in
tilt axes (`learning.sampler`): for a thrust vector f (believed newton per believed kilogram, NED, thrust is -f), its
direction b = f / |f| and x as `query_inputs` has it

    a = g e_d - f + R(b) (residual(x) - D R(b)' v),      R(b): the shortest turn of down onto b, D = drag / mass

so that a's standard deviation along an axis is that of a row of R(b) times three independent outputs; x and y share
one store's variance, each with its own i_B, excess and remainder.  The calibrated variance of an output is i_B^2
variance + excess, the latter as in the learner's own bound (`learning.store`), and beside it there is what no named
effect explains, rho (1 + sum |w|), w the posterior weights of the points (`confidence`).

Noise is white, and wanders besides (`Drift`): what an accelerometer's bias or a slow gust does is the same for windows
that are seconds apart, and taken for white it looks like a function of the path.  The points' covariance is then
K + noise I + variance exp(-|t_i - t_j| / time); of an acceleration yet to come the variance is excess like any other.

A force up or down is a constant along the thrust axis and, as -b_n w_d and -b_e w_d, a line in the lean across it.  The
learner's prior has it small (vertically it trades against thrust's own error) or not at all, and its smooth part stands
in for it, which says nothing where nothing was flown.  A certificate asks the points whether there is one.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.linalg import lapack

from flightstack.barrier.confidence import ALLOWANCE, colour
from flightstack.barrier.initial import DOWN
from flightstack.barrier.process import DRIFT_S, Drift, Process
from flightstack.barrier.query_inputs import along
from flightstack.barrier.sizes import SHARES, SmoothSizes
from flightstack.gp import Kernel, Matern, SquaredExponential, program
from flightstack.gp.gram import alike, linear_columns, lower_triangle, parts
from flightstack.gp.kernels import Product, Sum
from flightstack.learning.learner import LearnerState, Learnt
from flightstack.learning.sampler import GROUND, THRUST, D
from flightstack.learning.store import INFLATION, Evidence, Store
from flightstack.model import Model
from flightstack.types import F64, I64, STANDARD_GRAVITY_MPS2

__all__ = ["Accelerations", "Drift", "Live", "Posterior", "Process", "sized_steps"]

_LIKELY = 1.92
"""Of the log likelihood: half the 95 % quantile of chi squared with one degree of freedom."""
_NEGLIGIBLE = 1e-18
_NOISES = ((1.0, 0.0), (1.0, 0.25), (1.5, 0.25), (1.0, 1.0))
"""Of what noise may be: its variance in shares of the measured one, and drift's in shares of that."""
_CHUNK = 64
_COLOURED = 500
"""Windows whose residuals are looked at: half a minute."""
_NEWEST = 100
"""Points, some seconds."""
_LEAST_GROUND = 0.5
"""Of Cheeseman and Bennett's, one standard deviation of a prior that knows the ground."""


class Posterior:
    """A process factorised; final, holds only constants."""

    __slots__ = ("_factor", "_gram", "_linear", "_program", "_together", "_weights", "process")

    def __init__(self, process: Process, gram: F64 | None = None, together: F64 | None = None) -> None:
        """`gram` (N, N): the kernel of the points, `together` (N, N): correlations of drift; both as in `gp.gram`."""
        self.process, self._program = process, process.kernel.program(process.x.shape[1])
        self._gram = lower_triangle(process.kernel, process.x) if gram is None else gram
        self._together = together
        self._linear: tuple[I64, F64, F64] | None = None
        self._factor, failed = lapack.dpotrf(self._noisy(0.0), lower=1, clean=0, overwrite_a=1)
        if failed:  # points that coincide to the last digit: a little more noise
            size = float(np.trace(self._gram)) + len(self._gram) * (process.noise_var + process.drift.variance)
            self._factor, _ = lapack.dpotrf(self._noisy(1e-9 * size), lower=1, clean=0, overwrite_a=1)
        self._weights = lapack.dpotrs(self._factor, process.y, lower=1)[0]

    def _noisy(self, more: float) -> F64:
        """(N, N) covariance of the values, of variances so much larger."""
        drift, noisy = self.process.drift, self._gram.copy(order="K")
        if drift.variance > 0.0:
            if self._together is None:
                self._together = self.process.correlations
            noisy = np.multiply(self._together, drift.variance, noisy)
            noisy += self._gram
        diagonal = noisy.ravel(order="K")[:: len(noisy) + 1]
        diagonal[:] = np.diagonal(self._gram) + self.process.noise_var + drift.variance + more
        return noisy

    @property
    def log_likelihood(self) -> float:
        """Of the values, all outputs together, up to a constant (Rasmussen and Williams, equation 2.30)."""
        fit, size = float(np.sum(self.process.y * self._weights)), float(np.log(np.diagonal(self._factor)).sum())
        return -0.5 * fit - float(self.process.y.shape[1]) * size

    def widened(self, x: F64, y: F64) -> Posterior:
        """The same, the excess at least what values y (M, P) at x (M, D) are off by beyond their noise."""
        if not len(x):
            return self
        error = y - self.mean(x)
        beyond = INFLATION**2 * (np.einsum("ij,ij->j", error, error) / len(x) - self.process.noise_var)
        return self._with(replace(self.process, excess=np.maximum(self.process.excess, beyond)))

    def coloured_steps(self, evidence: Evidence, crosses: list[F64]) -> Iterator[Posterior]:
        """The same with the colour that the newest windows' residuals show; valid after the last piece of work.

        `crosses`: the kernel between points and windows, a piece each; worked out where it is not there yet.
        """
        x, y = evidence.pooled(_COLOURED)
        off: list[F64] = []
        for k, start in enumerate(range(0, len(x), _CHUNK)):
            yield self
            part = slice(start, start + _CHUNK)
            if k == len(crosses):
                crosses.append(self._cross(x[part]))
            mean = crosses[k].T @ self._weights
            off.append(y[part] - mean - self._drifted(evidence.spans_us[-_COLOURED:][part]))
        if off:
            found = colour(np.concatenate(off), evidence.spans_us[-_COLOURED:], self.process.noise_var)
            yield self._with(replace(self.process, colour=found))

    def raised(self) -> Posterior:
        """The same with white noise as strong as the spectrum's peak, in place of an inflation of all of the deviation.

        Noise of a spectrum nowhere above v moves a weighted mean of the points by no more than white noise of v does,
        so the posterior variance at v bounds the error's for its own weights: k - 2 w'k + w'(K + C) w <= s^2 where
        C <= v I.  What the points do not reach is the prior's, which no noise makes larger.
        """
        share = float(self.process.colour.inflation.max()) ** 2 / ALLOWANCE
        if share <= 1.0:
            return self
        noisier = replace(self.process, noise_var=share * self.process.noise_var)
        return Posterior(noisier, self._gram, self._together)

    def _drifted(self, spans_us: I64) -> F64:
        """(M, P) what noise has most likely wandered to in windows with these stamps (M, 2)."""
        process = self.process
        if process.drift.variance == 0.0:
            return np.zeros((len(spans_us), process.y.shape[1]))
        found: F64 = process.drift.between(spans_us[:, 1], process.spans_us[:, 1]) @ self._weights
        return found

    def _with(self, process: Process) -> Posterior:
        other = object.__new__(Posterior)
        other.process, other._program = process, self._program
        other._factor, other._weights = self._factor, self._weights
        other._gram, other._together, other._linear = self._gram, self._together, self._linear
        return other

    def _cross(self, x: F64) -> F64:
        """(N, M) covariances of the points with x (M, D)."""
        return program.matrix(self._program, self.process.x, np.ascontiguousarray(x))

    def weight_sums(self, x: F64) -> F64:
        """(M,) sum of the absolute weights that a mean gives to the points."""
        cross = self._cross(x)
        weights, _ = lapack.dpotrs(self._factor, cross, lower=1)
        found: F64 = np.abs(weights).sum(axis=0)
        return found

    def mean(self, x: F64) -> F64:
        """(M, P) at x (M, D): the same as of `at`, at a third of its cost."""
        mean: F64 = self._cross(x).T @ self._weights
        return mean

    def at(self, x: F64) -> tuple[F64, F64]:
        """Means (M, P) and latent variance (M,) at x (M, D).

        What the kernel has a column in by itself and linearly alone, thrust, costs nothing: with z = L^-1 k at thrust 0
        and Z = L^-1 dk/dx, solved once, it is z + Z x.
        """
        columns, slopes, solved_slopes = self._linear or self._solved_slopes()
        places, first = alike(x, columns)
        base, linear = x[first], x[:, columns]
        base[:, columns] = 0.0
        cross = self._cross(base)
        solved, _ = lapack.dtrtrs(self._factor, cross, lower=1)
        mean: F64 = (cross.T @ self._weights)[places] + linear @ (slopes.T @ self._weights)
        known = np.einsum("ij,ij->j", solved, solved)[places]
        if len(columns):
            known += np.einsum("ij,ij->i", linear, 2.0 * (solved.T @ solved_slopes)[places])
            known += np.einsum("ij,ij->i", linear @ (solved_slopes.T @ solved_slopes), linear)
        return mean, np.maximum(program.diagonal(self._program, np.ascontiguousarray(x)) - known, 0.0)

    def _solved_slopes(self) -> tuple[I64, F64, F64]:
        """Columns in which the kernel is linear and no more, slopes (N, columns) of covariances along them, solved."""
        columns, variances = linear_columns(self._program, self.process.x.shape[1])
        slopes = np.asfortranarray(self.process.x[:, columns] * variances)
        found = columns, slopes, lapack.dtrtrs(self._factor, slopes, lower=1)[0] if len(columns) else slopes
        self._linear = found
        return found


def sized_steps(process: Process) -> Iterator[Posterior | None]:
    """The process with its smooth part as large as its points leave likely: None after each piece of work, then it.

    Sizes are tried from the prior's down, each with every noise, the likeliest of which counts; all of it without and
    with a force up or down, and with one if the likeliest of all has it.  See `knowledge`.
    """
    dated, force = len(process.spans_us) > 0, process.force
    times_s = np.asarray(1e-6 * process.spans_us[:, 1] if dated else np.zeros(len(process.x)), np.float64)
    known = parts(process.kernel, process.x)
    sizes = SmoothSizes(
        known.root, known.smooth, process.y, process.noise_var, times_s, DRIFT_S,
        None if force is None else parts(force, process.x).root,
    )  # fmt: skip
    together = process.correlations if dated and not sizes.worth_it else None
    tried: dict[tuple[bool, float], tuple[float, float, float]] = {}
    forces = (process,) if force is None else (process, replace(process, kernel=process.kernel + force))
    for forced, share in itertools.product(range(len(forces)), SHARES):
        found, gram = list[tuple[float, float, float]](), None
        for white, drift in _NOISES if dated else _NOISES[:1]:
            noise_var = white * process.noise_var
            drift_var = drift * noise_var
            if sizes.worth_it:
                likely = sizes.log_likelihood(share, noise_var, drift_var, bool(forced))
            else:
                trial = _sized(forces[forced], share, noise_var, drift_var)
                gram = lower_triangle(trial.kernel, trial.x) if gram is None else gram
                likely = Posterior(trial, gram, together).log_likelihood
            found.append((likely, noise_var, drift_var))
            yield None
        tried[bool(forced), share] = max(found, key=lambda each: each[0])
        yield None
    likeliest = max(tried, key=lambda key: tried[key][0])
    least = tried[likeliest][0] - _LIKELY
    share = max(s for (forced, s), (likely, *_) in tried.items() if forced == likeliest[0] and likely >= least)
    sized = _sized(forces[likeliest[0]], share, *tried[likeliest[0], share][1:])
    beyond = INFLATION**2 * sized.drift.variance
    yield Posterior(replace(sized, excess=np.maximum(sized.excess, beyond)))


def _sized(process: Process, share: float, noise_var: float, drift_var: float) -> Process:
    """The process with a share of its smooth part, and with such noise."""
    kernel = _scaled(process.kernel, share) if share < 1.0 else process.kernel
    return replace(process, kernel=kernel, noise_var=noise_var, drift=Drift(drift_var))


def _scaled(kernel: Kernel, by: float) -> Kernel:
    """The kernel with the variance of every stationary leaf times `by`."""
    if isinstance(kernel, Sum | Product):
        return type(kernel)(_scaled(kernel.left, by), _scaled(kernel.right, by))
    if isinstance(kernel, SquaredExponential | Matern):
        return replace(kernel, variance=kernel.variance * by)
    return kernel


class Live:
    """The same answers from a learner's own recursion: nothing to factorise, good until its next point."""

    __slots__ = ("_gp", "process")

    def __init__(self, store: Store) -> None:
        self.process, self._gp = Process.of(store, store.gp.x, store.gp.y), store.gp

    def at(self, x: F64) -> tuple[F64, F64]:
        """As Posterior."""
        mean, variance = self._gp.predict(x)
        return mean, variance[:, 0]

    def weight_sums(self, x: F64) -> F64:
        """As Posterior: of a process without a remainder nobody asks."""
        raise NotImplementedError


class Accelerations:
    """The true acceleration as both processes see it; final, holds only constants."""

    __slots__ = ("_drag_per_s", "lateral", "vertical")

    def __init__(self, lateral: Posterior | Live, vertical: Posterior | Live, model: Model) -> None:
        self.lateral, self.vertical = lateral, vertical
        x, y, z = model.drag_kgps
        self._drag_per_s = np.array([0.5 * (x + y), 0.5 * (x + y), z]) / model.mass_kg

    @classmethod
    def live(cls, state: LearnerState, model: Model) -> Accelerations:
        """From what a learner holds now, for use at once."""
        return cls(Live(state.lateral), Live(state.vertical), model)

    @classmethod
    def frozen_steps(cls, state: LearnerState | Learnt, model: Model) -> Iterator[Accelerations | None]:
        """From each store's certificate set, the smooth part sized by it: None after each piece of work.

        What the newest points are off by beyond their noise widens the bound: a drift since the oldest of the set.
        """
        found: list[Posterior] = []
        before: Evidence | None = None
        for store in (state.lateral, state.vertical):
            evidence = store.evidence()
            if before is None or not evidence.is_where(before):  # both mostly hear of the same windows
                before, chosen = evidence, evidence.chosen(evidence.capacity)
            copy = Process.resting_on(evidence, chosen)
            yield None
            sized: Posterior | None = None
            for piece in sized_steps(copy):
                sized = piece
                yield None
            assert sized is not None
            evidence, crosses = store.evidence(), list[F64]()
            for posterior in sized.coloured_steps(evidence, crosses):
                sized = posterior
                yield None
            sized = sized.widened(*evidence.pooled(_NEWEST)).raised()
            for posterior in sized.coloured_steps(evidence, crosses):
                sized = posterior
                yield None
            found.append(sized)
        yield cls(found[0], found[1], model)

    def knows_ground(self, near: float) -> bool:
        """Whether the vertical prior lets the ground do half of Cheeseman and Bennett's or more, one deviation."""
        x = np.zeros((2, D))
        x[:, THRUST], x[1, GROUND] = 1.0, near
        far, close = self.vertical.process.kernel.diagonal(x).tolist()
        return bool(close - far >= (_LEAST_GROUND * near * STANDARD_GRAVITY_MPS2) ** 2)

    def at(self, axis: int, speed: F64, thrust: F64, near: F64) -> tuple[F64, F64, F64]:
        """Mean, standard deviation and remainder (M,) along an axis.

        At velocities (M, 3), thrust vectors f (M, 3) and nearness (M,).
        With upright thrust the down axis sees the vertical process alone, which saves half the work.
        """
        x, shares, mean = along(axis, speed, np.ascontiguousarray(thrust), near, self._drag_per_s)
        mean += STANDARD_GRAVITY_MPS2 if axis == DOWN else 0.0
        variance, rest = np.zeros(len(x)), np.zeros(len(x))
        for process, columns in ((self.lateral, slice(0, 2)), (self.vertical, slice(2, 3))):
            share = shares[:, columns]
            if share.any():
                residual, spread = process.at(x)
                mean += (share * residual).sum(axis=1)
                known = process.process.colour
                calibrated = known.inflation**2 * spread[:, None] + process.process.excess
                variance += (share * share * calibrated).sum(axis=1)
                if known.remainder_mps2.any():
                    rest += np.abs(share) @ known.remainder_mps2 * (1.0 + process.weight_sums(x))
        return mean, np.sqrt(variance), rest
