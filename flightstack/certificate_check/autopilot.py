"""The autopilot that a vehicle file means: PX4's rate gains, and how late body rates follow; worked out anew.

gains   as the file's [autopilot] states them, else PX4's defaults (its public parameter reference).  K, where none is
        stated: min(1, c / (P alpha tau)), c 1.1 (yaw 0.6), tau the lags of rotors, gyro filter and yaw's low-pass;
        then 2 % less at a time until the loop of what the file flies has 35 degrees of phase.  alpha: angular
        acceleration of a unit of torque at the hover of the file's body
lag     mean of roll and pitch of (1 + a D) / (a P), P 0.15 and D 0.003, a at the hover of what the file flies,
        within 10 to 150 ms
gyro    white noise of the grade's gyro, rad/s/sqrt(Hz); of a vehicle's own sensors nothing is said
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .intervals import F64
from .reading import Refused, Unreadable

_NAMES = ("roll", "pitch", "yaw")
_DEFAULTS = {
    **{f"mc_{axis}rate_{part}": value for axis in _NAMES[:2]
       for part, value in (("p", 0.15), ("i", 0.2), ("d", 0.003), ("ff", 0.0), ("max", 220.0))},
    "mc_yawrate_p": 0.2, "mc_yawrate_i": 0.1, "mc_yawrate_d": 0.0, "mc_yawrate_ff": 0.0, "mc_yawrate_max": 200.0,
    "mc_rr_int_lim": 0.3, "mc_pr_int_lim": 0.3, "mc_yr_int_lim": 0.3, "imu_gyro_cutoff": 40.0,
    "imu_dgyro_cutoff": 20.0, "mc_yaw_tq_cutoff": 2.0, "thr_mdl_fac": 0.0, "airmode": 0.0,
}  # fmt: skip
_LOOP, _PHASE_DEG, _LESS, _LEAST_K = (1.1, 1.1, 0.6), 35.0, 0.98, 0.01
_LAG_S = (0.01, 0.15)
_GYRO = {
    "mocap": (1e-3, 1e-3, 7e-4), "gps": (3e-3, 2e-3, 1e-3), "px4-sih": (1.252e-2, 6.26e-3, 2.68e-3),
    "px4-sih-ekf": (1.252e-2, 6.26e-3, 2.68e-3),
}  # fmt: skip
_G = 9.80665
_CLOSE = 1e-6
"""Share by which a stated figure may be another."""
_STEP = 1.02
"""K found in steps of 2 % may be one step off where the phase is just enough."""


def check_gyro(stated: Any, sensors: Any) -> None:
    """Refused where the governor counts on less noise of the gyro than the grade's."""
    least = _GYRO.get(sensors, (0.0, 0.0, 0.0))
    if not all(float(each) >= (1.0 - _CLOSE) * low for each, low in zip(stated, least, strict=True)):
        raise Refused(f"governor.vehicle.gyro_noise_radps_rthz = {stated} is less than the {list(least)} of {sensors}")


def check_autopilot(governor: dict[str, Any], axes: list[dict[str, Any]], file: dict[str, Any]) -> None:
    """Refused where gains, limits or the rate loop's lag are not those of the vehicle file's tables."""
    try:
        airframe, stated = _Airframe(file), {key: _value(each) for key, each in file.get("autopilot", {}).items()}
        wanted = {key: float(np.float32(each)) for key, each in (_DEFAULTS | stated).items()}
        gains = {key: np.float32(each) for key, each in airframe.gains(wanted).items()}
    except (KeyError, TypeError, ValueError, AttributeError):
        raise Unreadable("vehicle: is no vehicle file") from None
    for key, each in wanted.items():
        if not math.isclose(float(governor["autopilot"][key]), each, rel_tol=_CLOSE, abs_tol=1e-12):
            raise Refused(f"governor.autopilot.{key} = {governor['autopilot'][key]:g}, the vehicle file says {each:g}")
    for key in gains.keys() - stated.keys():
        apart = float(governor["autopilot"][key]) / float(gains[key])
        if not 1.0 / _STEP - _CLOSE <= apart <= _STEP + _CLOSE:
            raise Refused(f"governor.autopilot.{key} is {apart:.4g} times what the vehicle file gives")
    lag = airframe.rate_lag_s()
    for axis in axes:
        c1, c2 = float(axis["response"]["c1_s"]), float(axis["response"]["c2_s2"])
        if axis["axis"] != "down" and not math.isclose(c2, c1 * lag, rel_tol=_CLOSE):
            raise Refused(f"{axis['axis']}.response.c2_s2 = {c2:.6g}, steering and rate loop give {c1 * lag:.6g}")


def _value(entry: Any) -> float:
    return float(entry["value"] if isinstance(entry, dict) else entry)


class _Airframe:
    """Rotors and inertia of a vehicle file's tables."""

    def __init__(self, file: dict[str, Any]) -> None:
        body, rotors = file["body"], file["rotors"]
        self.effects = {
            name: {key: _value(each) for key, each in table.items()} for name, table in file.get("effects", {}).items()
        }
        self.mass_kg, self.one_n = _value(body["mass_kg"]), _value(rotors["max_thrust_n"])
        self.curve, self.lag_s = _value(rotors["thrust_model_factor"]), _value(rotors["time_constant_s"])
        self.inertia = np.array(_list(body["inertia_kgm2"]), np.float64)
        place = np.array(_list(rotors["position_m"]), np.float64)
        levers = np.stack([-place[:, 1], place[:, 0], np.array(_list(rotors["torque_ratio_m"]), np.float64)])
        mix = np.linalg.pinv(np.vstack([levers, np.ones(len(place))]))[:, :3]
        mix[np.abs(mix) < 1e-9 * np.abs(mix).max()] = 0.0
        used = np.maximum(np.count_nonzero(mix, axis=0), 1)
        mix[:, :2] /= math.sqrt(max(float((mix[:, k] ** 2).sum()) * 2.0 / used[k] for k in (0, 1)))
        mix[:, 2] /= np.abs(mix[:, 2]).max()
        self.moment_m: F64 = np.einsum("ki,ik->k", levers, mix)
        self.count = len(place)

    def slope(self, curve: float, full_n: float, mass_kg: float) -> float:
        """Newton of all rotors per unit of command, at hover."""
        share = mass_kg * _G / full_n
        root = math.sqrt((1.0 - curve) ** 2 + 4.0 * curve * share)
        return full_n * min(root, 1.0 + curve)

    def gains(self, known: dict[str, float]) -> dict[str, float]:
        """K of each axis."""
        full = self.count * self.one_n
        alpha = self.moment_m * self.slope(self.curve, full, self.mass_kg) / self.count / self.inertia
        gyro_hz, d_hz, yaw_hz = (known[key] for key in ("imu_gyro_cutoff", "imu_dgyro_cutoff", "mc_yaw_tq_cutoff"))
        gyro_s = math.sqrt(0.5) / (math.pi * gyro_hz) if gyro_hz > 0.0 else 0.0
        d_s = 0.5 / (math.pi * d_hz) if d_hz > 0.0 else 0.0
        flown_s = self.effects.get("motor_lag", {}).get("time_constant_s", self.lag_s)
        dead_s = self.effects.get("transport_delay", {}).get("delay_s", 0.0)
        out = {}
        for axis, name in enumerate(_NAMES):
            p, i, d = (known[f"mc_{name}rate_{part}"] for part in "pid")
            low_s = 0.5 / (math.pi * yaw_hz) if axis == 2 and yaw_hz > 0.0 else 0.0
            loop = p * float(alpha[axis]) * (self.lag_s + gyro_s + low_s)
            k = max(_LEAST_K, min(1.0, _LOOP[axis] / loop)) if loop > 0.0 else 1.0
            lags = (flown_s, gyro_s, low_s)
            while k > _LEAST_K and _phase(k * np.array([p, i, d]), d_s, float(alpha[axis]), lags, dead_s) < _PHASE_DEG:
                k *= _LESS
            out[f"mc_{name}rate_k"] = k
        return out

    def rate_lag_s(self) -> float:
        """How late roll and pitch rates follow."""
        effects = self.effects
        full = self.count * self.one_n * effects.get("thrust_scale", {}).get("scale", 1.0)
        curve = effects.get("thrust_curve", {}).get("thrust_model_factor", self.curve)
        mass = self.mass_kg + effects.get("payload", {}).get("mass_kg", 0.0)
        scale = np.array([effects.get("inertia", {}).get(f"scale_{axis}", 1.0) for axis in "xy"])
        a = self.moment_m[:2] * self.slope(curve, full, mass) / self.count / (self.inertia[:2] * scale)
        lag = float(np.mean((1.0 + 0.003 * a) / np.maximum(0.15 * a, 1e-6)))
        return min(max(lag, _LAG_S[0]), _LAG_S[1])


def _list(entry: Any) -> Any:
    return entry["value"] if isinstance(entry, dict) else entry


def _phase(gains: F64, d_s: float, alpha: float, lags: tuple[float, ...], dead_s: float) -> float:
    """Phase margin of (P + I / s + D s / (1 + s D_s)) alpha e^(-s dead) / (s (1 + s lag) ...), degrees."""
    w = np.geomspace(0.5, 500.0, 600)
    s = 1j * w
    loop = (gains[0] + gains[1] / s + gains[2] * s / (1.0 + s * d_s)) * alpha / s
    for lag in lags:
        loop = loop / (1.0 + s * lag)
    above = np.flatnonzero(np.abs(loop) >= 1.0)
    if not len(above):
        return 180.0
    return 180.0 + math.degrees(float(np.unwrap(np.angle(loop))[above[-1]]) - dead_s * float(w[above[-1]]))
