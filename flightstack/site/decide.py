"""One tick of the site filter, compiled: is the way out still clear after this command, and if not, which one is sent.

Numbers that last from tick to tick lie in one array (`MEMORY`), all of the vehicle in another (`pack`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.barrier.response import (
    C_CURVE,
    C_HOLD,
    C_NORM_HIGH,
    C_NORM_LOW,
    C_RATE_DELAY,
    C_SPECIFIC,
    CHAIN,
    M_ROTORS,
    STATE,
    acceleration,
    command_for,
    follow_rotors,
    lead,
    remember,
    thrust_of,
)
from flightstack.frames import quat_to_matrix, rotate
from flightstack.jit import njit, njit_called
from flightstack.lift_off import GENTLE_RADPS
from flightstack.model import thrust_to_norm
from flightstack.rows import FORCE_Z, RATE_X, RATE_Y
from flightstack.site import slide
from flightstack.site.backup import (
    JERK,
    LEAD_S,
    ROW,
    SNAP,
    STEP_S,
    STEPS,
    UPRIGHT,
    apart,
    at_time,
    follow,
    point_of,
    roll,
    widest,
)
from flightstack.site.clearance import CHUTE, FLOOR, GROUND, OPEN, TILT_CODE, clear_of
from flightstack.site.tube import OBSERVER_S
from flightstack.site.turning import ahead, seen, turn_on
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

(
    COMMITTED, SINCE_US, COUNT, GAIN, READ_S, LAST_US, EDGE, CLEARANCE, OFF, KEPT, SHARE, HOLD_S, FORCE,
) = range(13)  # fmt: skip
SENT, LEFT, BEYOND_S, SPIN, SURE, MEMORY = FORCE + 3, FORCE + 6, FORCE + 7, FORCE + 8, FORCE + 10, FORCE + 11
"""1 where a way out is committed; when it begins, its number of points; the gain and for how long it was read; time of
the last tick; what was nearest to being forbidden, how clear the way is; how far the vehicle is from the way that it
follows; 1 where it follows it; share of the wanted command that was let through; the hold; the force that
the accelerometer shows (3, NED, m/s^2); body rates sent last (3); 1 once the chute of take-off was left; for how long
the force has been more than the certificate says (s; BROKEN_S: once and for all); what roll and pitch rate change by
(2, 1/s^2); 1 where the way that is committed was clear."""
WAITING, PASSED, CHANGED = 1, 2, 3
_READ_AFTER_S, _READ_TIME_S = 0.5, 0.5
_AIRBORNE_M = 0.1
_LEAST_THRUST = 0.35
_STANDS_UPRIGHT, _LEVEL_PS = 0.98, 6.5
_DOWN_SHARE = 0.5
"""Of the weight, at rest: what is left of it puts all legs down and holds them there against 0.15 g."""
BROKEN_S = 0.1
_SHARES = (0.75, 0.5, 0.25, 0.125)
_NEAR_M = 100.0
_FORCE_MOST_MPS2 = 4.0
_TILT_AHEAD_S = 0.12
_ABOVE_M = 0.25
_FREE = -9
_DRAG, _OPEN_SHARE, _GAINS, _ROTORS_S = CHAIN + 12, CHAIN + 13, CHAIN + 14, CHAIN + 17
"""Places of a packed vehicle, after chain, response (3, 3) and rate limits (3): drag (1/s), how uncertain the gain is,
its range and the step of the rows, `turning.Turning.rotors_s`."""


class Known(NamedTuple):
    """What a certificate says of the vehicle; rows and soft by least gain (`Stopping`)."""

    vehicle: F64
    rows: F64
    soft: F64
    halves: F64


class Kept(NamedTuple):
    """What lasts from tick to tick."""

    memory: F64
    numbers: F64
    """MEMORY."""
    committed: F64


class Commands(NamedTuple):
    """The last one sent and the one that is wanted."""

    sent_norm: float
    sent_rate: F64
    wanted_norm: float
    wanted_rate: F64


class Buffers(NamedTuple):
    """Of one tick; `out`: a Filtered's row."""

    scratch: F64
    way: F64
    out: F64
    rate: F64


class Now(NamedTuple):
    """The vehicle when the command begins to act."""

    chain: F64
    state: F64
    spin: F64
    rotors_s: float
    offset: F64
    origin: F64
    numbers: F64


class Keeping(NamedTuple):
    """What is kept to: a row of the certificate, half heights of its tube, the site."""

    row: F64
    half: F64
    site: F64


@njit_called
def is_airborne(height: float, force_mps2: float) -> bool:
    """Whether thrust (m/s^2) at a height above the place of arming says that the vehicle flies."""
    return abs(height) >= _AIRBORNE_M and force_mps2 >= _LEAST_THRUST * STANDARD_GRAVITY_MPS2


@njit
def _observe(
    n: F64, chain: F64, measured: F64, rotors: float, dt: float, height: float, bounds: F64, drag: float
) -> None:
    """The thrust gain and the force, off the accelerometer, while the vehicle flies."""
    force = thrust_of(chain, rotors)
    if not is_airborne(height, force):
        for i in range(3):
            n[FORCE + i] = 0.0
        return
    n[READ_S] += dt
    share = min(max(dt / min(_READ_TIME_S, n[READ_S]), 0.0), 1.0)
    n[GAIN] += share * (min(max(-measured[FORCE_Z] / force, bounds[0]), bounds[1]) - n[GAIN])
    shown, r = rotate(measured[6:10], measured[13:16]), quat_to_matrix(measured[6:10])
    share = 1.0 - math.exp(-dt / OBSERVER_S)
    for i in range(3):
        beyond = shown[i] + n[GAIN] * force * r[i, 2] + drag * measured[3 + i]
        n[FORCE + i] += share * (min(max(beyond, -_FORCE_MOST_MPS2), _FORCE_MOST_MPS2) - n[FORCE + i])


@njit
def is_read(n: F64) -> bool:
    """Whether the gain has been read for long enough."""
    return n[READ_S] > _READ_AFTER_S + _READ_TIME_S  # type: ignore[no-any-return]


@njit
def _clear(now: Now, norm: float, rate: F64, of: Keeping, buffers: Buffers) -> bool:
    """Whether the way out after a command that is held for a tick is clear; the way is in `scratch` and `way`."""
    chain, n, p, origin = now.chain, now.numbers, of.row, now.origin
    after, spin, start, asked = now.state.copy(), now.spin.copy(), np.empty(ROW), np.empty(3)
    turn_on(after, spin, chain, now.rotors_s, norm, rate, n[HOLD_S], (now.offset, n[GAIN]))
    ahead_radps = p[SNAP] * p[LEAD_S] / STANDARD_GRAVITY_MPS2  # what changes the lean's jerk by the snap
    for i in range(3):  # the governor lets rates lead the present ones by so much
        asked[i] = min(max(rate[i], after[RATE_X + i] - ahead_radps), after[RATE_X + i] + ahead_radps)
    point_of(chain, after, spin, now.offset, n[GAIN], asked, start)
    for i in range(3):
        start[i] -= origin[i]
    r = quat_to_matrix(after[6:10])
    count = 0
    if r[2, 2] + _TILT_AHEAD_S * (after[RATE_Y] * r[2, 0] - after[RATE_X] * r[2, 1]) >= p[UPRIGHT]:
        count = roll(start, p, of.half, buffers.scratch, buffers.way)
    n[COUNT] = count
    if count == 0:
        n[EDGE] = TILT_CODE
        return False
    clearance, edge = clear_of(of.site, buffers.way, count, _NEAR_M)
    n[CLEARANCE], n[EDGE] = clearance, edge
    return clearance >= 0.0


@njit_called
def decide(
    known: tuple[F64, F64, F64, F64], kept: tuple[F64, F64, F64], site: F64, origin: F64, measured: F64,
    times_us: tuple[float, float, float], commands: tuple[float, F64, float, F64], buffers: tuple[F64, F64, F64, F64],
) -> tuple[float, int]:  # fmt: skip
    """`_decide`; plain tuples, for a named one that crosses into compiled code costs as much as a third of the tick."""
    return _decide(Known(*known), site, Kept(*kept), origin, measured, times_us, Commands(*commands), Buffers(*buffers))


@njit
def _decide(
    known: Known, site: F64, kept: Kept, origin: F64, measured: F64, times_us: tuple[float, float, float],
    commands: Commands, buffers: Buffers,
) -> tuple[float, int]:  # fmt: skip
    """The command to send: thrust, body rates into `buffers.rate` (3,); and the status.

    times_us: of the last command sent, the measurement, now; origin (3,).  PASSED: it is the wanted one, to the bit.
    """
    n, rate, begins_us = kept.numbers, buffers.rate, times_us[2] + known.vehicle[C_RATE_DELAY]
    state, offset, at = np.empty(STATE), np.zeros(3), _now(known, kept, origin, measured, times_us, commands)
    spin = n[SPIN : SPIN + 2].copy()
    _predict(known, kept, measured, times_us, (state, spin, offset))
    for i in range(3):
        n[SENT + i] = commands.sent_rate[i]
        rate[i] = commands.wanted_rate[i]
    now = Now(known.vehicle[:CHAIN], state, spin, known.vehicle[_ROTORS_S], offset, origin, n)
    of = Keeping(known.rows[at], known.halves[1 if is_read(n) else 0], site)
    s, height = known.soft[at], origin[2] - state[2]
    took_off = n[LEFT] == 0.0 and n[READ_S] > 0.0
    site[GROUND] = 1.0 if took_off and height >= _AIRBORNE_M else 0.0
    stands = n[LEFT] == 0.0 and height < _AIRBORNE_M
    turned = stands and _gently(state, rate)
    n[KEPT], n[SHARE], n[OFF] = 0.0, 1.0, 0.0
    leaves = n[LEFT] == 0.0 and height > site[FLOOR] + s[slide.HALF] + _ABOVE_M
    site[CHUTE] = -1.0 if leaves or n[LEFT] > 0.0 else site[OPEN]
    norm, code = _slid(now, of, s, known.vehicle, commands.wanted_norm, buffers)
    clear = _clear(now, norm, rate, of, buffers)
    if leaves and clear:
        n[LEFT] = 1.0
    elif leaves:  # not yet: there is no way out above the floor
        site[CHUTE] = site[OPEN]
        for i in range(3):
            rate[i] = commands.wanted_rate[i]
        norm, code = _slid(now, of, s, known.vehicle, commands.wanted_norm, buffers)
        clear = _clear(now, norm, rate, of, buffers)
    if clear:
        _commit(n, kept.committed, buffers.scratch, begins_us)
        if code != _FREE:
            n[EDGE] = code
        return norm, PASSED if code == _FREE and not turned else CHANGED
    if n[COMMITTED] == 0.0:
        if height < _AIRBORNE_M or n[COUNT] == 0.0:
            return commands.wanted_norm, WAITING
        _commit(n, kept.committed, buffers.scratch, begins_us)  # the best there is: it stops and holds
        n[SURE] = 0.0
    norm = _set_down(now, known.vehicle, rate) if stands else _held(
        now, norm, of, kept.committed, buffers, begins_us
    )  # fmt: skip
    return norm, CHANGED if n[SURE] > 0.0 else WAITING


@njit_called
def row_of(n: F64, vehicle: F64, count: int) -> int:
    """The row of the certificate for the least gain there may be."""
    lowest = vehicle[_GAINS]
    least = max(n[GAIN] * (1.0 - vehicle[_OPEN_SHARE]), lowest) if is_read(n) else lowest
    return int(min(max((least - lowest) / vehicle[_GAINS + 2], 0.0), count - 1.0))


@njit
def _now(
    known: Known, kept: Kept, origin: F64, measured: F64, times_us: tuple[float, float, float], commands: Commands
) -> int:  # fmt: skip
    """Take in the last command and what the accelerometer shows; the row of the certificate for the gain."""
    n, vehicle, now_us = kept.numbers, known.vehicle, times_us[2]
    chain, gains = vehicle[:CHAIN], vehicle[_GAINS : _GAINS + 2]
    remember(kept.memory, times_us[0], commands.sent_norm, commands.sent_rate)
    dt = min(max((now_us - n[LAST_US]) * 1e-6, 0.001), 0.05) if n[LAST_US] >= 0.0 else 0.004
    n[LAST_US], n[HOLD_S], chain[C_HOLD] = now_us, dt, dt
    follow_rotors(kept.memory, chain, times_us[1])
    seen(kept.memory, chain, vehicle[_ROTORS_S], measured, times_us[1], dt, n[SPIN : SPIN + 2])
    _observe(n, chain, measured, kept.memory[0, M_ROTORS], dt, origin[2] - measured[2], gains, vehicle[_DRAG])
    return row_of(n, vehicle, len(known.rows))


@njit
def _predict(
    known: Known, kept: Kept, measured: F64, times_us: tuple[float, float, float], out: tuple[F64, F64, F64]
) -> None:  # fmt: skip
    """The state (STATE,) and its spin (2,) when a command sent now begins to act, and the acceleration without thrust
    (3,)."""
    n, vehicle, (state, spin, offset) = kept.numbers, known.vehicle, out
    chain, drag = vehicle[:CHAIN], vehicle[_DRAG]
    for i in range(3):
        offset[i] = n[FORCE + i] - drag * measured[3 + i]
    offset[2] += STANDARD_GRAVITY_MPS2
    span_us = times_us[1], times_us[2] + chain[C_RATE_DELAY]
    ahead(kept.memory, chain, vehicle[_ROTORS_S], measured, span_us, (offset, n[GAIN]), state, spin)


@njit
def _slid(now: Now, of: Keeping, s: F64, vehicle: F64, norm: float, buffers: Buffers) -> tuple[float, int]:
    """The command slid along what is near, its rates in place; and what moved it, or _FREE."""
    chain, state, offset, n, rate = now.chain, now.state, now.offset, now.numbers, buffers.rate
    u, moved_u, near = buffers.out[8:11], buffers.out[11:14], np.empty((slide.MOST_ROWS, 6))
    acceleration(chain, state, offset, n[GAIN], norm, rate, u)
    z, v, response = np.empty(3), np.empty(3), vehicle[CHAIN : CHAIN + 9].reshape(3, 3)
    for i in range(3):
        moved_u[i] = u[i]
        z[i], v[i] = lead(chain, state, response, i, offset[i], n[GAIN])
        z[i] -= now.origin[i]
    count = slide.bounds(of.site, z, v, s, near)
    moved, code = slide.nearest_within(near, count, moved_u)
    if not moved:
        return norm, _FREE
    norm = command_for(chain, state, offset, n[GAIN], moved_u, rate)
    for i in range(2):
        fastest = min(vehicle[CHAIN + 9 + i], of.row[JERK] / STANDARD_GRAVITY_MPS2)
        rate[i] = min(max(rate[i], -fastest), fastest)
    return norm, code


@njit
def _level(state: F64, rate: F64) -> float:
    """Roll and pitch rates towards upright, gently, in place; cosine of the lean."""
    r = quat_to_matrix(state[6:10])
    rate[0] = min(max(-_LEVEL_PS * r[2, 1], -GENTLE_RADPS), GENTLE_RADPS)
    rate[1] = min(max(_LEVEL_PS * r[2, 0], -GENTLE_RADPS), GENTLE_RADPS)
    return r[2, 2]  # type: ignore[no-any-return]


@njit
def _gently(state: F64, rate: F64) -> bool:
    """Body rates (3,) of a vehicle that the ground may hold, in place: gentle ones, and once it leans such as level it;
    whether they were changed."""
    wanted_x, wanted_y = rate[0], rate[1]
    if _level(state, rate) >= _STANDS_UPRIGHT:
        rate[0] = min(max(wanted_x, -GENTLE_RADPS), GENTLE_RADPS)
        rate[1] = min(max(wanted_y, -GENTLE_RADPS), GENTLE_RADPS)
    return rate[0] != wanted_x or rate[1] != wanted_y  # type: ignore[no-any-return]


@njit
def _set_down(now: Now, vehicle: F64, rate: F64) -> float:
    """Thrust that puts the vehicle on its legs and leaves it there, and rates (in place) that level it: held by the
    ground it follows no way out, but tips over a leg or slides as it tries to."""
    n, chain = now.numbers, now.chain
    _level(now.state, rate)
    rate[2] = 0.0
    n[KEPT], n[SHARE] = 1.0, 0.0
    share = _DOWN_SHARE + (1.0 - _DOWN_SHARE) * max(now.state[5], 0.0) / slide.LANDING_MPS
    gain = n[GAIN] if is_read(n) else vehicle[_GAINS + 1]
    norm = thrust_to_norm(share * STANDARD_GRAVITY_MPS2 / gain, chain[C_SPECIFIC], chain[C_CURVE])
    return float(min(max(norm, chain[C_NORM_LOW]), chain[C_NORM_HIGH]))


@njit
def _commit(n: F64, committed: F64, scratch: F64, begins_us: float) -> None:
    count = int(n[COUNT])
    for k in range(count):
        for i in range(ROW):
            committed[k, i] = scratch[k, i]
    n[COMMITTED], n[SINCE_US], n[SURE] = count, begins_us + 1e6 * n[HOLD_S], 1.0


@njit
def _held(
    now: Now, norm: float, of: Keeping, committed: F64, buffers: Buffers, begins_us: float
) -> float:  # fmt: skip
    """The committed way is kept to; as much of the wanted command as leaves a way out clear is let through."""
    chain, state, n, rate = now.chain, now.state, now.numbers, buffers.rate
    clearance, edge = n[CLEARANCE], n[EDGE]
    target, brake, share_rate = np.empty(ROW), np.empty(3), np.empty(3)
    time_s = (begins_us - n[SINCE_US]) * 1e-6
    at_time(committed, int(n[COMMITTED]), time_s, target)
    for i in range(3):
        target[i] += now.origin[i]
    off = apart(committed, int(n[COMMITTED]), state[0] - now.origin[0], state[1] - now.origin[1])
    step = int(min(max(time_s / STEP_S, 0.0), STEPS - 1.0))
    n[OFF] = max(off - widest(committed, int(n[COMMITTED]), of.row), abs(state[2] - target[2]) - of.half[step])
    brake_norm = follow(of.row, chain, state, now.spin, now.offset, n[GAIN], target, brake)
    for share in _SHARES:
        share_norm = min(max(brake_norm + share * (norm - brake_norm), chain[C_NORM_LOW]), chain[C_NORM_HIGH])
        for i in range(3):
            share_rate[i] = brake[i] + share * (rate[i] - brake[i])
        if _clear(now, share_norm, share_rate, of, buffers):
            _commit(n, committed, buffers.scratch, begins_us)
            for i in range(3):
                rate[i] = share_rate[i]
            n[SHARE], n[CLEARANCE], n[EDGE] = share, clearance, edge
            return share_norm  # type: ignore[no-any-return]
    for i in range(3):
        rate[i] = brake[i]
    n[KEPT], n[SHARE], n[CLEARANCE], n[EDGE] = 1.0, 0.0, clearance, edge
    return brake_norm
