"""The plant's step for many vehicles: `rigid_body.step_row` over blocks of LANES vehicles, laid out by field.

A block's parameters and states, past commands included, lie together in one scratch array that stays in the
processor's first cache for all steps of a call.  There are two versions of the code: with every effect, and the rigid
body with its rotors' lag and its battery for batches in which none acts; neither asks in flight which effects there
are.  While a vehicle of a block is near the ground (a branch that its neighbours share) the whole block steps through
`step_row` itself.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numba import carray
from numpy.random import _generator

from flightstack.effects import EFFECTS, PARAMS, battery_sag, slung_load, turbulence
from flightstack.effects import row as place
from flightstack.jit import njit, njit_called, njit_free
from flightstack.types import F64, I64
from flightstack_sim import composed, rigid_body
from flightstack_sim.battery import discharge
from flightstack_sim.lanes import LANES, across_lanes, call, compiled_at, lane, vectorised
from flightstack_sim.rigid_body import step_row

# where each field begins in a block's scratch
_P, _Y = 0, PARAMS * LANES
_DY = _Y + place.EVALUATED * LANES
_MEAN = _DY + place.EVALUATED * LANES
_TARGET = _MEAN + place.EVALUATED * LANES
_SPEEDS = _TARGET + 4 * LANES  # at the step's start, middle and end
_NOW = _SPEEDS + 12 * LANES  # at this stage
_AIR = _NOW + 4 * LANES  # wind (3) and the battery's thrust factor
_FACTOR = 3
_MIDDLE, _END = 4, 8  # of a step, among the speeds
ROW_AT = _AIR + 4 * LANES  # the state's fields, the ring of past commands last
SCRATCH = ROW_AT + place.S_RING * LANES
"""What a step in the air touches; the ring follows."""
DRAWN = 64
"""Steps whose gust normals are drawn at once."""
_CLEARANCE_M = 0.1
"""More than a vehicle can accelerate towards the ground within a step of 10 ms."""


@njit
def _begin(scratch: F64) -> None:
    """What holds over the step: the motors' speeds at its start, middle and end, the air, the battery."""
    for i in range(LANES):
        p, row = lane(scratch, _P + i), lane(scratch, ROW_AT + i)
        goal, speeds, air = lane(scratch, _TARGET + i), lane(scratch, _SPEEDS + i), lane(scratch, _AIR + i)
        target = (goal[place.M1], goal[place.M2], goal[place.M3], goal[place.M4])
        lagging = p[place.D_TAU] != 0.0
        start = (
            row[place.S_U] if lagging else target[place.M1],
            row[place.S_U + 1] if lagging else target[place.M2],
            row[place.S_U + 2] if lagging else target[place.M3],
            row[place.S_U + place.M4] if lagging else target[place.M4],
        )
        end = rigid_body.lagged(target, start, p[place.D_LAG_FULL])
        speeds[place.M1], speeds[place.M2], speeds[place.M3], speeds[place.M4] = rigid_body.rotor_speeds(p, start)
        middle = rigid_body.lagged(target, start, p[place.D_LAG_HALF])
        (
            speeds[_MIDDLE + place.M1],
            speeds[_MIDDLE + place.M2],
            speeds[_MIDDLE + place.M3],
            speeds[_MIDDLE + place.M4],
        ) = rigid_body.rotor_speeds(p, middle)
        speeds[_END + place.M1], speeds[_END + place.M2], speeds[_END + place.M3], speeds[_END + place.M4] = (
            rigid_body.rotor_speeds(p, end)
        )
        row[place.S_U] = rigid_body.standing(target[place.M1], end[place.M1])
        row[place.S_U + 1] = rigid_body.standing(target[place.M2], end[place.M2])
        row[place.S_U + 2] = rigid_body.standing(target[place.M3], end[place.M3])
        row[place.S_U + place.M4] = rigid_body.standing(target[place.M4], end[place.M4])
        turbulence.advance(p, row)
        air[0], air[1], air[2] = rigid_body.air_velocity(p, row)
        air[_FACTOR] = battery_sag.factor(p, row[place.S_VOLTAGE])


@njit
def _stage(scratch: F64, reach: float, weight: float) -> None:
    """One evaluation of all lanes, `reach` (s) along the last derivative; it counts with `weight` in the mean."""
    for i in range(LANES):
        row, y = lane(scratch, ROW_AT + i), lane(scratch, _Y + i)
        dy, mean = lane(scratch, _DY + i), lane(scratch, _MEAN + i)
        u, air = lane(scratch, _NOW + i), lane(scratch, _AIR + i)
        for j in range(place.INTEGRATED):
            y[j] = row[j] + reach * dy[j]
        speeds, wind = (u[place.M1], u[place.M2], u[place.M3], u[place.M4]), (air[0], air[1], air[2])
        rigid_body.evaluate(lane(scratch, _P + i), y, speeds, wind, air[_FACTOR], dy)
        for j in range(place.E_THRUST):
            mean[j] += weight * dy[j]


@njit
def _end(scratch: F64) -> None:
    """Outputs, and what is brought in order after each step."""
    for i in range(LANES):
        p, row = lane(scratch, _P + i), lane(scratch, ROW_AT + i)
        dy, mean = lane(scratch, _DY + i), lane(scratch, _MEAN + i)
        for j in range(3):
            row[place.S_FORCE + j] = mean[place.E_FORCE + j]
            row[place.S_ANGULAR + j] = mean[place.S_RATE + j]
        for j in range(4):
            row[place.S_THRUST + j] = dy[place.E_THRUST + j]
        row[place.S_NORMAL] = mean[place.E_NORMAL]
        rigid_body.normalise(row)
        slung_load.constrain(p, row)
        discharge(p, row)


@njit
def advance_block(scratch: F64) -> None:
    """One step in free flight of a block whose targets and normals are set: the Runge-Kutta step of `rigid_body`."""
    _begin(scratch)
    h = scratch[_P + place.P_DT * LANES]
    for j in range(place.E_THRUST * LANES):
        scratch[_MEAN + j] = 0.0
    for stage in range(4):
        speeds = _SPEEDS + 4 * LANES * ((stage + 1) // 2)
        for j in range(4 * LANES):
            scratch[_NOW + j] = scratch[speeds + j]
        reach = 0.0 if stage == 0 else 0.5 * h if stage < 3 else h
        _stage(scratch, reach, 1.0 / 6.0 if stage == 0 or stage == 3 else 1.0 / 3.0)
    for j in range(place.INTEGRATED * LANES):
        scratch[ROW_AT + j] += h * scratch[_MEAN + j]
    _end(scratch)


_NOTHING = vectorised(lambda p, row: None)
_IN_THE_AIR = {"ground": {"near": vectorised(lambda p, pos_d: False)}}
_NO_EFFECT = {
    **_IN_THE_AIR,
    "turbulence": {"advance": _NOTHING, "gust": vectorised(lambda p, row: (0.0, 0.0, 0.0))},
    "composed": dict.fromkeys(composed.SUMS, vectorised(lambda start, *arguments: start)),
    "battery_sag": {"factor": vectorised(lambda p, voltage: 1.0)},
    "rotor_gyroscopic": {
        "momentum": vectorised(lambda p, rotor, speed: 0.0), "torque": vectorised(lambda spin, x, y: (0.0, 0.0)),
    },
    "slung_load": {"pull": vectorised(lambda p, y, force, dy: (0.0, 0.0, 0.0)), "constrain": _NOTHING},
}  # fmt: skip
_every_effect = across_lanes(advance_block, _IN_THE_AIR)
_no_effect = across_lanes(advance_block, _NO_EFFECT)
NAMES_IN_THE_LOOP = ("transport_delay", *(e.name for e in EFFECTS.values() if e.place not in ("parameters", "sensor")))
"""The effects that the step itself computes; the others only change the parameters that it begins with."""


def _step_with_effects(scratch: Any, same: Any, number: int) -> None:
    _every_effect(carray(scratch, (SCRATCH,)))


def _step_without(scratch: Any, same: Any, number: int) -> None:
    _no_effect(carray(scratch, (SCRATCH,)))


def _step_alone(params: Any, state: Any, fields: int) -> None:
    step_row(carray(params, (PARAMS,)), carray(state, (fields,)), np.empty((3, place.EVALUATED)))


@cache
def compiled_steps(effects: bool) -> tuple[int, int, int]:
    """Addresses of the step of a block, of the step of one vehicle's rows, and of NumPy's fill with standard normals.

    `effects`: whether any effect of NAMES_IN_THE_LOOP acts in any vehicle.  The fill (generator, count, numbers) is
    what `Generator.standard_normal` calls; NumPy's guide "Extending via CFFI" has it; 0 in a NumPy that hides it.
    """
    fill = getattr(ctypes.CDLL(_generator.__file__), "random_standard_normal_fill", None)
    normals = ctypes.cast(fill, ctypes.c_void_p).value if fill is not None else 0
    return compiled_at(_step_with_effects if effects else _step_without), compiled_at(_step_alone), normals or 0


@njit
def scratch_block(fields: int) -> F64:
    """A scratch for states of so many fields that begins where a cache line does."""
    size = ROW_AT + fields * LANES
    raw = np.zeros(size + LANES)
    begin = (-raw.ctypes.data // 8) % LANES
    return raw[begin : begin + size]


@njit
def load(params: F64, state: F64, first: int, scratch: F64) -> None:
    """Bring a block into the scratch."""
    own = params[first // LANES]
    for j in range(PARAMS * LANES):
        scratch[_P + j] = own[j]
    for j in range(state.shape[0]):
        for i in range(LANES):
            scratch[ROW_AT + j * LANES + i] = state[j, first + i]


@njit
def store(state: F64, first: int, scratch: F64) -> None:
    """Bring its states back."""
    for j in range(state.shape[0]):
        for i in range(LANES):
            state[j, first + i] = scratch[ROW_AT + j * LANES + i]


@njit
def _near_ground(scratch: F64) -> bool:
    """Whether any lane may touch the ground within the step."""
    lowest = -1.0
    for i in range(LANES):
        p, row = lane(scratch, _P + i), lane(scratch, ROW_AT + i)
        reach = row[place.S_POS + 2] + p[place.D_GROUND_LEVEL] + p[place.D_GROUND_REACH] + _CLEARANCE_M
        lowest = max(lowest, reach + abs(row[place.S_VEL + 2]) * p[place.P_DT] if p[place.P_GROUND] != 0.0 else -1.0)
    return lowest > 0.0


@njit_called
def _each_alone(step: int, scratch: F64) -> None:
    """`step_row`, at this address, of each vehicle of a block; commands and normals are in its state."""
    fields = (scratch.shape[0] - ROW_AT) // LANES
    p, row = np.empty(PARAMS), np.empty(fields)
    for i in range(LANES):
        for j in range(PARAMS):
            p[j] = scratch[_P + j * LANES + i]
        for j in range(fields):
            row[j] = scratch[ROW_AT + j * LANES + i]
        call(step, p, row, fields)
        for j in range(fields):
            scratch[ROW_AT + j * LANES + i] = row[j]


@njit_called
def _delay(scratch: F64) -> None:
    """New commands into the ring and the targets that act now: `transport_delay` for all lanes, whose cursor is one."""
    entries = (scratch.shape[0] - SCRATCH) // (4 * LANES)
    cursor = int(scratch[ROW_AT + place.S_CURSOR * LANES]) + 1
    if cursor >= entries:
        cursor = 0
    at, ring = SCRATCH + 4 * LANES * cursor, scratch[SCRATCH:]
    for i in range(LANES):
        scratch[ROW_AT + place.S_CURSOR * LANES + i] = cursor
    for j in range(4 * LANES):
        command = min(max(scratch[ROW_AT + place.S_COMMAND * LANES + j], 0.0), 1.0)
        command = command if command == command else 0.0
        scratch[ROW_AT + place.S_COMMAND * LANES + j] = scratch[at + j] = scratch[_TARGET + j] = command
    for i in range(LANES):
        steps = scratch[_P + place.D_DELAY_STEPS * LANES + i]
        if steps == 0.0:
            continue
        whole = int(steps)
        fraction = steps - whole
        newer = cursor - whole + (entries if cursor < whole else 0)
        older = newer - 1 if newer > 0 else entries - 1
        for j in range(4):
            new, old = ring[(4 * newer + j) * LANES + i], ring[(4 * older + j) * LANES + i]
            scratch[_TARGET + j * LANES + i] = (1.0 - fraction) * new + fraction * old


@njit
def room_for_normals(generators: I64) -> F64:
    """(LANES, DRAWN, 5) numbers for `draw_block`; none where no gusts blow in any vehicle."""
    return np.zeros((LANES if generators.any() else 0, DRAWN, turbulence.NORMALS))


@njit_called
def draw_block(steps: tuple[int, int, int], generators: I64, count: int, normals: F64) -> None:
    """The next `count` steps' normals of a block's vehicles into `normals`.

    `generators` (LANES,): addresses of NumPy's bit generators, 0 where no gusts blow.
    """
    for i in range(normals.shape[0]):
        if generators[i] != 0:
            call(steps[2], generators[i], count * turbulence.NORMALS, normals[i])


@njit_called
def step_block(steps: tuple[int, int, int], normals: F64, k: int, scratch: F64) -> None:
    """One step of a loaded block with the commands in its state and the k-th of the drawn `normals`."""
    for i in range(normals.shape[0]):
        for j in range(turbulence.NORMALS):
            scratch[ROW_AT + (place.S_NORMALS + j) * LANES + i] = normals[i, k, j]
    if _near_ground(scratch):
        _each_alone(steps[1], scratch)
        return
    _delay(scratch)
    call(steps[0], scratch, scratch, 0)


@njit_free
def run_blocks(
    steps: tuple[int, int, int], params: F64, state: F64, generators: I64, count: int, first: int, last: int
) -> None:
    """`count` steps of the blocks from vehicle `first` to `last`, commands held.

    `steps`: `compiled_steps`; params (N / LANES, PARAMS * LANES), state (S_RING + ring, N); generators (N,), as for
    `draw_block`.
    """
    scratch, normals = scratch_block(state.shape[0]), room_for_normals(generators)
    for at in range(first, last, LANES):
        load(params, state, at, scratch)
        for k in range(count):
            if k % DRAWN == 0:
                draw_block(steps, generators[at : at + LANES], min(DRAWN, count - k), normals)
            step_block(steps, normals, k % DRAWN, scratch)
        store(state, at, scratch)
