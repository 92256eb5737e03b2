"""DroneKit, unmodified, flies `flightstack sim`: `make client-dronekit` (its package is not among the tests' own)."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from simulator import ENVIRONMENT, HOST, free_ports, simulator

pytestmark = pytest.mark.client


def test_dronekit_connects_arms_changes_modes_and_lands() -> None:
    tried = subprocess.run([sys.executable, "-c", "import dronekit"], capture_output=True, text=True)
    if tried.returncode != 0:
        pytest.skip("DroneKit is not installed: make client-dronekit installs and runs it")
    port, gcs_port = free_ports()
    with simulator(port, gcs_port, speed=2):
        client = subprocess.run(
            [sys.executable, Path(__file__).with_name("dronekit_flight.py"), f"udpin:{HOST}:{port}"],
            capture_output=True, text=True, env=ENVIRONMENT, timeout=150.0,
        )  # fmt: skip
    steps = [json.loads(line) for line in client.stdout.splitlines() if line.startswith("{")]
    assert client.returncode == 0, client.stdout + client.stderr
    seen = {step["step"]: step["saw"] for step in steps}
    assert list(seen) == ["connected", "parameters", "armed", "takeoff", "LOITER", "RTL", "LAND", "disarmed"]
    assert "PX4" in seen["connected"]
    assert seen["parameters"] > 100
    assert seen["disarmed"] == pytest.approx(0.0, abs=0.3)
