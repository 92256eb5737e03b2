"""Position and velocity control with PX4's documented cascade: P position, PID velocity, acceleration to thrust vector.

    v_sp = P_pos (p_sp - p) + v_ff                    limited: horizontal speed, climb, descent
    a_sp = P (v_sp - v) + I - D v' + a_ff
    body z along (-a_x, -a_y, g), tilt limited        the vertical acceleration doesn't change the tilt
    collective = hover (1 - a_z / g) / cos(tilt)      hover = the hover thrust estimate, at first MPC_THR_HOVER

A component of a setpoint that is NaN is unset.  The integrator takes up what the hover thrust and the attitude get
wrong (payload, wind); it is held where thrust or tilt saturate, horizontally by back-calculation.  When the hover
thrust changes under way, the vertical integral moves so that the thrust doesn't, as in PX4.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.frames import quat_from_euler
from flightstack.jit import njit
from flightstack.rate_loop import first_order_alpha
from flightstack.rows import VEL_D
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack_sim.autopilot.params import Params

# places in the configuration
_P_POS, _P, _I, _D, _HOVER, _THR_MIN, _THR_MAX, _MARGIN, _ALPHA_D, _DT = 0, 3, 6, 9, 12, 13, 14, 15, 16, 17
_CONFIG_SIZE = 18
# places in the state
_INTEGRAL, _VEL_LAST, _VEL_DOT, _STARTED, _VEL_SP, _ACC_SP, _HOVER_LAST = 0, 3, 6, 9, 10, 13, 16
_STATE_SIZE = 17
_G = STANDARD_GRAVITY_MPS2


SP_YAW, _TILT_MAX = 9, 3
"""Of the setpoint, after position, velocity and acceleration; of the limits."""


class PositionControl:
    """Position loop of one vehicle.

    `setpoint` (11,): position, velocity, acceleration in NED, yaw, yaw rate; NaN is unset (yaw must be set).
    `limits` (4,): horizontal speed, climb, descent (m/s), tilt (rad).
    Results in place: `q_setpoint_ned_frd` (4,), `thrust` (1,) 0..1, `vel_setpoint_ned_mps` (3,).
    """

    __slots__ = (
        "_config",
        "_dt_s",
        "_state",
        "limits",
        "q_setpoint_ned_frd",
        "setpoint",
        "thrust",
        "vel_setpoint_ned_mps",
    )

    def __init__(self, params: Params, dt_s: float = 0.008) -> None:
        self._dt_s = dt_s
        self._config = np.zeros(_CONFIG_SIZE)
        self._state = np.zeros(_STATE_SIZE)
        self.setpoint = np.full(11, math.nan)
        self.limits = np.zeros(4)
        self.q_setpoint_ned_frd = np.array([1.0, 0.0, 0.0, 0.0])
        self.thrust = np.zeros(1)
        self.vel_setpoint_ned_mps = self._state[_VEL_SP : _VEL_SP + 3]
        self.configure(params)

    def configure(self, params: Params) -> None:
        """Take gains and limits from the parameters."""
        c = self._config
        for axis, name in enumerate(("XY", "XY", "Z")):
            c[_P_POS + axis] = params.get(f"MPC_{name}_P")
            c[_P + axis] = params.get(f"MPC_{name}_VEL_P_ACC")
            c[_I + axis] = params.get(f"MPC_{name}_VEL_I_ACC")
            c[_D + axis] = params.get(f"MPC_{name}_VEL_D_ACC")
        c[_HOVER] = params.get("MPC_THR_HOVER")
        c[_THR_MIN] = params.get("MPC_THR_MIN")
        c[_THR_MAX] = params.get("MPC_THR_MAX")
        c[_MARGIN] = params.get("MPC_THR_XY_MARG")
        c[_ALPHA_D] = first_order_alpha(params.get("MPC_VELD_LP"), self._dt_s)
        c[_DT] = self._dt_s

    def use_hover_thrust(self, thrust: float) -> None:
        """From the next step on: the collective thrust, 0..1, that carries the vehicle."""
        self._config[_HOVER] = thrust

    def reset(self) -> None:
        """Forget integrals and the velocity's derivative: on entry, on the ground."""
        self._state[:] = 0.0

    def step(self, state: F64) -> None:
        """One step from the estimate (13,): position, velocity, quaternion, ...."""
        position_step(
            state, self.setpoint, self.limits, self._config, self._state, self.q_setpoint_ned_frd, self.thrust
        )


@njit
def position_step(x: F64, sp: F64, limits: F64, c: F64, s: F64, q_out: F64, thrust_out: F64) -> None:
    """Cascade of one vehicle, in place."""
    dt = c[_DT]
    if s[_STARTED] != 0.0 and s[_HOVER_LAST] != c[_HOVER]:
        before = s[_ACC_SP + 2] - _G  # hover * (a - g) shall stay
        s[_INTEGRAL + 2] += before * s[_HOVER_LAST] / c[_HOVER] - before
    s[_HOVER_LAST] = c[_HOVER]
    for i in range(3):
        vel = x[3 + i]
        raw = (vel - s[_VEL_LAST + i]) / dt if s[_STARTED] != 0.0 else 0.0
        s[_VEL_DOT + i] += c[_ALPHA_D] * (raw - s[_VEL_DOT + i])
        s[_VEL_LAST + i] = vel
    s[_STARTED] = 1.0
    _velocity_setpoint(x, sp, limits, c, s)
    acc = s[_ACC_SP : _ACC_SP + 3]
    for i in range(3):
        acc[i] = 0.0 if math.isnan(sp[6 + i]) else sp[6 + i]
        if not math.isnan(s[_VEL_SP + i]):
            error = s[_VEL_SP + i] - x[3 + i]
            acc[i] += c[_P + i] * error + s[_INTEGRAL + i] - c[_D + i] * s[_VEL_DOT + i]
    _thrust_and_attitude(x, acc, sp[SP_YAW], limits[_TILT_MAX], c, s, q_out, thrust_out)


@njit
def _velocity_setpoint(x: F64, sp: F64, limits: F64, c: F64, s: F64) -> None:
    for i in range(3):
        pos_set, vel_set = not math.isnan(sp[i]), not math.isnan(sp[3 + i])
        vel = sp[3 + i] if vel_set else 0.0
        if pos_set:
            vel += c[_P_POS + i] * (sp[i] - x[i])
        s[_VEL_SP + i] = vel if pos_set or vel_set else math.nan
    north, east, down = s[_VEL_SP], s[_VEL_SP + 1], s[_VEL_SP + 2]
    speed = math.hypot(north, east)
    if speed > limits[0]:  # False where one of them is unset
        s[_VEL_SP] = north * limits[0] / speed
        s[_VEL_SP + 1] = east * limits[0] / speed
    if not math.isnan(down):
        s[_VEL_SP + 2] = min(max(down, -limits[1]), limits[2])


@njit
def _thrust_and_attitude(
    x: F64, acc: F64, yaw: float, tilt_max: float, c: F64, s: F64, q_out: F64, thrust_out: F64
) -> None:
    """Thrust vector within its limits, integrators, attitude; body z is minus the thrust's direction."""
    hover = c[_HOVER]
    lateral = math.hypot(acc[0], acc[1])
    tan_tilt = min(lateral / _G, math.tan(tilt_max))
    north, east = (acc[0] / lateral, acc[1] / lateral) if lateral > 1e-9 else (0.0, 0.0)
    up = hover * (1.0 - acc[2] / _G)  # vertical thrust
    low = c[_THR_MIN] / math.sqrt(1.0 + tan_tilt * tan_tilt)
    up_free = up
    up = max(up, low)
    across = up * tan_tilt
    kept = min(across, c[_MARGIN])
    up = min(up, math.sqrt(c[_THR_MAX] ** 2 - kept**2))
    across = min(across, math.sqrt(max(c[_THR_MAX] ** 2 - up * up, 0.0)), up * math.tan(tilt_max))
    if not math.isnan(s[_VEL_SP + 2]):
        error = s[_VEL_SP + 2] - x[VEL_D]
        saturated = (up < up_free and error < 0.0) or (up > up_free and error > 0.0)
        if not saturated:
            s[_INTEGRAL + 2] += c[_I + 2] * error * c[_DT]
        s[_INTEGRAL + 2] = min(max(s[_INTEGRAL + 2], -_G), _G)
    given = across / up * _G  # the lateral acceleration that this thrust vector stands for
    for i in range(2):
        if not math.isnan(s[_VEL_SP + i]):
            error = s[_VEL_SP + i] - x[3 + i]
            if lateral > given + 1e-9 and c[_P + i] > 0.0:
                direction = north if i == 0 else east
                error -= 2.0 / c[_P + i] * (lateral - given) * direction
            s[_INTEGRAL + i] += c[_I + i] * error * c[_DT]
    thrust = math.sqrt(up * up + across * across)
    thrust_out[0] = thrust
    _attitude_from_thrust(-across * north / thrust, -across * east / thrust, up / thrust, yaw, q_out)


@njit
def _attitude_from_thrust(zx: float, zy: float, zz: float, yaw: float, q_out: F64) -> None:
    """Attitude with body z = (zx, zy, zz) (unit, zz > 0) whose x axis points along `yaw` over ground.

    Seen from a frame turned by yaw, body z is (cos roll sin pitch, -sin roll, cos roll cos pitch).
    """
    ahead = zx * math.cos(yaw) + zy * math.sin(yaw)
    right = zy * math.cos(yaw) - zx * math.sin(yaw)
    q = quat_from_euler(math.asin(min(max(-right, -1.0), 1.0)), math.atan2(ahead, zz), yaw)
    for i in range(4):
        q_out[i] = q[i]
