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

import numpy as np

from flightstack.effect_specs import EFFECT_SPECS, ParamSpec
from flightstack.types import F64
from flightstack.vehicle import LEAST_MASS_SHARE, Vehicle, with_effects
from gap.records import Samples
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
    S_ANGULAR,
    S_FORCE,
    S_LOAD_DIR,
    S_POS,
    S_Q,
    S_RATE,
    S_RING,
    S_THRUST,
    S_U,
    S_VEL,
    S_VOLTAGE,
)
from sim.parameters import derive, parameter_row
from sim.plant import evaluate_rows, state_rows

_CHUNK = 1024
_STEP_SHARE = 0.02
_TIMING_STEP_S = 0.001
_COARSE_S = 0.0085
_NO_NORMALS = np.zeros((0, 1, turbulence.NORMALS))
_MOVES_ROTORS = ("motor_lag", "transport_delay")

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
    run = Run(vehicle, track(samples))
    return run.shown(vehicle)


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
    fewer = max(k for k in range(1, every + 1) if every % k == 0 and (k == 1 or k * samples.dt_s <= _COARSE_S))
    if fewer > 1:
        flight, every = thinned(flight, fewer), every // fewer
    base = Run(vehicle, flight)
    for k, knob in enumerate(columns):
        if not any(name in flight.missing for name in NEEDS.get(knob.effect, ())):
            out[:, :, k] = flight.lowpass(_difference(vehicle, base, knob))[::every]
    return out


def timing(vehicle: Vehicle, samples: Samples) -> F64:
    """d predict / d (commands act later), (N, 12) per second, through the common low-pass.

    A nuisance, no effect: commands of a loop faster than the log are known to about half a sample in time.
    """
    flight = track(samples)
    shown = [Run(vehicle, later(flight, change_s)).shown(vehicle) for change_s in (-_TIMING_STEP_S, _TIMING_STEP_S)]
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
        changed["mass_kg"] = max(changed["mass_kg"], (2.0 * LEAST_MASS_SHARE - 1.0) * vehicle.mass_kg)
    return with_effects(vehicle, {effect: changed})


def _spec(effect: str, parameter: str) -> ParamSpec:
    return next(p for p in EFFECT_SPECS[effect].params if p.name == parameter)


def _difference(vehicle: Vehicle, base: Run, knob: Knob) -> F64:
    """Difference quotient of what is shown, (N, 12), before the low-pass."""
    centre = with_value(vehicle, knob.effect, knob.at) if knob.at else vehicle
    now = value(centre, knob.effect, knob.parameter)
    spec = _spec(knob.effect, knob.parameter)
    step = _STEP_SHARE * natural_scale(vehicle, knob.effect, knob.parameter)
    high, low = min(now + step, spec.maximum), max(now - step, spec.minimum)
    up = with_value(centre, knob.effect, {knob.parameter: high})
    down = with_value(centre, knob.effect, {knob.parameter: low})
    if EFFECT_SPECS[knob.effect].kind == "sensor":
        return (base.shown(up) - base.shown(down)) / (high - low)
    own = knob.effect in _MOVES_ROTORS or knob.effect == "slung_load"
    moved = [(Run(v, base.track) if own else base).moved(params_row(v, base.track.step_s)) for v in (up, down)]
    return base.felt(params_row(centre, base.track.step_s), (moved[0] - moved[1]) / (high - low))


def params_row(vehicle: Vehicle, step_s: float) -> F64:
    """The plant's parameter row (PARAMS,) for a run-through: no ground contact, no gusts, this step."""
    p = parameter_row(vehicle, dt_us=1, ground=False)  # at given states nothing is too stiff
    p[P_DT] = step_s
    p[turbulence.SIGMA] = 0.0
    derive(p)
    return p


class Run:
    """One vehicle run through one flight: what is remembered at every sample, and the state rows to evaluate at."""

    __slots__ = ("load", "state", "track", "u", "voltage")

    def __init__(self, vehicle: Vehicle, flight: Track, known: dict[tuple[float, ...], F64] | None = None) -> None:
        """`known`: rotors' states that were run through before, by what they depend on; they are taken and kept."""
        self.track = flight
        p = params_row(vehicle, flight.step_s)
        count = len(flight.samples.t_s)
        known = {} if known is None else known
        key = (float(id(flight.commands)), p[D_TAU], p[D_DELAY_STEPS])
        if key not in known:
            known[key] = _rotors(p, flight)
        self.u = known[key]
        self.load = _load(p, flight)
        self.voltage = flight.samples.battery_v
        self.state = np.zeros((count, S_RING))
        self.state[:, S_POS : S_POS + 3] = flight.pos_ned_m
        self.state[:, S_VEL : S_VEL + 3] = flight.vel_ned_mps
        self.state[:, S_LOAD_DIR : S_LOAD_DIR + 6] = self.load
        self.state[:, S_U : S_U + 4] = self.u
        if p[P_HAS_BATTERY] != 0.0 and "battery_v" in flight.missing:
            self._drain(p)
        self.state[:, S_VOLTAGE] = self.voltage

    def _drain(self, p: F64) -> None:
        """No voltage in the log: the battery runs along, full at the start."""
        self.state[:, S_VOLTAGE] = p[P_FULL_V]
        self._evaluate(p, self.track.q_ned_frd, self.track.rate_frd_radps)
        slow = p.copy()
        slow[P_DT] = self.track.samples.dt_s
        self.voltage = np.zeros(len(self.state))
        run_battery(
            slow, self.state[:, S_THRUST : S_THRUST + 4].copy(), state_rows(p[None], dt_us=1000)[0], self.voltage
        )

    def _evaluate(self, p: F64, q: F64, rate: F64) -> None:
        self.state[:, S_Q : S_Q + 4] = q
        self.state[:, S_RATE : S_RATE + 3] = rate
        rows = np.tile(p, (min(_CHUNK, len(self.state)), 1))
        for at in range(0, len(self.state), _CHUNK):
            part = self.state[at : at + _CHUNK]
            evaluate_rows(part, rows[: len(part)])

    def moved(self, p: F64) -> F64:
        """Specific force and angular acceleration (N, 6) of this parameter row at this run's states."""
        flight = self.track
        self._evaluate(p, true_attitude(p, flight), flight.rate_frd_radps - gyro_bias.bias(p))
        return self.state[:, S_FORCE : S_ANGULAR + 3].copy()

    def felt(self, p: F64, moved: F64) -> F64:
        """A motion (N, 6), or a change of it, as the sensors show it but for their biases; (N, 12)."""
        flight = self.track
        out = np.zeros((len(moved), COLUMNS))
        out[:, :6] = moved
        misalignment = attitude_misalignment.rotation(p)[None, :]
        if "accel_frd_mps2" in flight.missing:
            out[:, 0:3] = rotate_inverse(misalignment, out[:, 0:3])
        if flight.averaged[0]:
            out[:, 0:3] = simpson(out[:, 0:3], flight.side)
        out[:, 3:6] = simpson(out[:, 3:6], flight.side)
        if "rate_frd_radps" in flight.missing:
            out[:, 3:6] = rotate_inverse(misalignment, out[:, 3:6])
        out[:, flight.blind] = np.nan
        return out

    def shown(self, vehicle: Vehicle) -> F64:
        """What the sensors would show (N, 12) with this vehicle's physics and sensor effects at this run's states."""
        flight = self.track
        p = params_row(vehicle, flight.step_s)
        out = self.felt(p, self.moved(p))
        bias = accelerometer_bias.bias(p)
        if "accel_frd_mps2" not in flight.missing:
            out[:, 0:3] += bias
        q, misalignment = true_attitude(p, flight), attitude_misalignment.rotation(p)[None, :]
        out[:, 6:9] = rotate(misalignment, flight.turn_frd_radps) + gyro_bias.bias(p)
        out[:, 9:12] = rotate_inverse(q, flight.vel_rate_ned_mps2 - GRAVITY_NED_MPS2) + bias
        out[:, flight.blind] = np.nan
        return out


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
