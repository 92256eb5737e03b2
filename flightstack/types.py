"""What crosses modules: frozen dataclasses with frame and unit in every name.

Frames are NED (world) and FRD (body); quaternions are Hamilton, scalar first, body to world (`q_ned_frd` turns an FRD
vector into NED).  Time is integer microseconds of the vehicle's own clock (`t_us`, since its boot).
Arrays are float64 and must not be written to by whoever receives them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Tuple3 = tuple[float, float, float]
Tuple4 = tuple[float, float, float, float]

STANDARD_GRAVITY_MPS2 = 9.80665


class InputError(ValueError):
    """Bad input of a user: a file, a key, an argument.  Its text is one line that says what is wrong and what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class FlatOutput:
    """One point of a reference: the flat outputs (position, yaw) and their time derivatives."""

    pos_ned_m: F64
    vel_ned_mps: F64
    acc_ned_mps2: F64
    jerk_ned_mps3: F64
    snap_ned_mps4: F64
    yaw_rad: float = 0.0
    yaw_rate_radps: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """What the vehicle reports of itself, predicted to `t_us`; an age is `t_us` minus the stream's own sample time."""

    t_us: int
    pos_ned_m: F64
    vel_ned_mps: F64
    q_ned_frd: F64
    rate_frd_radps: F64
    specific_force_frd_mps2: F64
    motor_command: F64
    """(4,) normalised commands last reported applied (0..1), NaN where the vehicle doesn't report them."""
    position_age_us: int
    attitude_age_us: int
    imu_age_us: int


@dataclass(frozen=True, slots=True, eq=False)
class Command:
    """What is sent: total thrust along body -z and body rates."""

    t_us: int
    thrust_n: float
    """Total thrust the model expects, newton (0 or more)."""
    thrust_norm: float
    """The same, as the normalised collective thrust that PX4 takes, 0..1."""
    rate_frd_radps: F64


@dataclass(frozen=True, slots=True, eq=False)
class TickRecord:
    """Why the command is what it is: one tick of the stack, for the log."""

    t_us: int
    reference: FlatOutput
    nominal_acc_ned_mps2: F64
    nominal_jerk_ned_mps3: F64
    measurement: Measurement
    thrust_ff_n: float
    thrust_fb_n: float
    rate_ff_frd_radps: F64
    rate_fb_frd_radps: F64
    attitude_error_rad: F64
    command: Command
    thrust_saturated: bool
    guard: str
    """Empty where the guard let the command pass, else the name of what it did instead."""
