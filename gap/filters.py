"""Filters and spectra of sampled columns: Butterworth both ways, finite filters, Welch's spectra.

SciPy has them all and is what the tests hold these against; its signal package takes a second to load, which is a
good part of the whole command, and filters column by column.  Here all columns of a row are filtered together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flightstack.jit import njit_called
from flightstack.types import F64


def lowpass_sections(cutoff_hz: float, dt_s: float) -> F64:
    """(1, 5) b0, b1, b2, a1, a2 of a Butterworth low-pass of second order, by the bilinear transform."""
    k = np.tan(np.pi * cutoff_hz * dt_s)
    a0 = 1.0 + np.sqrt(2.0) * k + k * k
    row = [k * k, 2.0 * k * k, k * k, 2.0 * (k * k - 1.0), 1.0 - np.sqrt(2.0) * k + k * k]
    return np.asarray(np.array([row]) / a0)


def bandpass_sections(low_hz: float, high_hz: float, dt_s: float) -> F64:
    """(2, 5) sections of a Butterworth band-pass of second order (a prototype of two poles), each 1 at the centre."""
    low, high = np.tan(np.pi * low_hz * dt_s), np.tan(np.pi * high_hz * dt_s)
    centre, half = np.sqrt(low * high), 0.5 * (high - low)
    shifted = half * np.exp(0.75j * np.pi)
    root = np.sqrt(shifted**2 - centre**2)
    at = (1.0 + 1j * centre) / (1.0 - 1j * centre)
    rows = []
    for analog in (shifted + root, shifted - root):
        pole = (1.0 + analog) / (1.0 - analog)
        a1, a2 = -2.0 * pole.real, abs(pole) ** 2
        size = abs((at * at - 1.0) / (at * at + a1 * at + a2))
        rows.append([1.0, 0.0, -1.0, a1 * size, a2 * size] / size)
    return np.array(rows)


def both_ways(sections: F64, pad: int, x: F64, *, even: bool = False) -> F64:
    """Forwards and backwards along the first axis of (N, C), without a shift in time.

    Both ends are continued by `pad` rows turned round the end (odd), or mirrored in it (`even`); the filter begins
    as if the first of these rows had always been there.
    """
    return np.asarray(_both_ways(sections, np.ascontiguousarray(x, dtype=np.float64), pad, even))


@njit_called
def _both_ways(sections: F64, x: F64, pad: int, even: bool) -> F64:
    count, width = x.shape
    rows = np.empty((count + 2 * pad, width))
    rows[pad : pad + count] = x
    for k in range(1, pad + 1):
        for c in range(width):
            before, after = x[k, c], x[count - 1 - k, c]
            rows[pad - k, c] = before if even else 2.0 * x[0, c] - before
            rows[pad + count - 1 + k, c] = after if even else 2.0 * x[count - 1, c] - after
    last = rows.shape[0] - 1
    _one_way(sections, rows, 0, 1)
    _one_way(sections, rows, last, -1)
    return rows[pad : pad + count].copy()


@njit_called
def _one_way(sections: F64, rows: F64, start: int, step: int) -> None:
    """All sections, in place, from one end to the other (direct form II transposed)."""
    count, width = rows.shape
    level = rows[start].copy()
    first, second = np.empty(width), np.empty(width)
    for s in range(sections.shape[0]):
        b0, b1, b2, a1, a2 = sections[s, 0], sections[s, 1], sections[s, 2], sections[s, 3], sections[s, 4]
        gain = (b0 + b1 + b2) / (1.0 + a1 + a2)
        for c in range(width):
            first[c] = (gain - b0) * level[c]
            second[c] = (b2 - a2 * gain) * level[c]
            level[c] *= gain
        for k in range(count):
            row = rows[start + step * k]
            for c in range(width):
                v = row[c]
                y = b0 * v + first[c]
                first[c] = b1 * v - a1 * y + second[c]
                second[c] = b2 * v - a2 * y
                row[c] = y


def finite(taps: F64, x: F64) -> F64:
    """The filter y[t] = sum_k taps[k] x[t - k] along the first axis of (N,) or (N, C); nothing before the first row."""
    if x.ndim == 1:
        return np.convolve(x, taps)[: len(x)]
    columns = np.ascontiguousarray(x.reshape(len(x), -1), dtype=np.float64)
    return np.asarray(_finite(np.asarray(taps, dtype=np.float64), columns)).reshape(x.shape)


@njit_called
def _finite(taps: F64, x: F64) -> F64:
    out = np.zeros(x.shape)
    for t in range(x.shape[0]):
        for k in range(min(len(taps), t + 1)):
            share = taps[k]
            for c in range(x.shape[1]):
                out[t, c] += share * x[t - k, c]
    return out


def spectra(columns: Sequence[F64], dt_s: float, per_segment: int, *, linear: bool = False) -> tuple[F64, F64]:
    """Frequencies (n,) and one-sided power spectral densities and cross densities (S, S, n, ...) of S signals.

    Welch's way (IEEE Trans. Audio Electroacoust. 1967): Hann windows that overlap by half; each segment less its mean
    or (`linear`) less its straight line.  Signals (N, ...) along the first axis; entry (i, j) is conj(X_i) X_j, real
    part only.
    """
    length = min(per_segment, len(columns[0]))
    step = length - length // 2
    begins = range(0, len(columns[0]) - length + 1, step)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    ramp = np.linspace(-1.0, 1.0, length)
    ramp /= np.sqrt(np.sum(ramp * ramp))
    total: F64 | None = None
    for begin in begins:
        transforms = []
        for column in columns:
            piece = column[begin : begin + length]
            piece = piece - piece.mean(axis=0)
            if linear:
                piece = piece - np.multiply.outer(ramp, np.tensordot(ramp, piece, axes=(0, 0)))
            transforms.append(np.fft.rfft((window * piece.T).T, axis=0))
        power = np.array([[(a.conj() * b).real for b in transforms] for a in transforms])
        total = power if total is None else total + power
    assert total is not None
    density = total * (dt_s / float(np.sum(window * window)) / len(begins))
    density[:, :, 1 : -1 if length % 2 == 0 else None] *= 2.0
    return np.asarray(np.fft.rfftfreq(length, dt_s), dtype=np.float64), density
