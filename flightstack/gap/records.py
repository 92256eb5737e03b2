"""What passes between the steps of the gap workflow: check -> compare -> locate -> name -> add -> verify -> report.

A `Flight` is what a log says, topic by topic, each with its own time stamps.  `Samples` is the same flight on one
grid, its topics shifted by the offsets that the data check found: all later steps work on it.  Everything is in SI,
NED and FRD; the ground lies at pos_d = 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from flightstack.types import F64

SIGNALS = (
    "specific_force_x",
    "specific_force_y",
    "specific_force_z",
    "angular_acceleration_x",
    "angular_acceleration_y",
    "angular_acceleration_z",
)
"""The one-step residual's first six columns: m/s^2 and rad/s^2, body FRD."""

KINEMATICS = ("rate_x", "rate_y", "rate_z", "acceleration_x", "acceleration_y", "acceleration_z")
"""Its last six: gyro against the attitude's derivative (rad/s), accelerometer against the velocity's (m/s^2), FRD.

No force and no torque shows in them, only sensor effects do.
"""

REGIMES = (
    "hover",
    "climb",
    "descent",
    "forward",
    "fast_forward",
    "near_ground",
    "full_throttle",
    "low_battery",
    "turning",
)
DRIVERS = (
    "position",
    "airspeed",
    "time",
    "attitude",
    "heading",
    "rate",
    "acceleration",
    "thrust",
    "height",
    "battery",
)
"""Quantities that a residual can depend on, as `gap.json` names them."""


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """One logged quantity with its own time stamps."""

    t_s: F64
    """(N,) seconds on the log's clock, strictly ascending."""
    value: F64
    """(N,) or (N, k), SI, NED/FRD."""
    source: str
    """Topic or columns it was read from."""


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """What one log says.

    Signals: pos_ned_m, vel_ned_mps, acc_ned_mps2 (kinematic), q_ned_frd (scalar first), rate_frd_radps,
    accel_frd_mps2 (specific force), motor (N, 4; normalised 0..1 commands as CONTRACT section 4 counts them, in the
    vehicle file's order), battery_v, height_m (over ground), landed (0 or 1).  What the log lacks is absent.
    """

    name: str
    kind: str
    """mcap, ulog, csv, cfusdlog."""
    signals: Mapping[str, Signal]
    notes: tuple[str, ...] = ()
    """What was done to read it, one line each: mapped columns, applied THR_MDL_FAC, removed rows."""


@dataclass(frozen=True, slots=True)
class Offset:
    """By how much one topic's stamps are late against the attitude's; its 95 % interval; NaN where unidentifiable."""

    signal: str
    offset_s: float
    low_s: float
    high_s: float


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the data check."""

    name: str
    level: str
    """ok, warning, refused."""
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """One flight's flying part on a uniform grid; NaN columns where a signal is missing.

    Values are linear interpolations of the (offset-corrected) topics, gaps longer than three of the topic's periods
    are `valid` = False.  `noise` is the white noise of each measured signal, one standard deviation per sample.
    """

    name: str
    t_s: F64
    """(N,) uniform."""
    dt_s: float
    pos_ned_m: F64
    vel_ned_mps: F64
    q_ned_frd: F64
    rate_frd_radps: F64
    accel_frd_mps2: F64
    """(N, 3) specific force: the accelerometer's, else from velocity and attitude (`derived` says so)."""
    motor: F64
    """(N, 4) commands, held between the stamps at which they were sent."""
    battery_v: F64
    """(N,) 0 where unknown."""
    height_m: F64
    """(N,) of the CoM over ground; NaN where unknown."""
    valid: NDArray[np.bool_]
    noise: Mapping[str, float] = field(default_factory=dict)
    derived: tuple[str, ...] = ()
    bandwidth_hz: float = 0.0
    """Up to here the slowest topic in use carries information."""
    command_late_s: float = 0.0
    """How much later the commands acted than the motor column says, where a log can't tell: within half a sample."""
    bias_frd_mps2: F64 | None = None
    """(N, 3) what is taken for the estimator's slow error in the specific force (`gap.estimator_bias`)."""


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """What the data check hands on."""

    flight: Flight
    samples: Samples | None
    """None where the log can't be used."""
    findings: tuple[Finding, ...]
    offsets: tuple[Offset, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """One-step disagreement of one flight: measured minus simulated, both through the same low pass.

    y (N, 12) in the order of SIGNALS + KINEMATICS, NaN columns where a channel can't be had and NaN rows where the
    samples are not usable; noise (12,) expected standard deviation of y from the sensors alone.
    """

    y: F64
    noise: F64


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter of a named effect: the value that goes into the vehicle file and its 95 % interval."""

    before: float
    estimate: float
    low: float
    high: float
    told: bool = True
    """False where the logs can't tell it: it stays what the file has, and the interval is all that is plausible."""


@dataclass(frozen=True, slots=True)
class Across:
    """One parameter of a named effect, flight by flight."""

    effect: str
    parameter: str
    p_value: float
    """Of its being the same in each, small differences allowed."""
    same: bool
    flights: tuple[tuple[str, Estimate], ...]
    """Log and what it says alone."""


@dataclass(frozen=True, slots=True)
class IdentifiedEffect:
    """One named effect."""

    name: str
    parameters: Mapping[str, Estimate]
    delta_bic: float
    holdout_gain: float
    """Share of the explainable held-out gap that falls when this effect joins the others; NaN where it hardly acts."""
    p_value: float
    indistinguishable_from: tuple[str, ...] = ()
    manoeuvre: str = ""
    """What to fly to split it from those; empty where it stands alone."""


@dataclass(frozen=True, slots=True)
class Rejected:
    """A candidate that was not named, and why in a few words."""

    name: str
    delta_bic: float
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Unexplained:
    """What is left over when all that was named is in the model."""

    significant: bool
    depends_on: tuple[str, ...] = ()
    fraction: float = 0.0
    shown: str = ""
    """What shows it, where neither force nor turning does."""


@dataclass(frozen=True, slots=True)
class ChannelResidual:
    """One channel's disagreement before anything is named."""

    signal: str
    rms: float
    unit: str
    expected_noise: float
    worst_regime: str
    correlates_with: str


@dataclass(frozen=True, slots=True)
class Figures:
    """Rms on held-out data; None where the log can't show it."""

    one_step_mps2: float | None
    one_step_radps2: float | None
    rollout_1s_m: float | None


@dataclass(frozen=True, slots=True)
class Gap:
    """The verdict in figures; `closed` as CONTRACT section 5 defines it."""

    before: Figures
    after: Figures
    noise_floor: Figures
    closed: float | None


_PX4, _ARDUPILOT = "PX4: SDLOG_MODE 0, SDLOG_PROFILE 25", "ArduPilot: LOG_BITMASK with fast attitude and fast IMU"
_ON_BOARD = f"on board, a telemetry log is too slow. {_PX4}; {_ARDUPILOT}"


def how_to_record(kind: str) -> str:
    """Which settings record what is needed, for the autopilots that write this kind of log."""
    return {"dataflash": _ARDUPILOT, "tlog": _ON_BOARD}.get(kind, _PX4)


def ok(name: str, text: str) -> Finding:
    """Nothing to do."""
    return Finding(name, "ok", text)


def warning(name: str, text: str) -> Finding:
    """Mended, or worth knowing."""
    return Finding(name, "warning", text)


def refused(name: str, text: str) -> Finding:
    """The log can't be used; `text` says why and what to do instead."""
    return Finding(name, "refused", text)
