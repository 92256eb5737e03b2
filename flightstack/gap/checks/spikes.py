"""Single samples that no flight makes are left out: a lost bit, a sentinel, a position that jumps for one row.

A sample is off where it lies far from the median of the samples round it (Hampel's filter): by what nearly all samples
of its signal lie off theirs, by what those round it do, and by how much its neighbours bend.  Steps, ramps and peaks
stay, and so does a knock: it rings, and lasts for more than one sample.  Commands are not looked at: a loop
does command single samples (a setpoint that is late, a kick of its derivative).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.checks.grid import period_s
from flightstack.gap.decisions import SMALL_SHARE, SPIKE_BENDS, SPIKE_SPREADS
from flightstack.gap.records import Finding, Signal, warning
from flightstack.types import F64
from flightstack_logs.turn import continuous

_LEAST = {
    "accel_frd_mps2": 1.0,
    "rate_frd_radps": 0.1,
    "vel_ned_mps": 0.3,
    "pos_ned_m": 0.1,
    "q_ned_frd": 0.01,
    "height_m": 0.3,
    "battery_v": 1.0,
}
"""What a sample must be off at least: a log without noise has kinks."""
_SLUGGISH = ("height_m", "battery_v", "pos_ned_m", "vel_ned_mps")
"""Signals that can't be elsewhere for one sample, however rare their samples are."""
_LONGEST_S = 0.0205
"""Longest period at which one sample is too short for what a vehicle can do."""
_HALF = 2
"""Samples to either side whose median counts."""
_ROUND = 10
"""Samples to either side whose distances from their medians are looked at."""
_MOST, _MOST_STD = 0.9, 1.645
"""Share of a signal's samples that are not off, and what it is of a normal distribution in standard deviations."""
_NEAR, _NEAR_STD = 0.6, 0.842
"""The same of the samples round one."""
_NEARLY_ALL = 0.02
_BEYOND, _BEYOND_LEAST = 10.0, 100.0
"""Beyond so many times what nearly all samples span, and so many times `_LEAST`, nothing need be alone."""


def without_spikes(
    signals: Mapping[str, Signal], span_s: tuple[float, float]
) -> tuple[dict[str, Signal], list[Finding]]:
    """The signals without single samples that no flight makes, and a line for each signal that had some.

    Only between `span_s`, s: before take-off and after landing the ground knocks.  Where more than a twentieth of a
    signal is off, that is how the signal is: all of it stays.
    """
    out, findings = dict(signals), []
    for name, least in _LEAST.items():
        signal = out.get(name)
        if signal is None:
            continue
        wrong = _off(name, signal, least) & (signal.t_s > span_s[0]) & (signal.t_s < span_s[1])
        if 0 < wrong.sum() <= SMALL_SHARE * len(wrong):
            out[name] = Signal(signal.t_s[~wrong], signal.value[~wrong], signal.source)
            text = f"{name}: {int(wrong.sum())} of {len(wrong)} samples are such as no flight makes; left out"
            findings.append(warning("spikes", text))
    return out, findings


def _off(name: str, signal: Signal, least: float) -> NDArray[np.bool_]:
    """(N,) samples far from the median of those round them, with neighbours that are not."""
    none = np.zeros(len(signal.t_s), np.bool_)
    if len(none) < 5 * _ROUND or not (period_s(signal) < _LONGEST_S or name in _SLUGGISH):
        return none
    value = continuous(signal.value) if name == "q_ned_frd" else signal.value.reshape(len(none), -1)
    windows = _windows(value, _HALF)
    off = np.abs(value - np.median(windows, axis=-1))
    if not np.any(off > least):
        return none
    most = np.maximum(SPIKE_SPREADS * np.quantile(off, _MOST, axis=0) / _MOST_STD, least)
    rows = np.flatnonzero(np.any(off > most, axis=1))
    near = np.quantile(_windows(off, _ROUND)[rows], _NEAR, axis=-1) / _NEAR_STD
    alone = off[rows] > np.maximum(SPIKE_BENDS * _bend(windows[rows]), SPIKE_SPREADS * near)
    low, high = np.quantile(value, (_NEARLY_ALL, 1.0 - _NEARLY_ALL), axis=0)
    beyond = off[rows] > np.maximum(_BEYOND * (high - low), _BEYOND_LEAST * least)
    none[rows] = np.any((off[rows] > most) & (alone | beyond), axis=1)
    return none


def _bend(windows: F64) -> F64:
    """(N, k) how far the samples next to the middle one of five (N, k, 5) lie off the line between the outer two."""
    first, before, _, after, last = np.moveaxis(windows, -1, 0)
    return np.asarray(
        np.maximum(np.abs(before - 0.75 * first - 0.25 * last), np.abs(after - 0.25 * first - 0.75 * last))
    )


def _windows(value: F64, half: int) -> F64:
    """(N, k, 2 half + 1) each sample (N, k) with so many to either side."""
    padded = np.pad(value, ((half, half), (0, 0)), mode="reflect")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
