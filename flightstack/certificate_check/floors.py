"""What no honest certificate is below: what is refused from the file alone, whatever else in it agrees.

noise       of a point: of a grade that is known 0.7 of what its accelerometer's white noise leaves of 60 ms, else
            1 mm/s^2; inflation at least 1.1 and excess at least (1.05 * 7.5 mm/s^2)^2, by the rules that set them
points      y as likely under kernel and noise as n Gaussian numbers: y' (K + noise I)^-1 y / n between 0.05 and
            what the inflation says
doubts      0.5 ms, 1 % (of the estimate: `premises`): below the resolution of what measures them
vehicle     rotors of 1 cm; commands held for 1 ms
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .intervals import F64
from .reading import Refused, number

LEAST_INFLATION, LEAST_EXCESS, LEAST_NOISE_MPS2 = 1.1, (1.05 * 0.0075) ** 2, 1e-3
_NEAR = 1e-9
_SHARE = 0.7
_WINDOW_S = 0.06
_DENSITIES = {"mocap": (5.0e-3, 8.0e-3), "gps": (1.0e-2, 1.5e-2)}
"""Least of the accelerometer's across, and along the thrust axis, m/s^2/sqrt(Hz), by grade."""
_DOUBTS = {"delay_s": 5e-4, "lag_share": 0.01, "rate_lag_share": 0.01}
_RADIUS_M, _DT_S = 0.01, 1e-3
_DRIFT_S = 2.0
_LEAST_FIT, _LEAST_POINTS = 0.05, 20


def check_process(noise: float, inflation: F64, excess: F64, remainder: F64, where: str) -> None:
    """Refused where a process' calibration is below what its rules can give."""
    if not inflation.min() >= LEAST_INFLATION * (1.0 - _NEAR):
        raise Refused(f"{where}.inflation must be at least {LEAST_INFLATION:g}")
    if not excess.min() >= LEAST_EXCESS * (1.0 - _NEAR):
        raise Refused(f"{where}.excess must be at least {LEAST_EXCESS:.3g} (m/s^2)^2")
    if not remainder.min() >= 0.0:
        raise Refused(f"{where}.remainder_mps2 must be at least 0")
    if not noise >= LEAST_NOISE_MPS2**2:
        raise Refused(f"{where}.noise_var must be at least ({LEAST_NOISE_MPS2:g} m/s^2)^2")


def check_drift(drift: tuple[float, float], noise: float, excess: F64, dated: bool, where: str) -> None:
    """Refused where noise wanders otherwise than the rule has it, or an acceleration yet to come does not."""
    variance, time_s = drift
    if not (0.0 < variance <= noise * (1.0 + _NEAR) and time_s == _DRIFT_S and dated):
        raise Refused(f"{where}.drift must be over {_DRIFT_S:g} s, at most the noise, of points with windows")
    if not excess.min() >= 1.05**2 * variance * (1.0 - _NEAR):
        raise Refused(f"{where}.excess must be at least the drift's {1.05**2 * variance:.3g} (m/s^2)^2")


def check_noise(noises: list[float], sensors: Any) -> None:
    """Refused where a grade's own accelerometer is noisier than the points are said to be."""
    for name, noise, density in zip(("lateral", "vertical"), noises, _DENSITIES.get(str(sensors), ()), strict=False):
        least = _SHARE * density / (2.0 * _WINDOW_S) ** 0.5
        if not noise**0.5 >= least:
            raise Refused(
                f"knowledge.{name}: noise of {noise**0.5:.3g} m/s^2 is stated, an accelerometer of {sensors} alone "
                f"makes {least / _SHARE:.3g}"
            )


def check_fit(y: F64, lower: F64, inflation: F64, where: str) -> None:
    """Refused where the points are no draw of their own kernel and noise."""
    if len(y) < _LEAST_POINTS:
        return
    fit = (np.linalg.solve(lower, y) ** 2).mean(axis=0)
    most = inflation**2 * (1.0 + 4.0 * (2.0 / len(y)) ** 0.5)
    for i in range(len(fit)):
        if not _LEAST_FIT <= fit[i] <= most[i]:
            raise Refused(f"{where}.y: output {i} has {fit[i]:.3g} times the variance that kernel and noise say")


def check_doubts(doubts: Any) -> None:
    """Refused where a doubt is below what could be known."""
    for key, least in _DOUBTS.items():
        if not number(doubts[key], f"knowledge.doubts.{key}") >= least:
            raise Refused(f"knowledge.doubts.{key} = {doubts[key]:g} is below the {least:g} that could be known")


def check_radius(rotor_radius_m: float) -> None:
    """Refused where a rotor is nothing."""
    if not rotor_radius_m >= _RADIUS_M:
        raise Refused(f"knowledge.rotor_radius_m = {rotor_radius_m:g} is below {_RADIUS_M:g} m")


def check_hold(dt_s: float) -> None:
    """Refused where commands are held for no time."""
    if not dt_s >= _DT_S:
        raise Refused(f"setting.dt_s = {dt_s:g} is below {_DT_S:g} s")
