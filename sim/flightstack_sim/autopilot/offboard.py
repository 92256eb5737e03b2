"""Offboard setpoints: from SET_ATTITUDE_TARGET and SET_POSITION_TARGET_* to what the control loops fly.

Which masks count as a signal, and what becomes of what they leave out, follows PX4 (measured, mask by mask):
roll and pitch rate go together, a body-rate setpoint without either is dropped; the yaw rate may be left out; thrust
left out becomes 0.  Nothing here raises: what isn't finite is "not set", what is huge is held within physical sense.
"""

from __future__ import annotations

import math
from typing import Final

from flightstack.geodesy import LocalFrame
from flightstack.rows import Q_W, Q_X, Q_Y, Q_Z
from flightstack.types import Tuple3, Tuple4
from flightstack_sim.autopilot.setpoint import NAN, ControlKind, ControlSetpoint
from mavlink_bridge.messages import SetAttitudeTarget, SetPositionTargetGlobalInt, SetPositionTargetLocalNed

# SET_ATTITUDE_TARGET.type_mask
_NO_ROLL_RATE: Final = 1
_NO_PITCH_RATE: Final = 2
_NO_YAW_RATE: Final = 4
_NO_THRUST: Final = 64
_NO_ATTITUDE: Final = 128

# SET_POSITION_TARGET_LOCAL_NED.type_mask: three bits each for position, velocity, acceleration, then these
_NO_ACCELERATION: Final = 7 << 6
_FORCE: Final = 512
_NO_YAW: Final = 1024
_NO_YAW_RATE_P: Final = 2048
_LOCAL_NED: Final = 1
_BODY_FRAMES: Final = (8, 12)  # BODY_NED, BODY_FRD

_ABOVE_SEA: Final = (0, 5)  # GLOBAL, GLOBAL_INT
_ABOVE_HOME: Final = (3, 6)  # GLOBAL_RELATIVE_ALT, the same INT

_MAX_RATE_RADPS: Final = 100.0
_MAX_POS_M: Final = 1e6
_MAX_VEL_MPS: Final = 1e3
_MAX_ACC_MPS2: Final = 1e3
_NO_ROTATION: Final = 1e-6


def _within(value: float, limit: float) -> float:
    """The value, held within +-limit; NaN where it isn't finite."""
    if -limit <= value <= limit:
        return value
    return math.copysign(limit, value) if math.isfinite(value) else NAN


def attitude_kind(type_mask: int) -> ControlKind | None:
    """What a SET_ATTITUDE_TARGET with this mask controls; None: it is dropped and no offboard signal."""
    if not type_mask & _NO_ATTITUDE:
        return ControlKind.ATTITUDE  # the attitude loop overwrites the rates, given or not
    if type_mask & (_NO_ROLL_RATE | _NO_PITCH_RATE):
        return None
    return ControlKind.RATE


def from_attitude_target(message: SetAttitudeTarget, last: ControlSetpoint | None) -> ControlSetpoint | None:
    """The setpoint to fly, None where the message is no signal.

    An attitude that is no rotation (q = 0 or not finite) keeps the one flown `last`.
    """
    mask, thrust, (x, y, z) = message.type_mask, message.thrust_norm, message.rate_frd_radps
    kind = attitude_kind(mask)
    if kind is None:
        return None
    if mask & _NO_THRUST:
        thrust = 0.0
    elif not 0.0 <= thrust <= 1.0:
        thrust = NAN if not math.isfinite(thrust) else 0.0 if thrust < 0.0 else 1.0
    most = _MAX_RATE_RADPS
    if not (-most <= x <= most and -most <= y <= most and -most <= z <= most):
        x, y, z = _within(x, most), _within(y, most), _within(z, most)
    yaw_rate = NAN if mask & _NO_YAW_RATE else z
    if kind is ControlKind.RATE:
        return ControlSetpoint(kind, (x, y, yaw_rate), thrust)
    q = _unit(message.q_ned_frd)
    if q is None:
        q = last.q_ned_frd if last is not None and last.kind is ControlKind.ATTITUDE else (1.0, 0.0, 0.0, 0.0)
    return ControlSetpoint(kind, thrust_norm=thrust, q_ned_frd=q, yaw_rate_radps=yaw_rate)


def _unit(q: Tuple4) -> Tuple4 | None:
    norm = math.sqrt(sum(min(abs(c), 1e9) ** 2 for c in q))
    if not _NO_ROTATION < norm < 1e6:  # False for NaN too
        return None
    return q[Q_W] / norm, q[Q_X] / norm, q[Q_Y] / norm, q[Q_Z] / norm


def from_position_target(message: SetPositionTargetLocalNed, yaw_rad: float) -> ControlSetpoint | None:
    """The setpoint to fly, None where the message is no signal; `yaw_rad`: the vehicle's heading, for body frames.

    Forces in place of accelerations (mask bit 9) and frames other than local NED and body aren't supported; a body
    frame has no positions.
    """
    mask, frame = message.type_mask, message.frame
    if frame != _LOCAL_NED and frame not in _BODY_FRAMES:
        return None
    if mask & _FORCE and mask & _NO_ACCELERATION != _NO_ACCELERATION:
        return None
    pos = _chosen(message.pos_ned_m, mask, _MAX_POS_M)
    vel = _chosen(message.vel_ned_mps, mask >> 3, _MAX_VEL_MPS)
    acc = _chosen(message.acc_ned_mps2, mask >> 6, _MAX_ACC_MPS2)
    if frame != _LOCAL_NED:
        pos, vel, acc = (NAN, NAN, NAN), _turned(vel, yaw_rad), _turned(acc, yaw_rad)
    if all(math.isnan(value) for value in (*pos, *vel, *acc)):
        return None
    yaw = NAN if mask & _NO_YAW else math.remainder(_within(message.yaw_rad, 1e6), 2.0 * math.pi)
    yaw_rate = NAN if mask & _NO_YAW_RATE_P else _within(message.yaw_rate_radps, _MAX_RATE_RADPS)
    return ControlSetpoint(
        ControlKind.POSITION, pos_ned_m=pos, vel_ned_mps=vel, acc_ned_mps2=acc, yaw_rad=yaw, yaw_rate_radps=yaw_rate
    )


def from_global_target(
    message: SetPositionTargetGlobalInt, frame: LocalFrame, home_altitude_m: float
) -> ControlSetpoint | None:
    """The same with the position on the globe, its height above the sea or above home."""
    if message.frame not in _ABOVE_SEA and message.frame not in _ABOVE_HOME:
        return None
    north, east = frame.to_local(message.lat_deg, message.lon_deg)
    above_sea_m = message.alt_m + (home_altitude_m if message.frame in _ABOVE_HOME else 0.0)
    local = SetPositionTargetLocalNed(
        message.t_boot_us, message.target_system, message.target_component, _LOCAL_NED, message.type_mask,
        (north, east, frame.altitude_m - above_sea_m), message.vel_ned_mps, message.acc_ned_mps2,
        message.yaw_rad, message.yaw_rate_radps,
    )  # fmt: skip
    return from_position_target(local, 0.0)


def _chosen(values: Tuple3, ignore: int, limit: float) -> Tuple3:
    """The components whose ignore bit is clear, NaN elsewhere."""
    x, y, z = values
    return (
        NAN if ignore & 1 else _within(x, limit),
        NAN if ignore & 2 else _within(y, limit),
        NAN if ignore & 4 else _within(z, limit),
    )


def _turned(v: Tuple3, yaw_rad: float) -> Tuple3:
    """A heading-frame vector in north-east-down; a horizontal half that isn't whole is unset."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]
