"""One vehicle run through one flight: rotors, battery and load from its first sample, then its physics at any sample.

Many parameter rows are evaluated at the same states in one compiled call (`gap.evaluated`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from flightstack.effects import (
    EFFECTS,
    PARAMS,
    accelerometer_bias,
    attitude_misalignment,
    gyro_bias,
    slung_load,
    turbulence,
)
from flightstack.effects.row import (
    D_DELAY_STEPS,
    D_MASS,
    D_TAU,
    P_DT,
    P_FULL_V,
    P_HAS_BATTERY,
    PLACES,
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
from flightstack.gap.evaluated import evaluate_at
from flightstack.gap.records import SIGNALS
from flightstack.gap.remembered import Remembered
from flightstack.gap.rotor_state import load_work, run_battery, run_load, run_rotors
from flightstack.gap.track import COLUMNS, GRAVITY_NED_MPS2, ProcessedFlight, simpson, step_commands
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_logs.turn import conjugate, multiply, rotate, rotate_inverse
from flightstack_sim.parameters import derive, parameter_row
from flightstack_sim.plant import evaluate_rows, state_rows

_ROWS_MADE = Remembered[F64](256)
_TURNED = Remembered[F64](4)
_SWUNG = Remembered[F64](4)
_FELT = Remembered[F64](4)
_STATES = Remembered[F64](2)
"""Of the last few vehicles: many loads and ropes are tried on each, and columns are taken where a fit already was."""
_ADRIFT_S = 1.0
"""A log that holds flight this soon began in the air."""
SENSORS = [PLACES[effect, p.name] for effect, spec in EFFECTS.items() if spec.kind == "sensor" for p in spec.params]
"""Places of the sensor effects' parameters in a row."""


@lru_cache(maxsize=4)
def with_added_delay(flight: ProcessedFlight, late_s: float) -> ProcessedFlight:
    """The flight with its commands acting this much later still."""
    samples = flight.samples
    return replace(flight, commands=step_commands(samples, flight.every, samples.command_late_s + late_s))


@dataclass(frozen=True, slots=True, eq=False)
class CentralDifference:
    """Parameter rows with one parameter a little higher and a little lower, and by how much they differ."""

    centre: F64
    up: F64
    down: F64
    width: float


def params_row(vehicle: Vehicle, step_s: float) -> F64:
    """The plant's parameter row (PARAMS,) for a run-through: no ground contact, no gusts, this step."""
    return _ROWS_MADE(lambda: _params_row(vehicle, step_s), vehicle, depends=np.float64(step_s).tobytes()).copy()


def _params_row(vehicle: Vehicle, step_s: float) -> F64:
    p = parameter_row(vehicle, dt_us=1, ground=False)  # at given states nothing is too stiff
    p[P_DT] = step_s
    p[turbulence.SIGMA] = 0.0
    derive(p)
    return p


class ModelEvaluation:
    """One vehicle's rotors, battery and load run through one flight: what is remembered at every sample."""

    __slots__ = ("load", "track", "u", "voltage")

    def __init__(self, p: F64, flight: ProcessedFlight) -> None:
        """`p`: `params_row`."""
        self.track = flight
        behind = np.array([flight.step_s, p[D_TAU], p[D_DELAY_STEPS]]).tobytes()
        self.u = _TURNED(lambda: _rotors(p, flight), flight.commands, depends=behind)
        swinging = p.tobytes() if p[slung_load.MASS] != 0.0 else b""
        self.load = _SWUNG(lambda: _load(p, flight, self.u), flight, depends=swinging)
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

    def changes(self, turned: Sequence[CentralDifference]) -> F64:
        """(N, 6, K) difference quotients as the sensors show them, before the low-pass; all at this run's states."""
        out = self._evaluated(turned[0].centre, np.stack([t.up for t in turned]))
        out -= self._evaluated(turned[0].centre, np.stack([t.down for t in turned]))
        out /= np.array([t.width for t in turned])
        return self._sensed(turned[0].centre, out)

    def _evaluated(self, sensors: F64, rows: F64) -> F64:
        """(N, 6, M) of M parameter rows, all with the sensors of one."""
        out = np.empty((len(self.u), 6, len(rows)))
        states = _states(sensors, self.track, self.load)
        evaluate_at(rows, states, self.u, np.ascontiguousarray(self.voltage), out)
        return out

    def _sensed(self, p: F64, moved: F64) -> F64:
        """A motion (N, 6, ...), or a change of it, as the sensors show it but for their biases; in place."""
        flight = self.track
        misalignment = attitude_misalignment.rotation(p)[None, :]
        given, angular = moved[:, 0:3], moved[:, 3:6]
        force = given
        if "accel_frd_mps2" in flight.missing:
            force = _turned_back(misalignment, force)
        if flight.averaged[0]:
            force = simpson(force, flight.side)
        if force is not given:
            moved[:, 0:3] = force
        angular = simpson(angular, flight.side)
        moved[:, 3:6] = _turned_back(misalignment, angular) if "rate_frd_radps" in flight.missing else angular
        return moved

    def measurement_change(self, p: F64, moved: F64) -> F64:
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
        return np.hstack([self.physics(p, moved), kinematics(self.track, p)])


def kinematics(flight: ProcessedFlight, p: F64) -> F64:
    """(N, 6) the columns without physics, as the sensors of this parameter row show them."""
    out = np.empty((len(flight.q_ned_frd), COLUMNS - len(SIGNALS)))
    misalignment = attitude_misalignment.rotation(p)[None, :]
    out[:, 0:3] = rotate(misalignment, flight.turn_frd_radps) + gyro_bias.bias(p)
    force = rotate_inverse(true_attitude(p, flight), flight.vel_rate_ned_mps2 - GRAVITY_NED_MPS2)
    out[:, 3:6] = force + accelerometer_bias.bias(p)
    out[:, [c - len(SIGNALS) for c in flight.blind if c >= len(SIGNALS)]] = np.nan
    return out


@lru_cache(maxsize=8)
def kinematic_residual(flight: ProcessedFlight, sensors: tuple[float, ...]) -> F64:
    """(N, 6) measured minus `kinematics` through the low-pass: no physics changes it, so it is kept."""
    p = np.zeros(PARAMS)
    p[SENSORS] = sensors
    return flight.lowpass(flight.measured[:, len(SIGNALS) :] - kinematics(flight, p))


def _turned_back(q: F64, vectors: F64) -> F64:
    """R(q)^T of vectors (N, 3, ...) along their second axis."""
    return np.moveaxis(rotate_inverse(q, np.moveaxis(vectors, 1, -1)), -1, 1)


def true_attitude(p: F64, flight: ProcessedFlight) -> F64:
    """(N, 4) attitude without the misalignment of this parameter row."""
    if not np.any(p[attitude_misalignment.ROLL : attitude_misalignment.YAW + 1]):
        return flight.q_ned_frd
    return multiply(flight.q_ned_frd, conjugate(attitude_misalignment.rotation(p)))


def first_command(flight: ProcessedFlight) -> F64:
    """(4,) what the rotors are taken to have turned at before the first sample: the first second's mean."""
    return np.asarray(flight.commands[: max(1, round(1.0 / flight.step_s))].mean(axis=0))


def _rotors(p: F64, flight: ProcessedFlight) -> F64:
    """Motors' u (N, 4) at the samples."""
    row = state_rows(p[None], dt_us=max(1, int(1e6 * flight.step_s)))[0]
    start = np.clip(first_command(flight), 0.0, 1.0)
    row[S_RING:] = np.tile(start, (len(row) - S_RING) // 4)
    row[S_U : S_U + 4] = start
    out = np.empty((len(flight.samples.t_s), 4))
    run_rotors(p, flight.commands, flight.every, row, out)
    return out


def _load(p: F64, flight: ProcessedFlight, u: F64) -> F64:
    """The slung load's direction and its rate (N, 6); hanging at rest at the first sample, where that is no flight."""
    out = np.zeros((len(flight.samples.t_s), 6))
    out[:, 2] = 1.0
    if p[slung_load.MASS] != 0.0:
        slow = p.copy()
        slow[P_DT] = flight.samples.dt_s
        row = np.zeros(S_RING)
        slung_load.hang(row)
        adrift = bool(flight.samples.valid[: max(1, round(_ADRIFT_S / flight.samples.dt_s))].any())
        seen = _felt_of_the_load(p, flight, u, out)
        run_load(slow, np.ascontiguousarray(flight.acc_ned_mps2), seen, adrift, row, np.zeros((4, load_work())), out)
    return out


def _states(p: F64, flight: ProcessedFlight, load: F64) -> F64:
    """(N, S_U) the measured motion without what the sensors add to it, and the load's, as a state row begins."""
    return _STATES(lambda: _states_made(p, flight, load), flight, load, depends=p[SENSORS].tobytes())


def _states_made(p: F64, flight: ProcessedFlight, load: F64) -> F64:
    rate = flight.rate_frd_radps - gyro_bias.bias(p)
    return np.hstack((flight.pos_ned_m, flight.vel_ned_mps, true_attitude(p, flight), rate, load))


def _felt_of_the_load(p: F64, flight: ProcessedFlight, u: F64, hanging: F64) -> F64:
    """(N, 3) N, NED: what the accelerometer felt beyond the forces of this vehicle without its load; NaN if unknown."""
    bare = p.copy()
    bare[slung_load.MASS] = bare[slung_load.LENGTH] = 0.0
    derive(bare)  # its ground contacts, which don't act here, would tell one load from another
    return _FELT(lambda: _felt_beyond(bare, flight, u, hanging), flight, depends=bare.tobytes())


def _felt_beyond(p: F64, flight: ProcessedFlight, u: F64, hanging: F64) -> F64:
    """`_felt_of_the_load` beyond the vehicle of this row."""
    out = np.empty((len(u), 6, 1))
    evaluate_at(p[None], _states_made(p, flight, hanging), u, np.ascontiguousarray(flight.samples.battery_v), out)
    force = flight.measured[:, 0:3]
    if "accel_frd_mps2" not in flight.missing:
        force = rotate(attitude_misalignment.rotation(p)[None, :], force - accelerometer_bias.bias(p))
    measurement_change = p[D_MASS] * rotate(true_attitude(p, flight), force - out[:, 0:3, 0])
    measurement_change[~flight.samples.valid] = np.nan
    return np.asarray(measurement_change)
