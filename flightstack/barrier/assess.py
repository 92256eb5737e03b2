"""One tick of the safety filter, compiled: predict, ask every barrier, set up the QP, turn its answer into a command.

A certificate is packed into one row of numbers (`packed`), all that changes in flight into one memory (`new_memory`).
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.barrier.condition import Reach, coefficients, interval, margin_at
from flightstack.barrier.packed import (
    DT_RANGE_S,
    P_BOUNDS,
    P_CENTRE,
    P_CERTIFIED,
    P_CHAIN,
    P_LEANS,
    P_RATES,
    P_RESPONSE,
    P_TURNING,
    pieces_of,
    setting_of,
    table_of,
)  # fmt: skip
from flightstack.barrier.records import N_ERROR_HIGH, N_ERROR_LOW, N_HIGH, N_LOW
from flightstack.barrier.response import (
    C_HOLD,
    C_LEAD_THRUST,
    C_NORM_LOW,
    C_RATE_DELAY,
    C_STEER,
    C_THRUST_DELAY,
    M_GOOD_SINCE,
    M_MODE,
    M_STEP_US,
    S_ROTORS,
    STATE,
    acceleration,
    ahead,
    command_for,
    follow_rotors,
    lead,
    remember,
    thrust_of,
)
from flightstack.barrier.shapes import piece_at
from flightstack.barrier.turning import Turn, paced, stays_within, straight
from flightstack.frames import quat_to_matrix
from flightstack.jit import njit
from flightstack.rows import F_H, F_H_STATE, F_INTERVENED, F_MARGIN, F_THRUST, F_WANTED, RATE_X, RATE_Y, VEL_D
from flightstack.types import F64

ENGAGE_H = 0.05
ENGAGE_US = 500_000.0
UNCERTIFIED, WAITING, PASSED, CHANGED, INFEASIBLE, UNSOLVED, FALSIFIED = range(7)
"""Values of `Filtered.status`."""
ENGAGED, DOUBTFUL = 1.0, 2.0
"""Modes in memory: engaged, engaged with a certificate for another region come in; 0 not engaged."""
ROWS = 7
"""Of the QP: three intervals, two pairs of sides that bound the lean, roll and pitch rate."""
WORK = 2 * STATE + 4
_GAIN = 3
"""Numbers between the two halves of a tick: the state when thrust and when rates begin to act, acceleration without
thrust (3), gain."""


@njit
def finite(values: F64) -> bool:
    """Whether all are numbers."""
    for value in values:  # noqa: SIM110  compiled: no generators
        if not math.isfinite(value):
            return False
    return True


@njit
def _turn(flat: F64, state: F64, offset: F64, axis: int) -> Turn:
    """One lateral axis' lean at the predicted state."""
    chain, r = flat[P_CHAIN:P_BOUNDS], quat_to_matrix(state[6:10])
    force = offset[_GAIN] * chain[C_LEAD_THRUST]
    rate = -(state[RATE_Y] * r[axis, 0] - state[RATE_X] * r[axis, 1])
    still = offset[axis] - offset[_GAIN] * thrust_of(chain, state[S_ROTORS]) * r[axis, 2]
    return Turn(still, rate, force, chain[C_STEER], flat[P_TURNING], flat[P_TURNING + 1])


@njit
def _below(table: F64, v: float) -> int:
    """Index of the node below v, or of the last that has one above it."""
    i = 0
    while i < table.shape[1] - 2 and table[0, i + 1] < v:
        i += 1
    return i


@njit
def column_at(table: F64, column: int, v: float) -> float:
    """A column at a speed: linear between nodes, constant beyond them."""
    if table.shape[1] < 2:
        return table[column, 0]  # type: ignore[no-any-return]
    i = _below(table, v)
    share = min(max((v - table[0, i]) / (table[0, i + 1] - table[0, i]), 0.0), 1.0)
    return table[column, i] + share * (table[column, i + 1] - table[column, i])  # type: ignore[no-any-return]


@njit
def _reach(table: F64, v: float) -> Reach:
    """`Authority.reach`."""
    i = _below(table, v)
    return Reach(table[N_LOW, i], table[N_HIGH, i], table[N_ERROR_LOW, i], table[N_ERROR_HIGH, i])


@njit
def assess(
    memory: F64, flat: F64, measured: F64, times_us: tuple[float, float, float], origin: F64,
    commands: tuple[float, F64, float, F64], problem: tuple[F64, F64, F64, F64], out: F64,
) -> int:  # fmt: skip
    """The first half of a tick: the status so far.  CHANGED: the QP is to be solved; INFEASIBLE: it can't be.

    times_us: of the last command sent, the measurement, and now; `measured` (20,): a Measurement's row; commands:
    normalised thrust and rates of the last and of the wanted one.  Into `problem`, work (WORK,), rows (ROWS, 3), low
    and high (ROWS,), and `out`, a Filtered's row, in which the wanted thrust is there already.
    """
    sent_us, measured_us, now_us = times_us
    sent_norm, sent_rate, norm, rate = commands
    work, rows, low, high = problem
    remember(memory, sent_us, sent_norm, sent_rate)
    step_s = (now_us - memory[0, M_STEP_US]) * 1e-6
    memory[0, M_STEP_US] = now_us
    if not (finite(measured[:13]) and math.isfinite(norm + out[F_THRUST]) and finite(rate)):
        return UNSOLVED if memory[0, M_MODE] > 0.0 else WAITING
    chain, predicted, offset = flat[P_CHAIN:P_BOUNDS], work[: 2 * STATE].reshape(2, STATE), work[2 * STATE :]
    chain[C_HOLD] = min(max(step_s, DT_RANGE_S[0]), DT_RANGE_S[1]) if step_s < np.inf else DT_RANGE_S[0]
    for i in range(3):
        offset[i] = column_at(table_of(flat, i), 1, measured[3 + i])
    offset[_GAIN] = column_at(table_of(flat, 2), 2, measured[VEL_D])
    follow_rotors(memory, chain, measured_us)
    thrust_us, rate_us = now_us + chain[C_THRUST_DELAY], now_us + chain[C_RATE_DELAY]
    ahead(memory, chain, measured, measured_us, thrust_us, offset, offset[_GAIN], predicted[0])
    if rate_us == thrust_us:
        for i in range(STATE):
            predicted[1, i] = predicted[0, i]
    else:
        ahead(memory, chain, measured, measured_us, rate_us, offset, offset[_GAIN], predicted[1])
    feasible = _barriers(flat, predicted, measured, origin, offset, low, high, out)
    if not (finite(out[:2]) and finite(out[23:29])):
        return UNSOLVED if memory[0, M_MODE] > 0.0 else WAITING
    _accelerations(chain, predicted, offset, norm, rate, out[8:11])
    for i in range(3):
        out[11 + i] = out[8 + i]
    out[F_MARGIN] = _least_margin(flat, out)
    lean, leans = predicted[1, 6:], flat[P_LEANS : P_LEANS + 4]
    kept = stays_within(lean[:4], lean[4:7], leans, flat[P_TURNING], flat[P_TURNING + 1])
    if not _engaged(memory, min(out[F_H], out[F_H_STATE]), kept, now_us):
        if memory[0, M_GOOD_SINCE] < np.inf:
            _keep_lean(flat, predicted, offset, rate, rows, low, high, out)
        return WAITING
    _limit_rows(flat, predicted, offset, rate, rows, low, high, out[8:11])
    if not feasible or low[2] > high[2]:
        return INFEASIBLE
    for i in range(ROWS):
        z = rows[i, 0] * out[F_WANTED] + rows[i, 1] * out[F_WANTED + 1] + rows[i, 2] * out[F_WANTED + 2]
        if not low[i] - 1e-9 <= z <= high[i] + 1e-9:
            return CHANGED
    return PASSED


@njit
def _engaged(memory: F64, h: float, kept: bool, now_us: float) -> bool:
    """Whether the filter is engaged after this tick's h: once it has been at least ENGAGE_H for ENGAGE_US, with a lean
    that can be `kept` at the first and the last of these ticks; in between it is (`_keep_lean`)."""
    if memory[0, M_MODE] == DOUBTFUL:
        memory[0, M_MODE] = ENGAGED if h >= 0.0 else 0.0
    if not h >= ENGAGE_H:
        memory[0, M_GOOD_SINCE] = np.inf
    elif memory[0, M_GOOD_SINCE] == np.inf and kept:
        memory[0, M_GOOD_SINCE] = now_us
    if now_us - memory[0, M_GOOD_SINCE] >= ENGAGE_US and kept:
        memory[0, M_MODE] = ENGAGED
    return memory[0, M_MODE] > 0.0  # type: ignore[no-any-return]


@njit
def _keep_lean(
    flat: F64, predicted: F64, offset: F64, rate: F64, rows: F64, low: F64, high: F64, out: F64
) -> None:  # fmt: skip
    """Into out[11:14] the wanted accelerations, moved to where the lean keeps within the certificate's: before the
    filter engages nothing else is limited."""
    _limit_rows(flat, predicted, offset, rate, rows, low, high, out[8:11])
    for k in range(2):
        out[11 + k] = min(max(out[8 + k], low[3 + k]), high[3 + k])
        if abs(out[11 + k] - out[8 + k]) > 1e-6:
            out[F_INTERVENED] = 1.0


@njit
def _barriers(
    flat: F64, predicted: F64, measured: F64, origin: F64, offset: F64, low: F64, high: F64, out: F64
) -> bool:
    """Each axis' barrier at the predicted and the measured state and the accelerations that it allows; whether every
    axis has one.  `offset` becomes that at the predicted speeds."""
    feasible = True
    out[F_H] = out[F_H_STATE] = np.inf
    response, chain = flat[P_RESPONSE:P_CHAIN].reshape(3, 3), flat[P_CHAIN:P_BOUNDS]
    for i in range(3):
        low[i], high[i] = -np.inf, np.inf
        p, v = lead(chain, predicted[0 if i == 2 else 1], response, i, offset[i], offset[_GAIN])
        centre = origin[i] + flat[P_CENTRE + i]
        e, seen = p - centre, measured[i] - centre
        out[23 + i], out[26 + i] = e, v
        if flat[P_CERTIFIED + i] == 0.0:
            continue
        table, pieces = table_of(flat, i), pieces_of(flat, i)
        offset[i] = column_at(table, 1, v)
        if i == 2:
            offset[_GAIN] = column_at(table, 2, v)
        reach, setting = _reach(table, v), setting_of(flat, i)
        for piece in pieces:
            out[F_H] = min(out[F_H], piece_at(piece, e, v)[0] - setting.inner)
            out[F_H_STATE] = min(out[F_H_STATE], piece_at(piece, seen, measured[3 + i])[0])
        if i < 2 and flat[P_TURNING] > 0.0:
            low[i], high[i], margin = paced(pieces, e, v, setting, reach, _turn(flat, predicted[1], offset, i))
        else:
            low[i], high[i], margin = interval(pieces, e, v, setting, reach)
        out[14 + i], out[17 + i], out[20 + i] = low[i], high[i], margin
        out[29 + i] = max(reach.error_low, reach.error_high)
        feasible = feasible and margin >= 0.0
    return feasible


@njit
def _apart(predicted: F64) -> bool:
    """Whether thrust and rates begin to act at different times."""
    for i in range(STATE):  # noqa: SIM110  compiled: no generators
        if predicted[0, i] != predicted[1, i]:
            return True
    return False


@njit
def _accelerations(chain: F64, predicted: F64, offset: F64, norm: float, rate: F64, u: F64) -> None:
    """A command's accelerations: down from the state when thrust begins to act, sideways from that of the rates."""
    acceleration(chain, predicted[0], offset, offset[_GAIN], norm, rate, u)
    if _apart(predicted):
        down = u[2]
        acceleration(chain, predicted[1], offset, offset[_GAIN], norm, rate, u)
        u[2] = down


@njit
def _limit_rows(
    flat: F64, predicted: F64, offset: F64, rate: F64, rows: F64, low: F64, high: F64, wanted: F64
) -> None:  # fmt: skip
    """All rows of the QP in u; the first three bounds hold the barriers' intervals already.

    Thrust bounds the vertical interval, exactly: it acts along the predicted axis.  The budget's gives way to what the
    barrier needs, a little more while the lean turns; the vehicle's own does not.  The lean n that is steered to, and
    the one that comes of how fast it turns, keep within the certificate's.  Sideways the barriers' intervals reach to
    these bounds: a barrier that wants all at once gets what can be turned back in time.  A lean that turns too fast to
    be stopped runs beyond the certificate, and is late for the next wall.
    """
    chain, gain = flat[P_CHAIN:P_BOUNDS], offset[_GAIN]
    ends, still, edge, asked = np.empty(3), np.zeros(3), np.empty(2), np.empty(2)
    for i in range(ROWS):
        rows[i, 0] = rows[i, 1] = rows[i, 2] = 0.0
    rows[0, 0] = rows[1, 1] = rows[2, 2] = 1.0
    for k in range(2):
        acceleration(chain, predicted[0], offset, gain, chain[C_NORM_LOW + k], still, ends)
        edge[k] = ends[2]
        acceleration(chain, predicted[0], offset, gain, flat[P_BOUNDS + k], still, ends)
        asked[k] = ends[2]
    wide = low[2], high[2]
    low[2] = max(wide[0], edge[1], min(asked[1], wide[1]))
    high[2] = min(wide[1], edge[0], max(asked[0], wide[0]))
    r = quat_to_matrix(predicted[1, 6:10])
    force = gain * chain[C_LEAD_THRUST]
    for k in range(2):
        rows[3 + k, k] = 1.0
        still_u = wanted[k] + force * chain[C_STEER] * (rate[1] * r[k, 0] - rate[0] * r[k, 1])
        upright = still_u + force * r[k, 2]  # u whose n is upright
        least, most = flat[P_LEANS + 2 * k], flat[P_LEANS + 2 * k + 1]
        low[3 + k] = upright - force * _steered(flat, r[k, 2], least, most)
        high[3 + k] = upright + force * _steered(flat, -r[k, 2], -most, -least)
        low[k], high[k] = min(low[k], high[3 + k]), max(high[k], low[3 + k])
    turn = force * chain[C_STEER] * max(r[2, 2], 0.1)
    for k in range(2):  # roll and pitch rate as `command_for` has them
        size = max(math.sqrt(r[1, k] * r[1, k] + r[0, k] * r[0, k]), 1e-9)
        rows[5 + k, 0], rows[5 + k, 1] = -r[1, k] / size, r[0, k] / size
        at = rows[5 + k, 0] * wanted[0] + rows[5 + k, 1] * wanted[1]
        low[5 + k] = at - turn / size * (flat[P_RATES + k] + rate[k])
        high[5 + k] = at + turn / size * (flat[P_RATES + k] - rate[k])


@njit
def _steered(flat: F64, lean: float, least: float, most: float) -> float:
    """The greatest lean to one side that may be steered to from this one: turned back as the governor does (`turning`),
    it comes to rest within the certificate's, least to most."""
    turn, wait = flat[P_TURNING], flat[P_TURNING + 1]
    room = max(most - lean, 0.0)
    if turn <= 0.0:
        return most
    rate = math.sqrt(turn * turn * wait * wait + 2.0 * turn * room) - turn * wait
    return max(min(most, lean + flat[P_CHAIN + C_STEER] * rate), least)  # type: ignore[no-any-return]


@njit
def _least_margin(flat: F64, out: F64) -> float:
    """Least q of all pieces at the accelerations out[11:14], 1/s."""
    least = np.inf
    for i in range(3):
        if flat[P_CERTIFIED + i] == 0.0:
            continue
        reach = _reach(table_of(flat, i), out[26 + i])
        for piece in pieces_of(flat, i):
            setting, u = setting_of(flat, i), out[11 + i]
            q = margin_at(coefficients(piece, out[23 + i], out[26 + i], setting, reach), u)
            if i < 2 and flat[P_TURNING] > 0.0:
                q = max(q, margin_at(coefficients(piece, out[23 + i], out[26 + i], straight(setting), reach), u))
            least = min(least, q)
    return least


@njit
def fallback(out: F64, u: F64) -> None:
    """Into u (3,): per axis the wanted acceleration, moved into what the barrier allows; where that is nothing, the
    best command of its worst piece, a saturated brake."""
    for i in range(3):
        u[i] = out[8 + i]
        if out[14 + i] <= out[17 + i]:  # NaN where nothing is certified
            u[i] = min(max(u[i], out[14 + i]), out[17 + i])


@njit
def steer(flat: F64, work: F64, u: F64, rate: F64) -> float:
    """The command for u (3,): normalised thrust; roll and pitch rates into `rate` (3,), whose yaw rate stays."""
    chain, predicted, offset = flat[P_CHAIN:P_BOUNDS], work[: 2 * STATE].reshape(2, STATE), work[2 * STATE :]
    norm = command_for(chain, predicted[0], offset, offset[_GAIN], u, rate)
    if _apart(predicted):
        command_for(chain, predicted[1], offset, offset[_GAIN], u, rate)
    return norm


@njit
def settle(flat: F64, work: F64, norm: float, rate: F64, out: F64) -> None:
    """What the command really does, into the row: accelerations and the least margin."""
    chain, predicted, offset = flat[P_CHAIN:P_BOUNDS], work[: 2 * STATE].reshape(2, STATE), work[2 * STATE :]
    _accelerations(chain, predicted, offset, norm, rate, out[11:14])
    out[F_MARGIN] = _least_margin(flat, out)
