"""How fast a governed lean turns round, and which accelerations sideways leave enough room to turn.

Sideways the filter acts through body rates: u = a + K w, a = offset - gain F b3 what the lean gives as it is, w the
commanded lean rate, K = gain F0 T (`response`).  The condition takes u for something that can be changed at once; but
the governor (`governor`) changes commanded rates by s (t - t0) in a time t only, and meanwhile the lean goes on,
a' = gain F0 w.  So from a command u on, what is sent differs from the braking u_b that the edge will ask for by

    y(t) = u - u_b + gain F0 w t                                                  until t0
         = y(t0) + (gain F0 w - K s) (t - t0) - gain F0 s (t - t0)^2 / 2          until it is 0, at t1

where w is the greater of the commanded and the predicted lean rate.  Until t1, z moves as (e, v)'' = u_b + y: in closed
form.  A command is let through if z(t1) is still inside (x >= 0, x of `condition`); u_b is the lesser of what the flat
line of alpha allows here and what it allows there.  What it allows here is always let through.  With that the steep
line of alpha needs no knee: alpha = (gamma + inside) x.

s: the governor leaves each of roll and pitch r_max / sqrt(2) of torque whatever the other does, the copy with the least
alpha needs most of it, and thrust is at least the budget's: (1 - alpha_share) alpha(u_low) r_max / sqrt(2), over chi
for what a peak is beyond the steady torque.  t0: the rate loop's lag, by which lean rates follow commanded ones.  That
the governor turns commands so fast with both axes dithered is tested in `tests/unit/test_turning.py`, that what this
leaves out (thrust that changes the lean's part, yaw, turning back) stays within the ledger in `tests/attack`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.autopilot import effectiveness, mixer
from flightstack.barrier.condition import Reach, Setting, doubt_of, interval
from flightstack.barrier.shapes import piece_at
from flightstack.barrier.torque import GovernorTerms
from flightstack.frames import quat_to_matrix
from flightstack.jit import njit, njit_called
from flightstack.model import Model
from flightstack.rate_loop import steepness
from flightstack.types import F64
from flightstack.vehicle import Rotors

_HALVINGS = 7
"""The command is found to a 128th of the span."""


def turning(terms: GovernorTerms, model: Model, low_mps2: float) -> tuple[float, float]:
    """(s, t0), rad/s^2 and s: commanded roll and pitch rate change by s (t - t0) at least.

    low_mps2: least thrust, believed newton per believed kilogram.
    """
    vehicle = terms.vehicle
    rotors = Rotors(
        position_m=np.array(vehicle["position_m"], dtype=np.float64),
        torque_ratio_m=np.array(vehicle["torque_ratio_m"], dtype=np.float64),
        max_thrust_n=0.25 * vehicle["max_thrust_n"], max_speed_radps=1.0,
        thrust_model_factor=vehicle["thrust_model_factor"], time_constant_s=vehicle["rotor_lag_s"], radius_m=0.1,
    )  # fmt: skip
    moment_nm = np.diag(effectiveness(rotors)[:2] @ mixer(rotors)[:, :2]) * rotors.max_thrust_n
    norm = model.norm_of(low_mps2 * model.mass_kg)
    bend = steepness(norm, vehicle["thrust_model_factor"], terms.autopilot["thr_mdl_fac"])
    alpha = float((moment_nm / np.array(vehicle["inertia_kgm2"])[:2]).min()) * bend
    least = (1.0 - vehicle["alpha_share"]) * alpha * terms.roll_pitch_max * math.sqrt(0.5)
    return least / terms.chi, model.rate_lag_s


@njit_called
def stays_within(q_ned_frd: F64, rate_frd_radps: F64, leans: F64, turn_radps2: float, wait_s: float) -> bool:
    """Whether the leans are within these, (4,) least and most to north and to east, and turn no faster than can be
    stopped there, by s and t0; s 0: nothing is governed, only the leans are asked for."""
    r = quat_to_matrix(q_ned_frd)
    for k in range(2):
        lean, rate = r[k, 2], rate_frd_radps[1] * r[k, 0] - rate_frd_radps[0] * r[k, 1]
        on = rate * (wait_s + 0.5 * abs(rate) / turn_radps2) if turn_radps2 > 0.0 else 0.0
        if not leans[2 * k] <= min(lean, lean + on) <= max(lean, lean + on) <= leans[2 * k + 1]:
            return False
    return True


class Turn(NamedTuple):
    """One axis' lean as it is, and how fast that turns."""

    still_mps2: float
    """a: acceleration at no lean rate."""
    rate_radps: float
    """Predicted lean rate, positive where it adds to the acceleration."""
    force_mps2: float
    """gain F0."""
    steer_s: float
    """T."""
    turn_radps2: float
    """s."""
    wait_s: float
    """t0."""


@njit
def paced(
    rows: F64, e: float, v: float, setting: Setting, reach: Reach, turn: Turn
) -> tuple[float, float, float]:  # fmt: skip
    """As `condition.interval`, less what leaves too little room to turn."""
    flat = _line(setting, setting.gamma_ps)
    inside = _inside(rows, e, v, setting)
    low, high, margin = interval(rows, e, v, straight(setting) if inside else setting, reach)
    if margin < 0.0:
        return low, high, margin
    least, most, _ = interval(rows, e, v, flat, reach)
    high = _furthest(rows, (e, v), flat, reach, turn, 1.0, max(most, low), high)
    low = _furthest(rows, (e, v), flat, reach, turn, -1.0, min(least, high), low)
    return low, high, margin


@njit
def straight(setting: Setting) -> Setting:
    """With the steep line of alpha from the edge on."""
    return _line(setting, setting.gamma_ps + setting.inside_ps)


@njit
def _line(setting: Setting, slope_ps: float) -> Setting:
    return Setting(
        slope_ps, setting.eta, setting.rate_ps, setting.dt_s, setting.off_m, setting.inner, 0.0, setting.off_mps
    )


@njit
def _furthest(
    rows: F64, at: tuple[float, float], flat: Setting, reach: Reach, turn: Turn, way: float, safe: float, end: float
) -> float:
    """The command nearest to `end` from which there is room to turn; at least `safe`, in the direction `way`."""
    if way * (end - safe) <= 0.0 or _turns(rows, at, flat, reach, turn, way, safe, end):
        return end
    held = safe
    for _ in range(_HALVINGS):
        middle = 0.5 * (held + end)
        if _turns(rows, at, flat, reach, turn, way, safe, middle):
            held = middle
        else:
            end = middle
    return held


@njit
def _turns(
    rows: F64, at: tuple[float, float], flat: Setting, reach: Reach, turn: Turn, way: float, brake: float, u: float
) -> bool:
    """Whether after u, let go at once, z is inside when the brake has been reached."""
    p, s = after_turning(at[0], at[1], turn, way, brake, u)
    low, high, _ = interval(rows, p, s, flat, reach)
    there = high if way > 0.0 else low
    if way * (there - brake) < 0.0:
        p, s = after_turning(at[0], at[1], turn, way, there, u)
    return _inside(rows, p, s, flat)


@njit
def _inside(rows: F64, e: float, v: float, setting: Setting) -> bool:
    """Whether x >= 0 of every piece."""
    for i in range(rows.shape[0]):
        h, he, hv = piece_at(rows[i], e, v)
        if not h - setting.inner - doubt_of(rows[i], he, hv, setting.off_m, setting.off_mps) >= 0.0:
            return False
    return True


@njit
def after_turning(e: float, v: float, turn: Turn, way: float, brake: float, u: float) -> tuple[float, float]:
    """(e, v) when what is sent has come from u to `brake`, on the side `way`."""
    force, wait, s = turn.force_mps2, turn.wait_s, turn.turn_radps2
    stiff = force * turn.steer_s
    rate = max(way * (u - turn.still_mps2) / stiff, way * turn.rate_radps)
    y = way * (u - brake)
    ahead = wait * (y + 0.5 * force * rate * wait)
    first = wait * wait * (0.5 * y + force * rate * wait / 6.0)
    y += force * rate * wait
    slope, bend = force * rate - stiff * s, force * s
    t = max((slope + math.sqrt(max(slope * slope + 2.0 * bend * y, 0.0))) / bend, 0.0) if y > 0.0 else 0.0
    more_v = ahead + t * (y + t * (0.5 * slope - t * bend / 6.0))
    more_e = first + ahead * t + t * t * (0.5 * y + t * (slope / 6.0 - t * bend / 24.0))
    span = wait + t
    return e + v * span + 0.5 * brake * span * span + way * more_e, v + brake * span + way * more_v


__all__ = ["Turn", "after_turning", "paced", "stays_within", "straight", "turning"]
