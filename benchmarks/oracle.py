"""The exact model as a learner: what a flight would be if everything were known, hence the floor of all learning.

`Oracle` reads the truth's own parameter row (also while timed events change it) and feeds forward, through the seam
that a learner has, what the believed model does not explain at the state that the reference asks for:

    gain   slope of the true specific force over the believed one, in still air far from the ground
    d      a_true(r, v, q, omega, u) - a_believed(v, q, T), T = T_flat / gain, u = the command that asks for T

with q, omega and T_flat what flatness wants for the reference and d itself: a fixed point, iterated.  Its time
derivative is a central difference along the reference, whose own derivatives up to snap say where it was and will be.
It never sees the vehicle's true state, only the truth's physics; gusts are left out (nobody knows them ahead).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flightstack.effects.row import P_GROUND, S_FORCE, S_POS, S_Q, S_RATE, S_U, S_VEL, S_VOLTAGE
from flightstack.flatness import _to_body
from flightstack.frames import rotation, rotation_to_quat
from flightstack.jit import njit
from flightstack.model import Model, thrust_to_norm
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Command, FlatOutput, Learned, Measurement
from flightstack.vehicle import Vehicle
from flightstack_sim.plant import NativePlant, evaluate_rows, state_rows

_DT_US = 1000
_STEP_S = 0.002
"""Of the central difference: far above rounding, far below the time in which a reference changes."""
_ITERATIONS_MAX = 30
_TOLERANCE_MPS2 = 1e-7
_FAR_UP_M = 1000.0
_HIGHEST_SHARE, _LOWEST_SHARE = 1.2, 0.8
"""Of the believed weight: the thrusts whose slope is the gain."""


class OracleState(NamedTuple):
    """What the next tick's fixed points begin with."""

    acc_ned_mps2: F64
    """(3, 3): d at the reference, a step before it and a step after it."""
    jerk_ned_mps3: F64


class Oracle:
    """A learner that knows the truth; `watch` ties it to a plant whose timed events it then follows."""

    enabled = True

    def __init__(self, model: Model, truth: Vehicle) -> None:
        self._model = np.array([model.mass_kg, model.max_thrust_n, model.thrust_model_factor, *model.drag_kgps])
        self._row = np.empty((1, 0))
        self.watch(NativePlant(truth, seed=0, dt_us=_DT_US))

    def watch(self, plant: NativePlant) -> None:
        """Take the truth's parameters and its battery's voltage from this plant from now on."""
        self._plant = plant
        self._row = state_rows(plant.params_row[None, :], dt_us=_DT_US)

    def init(self) -> object:
        """Nothing found yet."""
        return OracleState(np.zeros((3, 3)), np.zeros(3))

    def step(
        self, state: object, measurement: Measurement, sent: Command, reference: FlatOutput
    ) -> tuple[object, Learned]:
        """What the truth adds to the model at this point of the reference."""
        assert isinstance(state, OracleState)
        gain, acc, jerk = self.exact(reference, state, measurement.q_ned_frd)
        row = Learned.nothing().row
        row[0:3], row[3:6] = acc[0], jerk
        row[6:9] = gain, 1.0, 3.0
        return OracleState(acc, jerk), Learned(row)

    def exact(self, reference: FlatOutput, state: OracleState, hint_q_ned_frd: F64) -> tuple[float, F64, F64]:
        """Thrust gain, d (3, 3: here, before, after) NED m/s^2 and its time derivative (3,) at the reference."""
        params = self._plant.params_row[None, :].copy()
        params[0, P_GROUND] = 0.0  # a reference that stands on the ground is not carried by it
        self._row[0, S_VOLTAGE] = self._plant.state_row[S_VOLTAGE]
        acc = state.acc_ned_mps2.copy()
        gain = _exact(reference.row, state.jerk_ned_mps3, hint_q_ned_frd, self._model, params, self._row, acc)
        return gain, acc, (acc[2] - acc[1]) / (2.0 * _STEP_S)


@njit
def _exact(point: F64, jerk: F64, hint: F64, model: F64, params: F64, row: F64, acc: F64) -> float:
    """The gain; d at the point, a step before and a step after it into `acc` (3, 3), which holds the first guesses."""
    gain = _thrust_gain(model, params, row)
    for k, ahead in enumerate((0.0, -_STEP_S, _STEP_S)):
        _fixed_point(_moved(point, ahead), jerk, hint, gain, model, params, row, acc[k])
    return gain


@njit
def _thrust_gain(model: F64, params: F64, row: F64) -> float:
    """True over believed thrust acceleration per change of thrust; upright, in still air, far from the ground."""
    weight = model[0] * STANDARD_GRAVITY_MPS2
    row[0, : S_U + 4] = 0.0
    row[0, S_POS + 2] = -_FAR_UP_M
    row[0, S_Q] = 1.0
    _command(row, _LOWEST_SHARE * weight, model)
    evaluate_rows(row, params)
    less = row[0, S_FORCE + 2]
    _command(row, _HIGHEST_SHARE * weight, model)
    evaluate_rows(row, params)
    more = row[0, S_FORCE + 2]
    return (less - more) * model[0] / ((_HIGHEST_SHARE - _LOWEST_SHARE) * weight)  # type: ignore[no-any-return]


@njit
def _command(row: F64, thrust_n: float, model: F64) -> None:
    """All rotors where they give `thrust_n` in all by the model."""
    for i in range(4):
        row[0, S_U + i] = thrust_to_norm(thrust_n, model[1], model[2])


@njit
def _fixed_point(
    point: F64, jerk: F64, hint: F64, gain: float, model: F64, params: F64, row: F64, d: F64
) -> None:  # fmt: skip
    """d (3,) at one point of the reference, from the guess in it."""
    upright = rotation(hint)
    for _ in range(_ITERATIONS_MAX):
        (force, _), rate, _, (x, y, z) = _to_body(
            (point[3:6], point[6:9], point[9:12], point[12:15]), (point[15], point[16]), (d, jerk), upright, model[0],
            model[3:6], STANDARD_GRAVITY_MPS2,
        )  # fmt: skip
        r = (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])
        q = rotation_to_quat(r)
        thrust = force / gain
        row[0, S_POS : S_POS + 3] = point[0:3]
        row[0, S_VEL : S_VEL + 3] = point[3:6]
        for i in range(4):
            row[0, S_Q + i] = q[i]
        for i in range(3):
            row[0, S_RATE + i] = rate[i]
        _command(row, thrust, model)
        evaluate_rows(row, params)
        change = 0.0
        unexplained = np.empty(3)
        for i in range(3):
            air = r[0][i] * point[3] + r[1][i] * point[4] + r[2][i] * point[5]
            unexplained[i] = row[0, S_FORCE + i] + model[3 + i] * air / model[0]
        unexplained[2] += gain * thrust / model[0]
        for i in range(3):
            found = r[i][0] * unexplained[0] + r[i][1] * unexplained[1] + r[i][2] * unexplained[2]
            change = max(change, abs(found - d[i]))
            d[i] = found
        if change < _TOLERANCE_MPS2:
            return


@njit
def _moved(point: F64, h: float) -> F64:
    """The reference `h` seconds later, by its own derivatives; (17,) -> (17,)."""
    out = point.copy()
    for i in range(3):
        p, v, a, j, s = point[i], point[3 + i], point[6 + i], point[9 + i], point[12 + i]
        out[i] = p + h * (v + h / 2.0 * (a + h / 3.0 * (j + h / 4.0 * s)))
        out[3 + i] = v + h * (a + h / 2.0 * (j + h / 3.0 * s))
        out[6 + i] = a + h * (j + h / 2.0 * s)
        out[9 + i] = j + h * s
    out[15] = point[15] + h * point[16]
    return out
