"""Output-error refinement: the named effects' parameters fitted through many short simulations of the flight.

From measured states the simulator runs freely over windows of half a second, driven by the logged commands.  What its
accelerometer and gyro would have gathered in each twentieth of a second is set against what the real ones gathered.
Gauss-Newton on that difference, weighted by its own covariance: each channel's is taken as stationary and estimated
from the residuals (generalised least squares), and the intervals are of the sandwich kind over windows, with their
neighbours' correlation over 5 s (Newey and West, Econometrica 1987), so a coloured residual doesn't shrink them.

Four nuisances of each flight are fitted along.  When the commands acted is known to half a sample only: that shift has
a prior of a uniform distribution's width (beside a transport delay it can't be told from, it stays 0 and widens the
delay's interval).  Between their stamps commands are straight lines here, which passes less of a wave than a loop
that is faster than the log, or that holds its commands, did: that bend has a prior between these two.  Of the noise on
the commands a share is folded in by sampling, for the force and for each torque (`gap.naming.inputs`).  What is left
of the accelerometer's bias has a prior from the kinematic columns.  Sensor effects themselves are not moved: the
kinematic columns know them better.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flightstack.effects import EFFECTS
from flightstack.gap.airspeed import DRAGS, offset, share_of_motion
from flightstack.gap.chances import t_limit
from flightstack.gap.compare import residual
from flightstack.gap.decisions import BIAS_STD_MPS2, NOT_WORSE, SAMPLED_SHARE, STATE_ERRORS
from flightstack.gap.estimator_bias import bias_std
from flightstack.gap.naming.candidates import plausible
from flightstack.gap.records import Estimate, Samples
from flightstack.gap.remainder import GROUPS
from flightstack.gap.rollouts import WINDOW_S, Windows, gathered_by, rollouts, windows_of
from flightstack.gap.sampled import open_gains, timing_s
from flightstack.gap.simulate import missing_signals, natural_scale, predict, spec_of, value, with_value
from flightstack.gap.track import track
from flightstack.types import F64, InputError
from flightstack.vehicle import Vehicle

_MOST_WINDOWS = 400
_ROUNDS = 4
_STEP_SHARE = 0.05
_PRIOR_SCALES = 30.0
"""A parameter that the windows can't see stays where it was, with an interval of this many natural scales."""
_CONVERGED = 0.02
_TIMING_STEP_S = 0.001
_BLOCK_S = 4.0
_WINDS = ("north_mps", "east_mps", "down_mps")
_AXES = {"k_d_kg_per_rad": (0, 1)} | {
    f"{name}_{axis}_{unit}": (k,) for name, unit in (("d", "kgps"), ("c", "kg_per_m")) for k, axis in enumerate("xyz")
}
"""Of the body, along which each drag's parameter acts."""
_MEMORY_S = 5.0
_FOLDED = ((0, 1, 2), (3,), (4,), (5,))
"""Channels of each part of the commands' noise."""
_NUISANCES = 9
"""Shift, bend, folded shares, biases."""
_GAINS = (("thrust_scale", "scale"), *(("inertia", f"scale_{axis}") for axis in "xyz"))
_GAIN_STEP = 0.01
_GAIN_PER_S = np.array([0.05, 0.2, 0.2, 0.2])
"""How well thrust and torques are known for each second between samples, one standard deviation: never fitted."""
_BEND, _BEND_STD = 0.75, 0.25
"""Of `with_sharp_commands`, mean and deviation: a loop as fast as the log, that holds, bends half; a faster one all."""


@dataclass(frozen=True, slots=True)
class Refined:
    """The vehicle with refined parameters, their intervals, and how much later each flight's commands acted."""

    vehicle: Vehicle
    parameters: Mapping[str, Mapping[str, Estimate]]
    """Effect -> parameter -> estimate; `before` is the vehicle's own value before anything was named."""
    late_s: tuple[float, ...]
    windows: int


def refine(
    believed: Vehicle,
    vehicle: Vehicle,
    flights: Sequence[Samples],
    masks: Sequence[NDArray[np.bool_]],
    effects: Sequence[str],
    fixed: Collection[tuple[str, str]] = (),
) -> Refined | None:
    """Refine the parameters of these effects of `vehicle`, starting at its values.

    `believed`: before anything was named; `masks`: (N,) for each flight, samples to learn from; `fixed`: parameters
    that stay.  Without a physical effect it is found when the commands acted.  None where there is nothing to refine
    by: no windows, or an effect that no flight can show; and where the refined vehicle predicts a single step worse
    than the one it began with, as it may with a structure that is wrong.
    """
    unknowns = [
        (effect, p.name)
        for effect in effects
        if EFFECTS[effect].kind != "sensor" and effect != "turbulence"
        for p in EFFECTS[effect].params
        if not p.integer and not math.isnan(value(vehicle, effect, p.name)) and (effect, p.name) not in fixed
    ]
    problem = _Problem(vehicle, unknowns, flights, masks)
    if problem.count <= len(unknowns) + 2:
        return None
    theta, covariance = problem.solve()
    # A sum over neighbours has this many degrees of freedom (Bartlett's kernel: 3/2 of the windows over its reach).
    freedom = 1.5 * problem.count / max(1.5, max(_reach(len(w.starts)) for w in problem.windows))
    half = STATE_ERRORS * t_limit(max(freedom, 2.0)) * np.sqrt(np.diag(covariance))
    found: dict[str, dict[str, Estimate]] = {}
    for k, (effect, parameter) in enumerate(unknowns):
        found.setdefault(effect, {})[parameter] = bounded(believed, effect, parameter, float(theta[k]), float(half[k]))
    shifts = theta[len(unknowns) :: _NUISANCES]
    late = tuple(s.command_late_s + float(x) for s, x in zip(flights, shifts, strict=True))
    refined = problem.vehicle_at(theta)
    shifted = [replace(s, command_late_s=x) for s, x in zip(flights, late, strict=True)]
    if np.any(_one_step(refined, shifted, masks) > NOT_WORSE * _one_step(vehicle, flights, masks)):
        return None
    return Refined(refined, found, late, problem.count)


def _one_step(vehicle: Vehicle, flights: Sequence[Samples], masks: Sequence[NDArray[np.bool_]]) -> F64:
    """(groups,) one-step rms over all flights: side force, lift, torque; 0 where no flight measures it."""
    y = np.concatenate([residual(vehicle, s).y[mask, :6] for s, mask in zip(flights, masks, strict=True)])
    known = np.isfinite(y)
    power = np.where(known, y, 0.0) ** 2
    parts = [list(channels) for channels in GROUPS.values()]
    return np.array([np.sqrt(power[:, c].sum() / max(int(known[:, c].sum()), 1)) for c in parts])


def bounded(believed: Vehicle, effect: str, parameter: str, estimate: float, reach: float) -> Estimate:
    """A parameter with its interval, which holds nothing that can't be: no mass lies beyond the rotors."""
    low, high = plausible(believed, effect, parameter)
    before = value(believed, effect, parameter)
    return Estimate(
        before, estimate, min(estimate, max(estimate - reach, low)), max(estimate, min(estimate + reach, high))
    )


def _limits(effect: str, parameter: str) -> tuple[float, float]:
    spec = spec_of(effect, parameter)
    return spec.minimum, spec.maximum


def _bias_prior(vehicle: Vehicle, samples: Samples, mask: NDArray[np.bool_]) -> tuple[F64, F64]:
    """Mean and standard deviation (3,) of the accelerometer's bias beyond the vehicle's, m/s^2."""
    flight = track(samples)
    none = np.zeros(3), np.full(3, 1e-6)
    if "accel_frd_mps2" in flight.missing:
        return none
    believed = bias_std(vehicle, samples)
    if believed.any():  # the estimator's tilt cancels it in the kinematic columns
        return np.zeros(3), believed
    y = residual(vehicle, samples).y[mask & flight.usable, 9:12]
    length = round(_BLOCK_S / samples.dt_s)
    blocks = [y[k : k + length].mean(axis=0) for k in range(0, len(y) - length + 1, length)]
    if len(blocks) < 3 or not np.isfinite(blocks).all():
        return np.zeros(3), np.full(3, BIAS_STD_MPS2)
    seen = np.var(blocks, axis=0, ddof=1) / len(blocks)
    trust = BIAS_STD_MPS2**2 / (BIAS_STD_MPS2**2 + seen)
    return trust * np.mean(blocks, axis=0), np.sqrt(trust * seen)


class _Problem:
    """Parameters (K) and each flight's nuisances (`_NUISANCES`) as one vector, over all windows."""

    def __init__(
        self,
        vehicle: Vehicle,
        unknowns: Sequence[tuple[str, str]],
        flights: Sequence[Samples],
        masks: Sequence[NDArray[np.bool_]],
    ) -> None:
        self._vehicle, self._unknowns = vehicle, unknowns
        most = max(1, _MOST_WINDOWS // max(len(flights), 1))
        usable = [
            "motor" not in track(s).missing and not any(missing_signals(s, effect) for effect, _ in unknowns)
            for s in flights
        ]
        self.windows = [
            windows_of(vehicle, s, m if ok else m & False, most)
            for s, m, ok in zip(flights, masks, usable, strict=True)
        ]
        self.count = sum(len(w.starts) for w in self.windows)
        scales = [natural_scale(vehicle, effect, parameter) for effect, parameter in unknowns]
        self._delayed = ("transport_delay", "delay_s") in unknowns
        own = np.array([value(vehicle, *unknown) for unknown in unknowns])
        limits = np.array([_limits(*unknown) for unknown in unknowns]).reshape(-1, 2)
        means, stds, steps, reach = [own], [_PRIOR_SCALES * np.array(scales)], [_STEP_SHARE * np.array(scales)], []
        for s, mask in zip(flights, masks, strict=True):
            bias, bias_std = _bias_prior(vehicle, s, mask)
            shift_std = 1e-9 if self._delayed else s.dt_s / math.sqrt(12.0)
            means.append(np.array([0.0, _BEND, 0.0, 0.0, 0.0, 0.0, *bias]))
            stds.append(np.array([shift_std, _BEND_STD, 1.0, 1.0, 1.0, 1.0, *bias_std]))
            steps.append(np.array([_TIMING_STEP_S, *np.ones(_NUISANCES - 1)]))
            reach.append(np.array([s.dt_s, 2.0, 5.0, 5.0, 5.0, 5.0, 10.0, 10.0, 10.0]))
        self._start, self._prior_std, self._step = np.concatenate(means), np.concatenate(stds), np.concatenate(steps)
        self._low = np.concatenate([limits[:, 0], *[-r for r in reach]])
        self._high = np.concatenate([limits[:, 1], *reach])
        self._offset = np.mean([offset(s, m) for s, m in zip(flights, masks, strict=True)], axis=0)
        shares = [share_of_motion(s, m & s.valid) for s, m in zip(flights, masks, strict=True)]
        windows = np.array([len(w.starts) for w in self.windows])
        self._slope = windows @ np.array(shares) / max(self.count, 1) ** 2
        self._sampling_s = max((s.dt_s for s in flights), default=0.0)

    def vehicle_at(self, theta: F64) -> Vehicle:
        """The vehicle with these parameters."""
        changed = self._vehicle
        for (effect, parameter), x in zip(self._unknowns, theta, strict=False):
            changed = with_value(changed, effect, {parameter: float(x)})
        return changed

    def solve(self) -> tuple[F64, F64]:
        """Estimate and covariance of all parameters and nuisances."""
        theta = self._start.copy()
        covariance = np.diag(self._prior_std**2)
        for _ in range(_ROUNDS):
            parts = [self._linear(theta, f) for f in range(len(self.windows))]
            change, covariance = self._step_from(theta, parts)
            moved = np.clip(theta + change, self._low, self._high)
            try:
                self.vehicle_at(moved)
            except InputError:
                moved = theta + 0.5 * (moved - theta)
            done = np.max(np.abs(moved - theta) / np.maximum(np.sqrt(np.diag(covariance)), 1e-12)) < _CONVERGED
            theta = moved
            if done:
                break
        shift = self._considered(theta)
        covariance = covariance + shift @ shift.T
        for k, (effect, parameter) in enumerate(self._unknowns):
            if effect == "transport_delay":
                covariance[k, k] += self._sampling_s**2 / 12.0
            elif effect == "motor_lag":
                covariance[k, k] += timing_s(self._sampling_s) ** 2
            elif effect == "inertia":
                covariance[k, k] += SAMPLED_SHARE**2
            elif effect == "slung_load" and parameter == "length_m":
                covariance[k, k] += (SAMPLED_SHARE * theta[k]) ** 2
            elif effect in DRAGS:
                # each window starts with an error of the velocity of its own
                covariance[k, k] += self._slope[list(_AXES[parameter])].mean() * theta[k] ** 2
            elif effect == "steady_wind":
                covariance[k, k] += self._offset[_WINDS.index(parameter)] ** 2
        return theta, covariance

    def _linear(self, theta: F64, f: int) -> tuple[F64, F64]:
        """Residual (S, n, 6) and its derivatives by parameters and nuisances (S, n, 6, K + 9 F) of one flight."""
        windows = self.windows[f]
        jacobian = np.zeros((*windows.gathered.shape, len(theta)))
        if len(windows.starts) == 0:
            return windows.gathered, jacobian
        late = len(self._unknowns) + _NUISANCES * f
        own = [*range(len(self._unknowns)), late]
        sign = np.where(theta + self._step > self._high, -1.0, 1.0)
        points = [theta] + [theta + sign[k] * self._step[k] * np.eye(len(theta))[k] for k in own]
        reach_s = windows.edges[-1] * windows.flight.samples.dt_s
        variants = [(self.vehicle_at(x), float(x[late])) for x in points]
        runs = rollouts(variants, windows.flight.samples, windows.starts, reach_s)
        sharp, smooth = (
            rollouts(variants[:1], other, windows.starts, reach_s)[0] for other in (windows.sharp, windows.smooth)
        )
        base = gathered_by(runs[0], windows)
        for k, run in zip(own, runs[1:], strict=True):
            jacobian[..., k] = (gathered_by(run, windows) - base) / (sign[k] * self._step[k])
        jacobian[..., late + 1] = gathered_by(sharp, windows) - base
        quiet = gathered_by(smooth, windows) - base
        for part, channels in enumerate(_FOLDED):
            jacobian[:, :, channels, late + 2 + part] = quiet[:, :, channels]
        span = np.diff(windows.edges) * windows.flight.samples.dt_s
        for axis in range(3):
            jacobian[:, :, axis, late + 6 + axis] = span
        linear = slice(late + 1, late + _NUISANCES)
        y = windows.gathered - base - jacobian[..., linear] @ theta[linear]
        # The first piece's change of rate holds the start's own error with the opposite sign: that looks like damping.
        return y[:, 1:], jacobian[:, 1:]

    def _considered(self, theta: F64) -> F64:
        """(K, 4) how far gains of thrust and torques that nobody knows move the estimate (Schmidt, 1966)."""
        count = len(self._unknowns)
        information = np.diag(1.0 / self._prior_std**2)
        cross = np.zeros((len(theta), len(_GAINS)))
        for f, windows in enumerate(self.windows):
            if len(windows.starts) == 0:
                continue
            y, x = self._linear(theta, f)
            gains = self._gains(theta, f)
            white = _whitened(y, np.concatenate([x, gains], axis=-1))[1]
            own, other = white[..., : len(theta)], white[..., len(theta) :]
            information += np.einsum("srck,srcl->kl", own, own)
            cross += np.einsum("srck,srcl->kl", own, other * self._gain_sizes(windows))
        out = np.zeros((len(theta), len(_GAINS)))
        out[:count] = (_inverse(information) @ cross)[:count]
        return out

    def _gain_sizes(self, windows: Windows) -> F64:
        """(4,) how far gains of thrust and torques may be off, one standard deviation."""
        flight = windows.flight
        base, calm = (flight.lowpass(predict(self._vehicle, s)) for s in (flight.samples, windows.smooth))
        open_ = np.append(0.0, open_gains(base, calm - base, flight.usable))
        return np.asarray(_GAIN_PER_S * flight.samples.dt_s + open_)

    def _gains(self, theta: F64, f: int) -> F64:
        """(S, n, 6, 4) derivatives by gains of thrust and torques of one flight."""
        windows, base = self.windows[f], self.vehicle_at(theta)
        late = float(theta[len(self._unknowns) + _NUISANCES * f])
        # at the upper end of a range the step goes down
        signs = [-1.0 if value(base, e, p) * (1.0 + _GAIN_STEP) > _limits(e, p)[1] else 1.0 for e, p in _GAINS]
        turned = [
            with_value(base, e, {p: value(base, e, p) * (1.0 + sign * _GAIN_STEP)})
            for sign, (e, p) in zip(signs, _GAINS, strict=True)
        ]
        reach_s = windows.edges[-1] * windows.flight.samples.dt_s
        runs = rollouts([(v, late) for v in (base, *turned)], windows.flight.samples, windows.starts, reach_s)
        still, *moved = (gathered_by(run, windows) for run in runs)
        return np.stack(
            [(each - still) / (sign * _GAIN_STEP) for sign, each in zip(signs, moved, strict=True)], axis=-1
        )[:, 1:]

    def _step_from(self, theta: F64, parts: Sequence[tuple[F64, F64]]) -> tuple[F64, F64]:
        """Gauss-Newton step and the sandwich covariance, all windows of all flights together."""
        information = np.diag(1.0 / self._prior_std**2)
        score = (self._start - theta) / self._prior_std**2
        meat = information.copy()
        for y, x in parts:
            white_y, white_x = _whitened(y, x)
            each = np.einsum("src,srck->sk", white_y, white_x)
            information += np.einsum("srck,srcl->kl", white_x, white_x)
            score += each.sum(axis=0)
            step = np.linalg.lstsq(information, score, rcond=None)[0]
            left = np.einsum("src,srck->sk", white_y - white_x @ step, white_x)
            meat += left.T @ left
            reach = _reach(len(left))
            for lag in range(1, reach + 1):
                neighbours = left[lag:].T @ left[:-lag]
                meat += (1.0 - lag / (reach + 1.0)) * (neighbours + neighbours.T)
        inverse = _inverse(information)
        return inverse @ score, inverse @ meat @ inverse


def _inverse(information: F64) -> F64:
    """Of a normal matrix of unknowns of very different size."""
    scale = 1.0 / np.sqrt(np.diag(information))
    return np.asarray(scale[:, None] * np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-12) * scale)


def _reach(windows: int) -> int:
    """How many windows later a residual may still remember: attitude and position drift for seconds."""
    return max(0, min(round(_MEMORY_S / WINDOW_S), windows // 6))


def _whitened(y: F64, x: F64) -> tuple[F64, F64]:
    """Residual (S, n, 6) and columns (S, n, 6, K) so that the residual's pieces are of unit variance and independent.

    A first regression takes out what the parameters explain: the noise is what is left.
    """
    flat_x, flat_y = x.reshape(-1, x.shape[-1]), y.ravel()
    weight = 1.0 / np.maximum(np.std(y, axis=(0, 1)), 1e-9)
    rows = np.broadcast_to(weight, y.shape).ravel()
    norm = np.maximum(np.linalg.norm(flat_x * rows[:, None], axis=0), 1e-300)
    fit = np.linalg.lstsq(flat_x * rows[:, None] / norm, flat_y * rows, rcond=1e-8)[0] / norm
    rest = y - x @ fit
    white_y, white_x = np.zeros_like(y), np.zeros_like(x)
    for c in range(y.shape[2]):
        if not np.isfinite(y[:, :, c]).all():
            continue
        factor = _factor(rest[:, :, c])
        white_y[:, :, c] = np.linalg.solve(factor, y[:, :, c].T).T
        columns = np.moveaxis(x[:, :, c], 1, 0).reshape(y.shape[1], -1)
        solved = np.linalg.solve(factor, columns).reshape(y.shape[1], y.shape[0], -1)
        white_x[:, :, c] = np.moveaxis(solved, 0, 1)
    return white_y, white_x


def _factor(rest: F64) -> F64:
    """Cholesky factor of the stationary covariance of (S, n) residual pieces, tapered so that it is positive."""
    n = rest.shape[1]
    covariance = np.array([np.mean(rest[:, : n - j] * rest[:, j:]) for j in range(n)]) * (1.0 - np.arange(n) / n)
    covariance[0] = max(covariance[0], 1e-18)
    matrix = covariance[np.abs(np.subtract.outer(np.arange(n), np.arange(n)))] + 1e-3 * covariance[0] * np.eye(n)
    least = float(np.linalg.eigvalsh(matrix)[0])
    if least < 1e-3 * covariance[0]:
        matrix += (1e-3 * covariance[0] - least) * np.eye(n)
    return np.asarray(np.linalg.cholesky(matrix))
