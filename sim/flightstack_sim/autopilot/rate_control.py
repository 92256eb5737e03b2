"""Body-rate control with PX4's structure, at 1 kHz, one compiled call a sample down to the motor commands.

    torque = P e + I - D w' + FF w_sp        P, I, D each times K; e = w_sp - w

Gyro: second-order Butterworth low-pass (IMU_GYRO_CUTOFF).  w': its derivative through a first-order low-pass
(IMU_DGYRO_CUTOFF).  The integrator's step shrinks with the error, i' = I e (1 - (e / 400 deg/s)^2) and nothing beyond;
it is held while landed, is limited, doesn't grow further into an axis that the allocation couldn't serve, and starts
at 0 on arming.  Yaw torque passes a first-order low-pass (MC_YAW_TQ_CUTOFF).  Motor commands are thrusts where
THR_MDL_FAC is 0; above, they are the commands whose curve gives those thrusts.

K is the airframe's where nothing else is set: `flightstack.autopilot`.
"""

from __future__ import annotations

import math
from struct import Struct

import numpy as np

from flightstack.autopilot import mixer
from flightstack.jit import njit
from flightstack.rate_loop import butterworth2, first_order_alpha
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_sim.autopilot.allocation import allocate
from flightstack_sim.autopilot.params import Params

AXES = ("ROLLRATE", "PITCHRATE", "YAWRATE")
INTEGRATOR_LIMITS = ("MC_RR_INT_LIM", "MC_PR_INT_LIM", "MC_YR_INT_LIM")
_INTEGRATOR_FADE_RADPS = math.radians(400.0)

# places in the loop's state
_RATE_SP, _THRUST_SP, _ARMED, _HOLD_I = 0, 3, 4, 5
_TARGET = Struct("6d")  # these six in one go, which is several times as fast as one by one
_FILTER, _RATE, _ACC, _INTEGRAL, _TORQUE, _LOST, _STARTED = 6, 12, 15, 18, 21, 24, 27
STATE_SIZE = 28
"""What a sample changes, but for the motor commands."""
# places in its configuration
_P, _I, _D, _FF, _LIMIT, _B, _A1, _A2, _ALPHA_D, _ALPHA_YAW, _DT, _CURVE, _STOPPED = (
    0,
    3,
    6,
    9,
    12,
    15,
    18,
    19,
    20,
    21,
    22,
    23,
    24,
)
_CONFIG_SIZE = 28
# and of all in the loop's one row: state, configuration, motor commands, then the mixer's rows
_CONFIG = STATE_SIZE
_MOTORS = _CONFIG + _CONFIG_SIZE
_ROTORS = 4
_MIX = _MOTORS + _ROTORS
ROW = _MIX + 4 * _ROTORS
"""Numbers of a loop's row."""


class RateControl:
    """Rate loop and allocation of one vehicle.

    All arrays are parts of one `row`, which compiled code takes, and are updated in place: `rate_frd_radps` (3,) the
    filtered gyro, `angular_acceleration_frd_radps2` (3,) its filtered derivative, `rate_setpoint_frd_radps` (3,),
    `torque` (3,) normalised, `integral` (3,), `motor_command` (4,) 0..1.  `thrust_setpoint` is the collective thrust
    asked for, 0..1.
    """

    __slots__ = (
        "_config",
        "_dt_s",
        "_target",
        "angular_acceleration_frd_radps2",
        "integral",
        "motor_command",
        "rate_frd_radps",
        "rate_setpoint_frd_radps",
        "row",
        "thrust_setpoint",
        "torque",
    )

    def __init__(self, vehicle: Vehicle, params: Params, dt_s: float = 0.001) -> None:
        self._dt_s = dt_s
        mix = mixer(vehicle.rotors)
        row = self.row = np.zeros(ROW)
        row[_MIX:] = mix.ravel()
        self._target = memoryview(row)  # type: ignore[arg-type]
        self._config = row[_CONFIG:_MOTORS]
        self.motor_command = row[_MOTORS:_MIX]
        self.rate_setpoint_frd_radps = row[_RATE_SP : _RATE_SP + 3]
        self.rate_frd_radps = row[_RATE : _RATE + 3]
        self.angular_acceleration_frd_radps2 = row[_ACC : _ACC + 3]
        self.integral = row[_INTEGRAL : _INTEGRAL + 3]
        self.thrust_setpoint = 0.0
        self.torque = row[_TORQUE : _TORQUE + 3]
        self.configure(params)

    def configure(self, params: Params) -> None:
        """Take gains and cut-offs from the parameters; acts from the next sample."""
        c = self._config
        for axis, name in enumerate(AXES):
            k = params.get(f"MC_{name}_K")
            c[_P + axis] = k * params.get(f"MC_{name}_P")
            c[_I + axis] = k * params.get(f"MC_{name}_I")
            c[_D + axis] = k * params.get(f"MC_{name}_D")
            c[_FF + axis] = params.get(f"MC_{name}_FF")
            c[_LIMIT + axis] = params.get(INTEGRATOR_LIMITS[axis])
        b0, b1, b2, a1, a2 = butterworth2(params.get("IMU_GYRO_CUTOFF"), 1.0 / self._dt_s)
        c[_B], c[_B + 1], c[_B + 2], c[_A1], c[_A2] = b0, b1, b2, a1, a2
        c[_ALPHA_D] = first_order_alpha(params.get("IMU_DGYRO_CUTOFF"), self._dt_s)
        c[_ALPHA_YAW] = first_order_alpha(params.get("MC_YAW_TQ_CUTOFF"), self._dt_s)
        c[_DT] = self._dt_s
        c[_CURVE] = params.get("THR_MDL_FAC")

    def stop_motor(self, number: int, *, stopped: bool) -> None:
        """Motor 1 to 4, 0: all, gets no command from now on whatever the loop wants, or its own again."""
        for index in range(_ROTORS) if number == 0 else (number - 1,):
            self._config[_STOPPED + index] = stopped

    def set_target(self, rate: tuple[float, float, float], thrust: float, *, armed: bool, hold_integral: bool) -> None:
        """Rates (rad/s, NaN: the measured rate, so no action of P and I) and collective thrust from now on."""
        self.thrust_setpoint = thrust
        p, q, r = rate
        _TARGET.pack_into(self._target, 0, p, q, r, thrust, armed, hold_integral)

    def step(self, gyro_frd_radps: F64) -> None:
        """One gyro sample (3,) rad/s -> `motor_command`."""
        rate_step(gyro_frd_radps, self.row)


@njit
def aim(row: F64, rate: F64, thrust: float) -> None:
    """Armed, with these rates (3,) rad/s and this collective thrust from now on; the integrator runs."""
    for axis in range(3):
        row[_RATE_SP + axis] = rate[axis]
    row[_THRUST_SP], row[_ARMED], row[_HOLD_I] = thrust, 1.0, 0.0


@njit
def motors_of(row: F64) -> F64:
    """The motor commands in a loop's row."""
    return row[_MOTORS:_MIX]


@njit
def has_lost(row: F64) -> bool:
    """Whether torque about the body's x axis was asked for that could not be given."""
    return bool(row[_LOST] != 0.0)


@njit
def kind_of(row: F64) -> tuple[bool, bool, bool]:
    """Whether a loop has its first sample, is armed, and undoes a thrust curve."""
    return row[_STARTED] == 0.0, row[_ARMED] != 0.0, row[_CONFIG + _CURVE] > 1e-6


@njit
def rate_step(gyro: F64, row: F64) -> None:
    """Filter, PID and allocation of one sample (3,), in place in a loop's row."""
    s, c, motors, mix = row[:STATE_SIZE], row[_CONFIG:_MOTORS], motors_of(row), row[_MIX:]
    first, armed, curved = kind_of(row)
    s[_STARTED] = 1.0
    for axis in range(3):
        z1, z2 = _FILTER + axis, _FILTER + 3 + axis
        x = gyro[axis]
        if first:  # as if the first sample had lasted for ever
            y = x
            s[z1] = x * (1.0 - c[_B])
            s[z2] = x * (c[_B + 2] - c[_A2])
            s[_RATE + axis] = x
        else:
            y = c[_B] * x + s[z1]
            s[z1] = c[_B + 1] * x - c[_A1] * y + s[z2]
            s[z2] = c[_B + 2] * x - c[_A2] * y
        raw_acc = (y - s[_RATE + axis]) / c[_DT]
        s[_ACC + axis] += c[_ALPHA_D] * (raw_acc - s[_ACC + axis])
        s[_RATE + axis] = y
    if not armed:
        for k in range(3):
            s[_INTEGRAL + k] = 0.0
            s[_TORQUE + k] = 0.0
            s[_LOST + k] = 0.0
        motors[:] = 0.0
        return
    for axis in range(3):
        target = s[_RATE_SP + axis]
        if math.isnan(target):
            target = s[_RATE + axis]
        error = target - s[_RATE + axis]
        integral = s[_INTEGRAL + axis]
        torque = c[_P + axis] * error + integral - c[_D + axis] * s[_ACC + axis] + c[_FF + axis] * target
        if axis == 2:
            torque = s[_TORQUE + 2] + c[_ALPHA_YAW] * (torque - s[_TORQUE + 2])
        s[_TORQUE + axis] = torque
        lost = s[_LOST + axis]
        runs = s[_HOLD_I] == 0.0 and not (lost > 1e-9 and error > 0.0) and not (lost < -1e-9 and error < 0.0)
        fade = error / _INTEGRATOR_FADE_RADPS
        grown = integral + c[_I + axis] * error * max(0.0, 1.0 - fade * fade) * c[_DT]
        s[_INTEGRAL + axis] = min(max(grown, -c[_LIMIT + axis]), c[_LIMIT + axis]) if runs else integral
    allocate(mix, s[_TORQUE], s[_TORQUE + 1], s[_TORQUE + 2], s[_THRUST_SP], motors, s[_LOST : _LOST + 3])
    curve = c[_CURVE]
    if curved:  # the command u whose curve f u^2 + (1 - f) u is the thrust wanted
        for i in range(motors.shape[0]):
            linear = 1.0 - curve
            motors[i] = (math.sqrt(linear * linear + 4.0 * curve * motors[i]) - linear) / (2.0 * curve)
    for i in range(_ROTORS):  # the loop does not know, as PX4's doesn't (CA_FAILURE_MODE 0)
        motors[i] = 0.0 if c[_STOPPED + i] != 0.0 else motors[i]
