"""Thousands of vehicles in closed loop in one call: plant, rate loop and flatness controller, on all cores.

For questions that are not MAVLink's: no messages, no sensors' noise, no estimator; the controller sees the true state.
It is made of the very functions that single flights call one by one, in the same order, so each vehicle flies as it
would alone: a tick of 4 ms is the controller, the limits, and four times the rate loop and the plant.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np

from flightstack.control.feedback import FeedbackGains, controller_rows
from flightstack.effects import PARAMS, turbulence
from flightstack.effects import row as at
from flightstack.model import Limits, Model, limiter_row
from flightstack.types import F64, InputError, Learned
from flightstack.vehicle import Vehicle
from flightstack_sim.autopilot.flight_control import airframe_params
from flightstack_sim.autopilot.rate_control import RateControl
from flightstack_sim.batch_loop import TICK_S, fly_blocks
from flightstack_sim.batch_step import NAMES_IN_THE_LOOP, compiled_steps, run_blocks
from flightstack_sim.lanes import LANES
from flightstack_sim.parameters import parameter_row
from flightstack_sim.plant import GustDraws, state_rows

_DT_US = 1000
REFERENCE = 17
_MOST_THREADS = 64
_LEAST_SHARE = 64
"""Blocks that are worth a thread: to start one for a call takes some 50 us."""


class VehicleBatch:
    """What batches share: N vehicles' parameters and states by field, gusts, threads.

    `pos_ned_m`, ... are (N, 3 or 4) views of the present state and may be written to between calls.  Vehicle i has the
    gusts of a plant with seed `seed` + i.
    """

    def __init__(self, vehicles: Sequence[Vehicle], *, seed: int, dt_us: int, ground: bool) -> None:
        if not vehicles:
            raise InputError("batch: at least one vehicle is needed")
        if not 100 <= dt_us <= 10_000:
            raise InputError(f"batch: dt_us = {dt_us} is not allowed; it must be 100 to 10000 us")
        self.dt_us = dt_us
        self._count = len(vehicles)
        params = np.stack([parameter_row(vehicle, dt_us=dt_us, ground=ground) for vehicle in vehicles])
        delays = [vehicle.effects.get("transport_delay", {}).get("delay_s", 0.0) for vehicle in vehicles]
        rows = state_rows(params, dt_us=dt_us, max_delay_s=max(delays))
        gusty = np.flatnonzero(params[:, turbulence.SIGMA] != 0.0).tolist()
        self._gusts = {i: GustDraws(seed + i, rows[i : i + 1]) for i in gusty}
        self._steps = compiled_steps(any(_acts_in_the_loop(vehicle) for vehicle in vehicles))
        if gusty and not self._steps[2]:
            raise InputError("batch: this NumPy hides what draws gusts; take NumPy's own wheel, or no turbulence")
        self._state = _by_field(rows)
        by_field = _by_field(params)
        by_field[at.P_GROUND, self._count :] = 0.0  # what fills the last block has no ground to slow it down
        blocks = by_field.shape[1] // LANES
        self._params = by_field.reshape(PARAMS, blocks, LANES).transpose(1, 0, 2).reshape(blocks, PARAMS * LANES)
        self._generators = np.zeros(by_field.shape[1], dtype=np.int64)
        for i, draws in self._gusts.items():
            self._generators[i] = draws.generator
        self._pool = ThreadPoolExecutor(_MOST_THREADS)
        self.pos_ned_m = self._view(at.S_POS, 3)
        self.vel_ned_mps = self._view(at.S_VEL, 3)
        self.q_ned_frd = self._view(at.S_Q, 4)
        self.rate_frd_radps = self._view(at.S_RATE, 3)
        self.motor_u = self._view(at.S_U, 4)

    def __len__(self) -> int:
        return self._count

    def _view(self, first: int, fields: int) -> F64:
        return self._state[first : first + fields, : self._count].T

    def _share(self, work: Callable[[int, int], None], threads: int | None) -> None:
        """`work(first, last)` for the vehicles of each thread; None: one for each core where there are enough."""
        blocks = self._state.shape[1] // LANES
        count = min(blocks // _LEAST_SHARE if threads is None else threads, blocks, _MOST_THREADS)
        if count > 1 and threads is None:  # asking for the cores takes as long as ten vehicles' step
            count = min(count, os.cpu_count() or 1)
        if count <= 1:
            work(0, LANES * blocks)
            return
        edges = (LANES * (np.arange(count + 1) * blocks // count)).tolist()
        for job in [self._pool.submit(work, low, high) for low, high in pairwise(edges)]:
            job.result()


class BatchPlant(VehicleBatch):
    """N plants in one compiled call; each flies as its own NativePlant with seed `seed` + i would, to 1e-9.

    `threads`: how many step them (default: one for each core where there are enough vehicles); it changes no number.
    Without `ground` there is none to stand on.
    """

    def __init__(
        self,
        vehicles: Sequence[Vehicle],
        *,
        seed: int,
        dt_us: int = 1000,
        threads: int | None = None,
        ground: bool = True,
    ) -> None:
        super().__init__(vehicles, seed=seed, dt_us=dt_us, ground=ground)
        self._threads = threads
        self.t_us = 0
        self._command = self._view(at.S_COMMAND, 4)
        self.specific_force_frd_mps2 = self._view(at.S_FORCE, 3)
        self.angular_acceleration_frd_radps2 = self._view(at.S_ANGULAR, 3)
        self.battery_v = self._state[at.S_VOLTAGE, : self._count]

    @property
    def on_ground(self) -> np.ndarray:
        """(N,) whether the ground pushed during the last step."""
        return self._state[at.S_NORMAL, : self._count] > 0.0

    def step(self, motor_command: F64) -> None:
        """Advance all by dt_us; `motor_command` (N, 4) or (4,)."""
        self.run(motor_command, 1)

    def run(self, motor_command: F64, steps: int) -> None:
        """`steps` steps with the same commands: the same flight as calling `step` that often, and quicker."""
        self._command[:] = motor_command
        self._state[at.S_COMMAND : at.S_COMMAND + 4, self._count :] = 0.0
        fleet = self._params, self._state, self._generators
        self._share(lambda low, high: run_blocks(self._steps, *fleet, steps, low, high), self._threads)
        self.t_us += steps * self.dt_us


def _acts_in_the_loop(vehicle: Vehicle) -> bool:
    return any(name in vehicle.effects for name in NAMES_IN_THE_LOOP)


def _by_field(rows: F64) -> F64:
    """(N, fields) as (fields, N), the last vehicle repeated until the blocks are full."""
    missing = -len(rows) % LANES
    return np.ascontiguousarray(np.concatenate([rows, np.repeat(rows[-1:], missing, axis=0)]).T)


class BatchClosedLoop(VehicleBatch):
    """N vehicles, each with its own truth, all flown by the controller of one believed vehicle.

    Each begins level at the origin, at rest, its rotors carrying the believed weight; without a ground.
    """

    def __init__(
        self,
        believed: Vehicle,
        truths: Sequence[Vehicle],
        *,
        seed: int = 0,
        gains: FeedbackGains | None = None,
        limits: Limits | None = None,
    ) -> None:
        super().__init__(truths, seed=seed, dt_us=_DT_US, ground=False)
        model, limits = Model.from_vehicle(believed), limits or Limits()
        padded = self._state.shape[1]
        self._state[at.S_U : at.S_U + 4] = self._state[at.S_COMMAND : at.S_COMMAND + 4] = model.hover_norm
        loop = np.append(RateControl(believed, airframe_params(believed)).row, np.zeros(3))
        self._loops = np.repeat(np.repeat(loop, LANES)[None], padded // LANES, axis=0)
        self._corrections = np.zeros((padded, 3))
        constants = controller_rows(model, gains or FeedbackGains(), limits)
        self._control = (constants, limiter_row(model, limits), Learned.nothing().row)
        self._began = False

    def fly(self, reference: F64, *, threads: int | None = None) -> F64:
        """Follow `reference` (ticks, 17), rows of FlatOutput every 4 ms, or (N, ticks, 17) with one for each vehicle.

        (N, ticks) distances from the reference at the beginning of each tick, m.  The result does not depend on
        `threads` (default: one for each core).
        """
        rows = np.ascontiguousarray(reference, dtype=np.float64)
        if rows.ndim == 2:
            rows = rows[None]
        if rows.ndim != 3 or rows.shape[0] not in (1, len(self)) or rows.shape[2] != REFERENCE:
            raise InputError(f"batch: a reference of shape {np.shape(reference)} is not (ticks, 17) or (N, ticks, 17)")
        distances = np.empty((len(self), rows.shape[1]))
        self._share(lambda low, high: self._fly(low, high, rows, distances), threads)
        self._began |= rows.shape[1] > 0
        return distances

    def _fly(self, low: int, high: int, rows: F64, distances: F64) -> None:
        fleet = self._params, self._state, self._generators, self._loops, self._corrections
        first_dt = TICK_S if self._began else 0.0
        fly_blocks(self._control, fleet, rows, distances, (low, high), first_dt, self._steps)
