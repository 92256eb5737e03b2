"""What torque may do to thrust, worked out anew from rotors, inertia, rate gains and the governor's limits.

Commands u_i = u + M_i . (roll, pitch, yaw), M the normalised pseudo-inverse of the rotors' effectiveness.  The governor
keeps the hypotenuse of roll and pitch torque of five models within r, yaw's within y; their alpha and lag are the
believed ones and the four corners of the doubts.  On the same commands a true loop's torque is a model's plus g * it:

    chi      1.06 max over u in {D, 1/2, 1 - D}, lag, alpha_roll, alpha_pitch and rotors of 1 + sum hypot(c g_r, s g_p)
    chi_yaw  1.06 max of 1 + sum |g_y|,  each true loop against the model whose sum |g| is least
    noise    4 sigma of the torque that white gyro noise makes at u = 1 - D
    D        max_i hypot(M_ir, M_ip) (chi r + noise) + |M_iy| (chi_yaw y + noise_yaw) + trim
    lift     T_full / m f (sqrt(lambda (chi r + noise)^2 + mean M_y^2 (chi_yaw y + noise_yaw)^2) + trim)^2

Stated figures may be less than these by 1 %.  With THR_MDL_FAC = F: d up to 1 / (1 - F) as large, loss F / (1 - F)^3.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .intervals import F64
from .knowledge import StatedKnowledge
from .reading import Refused, number, numbers, rows, table_of

_TERMS = (
    "roll_pitch_max", "yaw_max", "margin", "chi", "chi_yaw", "noise", "noise_yaw", "trim", "lift_mps2", "loss_mps2",
)  # fmt: skip
_VEHICLE = (
    "position_m", "torque_ratio_m", "inertia_kgm2", "damping_nms", "max_thrust_n", "mass_kg", "thrust_model_factor",
    "rotor_lag_s", "gyro_noise_radps_rthz", "alpha_share", "lag_share",
)  # fmt: skip
_NAMES = ("roll", "pitch", "yaw")
_AUTOPILOT = (
    *(f"mc_{axis}rate_{part}" for axis in _NAMES for part in ("p", "i", "d", "ff", "k", "max")),
    "mc_rr_int_lim", "mc_pr_int_lim", "mc_yr_int_lim", "imu_gyro_cutoff", "imu_dgyro_cutoff", "mc_yaw_tq_cutoff",
    "thr_mdl_fac", "airmode",
)  # fmt: skip
_UNMODELLED, _SIGMA = 1.06, 4.0
_DT, _STEPS, _SHARES = 0.001, 1500, 5
_LEAST_SHARE = 0.2
_CLOSE, _NEAR = 0.01, 1e-9

_DONE: dict[str, tuple[float, float, float, float]] = {}


_FOUND = ("chi", "chi_yaw", "noise", "noise_yaw")


def check_governor(value: Any, budget: Any, known: StatedKnowledge) -> str:
    """Verify the governor's terms against the budget and the knowledge; what was verified, in words."""
    if value is None:
        raise Refused("governor is missing: nothing bounds the torque that takes thrust")
    table = table_of(value, (*_TERMS, "vehicle", "autopilot"), "governor")
    r, y, margin, chi, chi_yaw, noise, noise_yaw, trim, lift, loss = (
        number(table[key], f"governor.{key}") for key in _TERMS
    )
    loop = _Loop(table["vehicle"], table["autopilot"])
    if min(r, y, trim, lift, loss) < 0.0 or not 0.0 < margin < 0.5:
        raise Refused("governor: limits must be at least 0, margin in 0 to 0.5")
    tilt, turn = chi * r + noise, chi_yaw * y + noise_yaw
    _at_least("margin", margin, loop.spread(tilt, turn) + trim)
    gained, lost = loop.thrust_error(tilt, turn, trim)
    _at_least("lift_mps2", lift, gained)
    _at_least("loss_mps2", loss, lost)
    charged = number(known.data["torque_mps2"], "knowledge.torque_mps2")
    if not charged >= max(lift, loss) * (1.0 - _NEAR):
        raise Refused(f"knowledge.torque_mps2 = {charged:.6g} is less than the governor's {max(lift, loss):.6g} m/s^2")
    low, high = (loop.thrust(u) for u in (margin, 1.0 - margin))
    stated_low, most = (number(budget[key], f"budget.{key}") for key in ("low_mps2", "thrust_max_mps2"))
    if not (low * (1.0 - 1e-6) <= stated_low and most <= high * (1.0 + 1e-6)):
        raise Refused(
            f"budget: {stated_low:.6g} to {most:.6g} m/s^2 is not within what the governor leaves of thrust, "
            f"{low:.6g} to {high:.6g}"
        )
    found = loop.doubt(margin)
    for name, stated, least in zip(_FOUND, (chi, chi_yaw, noise, noise_yaw), found, strict=True):
        _at_least(name, stated, least)
    return (
        f"governor: torque up to {r:.3g} (yaw {y:.3g}), true within {chi:.3g} times; no rotor saturates at commands of "
        f"{margin:.3g} to {1.0 - margin:.3g}; thrust off by {max(lift, loss):.3g} m/s^2 at most"
    )


def _at_least(name: str, stated: float, least: float) -> None:
    if not stated >= least * (1.0 - _CLOSE):
        raise Refused(f"governor.{name} = {stated:.6g} is less than its sources give, {least:.6g}")


class _Loop:
    """Rate loops of the three axes, from the file's numbers."""

    def __init__(self, vehicle: Any, autopilot: Any) -> None:
        table_of(vehicle, _VEHICLE, "governor.vehicle")
        gains = dict(zip(_AUTOPILOT, numbers(autopilot, _AUTOPILOT, "governor.autopilot"), strict=True))
        place = rows(vehicle["position_m"], 3, "governor.vehicle.position_m")
        if place.shape != (4, 3):
            raise Refused("governor.vehicle.position_m must be four places")
        ratio, inertia, damping, density = (
            rows([vehicle[key]], size, f"governor.vehicle.{key}")[0]
            for key, size in (
                ("torque_ratio_m", 4), ("inertia_kgm2", 3), ("damping_nms", 3), ("gyro_noise_radps_rthz", 3),
            )
        )  # fmt: skip
        full, mass, curve, lag, alpha_share, lag_share = (
            number(vehicle[key], f"governor.vehicle.{key}")
            for key in ("max_thrust_n", "mass_kg", "thrust_model_factor", "rotor_lag_s", "alpha_share", "lag_share")
        )
        undone = gains["thr_mdl_fac"]
        if not (
            min(*inertia, full, mass, lag) > 0.0
            and min(*damping, *density, *gains.values()) >= 0.0
            and 0.0 <= curve <= 1.0
            and 0.0 <= undone < 1.0
            and _LEAST_SHARE <= min(alpha_share, lag_share) <= max(alpha_share, lag_share) < 1.0
        ):
            raise Refused("governor: vehicle and autopilot out of range; doubts of alpha and lag at least 20 %")
        self.full_mps2, self.curve, self.undone = full / mass, curve, undone
        self.gains, self.lag, self.density = gains, lag, density
        self.alpha_share, self.lag_share = alpha_share, lag_share
        levers = np.stack([-place[:, 1], place[:, 0], ratio])
        mix = np.linalg.pinv(np.vstack([levers, np.ones(4)]))[:, :3]
        mix[np.abs(mix) < 1e-9 * np.abs(mix).max()] = 0.0
        used = np.count_nonzero(mix, axis=0)
        if used.min() == 0:
            raise Refused("governor.vehicle: the rotors give no torque about some axis")
        mix[:, :2] /= math.sqrt(max(float((mix[:, k] ** 2).sum()) * 2.0 / used[k] for k in (0, 1)))
        mix[:, 2] /= np.abs(mix[:, 2]).max()
        self.mix: F64 = mix
        self.alpha = np.einsum("ki,ik->k", levers, mix) * 0.25 * full / inertia
        self.damping = damping / inertia

    def thrust(self, mixed: float) -> float:
        """Specific thrust at a collective thrust as PX4 mixes it."""
        f, root = self.undone, 1.0 - self.undone
        u = mixed if f < 1e-12 else (math.sqrt(root * root + 4.0 * f * mixed) - root) / (2.0 * f)
        return self.full_mps2 * (self.curve * u + 1.0 - self.curve) * u

    def spread(self, tilt: float, turn: float) -> float:
        """The furthest that a rotor's command is from the collective one."""
        return float((np.hypot(self.mix[:, 0], self.mix[:, 1]) * tilt + np.abs(self.mix[:, 2]) * turn).max())

    def thrust_error(self, tilt: float, turn: float, trim: float) -> tuple[float, float]:
        """Most specific thrust gained and lost."""
        gram = self.mix.T @ self.mix / 4.0
        if np.abs(gram[:2, 2]).max() < 1e-9:
            square = float(np.linalg.eigvalsh(gram[:2, :2])[-1]) * tilt * tilt + float(gram[2, 2]) * turn * turn
        else:
            square = float(np.linalg.eigvalsh(gram)[-1]) * (tilt * tilt + turn * turn)
        square = (math.sqrt(square) + trim) ** 2 * self.full_mps2
        left = 1.0 / (1.0 - self.undone)
        return self.curve * square * left**2, (1.0 + self.curve) * self.undone * left**3 * square

    def doubt(self, margin: float) -> tuple[float, float, float, float]:
        """chi, chi_yaw, noise, noise_yaw."""
        key = repr((margin, self.__dict__))
        if key not in _DONE:  # files are checked again and again with the same loop
            _DONE.clear()
            _DONE[key] = self._doubt(margin)
        return _DONE[key]

    def _doubt(self, margin: float) -> tuple[float, float, float, float]:
        commands = np.array([margin, 0.5, 1.0 - margin])
        bend = (2.0 * self.curve * commands + 1.0 - self.curve) / np.maximum(
            2.0 * self.undone * commands + 1.0 - self.undone, 0.05
        )
        alpha = self.alpha[:, None] * bend  # (axis, command)
        best = _nearest(self._kernels(alpha))
        across = self.mix[:, :2] / np.hypot(self.mix[:, 0], self.mix[:, 1])[:, None]
        chi = max(
            1.0 + float(np.hypot(c * best[:, 0, :, :, :, None], s * best[:, 1, :, :, None, :]).sum(axis=0).max())
            for c, s in np.abs(across)
        )
        chi_yaw = 1.0 + float(np.abs(best[:, 2]).sum(axis=0).max())
        sigma = self.density * np.sqrt(0.5 / _DT * (self._noise(alpha[:, -1]) ** 2).sum(axis=0))
        return (
            _UNMODELLED * chi, _UNMODELLED * chi_yaw, _SIGMA * float(sigma[:2].max()), _SIGMA * float(sigma[2]),
        )  # fmt: skip

    def _kernels(self, alpha: F64) -> F64:
        """(steps, axis, command, lag, alpha, model) what the true torque adds after a unit pulse of the model's."""
        share = np.linspace(-1.0, 1.0, _SHARES)
        a = alpha[:, :, None, None, None] * (1.0 + self.alpha_share * share[None, None, None, :, None])
        t = self.lag * (1.0 + self.lag_share * share[None, None, :, None, None])
        corner = np.array([[0.0, 0.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
        a_model = alpha[:, :, None, None, None] * (1.0 + self.alpha_share * corner[:, 0])
        t_model = self.lag * (1.0 + self.lag_share * corner[:, 1])
        shape = (3, alpha.shape[1], _SHARES, _SHARES, len(corner))
        controller = _Controller(self.gains, shape)
        damp = self.damping.reshape(3, 1, 1, 1, 1)
        keep, keep_model = np.exp(-_DT / t), np.exp(-_DT / t_model)
        rate, rate_model, force, force_model = (np.zeros(shape) for _ in range(4))
        out = np.empty((_STEPS, *shape))
        for k in range(_STEPS):
            out[k] = controller.torque(rate - rate_model)
            pulse = float(k == 0)
            force = keep * force + (1.0 - keep) * (pulse + out[k])
            force_model = keep_model * force_model + (1.0 - keep_model) * pulse
            rate = rate + _DT * (a * force - damp * rate)
            rate_model = rate_model + _DT * (a_model * force_model - damp * rate_model)
        return out

    def _noise(self, alpha: F64) -> F64:
        """(steps, axis) torque after one gyro sample of 1 rad/s."""
        controller, keep = _Controller(self.gains, (3,)), math.exp(-_DT / self.lag)
        rate, force, out = np.zeros(3), np.zeros(3), np.empty((_STEPS, 3))
        for k in range(_STEPS):
            out[k] = controller.torque(rate + float(k == 0))
            force = keep * force + (1.0 - keep) * out[k]
            rate = rate + _DT * (alpha * force - self.damping * rate)
        return out


class _Controller:
    """Torque that a rate controller answers a gyro signal with, at a setpoint of 0; arrays begin with the axis."""

    def __init__(self, gains: dict[str, float], shape: tuple[int, ...]) -> None:
        wide = (3,) + (1,) * (len(shape) - 1)
        self._p, self._i, self._d = (
            np.reshape([gains[f"mc_{axis}rate_k"] * gains[f"mc_{axis}rate_{part}"] for axis in _NAMES], wide)
            for part in "pid"
        )
        self._filter = _low_pass(gains["imu_gyro_cutoff"])
        self._acc_weight = _weight(gains["imu_dgyro_cutoff"])
        self._torque_weight = np.reshape([1.0, 1.0, _weight(gains["mc_yaw_tq_cutoff"])], wide)
        self._in, self._out = [np.zeros(shape) for _ in range(2)], [np.zeros(shape) for _ in range(2)]
        self._acc, self._sum, self._last = np.zeros(shape), np.zeros(shape), np.zeros(shape)

    def torque(self, gyro: F64) -> F64:
        """The next sample's."""
        (b0, b1, b2), (a1, a2) = self._filter
        rate = b0 * gyro + b1 * self._in[0] + b2 * self._in[1] - a1 * self._out[0] - a2 * self._out[1]
        self._acc = self._acc + self._acc_weight * ((rate - self._out[0]) / _DT - self._acc)
        self._in, self._out = [gyro, self._in[0]], [rate, self._out[0]]
        wanted = -self._p * rate - self._i * self._sum - self._d * self._acc
        self._last = self._last + self._torque_weight * (wanted - self._last)
        self._sum = self._sum + _DT * rate
        return self._last


def _low_pass(cutoff_hz: float) -> tuple[tuple[float, float, float], tuple[float, float]]:
    """Second-order Butterworth by the bilinear transform, prewarped: b, a of the difference equation."""
    if not 0.0 < cutoff_hz < 0.5 / _DT:
        return (1.0, 0.0, 0.0), (0.0, 0.0)
    w = 1.0 / math.tan(math.pi * cutoff_hz * _DT)
    scale = 1.0 / (w * w + math.sqrt(2.0) * w + 1.0)
    return (scale, 2.0 * scale, scale), (2.0 * scale * (1.0 - w * w), scale * (w * w - math.sqrt(2.0) * w + 1.0))


def _weight(cutoff_hz: float) -> float:
    return 1.0 if cutoff_hz <= 0.0 else _DT / (_DT + 0.5 / (math.pi * cutoff_hz))


def _nearest(kernels: F64) -> F64:
    """Of each true loop, that of the model whose sum is least: without the last index."""
    which = np.abs(kernels).sum(axis=0).argmin(axis=-1)
    found: F64 = np.take_along_axis(kernels, which[None, ..., None], axis=-1)[..., 0]
    return found
