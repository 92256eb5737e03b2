"""A sudden change in flight: how soon it is noticed, how soon the bound holds again, how soon it is learned."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from flightstack.calibration import BOUND_SIGMAS
from flightstack.types import F64, Learned

Flags = NDArray[np.bool_]

LEARNED_SHARE = 0.1
"""Of the jump: what may be left of it, as a mean over 0.1 s, once the change counts as learned."""
BACK_M = 0.05
_SMOOTH_TICKS = 25
_AT_ONCE_TICKS = 5
_WATCHED_S = 8.0
_BEFORE_S = 1.0
_SHOWN_S = (-1.0, 4.0)
_SHOWN_EVERY = 5


def change_summary(event_s: float, times_s: F64, rows: F64, truth: F64, distance_m: F64) -> dict[str, Any]:
    """Seconds since the change at `event_s`; None where it never came to it.

    `rows` (n, 32) of Learned, `truth` (n, 3) the true residual, m/s^2, `distance_m` (n,) from the reference.  All is
    judged along body z, where a mass acts.
    """
    after = times_s >= event_s
    watched = after & (times_s <= event_s + _WATCHED_S)
    before = (times_s >= event_s - _BEFORE_S) & ~after
    mean, sigma = rows[:, Learned.residual_frd_mps2.place][:, 2], rows[:, Learned.sigma_frd_mps2.place][:, 2]
    error = truth[:, 2] - mean
    changes = rows[:, Learned.changes.place]
    told = watched & (changes > changes[before][-1])
    first_told = _first(times_s, told, event_s)
    jump = abs(float(np.mean(error[after][:5]) - np.mean(error[before])))
    smooth = np.convolve(error, np.full(_SMOOTH_TICKS, 1.0 / _SMOOTH_TICKS), mode="same")
    inside = np.abs(error) <= BOUND_SIGMAS * sigma
    since = np.zeros_like(after) if first_told is None else watched & (times_s >= event_s + first_told)
    settled = since & (times_s <= event_s + 2.0)
    return {
        "jump_mps2": jump,
        "noticed_s": first_told,
        "bound_before_mps2": float(BOUND_SIGMAS * np.mean(sigma[before])),
        "bound_noticed_mps2": float(BOUND_SIGMAS * sigma[since][:_AT_ONCE_TICKS].max()) if since.any() else None,
        "covered_s": _first(times_s, since & inside, event_s),
        "covered_after_notice": float(inside[settled].mean()) if settled.any() else None,
        "learned_s": _for_good(times_s, watched, np.abs(smooth) > LEARNED_SHARE * jump, event_s),
        "back_s": _for_good(times_s, watched, distance_m > BACK_M, event_s),
        "shown": _shown(event_s, times_s, np.stack([truth[:, 2], mean, BOUND_SIGMAS * sigma, distance_m])),
    }


def _first(times_s: F64, condition: Flags, event_s: float) -> float | None:
    """When it first holds."""
    return float(times_s[condition][0] - event_s) if condition.any() else None


def _for_good(times_s: F64, watched: Flags, wrong: Flags, event_s: float) -> float | None:
    """When it stops being wrong for the rest of the time watched."""
    bad = times_s[watched & wrong]
    if not len(bad):
        return 0.0
    end = float(times_s[watched][-1])
    return None if bad[-1] >= end else float(bad[-1] - event_s)


def _shown(event_s: float, times_s: F64, columns: F64) -> dict[str, list[float]]:
    """What the figure shows: every fifth tick round the change."""
    near = (times_s >= event_s + _SHOWN_S[0]) & (times_s <= event_s + _SHOWN_S[1])
    picked = np.flatnonzero(near)[::_SHOWN_EVERY]
    names = ("true_mps2", "expected_mps2", "bound_mps2", "distance_m")
    shown = {name: np.round(column[picked], 4).tolist() for name, column in zip(names, columns, strict=True)}
    return {"time_s": np.round(times_s[picked] - event_s, 3).tolist()} | shown
