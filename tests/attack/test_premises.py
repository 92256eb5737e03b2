"""What a certificate takes as given: estimates as good as it says, joint over axes, and the thrust that was learned."""

from __future__ import annotations

import pytest
from attacked import attacked, engaged, held

from benchmarks.attack_adversary import KNOWN, PUSH
from benchmarks.attack_worlds import World
from flightstack.barrier.premise_watch import NAMES
from flightstack.types import TickRecord

pytestmark = pytest.mark.attack


@pytest.mark.parametrize("strategy", [PUSH, KNOWN])
def test_estimates_are_as_good_as_the_certificate_says(strategy: object) -> None:
    outcome = attacked(World(0), 6, strategy)  # type: ignore[arg-type]
    held(outcome)
    assert outcome.premises > 1000
    assert outcome.premises_true >= 0.999 * outcome.premises, outcome


@pytest.mark.parametrize(("share", "over_s"), [(0.92, 0.0), (0.92, 10.0)])
def test_thrust_that_is_lost_at_once_or_little_by_little_is_noticed_inside(share: float, over_s: float) -> None:
    """While pushed.  The range of the gain, some 7 % to either side of what was learned, is left on the way down."""
    flight = engaged(World(0), 6)
    plant, start_us = flight.vehicle.plant, flight.t_us

    def weaken(record: TickRecord) -> None:
        lost = min(1e-6 * (record.t_us - start_us) / over_s, 1.0) if over_s else 1.0
        plant.set_effect("thrust_scale", {"scale": 1.0 - (1.0 - share) * lost})

    outcome = flight.attack(PUSH, 15.0, weaken)
    assert outcome.least_h >= 0.0, outcome
    assert outcome.infeasible == 0, outcome
    assert NAMES[outcome.broken] == "thrust gain", outcome
    assert outcome.broken_s < (over_s or 1.0), outcome
