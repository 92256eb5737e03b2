"""From a log's ticks to samples: what the believed vehicle does not explain of the measured force, and where, anew.

Each tick has a measurement, the command sent in the tick before, and the delay that the learner went by.

    thrust      the command that was sent a delay ago, through the rotors' lag: u' = (u_c - u) / lag, exactly over each
                step between two samples of force, T = T_max (f u^2 + (1 - f) u)
    y           measured specific force + D R'v / m + (0, 0, T / m), body axes, turned to tilt axes: c, s of the heading
    x           (v in tilt axes, b_n, b_e, F, F near): b = R e_z, F = T / (m g), near = (R / 4 h)^2, h at least R / 2
    fit         a new sample of force no older than 50 ms after the last, away from the place of take-off, upright,
                F > 0.3, less than 40 m/s^2 of force, each y within 0.8 g

Where motors report what they were given, commands count as so much more or less as they say over 2 s, if that is
beyond 3 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from .intervals import F64, I64, Mask
from .log import FlightRecording, Table
from .reading import Refused, Unreadable

G = 9.80665
TICK = (
    "pos_ned_m", "vel_ned_mps", "q_ned_frd", "rate_frd_radps", "specific_force_frd_mps2", "motor_command",
    "position_age_us", "attitude_age_us", "imu_age_us", "vehicle_us",
)  # fmt: skip
WANTED = {"/tick": (*TICK, "delay_s"), "/command": ("thrust_norm", "rate_frd_radps")}
WINDOW = 15
"""Samples whose mean is a point."""
_SAME_S = 5e-7
_PARASITIC_AT_MPS = 2.0
"""Airspeed as at which a parasitic drag is believed to be linear."""
_GAP_S, AWAY_M, _FORCE_MPS2, _LEAST_WEIGHTS, _MOST_MPS2 = 0.05, 0.1, 40.0, 0.3, 0.8 * G


@dataclass(frozen=True)
class Believed:
    """What a vehicle file says of thrust and drag."""

    mass_kg: float
    max_thrust_n: float
    factor: float
    lag_s: float
    drag_kgps: F64
    radius_m: float
    frame: dict[str, Any]
    """Where rotors stand and what they turn: as `governor.vehicle` names it."""
    file: dict[str, Any]
    """Its tables."""

    @classmethod
    def of(cls, file: dict[str, Any]) -> Believed:
        """From the file's tables."""
        try:
            body, rotors = _plain(file["body"]), _plain(file["rotors"])
            effects = {name: _plain(values) for name, values in file.get("effects", {}).items()}
            drag = effects.get("linear_drag", {})
            mass_kg = float(body["mass_kg"] + effects.get("payload", {}).get("mass_kg", 0.0))
            max_thrust_n = float(4.0 * rotors["max_thrust_n"] * effects.get("thrust_scale", {}).get("scale", 1.0))
            turning = 4.0 * float(rotors["max_speed_radps"]) * np.sqrt(mass_kg * G / max_thrust_n)  # of all, in hover
            k_d = effects.get("rotor_drag", {}).get("k_d_kg_per_rad", 0.0)
            k_z = effects.get("induced_inflow", {}).get("k_z_kg_per_rad", 0.0)
            parasitic = [effects.get("parasitic_drag", {}).get(f"c_{axis}_kg_per_m", 0.0) for axis in "xyz"]
            return cls(
                mass_kg,
                max_thrust_n,
                float(effects.get("thrust_curve", {}).get("thrust_model_factor", rotors["thrust_model_factor"])),
                max(float(effects.get("motor_lag", {}).get("time_constant_s", rotors["time_constant_s"])), 1e-4),
                np.array([float(drag.get(f"d_{axis}_kgps", 0.0)) for axis in "xyz"])
                + turning * np.array([k_d, k_d, k_z])
                + _PARASITIC_AT_MPS * np.array(parasitic),
                float(rotors["radius_m"]),
                {
                    "position_m": rotors["position_m"],
                    "torque_ratio_m": rotors["torque_ratio_m"],
                    "inertia_kgm2": [
                        float(i) * float(effects.get("inertia", {}).get(f"scale_{axis}", 1.0))
                        for i, axis in zip(body["inertia_kgm2"], "xyz", strict=True)
                    ],
                    "damping_nms": [effects.get("angular_damping", {}).get(f"k_{axis}_nms", 0.0) for axis in "xyz"],
                },
                file,
            )
        except (KeyError, TypeError, ValueError, AttributeError):
            raise Unreadable("vehicle: is no vehicle file") from None

    def thrust_n(self, u: F64) -> F64:
        """Of normalised commands."""
        out: F64 = self.max_thrust_n * (self.factor * u * u + (1.0 - self.factor) * u)
        return out

    def norm(self, thrust_n: float) -> float:
        """The other way round, 0..1."""
        share = min(max(thrust_n / self.max_thrust_n, 0.0), 1.0)
        linear = 1.0 - self.factor
        return 2.0 * share / (linear + math.sqrt(linear * linear + 4.0 * self.factor * share))


def _plain(table: dict[str, Any]) -> dict[str, Any]:
    """Its entries, with the value alone of each that also has a range."""
    return {key: entry["value"] if isinstance(entry, dict) else entry for key, entry in table.items()}


@dataclass(frozen=True)
class Ticks:
    """A log's ticks from the learner's first on."""

    t_us: I64
    tick: Table
    norm: F64
    rates: F64
    delay_s: F64
    """NaN where nothing was learned from it."""

    @classmethod
    def of(cls, recording: FlightRecording, first_us: int, last_us: int) -> Ticks:
        """Those of a log between two stamps; refused where it does not hold them."""
        for topic in ("/tick", "/command"):
            if topic not in recording.tables:
                raise Unreadable(f"log: has no {topic}")
        tick, command = recording.tables["/tick"], recording.tables["/command"]
        times, logged_us = tick["vehicle_us"].astype(np.int64), tick["t_us"]
        if not np.array_equal(logged_us, command["t_us"]) or not np.all(np.diff(times) > 0):
            raise Refused("log: ticks and commands do not belong together")
        inside = (times >= first_us) & (times <= last_us)
        if not inside.any() or times[inside][0] != first_us or times[inside][-1] != last_us:
            raise Refused(f"log: has no ticks from {first_us} to {last_us} us")
        delay = tick["delay_s"]
        kept = {name: column[inside] for name, column in tick.items()}
        return cls(
            times[inside], kept, command["thrust_norm"][inside], command["rate_frd_radps"][inside], delay[inside]
        )

    def bytes(self) -> bytes:
        """What SHA-256 is taken of: each tick's stamp, measurement, ages, command and delay, little-endian."""
        row = [self.t_us.astype("<i8")[:, None]]
        row += [self.tick[name].reshape(len(self.t_us), -1).astype("<f8").view("<i8") for name in TICK[:6]]
        row += [self.tick[name].astype("<i8")[:, None] for name in TICK[6:9]]
        delay = np.where(np.isnan(self.delay_s), -1.0, self.delay_s)
        row += [
            np.ascontiguousarray(part, "<f8").reshape(len(self.t_us), -1).view("<i8")
            for part in (self.norm, self.rates, delay)
        ]
        return np.hstack(row).tobytes()


@dataclass(frozen=True)
class DerivedSamples:
    """Of each tick with a new sample of force that something was learned from, in their order."""

    t_us: I64
    x: F64
    """(n, 7)."""
    y: F64
    """(n, 3) tilt axes, m/s^2."""
    fit: Mask
    force_z: F64
    """Measured, m/s^2."""
    dt_s: F64
    """Between samples of force."""
    middle_s: F64
    """Of the step before each, s: a command a delay before it acts in it."""
    sent_s: F64
    sent_norm: F64
    """Commands as applied and when they were sent."""


def samples(ticks: Ticks, believed: Believed, away_m: float) -> DerivedSamples:
    """All of them, by the module's rule, from `away_m` from the place of take-off on."""
    keep = np.isfinite(ticks.delay_s)
    pos, vel, q, force = (
        ticks.tick[name][keep] for name in ("pos_ned_m", "vel_ned_mps", "q_ned_frd", "specific_force_frd_mps2")
    )
    now, delay = ticks.t_us[keep] * 1e-6, ticks.delay_s[keep]
    sent_s, sent = _sent(ticks, believed, keep)
    imu_s = now - ticks.tick["imu_age_us"][keep] * 1e-6
    before = _before(imu_s)
    dt = imu_s - before
    step = np.clip(dt, 0.0, _GAP_S)
    middle = imu_s - 0.5 * step
    delays, place = np.unique(delay, return_inverse=True)
    u = lagged(sent_s, sent, middle, np.where(dt > _SAME_S, step, 0.0), delays, np.full(len(delays), believed.lag_s))
    thrust = believed.thrust_n(u[np.arange(len(now)), place])
    weights = thrust / (believed.mass_kg * G)
    turn = matrices(q)
    axis = turn[:, :, 2]
    height = pos[0, 2] - pos[:, 2]
    near = (0.25 * believed.radius_m / np.maximum(height, 0.5 * believed.radius_m)) ** 2
    along = np.einsum("nji,nj->ni", turn, vel)
    residual = force + believed.drag_kgps * along / believed.mass_kg
    residual[:, 2] += thrust / believed.mass_kg
    tilt = _tilts(axis)
    x = np.column_stack([np.einsum("nji,nj->ni", tilt, vel), axis[:, :2], weights, weights * near])
    c = np.einsum("ni,ni->n", tilt[:, :, 0], turn[:, :, 0])
    s = np.einsum("ni,ni->n", tilt[:, :, 1], turn[:, :, 0])
    y = np.column_stack(
        [c * residual[:, 0] - s * residual[:, 1], s * residual[:, 0] + c * residual[:, 1], residual[:, 2]]
    )
    fresh = (dt > _SAME_S) & (dt <= _GAP_S) & (before >= 0.0)
    away = ((pos - pos[0]) ** 2).sum(axis=1) > away_m**2
    fit = fresh & away & ((force**2).sum(axis=1) < _FORCE_MPS2**2) & (axis[:, 2] > 0.0) & (weights > _LEAST_WEIGHTS)
    fit &= (np.abs(y) <= _MOST_MPS2).all(axis=1)
    new = dt > _SAME_S  # what a tick repeats is no sample
    return DerivedSamples(
        ticks.t_us[keep][new], x[new], y[new], fit[new], force[new, 2], step[new], middle[new], sent_s, sent
    )


def _before(imu_s: F64) -> F64:
    """(n,) stamp of the force that was new last; one that a tick repeats may be rounded otherwise, and is not it."""
    last, out = -1.0, np.empty(len(imu_s))
    for i, stamp in enumerate(imu_s.tolist()):
        out[i] = last
        if stamp - last > _SAME_S:
            last = stamp
    return out


def _sent(ticks: Ticks, believed: Believed, keep: Mask) -> tuple[F64, F64]:
    """(n,) when the command before each tick was sent, s, and its collective as the motors say that it was applied."""
    first = believed.norm(believed.mass_kg * G)
    norm = np.concatenate([[first], ticks.norm[:-1]])
    sent_us = np.concatenate([ticks.t_us[:1], ticks.t_us[:-1]])
    share = _applied(norm, ticks.tick["motor_command"], 1.0 * (ticks.t_us - sent_us), believed, keep)
    return sent_us[keep] * 1e-6, np.where(share == 1.0, norm, np.minimum(norm * share, 1.0))[keep]


def _applied(norm: F64, motors: F64, dt_us: F64, believed: Believed, keep: Mask) -> F64:
    """(n,) applied over sent, as the motors' reports have it on average."""
    told: Mask = np.all((motors >= 0.0) & (motors <= 1.0), axis=1)
    mean = believed.thrust_n(motors).mean(axis=1)
    recent = sent = measured = 0.0
    out = np.ones(len(norm))
    for i in np.flatnonzero(keep):
        recent += min(dt_us[i] / 50_000.0, 1.0) * (norm[i] - recent)
        if norm[i] > 0.2 and abs(norm[i] - recent) < 0.05 * norm[i] and told[i]:
            share = min(dt_us[i] / 2_000_000.0, 1.0)
            sent += share * (norm[i] - sent)
            measured += share * (believed.norm(float(mean[i])) - measured)
        if sent >= 0.1 and abs(measured / sent - 1.0) >= 0.03:
            out[i] = min(max(measured / sent, 0.5), 2.0)
    return out


def lagged(sent_s: F64, sent: F64, middle_s: F64, dt_s: F64, delays_s: F64, lags_s: F64) -> F64:
    """(n, k) rotors' states after each step, for k pairs of delay and lag."""
    place = np.searchsorted(sent_s, middle_s[:, None] - delays_s, side="right") - 1
    wanted = np.where(place >= 0, sent[np.maximum(place, 0)], 0.0)
    keep = np.exp(-dt_s[:, None] / lags_s)
    u, out = np.zeros(len(delays_s)), np.empty(wanted.shape)
    for i in range(len(wanted)):
        u = wanted[i] + keep[i] * (u - wanted[i])
        out[i] = u
    return out


def matrices(q: F64) -> F64:
    """(n, 3, 3) body to world."""
    w, x, y, z = q.T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))


def _tilts(axis: F64) -> F64:
    """(n, 3, 3) the shortest turns of down onto each axis."""
    n, e = axis[:, 0], axis[:, 1]
    down = np.sqrt(np.maximum(1.0 - n * n - e * e, 0.0))
    share = 1.0 / (1.0 + down)
    rows = [[1.0 - share * n * n, -share * n * e, n], [-share * n * e, 1.0 - share * e * e, e], [-n, -e, down]]
    return np.moveaxis(np.array(rows), 2, 0)
