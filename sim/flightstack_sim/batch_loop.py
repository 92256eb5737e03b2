"""The closed loop for many vehicles: controller, rate loop and plant, over blocks of LANES vehicles.

The controller is called vehicle by vehicle, once a tick; rate loop and plant go across the lanes.
"""

from __future__ import annotations

import numpy as np

from flightstack.control.attitude import PROPOSAL
from flightstack.control.feedback import control_step
from flightstack.effects.row import INTEGRATED, S_COMMAND, S_POS, S_RATE
from flightstack.jit import njit, njit_called, njit_free
from flightstack.model import limit_command
from flightstack.types import F64
from flightstack_sim.autopilot.rate_control import ROW, aim, motors_of, rate_step
from flightstack_sim.batch_step import ROW_AT, load, scratch_block, step_block, store
from flightstack_sim.lanes import LANES, across_lanes, lane

TICK_S = 0.004
STEPS = 4
"""Of the plant, in a tick."""
_GYRO = ROW * LANES
"""Where a block of rate loops, laid out by field, holds what its gyros measure."""
_MEASURED = 13


@njit
def _loops(block: F64) -> None:
    for i in range(LANES):
        rate_step(lane(block, _GYRO + i), lane(block, i))


_across = across_lanes(_loops, {})


@njit_called
def _rates(block: F64, scratch: F64) -> None:
    """A block's rate loops, from the states' rates to the states' commands."""
    for j in range(3 * LANES):
        block[_GYRO + j] = scratch[ROW_AT + S_RATE * LANES + j]
    _across(block)
    for i in range(LANES):
        motors = motors_of(lane(block, i))
        for j in range(4):
            scratch[ROW_AT + (S_COMMAND + j) * LANES + i] = motors[j]


@njit_called
def _control(
    control: tuple[F64, F64, F64], correction: F64, dt: float, wanted: F64, row: F64, loop: F64, work: F64
) -> float:
    """One vehicle's tick: its loop's new target; its distance (m) from the reference.  `work` (2 PROPOSAL + 3,)."""
    proposal, measured, rate = work[:PROPOSAL], work[PROPOSAL : 2 * PROPOSAL], work[2 * PROPOSAL :]
    constants, limits, learned = control
    off = 0.0
    for j in range(3):
        off += (row[S_POS + j] - wanted[j]) ** 2
    for j in range(_MEASURED):
        measured[j] = row[j]
    thrust = control_step(constants, correction, dt, wanted, measured, learned, proposal)
    _, norm = limit_command(thrust, proposal[17:20], limits, rate)
    aim(loop, rate, norm)
    return float(np.sqrt(off))


@njit_free
def fly_blocks(
    control: tuple[F64, F64, F64], fleet: tuple[F64, F64, F64, F64, F64], reference: F64, distances: F64,
    ticks: tuple[int, int], vehicles: tuple[int, int], first_dt: float, steps: tuple[int, int],
) -> None:  # fmt: skip
    """These ticks (first, last) of these vehicles; whole blocks of them.

    `control`: rows of controller, limiter and what is learned; `fleet`: parameters, states and normals as for
    `run_blocks`, blocks of rate loops, corrections (N, 3); `reference` (1 or N, ticks, 17); into `distances` (N,
    ticks); `first_dt`: since the tick before, s;
    `steps`: `compiled_steps`.
    """
    params, state, normals, loops, corrections = fleet
    scratch, work = scratch_block(state.shape[0]), np.zeros(2 * PROPOSAL + 3)
    last = distances.shape[0] - 1
    for at in range(vehicles[0], vehicles[1], LANES):
        load(params, state, at, scratch)
        block = loops[at // LANES]
        for k in range(ticks[0], ticks[1]):
            dt = first_dt if k == ticks[0] else TICK_S
            for i in range(LANES):
                which = min(at + i, last)
                row, loop = lane(scratch, ROW_AT + i), lane(block, i)
                wanted = reference[which if reference.shape[0] > 1 else 0, k]
                off = _control(control, corrections[at + i], dt, wanted, row[:INTEGRATED], loop, work)
                if at + i <= last:
                    distances[which, k] = off
            for step in range(STEPS):
                _rates(block, scratch)
                step_block(steps, at, normals, STEPS * (k - ticks[0]) + step, scratch)
        store(state, at, scratch)
