"""What a flight is judged by: the vehicle's words, one by one or several at once."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from flightstack.cli.flight import FlyOptions, prepare
from flightstack.cli.score import FlightScore
from mavlink_bridge import messages as m
from mavlink_bridge.frequent import FrequentReader, Heard
from mavlink_bridge.link import Link

FLOWN = [(-1.0, 0.5), (-0.3, 0.6), (-0.05, 0.7), (-0.02, 0.1)]
"""Height down and vertical velocity, m and m/s: a landing."""


def _said(*, at_once: bool) -> list[Any]:
    vehicle, link = Link(1, 1), Link(240, 191)
    if at_once:
        link.read_runs(FrequentReader(1, 1))
    vehicle.send(m.Heartbeat(2, 12, 0, 0, 4))
    for down_m, down_mps in FLOWN:
        vehicle.send(m.LocalPositionNed(4000, (0.0, 0.0, down_m), (0.0, 0.0, down_mps)))
    for data in vehicle.datagrams_to_send():
        link.receive_datagram(data, 0)
    said = [received.message for received in link.take_events()]
    assert sum(isinstance(message, Heard) for message in said) == (len(FLOWN) if at_once else 0)
    return said


@pytest.mark.parametrize("at_once", [False, True])
@pytest.mark.parametrize(("landing", "hits_mps"), [(True, 0.7), (False, None)])
def test_an_estimated_descent_is_scored_from_the_command_to_land_on(
    at_once: bool, landing: bool, hits_mps: float | None
) -> None:
    score = FlightScore(prepare(FlyOptions(scenario="hover")).flight, of="estimate")
    score.companion = SimpleNamespace(land_command_us=1 if landing else -1)  # type: ignore[assignment]
    for message in _said(at_once=at_once):
        score.on_message(4000, message)
    assert score.ascent.touchdown_mps == (None if hits_mps is None else pytest.approx(hits_mps, abs=1e-6))
