"""Whole flights over UDP on the JSBSim plant, the native model believed, with learner, certifier and barrier filter."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from flightstack.cli.certify import ExplorationPlanner, prepare_certify
from flightstack.cli.flight import FlyOptions, fly, fly_setup
from flightstack.cli.result import FlightResult
from flightstack.explore import ExploreConfig, Explorer
from flightstack_logs.reader import Log, read
from tests.thorough import ONLY_THEN

pytest.importorskip("jsbsim", reason="no JSBSim here (wheels exist for x86-64 only)")
pytestmark = pytest.mark.jsbsim
ROOT = Path(__file__).resolve().parents[2]


def flown(tmp_path: Path, scenario: str, **options: object) -> tuple[FlightResult, Log]:
    asked = FlyOptions(scenario=scenario, out=tmp_path, plant="jsbsim", **options)  # type: ignore[arg-type]
    result = fly(asked, report_wanted=lambda result: False)
    return result, read(tmp_path / "flight.mcap")


def test_the_paper_s_flight_learns_the_mass_and_stays_inside_on_the_other_physics(tmp_path: Path) -> None:
    """1.4 times the mass: the learned gain is its inverse; nothing of JSBSim is known to controller or filter."""
    result, log = flown(tmp_path, "paper-tracking", duration_s=12.0)
    assert result.completed, result.reason
    assert result.plant == "jsbsim"
    assert result.tracking["of"] == "truth"
    assert result.tracking["rmse_m"] < 0.03
    assert result.barrier["enabled"]
    assert result.barrier["violations"] == 0
    assert result.barrier["min_h_truth"] > 0.0
    assert result.gp["thrust_gain"] == pytest.approx(1 / 1.4, rel=0.03)
    assert result.gp["coverage_3sigma"] > 0.97
    assert log.metadata["settings"]["plant"] == "jsbsim"
    assert log.tables["/truth"]["pos_ned_m"][:, 2].min() < -1.0


@ONLY_THEN
def test_the_certified_region_grows_and_is_not_left_on_the_other_physics(tmp_path: Path) -> None:
    """`certify --plant jsbsim`'s flight, one round: what the native model's certifier says holds for JSBSim's truth."""
    options = FlyOptions(scenario="paper-barrier", seed=21, duration_s=30.0, out=tmp_path, plant="jsbsim")
    setup = prepare_certify(options)
    certifier = setup.flight.protection.watched
    assert certifier is not None
    planner = ExplorationPlanner(Explorer(ExploreConfig(axes=(2,), rounds_max=1)), certifier)
    result = fly_setup(setup, options, planner=planner, stop_requested=lambda: "")
    assert result.completed, result.reason
    assert result.plant == "jsbsim"
    assert result.barrier["violations"] == 0
    assert result.barrier["min_h_truth"] > 0.0
    areas = [certificate.axes[0].barrier.area_m2ps for certificate in certifier.adopted]
    assert len(areas) > 1
    assert areas[-1] > areas[0]


@ONLY_THEN
def test_rotor_drag_and_lift_that_only_jsbsim_knows_are_learned(tmp_path: Path) -> None:
    result, _ = flown(tmp_path, "steady-wind", duration_s=8.0)
    assert result.completed, result.reason
    assert result.tracking["rmse_settled_m"] < 0.03


def test_jsbsim_s_f450_flies_its_own_motors_and_propellers(tmp_path: Path) -> None:
    result, log = flown(tmp_path, "hover", vehicle="f450", duration_s=4.0)
    assert result.completed, result.reason
    assert result.tracking["rmse_m"] < 0.03
    truth = log.tables["/truth"]
    hovering = np.linalg.norm(truth["vel_ned_mps"], axis=1) < 0.1
    hovering &= truth["pos_ned_m"][:, 2] < truth["pos_ned_m"][:, 2].min() + 0.1
    thrust = np.sum(truth["rotor_thrust_n"], axis=1)[hovering]
    assert len(thrust) > 100  # 25 a second
    assert np.median(thrust) == pytest.approx(1.4 * 9.8069, rel=0.01)


def test_sim_alone_flies_jsbsim_too(tmp_path: Path) -> None:
    """`flightstack sim --plant jsbsim` comes up and simulates."""
    result = tmp_path / "sim.json"
    command = [
        sys.executable, "-m", "flightstack", "sim", "--plant", "jsbsim", "--duration", "1", "--speed", "10",
        "--port", "47110", "--gcs-port", "47111", "--json", str(result),
    ]  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert "is up" in done.stdout
    found = json.loads(result.read_text())
    assert found["plant"] == "jsbsim"
    assert found["simulated_s"] >= 1.0
