"""From a setpoint to what the position loop follows: hold points, speeds, take-off ramp, landing, ground contact.

On the ground the thrust stays 0 until the motors have spun up (COM_SPOOLUP_TIME) and the setpoint wants the vehicle up;
then the climb is let out over MPC_TKO_RAMP_T.  A landing slows from MPC_Z_V_AUTO_DN at MPC_LAND_ALT1 to MPC_LAND_SPEED
at MPC_LAND_ALT2 above home.  Ground contact levels the vehicle at MPC_THR_MIN; once landed it is 0 again.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.frames import euler_from_quat, quat_from_euler
from flightstack.rows import ACC_E, ACC_N, VEL_D, VEL_E, VEL_N
from flightstack.types import F64
from flightstack_sim.autopilot.land_detector import LandDetector
from flightstack_sim.autopilot.params import Params
from flightstack_sim.autopilot.position_control import SP_YAW, PositionControl
from flightstack_sim.autopilot.setpoint import HOLDING_KINDS, OFF, ControlKind, ControlSetpoint

_WANTS_UP_M = 0.05
"""A position setpoint this far above the vehicle starts a take-off."""
_SHARE_OF_BRAKING = 0.7
"""Share of MPC_ACC_HOR that a planned stop uses, so that the loop has some left."""
_LEASH_M = 2.0
"""The horizontal reference waits for the vehicle beyond this distance (PX4's MPC_XY_ERR_MAX)."""
_IGNORE_CONTACT_S = 0.5
"""The land detector needs this long to notice that thrust came back."""


class Guidance:
    """Setpoint logic in front of one vehicle's position loop; results are `q_setpoint_ned_frd` (4,) and `thrust`."""

    def __init__(self, params: Params, dt_s: float) -> None:
        self._dt_s = dt_s
        self.position = PositionControl(params, dt_s)
        self.q_setpoint_ned_frd = np.array([1.0, 0.0, 0.0, 0.0])
        self.thrust = 0.0
        self.descent_setpoint_mps = math.nan
        self._on_ground = True
        self._ramp_s = math.inf
        self._hold_ned_m = [0.0, 0.0, 0.0]
        self._reference = (0.0, 0.0, 0.0, 0.0)  # north, east position and velocity of the point that is followed
        self._yaw_rad = 0.0
        self._last = OFF
        self.configure(params)

    @property
    def taking_off(self) -> bool:
        """The climb's ramp is running."""
        return not self._on_ground and self._ramp_s < self._ramp_time_s

    def configure(self, params: Params) -> None:
        """Take gains, speeds and times from the parameters."""
        get = params.get
        self.position.configure(params)
        tilt, down, cruise = math.radians(get("MPC_TILTMAX_AIR")), get("MPC_Z_V_AUTO_DN"), get("MPC_XY_CRUISE")
        self._limits = {
            ControlKind.POSITION: (get("MPC_XY_VEL_MAX"), get("MPC_Z_VEL_MAX_UP"), get("MPC_Z_VEL_MAX_DN"), tilt),
            ControlKind.GOTO: (cruise, get("MPC_Z_V_AUTO_UP"), down, tilt),
            ControlKind.TAKEOFF: (cruise, get("MPC_TKO_SPEED"), down, tilt),
            ControlKind.LAND: (cruise, get("MPC_Z_V_AUTO_UP"), down, tilt),
        }
        self._tilt_on_ground_rad = math.radians(get("MPC_TILTMAX_LND"))
        self._ramp_time_s, self._spool_up_s = get("MPC_TKO_RAMP_T"), get("COM_SPOOLUP_TIME")
        self._land_speed, self._land_low_m, self._land_high_m = (
            get("MPC_LAND_SPEED"),
            get("MPC_LAND_ALT2"),
            get("MPC_LAND_ALT1"),
        )
        self._acc_mps2 = get("MPC_ACC_HOR")
        horizontal = _SHARE_OF_BRAKING * self._acc_mps2
        self._brake_mps2 = (horizontal, horizontal, _SHARE_OF_BRAKING * get("MPC_ACC_DOWN_MAX"))
        self._thrust_min = get("MPC_THR_MIN")

    def release(self, landed: bool) -> None:
        """Another kind of control is active: forget integrals and hold points, remember whether it stands."""
        self._on_ground = landed
        self._ramp_s = math.inf
        self.descent_setpoint_mps = math.nan
        self._last = OFF

    def step(self, setpoint: ControlSetpoint, state: F64, land: LandDetector, armed_s: float) -> None:
        """One step from the estimate's state (13,)."""
        self._capture(setpoint, state)
        self._last = setpoint
        self._fill(setpoint, state)
        if self._on_ground:
            self._start_reference(state, moving=False)
            if armed_s < self._spool_up_s or not self._wants_up(setpoint, state):
                self._idle(0.0)
                return
            self._on_ground = False
            self._ramp_s = 0.0
            self.position.reset()
        elif self._ramp_s > _IGNORE_CONTACT_S and land.landed:
            self._on_ground = True
            self._idle(0.0)
            return
        self._ramp_s += self._dt_s
        speed, climb, descent, tilt = self._limits[setpoint.kind]
        if setpoint.speed_mps > 0.0:  # False where it is unset
            speed = setpoint.speed_mps
        ramping = self._ramp_s < self._ramp_time_s
        if ramping:
            climb *= self._ramp_s / self._ramp_time_s
            tilt = min(tilt, self._tilt_on_ground_rad)
        elif land.ground_contact:
            self.position.reset()
            self._idle(self._thrust_min)
            self.descent_setpoint_mps = descent  # still wants to sink: the contact must not end by its own effect
            return
        self.position.limits[:] = speed, climb, descent, tilt
        self.position.step(state)
        self.q_setpoint_ned_frd[:] = self.position.q_setpoint_ned_frd
        self.thrust = float(self.position.thrust[0])
        self.descent_setpoint_mps = float(self.position.vel_setpoint_ned_mps[2])

    def _capture(self, setpoint: ControlSetpoint, state: F64) -> None:
        """Hold points and yaw, at the moment they become the ones to keep."""
        last = self._last
        entered = setpoint.kind is not last.kind
        if entered:
            if last is OFF:
                self.position.reset()
            if last.kind not in HOLDING_KINDS:
                self._start_reference(state, moving=not self._on_ground)
        if entered or (math.isnan(setpoint.yaw_rad) and not math.isnan(last.yaw_rad)):
            self._yaw_rad = float(euler_from_quat(state[6:10])[2])
        for axis in range(3):
            if entered or (math.isnan(setpoint.pos_ned_m[axis]) and not math.isnan(last.pos_ned_m[axis])):
                vel = 0.0 if self._on_ground else float(state[3 + axis])
                self._hold_ned_m[axis] = float(state[axis]) + vel * abs(vel) / (2.0 * self._brake_mps2[axis])

    def _fill(self, setpoint: ControlSetpoint, state: F64) -> None:
        """The position loop's setpoint (11,)."""
        target = [*setpoint.pos_ned_m, *setpoint.vel_ned_mps, *setpoint.acc_ned_mps2]
        if setpoint.kind in HOLDING_KINDS:
            unset = [math.isnan(value) for value in target]
            for axis in range(3):
                if unset[axis] and unset[3 + axis]:
                    target[axis] = self._hold_ned_m[axis]
            if unset[VEL_N] and unset[VEL_E] and not (math.isnan(target[0]) or math.isnan(target[1])):
                self._move_reference(target, state)
            else:  # a way of its own: what follows it begins where the vehicle is
                self._start_reference(state, moving=True)
        if setpoint.kind is ControlKind.LAND:
            target[2], target[VEL_D] = math.nan, self._landing_speed(-float(state[2]))
        if not math.isnan(setpoint.yaw_rad):
            self._yaw_rad = setpoint.yaw_rad
        elif not math.isnan(setpoint.yaw_rate_radps):
            self._yaw_rad += setpoint.yaw_rate_radps * self._dt_s
        self.position.setpoint[:SP_YAW], self.position.setpoint[SP_YAW] = target, self._yaw_rad

    def _start_reference(self, state: F64, *, moving: bool) -> None:
        north, east, _, v_north, v_east = state[:5].tolist()
        self._reference = (north, east, v_north, v_east) if moving else (north, east, 0.0, 0.0)

    def _move_reference(self, target: list[float], state: F64) -> None:
        """Replace the horizontal target by the next point of a way there with limited speed and acceleration."""
        north, east, v_north, v_east = self._reference
        to_n, to_e = target[0] - north, target[1] - east
        left_m = math.hypot(to_n, to_e)
        asked = self._last.speed_mps
        cruise = asked if asked > 0.0 else self._limits[ControlKind.GOTO][0]
        speed = min(cruise, math.sqrt(2.0 * self._brake_mps2[0] * left_m))
        speed = min(speed, left_m / self._dt_s)
        if math.hypot(north - float(state[0]), east - float(state[1])) > _LEASH_M:
            speed = 0.0
        scale = speed / left_m if left_m > 1e-9 else 0.0
        dv_n, dv_e = scale * to_n - v_north, scale * to_e - v_east
        change = math.hypot(dv_n, dv_e)
        most = self._acc_mps2 * self._dt_s
        share = 1.0 if change <= most else most / change
        v_north, v_east = v_north + share * dv_n, v_east + share * dv_e
        self._reference = (north + v_north * self._dt_s, east + v_east * self._dt_s, v_north, v_east)
        target[0], target[1], target[VEL_N], target[VEL_E] = self._reference
        target[ACC_N], target[ACC_E] = share * dv_n / self._dt_s, share * dv_e / self._dt_s

    def _landing_speed(self, height_m: float) -> float:
        fast = max(self._limits[ControlKind.LAND][2], self._land_speed)
        span_m = max(self._land_high_m - self._land_low_m, 1e-3)
        share = min(max((height_m - self._land_low_m) / span_m, 0.0), 1.0)
        return self._land_speed + share * (fast - self._land_speed)

    def _wants_up(self, setpoint: ControlSetpoint, state: F64) -> bool:
        """Asked to leave the ground by the setpoint itself, not by a hold point; False where the height is unset."""
        if setpoint.kind is ControlKind.LAND:
            return False
        climbing = setpoint.vel_ned_mps[2] < 0.0 or (
            math.isnan(setpoint.vel_ned_mps[2]) and setpoint.acc_ned_mps2[2] < 0.0
        )
        return setpoint.pos_ned_m[2] < float(state[2]) - _WANTS_UP_M or climbing

    def _idle(self, thrust: float) -> None:
        """Level, this much thrust, no position control."""
        self.q_setpoint_ned_frd[:] = quat_from_euler(0.0, 0.0, self._yaw_rad)
        self.thrust = thrust
        self.descent_setpoint_mps = math.nan
