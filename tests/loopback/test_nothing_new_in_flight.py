"""In flight nothing is imported, compiled or worked out that could have been before: each would be a stall."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest
from numba.core import event

from flightstack.cli.files import load_scenario
from flightstack.cli.flight import FlyOptions, SimulatedFlight, prepare, warm_up_all
from flightstack.mission import plan, run_up_of
from flightstack_logs.writer import FlightLog
from mavlink_bridge.handshake import State
from tests.thorough import thorough


@pytest.mark.parametrize(
    ("scenario", "fault"), [("figure8", None), ("hover", "link-jitter@4"), thorough("hover", "link-loss@4")]
)
def test_from_offboard_to_the_landing_nothing_is_imported_or_compiled(
    tmp_path: Path, scenario: str, fault: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a link that delays, messages come by themselves, and what writes each to the log is Python's own code."""
    options = FlyOptions(scenario=scenario, out=tmp_path, duration_s=5.0, fault=fault)
    setup = prepare(options)
    warm_up_all(setup)
    log = FlightLog.open(tmp_path / "flight.mcap", metadata={})
    flight = SimulatedFlight(setup, options, log)
    try:
        while flight.companion.state is not State.OFFBOARD:
            flight.step()
        before, made, compiler = set(sys.modules), [], compile
        monkeypatch.setattr(
            "builtins.compile", lambda *args, **more: (made.append(args[0]), compiler(*args, **more))[1]
        )
        with event.install_recorder("numba:compile") as compiled:
            while not flight.companion.done:
                flight.step()
        assert flight.companion.state is State.LANDED
        assert set(sys.modules) == before
        assert not compiled.buffer
        assert not made
    finally:
        flight.close()
        log.close()


def test_with_the_run_up_known_beforehand_a_plan_takes_a_fraction_of_the_time_and_is_the_same() -> None:
    scenario, _ = load_scenario("figure8")
    run_up = run_up_of(scenario)
    start = run_up.path.at(0.0).pos_ned_m * 0.0 + 1.0  # type: ignore[union-attr]

    def best_s(given: object) -> float:
        times = []
        for _ in range(5):
            began = time.thread_time()
            plan(scenario, start, 0.3, given)  # type: ignore[arg-type]
            times.append(time.thread_time() - began)
        return min(times)

    assert best_s(run_up) < 0.25 * best_s(None)
    with_it, without = plan(scenario, start, 0.3, run_up), plan(scenario, start, 0.3)
    for t_s in (0.0, 2.0, with_it.track_start_s - 0.5, with_it.track_start_s + 1.0):
        assert (with_it.reference(t_s).row == without.reference(t_s).row).all()
