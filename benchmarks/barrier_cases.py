"""The flights of the barrier campaign: what is drawn for each, and the controller that wants out.

Every figure comes from the flight's seed.  What is believed differs from what flies as the ledger allows: mass and
force by the knowledge before take-off, the rotors' lag by a fifth, the delay by 4 ms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flightstack.barrier.initial import LEAST_AUTHORITY_WEIGHTS, vertical_authority_weights
from flightstack.seams import Controller
from flightstack.types import F64, Command, FlatOutput, Learned, Measurement, Proposal, Tuple3, changed
from flightstack.vehicle import Vehicle, scaled, with_effects

PILOTS = ("sound", "unfiltered", "as-published")
TASKS = ("explore", "adversary")
TICK_MS = 4
FLIGHT_S = 20.0
"""From the first certificate on; of an exploration, from its first round."""
_STEERED_M = np.array([0.5, 0.5, 0.2])
_FAR_M, _FAST_MPS = 1.0, 0.5
"""Sideways, where nothing is certified, the adversary turns back from here on: else the flight would end at its
envelope, for the certificate leaves little to tilt."""


@dataclass(frozen=True, slots=True)
class Draw:
    """The world of one flight."""

    seed: int
    mass_ratio: float
    """True over believed."""
    wind_g: Tuple3
    """Force north, east, down, in true weights."""
    rotor_lag_s: float
    lag_share: float
    """Believed over true lag."""
    period_ticks: int
    """Ticks between two commands."""
    down_ms: float
    """Delay of the link from the vehicle, and to it."""
    up_ms: float
    jitter_ms: float
    """Besides, 0 to so much more, drawn for each datagram."""
    loss: float
    """Share of the datagrams, either way, that never arrive."""
    delay_error_ms: float
    """Believed less true delay."""

    @property
    def authority_weights(self) -> float:
        """Upward acceleration that is left, in g."""
        return vertical_authority_weights(1.8, self.mass_ratio, self.wind_g)

    @property
    def refused(self) -> bool:
        """Too little to fly with."""
        return self.authority_weights < LEAST_AUTHORITY_WEIGHTS - 1e-9

    @property
    def delay_s(self) -> float:
        """From sensing to acting: the link both ways and half its jitter."""
        return 1e-3 * (self.down_ms + self.up_ms + self.jitter_ms)

    def believed(self, vehicle: Vehicle) -> Vehicle:
        """The vehicle file that the stack is given."""
        lag = {"time_constant_s": self.rotor_lag_s * self.lag_share}
        late = {"delay_s": max(1e-3 * (self.up_ms + 0.5 * self.jitter_ms + self.delay_error_ms), 0.0)}
        return with_effects(vehicle, {"motor_lag": lag, "transport_delay": late})

    def truth(self, vehicle: Vehicle) -> Vehicle:
        """The vehicle that flies."""
        true = scaled(vehicle, mass_ratio=self.mass_ratio)
        north, east, down = (share * true.weight_n for share in self.wind_g)
        force = {"north_n": north, "east_n": east, "down_n": down}
        return with_effects(true, {"constant_force": force, "motor_lag": {"time_constant_s": self.rotor_lag_s}})


def draw(seed: int) -> Draw:
    """The world of a seed."""
    rng = np.random.default_rng([4, seed])
    direction = rng.normal(size=3)
    wind = rng.uniform(0.0, 0.15) * direction / np.linalg.norm(direction)
    link = rng.uniform(10.0, 40.0)
    share = rng.uniform(0.3, 0.7)
    return Draw(
        seed=seed,
        mass_ratio=float(rng.uniform(0.8, 1.5)),
        wind_g=(float(wind[0]), float(wind[1]), float(wind[2])),
        rotor_lag_s=float(rng.uniform(0.03, 0.08)),
        lag_share=float(rng.uniform(0.85, 1.15)),
        period_ticks=int(rng.integers(1, 6)),
        down_ms=float(link * share),
        up_ms=float(link * (1.0 - share)),
        jitter_ms=float(rng.uniform(0.0, 4.0)),
        loss=float(rng.uniform(0.0, 0.01)),
        delay_error_ms=float(rng.uniform(-2.0, 2.0)),
    )


class Adversary:
    """A controller that tries to leave the region: outwards at full thrust and tilt, or anywhere at random.

    It flies like the one inside it until `begins` says so.  Three manners, drawn from the seed, each for 0.2 to 1.5 s:
    away from the centre; the way it moves already, both with thrust at its ends; a random place and random thrust.
    Only height is certified in these flights: sideways it stays within some metres.
    """

    def __init__(
        self, inner: Controller, seed: int, thrust_range_n: tuple[float, float], begins: Callable[[], bool]
    ) -> None:
        self._inner, self._seed, self._range_n, self._begins = inner, seed, thrust_range_n, begins

    def init(self, now_us: int) -> Any:
        """The inner controller's state, and nothing planned."""
        return _Plan(self._inner.init(now_us), np.random.default_rng([5, self._seed]))

    def healthy(self, state: Any) -> bool:
        """The inner controller's."""
        return self._inner.healthy(state.inner)

    def step(
        self, state: Any, measurement: Measurement, reference: FlatOutput, learned: Learned, sent: Command, now_us: int
    ) -> tuple[Any, Proposal]:
        """The inner controller's way to a place outside; thrust at an end of its range."""
        adverse, aim = self._begins(), reference
        if adverse:
            state.plan(measurement, reference, now_us)
            aim = changed(reference, pos_ned_m=state.place(measurement, reference))
        state.inner, proposal = self._inner.step(state.inner, measurement, aim, learned, sent, now_us)
        if adverse and state.thrust >= 0.0:
            low, high = self._range_n
            proposal = replace(proposal, thrust_n=low + state.thrust * (high - low))
        return state, proposal


class _Plan:
    """What the adversary is about; changed in place."""

    def __init__(self, inner: Any, rng: np.random.Generator) -> None:
        self.inner, self._rng = inner, rng
        self._until_us = -1
        self.way: F64 = np.zeros(3)
        """Direction, each axis in [-1, 1]."""
        self.thrust = -1.0
        """Share of the thrust's range; below 0: the inner controller's."""

    def place(self, measurement: Measurement, reference: FlatOutput) -> F64:
        """Where the inner controller is to fly: sideways turned back from too far, in height near where it is, for a
        climb beyond what thrust gives would leave it nothing to hold its place with."""
        way, here = self.way.copy(), measurement.pos_ned_m
        far = np.hypot(*(here - reference.pos_ned_m)[:2]) > _FAR_M
        if far or np.hypot(*measurement.vel_ned_mps[:2]) > _FAST_MPS:
            way[:2] = 0.0
        base: F64 = np.append(reference.pos_ned_m[:2], here[2])
        return base + _STEERED_M * way

    def plan(self, measurement: Measurement, reference: FlatOutput, now_us: int) -> None:
        """Another manner when the present one's time is over."""
        if now_us < self._until_us:
            return
        rng = self._rng
        manner = int(rng.integers(3))
        self._until_us = now_us + int(1e6 * rng.uniform(0.2, 1.5))
        away = measurement.pos_ned_m - reference.pos_ned_m
        if manner == 2:
            self.way, self.thrust = rng.uniform(-1.0, 1.0, 3), float(rng.choice([-1.0, 0.0, 1.0, rng.uniform()]))
            return
        self.way = _signs(away if manner == 0 else measurement.vel_ned_mps)
        self.thrust = 0.0 if self.way[2] > 0.0 else 1.0  # down is positive: less thrust is further down
        self.way[2] = 0.0


def _signs(values: F64) -> F64:
    return np.asarray(np.where(values >= 0.0, 1.0, -1.0))
