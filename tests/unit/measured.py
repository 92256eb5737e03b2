"""A measurement from its parts."""

from __future__ import annotations

import numpy as np

from flightstack.types import F64, Measurement


def measured(
    t_us: int, pos_ned_m: F64, vel_ned_mps: F64, q_ned_frd: F64, rate_frd_radps: F64, specific_force_frd_mps2: F64,
    motor_command: F64, position_age_us: int, attitude_age_us: int, imu_age_us: int,
) -> Measurement:  # fmt: skip
    """As `Measurement` names them."""
    parts = [pos_ned_m, vel_ned_mps, q_ned_frd, rate_frd_radps, specific_force_frd_mps2, motor_command]
    return Measurement(t_us, np.concatenate(parts), position_age_us, attitude_age_us, imu_age_us)
