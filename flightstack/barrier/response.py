"""How the vehicle answers its commands: the state when the next command begins to act, and what that command does then.

Thrust.  The rotors' command w follows the sent one, w' = (w_c - w) / tau; specific thrust is F(w) = k (f w^2 + (1-f) w)
(believed newton per believed kilogram), of which the learned share `gain` acts.  With the attitude's lean c = b3_down

    z_v = v + tau (offset - gain F~(w) c),      F~' = k (f (w_max + w) + 1 - f),   F~(w_max) = F(w_max)
    z_v' = offset - gain ((F(w) + F~'(w) (w_c - w)) c + tau F~ c')  =: u(w_c)

so u is had exactly, whatever the rotors still have to do.  F~ is F for a linear curve (f = 0).  For a bent one it
counts what the rotors owe on the way to *full* thrust: then w_c = w_max gives the whole of braking from every w, which
the tangent of the curve would not, and the least thrust gives no less than it seems to.  The price is that z_v is
tau gain k f (w_max - w)^2 / 2 too far down: 2 mm/s in hover, 0.1 m/s for a moment after rotors at idle.

Steering.  Body rates w_c turn the thrust axis b3: with the rate loop's lag tau_r, b3 + T b3' + T tau_r b3'' = n,
n = b3 + T w_c x b3, T the time constant that the filter itself steers with.  With a constant thrust F0 for the lead

    z_v = v + T (offset - gain F0 b3) - T tau_r gain F0 b3',   z_p = p + T v + T tau_r (offset - gain F0 b3)
    z_v' = offset - gain (F b3 + F0 T w_c x b3)  =: u(w_c)

(north and east parts): what thrust does meanwhile is accounted for in u, and no change of it makes z jump.

The state is carried from the measurement to the moment when the next command begins to act by integrating this chain
with the commands that were really sent.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.frames import quat_from_rotation_vector, quat_multiply, quat_to_matrix
from flightstack.jit import njit
from flightstack.rows import RATE_X, RATE_Y
from flightstack.types import F64

RING = 64
"""Commands remembered: 128 ms at 2 ms a tick."""
COMMAND = 5
"""Numbers of a remembered command: time (us), normalised thrust, body rates."""
CHAIN = 11
"""Numbers of a chain, by the names below."""
(
    C_SPECIFIC, C_CURVE, C_NORM_LOW, C_NORM_HIGH, C_ROTOR_LAG, C_RATE_LAG, C_THRUST_DELAY, C_RATE_DELAY, C_STEER,
    C_LEAD_THRUST, C_HOLD,
) = range(CHAIN)  # fmt: skip
"""k (m/s^2), f, range of w, tau (s), tau_r (s), delays of thrust and rates (whole us), T (s), F0 (m/s^2), hold (s)."""
STATE, S_ROTORS = 14, 13
"""Numbers of a predicted state: position (3), velocity (3), attitude (4), body rates (3), rotor command w."""
_STEP_US = 4000.0


M_ROTORS_US, M_ROTORS, M_STEP_US, M_GOOD_SINCE, M_MODE = range(COMMAND)
"""Row 0 of the memory: time of the rotors' state, the state; and the filter's own: time of the last step, since when h
is good (inf: it is not), mode."""


def new_memory() -> F64:
    """(RING + 1, COMMAND) memory before the first command: row 0 as above, then the commands, the latest last."""
    memory = np.zeros((RING + 1, COMMAND))
    memory[:, 0] = -np.inf
    memory[0, M_STEP_US], memory[0, M_GOOD_SINCE] = -np.inf, np.inf
    return memory


@njit
def remember(memory: F64, t_us: float, norm: float, rate: F64) -> None:
    """Take in a command that was sent; one that is not later than the last replaces nothing, and what is not a number
    is not taken: the vehicle does not take it either."""
    if not (t_us > memory[RING, 0] and math.isfinite(norm + rate[0] + rate[1] + rate[2])):
        return
    if memory[RING, 0] == -np.inf:  # the first: rotors have long been there
        memory[0, M_ROTORS_US], memory[0, M_ROTORS] = t_us, norm
    for i in range(1, RING):
        for k in range(COMMAND):
            memory[i, k] = memory[i + 1, k]
    memory[RING, 0], memory[RING, 1] = t_us, norm
    for k in range(3):
        memory[RING, 2 + k] = rate[k]


@njit
def acting(memory: F64, t_us: float) -> int:
    """Index of the latest command sent until t_us; the oldest one there is where all are later."""
    i = RING
    while i > 1 and memory[i, 0] > t_us and memory[i - 1, 0] > -np.inf:
        i -= 1
    return i


@njit
def _next(memory: F64, at: int, delay_us: float, end_us: float) -> float:
    """When the command after `at` begins to act, or the end if that is sooner."""
    return end_us if at >= RING else min(memory[at + 1, 0] + delay_us, end_us)


@njit
def _left(span_s: float, lag_s: float) -> float:
    """What is left of a lag's error after a time."""
    return math.exp(-span_s / lag_s) if lag_s > 1e-6 else 0.0


@njit
def follow_rotors(memory: F64, chain: F64, now_us: float) -> None:
    """Carry the rotors' state to `now_us` with the commands that acted meanwhile."""
    delay = chain[C_THRUST_DELAY]
    while -np.inf < memory[0, M_ROTORS_US] < now_us:
        t = memory[0, M_ROTORS_US]
        at = acting(memory, t - delay)
        until = max(_next(memory, at, delay, now_us), t)
        left = _left((until - t) * 1e-6, chain[C_ROTOR_LAG])
        memory[0, M_ROTORS] = memory[at, 1] + left * (memory[0, M_ROTORS] - memory[at, 1])
        memory[0, M_ROTORS_US] = until


@njit
def thrust_of(chain: F64, w: float) -> float:
    """F(w), m/s^2."""
    return chain[C_SPECIFIC] * w * (chain[C_CURVE] * w + 1.0 - chain[C_CURVE])  # type: ignore[no-any-return]


@njit
def lead_thrust(chain: F64, w: float) -> float:
    """F~(w), m/s^2."""
    short = chain[C_NORM_HIGH] - w
    return thrust_of(chain, w) - 0.5 * chain[C_SPECIFIC] * chain[C_CURVE] * short * short  # type: ignore[no-any-return]


@njit
def held_until(memory: F64, chain: F64, t_us: float, to_us: float) -> tuple[int, int, float]:
    """Which commands of thrust and of rates act at a time, and until when both do, at most a step and to_us."""
    thrust_at = acting(memory, t_us - chain[C_THRUST_DELAY])
    rate_at = acting(memory, t_us - chain[C_RATE_DELAY])
    until = _next(memory, thrust_at, chain[C_THRUST_DELAY], min(t_us + _STEP_US, to_us))
    until = _next(memory, rate_at, chain[C_RATE_DELAY], until)
    if until <= t_us:  # a command of the past that the ring no longer tells from the next
        until = min(t_us + _STEP_US, to_us)
    return thrust_at, rate_at, until


@njit
def ahead(
    memory: F64, chain: F64, measured: F64, from_us: float, to_us: float, offset: F64, gain: float, state: F64
) -> None:
    """The state at `to_us` from one measured at `from_us`, into `state` (STATE,).

    measured (20,): a Measurement's row; memory as of `from_us`; offset (3,) NED m/s^2: acceleration without thrust.
    Rotors and body rates are exact for held commands, attitude and motion to third and fourth order in 4 ms.
    """
    for i in range(13):
        state[i] = measured[i]
    state[S_ROTORS] = memory[0, M_ROTORS]
    t = from_us
    while t < to_us:
        thrust_at, rate_at, until = held_until(memory, chain, t, to_us)
        advance(state, chain, memory[thrust_at, 1], memory[rate_at], (until - t) * 1e-6, offset, gain)
        t = until


@njit
def advance(state: F64, chain: F64, norm: float, command: F64, span: float, offset: F64, gain: float) -> None:
    """One step of the chain with held commands; Simpson's rule for the motion."""
    w, half = state[S_ROTORS], 0.5 * span
    rotor, rate = _left(half, chain[C_ROTOR_LAG]), _left(half, chain[C_RATE_LAG])
    w_mid = norm + rotor * (w - norm)
    w_end = norm + rotor * (w_mid - norm)
    lean = np.empty((3, 3))  # thrust axis at the start, middle and end
    q, omega = state[6:10], state[10:13]
    turn, after = np.empty(3), np.empty(3)
    r = quat_to_matrix(q)
    for k in range(3):
        lean[0, k] = r[k, 2]
    for part in range(2):
        for k in range(3):
            steered = k < 2
            after[k] = command[2 + k] + rate * (omega[k] - command[2 + k]) if steered else omega[k]
            turn[k] = 0.5 * (omega[k] + after[k]) * half
            omega[k] = after[k]
        turned = quat_multiply(q, quat_from_rotation_vector(turn))
        for k in range(4):
            q[k] = turned[k]
        r = quat_to_matrix(q)
        for k in range(3):
            lean[1 + part, k] = r[k, 2]
    start, middle, end = (
        gain * thrust_of(chain, w),
        gain * thrust_of(chain, w_mid),
        gain * thrust_of(chain, w_end),
    )
    for k in range(3):
        a0, am, a1 = offset[k] - start * lean[0, k], offset[k] - middle * lean[1, k], offset[k] - end * lean[2, k]
        state[k] += span * (state[3 + k] + span / 6.0 * (a0 + 2.0 * am))
        state[3 + k] += span / 6.0 * (a0 + 4.0 * am + a1)
    state[S_ROTORS] = w_end


@njit
def lead(chain: F64, state: F64, response: F64, axis: int, offset: float, gain: float) -> tuple[float, float]:
    """(z_p, z_v) of one axis (0 north, 1 east, 2 down) of a predicted state; response (3, 3): c1, c2, delay."""
    r = quat_to_matrix(state[6:10])
    c1, c2 = response[axis, 0], response[axis, 1]
    p, v = state[axis], state[3 + axis]
    if axis == 2:
        return p + c1 * v, v + c1 * (offset - gain * lead_thrust(chain, state[S_ROTORS]) * r[2, 2])
    force = gain * chain[C_LEAD_THRUST]
    a = offset - force * r[axis, 2]
    jerk = -force * (state[RATE_Y] * r[axis, 0] - state[RATE_X] * r[axis, 1])
    return p + c1 * v + c2 * a, v + c1 * a + c2 * jerk


@njit
def acceleration(chain: F64, state: F64, offset: F64, gain: float, norm: float, rate: F64, u: F64) -> float:
    """The commanded acceleration u (3,) of a command, as the barriers count it; the mean thrust F while it is held."""
    r = quat_to_matrix(state[6:10])
    lean, change = _mean_lean(chain, state, r)
    span, w = chain[C_HOLD], state[S_ROTORS]
    once = _share(span, chain[C_ROTOR_LAG])
    f, k = chain[C_CURVE], chain[C_SPECIFIC]
    force = _mean_thrust(chain, w, norm)
    owed = thrust_of(chain, norm) + k * f * (chain[C_NORM_HIGH] - norm) * (norm - w) * once
    u[2] = offset[2] - gain * (owed * lean[2] + chain[C_ROTOR_LAG] * lead_thrust(chain, w) * change)
    turn = gain * chain[C_LEAD_THRUST] * chain[C_STEER]
    for i in range(2):
        u[i] = offset[i] - gain * force * lean[i] - turn * (rate[1] * r[i, 0] - rate[0] * r[i, 1])
    return force


@njit
def command_for(chain: F64, state: F64, offset: F64, gain: float, u: F64, rate: F64) -> float:
    """The command that has the acceleration u: thrust within its range, roll and pitch rates into `rate` (3,)."""
    r = quat_to_matrix(state[6:10])
    lean, change = _mean_lean(chain, state, r)
    w, f = state[S_ROTORS], chain[C_CURVE]
    once = _share(chain[C_HOLD], chain[C_ROTOR_LAG])
    owed = (offset[2] - u[2]) / gain - chain[C_ROTOR_LAG] * lead_thrust(chain, w) * change
    constant = f * once * chain[C_NORM_HIGH] * w + owed / (max(lean[2], 0.1) * chain[C_SPECIFIC])
    linear, square = 1.0 - f + f * once * (chain[C_NORM_HIGH] + w), f * (1.0 - once)
    norm = 2.0 * constant / (linear + math.sqrt(max(linear * linear + 4.0 * square * constant, 1e-24)))
    norm = min(max(norm, chain[C_NORM_LOW]), chain[C_NORM_HIGH])
    force = _mean_thrust(chain, w, norm)
    turn = gain * chain[C_LEAD_THRUST] * chain[C_STEER]
    north = (offset[0] - u[0] - gain * force * lean[0]) / turn
    east = (offset[1] - u[1] - gain * force * lean[1]) / turn
    upright = max(r[2, 2], 0.1)
    rate[0] = (r[1, 0] * north - r[0, 0] * east) / upright
    rate[1] = (r[1, 1] * north - r[0, 1] * east) / upright
    return norm  # type: ignore[no-any-return]


@njit
def _mean_lean(chain: F64, state: F64, r: F64) -> tuple[F64, float]:
    """The thrust axis in the middle of the hold (3,), and how fast its down part changes, 1/s."""
    lean, change = np.empty(3), 0.0
    for i in range(3):
        change = state[RATE_Y] * r[i, 0] - state[RATE_X] * r[i, 1]
        lean[i] = r[i, 2] + 0.5 * chain[C_HOLD] * change
    return lean, change


@njit
def _share(span: float, lag: float) -> float:
    """Mean of a lag's error over a time, in shares of its start."""
    x = span / lag if lag > 1e-6 else np.inf
    if x < 1e-6:
        return 1.0
    return (1.0 - math.exp(-x)) / x if x < np.inf else 0.0


@njit
def _mean_thrust(chain: F64, w: float, norm: float) -> float:
    """F while the rotors go from w towards `norm`, mean over the hold."""
    once, twice = _share(chain[C_HOLD], chain[C_ROTOR_LAG]), _share(2.0 * chain[C_HOLD], chain[C_ROTOR_LAG])
    gap, f = norm - w, chain[C_CURVE]
    bent = norm * norm - 2.0 * norm * gap * once + gap * gap * twice
    return chain[C_SPECIFIC] * (f * bent + (1.0 - f) * (norm - gap * once))  # type: ignore[no-any-return]
