"""MAVSDK-Python, unmodified, flies `flightstack sim` over real sockets: the client is `mavsdk_flight.py` beside this.

Both run in processes of their own: a native library that crashes is a failed test, not a lost test run.  What the
client saw is held against what it asked for and against PX4's documented defaults.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from simulator import ENVIRONMENT, HOST, free_ports, simulator

pytestmark = pytest.mark.client

HERE = Path(__file__).resolve().parent
FLIGHT_LIMIT_S = 90.0


@pytest.fixture(scope="module")
def flight() -> dict[str, Any]:
    """Step -> what the client saw."""
    tried = subprocess.run([sys.executable, "-c", "import mavsdk.asyncio"], capture_output=True, text=True)
    if tried.returncode != 0:
        pytest.skip(f"MAVSDK-Python 4 can't be used here: {(tried.stderr.splitlines() or ['no reason given'])[-1]}")
    port, gcs_port = free_ports()
    with simulator(port, gcs_port):
        client = subprocess.run(
            [sys.executable, HERE / "mavsdk_flight.py", f"udpin://{HOST}:{port}"],
            capture_output=True, text=True, env=ENVIRONMENT, timeout=FLIGHT_LIMIT_S,
        )  # fmt: skip
    steps = [json.loads(line) for line in client.stdout.splitlines() if line.startswith("{")]
    assert client.returncode == 0, f"after {[step['step'] for step in steps][-1:]}:\n{client.stdout}\n{client.stderr}"
    return {step["step"]: step["saw"] for step in steps}


def test_the_vehicle_is_found_healthy_and_says_what_it_is(flight: dict[str, Any]) -> None:
    assert flight["connected"]["system"] == 1
    assert flight["connected"]["sdk"].lstrip("v").startswith("4.")
    assert flight["health"] is True
    assert flight["version"] == {"flight": [1, 18, 0], "uid": 5283920058631409231}  # as the recorded PX4 answered


def test_parameters_are_read_written_listed_and_refused(flight: dict[str, Any]) -> None:
    """MPC_XY_VEL_MAX 12 m/s and NAV_DLL_ACT 0 are the defaults of PX4's parameter reference."""
    seen = flight["parameters"]
    assert (seen["MPC_XY_VEL_MAX"], seen["NAV_DLL_ACT"]) == (12.0, 0)
    assert (seen["COM_OF_LOSS_T"], seen["COM_OBL_RC_ACT"]) == (5.0, 5)  # as set
    assert seen["listed"] > 100
    assert seen["refused"] == ["DOES_NOT_EXIST", "TYPE_MISMATCH"]


def test_every_stream_comes_at_the_rate_asked_for(flight: dict[str, Any]) -> None:
    """Counted over 8 s of the autopilot's clock: within 5 % and one sample at either end."""
    asked, came = flight["streams"]["asked_hz"], flight["streams"]["came_hz"]
    assert len(asked) >= 15
    assert came == pytest.approx(asked, rel=0.05, abs=0.25)


def test_it_takes_off_to_the_height_asked_for_and_will_not_disarm_there(flight: dict[str, Any]) -> None:
    assert flight["takeoff"] == pytest.approx(5.0, abs=0.5)
    assert flight["disarm in the air"] == "COMMAND_DENIED"


def test_offboard_flies_positions_velocities_and_body_rates(flight: dict[str, Any]) -> None:
    assert flight["offboard position"] == pytest.approx([5.0, 3.0, -8.0, 90.0], abs=5.0)
    assert flight["offboard velocity"] == pytest.approx([-2.0, 1.0, 0.0], abs=0.5)
    assert flight["offboard rate"] == pytest.approx(40.0, abs=6.0)
    assert flight["hold"] is False  # no longer offboard


def test_it_goes_to_places_on_the_globe_circles_and_takes_a_home(flight: dict[str, Any]) -> None:
    assert flight["goto"] == pytest.approx([0.0, 0.0, 45.0], abs=5.0)
    assert flight["goto"][:2] == pytest.approx([0.0, 0.0], abs=0.5)
    assert flight["orbit"] == pytest.approx(2.0, abs=0.5)
    assert flight["set home"] == pytest.approx([-5.0], abs=0.01)


def test_it_returns_lands_and_disarms(flight: dict[str, Any]) -> None:
    assert flight["return"] == pytest.approx([0.0, 0.0], abs=1.5)
    assert flight["landed"] == pytest.approx(0.0, abs=0.3)
    assert list(flight)[-1] == "disarmed"
