"""The simulator's forces and torques at measured states, of many vehicles at once; and many short simulations.

Compiled loops round the plant's own functions, their rows shared out to the cores: no row knows of another.
"""

from __future__ import annotations

import numpy as np

from flightstack.effects import battery_sag
from flightstack.effects.row import (
    E_FORCE,
    EVALUATED,
    INTEGRATED,
    P_EMPTY_V,
    P_FULL_V,
    S_COMMAND,
    S_FORCE,
    S_LOAD_DIR,
    S_RATE,
    S_RING,
    S_U,
    S_VOLTAGE,
)
from flightstack.gap.cores import share
from flightstack.jit import njit_free
from flightstack.types import F64, I64
from flightstack_sim.rigid_body import air_velocity, evaluate, rotor_speeds, step_row

_LEAST_STATES, _LEAST_WINDOWS = 500, 8
"""That are worth a thread: to hand a part over takes some 50 us, to evaluate a state 0.2, to simulate a window 100."""


def evaluate_at(params: F64, states: F64, u: F64, voltage: F64, out: F64) -> None:
    """Specific force and angular acceleration (N, 6, M) into `out`, of M parameter rows at the same N states.

    states (N, S_U) as the state row begins: position, velocity, attitude, rate, load; motors' u (N, 4), voltage (N,).
    """
    share(lambda part: states_loop(params, states[part], u[part], voltage[part], out[part]), len(out), _LEAST_STATES)


@njit_free
def states_loop(params: F64, states: F64, u: F64, voltage: F64, out: F64) -> None:
    """`evaluate_at` of these rows."""
    row = np.zeros(S_RING)
    dy = np.empty(EVALUATED)
    for n in range(out.shape[0]):
        for j in range(S_U):
            row[j] = states[n, j]
        now = (u[n, 0], u[n, 1], u[n, 2], u[n, 3])
        for m in range(out.shape[2]):
            p = params[m]
            speeds, wind = rotor_speeds(p, now), air_velocity(p, row)
            evaluate(p, row[:INTEGRATED], speeds, wind, battery_sag.factor(p, voltage[n]), dy)
            for j in range(3):
                out[n, j, m] = dy[E_FORCE + j]
                out[n, 3 + j, m] = dy[S_RATE + j]


def run_windows(
    state: F64, params: F64, start: I64, driven: I64, commands: F64, voltage: F64, shown: F64, force: F64
) -> None:
    """Simulate R rows freely from their states: what they show (R, n + 1, S_LOAD_DIR) and mean specific forces.

    Row i starts at sample start[i] and is driven by commands[driven[i]] (N, or a multiple of N, 4) and
    voltage[driven[i]] (N,); force (R, n + 1, 3) is the mean since the sample before, 0 at the start.
    """

    def work(part: slice) -> None:
        own = state[part], params[part], start[part], driven[part]
        windows_loop(*own, commands, voltage, shown[part], force[part])

    share(work, state.shape[0], _LEAST_WINDOWS)


@njit_free
def windows_loop(
    state: F64, params: F64, start: I64, driven: I64, commands: F64, voltage: F64, shown: F64, force: F64
) -> None:
    """`run_windows` of these rows."""
    every = commands.shape[1] // voltage.shape[1]
    work = np.empty((3, EVALUATED))
    for i in range(state.shape[0]):
        row, p, c = state[i], params[i], driven[i]
        for j in range(S_LOAD_DIR):
            shown[i, 0, j] = row[j]
        for k in range(shown.shape[1] - 1):
            at = start[i] + k
            row[S_VOLTAGE] = p[P_FULL_V] = p[P_EMPTY_V] = voltage[c, at]
            for step in range(at * every, (at + 1) * every):
                for j in range(4):
                    row[S_COMMAND + j] = commands[c, step, j]
                step_row(p, row, work)
                for j in range(3):
                    force[i, k + 1, j] += row[S_FORCE + j] / every
            for j in range(S_LOAD_DIR):
                shown[i, k + 1, j] = row[j]
