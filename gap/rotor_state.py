"""What remembers: rotors behind their commands, the battery behind its charge, the load behind the vehicle's motion.

These states are in no log, so the simulator's own functions run through the flight to have them at every sample.
"""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from sim.battery import discharge
from sim.effects import slung_load, transport_delay
from sim.layout import (
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
)
from sim.rigid_body import _lagged

_PINNED_KG = 1e9
"""Mass of a vehicle that no load can disturb: its motion is then whatever force per mass says."""


@njit
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
            end = _lagged(target, now, p[D_LAG_FULL])
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
def _swing_rate(heavy: F64, y: F64, acc: F64, dy: F64) -> None:
    mass = heavy[D_MASS]
    slung_load.pull(heavy, y, (mass * acc[0], mass * acc[1], mass * acc[2]), dy)


@njit
def run_load(p: F64, acc_ned: F64, row: F64, work: F64, out: F64) -> None:
    """The load's direction and its rate (N, 6) into `out` under a vehicle that moves with `acc_ned` (N, 3), m/s^2.

    A step is P_DT long, Runge-Kutta; `row`: a state row with the load as it hangs first; `work`: (4, EVALUATED).
    """
    heavy = p.copy()
    heavy[D_MASS] = _PINNED_KG
    h = p[P_DT]
    first, last = S_LOAD_DIR, S_LOAD_RATE + 3
    y, dy, mean = work[0], work[1], work[2]
    acc = work[3]
    count = out.shape[0]
    for k in range(count):
        for j in range(first, last):
            out[k, j - first] = row[j]
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
