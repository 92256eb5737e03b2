"""Each effect on parameters, commands and sensors, hidden in a short flight, is found; nothing in a clean one."""

from __future__ import annotations

import pytest

from flightstack.effects import EFFECTS
from tests.gap_hidden import HIDDEN, flights, named

KINDS = ("parameter", "command", "sensor")


def check_found(effect: str, tolerance: float = 0.1) -> None:
    """The effect alone is named, its parameters are those hidden: within `tolerance` of them or in their interval."""
    verdict = named(flights()[effect])
    assert [found.name for found in verdict.found] == [effect]
    assert not verdict.unexplained.significant
    for parameter, hidden in HIDDEN[effect].items():
        got = verdict.found[0].parameters[parameter]
        assert got.estimate == pytest.approx(hidden, rel=tolerance) or got.low <= hidden <= got.high
    for parameter, value in verdict.vehicle.effects[effect].items():
        assert value == verdict.found[0].parameters[parameter].estimate


@pytest.mark.parametrize("effect", [name for name, spec in EFFECTS.items() if spec.kind in KINDS])
def test_a_hidden_effect_is_found(effect: str) -> None:
    check_found(effect)


def test_in_a_clean_flight_nothing_is_named() -> None:
    verdict = named(flights()[""])
    assert verdict.found == ()
    assert not verdict.unexplained.significant
    assert {r.name for r in verdict.rejected} == set(EFFECTS)
