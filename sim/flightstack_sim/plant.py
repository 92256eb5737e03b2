"""The plant: what every one has (`Plant`), which there are (`make_plant`), the native one.

Everything that a plant shows is a view into its row and is updated in place by each step.  Many in one call:
`flightstack_sim.batch`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np

from flightstack.effects import (
    accelerometer_bias,
    attitude_misalignment,
    battery_sag,
    gyro_bias,
    slung_load,
    turbulence,
)
from flightstack.effects import row as at
from flightstack.jit import njit
from flightstack.types import F64, InputError, Tuple3, Tuple4, made
from flightstack.vehicle import Vehicle, with_effects
from flightstack_sim.parameters import parameter_row
from flightstack_sim.rigid_body import air_velocity, evaluate, rotor_speeds, step_row

PLANTS = ("native", "jsbsim")
MAX_DELAY_S = 0.25
_BLOCK = 256  # steps whose gust normals are drawn at once
_NO_NORMALS = np.zeros((0, 1, turbulence.NORMALS))


class Truth(NamedTuple):
    """A snapshot of a plant, for logs and scoring: plain numbers, SI units."""

    t_us: int
    pos_ned_m: Tuple3
    vel_ned_mps: Tuple3
    q_ned_frd: Tuple4
    rate_frd_radps: Tuple3
    specific_force_frd_mps2: Tuple3
    """Mean over the last step."""
    angular_acceleration_frd_radps2: Tuple3
    """Mean over the last step."""
    motor_u: Tuple4
    """Normalised motor commands after their lag."""
    rotor_thrust_n: Tuple4
    wind_ned_mps: Tuple3
    battery_v: float
    on_ground: bool


class Plant(Protocol):
    """A simulated vehicle's physics.  The arrays are the same objects for the plant's life, updated in place."""

    dt_us: int
    t_us: int
    pos_ned_m: F64
    vel_ned_mps: F64
    q_ned_frd: F64
    rate_frd_radps: F64
    specific_force_frd_mps2: F64
    """Mean over the last step, at the CoM."""
    accel_bias_frd_mps2: F64
    gyro_bias_frd_radps: F64
    misalignment_q: F64
    """The measured attitude is q_ned_frd (x) this."""

    @property
    def battery_v(self) -> float:
        """Voltage at the battery's terminals; 0 where the vehicle has no [battery]."""

    @property
    def on_ground(self) -> bool:
        """Whether the ground pushed during the last step."""

    def step(self, motor_command: F64) -> None:
        """Advance by dt_us with these commands (4,), normalised 0..1, held; what is not a number stops its motor."""

    def truth(self) -> Truth:
        """A snapshot."""

    def set_effect(self, name: str, values: Mapping[str, float]) -> None:
        """From now on the effect has these values (absent ones: null); InputError where they are not allowed."""


@njit
def step_rows(state: F64, params: F64) -> None:
    """One step of each of N vehicles: state (N, ...), commands and normals included, params (N, PARAMS)."""
    work = np.empty((3, at.EVALUATED))
    for i in range(state.shape[0]):
        step_row(params[i], state[i], work)


@njit
def run_rows(state: F64, params: F64, normals: F64, steps: int) -> None:
    """`steps` steps with the same commands; normals (steps, N, 5), or (0, N, 5) for steps without gusts."""
    work = np.empty((3, at.EVALUATED))
    for k in range(steps):
        for i in range(state.shape[0]):
            if normals.shape[0] > 0:
                for j in range(turbulence.NORMALS):
                    state[i, at.S_NORMALS + j] = normals[k, i, j]
            step_row(params[i], state[i], work)


@njit
def evaluate_rows(state: F64, params: F64) -> None:
    """Outputs of N state rows without a step: specific force, angular acceleration, thrusts, wind, ground's push.

    Reads position, velocity, attitude, rates, motors' u, voltage, load and gust states; friction has no part in it.
    """
    work = np.empty((2, at.EVALUATED))
    y, dy = work[0], work[1]
    for i in range(state.shape[0]):
        row, p = state[i], params[i]
        for k in range(at.EVALUATED):  # a copy of slices takes 2 s to compile: it may fail, and would say so
            y[k] = row[k]
        u = (row[at.S_U], row[at.S_U + 1], row[at.S_U + 2], row[at.S_U + 3])
        evaluate(p, y, rotor_speeds(p, u), air_velocity(p, row), battery_sag.factor(p, row[at.S_VOLTAGE]), dy)
        for j in range(3):
            row[at.S_FORCE + j] = dy[at.E_FORCE + j]
            row[at.S_ANGULAR + j] = dy[at.S_RATE + j]
        row[at.S_NORMAL] = dy[at.E_NORMAL]
        for j in range(4):
            row[at.S_THRUST + j] = dy[at.E_THRUST + j]


def state_rows(params: F64, *, dt_us: int, max_delay_s: float = MAX_DELAY_S) -> F64:
    """State rows of N vehicles at rest on the ground at the origin, facing north, motors off, battery full."""
    entries = int(np.ceil(max_delay_s / (1e-6 * dt_us))) + 2
    state = np.zeros((params.shape[0], at.S_RING + 4 * entries))
    state[:, at.S_Q] = 1.0
    state[:, at.S_CHARGE] = 1.0
    state[:, at.S_VOLTAGE] = np.where(params[:, at.P_HAS_BATTERY] != 0.0, params[:, at.P_FULL_V], 0.0)
    for row in state:
        slung_load.hang(row)
    evaluate_rows(state, params)
    return state


class GustDraws:
    """Blocks of standard normals for (N, 5) a step; none are drawn while no vehicle has turbulence."""

    def __init__(self, seed: int, state: F64) -> None:
        self._rng = np.random.default_rng(seed)
        self._inputs = state[:, at.S_NORMALS : at.S_NORMALS + turbulence.NORMALS]
        self._block = np.empty((0, *self._inputs.shape))
        self._next = 0
        self._inputs[:] = self._rng.standard_normal(self._inputs.shape)
        for row in state:
            turbulence.start(row)

    def take(self, most: int) -> F64:
        """Normals of the next 1 to `most` steps, (steps, N, 5)."""
        if self._next == len(self._block):
            self._refill()
        first = self._next
        self._next = min(first + most, len(self._block))
        return self._block[first : self._next]

    @property
    def generator(self) -> int:
        """The address of NumPy's bit generator, for compiled loops that draw; valid while this is."""
        return int(self._rng.bit_generator.ctypes.bit_generator.value)

    def draw(self) -> None:
        """Put the next step's normals into the state rows."""
        if self._next == len(self._block):
            self._refill()
        self._inputs[:] = self._block[self._next]
        self._next += 1

    def _refill(self) -> None:
        self._block = self._rng.standard_normal((_BLOCK, *self._inputs.shape))
        self._next = 0


class NativePlant:
    """One vehicle; same vehicle, seed and commands give the same flight, bit for bit.

    It starts at rest on the ground at the origin, facing north; its state arrays may be written to between steps.
    `params_row` and `state_row` are its rows as `step_row` takes them, for compiled loops round it.
    """

    def __init__(self, vehicle: Vehicle, *, seed: int, dt_us: int = 1000, ground: bool = True) -> None:
        if not 100 <= dt_us <= 10_000:
            raise InputError(f"plant: dt_us = {dt_us} is not allowed; it must be 100 to 10000 us")
        self.dt_us = dt_us
        self.t_us = 0
        self.vehicle = vehicle
        self._ground = ground
        self._params = parameter_row(vehicle, dt_us=dt_us, ground=ground)[None, :]
        self._state = state_rows(self._params, dt_us=dt_us)
        self._gusts = GustDraws(seed, self._state)
        row = self.state_row = self._state[0]
        self.params_row = self._params[0]
        self._shown = row[: at.S_RING]
        self._command = row[at.S_COMMAND : at.S_COMMAND + 4]
        self.pos_ned_m = row[at.S_POS : at.S_POS + 3]
        self.vel_ned_mps = row[at.S_VEL : at.S_VEL + 3]
        self.q_ned_frd = row[at.S_Q : at.S_Q + 4]
        self.rate_frd_radps = row[at.S_RATE : at.S_RATE + 3]
        self.specific_force_frd_mps2 = row[at.S_FORCE : at.S_FORCE + 3]
        self.angular_acceleration_frd_radps2 = row[at.S_ANGULAR : at.S_ANGULAR + 3]
        self.motor_u = row[at.S_U : at.S_U + 4]
        self.accel_bias_frd_mps2 = np.zeros(3)
        self.gyro_bias_frd_radps = np.zeros(3)
        self.misalignment_q = np.zeros(4)
        self._take_over_effects()

    @property
    def battery_v(self) -> float:
        """Voltage at the battery's terminals; 0 where the vehicle has no [battery]."""
        return float(self._state[0, at.S_VOLTAGE])

    @property
    def on_ground(self) -> bool:
        """Whether the ground pushed during the last step."""
        return bool(self._state[0, at.S_NORMAL] > 0.0)

    def step(self, motor_command: F64) -> None:
        """Advance by dt_us with these commands (4,), normalised 0..1, held; what is not a number stops its motor."""
        self._command[:] = motor_command
        if self._gusty:
            self._gusts.draw()
        step_rows(self._state, self._params)
        self.t_us += self.dt_us

    def run(self, motor_command: F64, steps: int) -> None:
        """`steps` steps with the same commands in one compiled call; the same flight as calling `step` that often."""
        self._command[:] = motor_command
        self.t_us += steps * self.dt_us
        if not self._gusty:
            run_rows(self._state, self._params, _NO_NORMALS, steps)
            return
        while steps > 0:
            normals = self.take_normals(steps)
            run_rows(self._state, self._params, normals, len(normals))
            steps -= len(normals)

    def take_normals(self, steps: int) -> F64:
        """Normals for the gusts of the next 1 to `steps` steps, (n, 1, 5); (0, 1, 5) where there are no gusts."""
        return self._gusts.take(steps) if self._gusty else _NO_NORMALS

    def evaluate(self) -> None:
        """Bring specific force and angular acceleration in line with a state that was written from outside."""
        evaluate_rows(self._state, self._params)

    def truth(self) -> Truth:
        """A snapshot."""
        row = tuple(self._shown.tolist())
        shown = (
            self.t_us,
            row[at.S_POS : at.S_POS + 3],
            row[at.S_VEL : at.S_VEL + 3],
            row[at.S_Q : at.S_Q + 4],
            row[at.S_RATE : at.S_RATE + 3],
            row[at.S_FORCE : at.S_FORCE + 3],
            row[at.S_ANGULAR : at.S_ANGULAR + 3],
            row[at.S_U : at.S_U + 4],
            row[at.S_THRUST : at.S_THRUST + 4],
            row[at.S_WIND : at.S_WIND + 3],
            row[at.S_VOLTAGE],
            row[at.S_NORMAL] > 0.0,
        )
        return made(Truth, shown)

    def set_effect(self, name: str, values: Mapping[str, float]) -> None:
        """From now on the effect has these values (absent ones: null); InputError where they are not allowed.

        The state stays; a load that was not there before hangs straight down, at rest relative to the vehicle.
        """
        had_load = self._params[0, slung_load.MASS] != 0.0
        self.vehicle = with_effects(self.vehicle, {name: values}, source="event")
        self._params[0] = parameter_row(self.vehicle, dt_us=self.dt_us, ground=self._ground)
        if name == "slung_load" and not had_load:
            slung_load.hang(self._state[0])
        self._take_over_effects()

    def _take_over_effects(self) -> None:
        p = self._params[0]
        self._gusty = bool(p[turbulence.SIGMA] != 0.0)
        self.accel_bias_frd_mps2[:] = accelerometer_bias.bias(p)
        self.gyro_bias_frd_radps[:] = gyro_bias.bias(p)
        self.misalignment_q[:] = attitude_misalignment.rotation(p)


def make_plant(name: str, vehicle: Vehicle, *, seed: int, dt_us: int = 1000) -> Plant:
    """A plant by its name, one of PLANTS; InputError where it can't fly this vehicle on this machine."""
    if name == "native":
        return NativePlant(vehicle, seed=seed, dt_us=dt_us)
    if name == "jsbsim":
        from flightstack_sim.jsbsim.plant import JsbsimPlant  # a library that not every machine has

        return JsbsimPlant(vehicle, seed=seed, dt_us=dt_us)
    raise InputError(f"--plant {name} is not known; there are {', '.join(PLANTS)}")
