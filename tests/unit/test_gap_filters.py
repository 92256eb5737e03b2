"""The gap workflow's filters and spectra against SciPy's, on the same numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from gap.filters import bandpass_sections, both_ways, finite, lowpass_sections, spectra

_DT_S = 0.008


def _walk(columns: int = 3, rows: int = 700) -> np.ndarray:
    rng = np.random.default_rng(7)
    return np.cumsum(rng.standard_normal((rows, columns)), axis=0) + rng.standard_normal((rows, columns))


@pytest.mark.parametrize("kind", ["odd", "even"])
@pytest.mark.parametrize("cutoff_hz", [0.04, 2.0, 20.0, 50.0])
def test_lowpass_both_ways(cutoff_hz: float, kind: str) -> None:
    x = _walk()
    sos = signal.butter(2, cutoff_hz, fs=1.0 / _DT_S, output="sos")
    wanted = signal.sosfiltfilt(sos, x, axis=0, padtype=kind, padlen=200)
    found = both_ways(lowpass_sections(cutoff_hz, _DT_S), 200, x, even=kind == "even")
    np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-8 * np.abs(wanted).max())


@pytest.mark.parametrize("band", [(0.3, 5.0), (0.1, 12.0), (2.0, 40.0)])
def test_bandpass_both_ways(band: tuple[float, float]) -> None:
    x = _walk()
    sos = signal.butter(2, band, "bandpass", fs=1.0 / _DT_S, output="sos")
    wanted = signal.sosfiltfilt(sos, x, axis=0, padlen=300)
    found = both_ways(bandpass_sections(*band, _DT_S), 300, x)
    np.testing.assert_allclose(found, wanted, atol=1e-7 * np.abs(wanted).max())


@pytest.mark.parametrize("shape", [(5,), (700,), (700, 4)])
def test_finite_filter(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    taps, x = rng.standard_normal(17), rng.standard_normal(shape)
    np.testing.assert_allclose(finite(taps, x), signal.lfilter(taps, [1.0], x, axis=0), atol=1e-12)


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("per_segment", [128, 129, 5000])
def test_spectra(per_segment: int, linear: bool) -> None:
    a, b = _walk(), _walk()[::-1].copy()
    given = {"fs": 1.0 / _DT_S, "nperseg": min(per_segment, len(a)), "detrend": "linear" if linear else "constant"}
    hz, wanted = signal.welch(a, axis=0, **given)
    shared = np.real(signal.csd(a, b, axis=0, **given)[1])
    found_hz, found = spectra([a, b], _DT_S, per_segment, linear=linear)
    np.testing.assert_allclose(found_hz, hz, atol=1e-12)
    np.testing.assert_allclose(found[0, 0], wanted, rtol=1e-8, atol=1e-12 * wanted.max())
    np.testing.assert_allclose(found[0, 1], shared, rtol=1e-6, atol=1e-10 * np.abs(wanted).max())
