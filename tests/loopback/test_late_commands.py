"""The companion stands still for a moment while it is protected: what is told, and when it ends the flight."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from flightstack.cli.flight import FlyOptions, SimulatedFlight, prepare, warm_up_all
from flightstack_logs.reader import read
from flightstack_logs.writer import FlightLog

TICK_S = 0.004


class Stalled:
    """A flight of the paper's path, protected; `stall` lets the vehicle fly on alone."""

    def __init__(self, folder: Path) -> None:
        options = FlyOptions(scenario="paper-tracking", out=folder)
        setup = prepare(options)
        warm_up_all(setup)
        self.path = folder / "flight.mcap"
        self.log = FlightLog.open(self.path, metadata={})
        self.flight = SimulatedFlight(setup, options, self.log)
        self.watched = setup.flight.protection.watched
        self.record = self.flight.score.on_record
        self.broken: list[float] = []
        self.flight.companion._observer.record_to = self._on_record  # type: ignore[attr-defined]
        self.protecting = False

    def _on_record(self, record: object) -> None:
        self.record(record)  # type: ignore[arg-type]
        filtered = record.filtered  # type: ignore[attr-defined]
        self.protecting = filtered.status in (2.0, 3.0)
        if filtered.premise > 0.0:
            self.broken.append(filtered.premise)

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.flight.step()

    def stall(self, seconds: float) -> None:
        """So long between two ticks of the companion."""
        companion = self.flight.companion
        step, companion.step = companion.step, lambda now_us: None  # type: ignore[method-assign]
        self.fly(seconds - TICK_S)
        companion.step = step  # type: ignore[method-assign]
        self.flight.step()


@pytest.fixture(scope="module")
def stalled(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stalled]:
    made = Stalled(tmp_path_factory.mktemp("stalled"))
    while not made.protecting:
        made.fly(1.0)
        assert made.flight.t_us < 40e6
    yield made
    made.flight.close()


def certified_s(stalled: Stalled) -> float:
    """The command interval of the certificate in force."""
    premises = stalled.watched.adopted[-1].premises  # type: ignore[union-attr]
    assert premises is not None
    return premises.command_interval_s


def test_a_loop_that_was_never_late_is_certified_for_its_own_period(stalled: Stalled) -> None:
    assert stalled.broken == []
    assert certified_s(stalled) == pytest.approx(0.004)


@pytest.mark.parametrize("gap_s", [0.016, 0.032, 0.1])
def test_one_late_command_is_told_and_the_protected_flight_goes_on(stalled: Stalled, gap_s: float) -> None:
    stalled.fly(1.5)
    before = len(stalled.broken)
    stalled.stall(gap_s)
    assert stalled.broken[before:] == [11.0]
    stalled.fly(1.0)
    assert stalled.broken[before:] == [11.0]
    assert stalled.protecting
    assert stalled.flight.companion.state.value == "offboard"
    assert stalled.flight.score.prepared.protection.filter.enabled


def test_afterwards_it_is_certified_for_commands_that_far_apart(stalled: Stalled) -> None:
    for _ in range(40):
        stalled.fly(0.5)
        if certified_s(stalled) > 0.004:
            break
    assert certified_s(stalled) == pytest.approx(0.012)
    before = len(stalled.broken)
    stalled.stall(0.012)
    stalled.fly(0.5)
    assert stalled.broken[before:] == [], "what the certificate holds for breaks nothing"


def test_a_quarter_of_a_second_ends_the_certificate_and_it_brakes_until_there_is_another(stalled: Stalled) -> None:
    before = stalled.watched.adopted[-1].version  # type: ignore[union-attr]
    stalled.stall(0.24)
    stalled.fly(8.0)
    stalled.log.close()
    assert stalled.watched.adopted[-1].version > before or stalled.flight.companion.reason  # type: ignore[union-attr]
    events = read(stalled.path).tables["/events"]
    texts = events["text"].tolist()
    assert sum(text.startswith("filter: premise broken: command interval (h") for text in texts) == 4
    assert texts.count("filter: premise broken: command interval: braking, to rest") == 1
