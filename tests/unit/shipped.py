"""The shipped files, for tests that need one."""

from __future__ import annotations

from pathlib import Path

from flightstack.cli import files
from flightstack.scenario import Scenario
from flightstack.vehicle import Vehicle

ROOT = Path(__file__).resolve().parents[2]


def load_scenario(name: str) -> Scenario:
    return files.load_scenario(name)[0]


def load_vehicle(name: str) -> Vehicle:
    return files.load_vehicle(name)[0]
