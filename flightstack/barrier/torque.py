"""What torque may do to thrust while the governor has the last word: the ledger's line `torque`, and the limits to fly.

Symbols: r_max, y_max, D the governor's limits (`governor`); M (rotors x 3) the mixing matrix; d_i = u_i - u how far
rotor i's command is from the collective one; f the rotors' curve, T_full the thrust of all rotors at full command.

**Torque as it is, against torque as modelled.**  On the same commands the torque of the true loop is that of a model
through (1 + C Q_model) / (1 + C Q_true), C the rate controller with its filters, Q from torque to body rate: a pulse
and a kernel g(t).  The governor keeps five models within r_max.  For each true (alpha, tau) within the doubts the
nearest of the five counts, on either axis by itself, since the governor bounds any copy's roll with any copy's pitch:

    chi     = max over tau, alpha_roll, alpha_pitch, u, rotors of 1 + integral hypot(c g_roll, s g_pitch),
              (c, s) the direction of (M_ir, M_ip);  chi_yaw = max of 1 + integral |g_yaw|

with alpha(u) at commands u held from D to 1 - D.  `UNMODELLED` is for what such kernels leave out: thrust that steps
while the loop answers, products of torques on a bent curve, the fade of the integrator, steps of the prediction.

**Noise.**  Gyro noise (white, of density s) makes torque: s times the root of the integral of its answer's square;
NOISE_SIGMA times that, roll's and pitch's along each rotor's direction.

**Saturation.**  D is at least every |d_i|: max_i hypot(M_ir, M_ip) (chi r_max + noise) + |M_iy| (chi_yaw y_max +
noise_yaw) + trim.  Then u_i lies in [0, 1] for every u in [D, 1 - D], whatever the airmode, and no thrust is lost to
saturation.  Where THR_MDL_FAC = F is above 0, d and u are PX4's thrusts before the curve is undone.  `trim`: steady
torque that the model does not know (an offset centre of mass, wind on the frame).

**Curve.**  Rotors' lags act on each command alike, so the mean of the delayed commands is the delayed collective one,
and with T = T_full mean(f u_i^2 + (1 - f) u_i) what is left is f times the mean square of d:

    0 <= dT <= T_full f (sqrt(lambda (chi r_max + noise)^2 + mean M_iy^2 (chi_yaw y_max + noise_yaw)^2) + trim)^2

lambda the largest eigenvalue of the mean of (M_r, M_p)' (M_r, M_p); where yaw's column is not orthogonal to these,
lambda is that of all three.  Where F > 0 the undone curve g bends the other way: after it d is at most 1 / (1 - F) as
large again (gain), and the mean of g(s + d) is less than g(s) by F / (1 - F)^3 times the mean of d^2 at most (loss).

It acts along the thrust: the vertical line is dT / m times the greatest learned gain, a lateral one that times the
sine of the greatest lean.  Tested against the simulated autopilot in `tests/physics/test_torque_margin.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from flightstack.autopilot import autopilot_of, mixer, torque_per_slope
from flightstack.autopilot_params import AUTOPILOT_PARAMS, AXES
from flightstack.checked import number, only
from flightstack.governor import GovernorLimits
from flightstack.jit import njit
from flightstack.kept import kept
from flightstack.model import Limits, Model
from flightstack.rate_loop import SPREAD, butterworth2, first_order_alpha, steepness
from flightstack.types import F64, InputError, Tuple3, Tuple4
from flightstack.vehicle import Vehicle

UNMODELLED = 1.06
NOISE_SIGMA = 4.0
LINE_MOST_MPS2 = 0.12
"""Specific thrust that torque may add: 0.15 m/s^2 for a true mass of 0.8 times the believed one."""
LEAST_WEIGHTS = 0.25
"""Thrust of a powerful vehicle is let down to this: with 0.8 of the believed mass and a force of 0.15 g upwards a climb
is then still braked by half the weight."""
_STEP_S = 0.001
_STEPS = 1500
"""Of a kernel; beyond, roll's and pitch's have ended, and yaw's add 5 % of themselves at most, at little thrust."""
_NODES = 5
"""Values of alpha and of tau between the ends of their doubts, ends included."""
_COMMANDS = 3
_ROUNDS = 4
_MARGIN_MOST = 0.49
_SETTLED, _GROWN, _RINGING = 0.002, 1.002, 1.5
"""How exactly D is looked for where the rounds give none; they do where chi at it is greater than its own by a share,
or the worst copy's noise is so many times the believed loop's (quad-x: 1.11): it rings."""
_LATE, UNBOUNDED = 0.01, 1e3
"""Share of an answer's power that its last third may hold: it falls by more than 2 / s then; and the noise beyond."""
_YAW_SHARE = 0.18
"""Of D, what yaw may take."""
_LEAST, _MOST = 0.03, 0.12
"""r_max: below, a vehicle no longer leans in time; beyond, nothing is gained."""
VEHICLE_KEYS = (
    "position_m", "torque_ratio_m", "inertia_kgm2", "damping_nms", "max_thrust_n", "mass_kg", "thrust_model_factor",
    "rotor_lag_s", "gyro_noise_radps_rthz", "alpha_share", "lag_share",
)  # fmt: skip
_CORNERS = ((1.0, 1.0), (1.0 - SPREAD, 1.0 - SPREAD), (1.0 - SPREAD, 1.0 + SPREAD), (1.0 + SPREAD, 1.0 - SPREAD),
            (1.0 + SPREAD, 1.0 + SPREAD))  # fmt: skip


@dataclass(frozen=True, slots=True)
class GovernorTerms:
    """What a certificate says of the governor: its limits, and the figures that the ledger's line rests on."""

    roll_pitch_max: float
    yaw_max: float
    margin: float
    chi: float
    chi_yaw: float
    noise: float
    """Torque that gyro noise makes, roll and pitch."""
    noise_yaw: float
    trim: float
    """Steady difference of a rotor's command from the collective one."""
    lift_mps2: float
    """Most specific thrust (believed newton per kilogram) that torque adds."""
    loss_mps2: float
    """Most that it takes."""
    vehicle: Mapping[str, Any]
    """Numbers of the believed vehicle: see `_vehicle`."""
    autopilot: Mapping[str, float]
    """Every key of `[autopilot]`."""

    @property
    def limits(self) -> GovernorLimits:
        """What the governor is to keep."""
        return GovernorLimits(self.roll_pitch_max, self.yaw_max, self.margin)

    def differs_from(self, believed: Vehicle, model: Model) -> str:
        """Which number of the vehicle or its autopilot is another than the believed one's, in words; empty if none."""
        loop = _Loop(believed)
        vehicle = loop.as_json(tuple(self.vehicle["gyro_noise_radps_rthz"]), model)
        for mine, theirs in ((self.autopilot, loop.autopilot), (self.vehicle, vehicle)):
            for key, value in theirs.items():
                if not np.allclose(mine[key], value, rtol=1e-6, atol=1e-12):
                    return f"holds for {key} = {mine[key]}, this vehicle has {value}"
        return ""

    @property
    def worst_mps2(self) -> float:
        """Of gain and loss."""
        return max(self.lift_mps2, self.loss_mps2)


def governor_terms(
    vehicle: Vehicle, model: Model, limits: Limits, gyro_noise_radps_rthz: Tuple3, trim: float = 0.0
) -> GovernorTerms:
    """The greatest r_max whose D leaves the flight's greatest thrust and LEAST_WEIGHTS, and all that follows from it.

    Where even the least r_max needs more, D is what that needs, and thrust is bounded by D and 1 - D.
    """
    loop, scale = _Loop(vehicle), model.max_thrust_n / model.mass_kg
    greatest, least = model.thrust_range_n(limits)[1], LEAST_WEIGHTS * model.weight_n
    room = max(min(1.0 - loop.setpoint(model.norm_of(greatest)), loop.setpoint(model.norm_of(least))), 0.02)
    tilt, turn = np.hypot(loop.mix[:, 0], loop.mix[:, 1]), np.abs(loop.mix[:, 2])
    margin, r_max, y_max, figures = room, 0.0, 0.0, (1.0, 1.0, 0.0, 0.0)
    for _ in range(_ROUNDS):  # chi and noise grow a little where commands may come nearer to the ends
        chi, chi_yaw = (UNMODELLED * each for each in loop.doubt(margin))
        noise, noise_yaw = loop.noise(gyro_noise_radps_rthz, 1.0 - margin)
        y_max = _YAW_SHARE * room / float(turn.max())
        left = (room - trim - turn * (chi_yaw * y_max + noise_yaw)) / tilt - noise
        r_max = min(max(float(left.min()) / chi, _LEAST), _MOST)
        torque = chi * r_max + noise, chi_yaw * y_max + noise_yaw
        while r_max > _LEAST and scale * max(loop.thrust_error(torque, trim)) > LINE_MOST_MPS2:
            r_max, y_max = 0.98 * r_max, 0.98 * y_max
            torque = chi * r_max + noise, chi_yaw * y_max + noise_yaw
        margin = min(loop.spread(torque) + trim, _MARGIN_MOST)
        figures = chi, chi_yaw, noise, noise_yaw
    margin, figures = _settled(loop, gyro_noise_radps_rthz, (r_max, y_max, trim), margin, figures)
    chi, chi_yaw, noise, noise_yaw = figures
    lift, loss = loop.thrust_error((chi * r_max + noise, chi_yaw * y_max + noise_yaw), trim)
    return GovernorTerms(
        r_max, y_max, margin, *figures, trim, scale * lift, scale * loss,
        loop.as_json(gyro_noise_radps_rthz, model), dict(loop.autopilot),
    )  # fmt: skip


def _settled(
    loop: _Loop, density: Tuple3, asked: tuple[float, float, float], margin: float, figures: Tuple4
) -> tuple[float, Tuple4]:
    """D and the figures that hold at it.  `asked`: r_max, y_max and trim.

    A loop that is steady at hover may ring near full command, where rotors give twice as much for a command: chi and
    the noise of the worst copy at 1 - D are without bound then, and D must be so large that no such command is given.
    """
    r_max, y_max, trim = asked

    def needed(at: float) -> tuple[float, Tuple4]:
        chi, chi_yaw = (UNMODELLED * each for each in loop.doubt(at))
        noise, noise_yaw = loop.noise(density, 1.0 - at, _CORNERS)
        return loop.spread((chi * r_max + noise, chi_yaw * y_max + noise_yaw)) + trim, (chi, chi_yaw, noise, noise_yaw)

    chi, chi_yaw, noise, _ = needed(margin)[1]
    if chi <= _GROWN * figures[0] and chi_yaw <= _GROWN * figures[1] and noise <= _RINGING * figures[2]:
        return margin, figures
    low, high = margin, _MARGIN_MOST
    while high - low > _SETTLED:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if needed(middle)[0] > middle else (low, middle)
    return high, needed(high)[1]


def parse_governor(value: object, where: str) -> GovernorTerms:
    """The terms of a certificate file's table; InputError names the key."""
    names = [part.name for part in fields(GovernorTerms)]
    top = _table(value, names, where)
    numbers = {name: number(top[name], f"{where}.{name}", 0.0, 1e6) for name in names[:-2]}
    autopilot = _table(top["autopilot"], AUTOPILOT_PARAMS, f"{where}.autopilot")
    stated = {key: number(autopilot[key], f"{where}.autopilot.{key}", 0.0, 1e6) for key in AUTOPILOT_PARAMS}
    vehicle = _table(top["vehicle"], VEHICLE_KEYS, f"{where}.vehicle")
    return GovernorTerms(**numbers, vehicle=dict(vehicle), autopilot=stated)


def _table(value: object, names: Iterable[str], where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{where} must be a table")
    only(value, names, where)
    for name in names:
        if name not in value:
            raise InputError(f"{where}.{name} is missing")
    return value


def within(limits: Limits, model: Model, terms: GovernorTerms | None) -> Limits:
    """The limits of a flight whose governor keeps the collective command in [D, 1 - D]."""
    if terms is None:
        return limits
    low, high = terms.limits.command_range(terms.autopilot["thr_mdl_fac"])
    return replace(
        limits,
        thrust_min_weights=max(limits.thrust_min_weights, model.thrust_of(low) / model.weight_n),
        thrust_max_weights=min(limits.thrust_max_weights, model.thrust_of(high) / model.weight_n),
    )


_KP, _KI, _KD, _ALPHA, _LAG, _DAMPING, _SMOOTH_D, _SMOOTH_YAW, _B0, _B1, _B2, _A1, _A2 = range(13)
"""Of `_Loop._constants`."""


class _Loop:
    """The numbers of one believed vehicle's rate loop."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.autopilot = autopilot_of(vehicle)
        self.mix = mixer(vehicle.rotors)[:, :3]
        self.vehicle, effects = vehicle, vehicle.effects
        self.curve = effects.get("thrust_curve", {}).get("thrust_model_factor", vehicle.rotors.thrust_model_factor)
        self.undone = self.autopilot["thr_mdl_fac"]
        self.alpha = torque_per_slope(vehicle)
        self.lag_s = effects.get("motor_lag", {}).get("time_constant_s", vehicle.rotors.time_constant_s)
        scales = effects.get("inertia", {})
        self.inertia = [
            float(i) * scales.get(f"scale_{a}", 1.0) for i, a in zip(vehicle.inertia_kgm2, "xyz", strict=True)
        ]
        self.damping = [effects.get("angular_damping", {}).get(f"k_{a}_nms", 0.0) for a in "xyz"]

    def setpoint(self, norm: float) -> float:
        """PX4's collective thrust whose undone curve is this command."""
        return self.undone * norm * norm + (1.0 - self.undone) * norm

    def spread(self, torque: tuple[float, float]) -> float:
        """How far a rotor's command is from the collective one at most, at these torques (roll and pitch, yaw)."""
        tilt, turn = np.hypot(self.mix[:, 0], self.mix[:, 1]), np.abs(self.mix[:, 2])
        return float((tilt * torque[0] + turn * torque[1]).max())

    def kernels(self, axis: int, norm: float) -> F64:
        """(_STEPS, tau, alpha, copies) g of every true loop against each model, at a held command."""
        return _kernels(
            self._constants(axis, norm), np.array(_CORNERS), np.linspace(1.0 - SPREAD, 1.0 + SPREAD, _NODES)
        )

    def doubt(self, margin: float) -> tuple[float, float]:
        """chi and chi_yaw for commands from D to 1 - D."""
        question = self.curve, self.lag_s, list(self.alpha), self.inertia, self.damping, self.mix.tolist()
        chi, chi_yaw = kept(__name__, ("doubt", margin, self.autopilot, question), lambda: self._doubt(margin))
        return chi, chi_yaw

    def _doubt(self, margin: float) -> list[float]:
        chi = chi_yaw = 1.0
        directions = self.mix[:, :2] / np.hypot(self.mix[:, 0], self.mix[:, 1])[:, None]
        directions = np.unique(np.round(np.abs(directions), 12), axis=0)
        for norm in np.linspace(margin, 1.0 - margin, _COMMANDS):
            roll, pitch = (_nearest(self.kernels(axis, float(norm))) for axis in (0, 1))
            for c, s in directions:
                both = np.hypot(c * roll[:, :, :, None], s * pitch[:, :, None, :]).sum(axis=0)
                chi = max(chi, 1.0 + float(both.max()))
            chi_yaw = max(chi_yaw, 1.0 + float(np.abs(_nearest(self.kernels(2, float(norm)))).sum(axis=0).max()))
        return [chi, chi_yaw]

    def noise(
        self, density: Tuple3, norm: float, copies: tuple[tuple[float, float], ...] = _CORNERS[:1]
    ) -> tuple[float, float]:
        """NOISE_SIGMA deviations of the torque that gyro noise makes at a command; of several copies the worst's, and
        no bound where one's answer has not ended."""
        sigma = [0.0, 0.0, 0.0]
        for axis in range(3):
            for alpha, lag in copies:
                c = self._constants(axis, norm)
                c[_ALPHA], c[_LAG] = alpha * c[_ALPHA], lag * c[_LAG]
                answer = _noise_answer(c) ** 2
                power, late = 0.5 / _STEP_S * float(np.sum(answer)), float(np.sum(answer[2 * _STEPS // 3 :]))
                ended = len(copies) == 1 or late <= _LATE * float(np.sum(answer))
                sigma[axis] = max(sigma[axis], density[axis] * math.sqrt(power) if ended else UNBOUNDED)
        return NOISE_SIGMA * max(sigma[:2]), NOISE_SIGMA * sigma[2]

    def thrust_error(self, torque: tuple[float, float], trim: float) -> tuple[float, float]:
        """Most thrust gained and lost over T_full, at torques of so much (roll and pitch together, yaw)."""
        gram = self.mix.T @ self.mix / len(self.mix)
        if float(np.abs(gram[:2, 2]).max()) < 1e-9:
            square = float(np.linalg.eigvalsh(gram[:2, :2]).max()) * torque[0] ** 2 + gram[2, 2] * torque[1] ** 2
        else:
            square = float(np.linalg.eigvalsh(gram).max()) * (torque[0] ** 2 + torque[1] ** 2)
        square = (math.sqrt(square) + trim) ** 2
        if self.undone >= 0.95:
            return math.inf, math.inf
        left = 1.0 / (1.0 - self.undone)
        return self.curve * square * left * left, (1.0 + self.curve) * self.undone * left**3 * square

    def as_json(self, density: Tuple3, model: Model) -> dict[str, Any]:
        """The vehicle's numbers, for whoever works all this out anew."""
        rotors = self.vehicle.rotors
        return {
            "position_m": rotors.position_m.tolist(),
            "torque_ratio_m": rotors.torque_ratio_m.tolist(),
            "inertia_kgm2": self.inertia,
            "damping_nms": self.damping,
            "max_thrust_n": model.max_thrust_n,
            "mass_kg": model.mass_kg,
            "thrust_model_factor": self.curve,
            "rotor_lag_s": self.lag_s,
            "gyro_noise_radps_rthz": list(density),
            "alpha_share": SPREAD,
            "lag_share": SPREAD,
        }

    def _constants(self, axis: int, norm: float) -> F64:
        """(16,) of one axis' loop at a held command."""
        get, name = self.autopilot, AXES[axis]
        p, i, d = (get[f"mc_{name}rate_k"] * get[f"mc_{name}rate_{part}"] for part in "pid")
        alpha = self.alpha[axis] * steepness(norm, self.curve, self.undone)
        yaw_hz = get["mc_yaw_tq_cutoff"] if axis == 2 else 0.0
        return np.array([
            p, i, d, alpha, self.lag_s, self.damping[axis] / self.inertia[axis],
            first_order_alpha(get["imu_dgyro_cutoff"], _STEP_S), first_order_alpha(yaw_hz, _STEP_S),
            *butterworth2(get["imu_gyro_cutoff"], 1.0 / _STEP_S),
        ])  # fmt: skip


def _nearest(kernels: F64) -> F64:
    """(_STEPS, tau, alpha) of the copy whose kernel is smallest."""
    size = np.abs(kernels).sum(axis=0)
    best = np.argmin(size, axis=-1)
    found: F64 = np.take_along_axis(kernels, best[None, :, :, None], axis=-1)[..., 0]
    return found


@njit
def _left(lag_s: float) -> float:
    """What the rotors' lag leaves of an error in a step."""
    return math.exp(-_STEP_S / lag_s) if lag_s > 0.0 else 0.0


@njit
def _kernels(c: F64, copies: F64, shares: F64) -> F64:
    """g: what the true loop's torque adds to a unit pulse of a copy's, on the same commands; `_Loop._constants`."""
    count, many = len(shares), len(copies)
    out = np.zeros((_STEPS, count, count, many))
    for t in range(count):
        for a in range(count):
            for m in range(many):
                lag = c[_LAG] * shares[t], c[_LAG] * copies[m, 1]
                left = _left(lag[0]), _left(lag[1])
                gain = c[_ALPHA] * shares[a], c[_ALPHA] * copies[m, 0]
                z1 = z2 = rate = acc = integral = added = true = model = w_true = w_model = 0.0
                for k in range(_STEPS):
                    x = w_true - w_model
                    y = c[_B0] * x + z1
                    z1 = c[_B1] * x - c[_A1] * y + z2
                    z2 = c[_B2] * x - c[_A2] * y
                    acc += c[_SMOOTH_D] * ((y - rate) / _STEP_S - acc)
                    rate = y
                    added += c[_SMOOTH_YAW] * (-c[_KP] * y + integral - c[_KD] * acc - added)
                    integral -= c[_KI] * y * _STEP_S
                    out[k, t, a, m] = added
                    pulse = 1.0 if k == 0 else 0.0
                    true = pulse + added + left[0] * (true - pulse - added)
                    model = pulse + left[1] * (model - pulse)
                    w_true += _STEP_S * (gain[0] * true - c[_DAMPING] * w_true)
                    w_model += _STEP_S * (gain[1] * model - c[_DAMPING] * w_model)
    return out


@njit
def _noise_answer(c: F64) -> F64:
    """(_STEPS,) torque after one gyro sample of 1 rad/s at rest."""
    out = np.zeros(_STEPS)
    left = _left(c[_LAG])
    z1 = z2 = rate = acc = integral = torque = delivered = w = 0.0
    for k in range(_STEPS):
        x = w + (1.0 if k == 0 else 0.0)
        y = c[_B0] * x + z1
        z1 = c[_B1] * x - c[_A1] * y + z2
        z2 = c[_B2] * x - c[_A2] * y
        acc += c[_SMOOTH_D] * ((y - rate) / _STEP_S - acc)
        rate = y
        torque += c[_SMOOTH_YAW] * (-c[_KP] * y + integral - c[_KD] * acc - torque)
        integral -= c[_KI] * y * _STEP_S
        out[k] = torque
        delivered = torque + left * (delivered - torque)
        w += _STEP_S * (c[_ALPHA] * delivered - c[_DAMPING] * w)
    return out
