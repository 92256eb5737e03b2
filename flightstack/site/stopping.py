"""The stopping certificate: from any speed the vehicle stops on a known way, within a known tube, and holds there.

It is made once per vehicle, load and wind; no site enters (docs/site.md).  What it rests on without any flight is the
prior: true over believed mass in a range, a force of any direction that may change at any time.  The thrust gain
(delivered over believed thrust per mass) is read off the accelerometer once the vehicle flies; what that leaves open is
again the force.  Lines of the ledger, all m/s^2, across and along (up and down):

    force      |d| of the prior, in any direction at any time; the accelerometer shows it, the observer follows
    gain       what thrust does more or less than believed, by the sine of the lean; up and down, by its change
    estimate   the attitude's error, as acceleration (`estimate_bounds`); the tube itself has position and velocity
    torque     thrust that torque adds within the governor's limits (`barrier.torque`)
    model      what the way out and the vehicle's answer differ by without any doubt: MODEL_*, by test

Force and gain are seen by the accelerometer (D of `tube`), the others are not (R).

Authority: with the least gain g_l, thrust F carries weight and force in every direction phi of the force at once,

    across = min over phi of sqrt((g_l F)^2 - (g + OVER f sin phi + up)^2) - DEMAND f cos phi

and `up` is a stated share of what thrust leaves beyond weight and force.  A climb is braked by what the greatest gain
g_h and the least thrust F_low that the governor lets through leave of weight and force, a stated share of it again:

    down = min(2, 0.4 (g - g_h F_low - OVER f))
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flightstack.barrier.estimate_bounds import EstimateBounds
from flightstack.barrier.torque import UNBOUNDED, GovernorTerms, within
from flightstack.model import Limits, Model
from flightstack.rows import VEL_N, WAY_RADIUS
from flightstack.site import backup as b
from flightstack.site import slide
from flightstack.site.approach import JERK_MOST_MPS3
from flightstack.site.law import led_lags
from flightstack.site.radii import resting, searched
from flightstack.site.tube import STEP_S as TUBE_STEP_S
from flightstack.site.tube import LoopBounds, Tube, along
from flightstack.site.turning import Turning, turning
from flightstack.site.worst import Held
from flightstack.types import F64, InputError
from flightstack.types import STANDARD_GRAVITY_MPS2 as G
from flightstack.vehicle import Vehicle

MODEL_ACROSS_MPS2, MODEL_ALONG_MPS2 = 0.15, 0.15
"""Set, not derived, and no bound: `benchmarks.fence_model` measures up to 0.18 and 0.9, and more of one vehicle."""
_OVER, _DEMAND, _SPARE = 1.05, 1.5, 1.6
_UP_SHARE, _UP_MOST = 0.3, 3.0
_DOWN_SHARE, _DOWN_LEAST, _DOWN_MOST = 0.4, 0.5, 2.0
_ACROSS_MOST, _ACROSS_MOST_CALM, _CALM_G = 4.0, 7.0, 0.08
"""Braking across, at most; and where the force is known to be small."""
_ACROSS_LEAST, _UP_LEAST = 0.3, 0.05
_JERK_RADPS, _RATE_SHARE = 1.6, 0.6
_EASE, _WAY, _WAY_CALM = 0.8, (0.2, 0.4, 1.6, 0.65), (0.35, 0.88, 2.0, 0.82)
"""Of the fastest rates, what the way out takes itself; of what its snap does in the time that the speed lasts, the lean
out of the brake; of the snap that is sure, what a slow and a fast way take, as following it needs the rest; how fast
braking fades at last, and of the turning that can be stopped, the share that is used."""
_LEAN_MPS2 = 8.5
_TILT_ROOM_RAD = math.radians(5.0)
_SWING_MPS2, _SWING_LAG_S = 8.5, 0.025
_LED_S, _LED_PS, _LED_MPS2 = 0.09, 3.0, 0.75
"""Jerk of a reference that is led: by the snap that there is, by the braking that is left, and by what lean falls
behind with the rates' lag."""
SMOOTH_M = 0.1
_SMOOTH_SHARE, _SMOOTH_LATE_S, _GAMMA_PS = 0.7, 0.1, 3.5
_LAG_SHARE, _HOLD_S = 1.2, 0.006
_LATE_S = 0.01
_STEER_PS = 6.5
_RINGING = 4.0
"""chi beyond which nothing but the rate loop itself is to blame."""
GAIN_STEP = 0.02
ANY_SPEED_MPS = 100.0
"""More than any multicopter flies."""


class Prior(NamedTuple):
    """What is known: by default before any flight."""

    mass_low: float = 0.8
    mass_high: float = 1.5
    force_g: float = 0.15
    """Of the true weight."""
    speed_mps: float = ANY_SPEED_MPS
    """Up to which all of it holds."""

    @property
    def gain(self) -> tuple[float, float]:
        """Range of the thrust gain."""
        return 1.0 / self.mass_high, 1.0 / self.mass_low


class Told(NamedTuple):
    """The share of every doubt that is told; less than 1 is a lie, for tests that it would be found out."""

    force: float = 1.0
    gain: float = 1.0
    estimate: float = 1.0
    """Of the attitude."""
    torque: float = 1.0
    model: float = 1.0
    place: float = 1.0
    """Of the estimate's position and velocity."""
    lag: float = 1.0
    hold: float = 1.0
    late: float = 1.0

    @classmethod
    def all(cls, share: float) -> Told:
        """The same share of each."""
        return cls(*(share,) * len(cls._fields))


HONEST = Told()


class Line(NamedTuple):
    """One line of the ledger."""

    name: str
    across_mps2: float
    along_mps2: float


@dataclass(frozen=True, slots=True, eq=False)
class StoppingCertificate:
    """The certificate as the filter uses it."""

    prior: Prior
    ledger: tuple[Line, ...]
    across: Tube
    along: Tube
    along_first: Tube
    """Before the thrust gain was read."""
    rows: F64
    """(n, b.PARAMETERS) of the way out, for least gains from the prior's lowest on in steps of GAIN_STEP."""
    soft: F64
    """(n, slide.SOFT) of the smoothness, the same."""
    chain: F64
    """`response.CHAIN` numbers."""
    response: F64
    """(3, 3) of `response.lead`."""
    governor: GovernorTerms
    eps_gain: float
    """What the accelerometer leaves open of the gain, as a share of it."""
    doubts: tuple[LoopBounds, LoopBounds]
    """Across and along: what the tubes are made of."""
    lags_s: tuple[tuple[float, float], tuple[float, float]]
    """Across and along: of the rates (of thrust), and what the rotors add."""
    thrust_mps2: float
    """The most that the believed vehicle has, within the governor's limits."""
    least_mps2: float
    """The least."""
    turning: Turning

    @property
    def radius_m(self) -> float:
        """Across, at rest."""
        return float(self.across.radius_m[-1])

    @property
    def half_m(self) -> float:
        """Up and down, at rest."""
        return float(self.along.radius_m[-1])

    @property
    def kept_m(self) -> float:
        """Distance that a reference keeps: the tube at rest and what smoothness needs."""
        return self.radius_m + 1.5 * SMOOTH_M

    @property
    def snap_mps4(self) -> float:
        """How fast jerk can change with the torque that the governor lets through."""
        return self.turning.snap_mps4

    def halves(self) -> F64:
        """(2, b.STEPS) half height of the tube after each step of a way: before the gain was read, and after."""
        at = np.minimum((np.arange(b.STEPS) + 1) * round(b.STEP_S / TUBE_STEP_S), len(self.along.radius_m) - 1)
        return np.stack([each.radius_m[at] for each in (self.along_first, self.along)])

    def row_of(self, gain_low: float) -> int:
        """The row for a least gain, rounded down."""
        return int(min(max((gain_low - self.prior.gain[0]) / GAIN_STEP, 0.0), len(self.rows) - 1))

    def stopping_way_m(self, speed_mps: float, gain_low: float = math.inf) -> float:
        """From level flight: how far the place of rest and all of its tube are, ahead."""
        start = np.zeros(b.ROW)
        start[VEL_N] = speed_mps
        points, way = np.zeros((b.STEPS, b.ROW)), np.zeros((b.STEPS, 5))
        count = b.roll(start, self.rows[self.row_of(gain_low)], self.halves()[1], points, way)
        return float(np.max(way[:count, 0] + way[:count, WAY_RADIUS])) if count else math.inf


def steady_pole_ps(snap_mps4: float, motor_lag_s: float = 0.0) -> float:
    """The fastest pole of a loop that does not swing where jerk changes by so much at most: at a pole p the jerk of an
    acceleration A changes by p^2 A.  Torque that comes late takes more: A is measured (docs/site.md)."""
    return math.sqrt(snap_mps4 / (_SWING_MPS2 * max(motor_lag_s / _SWING_LAG_S, 1.0)))


def stopping(
    vehicle: Vehicle, model: Model, limits: Limits, estimate: EstimateBounds, governor: GovernorTerms,
    prior: Prior | None = None, told: Told = HONEST,
) -> StoppingCertificate:  # fmt: skip
    """The certificate from the prior; InputError where the vehicle can't hold against it."""
    prior = prior or Prior()
    limits = within(limits, model, governor)
    least, high = (each / model.mass_kg for each in model.thrust_range_n(limits))
    force = prior.force_g * G
    hardest = _ACROSS_MOST_CALM if prior.force_g <= _CALM_G else _ACROSS_MOST
    lean = math.atan((hardest + force) / G)
    eps_p, eps_v, eps_a = (np.array(part) for part in (estimate.pos_m, estimate.vel_mps, estimate.acc_mps2))
    flat_p, flat_v, flat_a = (float(np.hypot(*part[:2]) / math.sqrt(2.0)) for part in (eps_p, eps_v, eps_a))
    ledger = (
        Line("force", force, force),
        Line("gain", force * math.sin(lean), 0.3 * force),
        Line("estimate", flat_a, float(eps_a[2])),
        Line("torque", governor.worst_mps2 * math.sin(lean), governor.worst_mps2),
        Line("model", MODEL_ACROSS_MPS2, MODEL_ALONG_MPS2),
    )
    doubts = (
        LoopBounds(*_seen(ledger, 0, told), told.place * flat_p, told.place * flat_v),
        LoopBounds(*_seen(ledger, 1, told), told.place * float(eps_p[2]), told.place * float(eps_v[2])),
    )
    gain_low, gain_high = prior.gain
    unread = told.gain * 0.5 * (gain_high - gain_low) / math.sqrt(gain_low * gain_high) * G
    slower, held_s = 1.0 + told.lag * (_LAG_SHARE - 1.0), told.hold * _HOLD_S
    turn = turning(vehicle, model, governor, limits)
    lags_across = slower * turn.lag_s + held_s, slower * turn.rotors_s
    lag_along = slower * model.motor_lag_s + held_s + 0.01
    down = _down(vehicle, prior, governor, least)
    lean_most = _authority(gain_low * high, force, hardest, (down, limits))[2]
    held = Held(
        turn.sure_mps4,
        lean_most,
        min(turn.rate_radps, b.FASTEST * _JERK_RADPS) * G,
        _stepped(ledger, told),
        *doubts[0][1:],
    )
    _require_thrust(vehicle, model, prior, high)  # before what takes seconds
    tubes = resting(lags_across, doubts[0], held), along(lag_along, doubts[1])
    slow, fast, fade_ps, stoppable = _WAY_CALM if prior.force_g <= _CALM_G else _WAY
    turn = turn._replace(way_mps4=slow * turn.sure_mps4, way_fast_mps4=fast * turn.sure_mps4)
    first = along(lag_along, doubts[1]._replace(force_mps2=doubts[1].force_mps2 + unread))
    first = first._replace(radius_m=np.maximum(first.radius_m, tubes[1].radius_m))
    rows = _rows(prior, (high, down, hardest), limits, tubes, turn, lags_across, told, (held, fade_ps, stoppable))
    tubes = searched(rows, tubes[0], held, lags_across), tubes[1]
    soft = _softness(rows, tubes[1], turn)
    chain, response = _answer(model, limits, turn.lag_s)
    made = StoppingCertificate(
        prior, ledger, *tubes, first, rows, soft, chain, response, governor,
        (told.force * force + told.model * MODEL_ALONG_MPS2) / G, doubts,
        (lags_across, (lag_along, 0.0)), high, least, turn,
    )  # fmt: skip
    for row, each in zip(made.rows, made.soft, strict=True):
        each[slide.SLOW_S] = _slow_s(row, made.halves()[1]) + _SMOOTH_LATE_S
        each[slide.SLOW_S] += (row[b.MOST_RADIUS] - row[b.REST_RADIUS]) / b.MUCH_MPS
    return made


def _require_thrust(vehicle: Vehicle, model: Model, prior: Prior, high_mps2: float) -> None:
    """InputError where thrust does not carry the heaviest against the force."""
    if prior.gain[0] * high_mps2 < (1.0 + prior.force_g) * G:
        raise InputError(
            f"vehicle {vehicle.name}: {high_mps2 / G:.2f} times the believed weight is all the thrust that it is flown "
            f"with (its rotors give {model.max_thrust_n / model.weight_n:.2f}, some of it for turning); "
            f"{prior.mass_high:g} times the believed mass and a force of {prior.force_g:g} g take "
            f"{prior.mass_high * (1.0 + prior.force_g):.2f}: nothing keeps it in a site but a certificate of less mass"
        )


def _down(vehicle: Vehicle, prior: Prior, governor: GovernorTerms, least_mps2: float) -> float:
    """What a climb is braked by; InputError where the vehicle can't come down."""
    gain = prior.gain[1]
    down = min(_DOWN_SHARE * (G - gain * least_mps2 - _OVER * prior.force_g * G), _DOWN_MOST)
    if down < _DOWN_LEAST and (governor.chi > _RINGING or governor.noise >= UNBOUNDED):
        raise InputError(
            f"vehicle {vehicle.name}: its rate loop rings where gain and lag are 20 % off (torque up to "
            f"{min(governor.chi, 999.0):.0f} times what is modelled): no torque can be promised; lower MC_ROLLRATE_K, "
            f"MC_PITCHRATE_K or the _D of both ([autopilot] of the file)"
        )
    if down < _DOWN_LEAST:
        raise InputError(
            f"vehicle {vehicle.name}: {least_mps2 / G:.2f} times the believed weight is the least thrust that leaves "
            f"its rotors room to turn it; with {prior.mass_low:g} times the believed mass and a force of "
            f"{prior.force_g:g} g a climb is not braked: nothing keeps it below a ceiling"
        )
    return down


def _rows(
    prior: Prior, ends: tuple[float, float, float], limits: Limits, tubes: tuple[Tube, Tube], turn: Turning,
    lags_s: tuple[float, float], told: Told, more: tuple[Held, float, float],
) -> F64:  # fmt: skip
    """`backup` parameters for each gain of the prior, the least first; `ends`: the most thrust, and what a
    climb is braked by and across at most, m/s^2; `more`: what the loop has, how braking fades, what it stops."""
    rows, force, (high, brake, hardest), (held, fade_ps, stoppable) = [], prior.force_g * G, ends, more
    gain_low, gain_high = prior.gain
    gains, down, snap, steps = tubes[0].gains, tubes[1].gains, turn.way_mps4, b.turned(*lags_s)
    jerk, spare = min(_JERK_RADPS, _RATE_SHARE * turn.rate_radps) * G, _SPARE * (held.force_mps2 + held.rest_mps2)
    for gain in np.arange(gain_low, gain_high + 1e-9, GAIN_STEP).tolist():
        a, up, lean_most = _authority(gain * high, force, hardest, (brake, limits))
        a = min(a, max(lean_most - spare, _ACROSS_LEAST))
        fast_mps = max(0.5 * a * math.sqrt(4.0 * a / snap), 0.2)
        rows.append([
            a, up, brake, jerk, snap, fade_ps, 3.0, 0.06, 40.0, gains.acc_ps, gains.vel_ps2, gains.pos_ps3,
            down.vel_ps2, down.pos_ps3, lean_most, told.late * _LATE_S, lags_s[0], gain * high,
            math.cos(limits.tilt_max_rad + _TILT_ROOM_RAD), G * math.tan(limits.tilt_max_rad),
            told.force * _OVER * force, lags_s[1], *steps, turn.sure_mps4, _EASE * snap ** (1.0 / 3.0),
            turn.way_fast_mps4, fast_mps, sum(led_lags(*lags_s)), stoppable, 0.0, 0.0, 0.0, 0.0,
        ])  # fmt: skip
    return np.array(rows)


def _softness(rows: F64, down: Tube, turn: Turning) -> F64:
    """`slide` parameters of each row."""
    high, late_s = down.radius_m[-1] + 0.5 * SMOOTH_M, turn.lag_s + turn.rotors_s
    jerk = min(JERK_MOST_MPS3, turn.snap_mps4 * _LED_S, _LED_MPS2 / late_s)
    return np.array([
        [
            row[b.REST_RADIUS] + SMOOTH_M, high, 0.0, _SMOOTH_SHARE * row[b.ACROSS], _GAMMA_PS,
            _SMOOTH_SHARE * row[b.UP], _SMOOTH_SHARE * row[b.DOWN], min(jerk, _LED_PS * row[b.ACROSS]),
        ]
        for row in rows
    ])  # fmt: skip


def _answer(model: Model, limits: Limits, rate_lag_s: float) -> tuple[F64, F64]:
    """How the vehicle answers: `response.CHAIN` numbers, and (3, 3) of `response.lead`."""
    low_n, high_n = model.thrust_range_n(limits)
    steer, delay_us = 1.0 / _STEER_PS, round(1e6 * model.transport_delay_s)
    chain = np.array([
        model.max_thrust_n / model.mass_kg, model.thrust_model_factor, model.norm_of(low_n), model.norm_of(high_n),
        model.motor_lag_s, rate_lag_s, delay_us, delay_us, steer, G, 0.004,
    ])  # fmt: skip
    lateral = [steer, steer * rate_lag_s, 0.0]
    return chain, np.array([lateral, lateral, [model.motor_lag_s, 0.0, 0.0]])


def _seen(ledger: tuple[Line, ...], way: int, told: Told) -> tuple[float, float]:
    """What the accelerometer shows of the ledger, and what it does not; way 0 across, 1 along."""
    sizes = [getattr(told, line.name) * (line.across_mps2, line.along_mps2)[way] for line in ledger]
    return sum(sizes[:2]), sum(sizes[2:])


def _stepped(ledger: tuple[Line, ...], told: Told) -> float:
    """Half of the greatest step of force across: one force has one direction, so what of it is taken for thrust (up and
    down) does not push across."""
    return math.hypot(told.force * ledger[0].across_mps2, told.gain * ledger[1].across_mps2)


def _authority(
    most_mps2: float, force_mps2: float, hardest_mps2: float, allowed: tuple[float, Limits]
) -> tuple[float, float, float]:
    """Braking across, of a fall, and the greatest acceleration by lean, with so much thrust; `allowed`: what a climb is
    braked by, and the flight's limits."""
    down, limits = allowed
    spare = most_mps2 - G - _OVER * force_mps2
    up = min(max(_UP_SHARE * spare, _UP_LEAST), _UP_MOST)
    phi = np.linspace(0.0, 0.5 * math.pi, 46)
    carried = G + _OVER * force_mps2 * np.sin(phi) + up
    left = np.sqrt(np.maximum(most_mps2**2 - carried**2, 0.0)) - _DEMAND * force_mps2 * np.cos(phi)
    a = max(float(left.min()), _ACROSS_LEAST)
    tilted = min((G - down) * math.tan(limits.tilt_max_rad), _LEAN_MPS2)
    return min(a, hardest_mps2), up, min(a + _DEMAND * force_mps2, tilted)


def _slow_s(row: F64, tube: F64) -> float:
    """Time that a stop takes beyond its ideal way, at the worst of some speeds."""
    return max(float(points[-1, 0] - 0.5 * v**2 / row[b.ACROSS]) / v for v, points in _stops(row, tube))


def _stops(row: F64, tube: F64) -> Iterator[tuple[float, F64]]:
    """Ways to rest from level flight at some speeds, with the speed; as good as at rest where there is none in time."""
    for speed in (0.5, 1.0, 2.0, 3.0, 5.0):
        points, way = np.zeros((b.STEPS, b.ROW)), np.zeros((b.STEPS, 5))
        points[0, VEL_N] = speed
        count = b.roll(points[0], row, tube, points, way)
        yield speed, points[:count] if count else np.zeros((1, b.ROW))
