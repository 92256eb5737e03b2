"""Sensor grades: how good the simulated sensors and the state estimate are, as read from a TOML file.

Every key is required; unknown keys and values out of range are errors that name the key.  Only the table `kalman` may
be left out, as a whole.  Arrays of three are along north, east, down (positions and velocities) or body x, y, z (the
rest).
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

from flightstack.checked import load_toml, only, words
from flightstack.dotted import changed
from flightstack.toml_text import toml_text
from flightstack.types import InputError, Tuple3

SCHEMA = "flightstack.sensors/1"
GRADES = ("mocap", "gps", "px4-sih", "px4-sih-ekf")
_Limits = tuple[float, float]
_KEYS: dict[str, dict[str, tuple[int, _Limits]]] = {
    "imu": {
        "gyro_noise_radps_rthz": (3, (0.0, 0.1)),
        "accel_noise_mps2_rthz": (3, (0.0, 1.0)),
        "gyro_bias_std_radps": (1, (0.0, 0.5)),
        "accel_bias_std_mps2": (1, (0.0, 5.0)),
        "bias_left_by_estimator": (1, (0.0, 1.0)),
    },
    "fix": {
        "rate_hz": (1, (0.1, 250.0)),
        "delay_s": (1, (0.0, 1.0)),
        "pos_std_m": (3, (0.0, 50.0)),
        "vel_std_mps": (3, (0.0, 10.0)),
    },
    "estimate": {
        "pos_std_m": (3, (0.0, 50.0)),
        "pos_bias_std_m": (3, (0.0, 50.0)),
        "pos_time_constant_s": (1, (0.001, 1e4)),
        "vel_std_mps": (3, (0.0, 10.0)),
        "vel_time_constant_s": (1, (0.001, 1e4)),
        "tilt_std_rad": (1, (0.0, 0.5)),
        "tilt_time_constant_s": (1, (0.001, 1e4)),
        "heading_std_rad": (1, (0.0, 1.0)),
        "heading_time_constant_s": (1, (0.001, 1e4)),
    },
    "kalman": {
        "imu_samples": (1, (1.0, 2.0)),
        "accel_bias_std_mps2": (3, (0.0, 1.0)),
        "accel_bias_time_constant_s": (1, (0.1, 1e4)),
        "vel_smoothing_s": (1, (0.01, 100.0)),
        "pos_follows_vel_s": (1, (0.01, 100.0)),
    },
    "air": {
        "baro_std_pa": (1, (0.0, 100.0)),
        "mag_std_gauss": (3, (0.0, 1.0)),
    },
}
"""Table -> key -> (how many numbers, inclusive range)."""


@dataclass(frozen=True, slots=True)
class ImuGrade:
    """White noise densities and turn-on biases of gyro and accelerometer, body FRD."""

    gyro_noise_radps_rthz: Tuple3
    accel_noise_mps2_rthz: Tuple3
    gyro_bias_std_radps: float
    accel_bias_std_mps2: float
    bias_left_by_estimator: float
    """Share of the turn-on bias that remains in what the autopilot reports."""


@dataclass(frozen=True, slots=True)
class FixGrade:
    """Raw position sensor (motion capture or GPS): white noise, rate, delay."""

    rate_hz: float
    delay_s: float
    pos_std_m: Tuple3
    vel_std_mps: Tuple3


@dataclass(frozen=True, slots=True)
class EstimateGrade:
    """Error statistics of the state estimate: first-order Gauss-Markov, plus a position bias constant in a flight."""

    pos_std_m: Tuple3
    pos_bias_std_m: Tuple3
    pos_time_constant_s: float
    vel_std_mps: Tuple3
    vel_time_constant_s: float
    tilt_std_rad: float
    tilt_time_constant_s: float
    heading_std_rad: float
    heading_time_constant_s: float


@dataclass(frozen=True, slots=True)
class KalmanGrade:
    """What PX4's Kalman filter adds: coloured IMU noise, a wrong bias estimate, position errors that follow velocity's.

    Sources: recorded flights of PX4 with its simulator SIH; `sensors` and `estimator` say what is done with it.
    """

    imu_samples: float
    """Samples in the trapezoidal mean that is reported: 2 make its noise MA(1) with a lag-1 correlation of 0.5."""
    accel_bias_std_mps2: Tuple3
    """Of the filter's estimate of a bias that is not there; it is taken out of what is reported."""
    accel_bias_time_constant_s: float
    vel_smoothing_s: float
    """Low-pass of the velocity error's slow part."""
    pos_follows_vel_s: float
    """T in e_p' = e_v - e_p / T: position sums up the velocity's error until the fixes pull it back."""


@dataclass(frozen=True, slots=True)
class AirGrade:
    """White noise of the barometer and the magnetometer."""

    baro_std_pa: float
    mag_std_gauss: Tuple3


@dataclass(frozen=True, slots=True)
class Grade:
    """A whole sensor file."""

    name: str
    imu: ImuGrade
    fix: FixGrade
    estimate: EstimateGrade
    air: AirGrade
    kalman: KalmanGrade | None = None
    """None: all errors are independent of one another."""


def load_grade(name: str) -> Grade:
    """The grade of this name among those that come with the simulator."""
    if name not in GRADES:
        raise InputError(f"sensors {name!r}: unknown grade; use one of {', '.join(GRADES)}")
    source = f"sim/grades/{name}.toml"
    return parse_grade(resources.files("flightstack_sim").joinpath("grades", f"{name}.toml").read_text("utf-8"), source)


def grade_keys() -> list[str]:
    """Every dotted key of a grade's file that can be changed."""
    return [f"{table}.{key}" for table, keys in _KEYS.items() for key in keys]


def changed_grade(name: str, changes: Mapping[str, object], source: str) -> Grade:
    """The grade of this name with these keys of its file changed; InputError where they are not allowed."""
    if not changes:
        return load_grade(name)
    load_grade(name)
    text = resources.files("flightstack_sim").joinpath("grades", f"{name}.toml").read_text("utf-8")
    return parse_grade(toml_text(changed(tomllib.loads(text), changes, source)), source)


def parse_grade(text: str, source: str) -> Grade:
    """Read a sensor file's text; `source` names it in errors."""
    table = load_toml(text, source, SCHEMA, ("name", *_KEYS))
    return Grade(
        words(table.get("name"), f"{source}: name"),
        ImuGrade(**_section(table, "imu", source)),
        FixGrade(**_section(table, "fix", source)),
        EstimateGrade(**_section(table, "estimate", source)),
        AirGrade(**_section(table, "air", source)),
        KalmanGrade(**_section(table, "kalman", source)) if "kalman" in table else None,
    )


def _section(table: dict[str, Any], section: str, source: str) -> dict[str, Any]:
    values = table.get(section)
    if not isinstance(values, dict):
        raise InputError(f"{source}: table [{section}] is missing")
    spec = _KEYS[section]
    only(values, spec, f"{source}: {section}")
    return {key: _numbers(values.get(key), f"{source}: {section}.{key}", *rule) for key, rule in spec.items()}


def _numbers(value: Any, where: str, count: int, limits: _Limits) -> Any:
    low, high = limits
    numbers = value if count > 1 else [value]
    valid = isinstance(numbers, list) and len(numbers) == count
    if valid:
        valid = all(isinstance(x, (int, float)) and not isinstance(x, bool) and low <= x <= high for x in numbers)
    if not valid:
        kind = "a number" if count == 1 else f"a list of {count} numbers"
        raise InputError(f"{where} = {value!r}: must be {kind} from {low:g} to {high:g}")
    return float(value) if count == 1 else tuple(float(x) for x in numbers)
