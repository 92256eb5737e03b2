"""The ledger: what estimate, delay and lags may cost, turned into the constants of the barrier condition.

The condition (`condition`) is checked at a predicted state z^; what counts is the true one.  Every source says by how
much z^ = (e, v) may be off: by (eps_e, eps_v), and *along the motion* by a time t: (t v, t a), a the acceleration now.
S is the span between the ends of the command, E the greatest doubt of the acceleration:

    estimate   position + (c1 + delay) velocity + c2 acceleration, velocity + (c1 + delay) acceleration, as reported
    delay      t = d, the doubt of the delay, in which commands act that were not counted, with d E; and the model's
               error over the delay itself, delay^2 E / 2 and delay E
    rotor lag  t = l: z = (p + c1 v, v + c1 a) is built with c1 off by l; and its a, from a model whose lag is off by l,
               differs after a step by S l / (c1 exp(1)) for a while: l S / exp(1)
    steering   the rate loop's lag is off by r, seen through T = c1: T r S / 2, and r S, as jerk is at most S / T

Measurement-robust barrier functions: with q at z^ at least b, q at z is not below 0 where

    b + b_u |u| >= sup |dq/de| eps_e + sup |dq/dv| eps_v + t sup |dq/de v + dq/dv a|   (without gamma h: that is eta's)
    eta >= sup |dh/de| eps_e + sup |dh/dv| eps_v + t sup |dh/de v + dh/dv a|

over all accelerations a in reach and all states of the region; each slope of q is one at rest plus one times |u|.  (h
is concave: h(z^) <= h(z) + grad h(z) (z^ - z), so the slopes at the true state bound it.)  Source: S. Dean, A. Taylor,
R. Cosner, B. Recht, A. Ames, "Guaranteeing safety of learned perception modules via measurement-robust control barrier
functions", CoRL 2020, theorem 2.  On an ellipse every one of these is greatest on its edge: linear in e for a given v,
and no interior maximum in v; a stopping way's are greatest at the greatest speed.

Between z and (p, v).  (p, v) follows z through the low pass 1 / (c1 s + 1) if v + c1 v' = z_v.  Two things come
between: the acceleration that the model does not know, c1 E, and on lateral axes thrust that is not the F0 with which
z is built (`response`), `coupling`.  Both are bounded offsets of v that do not add up, w in all: z keeps h at least
inner = sup |dh/dv| w, then (p, v) keeps h at least 0.  That costs gamma w of acceleration at a given h.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.barrier.condition import Setting
from flightstack.barrier.initial import DOWN
from flightstack.barrier.records import Authority, Margin, Response
from flightstack.barrier.shapes import K_EE, K_EV, K_VV, Barrier, Quadratic
from flightstack.types import F64


class Accuracy(NamedTuple):
    """How far estimates may be off, each axis."""

    pos_m: float
    vel_mps: float
    acc_mps2: float
    """Of the acceleration that the thrust axis as estimated gives: g times the tilt's error."""


class Doubts(NamedTuple):
    """How far the vehicle's answer to commands may be off."""

    delay_s: float = 0.004
    """The learner finds latency in steps of this."""
    lag_share: float = 0.2
    """Of the rotors' time constant."""
    rate_lag_share: float = 0.2
    """Of the rate loop's lag."""


USUAL = Doubts()
MOCAP = Accuracy(0.002, 0.01, 0.035)
GPS = Accuracy(0.2, 0.15, 0.1)


class Slopes(NamedTuple):
    """Suprema over the region {h >= -eta} and all commands in reach."""

    h_e: float
    """|dh/de|, 1/m."""
    h_v: float
    """|dh/dv|, s/m."""
    q_e: float
    """|dq/de| without gamma h at u = 0, 1/(m s)."""
    q_v: float
    """|dq/dv| without gamma h at u = 0, 1/m."""
    speed: float
    """|v|, m/s."""
    hold: float
    """What the time dt takes from q, 1/s."""
    flow_h: float
    """|dh/de v + dh/dv a|, 1/s: how fast h changes along the motion."""
    flow_q: float
    """|dq/de v + dq/dv a| without gamma h at u = 0, 1/s^2."""
    q_eu: float
    """What each m/s^2 of |u| adds to q_e, s/m^2."""
    q_vu: float
    """To q_v, s^2/m^2."""
    flow_qu: float
    """To flow_q, 1/m."""


def slopes(
    barrier: Barrier, low_mps2: float, high_mps2: float, error_mps2: float, dt_s: float, eta: float = 0.0
) -> Slopes:
    """For commands and accelerations from low to high and errors up to `error`."""
    ends = (low_mps2, high_mps2)
    return max_slopes([_piece_slopes(barrier, row, ends, error_mps2, dt_s, eta) for row in range(len(barrier.rows))])


def max_slopes(pieces: list[Slopes]) -> Slopes:
    """The greatest of each."""
    return Slopes(*(max(values) for values in zip(*pieces, strict=True)))


def _piece_slopes(
    barrier: Barrier, piece: int, ends: tuple[float, float], error: float, dt: float, eta: float
) -> Slopes:  # fmt: skip
    row, low, high = barrier.rows[piece], barrier.box[2], barrier.box[3]
    kee, kev, kvv, half = row[K_EE], abs(row[K_EV]), row[K_VV], 0.5 * dt
    command = max(abs(end) for end in ends)
    if isinstance(barrier, Quadratic):
        e, v = _edge(barrier, eta)
        speed = float(np.abs(v).max())
        h_e = -kee * (e - barrier.centre_m) - row[K_EV] * (v - barrier.centre_mps)
        h_v = -row[K_EV] * (e - barrier.centre_m) - kvv * (v - barrier.centre_mps)
    else:
        speed = max(-low, high) + eta * row[5] / row[3]  # on the way to stop, of which eta takes its share of the scale
        v = np.array([-speed, speed])
        h_e = np.full(2, -row[1] / row[5])
        h_v = -row[1] / row[5] * (row[3] + np.maximum(row[1] * v, -row[4] * row[3]) / row[4])
    turning = np.abs(h_e - row[K_EV] * v).max()
    flow_h = max(np.abs(h_e * v + h_v * a).max() for a in ends)
    flow_q = max(np.abs(kee * v * v - (h_e - row[K_EV] * v) * a).max() for a in ends)
    flow_qu = max(np.abs(row[K_EV] * v + kvv * a).max() for a in ends)
    kappa = dt * ((kee * half + kev) * (speed + command * half) + (kev * half + kvv) * command)
    kappa += half * (kvv + kev * dt + kee * half * half) * error
    held_e = kee * command * half + (kev + kee * half) * error  # what holding and the error add to the slopes of q
    held_v = dt * (kee * speed + kev * command) + half * (kee * dt + kev) * command
    held_v += (kvv + kev * half) * error + dt * (kee * half + kev) * error
    steep_e, steep_v = np.abs(h_e).max(), np.abs(h_v).max()
    hold = steep_e * half * command + half * kee * speed * (speed + dt * command) + dt * kev * speed * command
    hold += half * (kvv + kev * dt + kee * half * half) * command**2 + (steep_e * half + kappa) * error
    return Slopes(*(float(value) for value in (
        steep_e, steep_v, kee * speed + held_e, turning + held_v, speed, hold, flow_h,
        flow_q + held_e * speed + held_v * command, kev, kvv, flow_qu,
    )))  # fmt: skip


def _edge(barrier: Quadratic, eta: float) -> tuple[F64, F64]:
    """Points on the edge of {h >= -eta}, an ellipse grown by 1e-4 for what lies between them."""
    angle = np.linspace(0.0, 2.0 * math.pi, 361)
    p = np.array([[barrier.p11, barrier.p12], [barrier.p12, barrier.p22]])
    circle = np.stack([np.cos(angle), np.sin(angle)]) * math.sqrt(1.0 + eta) * (1.0 + 1e-4)
    e, v = np.linalg.solve(np.linalg.cholesky(p).T, circle)
    return e + barrier.centre_m, v + barrier.centre_mps


class _Source(NamedTuple):
    """One line before it is priced."""

    name: str
    eps_e: float
    eps_v: float
    late_s: float
    """Offset along the motion: by this time."""
    claim: float
    """Offset of v that only the claim on (p, v) has to bear, m/s."""
    because: str


def ledger(
    axis: int,
    barrier: Barrier,
    authority: Authority,
    response: Response,
    *,
    gamma_ps: float,
    dt_s: float,
    accuracy: Accuracy = MOCAP,
    doubts: Doubts = USUAL,
    gain_part_mps2: float = 0.0,
    coupling_mps: float = 0.0,
    inside_ps: float = 0.0,
) -> tuple[Setting, tuple[Margin, ...]]:
    """The condition's constants for one axis, and every margin in m/s^2.

    `gain_part_mps2`: how much of the error is the thrust gain's; `coupling_mps`: see above.  A margin in m/s^2 is
    (its part of b, of b_u times the hardest command, of gamma eta and of gamma inner) / max |dh/dv|.
    """
    least, most = float(authority.u_low_mps2.min()), float(authority.u_high_mps2.max())
    error = float(max(authority.error_low_mps2.max(), authority.error_high_mps2.max()))
    span = float((authority.u_high_mps2 - authority.u_low_mps2).max())
    eta, at = 0.0, slopes(barrier, least, most, error, dt_s)
    sources: tuple[_Source, ...] = ()
    for _ in range(3):  # eta widens the region whose slopes it comes from: a few parts in a hundred of itself
        at = slopes(barrier, least, most, error, dt_s, eta)
        sources = _sources(axis, response, span, error, accuracy, doubts, coupling_mps)
        eta = sum(_eta(at, source) for source in sources)
    rate, steep = sum(_rate(at, source) for source in sources), sum(_steep(at, source) for source in sources)
    claim = sum(source.claim for source in sources)
    brake = max(abs(least), abs(most))
    priced = {
        s.name: (
            (_rate(at, s) + brake * _steep(at, s) + gamma_ps * _eta(at, s)) / at.h_v + gamma_ps * s.claim,
            s.because,
        )
        for s in sources
        if s.name
    }
    low = float(authority.error_low_mps2.max())
    lines = {
        "gp_error": (
            low - gain_part_mps2,
            "bound of the acceleration's error at the braking end, less the gain's part",
        ),
        "thrust_gain": (gain_part_mps2, "bound of the thrust gain's error times the thrust beyond hover"),
        "discretisation": (0.0, "cells are covered with bounds that hold in all of each"),
        "zero_order_hold": (at.hold / at.h_v, f"a command holds {1e3 * dt_s:.3g} ms at most: part of the condition"),
        **priced,
    }
    order = ("gp_error", "thrust_gain", "discretisation", "zero_order_hold", "delay", "rotor_lag", "attitude_lag")
    margins = tuple(Margin(name, *lines[name]) for name in (*order, "estimate_error"))
    return Setting(gamma_ps, eta, rate, dt_s, steep, at.h_v * claim, inside_ps), margins


def _sources(
    axis: int, response: Response, span: float, error: float, accuracy: Accuracy, doubts: Doubts, coupling_mps: float
) -> tuple[_Source, ...]:
    c1, delay = response.c1_s, response.delay_s
    late = _Source(
        "delay", 0.5 * delay * delay * error, (doubts.delay_s + delay) * error, doubts.delay_s, 0.0,
        f"{1e3 * delay:.3g} ms known to {1e3 * doubts.delay_s:.3g} ms; the model's error over it",
    )  # fmt: skip
    rotor = attitude = _Source("", 0.0, 0.0, 0.0, 0.0, "")
    if axis == DOWN:
        lag = doubts.lag_share * c1
        rotor = _Source(
            "rotor_lag", 0.0, lag * span / math.e, lag, c1 * error,
            f"{1e3 * c1:.3g} ms known to {100 * doubts.lag_share:.3g} %; v within {c1 * error:.2g} m/s of what z keeps",
        )  # fmt: skip
        attitude = _Source("attitude_lag", 0.0, 0.0, 0.0, 0.0, "the lean is part of what thrust gives along down")
    else:
        lag = doubts.rate_lag_share * (response.c2_s2 / c1 if c1 > 0.0 else 0.0)
        claim = c1 * error + coupling_mps
        attitude = _Source(
            "attitude_lag", 0.5 * c1 * lag * span, lag * span, 0.0, claim,
            f"rate loop known to {1e3 * lag:.3g} ms; v within {claim:.2g} m/s of what z keeps: unknown acceleration "
            f"over {1e3 * c1:.3g} ms of steering, and thrust that is not the one steered with",
        )  # fmt: skip
        rotor = _Source(
            "rotor_lag", 0.0, 0.0, 0.0, 0.0, "thrust's lag moves lateral force by its share of the lean: attitude_lag"
        )
    estimate = _Source(
        "estimate_error",
        accuracy.pos_m + (c1 + delay) * accuracy.vel_mps + response.c2_s2 * accuracy.acc_mps2,
        accuracy.vel_mps + (c1 + delay) * accuracy.acc_mps2, 0.0, 0.0,
        f"position {1e3 * accuracy.pos_m:.3g} mm, velocity {1e2 * accuracy.vel_mps:.3g} cm/s, "
        f"acceleration {accuracy.acc_mps2:.2g} m/s^2",
    )  # fmt: skip
    return late, rotor, attitude, estimate


def _rate(at: Slopes, source: _Source) -> float:
    return at.q_e * source.eps_e + at.q_v * source.eps_v + at.flow_q * source.late_s


def _steep(at: Slopes, source: _Source) -> float:
    return at.q_eu * source.eps_e + at.q_vu * source.eps_v + at.flow_qu * source.late_s


def _eta(at: Slopes, source: _Source) -> float:
    return at.h_e * source.eps_e + at.h_v * source.eps_v + at.flow_h * source.late_s
