"""What is left when all that was named is in the model, and on what it depends.

A Gaussian process for each driver, on what the named columns can't reach, says how much of the rest is a smooth
function of that driver: by its marginal likelihood against mere noise and by prediction of stretches that it has not
seen.  Nothing is named for it: the answer is a driver and a share.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.compare import residual, velocity_noise
from flightstack.gap.decisions import CLEAR_SHARE, HALF, MATTERS_MPS2, REST_EVIDENCE, SMALL_SHARE
from flightstack.gap.estimator_bias import with_bias
from flightstack.gap.naming.bench import SimulatorBench
from flightstack.gap.naming.drivers import Blocks, block_means
from flightstack.gap.naming.estimate import Estimates
from flightstack.gap.naming.whitening import Mask
from flightstack.gap.records import Samples, Unexplained
from flightstack.gap.simulate import FreeParameter, sensitivities
from flightstack.gap.track import track
from flightstack.types import F64
from flightstack.vehicle import Vehicle

BLOCK_S = 0.2
FOLDS = 6
_LENGTHS = (0.5, 1.5)
"""Length scales in standard deviations of the driver (time: shares of the flight, below)."""
_TIME_LENGTHS = (0.3, 1.0)
_RATIOS = np.array([0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0])
"""Signal to noise variance."""
_MOST_BLOCKS = 300
_REMEMBERED = ("acceleration", "rate")
"""Drivers whose past is looked at as well."""
GROUPS = {"side force": (0, 1), "lift": (2,), "torque": (3, 4, 5)}
"""Channels that belong together."""


@dataclass(frozen=True, slots=True)
class ResidualTest:
    """The rest of one group of channels."""

    before: float
    """Mean square before anything was named, in units of the noise, all channels of the group."""
    after: float
    """With all that was named."""
    driven: float
    """What of `after` the best driver predicts where it has not looked."""
    drivers: tuple[str, ...]
    """Best first; empty where nothing is significant."""
    driven_rms: float = 0.0
    """Root of `driven` in the channels' own unit."""
    by_column: tuple[float, ...] = ()
    """Mean square that one unit of each named column brings, in units of the noise."""

    @property
    def share(self) -> float:
        """Of what can be explained at all, the part that the named effects leave to the driver."""
        explained = max(self.before - self.after, 0.0)
        total = explained + self.driven
        return self.driven / total if total > 0.0 else 0.0


@dataclass(slots=True, eq=False)
class _Kernel:
    """How alike blocks are by one driver, and the eigenvalues and -vectors of that."""

    matrix: F64
    values: F64
    vectors: F64


@dataclass(slots=True, eq=False)
class _Fitted:
    """The best function of one driver."""

    evidence: float
    kernel: _Kernel | None = None
    ratios: F64 | None = None
    y: F64 | None = None

    def driven(self, fold: NDArray[np.int64]) -> float:
        """Mean square that is predicted out of sample, over all channels."""
        if self.kernel is None or self.ratios is None or self.y is None:
            return 0.0
        return _predicted(self.kernel.matrix, self.y, fold, self.ratios)


def tested_residuals(before: F64, blocks: Blocks) -> dict[str, ResidualTest]:
    """The rest of every group; `before` (B, 6) block means of the residual when nothing was named."""
    if len(blocks.y) < 40:
        return {group: ResidualTest(0.0, 0.0, 0.0, ()) for group in GROUPS}
    thin = max(1, int(np.ceil(len(blocks.y) / _MOST_BLOCKS)))
    kernels = {name: _kernels(name, x[::thin]) for name, x in blocks.drivers.items()}
    past = {name: _past_kernels(blocks.past[name][::thin]) for name in _REMEMBERED if name in blocks.past}
    return {group: _rest(before, blocks, group, thin, kernels, past) for group in GROUPS}


def _rest(
    before: F64,
    blocks: Blocks,
    group: str,
    thin: int,
    kernels: dict[str, list[_Kernel]],
    past: dict[str, list[_Kernel]],
) -> ResidualTest:
    channels = [c for c in GROUPS[group] if np.any(blocks.y[:, c]) and np.std(blocks.y[:, c]) > 0.0]
    if not channels:
        return ResidualTest(0.0, 0.0, 0.0, ())
    noise = np.array([_noise(blocks.y[:, c]) for c in channels])
    bare = _without(blocks, channels, blocks.y[:, channels] / noise, noise)
    world = bare if group == "torque" else _world_rest(blocks, channels, noise)
    fits = {name: _fitted(own, (world if name == "position" else bare)[::thin]) for name, own in kernels.items()}
    for name, own in past.items():
        late = _fitted(own, bare[::thin])
        if late.evidence > fits[name].evidence:
            fits[name] = late
    best = max(fits, key=lambda name: fits[name].evidence)
    evidence = fits[best].evidence
    driven = fits[best].driven(blocks.fold[::thin]) if evidence >= REST_EVIDENCE else 0.0
    names: tuple[str, ...] = ()
    if driven > 0.0:
        names = tuple(
            sorted((n for n in fits if fits[n].evidence >= CLEAR_SHARE * evidence), key=lambda n: -fits[n].evidence)
        )
    power_before = float(np.mean(np.sum((before[:, channels] / noise) ** 2, axis=1)))
    power_after = float(np.mean(np.sum((blocks.y[:, channels] / noise) ** 2, axis=1)))
    unit = float(np.sqrt(np.mean(noise**2)))
    shape = np.mean(np.sum((blocks.columns[:, channels, :] / noise[:, None]) ** 2, axis=1), axis=0)
    return ResidualTest(power_before, power_after, driven, names, unit * float(np.sqrt(driven)), tuple(shape.tolist()))


def _noise(y: F64) -> float:
    """Standard deviation of what changes from block to block: second differences, robustly."""
    d = np.diff(y, n=2)
    return max(float(np.median(np.abs(d)) / 0.6745 / np.sqrt(6.0)), 1e-9)


def _without(blocks: Blocks, channels: list[int], y: F64, noise: F64) -> F64:
    """(B, c) what the named columns can't reach."""
    k = blocks.columns.shape[2]
    if k == 0:
        return y
    x = (blocks.columns[:, channels, :] / noise[:, None]).reshape(-1, k)
    flat = y.reshape(-1)
    return np.asarray((flat - x @ np.linalg.lstsq(x, flat, rcond=1e-8)[0]).reshape(y.shape))


def _world_rest(blocks: Blocks, channels: list[int], noise: F64) -> F64:
    """(B, 2 or 1) level or vertical force in the world's axes, in units of the mean noise."""
    axes = [2] if channels == [2] else [0, 1]
    return blocks.world[:, axes] / float(np.sqrt(np.mean(noise**2)))


def _scaled(x: F64) -> F64 | None:
    """Columns of unit spread round 0, those that change at all; None where none does."""
    spread = x.std(axis=0)
    moves = spread > 1e-9
    return (x - x.mean(axis=0))[:, moves] / spread[moves] if np.any(moves) else None


def _kernels(name: str, x: F64) -> list[_Kernel]:
    """Of smooth functions of a driver (B, d), one for each length."""
    z = _scaled(x)
    if z is None:
        return []
    square = ((z[:, None, :] - z[None, :, :]) ** 2).sum(axis=2)
    lengths = _TIME_LENGTHS if name == "time" else _LENGTHS
    return [_decomposed(np.exp(-0.5 * square / length**2)) for length in lengths]


def _past_kernels(x: F64) -> list[_Kernel]:
    """Of linear filters of a driver's last seconds (B, lags * d): what swings remembers."""
    z = _scaled(x)
    return [] if z is None else [_decomposed(z @ z.T / z.shape[1])]


def _decomposed(kernel: F64) -> _Kernel:
    values, vectors = np.linalg.eigh(kernel)
    return _Kernel(kernel, np.maximum(values, 0.0), vectors)


def _fitted(kernels: list[_Kernel], y: F64) -> _Fitted:
    """Log likelihood ratio against noise of the best of these kernels, over all channels (B, c)."""
    centred = y - y.mean(axis=0)
    best = _Fitted(-np.inf)
    for kernel in kernels:
        evidence, ratios = _evidence(kernel, centred)
        if evidence > best.evidence:
            best = _Fitted(evidence, kernel, ratios, centred)
    return best


def _evidence(kernel: _Kernel, y: F64) -> tuple[float, F64]:
    """Sum over channels of the greatest log likelihood ratio (scale and ratio free), and the ratio of each."""
    power = (kernel.vectors.T @ y) ** 2
    n = len(y)
    null = -0.5 * n * np.log(np.maximum(power.sum(axis=0), 1e-300) / n)
    spectrum = 1.0 + _RATIOS[:, None] * kernel.values[None, :]
    scale = (1.0 / spectrum) @ power / n
    logs = -0.5 * n * np.log(np.maximum(scale, 1e-300)) - 0.5 * np.log(spectrum).sum(axis=1)[:, None] - null
    at = np.argmax(logs, axis=0)
    gains = logs[at, np.arange(y.shape[1])]
    return float(gains[gains > 0.0].sum()), np.where(gains > 0.0, _RATIOS[at], 0.0)


def _predicted(kernel: F64, y: F64, fold: NDArray[np.int64], ratios: F64) -> float:
    """Mean square of y, over all channels, that is predicted for stretches not learned from."""
    gained = 0.0
    for c, ratio in enumerate(ratios):
        if ratio == 0.0:
            continue
        error = y[:, c].copy()
        for f in np.unique(fold):
            out = fold == f
            k = kernel[np.ix_(~out, ~out)] * ratio + np.eye(int((~out).sum()))
            error[out] -= ratio * kernel[np.ix_(out, ~out)] @ np.linalg.solve(k, y[~out, c])
        gained += max(0.0, float(np.mean(y[:, c] ** 2) - np.mean(error**2)))
    return gained


def structured_residuals(
    bench: SimulatorBench, made: Estimates, rests_of: Mapping[str, ResidualTest]
) -> dict[str, ResidualTest]:
    """Groups of channels whose rest depends on something, strongly enough to matter."""
    slow = _slow_noise(bench, made.vehicle)
    return {
        group: r
        for group, r in rests_of.items()
        if r.drivers and r.share > SMALL_SHARE and r.driven_rms > max(_matters(bench, group), slow[group])
    }


def above_noise(bench: SimulatorBench, start: Vehicle, told: Mapping[str, ResidualTest]) -> dict[str, ResidualTest]:
    """Of these, what stands out of one step's noise."""
    noise = np.nan_to_num(np.array([residual(start, s).noise for s in bench.flights])).max(axis=0)
    return {g: r for g, r in told.items() if r.driven_rms > HALF * np.linalg.norm(noise[list(GROUPS[g])])}


def unexplained_given(bench: SimulatorBench, start: Vehicle, made: Estimates) -> Unexplained:
    """The rest beside a poor model's names: on what it depends; that there is one is known."""
    told = structured_residuals(bench, made, residual_tests(bench, start, made))
    return replace(unexplained(above_noise(bench, start, told)), significant=True)


def unexplained(told: Mapping[str, ResidualTest]) -> Unexplained:
    """These rests in one, the strongest driver first."""
    drivers: list[str] = []
    for r in sorted(told.values(), key=lambda r: -r.driven):
        drivers += [d for d in r.drivers if d not in drivers]
    return Unexplained(bool(told), tuple(drivers), float(max((r.share for r in told.values()), default=0.0)))


def residual_tests(bench: SimulatorBench, start: Vehicle, made: Estimates) -> dict[str, ResidualTest]:
    """What is left of each group of channels, told or not."""
    masks = [s.valid & (np.repeat(f | h, k)[: len(s.t_s)]) for s, f, h, k in _whole(bench)]
    flights = [with_bias(made.vehicle, s) for s in bench.flights]
    after = [residual(made.vehicle, s).y for s in flights]
    before = [residual(start, s).y for s in flights]
    none = [np.zeros((len(s.t_s), 6, 0)) for s in bench.flights]
    knobs = [FreeParameter(e, p) for e, p in made.slots]
    columns = [sensitivities(made.vehicle, s, knobs) for s in bench.flights] if knobs else none
    blocks = block_means(bench.flights, after, columns, masks, block_s=BLOCK_S, stretch_s=3.0, folds=FOLDS)
    first = block_means(bench.flights, before, none, masks, block_s=BLOCK_S, stretch_s=3.0, folds=FOLDS)
    return tested_residuals(first.y, blocks)


def _slow_noise(bench: SimulatorBench, vehicle: Vehicle) -> dict[str, float]:
    """What the velocity's own slow error leaves of each group through the vehicle's drag, root mean square."""
    worst = np.nan_to_num(np.array([velocity_noise(vehicle, s) for s in bench.flights])).max(axis=0)
    return {group: float(np.max(worst[list(channels)])) for group, channels in GROUPS.items()}


def _matters(bench: SimulatorBench, group: str) -> float:
    """What a remainder of this group must reach to be told, root mean square."""
    if group != "torque":
        return MATTERS_MPS2
    flown = [track(s).lowpass(track(s).measured[:, 3:6])[s.valid] for s in bench.flights]
    return SMALL_SHARE * float(np.sqrt(np.nanmean(np.concatenate(flown) ** 2)))


def _whole(bench: SimulatorBench) -> list[tuple[Samples, Mask, Mask, int]]:
    return list(zip(bench.flights, bench.fit, bench.holdout, bench.every, strict=True))
