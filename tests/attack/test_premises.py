"""What a certificate takes as given: that estimates are as good as it says, joint over axes, under attack."""

from __future__ import annotations

import pytest
from attacked import attacked, held

from benchmarks.attack_adversary import KNOWN, PUSH
from benchmarks.attack_worlds import World

pytestmark = pytest.mark.attack


@pytest.mark.parametrize("strategy", [PUSH, KNOWN])
def test_estimates_are_as_good_as_the_certificate_says(strategy: object) -> None:
    outcome = attacked(World(0), 6, strategy)  # type: ignore[arg-type]
    held(outcome)
    assert outcome.premises > 1000
    assert outcome.premises_true >= 0.999 * outcome.premises, outcome
