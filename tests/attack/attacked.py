"""What every attack's test asserts: it really flew, under a filter that was really engaged, and stayed inside."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

from benchmarks.attack_adversary import Strategy
from benchmarks.attack_block import apart
from benchmarks.attack_flight import AttackFlight, Outcome
from benchmarks.attack_worlds import World
from flightstack.types import TickRecord

PATIENCE_S = 60.0
"""With a force from above a vertical certificate comes after 43 s."""


def engaged(world: World, seed: int) -> AttackFlight:
    """A flight that has learned, certified and engaged, and keeps the certificate that it has."""
    flight = AttackFlight(world, seed)
    engaged_s = flight.fly_until_engaged(PATIENCE_S)
    assert engaged_s is not None, f"never engaged: {flight.ended or 'nothing was certified'}"
    assert flight.certificate is not None
    flight.held.hold(flight.certificate)
    return flight


def attacked(world: World, seed: int, strategy: Strategy, seconds: float = 10.0) -> Outcome:
    """Learn, certify, attack; the outcome of a flight that counts."""
    return engaged(world, seed).attack(strategy, seconds)


def struck(
    flight: AttackFlight, strategy: Strategy, seconds: float = 10.0, each: Callable[[TickRecord], None] | None = None
) -> Outcome:
    """What comes of an attack that branches off from a flight in a process of its own: the next begins there too."""
    return Outcome(**apart(lambda: asdict(flight.attack(strategy, seconds, each))))


def held(outcome: Outcome, may_break: tuple[int, ...] = ()) -> None:
    """No exit, no infeasible step, engaged for at least half of the ticks, nothing falsified, no premise broken but
    those that may (`barrier.premise_watch.NAMES`)."""
    assert outcome.least_h >= 0.0, outcome
    assert outcome.infeasible == 0, outcome
    assert outcome.share >= 0.5, outcome
    assert outcome.falsified == 0, outcome
    assert outcome.broken in (0, *may_break), outcome
    assert outcome.travelled_m > 0.3, outcome
