"""Thousands of vehicles in closed loop in one call: plant, rate loop and flatness controller, on all cores.

For questions that are not MAVLink's: no messages, no sensors' noise, no estimator; the controller sees the true state.
It is made of the very functions that single flights call one by one, in the same order, so each vehicle flies as it
would alone: a tick of 4 ms is the controller, the limits, and four times the rate loop and the plant.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from flightstack.control.feedback import FeedbackGains, control_step, controller_rows
from flightstack.jit import njit_free
from flightstack.model import Limits, Model, limit_command, limiter_row
from flightstack.types import F64, InputError, Learned
from flightstack.vehicle import Vehicle
from flightstack_sim.autopilot.flight_control import airframe_params
from flightstack_sim.autopilot.rate_control import RateControl, aim, motors_of, rate_step
from flightstack_sim.effects import turbulence
from flightstack_sim.layout import EVALUATED, S_COMMAND, S_NORMALS, S_POS, S_Q, S_RATE, S_U, S_VEL
from flightstack_sim.parameters import parameter_row
from flightstack_sim.plant import Gusts, state_rows
from flightstack_sim.rigid_body import step_row

TICK_S = 0.004
_STEPS = 4
_DT_US = 1000
_BLOCK = 64
"""Ticks that are flown by one compiled call: as many as a block of gusts lasts."""
REFERENCE = 17


class BatchClosedLoop:
    """N vehicles, each with its own truth, all flown by the controller of one believed vehicle.

    `pos_ned_m`, `vel_ned_mps` (N, 3), `q_ned_frd` (N, 4) and `rate_frd_radps` (N, 3) are views of the present state and
    may be written to before `fly`.  Vehicle i has the gusts of a plant with seed `seed` + i.  It begins level at the
    origin, at rest, its rotors carrying the believed weight; without a ground.
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
        if not truths:
            raise InputError("batch: at least one vehicle is needed")
        model, limits = Model.from_vehicle(believed), limits or Limits()
        self._params = np.stack([parameter_row(truth, dt_us=_DT_US, ground=False) for truth in truths])
        delays = [truth.effects.get("transport_delay", {}).get("delay_s", 0.0) for truth in truths]
        self._state = state_rows(self._params, dt_us=_DT_US, max_delay_s=max(delays))
        self._state[:, S_U : S_U + 4] = self._state[:, S_COMMAND : S_COMMAND + 4] = model.hover_norm
        loop = RateControl(believed, airframe_params(believed)).row
        self._loops = np.repeat(loop[None, :], len(truths), axis=0)
        self._corrections = np.zeros((len(truths), 3))
        self._constants = controller_rows(model, gains or FeedbackGains(), limits)
        self._limits = limiter_row(model, limits)
        self._learned = Learned.nothing().row
        gusty = np.flatnonzero(self._params[:, turbulence.SIGMA] != 0.0)
        self._gusts = {int(i): Gusts(seed + int(i), self._state[i : i + 1]) for i in gusty}
        self._normals = np.zeros((len(truths), _BLOCK * _STEPS if self._gusts else 0, turbulence.NORMALS))
        self._began = False
        self.pos_ned_m = self._state[:, S_POS : S_POS + 3]
        self.vel_ned_mps = self._state[:, S_VEL : S_VEL + 3]
        self.q_ned_frd = self._state[:, S_Q : S_Q + 4]
        self.rate_frd_radps = self._state[:, S_RATE : S_RATE + 3]

    def __len__(self) -> int:
        return len(self._state)

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
        count = rows.shape[1]
        distances = np.empty((len(self), count))
        workers = min(threads or os.cpu_count() or 1, len(self))
        edges = np.linspace(0, len(self), workers + 1).astype(int).tolist()
        with ThreadPoolExecutor(workers) as pool:
            for first in range(0, count, _BLOCK):
                last = min(first + _BLOCK, count)
                self._draw((last - first) * _STEPS)
                jobs = [
                    pool.submit(self._fly, low, high, rows, first, last, distances)
                    for low, high in itertools.pairwise(edges)
                ]
                for job in jobs:
                    job.result()
                self._began = True
        return distances

    def _draw(self, steps: int) -> None:
        for i, gusts in self._gusts.items():
            drawn = 0
            while drawn < steps:
                normals = gusts.take(steps - drawn)
                self._normals[i, drawn : drawn + len(normals)] = normals[:, 0]
                drawn += len(normals)

    def _fly(self, low: int, high: int, rows: F64, first: int, last: int, distances: F64) -> None:
        block = np.empty((high - low, last - first))  # contiguous, as all that follows: one compiled version
        own = slice(low, high) if len(rows) > 1 else slice(0, 1)
        _fly_rows(
            self._constants, self._limits, self._learned, self._params[low:high], self._state[low:high],
            self._loops[low:high], self._corrections[low:high], self._normals[low:high],
            np.ascontiguousarray(rows[own, first:last]), block, 0.0 if not self._began else TICK_S,
        )  # fmt: skip
        distances[low:high, first:last] = block


@njit_free
def _fly_rows(
    constants: F64, limits: F64, learned: F64, params: F64, state: F64, loops: F64, corrections: F64, normals: F64,
    reference: F64, distances: F64, first_dt: float,
) -> None:  # fmt: skip
    """A block of ticks of each of these vehicles, one vehicle after the other; `first_dt`: since the tick before."""
    work, proposal, measured, rate = np.empty((3, EVALUATED)), np.empty(20), np.zeros(20), np.empty(3)
    for i in range(state.shape[0]):
        row, loop, p = state[i], loops[i], params[i]
        motors = motors_of(loop)
        wanted = reference[i if reference.shape[0] > 1 else 0]
        for k in range(wanted.shape[0]):
            off = 0.0
            for j in range(3):
                off += (row[S_POS + j] - wanted[k, j]) ** 2
            distances[i, k] = np.sqrt(off)
            for j in range(13):
                measured[j] = row[j]
            dt = first_dt if k == 0 else 0.004
            thrust = control_step(constants, corrections[i], dt, wanted[k], measured, learned, proposal)
            _, norm = limit_command(thrust, proposal[17:20], limits, rate)
            aim(loop, rate, norm)
            for step in range(4):
                rate_step(row[S_RATE : S_RATE + 3], loop)
                for j in range(4):
                    row[S_COMMAND + j] = motors[j]
                if normals.shape[1] > 0:
                    for j in range(5):
                        row[S_NORMALS + j] = normals[i, 4 * k + step, j]
                step_row(p, row, work)
