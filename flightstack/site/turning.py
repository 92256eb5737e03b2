"""How late a vehicle turns: PX4's rate loop at the gains that it has, with the rotors' lag in it; second order.

With alpha the angular acceleration of a unit of torque, P and D the gains (K in both) and tau the rotors' lag,

    tau d' = P (c - w) - D w' - d,   w' = alpha d        so        T s' = (c - w) / L - s,   s = w'
    L = (1 + alpha D) / (alpha P),   T = tau / (1 + alpha D)

A vehicle with slow rotors has a smaller K (`autopilot.airframe_gains`), so its L is twice that of the default gains and
more; and what turns it at a moment goes on for T, whatever is commanded: both are in the way out (`backup`), in its
tube (`tube`), and in the state that it begins with (`ahead`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.autopilot import autopilot_of, torque_per_slope
from flightstack.barrier.response import C_RATE_DELAY, C_RATE_LAG, M_ROTORS, S_ROTORS, acting, advance, held_until
from flightstack.barrier.torque import GovernorTerms
from flightstack.jit import njit
from flightstack.model import Limits, Model
from flightstack.rate_loop import SPREAD, steepness
from flightstack.rows import RATE_X
from flightstack.types import F64
from flightstack.types import STANDARD_GRAVITY_MPS2 as G
from flightstack.vehicle import Vehicle

_LEAST_S = 0.004
"""T is no less: the gyro's filters take more than that."""


class Turning(NamedTuple):
    """Of roll and pitch, the slower of both."""

    lag_s: float
    """L."""
    rotors_s: float
    """T."""
    snap_mps4: float
    """How fast jerk can change with the torque that the governor lets through, as modelled."""
    sure_mps4: float
    """What is left of it where gains and lag are off by what the governor knows of: the copy that asks for most torque
    decides, and the vehicle may be the one that has least of it."""
    rate_radps: float
    """The fastest that is let through."""
    way_mps4: float = 0.0
    """What of it the way out takes; and while it is fast."""
    way_fast_mps4: float = 0.0


def turning(vehicle: Vehicle, model: Model, governor: GovernorTerms, limits: Limits) -> Turning:
    """Of a believed vehicle at hover."""
    gains = autopilot_of(vehicle)
    bend = steepness(model.hover_norm, model.thrust_model_factor, gains["thr_mdl_fac"])
    alphas, lag_s, rotors_s = torque_per_slope(vehicle)[:2] * bend, 0.0, _LEAST_S
    for alpha, name in zip(alphas.tolist(), ("roll", "pitch"), strict=True):
        p, d = (gains[f"mc_{name}rate_k"] * gains[f"mc_{name}rate_{part}"] for part in "pd")
        lag_s = max(lag_s, (1.0 + alpha * d) / (alpha * p))
        rotors_s = max(rotors_s, model.motor_lag_s / (1.0 + alpha * d))
    snap = governor.roll_pitch_max * float(alphas.min()) * G
    rates = [math.radians(gains[f"mc_{name}rate_max"]) for name in ("roll", "pitch")]
    rate_radps = min(*rates, *limits.rate_max_radps[:2])
    return Turning(lag_s, rotors_s, snap, snap * (1.0 - SPREAD) / governor.chi, rate_radps)


@njit
def turn_on(
    state: F64, spin: F64, chain: F64, rotors_s: float, norm: float, rate: F64, span: float, force: tuple[F64, float]
) -> None:  # fmt: skip
    """One step with held commands; `spin` (2,): what roll and pitch rate change by, 1/s^2, in place; `force`:
    acceleration without thrust (3,) and thrust's gain."""
    command = np.zeros(5)
    left, follows = math.exp(-span / rotors_s), 1.0 - math.exp(-span / chain[C_RATE_LAG])
    for i in range(2):
        aim = (rate[i] - state[RATE_X + i]) / chain[C_RATE_LAG]
        after = aim + left * (spin[i] - aim)
        command[2 + i] = state[RATE_X + i] + 0.5 * (spin[i] + after) * span / follows
        spin[i] = after
    advance(state, chain, norm, command, span, *force)


@njit
def seen(memory: F64, chain: F64, rotors_s: float, measured: F64, at_us: float, dt: float, spin: F64) -> None:
    """Carry `spin` (2,) on to a measurement."""
    at, share = acting(memory, at_us - chain[C_RATE_DELAY]), 1.0 - math.exp(-dt / rotors_s)
    for i in range(2):
        spin[i] += share * ((memory[at, 2 + i] - measured[RATE_X + i]) / chain[C_RATE_LAG] - spin[i])


@njit
def ahead(
    memory: F64, chain: F64, rotors_s: float, measured: F64, times_us: tuple[float, float], force: tuple[F64, float],
    state: F64, spin: F64,
) -> None:  # fmt: skip
    """`response.ahead` with the rotors' lag in the turning: state (STATE,) and spin (2,) at the second of two times,
    spin from what it was at the first."""
    for i in range(13):
        state[i] = measured[i]
    state[S_ROTORS] = memory[0, M_ROTORS]
    t, to_us = times_us
    while t < to_us:
        thrust_at, rate_at, until = held_until(memory, chain, t, to_us)
        turn_on(state, spin, chain, rotors_s, memory[thrust_at, 1], memory[rate_at, 2:4], (until - t) * 1e-6, force)
        t = until
