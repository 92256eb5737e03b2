"""What the commander asks of the control loops: one small tagged record."""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

from flightstack.types import Tuple3, Tuple4

NAN = math.nan
UNSET: Tuple3 = (NAN, NAN, NAN)


class ControlKind(Enum):
    """What a setpoint controls."""

    OFF = "off"
    """Disarmed: motors off."""
    RATE = "rate"
    """Body rates (NaN: no action on that axis' error) and collective thrust (NaN: motors off)."""
    ATTITUDE = "attitude"
    """Attitude, yaw rate fed forward, collective thrust."""
    POSITION = "position"
    """Position, velocity, acceleration with offboard's limits (MPC_XY_VEL_MAX, MPC_Z_VEL_MAX_*)."""
    GOTO = "goto"
    """The same with the limits of automatic modes (MPC_XY_CRUISE, MPC_Z_V_AUTO_*); unset position: stop and hold."""
    TAKEOFF = "takeoff"
    """Climb to a height at MPC_TKO_SPEED; unset horizontal position: here."""
    LAND = "land"
    """Descend at the landing speed; unset horizontal position: where it can stop."""


POSITION_KINDS = (ControlKind.POSITION, ControlKind.GOTO, ControlKind.TAKEOFF, ControlKind.LAND)
HOLDING_KINDS = (ControlKind.GOTO, ControlKind.TAKEOFF, ControlKind.LAND)


class ControlSetpoint(NamedTuple):
    """What the control loops shall do; fields that the kind doesn't use are left at their defaults, NaN is unset."""

    kind: ControlKind
    rate_frd_radps: Tuple3 = (0.0, 0.0, 0.0)
    thrust_norm: float = 0.0
    q_ned_frd: Tuple4 = (1.0, 0.0, 0.0, 0.0)
    pos_ned_m: Tuple3 = UNSET
    vel_ned_mps: Tuple3 = UNSET
    acc_ned_mps2: Tuple3 = UNSET
    yaw_rad: float = NAN
    yaw_rate_radps: float = NAN
    speed_mps: float = NAN
    """Of automatic modes: the most horizontal speed; NaN: MPC_XY_CRUISE."""


OFF = ControlSetpoint(ControlKind.OFF)
HOLD = ControlSetpoint(ControlKind.GOTO)
LAND = ControlSetpoint(ControlKind.LAND)
