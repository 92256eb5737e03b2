"""The ledger: what estimate, delay and lags may cost, turned into the constants of the barrier condition.

The condition (`condition`) is checked at a predicted state z^; what counts is the true one.  Every source says by how
much z^ = (e, v) may be off, (eps_e, eps_v), with the axis' greatest speed V in the region, its greatest commanded
acceleration U, the span S between the ends of the command, and E, the greatest doubt of the acceleration:

    estimate   position + (c1 + delay) velocity + c2 acceleration, velocity + c1 acceleration errors, as reported
    delay      d V + delay^2 E / 2,  d (U + E) + delay E    d: doubt of the delay, in which commands act that were not
                                                            counted; and the model's error over the delay itself
    lag (c1)   l V,  l (U + S / exp(1))     z = (p + c1 v, v + c1 a) is built with c1 off by l, and with an acceleration
                                            whose own lag is off by l, which after a step differs by S l / (c1 exp(1))
    steering   T r U,  r S                  the rate loop's lag is off by r, seen through T = c1; jerk is at most S / c1

Measurement-robust barrier functions: with q at z^ at least b, q at z is not below 0 where

    b >= sup |dq/de| eps_e + sup |dq/dv| eps_v       (b without gamma h, whose doubt is eta)
    eta >= sup |dh/de| eps_e + sup |dh/dv| eps_v

for all commands in reach and all states of the region.  (h is concave: h(z^) <= h(z) + grad h(z) (z^ - z), so the slopes
at the true state bound it.)  Source: S. Dean, A. Taylor, R. Cosner, B. Recht, A. Ames, "Guaranteeing safety of learned
perception modules via measurement-robust control barrier functions", CoRL 2020, theorem 2.

(p, v) itself follows z through the low pass 1 / (c1 s + 1) only if v + c1 v' = z_v.  Two things come between: the
acceleration that the model does not know, c1 E, and on lateral axes thrust that is not the F0 with which z is built
(`response`), `coupling`.  Both are bounded offsets of v and enter eta: h >= 0 is claimed of (p, v).

Suprema in closed form.  An ellipse h = 1 - d^T P d, d = z - c, on {h >= -eta}: sup |alpha^T d| = sqrt(1 + eta)
sqrt(alpha^T P^-1 alpha); a stopping way's slopes are greatest at the greatest speed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.barrier.condition import Setting
from flightstack.barrier.initial import DOWN
from flightstack.barrier.records import Authority, Margin, Response
from flightstack.barrier.shapes import K_EE, K_EV, K_VV, Barrier, Quadratic


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


MOCAP = Accuracy(0.002, 0.01, 0.035)
GPS = Accuracy(0.2, 0.15, 0.1)


class Slopes(NamedTuple):
    """Suprema over the region {h >= -eta} and all commands in reach."""

    h_e: float
    """|dh/de|, 1/m."""
    h_v: float
    """|dh/dv|, s/m."""
    q_e: float
    """|dq/de| without gamma h, 1/(m s)."""
    q_v: float
    """|dq/dv| without gamma h, 1/m."""
    speed: float
    """|v|, m/s."""
    hold: float
    """What the time dt takes from q, 1/s."""


def slopes(barrier: Barrier, command: float, error: float, dt_s: float, eta: float = 0.0) -> Slopes:
    """For commands up to `command` and errors up to `error`, both m/s^2."""
    return max_slopes([_piece_slopes(barrier, row, command, error, dt_s, eta) for row in range(len(barrier.rows))])


def max_slopes(pieces: list[Slopes]) -> Slopes:
    """The greatest of each."""
    return Slopes(*(max(values) for values in zip(*pieces, strict=True)))


def _piece_slopes(barrier: Barrier, piece: int, command: float, error: float, dt: float, eta: float) -> Slopes:
    row, low, high = barrier.rows[piece], barrier.box[2], barrier.box[3]
    kee, kev, kvv, half = row[K_EE], abs(row[K_EV]), row[K_VV], 0.5 * dt
    if isinstance(barrier, Quadratic):
        grown = math.sqrt(1.0 + eta)
        p = np.array([[barrier.p11, barrier.p12], [barrier.p12, barrier.p22]])
        middle = barrier.centre_mps
        speed = max(abs(middle + sign * grown * 0.5 * (high - low)) for sign in (-1.0, 1.0))
        h_e, h_v = 2.0 * grown * math.sqrt(barrier.p11), 2.0 * grown * math.sqrt(barrier.p22)
        along = np.array([2.0 * barrier.p11, 4.0 * barrier.p12])
        turning = abs(2.0 * barrier.p12 * middle) + grown * math.sqrt(float(along @ np.linalg.solve(p, along)))
    else:
        more = eta * row[5] / row[3]  # the way to stop from the greatest speed grows by eta times the scale at most
        speed = max(-low, high) + more
        h_e, h_v = 1.0 / row[5], (row[3] + speed / row[4]) / row[5]
        turning = h_e
    kappa = dt * ((kee * half + kev) * (speed + command * half) + (kev * half + kvv) * command)
    kappa += half * (kvv + kev * dt + kee * half * half) * error
    q_e = kee * speed + kev * command + kee * command * half + (kev + kee * half) * error
    q_v = turning + kvv * command + dt * (kee * speed + kev * command) + half * (kee * dt + kev) * command
    q_v += (kvv + kev * half) * error + dt * (kee * half + kev) * error
    hold = h_e * half * command + half * kee * speed * (speed + dt * command) + dt * kev * speed * command
    hold += half * (kvv + kev * dt + kee * half * half) * command**2 + (h_e * half + kappa) * error
    return Slopes(h_e, h_v, q_e, q_v, speed, hold)


class _Source(NamedTuple):
    """One line before it is priced."""

    name: str
    eps_e: float
    eps_v: float
    claim: float
    """More offset of v that only the claim on (p, v) has to bear."""
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
    doubts: Doubts = Doubts(),
    gain_part_mps2: float = 0.0,
    coupling_mps: float = 0.0,
) -> tuple[Setting, tuple[Margin, ...]]:
    """The condition's constants for one axis, and every margin in m/s^2.

    `gain_part_mps2`: how much of the error is the thrust gain's; `coupling_mps`: see above.  A margin in m/s^2 is
    (its part of b + gamma its part of eta) / max |dh/dv|.
    """
    command = float(max(np.abs(authority.u_low_mps2).max(), np.abs(authority.u_high_mps2).max()))
    error = float(max(authority.error_low_mps2.max(), authority.error_high_mps2.max()))
    span = float((authority.u_high_mps2 - authority.u_low_mps2).max())
    eta, at = 0.0, slopes(barrier, command, error, dt_s)
    sources: tuple[_Source, ...] = ()
    for _ in range(3):  # eta widens the region whose slopes it comes from: a few parts in a hundred of itself
        at = slopes(barrier, command, error, dt_s, eta)
        sources = _sources(axis, response, at.speed, command, span, error, accuracy, doubts, coupling_mps)
        eta = sum(_eta(at, source) for source in sources)
    rate = sum(_rate(at, source) for source in sources)
    priced = {s.name: ((_rate(at, s) + gamma_ps * _eta(at, s)) / at.h_v, s.because) for s in sources}
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
    return Setting(gamma_ps, eta, rate, dt_s), margins


def _sources(
    axis: int, response: Response, speed: float, command: float, span: float, error: float, accuracy: Accuracy,
    doubts: Doubts, coupling_mps: float,
) -> tuple[_Source, ...]:  # fmt: skip
    c1, delay = response.c1_s, response.delay_s
    late = _Source(
        "delay", doubts.delay_s * speed + 0.5 * delay * delay * error,
        doubts.delay_s * (command + error) + delay * error, 0.0,
        f"{1e3 * delay:.3g} ms known to {1e3 * doubts.delay_s:.3g} ms; the model's error over it",
    )  # fmt: skip
    rotor = attitude = _Source("", 0.0, 0.0, 0.0, "")
    if axis == DOWN:
        lag = doubts.lag_share * c1
        rotor = _Source(
            "rotor_lag", lag * speed, lag * (command + span / math.e), c1 * error,
            f"{1e3 * c1:.3g} ms known to {100 * doubts.lag_share:.3g} %; unknown acceleration over the lag",
        )  # fmt: skip
        attitude = _Source("attitude_lag", 0.0, 0.0, 0.0, "the lean is part of what thrust gives along down")
    else:
        lag = doubts.rate_lag_share * (response.c2_s2 / c1 if c1 > 0.0 else 0.0)
        attitude = _Source(
            "attitude_lag", c1 * lag * command, lag * span, c1 * error + coupling_mps,
            f"rate loop known to {1e3 * lag:.3g} ms; unknown acceleration over {1e3 * c1:.3g} ms of steering; "
            f"{coupling_mps:.3g} m/s while thrust is not the one steered with",
        )  # fmt: skip
        rotor = _Source("rotor_lag", 0.0, 0.0, 0.0, "thrust's lag moves lateral force by its share of the lean, above")
    estimate = _Source(
        "estimate_error",
        accuracy.pos_m + (c1 + delay) * accuracy.vel_mps + response.c2_s2 * accuracy.acc_mps2,
        accuracy.vel_mps + (c1 + delay) * accuracy.acc_mps2, 0.0,
        f"position {1e3 * accuracy.pos_m:.3g} mm, velocity {1e2 * accuracy.vel_mps:.3g} cm/s, "
        f"acceleration {accuracy.acc_mps2:.2g} m/s^2",
    )  # fmt: skip
    return late, rotor, attitude, estimate


def _rate(at: Slopes, source: _Source) -> float:
    return at.q_e * source.eps_e + at.q_v * source.eps_v


def _eta(at: Slopes, source: _Source) -> float:
    return at.h_e * source.eps_e + at.h_v * (source.eps_v + source.claim)
