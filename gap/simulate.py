"""The simulator at the measured states: what the sensors would have shown if it were right, and how that depends.

Rotors, load and battery run through the flight from its first sample with the simulator's own code; then one compiled
call evaluates forces and torques at all samples.  An effect's regressor is the difference of two such predictions:
there is no second formula of any effect.  Sensor effects change what is shown and the states that the physics is
evaluated at, never the physics.

Turbulence has no regressor: its mean is nothing, it shows as spectrum only, through `steady_wind`'s columns.
A steady wind shows through the drag effects that the vehicle has; without one its columns are 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from flightstack.effect_specs import EFFECT_SPECS, ParamSpec
from flightstack.types import F64
from flightstack.vehicle import LEAST_MASS_SHARE, Vehicle, with_effects
from gap.evaluated import evaluate_at
from gap.records import SIGNALS, Samples
from gap.rotor_state import load_work, run_battery, run_load, run_rotors
from gap.scales import natural_scale
from gap.track import COLUMNS, GRAVITY_NED_MPS2, Track, simpson, step_commands, thinned, track
from logs.turn import conjugate, multiply, rotate, rotate_inverse
from sim.effects import accelerometer_bias, attitude_misalignment, gyro_bias, slung_load, turbulence
from sim.layout import (
    D_DELAY_STEPS,
    D_TAU,
    P_DT,
    P_FULL_V,
    P_HAS_BATTERY,
    PARAMS,
    S_LOAD_DIR,
    S_POS,
    S_Q,
    S_RATE,
    S_RING,
    S_THRUST,
    S_U,
    S_VEL,
    S_VOLTAGE,
    p_effect,
)
from sim.parameters import derive, parameter_row
from sim.plant import evaluate_rows, state_rows

_TOGETHER = 12
"""Columns taken in one call: a long log's must not fill the memory."""
_MOST_ROWS_MADE = 256
_ROWS_MADE: dict[tuple[int, float], tuple[Vehicle, F64]] = {}
_STEP_SHARE = 0.02
_TIMING_STEP_S = 0.001
_COARSE_S = 0.0105
_SENSORS = [
    p_effect(effect, p.name) for effect, spec in EFFECT_SPECS.items() if spec.kind == "sensor" for p in spec.params
]
_OWN_RUN = ("motor_lag", "transport_delay", "slung_load")
"""Effects that change the states that are remembered."""

NEEDS: Mapping[str, tuple[str, ...]] = {
    "battery_sag": ("battery_v",),
    "linear_drag": ("vel_ned_mps", "q_ned_frd"),
    "rotor_drag": ("vel_ned_mps", "q_ned_frd"),
    "induced_inflow": ("vel_ned_mps", "q_ned_frd"),
    "parasitic_drag": ("vel_ned_mps", "q_ned_frd"),
    "translational_lift": ("vel_ned_mps", "q_ned_frd"),
    "blade_flapping": ("vel_ned_mps", "q_ned_frd"),
    "vortex_ring": ("vel_ned_mps", "q_ned_frd"),
    "steady_wind": ("vel_ned_mps", "q_ned_frd"),
    "turbulence": ("vel_ned_mps", "q_ned_frd"),
    "ground_effect": ("height_m",),
    "constant_force": ("q_ned_frd",),
    "slung_load": ("q_ned_frd",),
    "attitude_misalignment": ("q_ned_frd",),
    "accelerometer_bias": ("accel_frd_mps2", "vel_ned_mps", "q_ned_frd"),
    "gyro_bias": ("rate_frd_radps", "q_ned_frd"),
}
"""Signals without which a log can't show an effect, whatever is flown."""


@dataclass(frozen=True, slots=True)
class Knob:
    """One parameter of one effect, and the values of that effect round which it is turned."""

    effect: str
    parameter: str
    at: Mapping[str, float] = field(default_factory=dict)
    """On top of what the vehicle has of the effect: the faulty rotor's number, a load's length."""


def knobs(effect: str, at: Mapping[str, float] | None = None) -> tuple[Knob, ...]:
    """All continuous parameters of an effect (a fault's rotor and other whole numbers are choices: give them `at`)."""
    return tuple(Knob(effect, p.name, dict(at or {})) for p in EFFECT_SPECS[effect].params if not p.integer)


def unseen(samples: Samples, effect: str) -> tuple[str, ...]:
    """Signals that the log lacks and without which it can't show this effect."""
    missing = track(samples).missing
    return tuple(name for name in NEEDS.get(effect, ()) if name in missing)


def predict(vehicle: Vehicle, samples: Samples) -> F64:
    """What the sensors would show if the simulator were right, (N, 12), before the common low-pass.

    Columns 0-2 specific force (m/s^2), 3-5 angular acceleration (rad/s^2), 6-8 body rates as the attitude's derivative
    says (rad/s), 9-11 specific force as the velocity's derivative says (m/s^2); all body FRD, each as its sensor
    shows it.  Compare with `gap.track.track(samples).measured`, both through its `lowpass`.
    """
    flight = track(samples)
    p = params_row(vehicle, flight.step_s)
    return Run(p, flight).shown(p)


def disagreement(vehicle: Vehicle, samples: Samples) -> tuple[F64, F64]:
    """Measured minus what `predict` says: (N, 12) through the common low-pass, and (N, 6) its physics before it.

    Columns that the log can't measure are NaN.
    """
    flight = track(samples)
    p = params_row(vehicle, flight.step_s)
    raw = flight.measured[:, :6] - Run(p, flight).physics(p)
    out = np.full((len(raw), COLUMNS), np.nan)
    sighted = [c for c in range(6) if c not in flight.blind]
    if sighted:
        out[:, sighted] = flight.smooth(raw[:, sighted])
    out[:, 6:] = _kinematic_rest(flight, tuple(p[_SENSORS].tolist()))
    return out, raw


def sensitivity(
    vehicle: Vehicle, samples: Samples, effect: str, parameter: str, at: Mapping[str, float] | None = None
) -> F64:
    """d predict / d parameter, (N, 12), through the common low-pass; see `sensitivities`."""
    return sensitivities(vehicle, samples, [Knob(effect, parameter, at or {})])[:, :, 0]


def sensitivities(vehicle: Vehicle, samples: Samples, columns: Sequence[Knob], every: int = 1) -> F64:
    """d predict / d parameter of all these, (ceil(N / every), 12, K), through the common low-pass.

    Central differences through the simulator, one-sided where the range ends.  Columns that the log can't measure are
    NaN; an effect that the log can't show (`unseen`) is 0 everywhere.  Where few rows are asked for, a fast log is not
    evaluated at each of its samples: the low-pass leaves nothing between them.
    """
    flight = track(samples)
    count = len(range(0, len(samples.t_s), every))
    out = np.zeros((count, COLUMNS, len(columns)))
    fewer = evaluated_every(samples) if every % evaluated_every(samples) == 0 else 1
    if fewer > 1:
        flight, every = thinned(flight, fewer), every // fewer
    row = params_row(vehicle, flight.step_s)
    base = Run(row, flight)
    turned = [_turned(vehicle, row, knob) for knob in columns]
    seen = [k for k, knob in enumerate(columns) if not flight.missing & set(NEEDS.get(knob.effect, ()))]
    shared = [k for k in seen if columns[k].effect not in _OWN_RUN and not _is_sensor(columns[k])]
    for begin in range(0, len(shared), _TOGETHER):
        part = shared[begin : begin + _TOGETHER]
        out[:, :6, part] = flight.smooth(base.changes([turned[k] for k in part]))[::every]
    for k in seen:
        if k not in shared:
            out[:, :, k] = flight.lowpass(_difference(base, turned[k], columns[k]))[::every]
    for column in flight.blind:
        out[:, column, seen] = np.nan
    return out


def evaluated_every(samples: Samples) -> int:
    """Samples of a fast log for which columns need be evaluated once only."""
    return max(1, int(_COARSE_S / samples.dt_s))


def timing(vehicle: Vehicle, samples: Samples) -> F64:
    """d predict / d (commands act later), (N, 12) per second, through the common low-pass.

    A nuisance, no effect: commands of a loop faster than the log are known to about half a sample in time.
    """
    flight = track(samples)
    p = params_row(vehicle, flight.step_s)
    shown = [Run(p, later(flight, change_s)).shown(p) for change_s in (-_TIMING_STEP_S, _TIMING_STEP_S)]
    return flight.lowpass((shown[1] - shown[0]) / (2.0 * _TIMING_STEP_S))


def later(flight: Track, late_s: float) -> Track:
    """The flight with its commands acting this much later still."""
    samples = flight.samples
    return replace(flight, commands=step_commands(samples, flight.every, samples.command_late_s + late_s))


def value(vehicle: Vehicle, effect: str, parameter: str) -> float:
    """A parameter as the vehicle has it: the effect's, else its null value, else the vehicle's own; NaN where none."""
    spec = _spec(effect, parameter)
    given = vehicle.effects.get(effect, {}).get(parameter, spec.null)
    if given is not None:
        return float(given)
    own = {"thrust_model_factor": vehicle.rotors.thrust_model_factor, "time_constant_s": vehicle.rotors.time_constant_s}
    return own.get(parameter, float("nan"))


def with_value(vehicle: Vehicle, effect: str, values: Mapping[str, float]) -> Vehicle:
    """The vehicle with some of an effect's parameters changed, the others kept; what flies keeps some mass."""
    changed = {**vehicle.effects.get(effect, {}), **values}
    if effect == "payload":
        changed["mass_kg"] = _carried(vehicle, changed["mass_kg"])
    return with_effects(vehicle, {effect: changed})


def _carried(vehicle: Vehicle, mass_kg: float) -> float:
    """A payload that leaves some mass."""
    return max(mass_kg, (2.0 * LEAST_MASS_SHARE - 1.0) * vehicle.mass_kg)


def _spec(effect: str, parameter: str) -> ParamSpec:
    return next(p for p in EFFECT_SPECS[effect].params if p.name == parameter)


@dataclass(frozen=True, slots=True, eq=False)
class _Turned:
    """Parameter rows with one parameter a little higher and a little lower, and by how much they differ."""

    centre: F64
    up: F64
    down: F64
    width: float


def _turned(vehicle: Vehicle, row: F64, knob: Knob) -> _Turned:
    """`row`: the vehicle's own."""
    now = knob.at.get(knob.parameter, value(vehicle, knob.effect, knob.parameter))
    spec = _spec(knob.effect, knob.parameter)
    step = _STEP_SHARE * natural_scale(vehicle, knob.effect, knob.parameter)
    high, low = min(now + step, spec.maximum), max(now - step, spec.minimum)
    centre, up, down = row.copy(), row.copy(), row.copy()
    for p, more in ((centre, {}), (up, {knob.parameter: high}), (down, {knob.parameter: low})):
        for name, x in {**knob.at, **more}.items():
            p[p_effect(knob.effect, name)] = _carried(vehicle, x) if knob.effect == "payload" else x
        derive(p)
    return _Turned(centre, up, down, high - low)


def _is_sensor(knob: Knob) -> bool:
    return EFFECT_SPECS[knob.effect].kind == "sensor"


def _difference(base: Run, turned: _Turned, knob: Knob) -> F64:
    """Difference quotient of what is shown, (N, 12), before the low-pass, of what no other parameter goes along with.

    Sensor effects change the states that the physics is evaluated at, lags and a load's swing are states of their own.
    """
    up, down = turned.up, turned.down
    if _is_sensor(knob):
        same = base.moved(turned.centre) if knob.effect == "accelerometer_bias" else None
        return (base.shown(up, same) - base.shown(down, same)) / turned.width
    moved = [Run(p, base.track).moved(p) for p in (up, down)]
    return base.felt(turned.centre, (moved[0] - moved[1]) / turned.width)


def params_row(vehicle: Vehicle, step_s: float) -> F64:
    """The plant's parameter row (PARAMS,) for a run-through: no ground contact, no gusts, this step."""
    key = (id(vehicle), step_s)
    if key not in _ROWS_MADE:
        p = parameter_row(vehicle, dt_us=1, ground=False)  # at given states nothing is too stiff
        p[P_DT] = step_s
        p[turbulence.SIGMA] = 0.0
        derive(p)
        if len(_ROWS_MADE) >= _MOST_ROWS_MADE:
            del _ROWS_MADE[next(iter(_ROWS_MADE))]
        _ROWS_MADE[key] = (vehicle, p)  # the vehicle is kept, else another could come to have its number
    return _ROWS_MADE[key][1].copy()


class Run:
    """One vehicle's rotors, battery and load run through one flight: what is remembered at every sample."""

    __slots__ = ("load", "track", "u", "voltage")

    def __init__(self, p: F64, flight: Track, known: dict[tuple[float, ...], F64] | None = None) -> None:
        """`p`: `params_row`; `known`: rotors' states run through before, by what they depend on; taken and kept."""
        self.track = flight
        known = {} if known is None else known
        key = (float(id(flight.commands)), p[D_TAU], p[D_DELAY_STEPS])
        if key not in known:
            known[key] = _rotors(p, flight)
        self.u = known[key]
        self.load = _load(p, flight)
        self.voltage = flight.samples.battery_v
        if p[P_HAS_BATTERY] != 0.0 and "battery_v" in flight.missing:
            self._drain(p)

    def _drain(self, p: F64) -> None:
        """No voltage in the log: the battery runs along, full at the start."""
        self.voltage = np.full(len(self.u), p[P_FULL_V])
        state = self.states(slice(None))
        state[:, S_Q : S_Q + 4], state[:, S_RATE : S_RATE + 3] = self.track.q_ned_frd, self.track.rate_frd_radps
        evaluate_rows(state, np.broadcast_to(p, (len(state), len(p))).copy())
        slow = p.copy()
        slow[P_DT] = self.track.samples.dt_s
        self.voltage = np.zeros(len(state))
        run_battery(slow, state[:, S_THRUST : S_THRUST + 4].copy(), state_rows(p[None], dt_us=1000)[0], self.voltage)

    def states(self, at: slice | NDArray[np.int64]) -> F64:
        """(n, S_RING) state rows at these samples, attitude and rates left to the caller."""
        flight = self.track
        u = self.u[at]
        state = np.zeros((len(u), S_RING))
        state[:, S_POS : S_POS + 3] = flight.pos_ned_m[at]
        state[:, S_VEL : S_VEL + 3] = flight.vel_ned_mps[at]
        state[:, S_LOAD_DIR : S_LOAD_DIR + 6] = self.load[at]
        state[:, S_U : S_U + 4] = u
        state[:, S_VOLTAGE] = self.voltage[at]
        return state

    def moved(self, p: F64) -> F64:
        """Specific force and angular acceleration (N, 6) of this parameter row at this run's states."""
        return self._evaluated(p, p[None])[:, :, 0]

    def changes(self, turned: Sequence[_Turned]) -> F64:
        """(N, 6, K) difference quotients as the sensors show them, before the low-pass; all at this run's states."""
        count = len(turned)
        rows = np.stack([*(t.up for t in turned), *(t.down for t in turned)])
        both = self._evaluated(rows[0], rows)
        out = (both[:, :, :count] - both[:, :, count:]) / np.array([t.width for t in turned])
        return self._sensed(turned[0].centre, out)

    def _evaluated(self, sensors: F64, rows: F64) -> F64:
        """(N, 6, M) of M parameter rows, all with the sensors of one."""
        flight = self.track
        out = np.empty((len(self.u), 6, len(rows)))
        rate = flight.rate_frd_radps - gyro_bias.bias(sensors)
        attitude = np.ascontiguousarray(true_attitude(sensors, flight))
        voltage = np.ascontiguousarray(self.voltage)
        evaluate_at(rows, flight.pos_ned_m, flight.vel_ned_mps, attitude, rate, self.u, self.load, voltage, out)
        return out

    def _sensed(self, p: F64, moved: F64) -> F64:
        """A motion (N, 6, ...), or a change of it, as the sensors show it but for their biases; in place."""
        flight = self.track
        misalignment = attitude_misalignment.rotation(p)[None, :]
        force, angular = moved[:, 0:3], moved[:, 3:6]
        if "accel_frd_mps2" in flight.missing:
            force = _turned_back(misalignment, force)
        moved[:, 0:3] = simpson(force, flight.side) if flight.averaged[0] else force
        angular = simpson(angular, flight.side)
        moved[:, 3:6] = _turned_back(misalignment, angular) if "rate_frd_radps" in flight.missing else angular
        return moved

    def felt(self, p: F64, moved: F64) -> F64:
        """A change of motion (N, 6) as the sensors show it, (N, 12)."""
        out = np.zeros((len(moved), COLUMNS))
        out[:, : len(SIGNALS)] = self._sensed(p, moved.copy())
        return out

    def physics(self, p: F64, moved: F64 | None = None) -> F64:
        """The first six columns of `shown`; `moved`: the motion (N, 6) where it is known."""
        out = self._sensed(p, self.moved(p) if moved is None else moved.copy())
        if "accel_frd_mps2" not in self.track.missing:
            out[:, 0:3] += accelerometer_bias.bias(p)
        out[:, [c for c in self.track.blind if c < len(SIGNALS)]] = np.nan
        return out

    def shown(self, p: F64, moved: F64 | None = None) -> F64:
        """What the sensors would show (N, 12) with these physics and sensor effects at this run's states."""
        return np.hstack([self.physics(p, moved), _kinematics(self.track, p)])


def _kinematics(flight: Track, p: F64) -> F64:
    """(N, 6) the columns without physics, as the sensors of this parameter row show them."""
    out = np.empty((len(flight.q_ned_frd), COLUMNS - len(SIGNALS)))
    misalignment = attitude_misalignment.rotation(p)[None, :]
    out[:, 0:3] = rotate(misalignment, flight.turn_frd_radps) + gyro_bias.bias(p)
    force = rotate_inverse(true_attitude(p, flight), flight.vel_rate_ned_mps2 - GRAVITY_NED_MPS2)
    out[:, 3:6] = force + accelerometer_bias.bias(p)
    out[:, [c - len(SIGNALS) for c in flight.blind if c >= len(SIGNALS)]] = np.nan
    return out


@lru_cache(maxsize=8)
def _kinematic_rest(flight: Track, sensors: tuple[float, ...]) -> F64:
    """(N, 6) measured minus `_kinematics` through the low-pass: no physics changes it, so it is kept."""
    p = np.zeros(PARAMS)
    p[_SENSORS] = sensors
    return flight.lowpass(flight.measured[:, len(SIGNALS) :] - _kinematics(flight, p))


def _turned_back(q: F64, vectors: F64) -> F64:
    """R(q)^T of vectors (N, 3, ...) along their second axis."""
    return np.moveaxis(rotate_inverse(q, np.moveaxis(vectors, 1, -1)), -1, 1)


def true_attitude(p: F64, flight: Track) -> F64:
    """(N, 4) attitude without the misalignment of this parameter row."""
    if not np.any(p[attitude_misalignment.ROLL : attitude_misalignment.YAW + 1]):
        return flight.q_ned_frd
    return multiply(flight.q_ned_frd, conjugate(attitude_misalignment.rotation(p)))


def first_command(flight: Track) -> F64:
    """(4,) what the rotors are taken to have turned at before the first sample: the first second's mean."""
    return np.asarray(flight.commands[: max(1, round(1.0 / flight.step_s))].mean(axis=0))


def _rotors(p: F64, flight: Track) -> F64:
    """Motors' u (N, 4) at the samples."""
    row = state_rows(p[None], dt_us=max(1, int(1e6 * flight.step_s)))[0]
    start = np.clip(first_command(flight), 0.0, 1.0)
    row[S_RING:] = np.tile(start, (len(row) - S_RING) // 4)
    row[S_U : S_U + 4] = start
    out = np.empty((len(flight.samples.t_s), 4))
    run_rotors(p, flight.commands, flight.every, row, out)
    return out


def _load(p: F64, flight: Track) -> F64:
    """The slung load's direction and its rate (N, 6); hanging at rest at the first sample."""
    out = np.zeros((len(flight.samples.t_s), 6))
    out[:, 2] = 1.0
    if p[slung_load.MASS] != 0.0:
        slow = p.copy()
        slow[P_DT] = flight.samples.dt_s
        row = np.zeros(S_RING)
        slung_load.hang(row)
        run_load(slow, np.ascontiguousarray(flight.acc_ned_mps2), row, np.zeros((4, load_work())), out)
    return out
