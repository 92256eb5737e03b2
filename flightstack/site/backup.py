"""The way out: stop as hard as is certified, then hold the place; and the feedback that keeps a vehicle to it.

`roll` lays it out from any state in steps of STEP_S: across, braking is against the velocity, and the lean can only be
changed by the jerk and the snap that the governor of rate commands lets through; up and down, thrust follows with its
lag.  Near rest the braking fades with the speed.  The way ends at rest and holds for ever.  `follow` asks for the body
rates and the thrust that keep a vehicle to it (`tube` bounds how far it may be off).  Compiled.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

from flightstack.barrier.response import C_CURVE, C_NORM_HIGH, C_NORM_LOW, C_SPECIFIC, S_ROTORS, STATE, thrust_of
from flightstack.frames import quat_to_matrix
from flightstack.jit import njit, njit_called
from flightstack.model import thrust_to_norm
from flightstack.rows import (
    ACC_D,
    ACC_E,
    ACC_N,
    JERK_E,
    JERK_N,
    RATE_X,
    RATE_Y,
    VEL_D,
    VEL_E,
    VEL_N,
    WAY_HALF,
    WAY_RADIUS,
)
from flightstack.site.law import SEEN_SHARE, asked, snap_asked, turn_towards
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

STEP_S = 0.04
_SUBSTEPS = 2
STEPS = 192
"""7.7 s: a way that takes longer is none."""
ROW = 15
"""Numbers of a point: position (3, NED), velocity (3), acceleration (3), jerk across (2), jerk across
that is asked for (2), snap across (2); across, acceleration is that of the lean, with thrust that
carries the weight, and jerk the weight times its rate of turning."""
(
    ACROSS, UP, DOWN, JERK, SNAP, FADE, FADE_DOWN, LAG_DOWN, JERK_DOWN, ACC_GAIN, VEL_GAIN, POS_GAIN, VEL_DOWN,
    POS_DOWN, LEAN, LATE_S, LEAD_S, THRUST, UPRIGHT, STEEPEST, RESERVE, ROTORS_S, TURN, SURE, EASE, SNAP_FAST, FAST,
    LATE_LED_S, STOPPABLE, REST_RADIUS, MOST_RADIUS, PER_LEAN, PER_TURN, PARAMETERS,
) = *range(23), *range(26, 37)  # fmt: skip
"""Braking across, of a fall and of a climb (m/s^2); jerk and snap across; how fast braking fades, 1/s, across and
down; lag of thrust, its jerk; gains across and down; greatest acceleration by lean; doubt of time; the rates' lag;
the greatest thrust, m/s^2; the least cosine of the tilt; the steepest
lean on the way, m/s^2; of thrust what is kept for the force, m/s^2; what the rotors' lag makes later, s; and
how jerk (less what is asked for) and snap go on over a step (2, 2), and the snap that is sure: `turning`.  Of the lean
out of the brake its size for a speed of 1 m/s; the snap of a way that is faster than a speed, and that speed; lags with
the lead (`law`); of the turning that can be stopped, the share that is used; radii of the tube,
and what it grows by for a lean (`wide`) and for turning (`turns`)."""
ASKED_N, ASKED_E = 11, 12
SNAP_N = 13
_LEAN_GAIN_PS, _JERK_GAIN_PS = 8.0, 20.0
LITTLE_MPS, MUCH_MPS, LEANT_S, LITTLE_MPS2 = 2.0, 4.0, 0.4, 1.0
"""Motion of a way's beginning (speed, and what its lean adds in that time) with which it is left by no more than one
from rest, and from which on by the most; and the lean beyond what braking asks for up to which that holds."""
QUICK_MPS3, MOST_TURN_MPS3 = 8.0, 25.0
"""A tube grows with turning, and beyond this with its square (`turns`); a way that begins with more than the last is
none: further none is searched."""
FASTEST, STOP_SHARE = 2.0, 0.75
"""Turning while a way is followed, by its own greatest; of the snap, what stops turning faster than the way's."""
_STILL_MPS, _STILL_MPS2 = 0.03, 0.15
_LEAST_UPRIGHT = 0.3


def turned(lag_s: float, rotors_s: float) -> list[float]:
    """How jerk, less what is asked for, and snap go on over a step: (2, 2), row by row."""
    rate = np.array([[0.0, 1.0], [-1.0 / (lag_s * rotors_s), -1.0 / rotors_s]])
    out: list[float] = expm(STEP_S / _SUBSTEPS * rate).ravel().tolist()
    return out


@njit_called
def roll(start: F64, p: F64, half: F64, points: F64, way: F64) -> int:
    """The way out from a point (ROW,): into `points` (STEPS, ROW) and the discs of `way` (STEPS, 5); how many, or 0.

    half (STEPS,): half height of the tube after each step.  0: it does not come to rest in time, leans too far, or
    begins to turn too fast.
    """
    if turning_of(start, p) > MOST_TURN_MPS3:
        return 0
    x = start.copy()
    speed = math.sqrt(x[VEL_N] * x[VEL_N] + x[VEL_E] * x[VEL_E] + x[VEL_D] * x[VEL_D])
    late = p[LATE_S] * speed
    dt = STEP_S / _SUBSTEPS
    most = max(p[STEEPEST] * p[STEEPEST], x[ACC_N] * x[ACC_N] + x[ACC_E] * x[ACC_E])
    for k in range(STEPS):
        at_n, at_e, at_d = x[0], x[1], x[2]
        for i in range(ROW):
            points[k, i] = x[i]
        way[k, 0], way[k, 1], way[k, 2] = x[0], x[1], -x[2]
        slow = math.sqrt(x[VEL_N] * x[VEL_N] + x[VEL_E] * x[VEL_E] + x[VEL_D] * x[VEL_D]) < _STILL_MPS
        still = slow and math.sqrt(x[ACC_N] * x[ACC_N] + x[ACC_E] * x[ACC_E] + x[ACC_D] * x[ACC_D]) < _STILL_MPS2
        if still:
            for i in range(3, ROW):
                points[k, i] = 0.0
            way[k, WAY_RADIUS], way[k, WAY_HALF] = late, half[STEPS - 1] + late
            radius = widest(points, k + 1, p)
            for i in range(k + 1):
                way[i, WAY_RADIUS] += radius
            _all_heights(way, k + 1)
            return k + 1
        for _ in range(_SUBSTEPS):
            _step(x, p, dt)
        if x[ACC_N] * x[ACC_N] + x[ACC_E] * x[ACC_E] > most:
            return 0
        across = math.sqrt((x[0] - at_n) ** 2 + (x[1] - at_e) ** 2)
        way[k, WAY_RADIUS], way[k, WAY_HALF] = (
            late + 0.5 * across,
            half[k] + late + 0.5 * abs(x[2] - at_d),
        )
        way[k, 0], way[k, 1], way[k, 2] = 0.5 * (at_n + x[0]), 0.5 * (at_e + x[1]), -0.5 * (at_d + x[2])
    return 0


@njit
def widest(points: F64, count: int, p: F64) -> float:
    """Radius of the tube of a way: the most of its parts until the turning that it begins with has been stopped, and
    what that turning adds."""
    most = wide(points[0], p)
    for k in range(1, count):
        if points[k, JERK_N] * points[0, JERK_N] + points[k, JERK_E] * points[0, JERK_E] <= 0.0:
            break
        most = max(most, wide(points[k], p))
    return most + p[PER_TURN] * turns(points[0], p)  # type: ignore[no-any-return]


@njit
def turning_of(start: F64, p: F64) -> float:
    """How fast the lean turns, or will once its snap has faded, m/s^3."""
    north, east = start[JERK_N] + p[ROTORS_S] * start[SNAP_N], start[JERK_E] + p[ROTORS_S] * start[SNAP_N + 1]
    return math.sqrt(max(start[JERK_N] ** 2 + start[JERK_E] ** 2, north * north + east * east))


@njit
def turns(start: F64, p: F64) -> float:
    """What a tube grows with, by turning."""
    turning = turning_of(start, p)
    return turning * (turning + QUICK_MPS3)


@njit
def wide(start: F64, p: F64) -> float:
    """Radius of the tube of a way that begins so and does not turn: more where it begins with much motion, or with a
    lean that is not the one it brakes with."""
    north, east = start[VEL_N] + LEANT_S * start[ACC_N], start[VEL_E] + LEANT_S * start[ACC_E]
    share = (math.sqrt(north * north + east * east) - LITTLE_MPS) / (MUCH_MPS - LITTLE_MPS)
    moved = min(max(share, 0.0), 1.0) * (p[MOST_RADIUS] - p[REST_RADIUS])
    return p[REST_RADIUS] + max(moved, p[PER_LEAN] * (leant(start, p) - LITTLE_MPS2))  # type: ignore[no-any-return]


@njit
def leant(start: F64, p: F64) -> float:
    """The lean of a way's beginning, or what it lacks of the one that brakes, whichever is less."""
    north, east = start[VEL_N], start[VEL_E]
    brake = _braking(math.sqrt(north * north + east * east), p)
    short_n, short_e = start[ACC_N] + brake * north, start[ACC_E] + brake * east
    return math.sqrt(min(start[ACC_N] ** 2 + start[ACC_E] ** 2, short_n * short_n + short_e * short_e))


@njit
def _braking(speed: float, p: F64) -> float:
    """How hard a way brakes, by its speed (1/s)."""
    fast = max(speed, 1e-9)
    return min(p[ACROSS] / fast, p[FADE], p[EASE] / fast ** (1.0 / 3.0))  # type: ignore[no-any-return]


@njit
def _all_heights(way: F64, count: int) -> None:
    """Every disc at all the heights of a way: the tube is about its places, whenever the vehicle is at them."""
    low, high = np.inf, -np.inf
    for k in range(count):
        low, high = min(low, way[k, 2] - way[k, WAY_HALF]), max(high, way[k, 2] + way[k, WAY_HALF])
    for k in range(count):
        way[k, 2], way[k, WAY_HALF] = 0.5 * (low + high), 0.5 * (high - low)


@njit
def apart(points: F64, count: int, north: float, east: float) -> float:
    """How far across a place is from the nearest of a way."""
    nearest = np.inf
    for k in range(max(count - 1, 1)):
        n, e = points[k, 0], points[k, 1]
        dn, de = (points[k + 1, 0] - n, points[k + 1, 1] - e) if k + 1 < count else (0.0, 0.0)
        share = min(max(((north - n) * dn + (east - e) * de) / max(dn * dn + de * de, 1e-12), 0.0), 1.0)
        nearest = min(nearest, (north - n - share * dn) ** 2 + (east - e - share * de) ** 2)
    return math.sqrt(nearest)


@njit
def _step(x: F64, p: F64, dt: float) -> None:
    """A step of the way out, in place."""
    speed = math.sqrt(x[VEL_N] * x[VEL_N] + x[VEL_E] * x[VEL_E])
    brake = _braking(speed, p)
    hurry = min(max(2.0 * (speed / p[FAST] - 1.0), 0.0), 1.0)
    most = p[SNAP] + hurry * (p[SNAP_FAST] - p[SNAP])
    turns = math.sqrt(x[JERK_N] * x[JERK_N] + x[JERK_E] * x[JERK_E]) / math.sqrt(p[SNAP] * p[ACROSS])
    most = max(most, p[SNAP] + min(max(2.0 * (turns - 0.8), 0.0), 1.0) * (STOP_SHARE * p[SURE] - p[SNAP]))
    rate_lag = max(p[LEAD_S], dt)
    jn = -brake * x[VEL_N] - x[ACC_N] - rate_lag * (x[JERK_N] + p[ROTORS_S] * x[SNAP_N])
    je = -brake * x[VEL_E] - x[ACC_E] - rate_lag * (x[JERK_E] + p[ROTORS_S] * x[SNAP_N + 1])
    short = max(math.sqrt(jn * jn + je * je), 1e-9)
    turn = min(_LEAN_GAIN_PS * short, p[STOPPABLE] * math.sqrt(2.0 * most * short), p[JERK]) / short
    jn, je = turn * jn, turn * je
    sn, se = _JERK_GAIN_PS * (jn - x[ASKED_N]), _JERK_GAIN_PS * (je - x[ASKED_E])
    size = math.sqrt(sn * sn + se * se)
    if size > most:
        sn, se = sn * most / size, se * most / size
    x[ASKED_N] += dt * sn
    x[ASKED_E] += dt * se
    for i in range(2):
        behind, snap = x[9 + i] - x[11 + i], x[SNAP_N + i]
        x[9 + i] = x[11 + i] + p[TURN] * behind + p[TURN + 1] * snap
        x[SNAP_N + i] = p[TURN + 2] * behind + p[TURN + 3] * snap
    most = p[UP] if x[VEL_D] > 0.0 else p[DOWN]
    wanted = -x[VEL_D] * min(most / max(abs(x[VEL_D]), 1e-9), p[FADE_DOWN])
    lift = math.sqrt(
        max(p[THRUST] * p[THRUST] - x[ACC_N] * x[ACC_N] - x[ACC_E] * x[ACC_E], 0.01 * p[THRUST] * p[THRUST])
    )
    wanted = max(wanted, STANDARD_GRAVITY_MPS2 - lift + p[RESERVE])  # what leans does not lift, nor what meets force
    down = min(max((wanted - x[ACC_D]) / p[LAG_DOWN], -p[JERK_DOWN]), p[JERK_DOWN])
    steep = 1.0 + (x[ACC_N] * x[ACC_N] + x[ACC_E] * x[ACC_E]) / STANDARD_GRAVITY_MPS2**2  # tan of a lean that turns
    lifted = max(STANDARD_GRAVITY_MPS2 - x[ACC_D], 0.0) / STANDARD_GRAVITY_MPS2
    for i in range(3):
        j, share = (down, 1.0) if i == 2 else (steep * x[9 + i], lifted)
        x[i] += dt * (x[3 + i] + dt * share * (0.5 * x[6 + i] + dt * j / 6.0))
        x[3 + i] += dt * share * (x[6 + i] + 0.5 * dt * j)
        x[6 + i] += dt * j


@njit
def point_of(chain: F64, state: F64, spin: F64, offset: F64, gain: float, asked: F64, out: F64) -> None:
    """A predicted state (`turning.ahead`) and its spin (2,) as a point of a way, under body rates asked for (3,).

    offset (3,): acceleration without thrust.
    """
    r = quat_to_matrix(state[6:10])
    for i in range(3):
        out[i], out[3 + i] = state[i], state[3 + i]
    out[ACC_D] = offset[2] - gain * thrust_of(chain, state[S_ROTORS]) * r[2, 2]
    force = STANDARD_GRAVITY_MPS2 / max(r[2, 2], _LEAST_UPRIGHT)
    for i in range(2):
        out[6 + i] = offset[i] - force * r[i, 2]
        out[9 + i] = -force * (state[RATE_Y] * r[i, 0] - state[RATE_X] * r[i, 1])
        out[11 + i] = -force * (asked[1] * r[i, 0] - asked[0] * r[i, 1])
        out[SNAP_N + i] = -force * (spin[1] * r[i, 0] - spin[0] * r[i, 1])


@njit
def at_time(points: F64, count: int, time_s: float, out: F64) -> None:
    """The point of a way at a time."""
    at = min(max(time_s / STEP_S, 0.0), count - 1.0)
    k = min(int(at), max(count - 2, 0))
    share = at - k if count > 1 else 0.0
    n = min(k + 1, count - 1)
    for i in range(ROW):
        out[i] = points[k, i] + share * (points[n, i] - points[k, i])


@njit
def follow(p: F64, chain: F64, state: F64, spin: F64, offset: F64, gain: float, target: F64, rate: F64) -> float:
    """The command that keeps a predicted state (STATE,) and its spin (2,) to a point: normalised thrust, body rates
    into `rate` (3,)."""
    here = np.empty(ROW)
    point_of(chain, state, spin, offset, gain, state[10:13], here)
    r = quat_to_matrix(state[6:10])
    back_n = (p[VEL_GAIN] * (target[VEL_N] - here[VEL_N]) + p[POS_GAIN] * (target[0] - here[0])) / p[ACC_GAIN]
    back_e = (p[VEL_GAIN] * (target[VEL_E] - here[VEL_E]) + p[POS_GAIN] * (target[1] - here[1])) / p[ACC_GAIN]
    share = asked(math.sqrt(back_n * back_n + back_e * back_e), p[VEL_GAIN] / p[ACC_GAIN], p[SURE])
    lean_n = target[ACC_N] + share * back_n + (1.0 - SEEN_SHARE) * offset[0]
    lean_e = target[ACC_E] + share * back_e + (1.0 - SEEN_SHARE) * offset[1]
    by_n, by_e = lean_n - offset[0], lean_e - offset[1]
    size = math.sqrt(by_n * by_n + by_e * by_e)
    down = target[ACC_D] + p[VEL_DOWN] * (target[VEL_D] - here[VEL_D]) + p[POS_DOWN] * (target[2] - here[2])
    lift = max(offset[2] - down, 0.0)  # comes first: what braking takes is certified to be left
    most = min(p[LEAN], math.sqrt(max(p[THRUST] * p[THRUST] - lift * lift, p[ACROSS] * p[ACROSS])))
    if size > most:
        lean_n, lean_e = offset[0] + by_n * most / size, offset[1] + by_e * most / size
    short_n, short_e = lean_n - here[ACC_N], lean_e - here[ACC_E]
    short = max(math.sqrt(short_n * short_n + short_e * short_e), 1e-9)
    turn = min(turn_towards(short, p[ACC_GAIN], p[SURE], p[LATE_LED_S]), FASTEST * p[JERK]) / short
    turn /= 1.0 + (here[ACC_N] * here[ACC_N] + here[ACC_E] * here[ACC_E]) / STANDARD_GRAVITY_MPS2**2
    jn, je = target[ASKED_N] + turn * short_n, target[ASKED_E] + turn * short_e
    sn, se = snap_asked(
        (jn, je), (here[JERK_N], here[JERK_E]), (here[SNAP_N], here[SNAP_N + 1]), p[SURE], (p[LEAD_S], p[ROTORS_S])
    )
    jn, je = here[JERK_N] + p[LEAD_S] * sn, here[JERK_E] + p[LEAD_S] * se
    upright = max(r[2, 2], _LEAST_UPRIGHT)
    force = STANDARD_GRAVITY_MPS2 / upright
    north, east = -jn / force, -je / force
    rate[0] = (r[1, 0] * north - r[0, 0] * east) / upright
    rate[1] = (r[1, 1] * north - r[0, 1] * east) / upright
    rate[2] = 0.0
    wanted = (offset[2] - down) / (gain * upright)
    norm = thrust_to_norm(max(wanted, 0.0), chain[C_SPECIFIC], chain[C_CURVE])
    return min(max(norm, chain[C_NORM_LOW]), chain[C_NORM_HIGH])  # type: ignore[no-any-return]


__all__ = ["PARAMETERS", "ROW", "STATE", "STEPS", "STEP_S", "at_time", "follow", "point_of", "roll"]
