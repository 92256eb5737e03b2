"""Where simulator and flight part: by channel, in which regime, against which quantity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flightstack.gap.naming.drivers import quantities
from flightstack.gap.naming.whitening import Mask
from flightstack.gap.records import DRIVERS, REGIMES, SIGNALS, ChannelResidual, Residual, Samples
from flightstack.gap.track import track
from flightstack.types import F64

_FEWEST = 0.5
"""Seconds of a regime below which it is not judged."""
_BLOCK_S = 0.2


def locate(residuals: Sequence[Residual], flights: Sequence[Samples]) -> tuple[ChannelResidual, ...]:
    """One line for each of the six physical channels that the flights can show.

    `correlates_with` is the driver whose square, straight and cubic parts explain most of the channel's block means,
    "" where none does better than chance.
    """
    good = [s.valid & np.isfinite(r.y[:, :6]).any(axis=1) for s, r in zip(flights, residuals, strict=True)]
    flown, driven = [regimes(s) for s in flights], [_driven(s) for s in flights]
    found = []
    for c, signal in enumerate(SIGNALS):
        y = [np.where(g, r.y[:, c], np.nan) for g, r in zip(good, residuals, strict=True)]
        values = np.concatenate(y) if y else np.empty(0)
        if not np.isfinite(values).any():
            continue
        noise = float(np.sqrt(np.mean([r.noise[c] ** 2 for r in residuals])))
        found.append(
            ChannelResidual(
                signal,
                float(np.sqrt(np.nanmean(values**2))),
                "m/s^2" if c < 3 else "rad/s^2",
                noise,
                _worst_regime(y, flown, flights[0].dt_s),
                _driver([_blocks(v, s) for v, s in zip(y, flights, strict=True)], driven),
            )
        )
    return tuple(found)


def regimes(samples: Samples) -> dict[str, Mask]:
    """Regime -> (N,) samples in it; a sample can be in several."""
    flight = track(samples)
    v = flight.vel_ned_mps
    level = np.hypot(v[:, 0], v[:, 1])
    climb = -v[:, 2]
    turn = np.linalg.norm(flight.rate_frd_radps, axis=1)
    motor = np.nan_to_num(samples.motor)
    height = samples.height_m
    volts = samples.battery_v
    low = np.quantile(volts[volts > 0.0], 0.2) if np.any(volts > 0.0) else -1.0
    masks = {
        "hover": (level < 0.5) & (np.abs(climb) < 0.3) & (turn < 0.3),
        "climb": climb > 0.7,
        "descent": climb < -0.7,
        "forward": (level >= 0.5) & (level < 3.0),
        "fast_forward": level >= 3.0,
        "near_ground": np.isfinite(height) & (np.nan_to_num(height, nan=np.inf) < 0.5),
        "full_throttle": motor.max(axis=1) > 0.95,
        "low_battery": (volts > 0.0) & (volts <= low),
        "turning": turn > 1.0,
    }
    return {name: masks[name] for name in REGIMES}


def _worst_regime(y: list[F64], flown: list[dict[str, Mask]], dt_s: float) -> str:
    worst, most = "", 0.0
    for name in REGIMES:
        parts = [values[masks[name] & np.isfinite(values)] for values, masks in zip(y, flown, strict=True)]
        joined = np.concatenate(parts)
        if len(joined) * dt_s < _FEWEST:
            continue
        rms = float(np.sqrt(np.mean(joined**2)))
        if rms > most:
            worst, most = name, rms
    return worst


def _driven(samples: Samples) -> dict[str, F64]:
    """Driver -> (B, d) its means over a flight's blocks."""
    return {name: _blocks(x.reshape(len(x), -1), samples) for name, x in quantities(samples).items()}


def _blocks(x: F64, samples: Samples) -> F64:
    """(B, ...) means of x (N, ...) over blocks of time."""
    size = max(1, round(_BLOCK_S / samples.dt_s))
    count = len(x) // size
    return np.asarray(x[: count * size].reshape(count, size, *x.shape[1:]).mean(axis=1))


def _driver(y: list[F64], driven: list[dict[str, F64]]) -> str:
    """The driver with the best adjusted share of the variance of block means (B,), where it beats chance."""
    best, name = 0.0, ""
    for driver in DRIVERS:
        if not all(driver in of for of in driven):
            continue
        x = np.concatenate([of[driver][np.isfinite(mean)] for mean, of in zip(y, driven, strict=True)])
        share = _adjusted_share(x, np.concatenate([mean[np.isfinite(mean)] for mean in y]))
        if share > best:
            best, name = share, driver
    return name


def _adjusted_share(x: F64, y: F64) -> float:
    spread = x.std(axis=0)
    if len(y) < 40 or not np.any(spread > 1e-9) or y.std() == 0.0:
        return 0.0
    z = (x - x.mean(axis=0))[:, spread > 1e-9] / spread[spread > 1e-9]
    design = np.hstack([np.ones((len(y), 1)), z, z**2, z * np.abs(z)])
    rest = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    share = 1.0 - float(rest @ rest) / float(((y - y.mean()) ** 2).sum())
    # blocks remember each other: as if one in five were independent
    n, k = len(y) / 5.0, design.shape[1] - 1
    f = share / k / max((1.0 - share) / max(n - k - 1.0, 1.0), 1e-12)
    return share if f > 4.0 else 0.0
