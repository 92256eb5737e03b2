"""Looking for the worst over the unit cube: ask for points, tell their margins (less is worse), until enough is known.

Each is a pure function of its seed and of what it was told, so a search that was cut off goes on where it stopped.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from scipy.special import ndtr

from flightstack.cli.campaign.searching import CMA_ES, CROSS_ENTROPY, UNIFORM, Search
from flightstack.errors import InputError
from flightstack.types import F64

_ELITE = 0.2
_SMOOTHING = 0.7
_LEAST_STD = 0.02
_UNIFORM = 0.1
"""Share of a generation that is drawn at random: what was missed at first can still be found."""
_LEVEL = 0.2
"""Share of a level's samples that goes on to the next."""
_STEP = 0.8
"""Correlation of a sample with the one it came from, in standard normal space."""
_MOST_LEVELS = 20


class Optimiser(Protocol):
    """One method."""

    finished: bool

    def ask(self) -> F64:
        """(n, d) points in the unit cube."""

    def tell(self, margins: F64) -> None:
        """(n,) margins of the points that were asked for; infinite where there is none."""

    def summary(self) -> dict[str, Any]:
        """What the method itself knows."""


def make(search: Search, dimensions: int, seed: int) -> Optimiser:
    """The method of a search over so many dimensions."""
    if search.method == CROSS_ENTROPY:
        return CrossEntropy(dimensions, search.population or max(10, 2 * dimensions), seed)
    if search.method == CMA_ES:
        return CmaEs(dimensions, search.population or 4 + int(3 * math.log(dimensions + 1)), seed)
    if search.method == UNIFORM:
        return Uniform(dimensions, search.population or 20, seed)
    limit = -search.below if search.maximise else search.below
    return Splitting(dimensions, search.population or 100, seed, limit)


class Uniform:
    """Points at random, whatever was told: what a search is measured against."""

    finished = False

    def __init__(self, dimensions: int, population: int, seed: int) -> None:
        self._shape, self._rng = (population, dimensions), np.random.default_rng([23, seed])

    def ask(self) -> F64:
        """A generation."""
        return self._rng.random(self._shape)

    def tell(self, margins: F64) -> None:
        """Nothing is learned."""

    def summary(self) -> dict[str, Any]:
        """Nothing."""
        return {}


class CrossEntropy:
    """Normal distributions moved towards the worst fifth of each generation (Rubinstein and Kroese 2004)."""

    def __init__(self, dimensions: int, population: int, seed: int) -> None:
        self._count, self._rng = population, np.random.default_rng([20, seed])
        self._mean, self._std = np.full(dimensions, 0.5), np.full(dimensions, math.inf)
        self._points = np.zeros((0, dimensions))
        self._best: list[tuple[float, F64]] = []
        self.finished = False

    def ask(self) -> F64:
        """A generation."""
        shape = (self._count, len(self._mean))
        uniform = self._rng.random(shape)
        normal = self._rng.standard_normal(shape)
        if not np.isfinite(self._std).all():
            self._points = uniform
            return uniform
        points = _reflected(self._mean + self._std * normal)
        drawn = self._rng.random(self._count) < _UNIFORM
        points[drawn] = uniform[drawn]
        self._points = points
        return points

    def tell(self, margins: F64) -> None:
        """The elite is the worst of all generations so far, as many as a fifth of one."""
        known = [(float(m), p) for m, p in zip(margins, self._points, strict=True) if math.isfinite(m)]
        self._best = sorted([*self._best, *known], key=lambda each: each[0])[: max(2, round(_ELITE * self._count))]
        if len(self._best) < 2:
            return
        elite = np.array([point for _, point in self._best])
        mean, std = elite.mean(axis=0), np.maximum(elite.std(axis=0), _LEAST_STD)
        if np.isfinite(self._std).all():
            mean = _SMOOTHING * mean + (1.0 - _SMOOTHING) * self._mean
            std = _SMOOTHING * std + (1.0 - _SMOOTHING) * self._std
        self._mean, self._std = mean, std

    def summary(self) -> dict[str, Any]:
        """Nothing of its own."""
        return {}


def _reflected(points: F64) -> F64:
    """Points folded back into the unit cube."""
    folded = np.mod(points, 2.0)
    return np.where(folded > 1.0, 2.0 - folded, folded)


class CmaEs:
    """Covariance matrix adaptation (Hansen), by the package `cma`."""

    def __init__(self, dimensions: int, population: int, seed: int) -> None:
        try:
            import cma
        except ImportError:
            raise InputError("method = \"cma-es\" needs cma: pip install 'flightstack[search]'") from None
        self._one = dimensions == 1  # the package wants two or more
        width = 2 if self._one else dimensions
        options = {"bounds": [0.0, 1.0], "popsize": population, "seed": seed % 2**31 + 1, "verbose": -9}
        self._strategy = cma.CMAEvolutionStrategy([0.5] * width, 0.3, options)
        self._points: list[Any] = []
        self._worst = 1.0
        self.finished = False

    def ask(self) -> F64:
        """A generation."""
        self._points = self._strategy.ask()
        points: F64 = np.clip(np.array(self._points), 0.0, 1.0)
        return points[:, :1] if self._one else points

    def tell(self, margins: F64) -> None:
        """What has no margin counts as the best that was seen."""
        finite = margins[np.isfinite(margins)]
        self._worst = max(self._worst, float(finite.max())) if finite.size else self._worst
        self._strategy.tell(self._points, np.where(np.isfinite(margins), margins, self._worst).tolist())
        self.finished = bool(self._strategy.stop())

    def summary(self) -> dict[str, Any]:
        """Generations and why it ended, where it did."""
        return {"generations": int(self._strategy.countiter), "ended": ", ".join(self._strategy.stop())}


class Splitting:
    """Subset simulation (Au and Beck 2001): levels that a fifth reaches each; the product is the probability."""

    def __init__(self, dimensions: int, population: int, seed: int, limit: float) -> None:
        self._count, self._limit = population, limit
        self._chains = max(2, round(_LEVEL * population))
        self._rng = np.random.default_rng([21, seed])
        self._proposed = self._rng.standard_normal((population, dimensions))
        self._samples: list[tuple[float, F64]] = []
        self._current: list[tuple[float, F64]] = []
        self._level = math.inf
        self._shares: list[float] = []
        self.finished = False

    def ask(self) -> F64:
        """The first level's samples, or the next of every chain."""
        points: F64 = ndtr(self._proposed)
        return points

    def tell(self, margins: F64) -> None:
        """A chain moves where its new sample is within the level."""
        told = [(float(m), z) for m, z in zip(margins, self._proposed, strict=True)]
        if self._current:
            told = [new if new[0] <= self._level else old for new, old in zip(told, self._current, strict=True)]
        self._samples += told
        self._current = told
        if len(self._samples) >= self._count:
            self._next_level()
        if not self.finished:
            spread = math.sqrt(1.0 - _STEP**2)
            noise = self._rng.standard_normal((len(self._current), self._proposed.shape[1]))
            self._proposed = _STEP * np.array([z for _, z in self._current]) + spread * noise

    def _next_level(self) -> None:
        ordered = sorted(self._samples, key=lambda each: each[0])
        reached = sum(margin < self._limit for margin, _ in ordered)
        if reached >= self._chains or len(self._shares) >= _MOST_LEVELS:
            self._shares.append(reached / len(ordered))
            self.finished = True
            return
        self._shares.append(self._chains / len(ordered))
        self._current = ordered[: self._chains]
        self._level = max(self._current[-1][0], self._limit)
        self._samples = []

    def summary(self) -> dict[str, Any]:
        """The probability, and its relative error where the samples of a level were independent (a lower bound)."""
        if not self.finished:
            return {"probability": None, "levels": len(self._shares)}
        variance = sum((1.0 - p) / (p * self._count) for p in self._shares if p > 0.0)
        product = math.prod(self._shares)
        return {"probability": product, "relative_error": math.sqrt(variance), "levels": len(self._shares)}
