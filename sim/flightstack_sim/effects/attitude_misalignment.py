"""Attitude misalignment: the measured attitude is the true one followed by a small body rotation."""

from __future__ import annotations

from flightstack.frames import quat_from_euler
from flightstack.types import F64
from flightstack_sim.layout import p_effect

ROLL = p_effect("attitude_misalignment", "roll_rad")
PITCH = p_effect("attitude_misalignment", "pitch_rad")
YAW = p_effect("attitude_misalignment", "yaw_rad")


def rotation(p: F64) -> F64:
    """Quaternion (4,) of one parameter row: q_measured = q_ned_frd (x) this."""
    return quat_from_euler(p[ROLL], p[PITCH], p[YAW])
