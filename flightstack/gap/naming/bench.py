"""The flights as a bench (`gap.naming.design.Bench`): residuals and columns through the simulator, thinned out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from flightstack.gap import airspeed, estimator_bias, voltage
from flightstack.gap.compare import residual
from flightstack.gap.estimator_bias import is_freed
from flightstack.gap.naming.inputs import with_sharp_commands, with_smooth_commands
from flightstack.gap.naming.whitening import Mask
from flightstack.gap.records import Samples
from flightstack.gap.remembered import Remembered
from flightstack.gap.run import params_row
from flightstack.gap.sampled import loop_noise, open_gains, timing_s
from flightstack.gap.simulate import FreeParameter, evaluated_every, predict, prediction_error, sensitivities, timing
from flightstack.gap.track import track
from flightstack.types import F64
from flightstack.vehicle import Vehicle

_GAINS = (FreeParameter("thrust_scale", "scale"), *(FreeParameter("inertia", f"scale_{axis}") for axis in "xyz"))
_LAG = (FreeParameter("motor_lag", "time_constant_s"),)
_GAIN_PER_S = np.array([0.05, 1.0, 1.0, 1.0])
"""Of those gains, one standard deviation for each second between samples."""
_GAIN_PER_NOISE = np.array([250.0, 250.0, 0.0])
"""Of the torques' gains besides, for each unit of the variance of the commands' noise.  Of PX4's simulator (0.018 of
full thrust, 8 %) moments of inertia come out 1 to 7 % too large, lags up to 12 ms short (`gap_px4 bent`)."""
_LAG_S_PER_NOISE, _DELAY_S_PER_NOISE = 50.0, 15.0
"""And of lag and delay with which commands turn into roll and pitch."""
_FOLDED = ((0, 1, 2), (3,), (4,), (5,))
"""Channels of each part of the commands' noise."""
_ROWS_PER_CUTOFF = 2.5
"""Rows a second for each hertz that the common low-pass lets through: above twice, nothing is lost."""
_MOST_KNOWN = 64
_MOST_ROWS = 12_000
"""Of all flights together, four minutes at 50 a second: of longer logs fewer are taken.

What is true of every row is true of every second one; only intervals get wider, and these rows are enough to name.
"""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatorBench:
    """Several flights at their own rates, each thinned to what its low-pass leaves."""

    flights: tuple[Samples, ...]
    calm: tuple[Samples, ...]
    """The same with smooth commands (`gap.naming.inputs`)."""
    every: tuple[int, ...]
    """Samples for each row, by flight."""
    fit: list[Mask]
    holdout: list[Mask]
    mute: frozenset[str] = frozenset()
    """Effects that none of the flights can show beside what the vehicle's model lacks."""
    trifles: float = 1.0
    """Of the candidates' negligible sizes, the share at which each is taken to be there (`candidates.trifle`)."""
    _known: Remembered[list[F64]] = field(default_factory=lambda: Remembered(_MOST_KNOWN), repr=False)
    """By the vehicle's parameters: a search comes back to its fits again and again."""

    def residual(self, vehicle: Vehicle) -> list[F64]:
        """Measured minus simulated (N, 12) of each flight, NaN where it can't be had; not to be written to."""
        return self._known(lambda: self._residual(vehicle), depends=params_row(vehicle, 1.0).tobytes())

    def _residual(self, vehicle: Vehicle) -> list[F64]:
        out = []
        for s, k in zip(self.flights, self.every, strict=True):
            flight = track(s)
            y = prediction_error(vehicle, s)[0][::k].copy()
            y[~flight.usable[::k]] = np.nan
            y.flags.writeable = False
            out.append(y)
        return out

    def columns(self, vehicle: Vehicle, knobs: Sequence[FreeParameter]) -> list[F64]:
        """Derivatives of the simulated (N, 12, K) of each flight; 0 of what it can't show."""
        out = []
        for s, k in zip(self.flights, self.every, strict=True):
            shown = sensitivities(vehicle, s, knobs, k)
            shown[:, :, [i for i, knob in enumerate(knobs) if knob.effect in self.mute]] = 0.0
            out.append(shown)
        return out

    def nuisance(self, vehicle: Vehicle) -> tuple[list[F64], F64, Mask]:
        """Columns (N, 12, K) of what no log tells, how large each may be, and whether it is fitted (K,).

        When the commands really acted; what they did between their stamps, as a curve and (a log in step with the
        loop sees each period at the same phase) as a gain of thrust and of each torque; and how much of their
        unsteadiness is folded in by sampling, for the force and for each torque: the change if none were real; where
        that is most of a torque, a loop's answers to its own noise are left, and the torque's gain is open.  And how
        much of the level velocity is its error, and by what it is off in the mean.
        """
        columns, freed = [], any(is_freed(s) for s in self.flights)
        for s, calm, k in zip(self.flights, self.calm, self.every, strict=True):
            late = timing(vehicle, s)[::k, :, None]
            base = predict(vehicle, s)
            change = track(s).lowpass(predict(vehicle, calm) - base)[::k]
            bent = track(s).lowpass(predict(vehicle, with_sharp_commands(s)) - base)[::k, :, None]
            folded = np.zeros((*change.shape, len(_FOLDED)))
            for j, channels in enumerate(_FOLDED):
                folded[:, channels, j] = change[:, channels]
            gains = np.nan_to_num(sensitivities(vehicle, s, _GAINS, k))
            gains[:, 3:, 0] = 0.0
            shown = track(s).lowpass(base)[::k]
            noise = loop_noise(s)
            more = open_gains(shown, change, track(s).usable[::k]) + _GAIN_PER_NOISE * noise
            gains[:, :, 1:] *= 1.0 + more / (_GAIN_PER_S[1:] * s.dt_s)
            lag = np.zeros((len(late), late.shape[1], 2))
            if noise:
                of_lag = [_LAG_S_PER_NOISE * sensitivities(vehicle, s, _LAG, k), _DELAY_S_PER_NOISE * late]
                lag[:, 3:5] = noise * np.nan_to_num(np.concatenate(of_lag, axis=2)[:, 3:5])
            unsure = airspeed.doubt(vehicle, s)[::k]
            off = airspeed.offset_columns(vehicle, s)[::k]
            columns.append(np.concatenate([late, bent, folded, gains, lag, unsure, off], axis=2))
            if freed:
                columns[-1] = np.concatenate([columns[-1], estimator_bias.columns(vehicle, s, k)], axis=2)
        period = float(np.mean([s.dt_s for s in self.flights]))
        sizes = [timing_s(period), 1.0, *([1.0] * len(_FOLDED)), *(_GAIN_PER_S * period).tolist(), 1.0, 1.0, 1.0, 1.0]
        offsets = [airspeed.offset(s, s.valid) for s in self.flights]
        sizes += np.maximum(np.mean(offsets, axis=0), 1e-6).tolist()  # 0: nothing says how far, and the columns are 0
        at = np.arange(columns[0].shape[2])
        never = len(sizes) - 3 + np.arange(3)
        fitted = (at > 0) & ~np.isin(at, never)  # when commands acted is the delay itself, and an offset a wind
        sizes += [1.0] * (len(at) - len(sizes))
        return columns, np.array(sizes), fitted

    def rate(self, flight: int) -> float:
        """Rows a second of one flight."""
        return 1.0 / (self.flights[flight].dt_s * self.every[flight])


def simulator_bench(
    vehicle: Vehicle, flights: Sequence[Samples], fit: Sequence[Mask], holdout: Sequence[Mask], *, trifles: float = 1.0
) -> SimulatorBench:
    """The bench of these flights; masks (N,) by flight: samples to learn from and samples to judge by."""
    every = _every(flights)
    off = [residual(vehicle, s).y[:, 2] for s in flights]
    lift = [float(np.sqrt(np.mean(y[np.isfinite(y)] ** 2))) if np.isfinite(y).any() else 0.0 for y in off]
    mute = set() if any(voltage.tells(s, rms) for s, rms in zip(flights, lift, strict=True)) else {"battery_sag"}
    mute |= set() if any(airspeed.moves(s) for s in flights) else airspeed.DRAGS
    return SimulatorBench(
        tuple(flights),
        tuple(with_smooth_commands(s, vehicle) for s in flights),
        every,
        [np.asarray(m, dtype=bool)[::k] for m, k in zip(fit, every, strict=True)],
        [np.asarray(m, dtype=bool)[::k] for m, k in zip(holdout, every, strict=True)],
        frozenset(mute),
        trifles,
    )


def _every(flights: Sequence[Samples]) -> tuple[int, ...]:
    """Samples for each row, by flight: whole multiples of the samples for which columns are evaluated once."""
    every = []
    for s in flights:
        most = max(1, int(1.0 / (_ROWS_PER_CUTOFF * track(s).cutoff_hz * s.dt_s)))
        every.append(most - most % min(evaluated_every(s), most))
    rows = sum(len(s.t_s) // k for s, k in zip(flights, every, strict=True))
    fewer = max(1, -(-rows // _MOST_ROWS))
    return tuple(k * fewer for k in every)
