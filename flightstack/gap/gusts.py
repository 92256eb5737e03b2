"""Turbulence as a variance component: what the named effects leave, through the known drag, against Dryden's gusts.

A gust has no mean, so it has no column; it shows in how the rest of the force hangs together.  With D the force that a
metre per second of wind makes (the columns of a steady wind at this vehicle), the rest of blocks i and j correlates as

    E[y_i y_j'] = sigma^2 sum_a D_ia rho_a(s_ij / L) D_ja' + noise,    s: distance flown through the air

rho_a = exp(-x) along the wind, (1 - x/2) exp(-x) across and vertical (MIL-F-8785C's low-altitude form, one sigma and
one length, as the simulator flies them).  Sigma, L and noise are judged by their likelihood on a grid; 95 % intervals
are those of that grid.  Turbulence is named where this beats plain noise clearly, and beats every other law that a
force of unknown origin may follow: one of place, airspeed or time, one that swings, or a wind that begins in
mid-flight (`gap.stepping`).

What is named beside it has columns.  They are fitted with the rest's own covariance, and the likelihood is that of what
they can't reach (restricted maximum likelihood: Patterson and Thompson, Biometrika 1971): a wind that is fitted as if
gusts were noise takes their mean with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.chances import chi2_tail
from flightstack.gap.compare import residual
from flightstack.gap.decisions import (
    CLEAR_EVIDENCE,
    GUST_SPREAD_OUT,
    LEAST_AIRSPEED_MPS,
    LEAST_SIGMA_MPS,
    SLOW_ERROR_S,
)
from flightstack.gap.estimator_bias import is_freed
from flightstack.gap.naming.drivers import quantities
from flightstack.gap.records import Estimate, IdentifiedEffect, Samples
from flightstack.gap.simulate import FreeParameter, sensitivities, spec_of
from flightstack.gap.stepping import stepping_wind
from flightstack.gap.track import track
from flightstack.types import F64
from flightstack.vehicle import Vehicle

_BLOCK_S = 0.2
_MOST_BLOCKS = 180
_FEWEST_BLOCKS = 60
_LENGTHS_M = np.geomspace(2.0, 400.0, 15)
_RATIOS = np.geomspace(1e-4, 1e8, 97)
_SPAN = (0.5, 1.5)
_PERIODS_S = np.geomspace(0.8, 12.0, 9)
_USUAL_LENGTH_M, _LENGTH_SPREAD = 25.0, 1.0
"""Gusts near the ground: median and spread of the length's logarithm, 5 to 70 m; a minute tells little of it."""
_PARTS = 4
"""Into which a block is cut for the mean of a correlation."""
_QUANTILES = (0.025, 0.5, 0.975)
_WIND = tuple(FreeParameter("steady_wind", f"{axis}_mps") for axis in ("north", "east", "down"))


@dataclass(frozen=True, slots=True)
class Gusts:
    """Turbulence by the flights' own rest."""

    sigma_mps: Estimate
    length_m: Estimate
    evidence: float
    """Logarithm of the likelihood ratio against noise alone."""
    other: float
    """The same of the best other law."""
    force_rms_mps2: float
    """Of one step: what the gusts make through the drag, all three axes together."""
    turning_rms_radps2: float
    """The same of the angular acceleration: drag acts at the hubs."""
    beside: F64
    """(K,) how far the parameters beside it are from the vehicle's, in their units."""
    covariance: F64
    """(K, K) of these, gusts being what they are."""

    @property
    def named(self) -> bool:
        """Whether the rest is turbulence rather than noise or another law."""
        return (
            self.evidence > CLEAR_EVIDENCE
            and self.evidence > self.other + CLEAR_EVIDENCE
            and self.sigma_mps.low > 0.0
            and self.sigma_mps.estimate >= LEAST_SIGMA_MPS
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """B blocks of all flights: rest and drag columns in units of the noise, and where, when and how far flown."""

    y: F64
    """(B, 3)."""
    drag: F64
    """(B, 3, 3): force axis, wind axis (along the mean wind, across, down)."""
    turn: F64
    """(B, 3, 3): world to body, in units of the noise."""
    t_s: F64
    flown_m: F64
    across_m: F64
    """(B,) flown within each."""
    place: F64
    """(B, 3) m."""
    airspeed: F64
    """(B, 3) body, m/s."""
    flight: NDArray[np.int64]
    beside: F64
    """(3 B, K) columns of the parameters beside it."""
    turning: F64
    """(B,) angular acceleration of a gust of 1 m/s on each axis, rad/s^2."""
    unit_mps2: float


def gusts(
    vehicle: Vehicle,
    flights: Sequence[Samples],
    masks: Sequence[NDArray[np.bool_]],
    beside: Sequence[FreeParameter] = (),
) -> Gusts | None:
    """Turbulence in what `vehicle` leaves of these samples; None where no drag or too little shows it.

    `beside`: K parameters that are fitted with it; what no force shows of them stays as it is.
    """
    blocks = _blocks(vehicle, flights, masks, beside)
    if blocks is None or len(blocks.t_s) < _FEWEST_BLOCKS or not np.any(blocks.drag):
        return None
    same = blocks.flight[:, None] == blocks.flight[None, :]
    fits = [_profile(_dryden(blocks, float(length)), blocks) for length in _LENGTHS_M]
    logs, noise = np.stack([fit.logs for fit in fits]), np.stack([fit.noise for fit in fits])
    usual = -0.5 * (np.log(_LENGTHS_M / _USUAL_LENGTH_M) / _LENGTH_SPREAD) ** 2
    weight = logs / GUST_SPREAD_OUT + usual[:, None]
    weight = np.exp(weight - weight.max())
    weight /= weight.sum()
    sigma = np.sqrt(_RATIOS[None, :]) * noise
    best = np.unravel_index(int(np.argmax(logs)), logs.shape)
    told = _estimate(sigma.ravel(), weight.ravel(), "sigma_mps")
    length = _estimate(np.broadcast_to(_LENGTHS_M[:, None], logs.shape).ravel(), weight.ravel(), "length_m")
    made = np.sqrt(np.mean(np.sum(blocks.drag**2, axis=(1, 2)))) * blocks.unit_mps2
    turned = np.sqrt(np.mean(blocks.turning**2)) * float(told.estimate)
    moved, covariance = _mixed(
        weight.ravel(), np.concatenate([f.beside for f in fits]), np.concatenate([f.covariance for f in fits])
    )
    force = float(made * told.estimate)
    other = max(
        _other_laws(blocks, same, freed=any(is_freed(s) for s in flights)),
        stepping_wind(blocks.y.reshape(-1), blocks.beside, blocks.drag, blocks.flight, blocks.t_s, _RATIOS),
    )
    return Gusts(told, length, float(logs[best]), other, force, float(turned), moved, covariance)


def _mixed(weight: F64, means: F64, covariances: F64) -> tuple[F64, F64]:
    """Mean (K,) and covariance (K, K) of a mixture of normals (G,)."""
    mean = weight @ means
    off = means - mean
    return mean, np.einsum("g,gij->ij", weight, covariances) + np.einsum("g,gi,gj->ij", weight, off, off)


def _dryden(blocks: _Blocks, length_m: float) -> F64:
    """Covariance of the rest (3 B, 3 B) by gusts of 1 m/s and this length, as means over blocks show them."""
    flown = blocks.flown_m[:, None] - blocks.flown_m[None, :]
    own = 0.5 * (blocks.across_m[:, None] + blocks.across_m[None, :])
    same = blocks.flight[:, None] == blocks.flight[None, :]
    along, across = np.zeros(flown.shape), np.zeros(flown.shape)
    for k in range(1 - _PARTS, _PARTS):
        x = np.abs(flown + own * k / _PARTS) / length_m
        share = (_PARTS - abs(k)) / _PARTS**2 * np.exp(-x) * same
        along += share
        across += (1.0 - 0.5 * x) * share
    return _kernel(blocks.drag, [along, across, across])


def _blocks(
    vehicle: Vehicle,
    flights: Sequence[Samples],
    masks: Sequence[NDArray[np.bool_]],
    beside: Sequence[FreeParameter],
) -> _Blocks | None:
    parts = []
    units = [np.nan_to_num(residual(vehicle, s).noise[:3]) for s in flights]
    for number, (s, mask, unit) in enumerate(zip(flights, masks, units, strict=True)):
        flight = track(s)
        if {"vel_ned_mps", "q_ned_frd", "pos_ned_m"} & flight.missing or not np.all(unit > 0.0):
            continue
        y = residual(vehicle, s).y[:, :3]
        blown_on = np.nan_to_num(sensitivities(vehicle, s, _WIND))
        drag, turning = blown_on[:, :3], np.sqrt(np.sum(blown_on[:, 3:6] ** 2, axis=(1, 2)))
        columns = np.nan_to_num(sensitivities(vehicle, s, beside)[:, :3]) if beside else np.zeros((len(y), 3, 0))
        wind = vehicle.effects.get("steady_wind", {})
        blown = np.array([wind.get(knob.parameter, 0.0) for knob in _WIND])
        drag = drag @ _turned(blown)
        speed = np.maximum(np.linalg.norm(np.nan_to_num(flight.vel_ned_mps) - blown, axis=1), LEAST_AIRSPEED_MPS)
        size = max(1, round(_BLOCK_S / s.dt_s))
        good = mask & s.valid & np.isfinite(y).all(axis=1)
        count = len(good) // size
        whole: NDArray[np.bool_] = np.asarray(good[: count * size].reshape(count, size).all(axis=1))

        def mean(values: F64, size: int = size, count: int = count, whole: NDArray[np.bool_] = whole) -> F64:
            cut = values[: count * size].reshape(count, size, *values.shape[1:])
            return np.asarray(cut.mean(axis=1)[whole])

        parts.append(
            (
                mean(np.nan_to_num(y)) / unit,
                mean(drag) / unit[:, None],
                mean(np.swapaxes(_to_world(s), 1, 2)) / unit[:, None],
                mean(s.t_s[:, None])[:, 0],
                mean(np.cumsum(speed)[:, None] * s.dt_s)[:, 0],
                mean(speed[:, None])[:, 0] * size * s.dt_s,
                mean(np.nan_to_num(s.pos_ned_m)),
                mean(quantities(s)["airspeed"]),
                np.full(int(whole.sum()), number),
                mean(columns) / unit[:, None],
                mean(turning[:, None])[:, 0],
            )
        )
    if not parts:
        return None
    whole_parts = [np.concatenate(each) for each in zip(*parts, strict=True)]
    thin = max(1, -(-len(whole_parts[0]) // _MOST_BLOCKS))
    y, drag, turn, t_s, flown, within, place, airspeed, number_of, x, turning = (each[::thin] for each in whole_parts)
    unit_mps2 = float(np.sqrt(np.mean(np.array([u for u in units if np.all(u > 0.0)]) ** 2)))
    flat = x.reshape(3 * len(y), -1)
    return _Blocks(
        y, drag, turn, t_s, flown, within, place, airspeed, number_of.astype(np.int64), flat, turning, unit_mps2
    )


def _turned(wind_ned_mps: F64) -> F64:
    """(3, 3) from axes along the mean wind, across and down to NED; without a wind along is north."""
    level = float(np.hypot(wind_ned_mps[0], wind_ned_mps[1]))
    cos, sin = (wind_ned_mps[:2] / level) if level > 0.0 else (1.0, 0.0)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _to_world(samples: Samples) -> F64:
    """(N, 3, 3) body to world."""
    w, x, y, z = track(samples).q_ned_frd.T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1),
        ],
        axis=1,
    )


def _kernel(loads: F64, correlations: Sequence[F64]) -> F64:
    """(3 B, 3 B) covariance of unit processes (one for each last axis of the loads) seen through loads (B, 3, A)."""
    count = len(loads)
    total = np.zeros((3 * count, 3 * count))
    for a, correlation in enumerate(correlations):
        load = loads[:, :, a].reshape(-1)
        total += np.outer(load, load) * np.repeat(np.repeat(correlation, 3, axis=0), 3, axis=1)
    return total


def as_found(blown: Gusts, gap_power: float) -> IdentifiedEffect:
    """Turbulence among the names; `gap_power`: what is left of the force beyond the floor, mean square."""
    share = 1.0 if gap_power <= 0.0 else min(1.0, blown.force_rms_mps2**2 / gap_power)
    return IdentifiedEffect(
        "turbulence",
        {"sigma_mps": blown.sigma_mps, "length_m": blown.length_m},
        -2.0 * blown.evidence,
        share,
        chi2_tail(2, 2.0 * blown.evidence),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Profile:
    """One law of the rest, by each of R ratios of variances."""

    logs: F64
    """(R,) log likelihood ratio against noise alone."""
    noise: F64
    """(R,) the noise's deviation."""
    beside: F64
    """(R, K) coefficients of the columns beside it."""
    covariance: F64
    """(R, K, K) of these."""


def _profile(kernel: F64, blocks: _Blocks) -> _Profile:
    """The restricted likelihood of a rest with this covariance, and what the columns beside it come to."""
    values, vectors = np.linalg.eigh(kernel)
    size = np.linalg.norm(blocks.beside, axis=0)
    seen = size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)
    y, x = vectors.T @ blocks.y.reshape(-1), vectors.T @ (blocks.beside[:, seen] / size[seen])
    spectrum = 1.0 + _RATIOS[:, None] * np.maximum(values, 0.0)[None, :]
    spectrum = np.concatenate([np.ones((1, len(y))), spectrum])  # noise alone comes first
    gram = np.einsum("ni,rn,nj->rij", x, 1.0 / spectrum, x, optimize=True) + 1e-12 * np.eye(x.shape[1])
    inverse = np.linalg.inv(gram)
    theta = np.einsum("rij,rj->ri", inverse, ((1.0 / spectrum) * y) @ x)
    n = len(y) - x.shape[1]
    scale = (1.0 / spectrum) @ y**2 - np.einsum("ri,rij,rj->r", theta, gram, theta)
    scale = np.maximum(scale, 1e-300) / n
    logs = -0.5 * (n * np.log(scale) + np.log(spectrum).sum(axis=1) + np.linalg.slogdet(gram)[1])
    whole = np.zeros((len(_RATIOS), len(size)))
    whole[:, seen] = theta[1:] / size[seen]
    covariance = np.zeros((len(_RATIOS), len(size), len(size)))
    covariance[np.ix_(range(len(_RATIOS)), seen.nonzero()[0], seen.nonzero()[0])] = (
        scale[1:, None, None] * inverse[1:] / np.outer(size[seen], size[seen])
    )
    return _Profile(logs[1:] - logs[0], np.sqrt(scale[1:]), whole, covariance)


def _estimate(values: F64, weight: F64, parameter: str) -> Estimate:
    """Median and 95 % interval of a parameter by its posterior on the grid."""
    spec = spec_of("turbulence", parameter)
    order = np.argsort(values)
    share, ordered = np.cumsum(weight[order]), values[order]
    low, middle, high = (float(ordered[min(int(np.searchsorted(share, q)), len(order) - 1)]) for q in _QUANTILES)
    within = [float(np.clip(v, spec.minimum, spec.maximum)) for v in (low, middle, high)]
    before = 0.0 if spec.null is None else float(spec.null)
    return Estimate(before, within[1], within[0], within[2])


def _other_laws(blocks: _Blocks, same: NDArray[np.bool_], *, freed: bool) -> float:
    """Log likelihood ratio of the best other law: of place or airspeed, a drift with time, a force that swings.

    `freed`: an estimator's idea of its accelerometer's bias was subtracted, which wanders along the level body axes.
    """
    lag = np.abs(blocks.t_s[:, None] - blocks.t_s[None, :])
    long_s = max(float(blocks.t_s.std()), 1.0)
    laws = _smooth_in(blocks.place)
    laws += [np.exp(-0.5 * (lag / (share * long_s)) ** 2) * same for share in (0.1, 0.3, 1.0)]
    laws += [np.cos(2.0 * np.pi * lag / p) * np.exp(-lag / (4.0 * p)) * same for p in _PERIODS_S]
    body = np.broadcast_to(np.diag(np.linalg.norm(blocks.turn[0], axis=1)), blocks.turn.shape)
    lift = body * np.array([0.0, 0.0, 1.0])  # what a thrust does that is not what it was
    slow = [np.exp(-0.5 * (lag / (share * long_s)) ** 2) * same for share in (0.3, 1.0)]
    slow += [np.exp(-lag / (share * long_s)) * same for share in (0.3, 3.0)]
    pairs = [(blocks.turn, law) for law in laws] + [(body, law) for law in _smooth_in(blocks.airspeed)]
    pairs += [(lift, law) for law in slow]
    pairs += [(body - lift, np.exp(-lag / SLOW_ERROR_S) * same)] if freed else []
    return max(float(_profile(_kernel(loads, [law] * 3), blocks).logs.max()) for loads, law in pairs)


def _smooth_in(x: F64) -> list[F64]:
    """Correlations (B, B) of smooth functions of a quantity (B, d), by its spread."""
    spread = x.std(axis=0)
    moved = x[:, spread > 1e-3] / spread[spread > 1e-3]
    if not moved.shape[1]:
        return []
    square = ((moved[:, None, :] - moved[None, :, :]) ** 2).sum(axis=2)
    return [np.exp(-0.5 * square / length**2) for length in _SPAN]
