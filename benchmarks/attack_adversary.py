"""The adversary: a controller that wants the vehicle out of its certified region, and knows region and truth.

It stands where the nominal controller stands (`seams.Controller`), so everything after it is the product's own:
limiter, guard's brake, filter.  A strategy is a point in the unit cube, so that a search can move it: which axes it
pushes, how it leans, what it does with thrust, and what it dithers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from flightstack.barrier.records import Certificate
from flightstack.barrier.shapes import piece_at
from flightstack.frames import quat_to_matrix
from flightstack.seams import Controller
from flightstack.types import F64, Command, FlatOutput, Learned, Measurement, Proposal, changed

GRADIENT, OUTWARD, ALONG, SWING, RANDOM, INNER = range(6)
"""Which way an axis is pushed: down h's gradient in speed, away from the centre, the way it moves, back and forth, at
random, as the controller inside."""
SINE, SQUARE, NOISE = range(3)
_DIMENSIONS = 20


class Strategy(NamedTuple):
    """What an adversary does; units in the names."""

    roll_radps: float
    """Amplitude of the dither."""
    pitch_radps: float
    yaw_radps: float
    hz: float
    yaw_hz: float
    phase_rad: float
    """Of pitch behind roll."""
    wave: int
    gate_h: float
    """It dithers where the true h is below this."""
    lateral: int
    vertical: int
    lean_rad: float
    steer_ps: float
    """Body rate for each radian of missing lean."""
    swing_s: float
    """Period of SWING, dwell of RANDOM."""
    swing_phase_rad: float
    wall_m: float
    """Above 0: sideways it does not lean itself, the controller inside is given a place so far outside."""
    axes: int
    """Bits: north 1, east 2, down 4; along the others and where nothing is certified the controller inside flies."""
    thrust_share: float
    """Of the way to the thrust's end that is wanted."""
    relent_s: float
    """Above 0: it alternates with the controller inside, so long each."""
    together: bool
    """Thrust is pushed to its upper end wherever it dithers: all rotors near their limits."""


KNOWN = Strategy(
    1.6, 1.6, 0.0, 10.8, 1.0, 0.0, SINE, 2.0, INNER, GRADIENT, 0.3, 8.0, 1.0, 0.0, 0.0, 4, 1.0, 0.0, False
)  # fmt: skip
"""The attack that broke the first three-axis certificates: 10.8 Hz, 1.6 rad/s, thrust at its ends."""
TIMED = KNOWN._replace(roll_radps=4.0, pitch_radps=4.0, hz=8.0, wave=SQUARE, gate_h=0.3)
"""It waits for the edge, then dithers: nothing is falsified before."""
TIMED_FAST = KNOWN._replace(roll_radps=6.0, pitch_radps=6.0, hz=15.0, phase_rad=0.5 * math.pi, gate_h=0.25)
PUSH = Strategy(
    0.0, 0.0, 0.0, 5.0, 1.0, 0.0, SINE, 0.0, GRADIENT, GRADIENT, 0.5, 8.0, 1.0, 0.0, 0.0, 7, 1.0, 0.0, False
)
"""No dither: all axes pushed outwards at once."""


def decode(x: F64) -> Strategy:
    """The strategy of a point of the unit cube, (20,)."""
    u = np.clip(np.asarray(x, dtype=np.float64), 0.0, 1.0 - 1e-9).tolist()
    waves = (SINE, SQUARE, NOISE)
    ways = (GRADIENT, OUTWARD, ALONG, SWING, RANDOM, INNER)
    amplitude = 0.0 if u[19] < 0.15 else 6.0 * u[0]
    return Strategy(
        roll_radps=amplitude, pitch_radps=amplitude * (2.0 * u[1] if u[1] < 0.5 else 1.0),
        yaw_radps=max(0.0, 3.0 * u[2] - 1.0), hz=15.0 ** u[3], yaw_hz=0.2 * 25.0 ** u[4],
        phase_rad=2.0 * math.pi * u[5], wave=waves[int(3 * u[6])],
        gate_h=2.0 if u[7] > 0.6 else u[7], lateral=ways[int(6 * u[8])], vertical=ways[int(6 * u[9])],
        lean_rad=0.1 + 0.6 * u[10], steer_ps=3.0 * 5.0 ** u[11], swing_s=0.2 * 20.0 ** u[12],
        swing_phase_rad=2.0 * math.pi * u[13], wall_m=0.0 if u[14] < 0.6 else 0.5 + 10.0 * (u[14] - 0.6),
        axes=1 + int(7 * u[15]), thrust_share=1.0 if u[16] > 0.4 else 0.5 + u[16],
        relent_s=0.0 if u[17] < 0.6 else 0.3 + 5.0 * (u[17] - 0.6), together=u[18] > 0.5,
    )  # fmt: skip


def drawn(rng: np.random.Generator) -> F64:
    """A random point, (20,)."""
    return rng.uniform(size=_DIMENSIONS)


def near(points: list[F64], rng: np.random.Generator, spread: float = 0.15) -> F64:
    """One between and near the best points so far: cross-entropy with crossing-over."""
    parents = np.stack(points)
    mixed = parents[rng.integers(len(parents), size=_DIMENSIONS), np.arange(_DIMENSIONS)]
    moved: F64 = mixed + spread * rng.standard_normal(_DIMENSIONS)
    return np.clip(np.abs(moved), 0.0, 1.0)


@dataclass(slots=True)
class Seen:
    """What the adversary knows; the flight keeps it up to date."""

    origin_ned_m: F64
    """The true place of the start, (3,)."""
    truth: Callable[[], tuple[F64, F64, F64]]
    """True position (3,), velocity (3,) and attitude (4,)."""
    certificate: Certificate | None = None
    strategy: Strategy | None = None
    """None: the controller inside flies."""
    since_us: int = 0
    h: float = 1.0
    """Least h of the truth."""


class Adversary:
    """The controller; `inner` flies where the strategy leaves it to."""

    def __init__(
        self, inner: Controller, seen: Seen, seed: int, thrust_range_n: tuple[float, float], rate_max_radps: F64
    ) -> None:
        self.seen = seen
        self._inner, self._seed, self._range_n, self._rate_max = inner, seed, thrust_range_n, rate_max_radps

    def init(self, now_us: int) -> Any:
        """The inner controller's state."""
        return _Memory(self._inner.init(now_us), np.random.default_rng([7, self._seed]))

    def healthy(self, state: Any) -> bool:
        """The inner controller's."""
        return self._inner.healthy(state.inner)

    def step(
        self, state: Any, measurement: Measurement, reference: FlatOutput, learned: Learned, sent: Command, now_us: int
    ) -> tuple[Any, Proposal]:
        """The inner controller's proposal, and what the strategy makes of it."""
        seen, plan = self.seen, self.seen.strategy
        if plan is None or seen.certificate is None:
            state.inner, proposal = self._inner.step(state.inner, measurement, reference, learned, sent, now_us)
            return state, proposal
        time_s = 1e-6 * (now_us - seen.since_us)
        pos, vel, q = seen.truth()
        axes = plan.axes & sum(1 << axis.axis for axis in seen.certificate.axes)  # elsewhere nobody claims anything
        pushes, seen.h = self._pushes(state, plan, seen.certificate, pos - seen.origin_ned_m, vel, time_s)
        relents = plan.relent_s > 0.0 and time_s % (2.0 * plan.relent_s) > plan.relent_s
        aim = reference
        if plan.wall_m > 0.0 and not relents:
            place = reference.pos_ned_m.copy()
            for i in range(3):
                if axes >> i & 1:
                    place[i] = measurement.pos_ned_m[i] + plan.wall_m * pushes[i]
            aim = changed(reference, pos_ned_m=place)
        state.inner, proposal = self._inner.step(state.inner, measurement, aim, learned, sent, now_us)
        row, thrust = proposal.row.copy(), proposal.thrust_n
        rate = row[17:20]
        if not relents:
            if plan.wall_m <= 0.0 and axes & 3 and plan.lateral != INNER:
                rate[:2] = _leaning(plan, pushes, q)
            if axes & 4 and plan.vertical != INNER and pushes[2] != 0.0:
                low, high = self._range_n
                end = low if pushes[2] > 0.0 else high
                thrust = thrust + plan.thrust_share * (end - thrust) if math.isfinite(thrust) else end
        if seen.h < plan.gate_h:
            self._dither(state, plan, time_s, rate)
            if plan.together and plan.roll_radps > 0.0:
                thrust = self._range_n[1]
        np.clip(rate, -self._rate_max, self._rate_max, out=rate)
        return state, replace(proposal, row=row, thrust_n=thrust)

    def _dither(self, state: _Memory, plan: Strategy, time_s: float, rate: F64) -> None:
        angle = 2.0 * math.pi * plan.hz * time_s
        if plan.wave == NOISE:
            if time_s >= state.noise_until_s:
                state.noise_until_s = time_s + 0.5 / plan.hz
                state.noise = state.rng.choice([-1.0, 1.0], size=2).tolist()
            roll, pitch = state.noise
        else:
            roll, pitch = math.sin(angle), math.sin(angle + plan.phase_rad)
            if plan.wave == SQUARE:
                roll, pitch = math.copysign(1.0, roll), math.copysign(1.0, pitch)
        rate[0] += plan.roll_radps * roll
        rate[1] += plan.pitch_radps * pitch
        if plan.yaw_radps > 0.0:
            rate[2] = math.copysign(plan.yaw_radps, math.sin(2.0 * math.pi * plan.yaw_hz * time_s))

    def _pushes(
        self, state: _Memory, plan: Strategy, certificate: Certificate, pos_ned_m: F64, vel_ned_mps: F64, time_s: float
    ) -> tuple[list[float], float]:
        """Which way each axis is pushed, in [-1, 1], and the least h of the truth."""
        if time_s >= state.until_s:
            state.until_s = time_s + plan.swing_s
            state.random = state.rng.uniform(-1.0, 1.0, 3).tolist()
        swing = math.copysign(1.0, math.sin(2.0 * math.pi * time_s / plan.swing_s + plan.swing_phase_rad))
        pushes, least = [0.0, 0.0, 0.0], math.inf
        for axis in certificate.axes:
            i = axis.axis
            e, v = float(pos_ned_m[i]) - certificate.centre_ned_m[i], float(vel_ned_mps[i])
            h, _, slope = min(piece_at(row, e, v) for row in axis.barrier.rows)
            least = min(least, h)
            way = plan.vertical if i == 2 else plan.lateral
            if way == INNER and plan.wall_m > 0.0:
                way = OUTWARD
            if way == GRADIENT:
                pushes[i] = math.copysign(1.0, -slope)
            elif way == OUTWARD:
                pushes[i] = math.copysign(1.0, e)
            elif way == ALONG:
                pushes[i] = math.copysign(1.0, v)
            elif way == SWING:
                pushes[i] = swing
            elif way == RANDOM:
                pushes[i] = state.random[i]
        return pushes, least


class _Memory:
    """Changed in place."""

    def __init__(self, inner: Any, rng: np.random.Generator) -> None:
        self.inner, self.rng = inner, rng
        self.until_s = self.noise_until_s = -math.inf
        self.noise, self.random = [0.0, 0.0], [0.0, 0.0, 0.0]


def _leaning(plan: Strategy, pushes: list[float], q_ned_frd: F64) -> tuple[float, float]:
    """Roll and pitch rate towards a lean that pushes north and east."""
    turn = quat_to_matrix(q_ned_frd)
    lean = math.tan(plan.lean_rad)
    north = -lean * pushes[0] if plan.axes & 1 else 0.0
    east = -lean * pushes[1] if plan.axes & 2 else 0.0
    size = math.sqrt(1.0 + north * north + east * east)
    x = (turn[0, 0] * north + turn[1, 0] * east + turn[2, 0]) / size  # the wanted thrust axis in body axes
    y = (turn[0, 1] * north + turn[1, 1] * east + turn[2, 1]) / size
    return -plan.steer_ps * y, plan.steer_ps * x
