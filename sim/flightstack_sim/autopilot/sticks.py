"""Flying by hand: MANUAL_CONTROL's sticks as setpoints of Position, Altitude, Stabilized and Manual.

Position: sticks are velocities along the heading (MPC_VEL_MANUAL, changing by MPC_ACC_HOR at most), centred they
hold the place.  Altitude: sticks lean by up to MPC_MAN_TILT_MAX, the throttle climbs and descends, centred it holds
the height.  Stabilized and Manual: the throttle is thrust, hover in its middle.  Yaw turns by MPC_MAN_Y_MAX in all.
Source: PX4 user guide, "Flight Modes (Multicopter)"; curves (expo, jerk limits) are left out.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from flightstack.frames import quat_from_euler
from flightstack.types import STANDARD_GRAVITY_MPS2, Tuple3
from flightstack_sim.autopilot import modes
from flightstack_sim.autopilot.modes import Mode
from flightstack_sim.autopilot.params import Params
from flightstack_sim.autopilot.setpoint import NAN, ControlKind, ControlSetpoint
from mavlink_bridge.messages import ManualControl

_TICK_S: Final = 0.004
_DEAD: Final = 0.1
_HOLDS_BELOW_MPS: Final = {2: 0.6, 1: 0.8, 0: 0.8}
"""A vehicle so slow along an axis keeps its place from there on (PX4's MPC_HOLD_MAX_XY, MPC_HOLD_MAX_Z)."""
_NOT_GIVEN: Final = 0x7FFF
FLOWN_BY_STICKS: Final = (modes.POSCTL, modes.POSITION_SLOW, modes.ALTCTL, modes.STABILIZED, modes.MANUAL)


class Sticks(NamedTuple):
    """Forward, right, up, clockwise: -1..1."""

    forward: float = 0.0
    right: float = 0.0
    up: float = 0.0
    turn: float = 0.0


def from_manual_control(message: ManualControl) -> Sticks:
    """What a MANUAL_CONTROL says; its throttle is 0..1000, an axis that is not given is centred."""
    forward, right, throttle, turn = (
        0.0 if value == _NOT_GIVEN else min(max(value * 1e-3, -1.0), 1.0)
        for value in (message.x, message.y, message.z, message.r)
    )
    return Sticks(forward, right, 0.0 if message.z == _NOT_GIVEN else min(max(2.0 * throttle - 1.0, -1.0), 1.0), turn)


def _dead(value: float) -> float:
    """Without the middle, in which nothing happens."""
    return math.copysign(max(0.0, abs(value) - _DEAD) / (1.0 - _DEAD), value)


class StickFlight:
    """One vehicle flown by hand."""

    __slots__ = ("_hold_ned_m", "_mode", "_params", "_vel_mps", "_yaw_rad")

    def __init__(self, params: Params) -> None:
        self._params = params
        self._mode: Mode | None = None
        self._yaw_rad = 0.0
        self._vel_mps = (0.0, 0.0)
        self._hold_ned_m = [NAN, NAN, NAN]

    def leave(self) -> None:
        """Another mode flies."""
        self._mode = None

    def step(
        self, mode: Mode, sticks: Sticks, pos_ned_m: Tuple3, vel_ned_mps: Tuple3, yaw_rad: float, hover: float
    ) -> ControlSetpoint:
        """The setpoint of this tick; `hover`: the collective thrust that carries the vehicle."""
        if mode is not self._mode:
            self._mode, self._yaw_rad = mode, yaw_rad
            self._vel_mps = vel_ned_mps[:2]
            self._hold_ned_m = [NAN, NAN, NAN]
        get = self._params.get
        yaw_rate = math.radians(get("MPC_MAN_Y_MAX")) * _dead(sticks.turn)
        if mode in (modes.STABILIZED, modes.MANUAL):
            return self._lean(sticks, yaw_rate, hover)
        climb = _dead(sticks.up)
        down_mps = -climb * get("MPC_Z_VEL_MAX_UP" if climb > 0.0 else "MPC_Z_VEL_MAX_DN")
        keep_down = self._keep((2,), climb == 0.0, pos_ned_m, vel_ned_mps)[0]
        ahead, right = _dead(sticks.forward), _dead(sticks.right)
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        north, east = cos * ahead - sin * right, sin * ahead + cos * right
        if mode is modes.ALTCTL:
            most = STANDARD_GRAVITY_MPS2 * math.tan(math.radians(get("MPC_MAN_TILT_MAX")))
            return ControlSetpoint(
                ControlKind.POSITION, pos_ned_m=(NAN, NAN, keep_down), vel_ned_mps=(NAN, NAN, down_mps),
                acc_ned_mps2=(most * north, most * east, NAN), yaw_rate_radps=yaw_rate,
            )  # fmt: skip
        wanted = get("MPC_VEL_MANUAL") * north, get("MPC_VEL_MANUAL") * east
        self._vel_mps = self._toward(wanted)
        centred = wanted == (0.0, 0.0) and math.hypot(*self._vel_mps) < _HOLDS_BELOW_MPS[0]
        keep_north, keep_east = self._keep((0, 1), centred, pos_ned_m, vel_ned_mps)
        return ControlSetpoint(
            ControlKind.POSITION, pos_ned_m=(keep_north, keep_east, keep_down),
            vel_ned_mps=(*self._vel_mps, down_mps), yaw_rate_radps=yaw_rate,
        )  # fmt: skip

    def _toward(self, wanted: tuple[float, float]) -> tuple[float, float]:
        """The velocity setpoint, no faster changed than the vehicle may accelerate."""
        dn, de = wanted[0] - self._vel_mps[0], wanted[1] - self._vel_mps[1]
        change, most = math.hypot(dn, de), self._params.get("MPC_ACC_HOR") * _TICK_S
        share = 1.0 if change <= most else most / change
        return self._vel_mps[0] + share * dn, self._vel_mps[1] + share * de

    def _keep(self, axes: tuple[int, ...], centred: bool, pos_ned_m: Tuple3, vel_ned_mps: Tuple3) -> tuple[float, ...]:
        """Where these axes stay once the vehicle has stopped with its sticks centred; NaN: nowhere."""
        stopped = centred and math.hypot(*(vel_ned_mps[axis] for axis in axes)) < _HOLDS_BELOW_MPS[axes[0]]
        for axis in axes:
            if not centred:
                self._hold_ned_m[axis] = NAN
            elif stopped and math.isnan(self._hold_ned_m[axis]):
                self._hold_ned_m[axis] = pos_ned_m[axis]
        return tuple(self._hold_ned_m[axis] for axis in axes)

    def _lean(self, sticks: Sticks, yaw_rate: float, hover: float) -> ControlSetpoint:
        """An attitude and a thrust."""
        get = self._params.get
        tilt = math.radians(get("MPC_MAN_TILT_MAX"))
        self._yaw_rad = math.remainder(self._yaw_rad + yaw_rate * _TICK_S, 2.0 * math.pi)
        low = get("MPC_MANTHR_MIN")
        thrust = hover + sticks.up * (get("MPC_THR_MAX") - hover if sticks.up > 0.0 else hover - low)
        q = quat_from_euler(tilt * _dead(sticks.right), -tilt * _dead(sticks.forward), self._yaw_rad)
        w, x, y, z = q.tolist()
        return ControlSetpoint(
            ControlKind.ATTITUDE, thrust_norm=thrust, q_ned_frd=(w, x, y, z), yaw_rate_radps=yaw_rate
        )
