"""The controller's model: what the believed vehicle file says, as far as a point mass with a thrust axis can say it.

Mass, total thrust, the command-to-thrust curve, lags and drag; every other effect of the file is listed in
`left_to_learner`: the model does not know it, and nothing pretends that it does.

Thrust.  PX4 passes the collective thrust of a body-rate setpoint straight to the motors, so the normalised command u
and the total thrust T (newton) are tied by the rotors' own curve, T = T_max (f u^2 + (1 - f) u).

Rate lag.  PX4's rate loop (K = 1) commands torque = P e + I int(e) - D w', its allocation scales roll and pitch to
sqrt(1/2) per rotor.  With a the angular acceleration of a unit torque command at hover, the loop closes as
a P / (tau s^2 + (1 + a D) s + a P): seen from the slow side, a delay of (1 + a D) / (a P).
Source: PX4 v1.16 `rate_control.cpp`, `ControlAllocationPseudoInverse.cpp` and the defaults of MC_ROLLRATE_*.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flightstack.jit import Entry, njit
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Command, InputError, Tuple3, made
from flightstack.vehicle import Vehicle

MC_RATE_P = 0.15
"""PX4's default MC_ROLLRATE_P and MC_PITCHRATE_P."""
MC_RATE_D = 0.003
"""PX4's default MC_ROLLRATE_D and MC_PITCHRATE_D."""
_LEAST_THRUST_TO_WEIGHT = 1.1
_RATE_LAG_RANGE_S = (0.01, 0.15)
PARASITIC_AT_MPS = 2.0
"""Airspeed at which the model's linear drag is what a parasitic drag makes there: more below it, less above."""
_EXPRESSED = frozenset(
    {
        "payload",
        "thrust_scale",
        "thrust_curve",
        "motor_lag",
        "transport_delay",
        "linear_drag",
        "rotor_drag",
        "induced_inflow",
        "parasitic_drag",
        "inertia",
    }
)


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a flight; forces in believed weights, lengths from the position at arming."""

    thrust_max_weights: float = 1.8
    """The most the controller may ask for (the paper's 1.8 m g), if the rotors give it."""
    thrust_min_weights: float = 0.12
    """The least in flight: with idle rotors PX4 has no torque left to steer with."""
    rate_max_radps: Tuple3 = (6.0, 6.0, 2.0)
    """Body rates asked for; PX4's own limit (MC_ROLLRATE_MAX 220 deg/s = 3.8 rad/s) lies below for roll and pitch."""
    tilt_max_rad: float = math.radians(55.0)
    """Tilt that the controller may plan."""
    tilt_abort_rad: float = math.radians(80.0)
    """Measured tilt at which the guard levels the vehicle."""
    radius_m: float = 50.0
    """Horizontal distance from the start at which the guard takes over."""
    height_m: float = 50.0
    """Height above the start at which the guard takes over."""
    position_age_max_us: int = 24_000
    """Three periods of LOCAL_POSITION_NED at 125 Hz: an older sample counts as missing."""
    attitude_age_max_us: int = 15_000
    """Three periods of ATTITUDE_QUATERNION at 200 Hz."""
    imu_age_max_us: int = 12_000
    """Three periods of HIGHRES_IMU at 250 Hz."""
    latency_max_us: int = 10_000
    """What the link itself may add to every age."""


@dataclass(frozen=True, slots=True)
class Model:
    """A point mass pushed along body -z, with the believed vehicle's numbers."""

    mass_kg: float
    """With the payload effect."""
    max_thrust_n: float
    """All four rotors at full command, with the thrust_scale effect."""
    thrust_model_factor: float
    """f of T = max_thrust_n (f u^2 + (1 - f) u)."""
    motor_lag_s: float
    """Time constant of the rotors: how late thrust follows."""
    rate_lag_s: float
    """How late roll and pitch rates follow the commanded ones (PX4's rate loop round this vehicle)."""
    transport_delay_s: float
    """How late a command begins to act."""
    drag_kgps: Tuple3
    """Drag along the body axes, force = -D v_body: the frame's (its parasitic one as at 2 m/s), and the rotors' at the
    speed at which they hover."""
    rotor_radius_m: float
    """Scale of height for what a rotor does near the ground."""
    left_to_learner: tuple[str, ...]
    """Effects of the vehicle file that this model cannot express, in file order."""

    @classmethod
    def from_vehicle(cls, vehicle: Vehicle) -> Model:
        """The model of a believed vehicle; InputError if it could not even hover."""
        effects = vehicle.effects
        scale = effects.get("thrust_scale", {}).get("scale", 1.0)
        factor = effects.get("thrust_curve", {}).get("thrust_model_factor", vehicle.rotors.thrust_model_factor)
        max_thrust = vehicle.max_total_thrust_n * scale
        if max_thrust < _LEAST_THRUST_TO_WEIGHT * vehicle.weight_n:
            raise InputError(
                f"vehicle {vehicle.name}: {max_thrust:.4g} N of thrust cannot fly {vehicle.weight_n:.4g} N of weight; "
                f"rotors.max_thrust_n must give at least {_LEAST_THRUST_TO_WEIGHT:g} times the weight in all"
            )
        hover_norm = thrust_to_norm(vehicle.weight_n, max_thrust, factor)
        return cls(
            mass_kg=vehicle.total_mass_kg,
            max_thrust_n=max_thrust,
            thrust_model_factor=factor,
            motor_lag_s=effects.get("motor_lag", {}).get("time_constant_s", vehicle.rotors.time_constant_s),
            rate_lag_s=_rate_lag_s(vehicle, 0.25 * max_thrust * (2.0 * factor * hover_norm + 1.0 - factor)),
            transport_delay_s=effects.get("transport_delay", {}).get("delay_s", 0.0),
            drag_kgps=_drag_kgps(vehicle, max_thrust),
            rotor_radius_m=vehicle.rotors.radius_m,
            left_to_learner=tuple(name for name in effects if name not in _EXPRESSED),
        )

    @property
    def weight_n(self) -> float:
        """Believed weight in standard gravity."""
        return self.mass_kg * STANDARD_GRAVITY_MPS2

    @property
    def hover_norm(self) -> float:
        """Normalised collective thrust that carries the believed weight (1 where the rotors can't)."""
        return self.norm_of(self.weight_n)

    def norm_of(self, thrust_n: float) -> float:
        """Normalised collective thrust (0..1) for a total thrust in newton; clipped at both ends."""
        return thrust_to_norm(thrust_n, self.max_thrust_n, self.thrust_model_factor)

    def thrust_of(self, thrust_norm: float) -> float:
        """Total thrust in newton of a normalised collective thrust."""
        f = self.thrust_model_factor
        return self.max_thrust_n * (f * thrust_norm * thrust_norm + (1.0 - f) * thrust_norm)

    def thrust_range_n(self, limits: Limits) -> tuple[float, float]:
        """Least and greatest total thrust of a flight: the limits in weights, and what the rotors give."""
        upper = min(limits.thrust_max_weights * self.weight_n, self.max_thrust_n)
        return min(limits.thrust_min_weights * self.weight_n, upper), upper


class Limiter:
    """Cuts what a controller wants to the limits of the flight and of the rotors; final, holds only constants."""

    __slots__ = ("_constants",)

    def __init__(self, model: Model, limits: Limits) -> None:
        self._constants = limiter_row(model, limits)

    def limit(self, thrust_n: float, rate_frd_radps: F64, now_us: int) -> tuple[Command, bool]:
        """The command within the limits, and whether thrust was cut; what is not a number stays so, for the guard."""
        rate = np.empty(3)
        thrust, norm = _LIMIT.call(thrust_n, rate_frd_radps, self._constants, rate)
        return made(Command, (now_us, thrust, norm, rate)), thrust != thrust_n


@njit
def _clip(value: float, low: float, high: float) -> float:
    """Within the range; NaN stays NaN."""
    if value > high:
        return high
    return low if value < low else value


_MAX_THRUST, _CURVE = 5, 6


def limiter_row(model: Model, limits: Limits) -> F64:
    """(7,) what `limit_command` needs: thrust range, rates (3), greatest thrust, curve factor."""
    curve = (model.max_thrust_n, model.thrust_model_factor)
    return np.array([*model.thrust_range_n(limits), *limits.rate_max_radps, *curve])


@njit
def limit_command(thrust: float, rate: F64, constants: F64, out: F64) -> tuple[float, float]:
    """Limited thrust and its norm, rates into `out`; `constants` (7,): thrust range, rates (3), T_max, curve factor."""
    for i in range(3):
        out[i] = _clip(rate[i], -constants[2 + i], constants[2 + i])
    limited = _clip(thrust, constants[0], constants[1])
    return limited, thrust_to_norm(limited, constants[_MAX_THRUST], constants[_CURVE])


@njit
def thrust_to_norm(thrust_n: float, max_thrust_n: float, thrust_model_factor: float) -> float:
    """Invert T = T_max (f u^2 + (1 - f) u) for u in 0..1; the root is written so that f = 0 is no special case."""
    share = min(1.0, max(0.0, thrust_n / max_thrust_n))
    linear = 1.0 - thrust_model_factor
    denominator = linear + math.sqrt(linear * linear + 4.0 * thrust_model_factor * share)
    return 2.0 * share / denominator if denominator > 0.0 else 0.0


_LIMIT = Entry(limit_command, "f8, f8[::1], f8[::1], f8[::1]")


def _drag_kgps(vehicle: Vehicle, max_thrust_n: float) -> Tuple3:
    """Linear drag; rotor drag and induced inflow, which go with the rotors' speed, here that of hover; and parasitic
    drag, which goes with the airspeed, here `PARASITIC_AT_MPS`."""
    effects = vehicle.effects
    hover_radps = vehicle.rotors.max_speed_radps * math.sqrt(vehicle.weight_n / max_thrust_n)
    across = 4.0 * hover_radps * effects.get("rotor_drag", {}).get("k_d_kg_per_rad", 0.0)
    along = 4.0 * hover_radps * effects.get("induced_inflow", {}).get("k_z_kg_per_rad", 0.0)
    x, y, z = (effects.get("linear_drag", {}).get(f"d_{axis}_kgps", 0.0) for axis in "xyz")
    c_x, c_y, c_z = (effects.get("parasitic_drag", {}).get(f"c_{axis}_kg_per_m", 0.0) for axis in "xyz")
    fast = PARASITIC_AT_MPS
    return x + across + fast * c_x, y + across + fast * c_y, z + along + fast * c_z


def _rate_lag_s(vehicle: Vehicle, thrust_per_command_n: float) -> float:
    """Delay of PX4's roll and pitch rate loop at its default gains; the slope is one rotor's, N per unit command."""
    x, y = vehicle.rotors.position_m[:, 0], vehicle.rotors.position_m[:, 1]
    lever = np.array([-y, x, vehicle.rotors.torque_ratio_m, np.ones(4)])
    mix = np.linalg.pinv(lever)[:, :2]
    used = np.maximum(np.sum(np.abs(mix) > 1e-6, axis=0), 1)
    scale = float(np.max(np.sqrt(np.sum(mix * mix, axis=0) / (0.5 * used))))
    if not scale > 0.0:
        return _RATE_LAG_RANGE_S[1]
    torque_nm = np.diagonal(lever[:2] @ (mix / scale)) * thrust_per_command_n
    scales = vehicle.effects.get("inertia", {})
    inertia = vehicle.inertia_kgm2[:2] * np.array([scales.get("scale_x", 1.0), scales.get("scale_y", 1.0)])
    per_unit = torque_nm / inertia
    lag = float(np.mean((1.0 + per_unit * MC_RATE_D) / np.maximum(per_unit * MC_RATE_P, 1e-6)))
    return min(max(lag, _RATE_LAG_RANGE_S[0]), _RATE_LAG_RANGE_S[1])
