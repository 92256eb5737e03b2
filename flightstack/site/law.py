"""How a way out is followed: what lean is asked for, and how fast it is turned towards; compiled.

Across, the vehicle is three integrals and two lags behind the snap that torque gives, and of that there is little.  A
linear loop that asks for more swings on, by metres.  So lean that is asked for grows with less than the speed e to be
taken back,

    S^(1/3) e^(2/3) ASKED_SHARE at most

(what snap S can do in the time that it takes); lean is turned towards no faster than it can be stopped with TURN_SHARE
of the snap; the rate that is asked for leads the one that there is, which takes most of the rate loop's lag away, and
asks for no more than the snap, in the direction that is wanted (the governor, which takes each axis for itself, would
turn it away),

    s = (1 + LEAD_S / L) (c - j) / L - LEAD_S T / L^2 s_0,    |s| <= S

with c the rate, j the one that there is, s_0 what it changes by, L and T the lags of rates and rotors; and of the force
that is seen only SEEN_SHARE is leant against, for one that turns round has to be leant against the other way.
`worst` drives a loop that is closed so as far from its way as it goes; shares and gains are what makes that least.
"""

from __future__ import annotations

import math

from flightstack.jit import njit

ASKED_SHARE, TURN_SHARE, LEAD_S, SEEN_SHARE = 0.5, 0.5, 0.05, 0.85
_SURELY = 0.99
PLACE_SHARE, TURN_PER_POLE = 0.5, 3.0
"""Gains by one pole p: lean p e_v + PLACE_SHARE p^2 e_p, turned towards at TURN_PER_POLE p."""


@njit
def asked(lin_mps2: float, vel_ps: float, snap_mps4: float) -> float:
    """Of a lean that the linear loop asks for, the share that is asked for; vel_ps: lean by speed."""
    if 1e-6 < lin_mps2 < _SURELY * ASKED_SHARE**3 * snap_mps4 / (vel_ps * vel_ps):
        return 1.0  # nearly always: a power takes as long as a whole step of the loop otherwise does
    most = ASKED_SHARE * snap_mps4 ** (1.0 / 3.0) * (lin_mps2 / vel_ps) ** (2.0 / 3.0)
    return min(1.0, most / max(lin_mps2, 1e-9))  # type: ignore[no-any-return]


@njit
def turn_towards(short_mps2: float, turn_ps: float, snap_mps4: float, late_s: float) -> float:
    """Rate of turning (m/s^3) towards a lean that is so far away: it can be stopped again, although it is late."""
    snap = TURN_SHARE * snap_mps4
    late = snap * late_s
    return min(turn_ps * short_mps2, math.sqrt(late * late + 2.0 * snap * short_mps2) - late)


@njit
def snap_asked(
    rate: tuple[float, float], jerk: tuple[float, float], snap: tuple[float, float], most: float,
    lags_s: tuple[float, float],
) -> tuple[float, float]:  # fmt: skip
    """The snap (north, east) towards a rate of turning (m/s^3), from the one that there is and what it changes by."""
    lag, rotors = lags_s
    lead, damped = (1.0 + LEAD_S / lag) / lag, LEAD_S * rotors / (lag * lag)
    north = lead * (rate[0] - jerk[0]) - damped * snap[0]
    east = lead * (rate[1] - jerk[1]) - damped * snap[1]
    share = min(1.0, most / max(math.sqrt(north * north + east * east), 1e-9))
    return share * north, share * east


def led_lags(lag_s: float, rotors_s: float) -> tuple[float, float]:
    """The lags of a loop without a lead that answers as this one does with it: T s' = (c - j) / L - s again."""
    more = 1.0 + LEAD_S * rotors_s / lag_s**2
    return lag_s * more / (1.0 + LEAD_S / lag_s), rotors_s / more
