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
from flightstack.types import F64, I64
from flightstack_sim.autopilot.rate_control import ROW, STATE_SIZE, aim, has_lost, kind_of, motors_of, rate_step
from flightstack_sim.batch_step import (
    DRAWN,
    ROW_AT,
    draw_block,
    load,
    room_for_normals,
    scratch_block,
    step_block,
    store,
)
from flightstack_sim.lanes import LANES, across_lanes, lane, vectorised

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


@vectorised
def _mixed(mix: F64, roll: float, pitch: float, yaw: float, thrust: float, motors: F64, lost: F64) -> None:
    """`allocate` where all that is asked for can be given; where it can't, `lost` says so."""
    given = (thrust >= 0.0) & (thrust <= 1.0)
    for i in range(4):
        level = mix[4 * i] * roll + mix[4 * i + 1] * pitch + mix[4 * i + 3] * thrust
        motor = level + mix[4 * i + 2] * yaw
        motors[i] = motor
        given &= (level >= 0.0) & (level <= 1.0) & (motor >= 0.0) & (motor <= 1.0)
    lost[0] = 0.0 if given else 1.0
    lost[1] = lost[2] = 0.0


_across = across_lanes(_loops, {})
_across_usual = across_lanes(
    _loops,
    {"rate_control": {"kind_of": vectorised(lambda row: (False, True, False))}, "allocation": {"allocate": _mixed}},
)


@njit_called
def _rates(block: F64, before: F64, scratch: F64) -> None:
    """A block's rate loops, from the states' rates to the states' commands; `before` has room for their states.

    All at once and without branches as long as each is armed, under way and gets the torque that it asks for.
    """
    for j in range(3 * LANES):
        block[_GYRO + j] = scratch[ROW_AT + S_RATE * LANES + j]
    usual = True
    for i in range(LANES):
        first, armed, curved = kind_of(lane(block, i))
        usual = usual and armed and not (first or curved)
    if usual:
        for j in range(len(before)):
            before[j] = block[j]
        _across_usual(block)
        for i in range(LANES):
            usual = usual and not has_lost(lane(block, i))
        if not usual:
            for j in range(len(before)):
                block[j] = before[j]
    if not usual:
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
    control: tuple[F64, F64, F64], fleet: tuple[F64, F64, I64, F64, F64], reference: F64, distances: F64,
    vehicles: tuple[int, int], first_dt: float, steps: tuple[int, int, int],
) -> None:  # fmt: skip
    """The reference's ticks of these vehicles (first, last); whole blocks of them.

    `control`: rows of controller, limiter and what is learned; `fleet`: parameters, states and generators as for
    `run_blocks`, blocks of rate loops, corrections (N, 3); `reference` (1 or N, ticks, 17); into `distances` (N,
    ticks); `first_dt`: since the tick before, s;
    `steps`: `compiled_steps`.
    """
    params, state, generators, loops, corrections = fleet
    scratch, work = scratch_block(state.shape[0]), np.zeros(2 * PROPOSAL + 3)
    normals, ticks = room_for_normals(generators), reference.shape[1]
    before, last = np.empty(STATE_SIZE * LANES), distances.shape[0] - 1
    for at in range(vehicles[0], vehicles[1], LANES):
        load(params, state, at, scratch)
        block = loops[at // LANES]
        for k in range(ticks):
            dt, drawn = first_dt if k == 0 else TICK_S, STEPS * k % DRAWN
            if drawn == 0:
                draw_block(steps, generators[at : at + LANES], min(DRAWN, STEPS * (ticks - k)), normals)
            for i in range(LANES):
                which = min(at + i, last)
                row, loop = lane(scratch, ROW_AT + i), lane(block, i)
                wanted = reference[which if reference.shape[0] > 1 else 0, k]
                off = _control(control, corrections[at + i], dt, wanted, row[:INTEGRATED], loop, work)
                if at + i <= last:
                    distances[which, k] = off
            for step in range(STEPS):
                _rates(block, before, scratch)
                step_block(steps, normals, drawn + step, scratch)
        store(state, at, scratch)
