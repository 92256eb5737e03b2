"""A short exploration with GPS: its certificate is derived from the log of its flight, by points that the log tells."""

from __future__ import annotations

from pathlib import Path

from flightstack.certificate_check import DERIVED, check
from flightstack.cli.certify import certify
from flightstack.cli.flight import FlyOptions
from flightstack.explore import ExploreConfig
from tests.thorough import ONLY_THEN


@ONLY_THEN
def test_the_log_of_a_gps_flight_stands_behind_its_certificate(tmp_path: Path) -> None:
    """Seed 1: its first windows seem so noisy that their thrust is learned as what the reference asked for."""
    options = FlyOptions(scenario="gps-barrier", seed=1, duration_s=36.0, out=tmp_path)
    result = certify(options, stop_requested=lambda: "", config=ExploreConfig(rounds_max=1))
    assert result.flight.completed, result.flight.reason
    assert result.flight.flown["first_height_m"] > 5.0
    assert result.certificate is not None
    assert result.flight.log is not None
    with Path(result.flight.log).open("rb") as file:
        verdict = check(Path(result.certificate).read_text(), file)
    assert verdict.valid, verdict.lines[-1]
    assert verdict.level == DERIVED
