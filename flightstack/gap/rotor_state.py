"""What remembers: rotors behind their commands, the battery behind its charge, the load behind the vehicle's motion.

These states are in no log, so the simulator's own functions run through the flight to have them at every sample.
"""

from __future__ import annotations

import math

from flightstack.effects import slung_load, transport_delay
from flightstack.effects.row import (
    D_LAG_FULL,
    D_MASS,
    EVALUATED,
    P_DT,
    S_COMMAND,
    S_LOAD_DIR,
    S_LOAD_RATE,
    S_THRUST,
    S_U,
    S_VOLTAGE,
    Vec,
)
from flightstack.jit import njit, njit_free
from flightstack.types import F64
from flightstack_sim.battery import discharge
from flightstack_sim.rigid_body import lagged

_PINNED_KG = 1e9
"""Mass of a vehicle that no load can disturb: its motion is then whatever force per mass says."""
HOLD_S = 1.0
"""Within which a load is brought back to what is felt of it: slow against its swing, quick against losing its phase."""
SOON_S = 0.2
UNSURE_MPS2 = 0.3
"""Of the vehicle: how much of what is felt may be anything else."""


@njit_free
def run_rotors(p: F64, commands: F64, every: int, row: F64, out: F64) -> None:
    """Motors' u (N, 4) into `out`, at the samples; `commands` (N * every, 4), one for each step of the row's P_DT.

    `row`: a state row whose ring and u say what was before the first sample.
    """
    for k in range(out.shape[0]):
        for i in range(4):
            out[k, i] = row[S_U + i]
        for j in range(every):
            for i in range(4):
                row[S_COMMAND + i] = commands[k * every + j, i]
            transport_delay.push(row)
            target = (
                transport_delay.delayed(p, row, 0),
                transport_delay.delayed(p, row, 1),
                transport_delay.delayed(p, row, 2),
                transport_delay.delayed(p, row, 3),
            )
            now = (row[S_U], row[S_U + 1], row[S_U + 2], row[S_U + 3])
            end = lagged(target, now, p[D_LAG_FULL])
            for i in range(4):
                row[S_U + i] = end[i]


@njit
def run_battery(p: F64, thrust: F64, row: F64, out: F64) -> None:
    """Terminal voltage (N,) into `out`, for rotors that give `thrust` (N, 4) newton; a step is P_DT long."""
    for k in range(out.shape[0]):
        out[k] = row[S_VOLTAGE]
        for i in range(4):
            row[S_THRUST + i] = thrust[k, i]
        discharge(p, row)


@njit
def _swing_rate(heavy: F64, y: F64, acc: F64, dy: F64) -> Vec:
    mass = heavy[D_MASS]
    return slung_load.pull(heavy, y, (mass * acc[0], mass * acc[1], mass * acc[2]), dy)


@njit
def _corrected(p: F64, row: F64, pulled: Vec, seen: F64, turn: float, speed: float) -> None:
    """The load's direction and rate turned towards what the vehicle felt of it (`seen`, N, NED): two gains."""
    nx, ny, nz = row[S_LOAD_DIR], row[S_LOAD_DIR + 1], row[S_LOAD_DIR + 2]
    tension = pulled[0] * nx + pulled[1] * ny + pulled[2] * nz
    off_x, off_y, off_z = seen[0] - pulled[0], seen[1] - pulled[1], seen[2] - pulled[2]
    along = off_x * nx + off_y * ny + off_z * nz
    unsure = UNSURE_MPS2 * p[D_MASS]
    share = tension / (tension * tension + unsure * unsure)
    for j, off in enumerate((off_x - along * nx, off_y - along * ny, off_z - along * nz)):
        row[S_LOAD_DIR + j] += turn * share * off
        row[S_LOAD_RATE + j] += speed * share * off
    slung_load.constrain(p, row)


_ACC = 3


@njit_free
def run_load(p: F64, acc_ned: F64, seen: F64, adrift: bool, row: F64, work: F64, out: F64) -> None:
    """The load's direction and its rate (N, 6) into `out` under a vehicle that moves with `acc_ned` (N, 3), m/s^2.

    A step is P_DT long, Runge-Kutta; `row`: a state row with the load as it hangs first; `work`: (4, EVALUATED).
    `seen`: (N, 3) what the vehicle felt of it (N, NED), NaN where that is not known.  A load that swings far forgets
    where it began within seconds, so it is held near what is felt, and the sooner if nobody knows how it hung first
    (`adrift`).
    """
    heavy = p.copy()
    heavy[D_MASS] = _PINNED_KG
    h = p[P_DT]
    first, last = S_LOAD_DIR, S_LOAD_RATE + 3
    y, dy, mean = work[0], work[1], work[2]
    acc = work[_ACC]
    count = out.shape[0]
    for k in range(count):
        for j in range(first, last):
            out[k, j - first] = row[j]
        if not math.isnan(seen[k, 0]):
            for i in range(3):
                acc[i] = acc_ned[k, i]
            for j in range(first, last):
                y[j] = row[j]
            soon = 1.0 / (k * h + SOON_S) if adrift else 0.0
            pulled = _swing_rate(heavy, y, acc, dy)
            _corrected(p, row, pulled, seen[k], h * (1.0 / HOLD_S + 4.0 * soon), h * 6.0 * soon * soon)
        for j in range(first, last):
            y[j] = row[j]
            mean[j] = 0.0
        for stage in range(4):
            share = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            weight = 1.0 / 6.0 if stage in (0, 3) else 1.0 / 3.0
            after = min(k + 1, count - 1)
            for i in range(3):
                acc[i] = (1.0 - share) * acc_ned[k, i] + share * acc_ned[after, i]
            if stage > 0:
                for j in range(first, last):
                    y[j] = row[j] + share * h * dy[j]
            _swing_rate(heavy, y, acc, dy)
            for j in range(first, last):
                mean[j] += weight * dy[j]
        for j in range(first, last):
            row[j] += h * mean[j]
        slung_load.constrain(p, row)


def load_work() -> int:
    """Length of a row of `run_load`'s work."""
    return EVALUATED
