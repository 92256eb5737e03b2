"""A log whose IMU is rare or missing answers what its attitude and velocity can answer, and names nothing else.

The flight is a real PX4's (SIH: 1 kg, drag 1 kg/s); its file is right, or 0.13 kg too light.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from flightstack.cli.files import load_vehicle
from flightstack.gap import workflow
from flightstack.gap.check import check
from flightstack.gap.read import flight
from flightstack.gap.records import Flight, Signal
from flightstack.gap.result import GapResult
from flightstack.vehicle import Vehicle
from tests.thorough import ONLY_THEN

LOG = "px4_sih_flight.ulg.gz"
ACCELEROMETER, GYRO = "accel_frd_mps2", "rate_frd_radps"


def rarer(log: Flight, names: tuple[str, ...], every: int) -> Flight:
    """Every so manieth sample of these signals; none where `every` is 0."""
    signals = dict(log.signals)
    for name in names:
        each = signals.pop(name)
        if every:
            signals[name] = Signal(each.t_s[::every], each.value[::every], each.source)
    return replace(log, signals=signals)


def said(monkeypatch: pytest.MonkeyPatch, recorded: Path, lighter_kg: float, *spoilt: object) -> GapResult:
    vehicle = load_vehicle(str(recorded / "px4_sih.toml"))[0]

    def read(path: Path, of: Vehicle, columns: object = None) -> Flight:
        return rarer(flight(path, of), *spoilt)  # type: ignore[arg-type]

    monkeypatch.setattr(workflow, "flight", read)
    return workflow.analyse([recorded / LOG], replace(vehicle, mass_kg=vehicle.mass_kg - lighter_kg))


@pytest.mark.parametrize(
    ("names", "every"),
    [
        ((ACCELEROMETER,), 0),
        pytest.param((ACCELEROMETER, GYRO), 25, marks=ONLY_THEN),
        pytest.param((GYRO,), 25, marks=ONLY_THEN),
    ],
    ids=["no accelerometer", "IMU at 10 Hz", "gyro at 10 Hz"],
)
@pytest.mark.parametrize("lighter_kg", [0.0, 0.13])
def test_a_rare_or_missing_imu_leaves_the_verdict_as_it_is(
    monkeypatch: pytest.MonkeyPatch, recorded: Path, names: tuple[str, ...], every: int, lighter_kg: float
) -> None:
    result = said(monkeypatch, recorded, lighter_kg, names, every)
    assert not result.unexplained.significant
    assert [found.name for found in result.found] == (["payload"] if lighter_kg else [])
    for found in result.found:
        mass = found.parameters["mass_kg"]
        assert mass.low <= lighter_kg <= mass.high


@pytest.mark.parametrize(
    ("name", "every", "used"),
    [(GYRO, 25, False), (GYRO, 2, True), (ACCELEROMETER, 25, False), (ACCELEROMETER, 10, True)],
)
def test_what_is_rarer_than_what_says_the_same_is_not_used_and_that_is_said(
    recorded: Path, name: str, every: int, used: bool
) -> None:
    vehicle = load_vehicle(str(recorded / "px4_sih.toml"))[0]
    checked = check(rarer(flight(recorded / LOG, vehicle), (name,), every), vehicle)
    assert checked.samples is not None
    assert (name not in checked.samples.derived) == used
    assert [f"{name}: 10 Hz is rarer" in each.text for each in checked.findings].count(True) == (0 if used else 1)
