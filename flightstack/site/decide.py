"""One tick of the site filter, compiled: is the way out still clear after this command, and if not, which one is sent.

Numbers that last from tick to tick lie in one array (`MEMORY`), all of the vehicle in another (`pack`).
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.barrier.response import (
    C_HOLD,
    C_NORM_HIGH,
    C_NORM_LOW,
    C_RATE_DELAY,
    CHAIN,
    M_ROTORS,
    STATE,
    _advance,
    acceleration,
    ahead,
    command_for,
    follow_rotors,
    lead,
    remember,
    thrust_of,
)
from flightstack.frames import quat_to_matrix, rotate
from flightstack.jit import njit, njit_called
from flightstack.site import slide
from flightstack.site.backup import JERK, ROW, STEP_S, STEPS, UPRIGHT, at_time, follow, point_of, roll
from flightstack.site.clearance import CHUTE, FLOOR, OPEN, TILT_CODE, clear_of
from flightstack.site.tube import OBSERVER_S
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

(
    COMMITTED, SINCE_US, COUNT, GAIN, READ_S, LAST_US, EDGE, CLEARANCE, OFF, KEPT, SHARE, HOLD_S, FORCE,
) = range(13)  # fmt: skip
SENT, LEFT, BEYOND_S, MEMORY = FORCE + 3, FORCE + 6, FORCE + 7, FORCE + 8
"""1 where a way out is committed; when it begins, its number of points; the gain and for how long it was read; time of
the last tick; what was nearest to being forbidden, how clear the way is; how far the vehicle is from the way that it
follows; 1 where it follows it; share of the wanted command that was let through; the hold; the force that
the accelerometer shows (3, NED, m/s^2); body rates sent last (3); 1 once the chute of take-off was left; for how long
the force has been more than the certificate says (s; BROKEN_S: once and for all)."""
WAITING, PASSED, CHANGED = 1, 2, 3
_READ_AFTER_S, _READ_TIME_S = 0.5, 0.5
_AIRBORNE_M = 0.1
_LEAST_THRUST = 0.35
BROKEN_S = 0.1
_SHARES = (0.75, 0.5, 0.25, 0.125)
_NEAR_M = 100.0
_FORCE_MOST_MPS2 = 4.0
_TILT_AHEAD_S = 0.12
_SLEW_RADPS = 0.5
_ABOVE_M = 0.25
_LIMITS = CHAIN + 9 + 3 + 2
"""Places of a packed vehicle: chain, response (3, 3), rate limits (3), drag (1/s) and how uncertain the gain is."""


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
    n[GAIN] += share * (min(max(-measured[15] / force, bounds[0]), bounds[1]) - n[GAIN])
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
def _clear(
    chain: F64, state: F64, norm: float, rate: F64, offset: F64, origin: F64, n: F64, p: F64, tube: F64, site: F64,
    scratch: F64, way: F64,
) -> bool:  # fmt: skip
    """Whether the way out after a command that is held for a tick is clear; the way is in `scratch` and `way`."""
    after, command, start, asked = state.copy(), np.empty(5), np.empty(ROW), np.empty(3)
    command[0], command[1] = 0.0, norm
    for i in range(3):
        command[2 + i] = rate[i]
    _advance(after, chain, norm, command, n[HOLD_S], offset, n[GAIN])
    for i in range(3):  # the governor lets rates change so much
        asked[i] = min(max(rate[i], n[SENT + i] - _SLEW_RADPS), n[SENT + i] + _SLEW_RADPS)
    point_of(chain, after, offset, n[GAIN], asked, start)
    for i in range(3):
        start[i] -= origin[i]
    r = quat_to_matrix(after[6:10])
    if r[2, 2] + _TILT_AHEAD_S * (after[11] * r[2, 0] - after[10] * r[2, 1]) < p[UPRIGHT]:
        n[EDGE] = TILT_CODE
        return False
    count = roll(start, p, tube, scratch, way)
    if count == 0:
        n[EDGE] = TILT_CODE
        return False
    clearance, edge = clear_of(site, way, count, _NEAR_M)
    n[CLEARANCE], n[EDGE] = clearance, edge
    if clearance < 0.0:
        return False
    n[COUNT] = count
    return True


@njit_called
def decide(
    memory: F64, vehicle: F64, measured: F64, times_us: tuple[float, float, float], origin: F64, sent_norm: float,
    sent_rate: F64, wanted_norm: float, wanted_rate: F64, site: F64, rows: F64, soft: F64, tubes: F64, n: F64,
    committed: F64, scratch: F64, way: F64, out: F64, rate: F64,
) -> tuple[float, int]:  # fmt: skip
    """The command to send: thrust, body rates into `rate` (3,); and the status.

    times_us: of the last command sent, the measurement, now; rows and soft: by least gain (`Stopping`); out: a
    Filtered's row.  PASSED: it is the wanted one, to the bit.
    """
    sent_us, measured_us, now_us = times_us
    remember(memory, sent_us, sent_norm, sent_rate)
    chain, response = vehicle[:CHAIN], vehicle[CHAIN : CHAIN + 9].reshape(3, 3)
    most, drag, open_share = vehicle[CHAIN + 9 : CHAIN + 12], vehicle[CHAIN + 12], vehicle[CHAIN + 13]
    gains = vehicle[CHAIN + 14 : CHAIN + 16]
    dt = min(max((now_us - n[LAST_US]) * 1e-6, 0.001), 0.05) if n[LAST_US] >= 0.0 else 0.004
    n[LAST_US], n[HOLD_S], chain[C_HOLD] = now_us, dt, dt
    follow_rotors(memory, chain, measured_us)
    _observe(n, chain, measured, memory[0, M_ROTORS], dt, origin[2] - measured[2], gains, drag)
    read = is_read(n)
    least = max(n[GAIN] * (1.0 - open_share), gains[0]) if read else gains[0]
    at = int(min(max((least - gains[0]) / vehicle[CHAIN + 16], 0.0), len(rows) - 1.0))
    p, s, tube = rows[at], soft[at], tubes[1 if read else 0]
    offset, state = np.zeros(3), np.empty(STATE)
    for i in range(2):
        offset[i] = n[FORCE + i] - drag * measured[3 + i]
    offset[2] = STANDARD_GRAVITY_MPS2 + n[FORCE + 2] - drag * measured[5]
    begins_us = now_us + chain[C_RATE_DELAY]
    ahead(memory, chain, measured, measured_us, begins_us, offset, n[GAIN], state)
    for i in range(3):
        n[SENT + i] = sent_rate[i]
    if origin[2] - state[2] > site[FLOOR] + s[slide.HALF] + _ABOVE_M:
        n[LEFT] = 1.0
    site[CHUTE] = -1.0 if n[LEFT] > 0.0 else site[OPEN]
    norm = wanted_norm
    for i in range(3):
        rate[i] = wanted_rate[i]
    u, near = out[8:11], np.empty((slide.MOST_ROWS, 6))
    acceleration(chain, state, offset, n[GAIN], norm, rate, u)
    for i in range(3):
        out[11 + i] = u[i]
    z, v = np.empty(3), np.empty(3)
    for i in range(3):
        z[i], v[i] = lead(chain, state, response, i, offset[i], n[GAIN])
        z[i] -= origin[i]
    count = slide.bounds(site, z, v, s, near)
    moved, code = slide.nearest_within(near, count, out[11:14])
    if moved:
        norm = command_for(chain, state, offset, n[GAIN], out[11:14], rate)
        for i in range(2):
            fastest = min(most[i], p[JERK] / STANDARD_GRAVITY_MPS2)
            rate[i] = min(max(rate[i], -fastest), fastest)
    n[KEPT], n[SHARE], n[OFF] = 0.0, 1.0, 0.0
    if _clear(chain, state, norm, rate, offset, origin, n, p, tube, site, scratch, way):
        _commit(n, committed, scratch, begins_us)
        if moved:
            n[EDGE] = code
        return norm, CHANGED if moved else PASSED
    if n[COMMITTED] == 0.0:
        for i in range(3):
            rate[i] = wanted_rate[i]
        return wanted_norm, WAITING
    return _kept(chain, state, offset, origin, norm, rate, n, (p, tube, site), committed, scratch, way, begins_us)


@njit
def _commit(n: F64, committed: F64, scratch: F64, begins_us: float) -> None:
    count = int(n[COUNT])
    for k in range(count):
        for i in range(ROW):
            committed[k, i] = scratch[k, i]
    n[COMMITTED], n[SINCE_US] = count, begins_us + 1e6 * n[HOLD_S]


@njit
def _kept(
    chain: F64, state: F64, offset: F64, origin: F64, norm: float, rate: F64, n: F64, of: tuple[F64, F64, F64],
    committed: F64, scratch: F64, way: F64, begins_us: float,
) -> tuple[float, int]:  # fmt: skip
    """The committed way is kept to; as much of the wanted command as leaves a way out clear is let through."""
    p, tube, site = of
    clearance, edge = n[CLEARANCE], n[EDGE]
    target, brake, share_rate = np.empty(ROW), np.empty(3), np.empty(3)
    time_s = (begins_us - n[SINCE_US]) * 1e-6
    at_time(committed, int(n[COMMITTED]), time_s, target)
    for i in range(3):
        target[i] += origin[i]
    off = math.sqrt((state[0] - target[0]) ** 2 + (state[1] - target[1]) ** 2)
    step = int(min(max(time_s / STEP_S, 0.0), STEPS - 1.0))
    n[OFF] = max(off - tube[step, 0], abs(state[2] - target[2]) - tube[step, 1])
    brake_norm = follow(p, chain, state, offset, n[GAIN], target, brake)
    for share in _SHARES:
        share_norm = min(max(brake_norm + share * (norm - brake_norm), chain[C_NORM_LOW]), chain[C_NORM_HIGH])
        for i in range(3):
            share_rate[i] = brake[i] + share * (rate[i] - brake[i])
        if _clear(chain, state, share_norm, share_rate, offset, origin, n, p, tube, site, scratch, way):
            _commit(n, committed, scratch, begins_us)
            for i in range(3):
                rate[i] = share_rate[i]
            n[SHARE], n[CLEARANCE], n[EDGE] = share, clearance, edge
            return share_norm, CHANGED
    for i in range(3):
        rate[i] = brake[i]
    n[KEPT], n[SHARE], n[CLEARANCE], n[EDGE] = 1.0, 0.0, clearance, edge
    return brake_norm, CHANGED
