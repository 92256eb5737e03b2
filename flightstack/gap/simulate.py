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
from dataclasses import dataclass, field

import numpy as np

from flightstack.effects import EFFECTS, ParamSpec
from flightstack.effects.record import Size
from flightstack.effects.row import PLACES
from flightstack.gap.cores import on_cores
from flightstack.gap.records import Samples
from flightstack.gap.remembered import Remembered
from flightstack.gap.run import (
    SENSORS,
    CentralDifference,
    ModelEvaluation,
    kinematic_residual,
    kinematics,
    params_row,
    with_added_delay,
)
from flightstack.gap.track import COLUMNS, ProcessedFlight, thinned, track
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import LEAST_MASS_SHARE, Vehicle, with_effects
from flightstack_sim.parameters import derive

_TOGETHER = 6
"""Columns taken in one call: a long log's must not fill the memory."""
_STEP_SHARE = 0.02
_TIMING_STEP_S = 0.001
_COARSE_S = 0.0105
_UPRIGHT = frozenset({"down_n", "down_mps"})
"""Without motors only side force is compared: what is vertical shows in it by the lean, as a loop's answer does."""


@dataclass(frozen=True, slots=True)
class FreeParameter:
    """One parameter of one effect, and the values of that effect round which it is turned."""

    effect: str
    parameter: str
    at: Mapping[str, float] = field(default_factory=dict)
    """On top of what the vehicle has of the effect: the faulty rotor's number, a load's length."""


def free_parameters(effect: str, at: Mapping[str, float] | None = None) -> tuple[FreeParameter, ...]:
    """All continuous parameters of an effect (a fault's rotor and other whole numbers are choices: give them `at`)."""
    return tuple(FreeParameter(effect, p.name, dict(at or {})) for p in EFFECTS[effect].params if not p.integer)


def missing_signals(samples: Samples, effect: str) -> tuple[str, ...]:
    """Signals that the log lacks and without which it can't show this effect."""
    missing = track(samples).missing
    return tuple(name for name in EFFECTS[effect].needs if name in missing)


def confounded_with_attitude(samples: Samples, effect: str) -> bool:
    """Whether the effect may only stand for how the log's attitude was made.

    An attitude out of the acceleration is the one at which there is no side force: it tells nothing of what blows or
    drags.  Differentiated twice it tells what tips a vehicle, not how soon: lags and damping are its filter's.
    """
    return "q_ned_frd" in samples.derived and (EFFECTS[effect].turns_only or "q_ned_frd" in EFFECTS[effect].needs)


def predict(vehicle: Vehicle, samples: Samples) -> F64:
    """What the sensors would show if the simulator were right, (N, 12), before the common low-pass.

    Columns 0-2 specific force (m/s^2), 3-5 angular acceleration (rad/s^2), 6-8 body rates as the attitude's derivative
    says (rad/s), 9-11 specific force as the velocity's derivative says (m/s^2); all body FRD, each as its sensor
    shows it.  Compare with `gap.track.track(samples).measured`, both through its `lowpass`.
    """
    flight = track(samples)
    p = params_row(vehicle, flight.step_s)
    return np.hstack([_physics(p, flight), kinematics(flight, p)])


def _physics(p: F64, flight: ProcessedFlight) -> F64:
    """(N, 6) the first columns of `predict`."""
    return _PHYSICS(lambda: ModelEvaluation(p, flight).physics(p), flight, depends=p.tobytes())


_PHYSICS = Remembered[F64](4)


def prediction_error(vehicle: Vehicle, samples: Samples) -> tuple[F64, F64]:
    """Measured minus what `predict` says: (N, 12) through the common low-pass, and (N, 6) its physics before it.

    Columns that the log can't measure are NaN.
    """
    flight = track(samples)
    p = params_row(vehicle, flight.step_s)
    raw = flight.measured[:, :6] - _physics(p, flight)
    out = np.full((len(raw), COLUMNS), np.nan)
    sighted = [c for c in range(6) if c not in flight.blind]
    if sighted:
        out[:, sighted] = flight.smooth(raw[:, sighted])
    out[:, 6:] = kinematic_residual(flight, tuple(p[SENSORS].tolist()))
    return out, raw


def sensitivities(vehicle: Vehicle, samples: Samples, columns: Sequence[FreeParameter], every: int = 1) -> F64:
    """d predict / d parameter of all these, (ceil(N / every), 12, K), through the common low-pass.

    Central differences through the simulator, one-sided where the range ends.  Columns that the log can't measure are
    NaN; what the log can't show (`unseen`, upright without motors) is 0 everywhere.  Where few rows are asked for, a
    fast log is not evaluated at each of its samples: the low-pass leaves nothing between them.
    """
    flight = track(samples)
    count = len(range(0, len(samples.t_s), every))
    out = np.zeros((count, COLUMNS, len(columns)))
    fewer = evaluated_every(samples) if every % evaluated_every(samples) == 0 else 1
    if fewer > 1:
        flight, every = thinned(flight, fewer), every // fewer
    row = params_row(vehicle, flight.step_s)
    base = ModelEvaluation(row, flight)
    turned = [_turned(vehicle, row, knob) for knob in columns]
    mute = _UPRIGHT if "motor" in flight.missing else frozenset()
    seen = [
        k for k, c in enumerate(columns) if not (flight.missing & set(EFFECTS[c.effect].needs) or c.parameter in mute)
    ]
    shared = [k for k in seen if not EFFECTS[columns[k].effect].has_states and not _is_sensor(columns[k])]

    def fill(part: list[int]) -> None:
        if part[0] in shared:
            out[:, :6, part] = flight.smooth(base.changes([turned[k] for k in part]))[::every]
        else:
            out[:, :, part[0]] = flight.lowpass(_difference(base, turned[part[0]], columns[part[0]]))[::every]

    together = [shared[begin : begin + _TOGETHER] for begin in range(0, len(shared), _TOGETHER)]
    on_cores(fill, [*together, *([k] for k in seen if k not in shared)])
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
    shown = [
        ModelEvaluation(p, with_added_delay(flight, change_s)).shown(p)
        for change_s in (-_TIMING_STEP_S, _TIMING_STEP_S)
    ]
    return flight.lowpass((shown[1] - shown[0]) / (2.0 * _TIMING_STEP_S))


def value(vehicle: Vehicle, effect: str, parameter: str) -> float:
    """A parameter as the vehicle has it: the effect's, else its null value, else the vehicle's own; NaN where none."""
    spec = spec_of(effect, parameter)
    given = vehicle.effects.get(effect, {}).get(parameter, spec.null)
    if given is not None:
        return float(given)
    own = {"thrust_model_factor": vehicle.rotors.thrust_model_factor, "time_constant_s": vehicle.rotors.time_constant_s}
    return own.get(parameter, float("nan"))


def with_value(vehicle: Vehicle, effect: str, values: Mapping[str, float]) -> Vehicle:
    """The vehicle with some of an effect's parameters changed, the others kept.

    Values are brought into the range that a vehicle file allows, and what flies keeps some mass: an estimate beyond a
    range must never be refused by the file that is made of it.
    """
    within = {p: float(np.clip(x, spec_of(effect, p).minimum, spec_of(effect, p).maximum)) for p, x in values.items()}
    changed = {**vehicle.effects.get(effect, {}), **within}
    if effect == "payload":
        changed["mass_kg"] = _carried(vehicle, changed["mass_kg"])
    return with_effects(vehicle, {effect: changed})


def _carried(vehicle: Vehicle, mass_kg: float) -> float:
    """A payload that leaves some mass."""
    return max(mass_kg, (2.0 * LEAST_MASS_SHARE - 1.0) * vehicle.mass_kg)


def spec_of(effect: str, parameter: str) -> ParamSpec:
    """The table's row of one parameter."""
    return next(p for p in EFFECTS[effect].params if p.name == parameter)


def _turned(vehicle: Vehicle, row: F64, knob: FreeParameter) -> CentralDifference:
    """`row`: the vehicle's own."""
    now = knob.at.get(knob.parameter, value(vehicle, knob.effect, knob.parameter))
    spec = spec_of(knob.effect, knob.parameter)
    step = _STEP_SHARE * natural_scale(vehicle, knob.effect, knob.parameter)
    high, low = min(now + step, spec.maximum), max(now - step, spec.minimum)
    centre, up, down = row.copy(), row.copy(), row.copy()
    for p, more in ((centre, {}), (up, {knob.parameter: high}), (down, {knob.parameter: low})):
        for name, x in {**knob.at, **more}.items():
            p[PLACES[knob.effect, name]] = _carried(vehicle, x) if knob.effect == "payload" else x
        derive(p)
    return CentralDifference(centre, up, down, high - low)


def _is_sensor(knob: FreeParameter) -> bool:
    return EFFECTS[knob.effect].kind == "sensor"


def _difference(base: ModelEvaluation, turned: CentralDifference, knob: FreeParameter) -> F64:
    """Difference quotient of what is shown, (N, 12), before the low-pass, of what no other parameter goes along with.

    Sensor effects change the states that the physics is evaluated at, lags and a load's swing are states of their own.
    """
    up, down = turned.up, turned.down
    if _is_sensor(knob):
        same = base.moved(turned.centre) if knob.effect == "accelerometer_bias" else None
        return (base.shown(up, same) - base.shown(down, same)) / turned.width
    moved = [ModelEvaluation(p, base.track).moved(p) for p in (up, down)]
    return base.measurement_change(turned.centre, (moved[0] - moved[1]) / turned.width)


def natural_scale(vehicle: Vehicle, effect: str, parameter: str) -> float:
    """A change of this parameter that moves the motion by some percent; positive, in the parameter's unit."""
    hover = min(1.0, (vehicle.mass_kg * STANDARD_GRAVITY_MPS2 / vehicle.max_total_thrust_n) ** 0.5)
    size = Size(
        mass_kg=vehicle.total_mass_kg,
        weight_n=vehicle.weight_n,
        inertia_kgm2=float(vehicle.inertia_kgm2.mean()),
        arm_m=float((vehicle.rotors.position_m[:, :2] ** 2).sum(axis=1).mean()) ** 0.5,
        turning_radps=4.0 * hover * vehicle.rotors.max_speed_radps,
    )
    scale = EFFECTS[effect].scale(size)
    return float(scale if isinstance(scale, float) else scale[parameter])
