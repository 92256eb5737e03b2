"""The few filters and spectra that the workflow needs, as `scipy.signal` has them: importing that takes a second.

Filters are second-order Butterworth ones, as sections b0, b1, b2, 1, a1, a2 in a row (Oppenheim, Schafer: Discrete-Time
Signal Processing, bilinear transform); spectra are Welch's with Hann windows that overlap by half.
The white noise of a signal is told by its own samples.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import njit, njit_free
from flightstack.types import F64


def lowpass(cutoff_hz: float, dt_s: float) -> F64:
    """(1, 6) sections of a low-pass."""
    k = math.tan(math.pi * cutoff_hz * dt_s)
    scale = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
    gain = k * k * scale
    return np.array(
        [[gain, 2.0 * gain, gain, 1.0, 2.0 * (k * k - 1.0) * scale, (1.0 - math.sqrt(2.0) * k + k * k) * scale]]
    )


def bandpass(low_hz: float, high_hz: float, dt_s: float) -> F64:
    """(2, 6) sections of a band-pass."""
    low, high = (2.0 * math.tan(math.pi * hz * dt_s) for hz in (low_hz, high_hz))
    pole = np.exp(0.75j * math.pi) * (high - low) / 2.0
    root = np.sqrt(pole * pole - low * high)
    analog = np.array([pole + root, pole - root])  # each with its conjugate
    z = (2.0 + analog) / (2.0 - analog)
    gain = (high - low) / np.abs(2.0 - analog) ** 2 * 2.0
    return np.stack([[g, 0.0, -g, 1.0, -2.0 * p.real, abs(p) ** 2] for g, p in zip(gain, z, strict=True)])


def both_ways(sections: F64, x: F64, pad: int, *, even: bool = False) -> F64:
    """Filtered forwards and backwards along the first axis, continued by `pad` rows at both ends.

    The continuation is turned about the end's value, or mirrored where `even`.
    """
    flat = x.reshape(len(x), -1)
    before, after = flat[pad:0:-1], flat[-2 : -pad - 2 : -1]
    if not even:
        before, after = 2.0 * flat[0] - before, 2.0 * flat[-1] - after
    y = np.concatenate([before, flat, after])
    _pass(sections, _steady(sections), y)
    return y[pad : len(y) - pad].reshape(x.shape)


def _steady(sections: F64) -> F64:
    """(n, 2) what the sections remember of an input that has been 1 for ever."""
    out, level = np.empty((len(sections), 2)), 1.0
    for own, (b0, b1, b2, _, a1, a2) in zip(out, sections.tolist(), strict=True):
        gain = (b0 + b1 + b2) / (1.0 + a1 + a2)
        own[1] = level * (b2 - a2 * gain)
        own[0] = level * (b1 - a1 * gain) + own[1]
        level *= gain
    return out


@njit_free
def _pass(sections: F64, steady: F64, y: F64) -> None:
    """Columns of `y` (N, k) through the sections, in place, then back, each at rest at its first row's values."""
    rows, columns = y.shape
    for begin, step in ((0, 1), (rows - 1, -1)):
        first = y[begin].copy()
        for n in range(sections.shape[0]):
            b0, b1, b2, a1, a2 = sections[n, 0], sections[n, 1], sections[n, 2], sections[n, 4], sections[n, 5]
            one, two = steady[n, 0] * first, steady[n, 1] * first
            for i in range(rows):
                row = y[begin + step * i]
                for j in range(columns):
                    x = row[j]
                    out = b0 * x + one[j]
                    one[j] = b1 * x - a1 * out + two[j]
                    two[j] = b2 * x - a2 * out
                    row[j] = out


def through(taps: F64, poles: F64, x: F64, start: float = 0.0) -> F64:
    """The recursion sum poles_k y_(i-k) = sum taps_k x_(i-k), poles_0 = 1, along the first axis.

    From rest, what was before the first row being `start` (input and output).
    """
    flat = np.ascontiguousarray(x.reshape(len(x), -1))
    return _recursion(taps, poles, flat, start).reshape(x.shape)


@njit
def _recursion(taps: F64, poles: F64, x: F64, start: float) -> F64:
    out = np.zeros_like(x)
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            total = 0.0
            for k in range(len(taps)):
                total += taps[k] * (x[i - k, j] if i >= k else start)
            for k in range(1, len(poles)):
                total -= poles[k] * (out[i - k, j] if i >= k else start)
            out[i, j] = total
    return out


def spectrum(x: F64, y: F64, dt_s: float, each: int, *, linear: bool = False) -> tuple[F64, F64]:
    """Frequencies (n,) in Hz and the real part of the cross spectral density (n, ...) along the first axis.

    Segments of `each` samples, less their mean, or less their straight line where `linear`.
    """
    starts = np.arange(0, len(x) - each + 1, each - each // 2)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(each) / each)
    at = np.arange(each) - 0.5 * (each - 1)

    def transformed(values: F64) -> np.ndarray:
        parts = values[starts[:, None] + np.arange(each)]
        parts = parts - parts.mean(axis=1, keepdims=True)
        if linear:
            slope = np.tensordot(at, parts, axes=(0, 1)) / float(at @ at)
            parts -= at.reshape(1, -1, *(1,) * (values.ndim - 1)) * slope[:, None]
        return np.asarray(np.fft.rfft(parts * window.reshape(1, -1, *(1,) * (values.ndim - 1)), axis=1))

    first = transformed(x)
    second = first if y is x else transformed(y)
    density = np.mean(np.real(np.conj(first) * second), axis=0) * 2.0 * dt_s / float(window @ window)
    density[0] *= 0.5
    if each % 2 == 0:
        density[-1] *= 0.5
    return np.asarray(np.fft.rfftfreq(each, dt_s)), np.asarray(density)


_THIRD = float(np.sqrt(20.0))
"""Standard deviation of the third difference of unit white noise: 1 + 9 + 9 + 1 = 20."""
_MAD = 1.4826
_STRIDES = 6
_STRAIGHT, _OFTEN = 1e-3, 0.2
"""A third difference this small against the rms is a straight line; so many of them are no accident."""


def white_noise(values: F64) -> F64:
    """(k,) standard deviation of the white noise on the columns of `values` (N, k).

    From third differences, which leave next to nothing of a smooth motion, by their median absolute value, which a few
    knocks don't move.  Rows filled in by straight lines have next to none; then every second, third
    ... row is taken.  NaN with less than 20 rows.
    """
    columns = values.reshape(len(values), -1)
    columns = columns[np.isfinite(columns).all(axis=1)]
    out = np.full(columns.shape[1], np.nan)
    for stride in range(1, _STRIDES + 1):
        third = np.diff(columns[::stride], n=3, axis=0)
        if len(third) < 20:
            break
        each = np.abs(third)
        out = _MAD * np.median(each, axis=0) / _THIRD
        straight = np.mean(each < _STRAIGHT * np.sqrt(np.mean(third * third, axis=0)), axis=0)
        if straight.max() < _OFTEN:
            break
    return out
