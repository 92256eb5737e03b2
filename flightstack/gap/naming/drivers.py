"""What a residual can depend on: the ten drivers of `gap.records.DRIVERS` as numbers, averaged over short blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.naming.whitening import Mask
from flightstack.gap.records import DRIVERS, Samples
from flightstack.gap.track import track
from flightstack.types import F64

_SMOOTH_S = 0.4
_LAGS = 10
"""Blocks that a driver is remembered for."""
_REMEMBERED = ("acceleration", "rate")
_INTERFERENCE_M = 1.0
"""Added to the height where its inverse is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Means over blocks of equal length, all flights one after another; B blocks."""

    y: F64
    """(B, 6) residual, body FRD."""
    world: F64
    """(B, 3) its force part turned to NED."""
    columns: F64
    """(B, 6, K) columns of what has been named."""
    drivers: dict[str, F64]
    """Driver -> (B, d); absent where the log can't tell."""
    past: dict[str, F64]
    """Driver -> (B, lags * d): its last two seconds."""
    fold: NDArray[np.int64]
    """(B,) for cross-validation: stretches of a few seconds in turn."""


def block_means(
    flights: tuple[Samples, ...],
    residuals: list[F64],
    columns: list[F64],
    masks: list[Mask],
    *,
    block_s: float,
    stretch_s: float,
    folds: int,
) -> Blocks:
    """Blocks of all flights; residuals (N, >= 6), columns (N, >= 6, K) and masks (N,) at the flights' own rates."""
    parts: list[tuple[F64, F64, F64, dict[str, F64], dict[str, F64], NDArray[np.int64]]] = []
    for samples, y, x, mask in zip(flights, residuals, columns, masks, strict=True):
        size = max(1, round(block_s / samples.dt_s))
        good = mask & np.isfinite(y[:, :6]).any(axis=1)
        count = len(good) // size
        whole: Mask = np.asarray(good[: count * size].reshape(count, size).all(axis=1))

        def mean(values: F64, size: int = size, count: int = count, whole: Mask = whole) -> F64:
            cut = values[: count * size].reshape(count, size, *values.shape[1:])
            return np.asarray(cut.mean(axis=1)[whole])

        number = np.flatnonzero(whole)
        known = quantities(samples)
        fold = (number * block_s // stretch_s).astype(np.int64) % folds
        parts.append(
            (
                mean(np.nan_to_num(y[:, :6])),
                mean(_to_world(samples, np.nan_to_num(y[:, :3]))),
                mean(np.nan_to_num(x[:, :6])),
                {name: mean(values) for name, values in known.items()},
                {name: mean(_lagged(known[name], size)) for name in _REMEMBERED if name in known},
                fold,
            )
        )
    body, world, slopes, drivers, remembered, folds_of = zip(*parts, strict=True)
    shared = [name for name in DRIVERS if all(name in each for each in drivers)]
    return Blocks(
        np.concatenate(body),
        np.concatenate(world),
        np.concatenate(slopes),
        {name: np.concatenate([each[name] for each in drivers]) for name in shared},
        {name: np.concatenate([each[name] for each in remembered]) for name in _REMEMBERED if name in shared},
        np.concatenate(folds_of),
    )


def _lagged(x: F64, size: int) -> F64:
    """(N, d) beside itself up to `_LAGS` blocks ago."""
    return np.hstack(
        [np.vstack([np.repeat(x[:1], k * size, axis=0), x[: len(x) - k * size]]) for k in range(_LAGS + 1)]
    )


def quantities(samples: Samples) -> dict[str, F64]:
    """Driver -> (N, d) at every sample; absent where the log lacks it."""
    flight = track(samples)
    missing = flight.missing
    found: dict[str, F64] = {"time": samples.t_s[:, None] - samples.t_s[0]}
    if "pos_ned_m" not in missing:
        found["position"] = np.nan_to_num(samples.pos_ned_m)
    if "q_ned_frd" not in missing:
        w, x, y, z = flight.q_ned_frd.T
        found["attitude"] = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x)], axis=1)
        heading = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        found["heading"] = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    if not {"vel_ned_mps", "q_ned_frd"} & missing:
        found["airspeed"] = _to_body(samples, flight.vel_ned_mps)
        slow = _smoothed(flight.vel_ned_mps, samples.dt_s)
        found["acceleration"] = _to_body(samples, np.gradient(slow, samples.dt_s, axis=0))
    if "rate_frd_radps" not in missing:
        found["rate"] = flight.rate_frd_radps
    if np.isfinite(samples.motor).any():
        found["thrust"] = np.nan_to_num(samples.motor).mean(axis=1, keepdims=True)
    if "height_m" not in missing:
        found["height"] = 1.0 / (np.maximum(np.nan_to_num(samples.height_m), 0.0)[:, None] + _INTERFERENCE_M)
    if "battery_v" not in missing:
        found["battery"] = samples.battery_v[:, None]
    return found


def _matrices(samples: Samples) -> F64:
    w, x, y, z = track(samples).q_ned_frd.T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1),
        ],
        axis=1,
    )


def _to_world(samples: Samples, v: F64) -> F64:
    return np.asarray(np.einsum("nij,nj->ni", _matrices(samples), v))


def _to_body(samples: Samples, v: F64) -> F64:
    return np.asarray(np.einsum("nji,nj->ni", _matrices(samples), v))


def _smoothed(x: F64, dt_s: float) -> F64:
    size = max(1, round(_SMOOTH_S / dt_s))
    kernel = np.ones(size) / size
    padded = np.pad(x, ((size // 2, size - 1 - size // 2), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, kernel, mode="valid") for column in padded.T], axis=1)
