"""The inner part that every controller here shares: from a wanted acceleration to thrust and body rates.

`reachable` cuts the acceleration to what the limits allow, `follow` turns it into the feed-forward of thrust and body
rates (flatness, with what is learned and the believed drag) and the attitude's feedback

    omega_FB = Ka e_R + Kr (omega_d - omega)

e_R is twice the vector part of the quaternion from the present to the desired attitude, in body axes.  omega_FF is
turned from the desired into the present body axes; thrust counts only along the present thrust axis.
Known lags are led: thrust by the rotors' time constant times its rate of change, body rates by the rate loop's delay
times the angular acceleration that the reference's snap asks for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from flightstack.flatness import _to_body
from flightstack.frames import Rows3, rotation_to_quat
from flightstack.jit import njit
from flightstack.model import Limits, Model
from flightstack.rows import YAW, YAW_RATE
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Tuple3

PROPOSAL = 20
"""Numbers of a Proposal's row."""


_P, _THRUST, _MASS, _DRAG, _TILT = range(5)
"""Of `vehicle_rows`."""


@dataclass(frozen=True, slots=True)
class AttitudeGains:
    """Gains of omega_FB."""

    attitude_p_ps: float = 6.5
    """Ka of roll and pitch: 1 / (4 Ka) = 38 ms; with PX4's rate lag of 45-80 ms the attitude closes at zeta 0.9-0.7."""
    yaw_p_ps: float = 2.0
    """Ka of yaw, whose rate loop is four times slower (reaction torque only)."""
    rate_p: float = 0.15
    """Kr: adds to PX4's own rate feedback, hence small; more would only pass gyro noise on."""


def vehicle_rows(model: Model, limits: Limits, gains: AttitudeGains) -> list[tuple[float, float, float]]:
    """Five rows of three: all that `reachable` and `follow` need to know of the vehicle."""
    low, high = model.thrust_range_n(limits)
    return [
        (gains.attitude_p_ps, gains.attitude_p_ps, gains.yaw_p_ps),
        (gains.rate_p, low / model.mass_kg, high / model.mass_kg),
        (model.mass_kg, model.motor_lag_s + model.transport_delay_s, model.rate_lag_s + model.transport_delay_s),
        model.drag_kgps,
        (math.tan(limits.tilt_max_rad), 0.0, 0.0),
    ]


@njit
def reachable(acc: F64, learned: F64, vel: F64, gain: float, vehicle: F64) -> Tuple3:
    """The acceleration nearest to `acc` whose thrust the limits allow: height first, then tilt, then sideways."""
    drag = vehicle[_DRAG]
    d = 0.5 * (drag[0] + drag[1]) / vehicle[_MASS, 0]
    low, high, slope = gain * vehicle[_THRUST, 1], gain * vehicle[_THRUST, 2], vehicle[_TILT, 0]
    north = learned[0] - acc[0] - d * vel[0]
    east = learned[1] - acc[1] - d * vel[1]
    wanted = learned[2] - acc[2] - d * vel[2] + STANDARD_GRAVITY_MPS2
    down = min(max(wanted, low), high)
    sideways = math.sqrt(north * north + east * east)
    allowed = min(slope * down, math.sqrt(high * high - down * down))
    share = 0.0 if sideways <= allowed else 1.0 - allowed / sideways
    return acc[0] + share * north, acc[1] + share * east, acc[2] + wanted - down


@njit
def follow(
    vehicle: F64, acc: Tuple3, jerk: F64, reference: F64, learned: F64, gain: float, present: tuple[Rows3, F64],
    out: F64,
) -> None:  # fmt: skip
    """Feed-forward and attitude feedback for `acc`, `jerk` (3,) and the reference's velocity, snap and yaw.

    `vehicle` (5, 3) of `vehicle_rows`; `reference` (17,) and `learned` (33,): rows of FlatOutput and Learned; `gain`:
    delivered over believed thrust; `present`: attitude (`frames.rotation`) and body rates (3,).
    Into `out` (20,), a Proposal's row: thrust_ff, rate_ff, rate_fb, attitude_error.
    """
    mass, (r, rate) = vehicle[_MASS, 0], present
    (thrust, thrust_rate), rate_d, angular_d, (x, y, z) = _to_body(
        (reference[3:6], acc, jerk, reference[12:15]), (reference[YAW], reference[YAW_RATE]),
        (learned[0:3], learned[3:6]), r, mass, vehicle[_DRAG], STANDARD_GRAVITY_MPS2,
    )  # fmt: skip
    turn = (_seen(r, 0, x, y, z), _seen(r, 1, x, y, z), _seen(r, 2, x, y, z))  # wanted body axes, from the present ones
    aligned = max(turn[2][2], 0.0)
    out[0] = aligned * (thrust + vehicle[_MASS, 1] * thrust_rate) / gain
    q_error = rotation_to_quat(turn)  # w >= 0: the shorter way round
    for i in range(3):
        out[8 + i] = 2.0 * q_error[1 + i]
        wanted = lead = 0.0
        for k in range(3):
            wanted += turn[i][k] * rate_d[k]
            lead += turn[i][k] * angular_d[k]
        out[2 + i] = wanted + vehicle[_MASS, 2] * lead
        out[5 + i] = vehicle[_P, i] * out[8 + i] + vehicle[_THRUST, 0] * (wanted - rate[i])


@njit
def _seen(r: Rows3, i: int, x: Tuple3, y: Tuple3, z: Tuple3) -> Tuple3:
    """Component of x, y and z along body axis `i`."""
    a, b, c = r[0][i], r[1][i], r[2][i]
    return a * x[0] + b * x[1] + c * x[2], a * y[0] + b * y[1] + c * y[2], a * z[0] + b * z[1] + c * z[2]


@njit
def together(out: F64) -> float:
    """Body rates of feed-forward and feedback added up in a Proposal's row `out` (20,); their total thrust."""
    for i in range(3):
        out[17 + i] = out[2 + i] + out[5 + i]
    return out[0] + out[1]  # type: ignore[no-any-return]
