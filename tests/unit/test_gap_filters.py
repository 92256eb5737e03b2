"""The filters and spectra of the gap workflow are those of SciPy's `signal`."""

import subprocess
import sys

import numpy as np
import pytest
from scipy import signal

from flightstack.gap.filters import bandpass, both_ways, lowpass, spectrum, through

DT_S = 0.008
X = np.random.default_rng(3).standard_normal((900, 3)).cumsum(axis=0) + 5.0


def test_a_low_pass_and_a_band_pass_both_ways_are_scipys() -> None:
    for ours, theirs in (
        (lowpass(4.0, DT_S), signal.butter(2, 4.0, fs=1.0 / DT_S, output="sos")),
        (lowpass(0.02, DT_S), signal.butter(2, 0.02, fs=1.0 / DT_S, output="sos")),
        (bandpass(0.3, 11.0, DT_S), signal.butter(2, [0.3, 11.0], "bandpass", fs=1.0 / DT_S, output="sos")),
        (bandpass(20.0, 22.0, DT_S), signal.butter(2, [20.0, 22.0], "bandpass", fs=1.0 / DT_S, output="sos")),
    ):
        for pad in (40, 899):
            for even in (False, True):
                wanted = signal.sosfiltfilt(theirs, X, axis=0, padtype="even" if even else "odd", padlen=pad)
                np.testing.assert_allclose(both_ways(ours, X, pad, even=even), wanted, rtol=0, atol=1e-8)


def test_one_column_is_filtered_as_one_of_many() -> None:
    sections = lowpass(2.0, DT_S)
    np.testing.assert_array_equal(both_ways(sections, X[:, 1], 50), both_ways(sections, X, 50)[:, 1])


@pytest.mark.parametrize(("taps", "poles"), [([1.0, -0.7, 0.2], [1.0]), ([0.3, 0.1], [1.0, -0.9, 0.4, 0.1])])
def test_a_recursion_is_scipys(taps: list[float], poles: list[float]) -> None:
    for x in (X, X[:, 0], X[::-1]):
        wanted = signal.lfilter(taps, poles, x, axis=0)
        np.testing.assert_allclose(through(np.array(taps), np.array(poles), x), wanted, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("detrend", ["constant", "linear"])
def test_spectra_are_scipys(detrend: str) -> None:
    told = {"fs": 1.0 / DT_S, "nperseg": 250, "detrend": detrend}
    hz, wanted = signal.welch(X, axis=0, **told)
    ours_hz, ours = spectrum(X, X, DT_S, 250, linear=detrend == "linear")
    np.testing.assert_allclose(ours_hz, hz, rtol=1e-12)
    np.testing.assert_allclose(ours, wanted, rtol=1e-9, atol=1e-12)
    shared = signal.csd(X[:, 0], X[:, 1], **told)[1].real
    np.testing.assert_allclose(spectrum(X[:, 0], X[:, 1], DT_S, 250, linear=detrend == "linear")[1], shared, rtol=1e-8)


def test_the_workflow_does_without_scipys_own_whose_import_takes_longest() -> None:
    heavy = {"scipy.linalg", "scipy.signal", "scipy.special"}
    code = f"import sys, flightstack.cli.gap, flightstack.gap.workflow; print(sorted({heavy} & set(sys.modules)))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"
