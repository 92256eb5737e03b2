"""How well two signals agree that may be stamped apart, and when one reading agrees better beyond doubt."""

from __future__ import annotations

import numpy as np

from flightstack.gap.decisions import CONVENTION_CHANCE, CONVENTION_MARGIN, CONVENTION_NEARLY, CONVENTION_POOR
from flightstack.types import F64

_SHIFT_S = 0.4


def correlation(a: F64, b: F64, dt_s: float) -> tuple[float, float, float]:
    """(greatest correlation over shifts within 0.4 s, slope of a on b there, the shift by which b is late, s)."""
    most = min(int(_SHIFT_S / dt_s), len(a) // 4)
    size = 1 << int(np.ceil(np.log2(len(a) + most + 1)))
    product = np.fft.irfft((np.fft.rfft(b, size, axis=0) * np.conj(np.fft.rfft(a, size, axis=0))).sum(axis=1), size)
    shifted = np.concatenate([product[-most:], product[: most + 1]])
    power_a, power_b = float(np.sum(a * a)), float(np.sum(b * b))
    if power_a <= 0.0 or power_b <= 0.0:
        return 0.0, 0.0, 0.0
    best = int(np.argmax(shifted))
    return float(shifted[best]) / np.sqrt(power_a * power_b), float(shifted[best]) / power_b, (best - most) * dt_s


def agreement(a: F64, b: F64, dt_s: float) -> float:
    """Correlation as far as it is none that noise has by chance: else nothing."""
    found = correlation(a, b, dt_s)[0]
    return found if found > CONVENTION_CHANCE else 0.0


def is_better(new: float, kept: float, perfect: float = 1.0) -> bool:
    """Whether one sum of correlations is beyond doubt better than another."""
    gain = new - kept
    enough = CONVENTION_MARGIN if perfect - new < CONVENTION_POOR else CONVENTION_CHANCE
    return gain > enough or (gain > CONVENTION_NEARLY and perfect - new < CONVENTION_POOR * (perfect - kept))
