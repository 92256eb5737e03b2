"""The ledger: what estimate, delay and lags may cost, turned into the constants of the barrier condition.

The condition (`condition`) is checked at a predicted state z^; what counts is the true one.  Every source says by how
much z^ = (e, v) may be off: by (eps_e, eps_v), and *along the motion* by a time t: (t v, t a), a an acceleration in
reach.  S is the span between the ends of the command, A the hardest of them, E the greatest doubt of the acceleration:

    estimate   position + (c1 + delay) velocity + c2 lead + (c1 delay + delay^2 / 2) acceleration,
               velocity + c1 lead + delay acceleration, as reported; lead: the acceleration's error at the thrust F0
               with which z is built (`response`), sideways F0 over the greatest thrust of it
    delay      t = d, the doubt of the time until a command has acted, in which commands act that were not counted, with
               d E; and the model's error over the delay itself, (delay^2 / 2 + c1 delay) E and delay E
    age        the newest sample is A old: over this time too the model predicts (`under_way`), with the commands that
               were sent and the means of this certificate.  The state at the sample is as the estimate says, so the
               delay's and the lags' doubts are what they are without an age; velocity adds A velocity to the position,
               and the whole error E (the attitude's part in it) what it gives in A more: (A delay + A^2 / 2 + A c1) E
               and A E
    rotor lag  the learner fits the delay with the lag as believed, so what it knows is their sum: a lag longer by l
               comes with a delay shorter by l.  The velocity that a command gives then follows another course to the
               same end; the two differ by l / e at most on either side, so z's speed is off by l S / e, and its
               position by A (c1 + l / 2) l, from the second moments.  Sideways thrust's lag is not in the way, and the
               delay there is off by l as well
    steering   the rate loop's lag is off by r, seen through T = c1: T r S / 2, and r S, as jerk is at most S / T
    lead       z_e grows by z_v and by w: by the acceleration that the model does not know, c1 E, and on lateral axes by
               thrust that is not the F0 with which z is built (`response`), `coupling`.  So much the speed of z is off:
               w, a part of rotor lag and steering

Measurement-robust barrier functions: all sources together are a box about z^ in which the true state lies.  The
condition itself takes from q what may be lost in that box (`condition`: off); h may be less there by

    eta = sup (|dh/de| eps_e + |dh/dv| eps_v + t |dh/de v + dh/dv a|)

over all accelerations a in reach and all states of the region.  (h is concave: h(z^) <= h(z) + grad h(z) (z^ - z), so
the slopes at the true state bound it.)  Source: S. Dean, A. Taylor, R. Cosner, B. Recht, A. Ames, "Guaranteeing safety
of learned perception modules via measurement-robust control barrier functions", CoRL 2020, theorem 2.  On an ellipse
each of these is greatest on its edge; a stopping way's are greatest at the greatest speed.

A margin in m/s^2 is what its source takes from q, with gamma times its part of eta, where braking is hardest, over
sup |dh/dv| there: on an ellipse at e = 0 and the greatest speed that there is there.

Between z and (p, v).  p + c1 v is z_e and v + c1 v' is z_v + w: (p, v) follows (z_e, z_v + w) through the low pass
1 / (c1 s + 1), is a weighted mean of where that has been, and that lies in the box about z^ in which h is at least 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.barrier.condition import Setting
from flightstack.barrier.initial import DOWN
from flightstack.barrier.records import MARGINS, Authority, Margin, Response
from flightstack.barrier.shapes import (
    BRAKE,
    CENTRE_V,
    K_EE,
    K_EV,
    K_VV,
    KIND,
    P11,
    P12,
    P22,
    REACTION,
    SCALE,
    SIGN,
    STOPPING,
    Barrier,
    Quadratic,
)
from flightstack.jit import njit, njit_called
from flightstack.types import F64


class Accuracy(NamedTuple):
    """How far estimates may be off, each axis."""

    pos_m: float
    vel_mps: float
    acc_mps2: float
    """Of the acceleration that the thrust axis as estimated gives, at the greatest thrust."""
    lead_share: float = 1.0
    """Of that, what it is off by at the thrust with which z is built."""


class Doubts(NamedTuple):
    """How far the vehicle's answer to commands may be off."""

    delay_s: float = 0.004
    """Of delay and lag together: the learner finds latency in steps of this."""
    lag_share: float = 0.2
    """Of the rotors' time constant."""
    rate_lag_share: float = 0.2
    """Of the rate loop's lag."""
    rotor_lag_s: float = 0.0
    """The rotors' time constant as believed: what its doubt puts wrong into the delay counts on the lateral axes."""
    age_s: float = 0.002
    """Greatest age of the newest sample: a premise, watched."""


USUAL = Doubts()
KNOWN = Accuracy(0.0, 0.0, 0.0)
"""The state is the truth itself."""


class Slopes(NamedTuple):
    """Suprema over the region {h >= -eta} and all commands in reach."""

    h_e: float
    """|dh/de|, 1/m."""
    h_v: float
    """|dh/dv|, s/m."""
    speed: float
    """|v|, m/s."""
    hold: float
    """What the time dt takes from q, 1/s."""
    flow_h: float
    """|dh/de v + dh/dv a|, 1/s: how fast h changes along the motion."""


def _fastest(barrier: Barrier) -> tuple[float, float]:
    """Least and greatest speed; of an ellipse nobody asks."""
    return (0.0, 0.0) if isinstance(barrier, Quadratic) else barrier.box[2:]


@njit_called
def _constants(rows: F64, fastest: tuple[float, float], given: F64, circle: F64) -> tuple[float, tuple[float, ...]]:
    """eta, and `_slopes` with the eta before it.

    `given`: ends of the command, error, time, and by how much all sources together are off: of e, v, along the motion.
    """
    eta, at = 0.0, _slopes(rows, fastest, given, 0.0, circle)
    for k in range(3):  # eta widens the region whose slopes it comes from: a few parts in a hundred of itself
        if k > 0:
            at = _slopes(rows, fastest, given, eta, circle)
        eta = max(0.0, at[-1])
    return eta, at


@njit_called
def _slopes(
    rows: F64, fastest: tuple[float, float], given: F64, eta: float, circle: F64
) -> tuple[float, float, float, float, float, float]:
    """`Slopes` over all pieces, and what h loses at most by the offsets; NaN where one is."""
    dt, error, half = given[_TIME], given[_ERROR], 0.5 * given[_TIME]
    command = max(abs(given[_LOW]), abs(given[_HIGH]))
    most_e = most_v = most_speed = most_hold = most_flow = most_lost = -np.inf
    for i in range(rows.shape[0]):
        row = rows[i]
        kee, kev, kvv = row[K_EE], abs(row[K_EV]), row[K_VV]
        speed, steep_e, steep_v, flow_h, lost = _greatest(row, fastest, given, eta, circle)
        kappa = dt * ((kee * half + kev) * (speed + command * half) + (kev * half + kvv) * command)
        kappa += half * (kvv + kev * dt + kee * half * half) * error
        hold = steep_e * half * command + half * kee * speed * (speed + dt * command) + dt * kev * speed * command
        hold += half * (kvv + kev * dt + kee * half * half) * command**2 + (steep_e * half + kappa) * error
        if math.isnan(hold + lost):
            return np.nan, np.nan, np.nan, np.nan, np.nan, np.nan
        most_e, most_v, most_speed = max(most_e, steep_e), max(most_v, steep_v), max(most_speed, speed)
        most_hold, most_flow, most_lost = max(most_hold, hold), max(most_flow, flow_h), max(most_lost, lost)
    return most_e, most_v, most_speed, most_hold, most_flow, most_lost


@njit
def _greatest(
    row: F64, fastest: tuple[float, float], given: F64, eta: float, circle: F64
) -> tuple[float, float, float, float, float]:
    """Of a piece on the edge of {h >= -eta}, where slopes are greatest, what is greatest: |v|, |dh/de|, |dh/dv|, the
    flow of h for accelerations at both ends, and what h loses by the offsets; NaN where one is."""
    speed = steep_e = steep_v = flow = lost = -np.inf
    ellipse = row[KIND] != STOPPING
    r11 = r12 = r22 = scale = fast = 0.0
    if ellipse:  # points on it, grown by 1e-4 for what lies between them: R z = circle, R' R = P
        r11 = math.sqrt(row[P11])
        r12 = row[P12] / r11
        r22 = math.sqrt(row[P22] - r12 * r12)
        scale = math.sqrt(1.0 + eta) * (1.0 + 1e-4)
    else:  # on the way to stop, of which eta takes its share of the scale
        fast = max(-fastest[0], fastest[1]) + eta * row[SCALE] / row[REACTION]
    for k in range(circle.shape[1] if ellipse else 2):
        if ellipse:
            dv = scale * circle[1, k] / r22
            de = (scale * circle[0, k] - r12 * dv) / r11
            v = dv + row[CENTRE_V]
            h_e, h_v = -row[K_EE] * de - row[K_EV] * dv, -row[K_EV] * de - row[K_VV] * dv
        else:
            v = fast if k else -fast
            slow = max(row[SIGN] * v, -row[BRAKE] * row[REACTION])
            h_e, h_v = -row[SIGN] / row[SCALE], -row[SIGN] / row[SCALE] * (row[REACTION] + slow / row[BRAKE])
        along, e, s = h_e * v, abs(h_e), abs(h_v)
        here = max(abs(along + h_v * given[_LOW]), abs(along + h_v * given[_HIGH]))
        less = e * given[_OFF_E] + s * given[_OFF_V] + given[_OFF_LATE] * here
        if math.isnan(less):
            return np.nan, np.nan, np.nan, np.nan, np.nan
        speed, steep_e, steep_v = max(speed, abs(v)), max(steep_e, e), max(steep_v, s)
        flow, lost = max(flow, here), max(lost, less)
    return speed, steep_e, steep_v, flow, lost


def brakes(barrier: Barrier, low_mps2: float, high_mps2: float) -> tuple[float, float, float]:
    """Where braking is hardest: what q loses there for each m and each m/s of offset, and |dh/dv|; of both ways."""
    lost = (0.0, 0.0, 0.0)
    for row in barrier.rows:
        if isinstance(barrier, Quadratic):
            fast = 1.0 / math.sqrt(barrier.p22)
            sides = [(barrier.centre_mps + fast, fast, low_mps2), (barrier.centre_mps - fast, -fast, high_mps2)]
            found = [
                (
                    abs(row[K_EE] * v + row[K_EV] * u),
                    abs(-row[K_EV] * out - row[K_EV] * v - row[K_VV] * u),
                    row[K_VV] * fast,
                )
                for v, out, u in sides
            ]
        else:
            slowest, fastest = barrier.box[2:]
            v, u = (fastest, low_mps2) if row[SIGN] > 0.0 else (-slowest, high_mps2)
            found = [(0.0, 1.0 / row[SCALE] + row[K_VV] * abs(u), (row[REACTION] + v / row[BRAKE]) / row[SCALE])]
        for each in found:
            lost = (max(lost[0], each[0] / each[2]), max(lost[1], each[1] / each[2]), max(lost[2], each[2]))
    return float(lost[0]), float(lost[1]), float(lost[2])


_ANGLE = np.linspace(0.0, 2.0 * math.pi, 361)
_CIRCLE = np.stack([np.cos(_ANGLE), np.sin(_ANGLE)])
_LOW, _HIGH, _ERROR, _TIME, _OFF_E, _OFF_V, _OFF_LATE = range(7)


class _Source(NamedTuple):
    """One line before it is priced."""

    name: str
    eps_e: float
    eps_v: float
    late_s: float
    """Offset along the motion: by this time."""
    because: str


class Ledger:
    """What a barrier of one axis needs, whichever it is: the condition's constants, and every margin; final."""

    __slots__ = ("_authority", "_given", "_known", "_parts", "_sources", "accuracy", "dt_s", "gamma_ps", "inside_ps")

    def __init__(
        self,
        axis: int,
        authority: Authority,
        response: Response,
        *,
        gamma_ps: float,
        dt_s: float,
        accuracy: Accuracy = KNOWN,
        doubts: Doubts = USUAL,
        gain_part_mps2: float = 0.0,
        torque_part_mps2: float = 0.0,
        coupling_mps: float = 0.0,
        inside_ps: float = 0.0,
    ) -> None:
        """`gain_part_mps2`, `torque_part_mps2`: how much of the error is the thrust gain's, and torque's;
        `coupling_mps`: see above."""
        self.gamma_ps, self.dt_s, self.accuracy, self.inside_ps = gamma_ps, dt_s, accuracy, inside_ps
        self._authority, self._parts = authority, (gain_part_mps2, torque_part_mps2)
        least, most = float(authority.u_low_mps2.min()), float(authority.u_high_mps2.max())
        error = float(max(authority.error_low_mps2.max(), authority.error_high_mps2.max()))
        span = float((authority.u_high_mps2 - authority.u_low_mps2).max())
        hardest = max(abs(least), abs(most))
        self._sources = _sources(
            axis, response, span, hardest, error - accuracy.acc_mps2, accuracy, doubts, coupling_mps
        )
        off = [sum(getattr(each, part) for each in self._sources) for part in ("eps_e", "eps_v", "late_s")]
        self._given = np.array([least, most, error, dt_s, *off])
        self._known: dict[Barrier, tuple[Setting, Slopes]] = {}
        """A search asks for the same barrier again and again."""

    def __call__(self, barrier: Barrier) -> tuple[Setting, tuple[Margin, ...]]:
        """The condition's constants, and every margin in m/s^2."""
        return self.setting(barrier), self.margins(barrier)

    def setting(self, barrier: Barrier) -> Setting:
        """The condition's constants."""
        return self._at(barrier)[0]

    def _at(self, barrier: Barrier) -> tuple[Setting, Slopes]:
        found = self._known.get(barrier)
        if found is None:
            eta, (*parts, _) = _constants(barrier.rows, _fastest(barrier), self._given, _CIRCLE)
            at = Slopes(*parts)
            off_m, off_mps = (sum(each[i] for each in self._offsets(at)) for i in range(2))
            setting = Setting(self.gamma_ps, eta, 0.0, self.dt_s, off_m, 0.0, self.inside_ps, off_mps)
            found = self._known[barrier] = setting, at
        return found

    def _offsets(self, at: Slopes) -> list[tuple[float, float]]:
        hardest = max(abs(self._given[_LOW]), abs(self._given[_HIGH]))
        return [(s.eps_e + s.late_s * at.speed, s.eps_v + s.late_s * hardest) for s in self._sources]

    def margins(self, barrier: Barrier) -> tuple[Margin, ...]:
        """Every margin in m/s^2."""
        _, at = self._at(barrier)
        least, most, *_ = self._given.tolist()
        (gain_part_mps2, torque_part_mps2), accuracy = self._parts, self.accuracy
        per_m, per_mps, steep = brakes(barrier, least, most)
        priced = {
            s.name: (
                per_m * off_m + per_mps * off_mps + self.gamma_ps * _eta(at, s) / steep,
                s.because,
            )
            for s, (off_m, off_mps) in zip(self._sources, self._offsets(at), strict=True)
            if s.name
        }
        low = float(self._authority.error_low_mps2.max())
        lines = {
            "gp_error": (
                low - gain_part_mps2 - torque_part_mps2 - accuracy.acc_mps2,
                "bound of the acceleration's error at the braking end, less the gain's, torque's and the attitude's "
                "parts",
            ),
            "torque": (
                torque_part_mps2, "thrust that torque adds through the rotors' curve, within the governor's limits"
            ),
            "thrust_gain": (gain_part_mps2, "bound of the thrust gain's error times the thrust beyond hover"),
            "discretisation": (0.0, "cells are covered with bounds that hold in all of each"),
            "zero_order_hold": (
                at.hold / at.h_v, f"a command holds {1e3 * self.dt_s:.3g} ms at most: part of the condition"
            ),
            **priced,
        }  # fmt: skip
        worth, because = lines["estimate_error"]
        lines["estimate_error"] = (worth + accuracy.acc_mps2, because)
        return tuple(Margin(name, *lines[name]) for name in MARGINS)


def _sources(
    axis: int, response: Response, span: float, hardest: float, error: float, accuracy: Accuracy, doubts: Doubts,
    coupling_mps: float,
) -> tuple[_Source, ...]:  # fmt: skip
    c1, delay = response.c1_s, response.delay_s
    t = doubts.delay_s + (0.0 if axis == DOWN else doubts.lag_share * doubts.rotor_lag_s)
    late = _Source(
        "delay", (0.5 * delay + c1) * delay * error, (t + delay) * error, t,
        f"{1e3 * delay:.3g} ms known to {1e3 * t:.3g} ms; the model's error over it",
    )  # fmt: skip
    rotor = attitude = _Source("", 0.0, 0.0, 0.0, "")
    apart = c1 * error + coupling_mps
    if axis == DOWN:
        lag = doubts.lag_share * c1
        rotor = _Source(
            "rotor_lag", hardest * (c1 + 0.5 * lag) * lag, lag * span / math.e + apart, 0.0,
            f"{1e3 * c1:.3g} ms known to {100 * doubts.lag_share:.3g} %; z moves {apart:.2g} m/s apart from its speed",
        )  # fmt: skip
        attitude = _Source("attitude_lag", 0.0, 0.0, 0.0, "the lean is part of what thrust gives along down")
    else:
        lag = doubts.rate_lag_share * (response.c2_s2 / c1 if c1 > 0.0 else 0.0)
        attitude = _Source(
            "attitude_lag", 0.5 * c1 * lag * span, lag * span + apart, 0.0,
            f"rate loop known to {1e3 * lag:.3g} ms; z moves {apart:.2g} m/s apart from its speed: acceleration "
            f"unknown over {1e3 * c1:.3g} ms of steering, and thrust that is not the one steered with",
        )  # fmt: skip
        rotor = _Source(
            "rotor_lag", 0.0, 0.0, 0.0, "thrust's lag moves lateral force by its share of the lean: attitude_lag"
        )
    old, whole = doubts.age_s, error + accuracy.acc_mps2
    age = _Source(
        "age",
        old * (accuracy.vel_mps + (c1 + delay + 0.5 * old) * whole), old * whole, 0.0,
        f"the newest sample {1e3 * old:.3g} ms old, over which the model may be off by {whole:.2g} m/s^2",
    )  # fmt: skip
    acc, lead = accuracy.acc_mps2, accuracy.lead_share * accuracy.acc_mps2
    estimate = _Source(
        "estimate_error",
        accuracy.pos_m + (c1 + delay) * accuracy.vel_mps + response.c2_s2 * lead + (c1 + 0.5 * delay) * delay * acc,
        accuracy.vel_mps + c1 * lead + delay * acc, 0.0,
        f"position {1e3 * accuracy.pos_m:.3g} mm, velocity {1e2 * accuracy.vel_mps:.3g} cm/s, "
        f"acceleration {accuracy.acc_mps2:.2g} m/s^2",
    )  # fmt: skip
    return late, age, rotor, attitude, estimate


def _eta(at: Slopes, source: _Source) -> float:
    return at.h_e * source.eps_e + at.h_v * source.eps_v + at.flow_h * source.late_s
