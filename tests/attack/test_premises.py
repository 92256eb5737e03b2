"""What a certificate takes as given: estimates as good as it says, joint over axes, and the thrust that was learned."""

from __future__ import annotations

import pytest
from attacked import engaged, held, struck

from benchmarks.attack_adversary import KNOWN, PUSH, RANDOM, SWING, Strategy
from benchmarks.attack_flight import AttackFlight
from benchmarks.attack_worlds import World
from flightstack.barrier.premise_watch import NAMES
from flightstack.types import TickRecord
from tests.thorough import thorough

pytestmark = pytest.mark.attack

SWITCH = PUSH._replace(vertical=SWING, lateral=SWING, swing_s=0.3, steer_ps=15.0)
"""Thrust between its ends and leaning to and fro, each 0.15 s."""
AT_RANDOM = SWITCH._replace(vertical=RANDOM, lateral=RANDOM, swing_s=0.1)


@pytest.fixture(scope="module")
def flight() -> AttackFlight:
    return engaged(World(0), 6)


@pytest.fixture(scope="module")
def another() -> AttackFlight:
    return engaged(World(0), 7)


@pytest.fixture(scope="module")
def late() -> AttackFlight:
    """Its samples and its commands take 20 ms each."""
    return engaged(World(6, down_ms=20.0, up_ms=20.0), 6)


@pytest.mark.parametrize("strategy", [PUSH, thorough(KNOWN)])
def test_estimates_are_as_good_as_the_certificate_says(flight: AttackFlight, strategy: Strategy) -> None:
    outcome = struck(flight, strategy)
    held(outcome)
    assert outcome.premises > 1000
    assert outcome.premises_true >= 0.999 * outcome.premises, outcome


@pytest.mark.parametrize("strategy", [SWITCH, thorough(AT_RANDOM)])
def test_commands_under_way_on_a_late_link_leave_estimates_as_good(late: AttackFlight, strategy: Strategy) -> None:
    """With the force last measured 9 to 11 % of the ticks were beyond the bounds."""
    outcome = struck(late, strategy)
    held(outcome)
    assert outcome.premises > 1000
    assert outcome.premises_true >= 0.999 * outcome.premises, outcome


@pytest.mark.parametrize(("share", "over_s"), [(0.92, 0.0), (0.9, 0.0), (0.92, 10.0)])
@pytest.mark.parametrize("seed", [7, thorough(6)])
def test_thrust_that_is_lost_at_once_or_little_by_little_is_noticed_inside(
    seed: int, share: float, over_s: float, request: pytest.FixtureRequest
) -> None:
    """While pushed.  The range of the gain, some 7 % to either side of what was learned, is left on the way down.

    After that whoever pushed no longer flies: through a filter that goes by bounds which no longer hold he left.
    """
    flight: AttackFlight = request.getfixturevalue("flight" if seed == 6 else "another")
    plant, start_us = flight.vehicle.plant, flight.t_us

    def weaken(record: TickRecord) -> None:
        lost = min(1e-6 * (record.t_us - start_us) / over_s, 1.0) if over_s else 1.0
        plant.set_effect("thrust_scale", {"scale": 1.0 - (1.0 - share) * lost})

    outcome = struck(flight, PUSH, 15.0, weaken)
    assert outcome.least_h >= 0.0, outcome
    assert outcome.infeasible == 0, outcome
    assert NAMES[outcome.broken] == "thrust gain", outcome
    assert outcome.broken_s < (over_s or 1.0), outcome
