"""Flights that learn, over UDP: the learner is really fed, and it pays.  Truth comes from the simulator alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flightstack.cli.controllers import load_gains
from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.result import FlightResult
from flightstack.control.gains import FlatnessGains
from flightstack_logs.reader import Log, read
from tests.thorough import ONLY_THEN

ROOT = Path(__file__).resolve().parents[2]


def _fly(folder: Path, scenario: str, **options: object) -> tuple[FlightResult, Log]:
    folder.mkdir(exist_ok=True)
    result = fly(FlyOptions(scenario=scenario, out=folder, **options), report_wanted=lambda result: False)  # type: ignore[arg-type]
    assert result.completed, result.reason
    return result, read(folder / "flight.mcap")


def _with_events(folder: Path, name: str, *events: str) -> str:
    """A shipped scenario with these events instead of its own; the path of its file."""
    text = (ROOT / "flightstack/data/scenarios" / f"{name}.toml").read_text()
    kept = text[: min(text.find(part) for part in ("[[events]]", "[[checks]]", "\0") if part in text + "\0")]
    path = folder / f"{name}-events.toml"
    path.write_text(kept + "\n" + "\n".join(f"[[events]]\n{event}" for event in events) + "\n")
    return str(path)


def _event_time_us(log: Log) -> list[int]:
    events = log.tables["/events"]
    return [int(t) for t, name in zip(events.t_us, events["name"], strict=True) if name == "effect"]


@ONLY_THEN
def test_on_the_papers_path_learning_leaves_a_tenth_of_the_error_and_was_really_fed(tmp_path: Path) -> None:
    """Without it the thrust that is lacking, 0.4 g, is carried by the position error alone (`test_fly.py` flies that):
    with poles at p the nominal's stiffness is p^2 / 3, and the feedback adds K_p / m."""
    learning, log = _fly(tmp_path, "paper-tracking", duration_s=16.0, seed=11)
    gains = load_gains()["flatness"].groups[1]
    assert isinstance(gains, FlatnessGains)
    droop_m = 0.4 * 9.80665 / (gains.pole_z_radps**2 / 3.0 + gains.thrust_p_ps2)
    assert learning.tracking["rmse_settled_m"] <= 0.1 * droop_m
    ticks = len(log.tables["/tick"])
    assert 0.8 * ticks < learning.gp["fed"] <= ticks
    assert learning.gp["points"] > 200
    assert float(log.tables["/learner"]["stage"].max()) == 3.0
    assert learning.gp["thrust_gain"] == pytest.approx(1.0 / 1.4, rel=0.05)  # the inverse of the true mass ratio


@ONLY_THEN  # in memory: test_learned_tails.py
def test_the_bound_holds_the_true_residual(tmp_path: Path) -> None:
    result, _ = _fly(tmp_path, "steady-wind", duration_s=20.0, seed=13)
    assert 0.98 < result.gp["coverage_3sigma"] <= 1.0


@ONLY_THEN
def test_px4s_draggy_quadrotor_flies_its_figure_within_8_cm_though_no_drag_is_believed(tmp_path: Path) -> None:
    vehicles = {"vehicle": "px4-sihsim-quadx-no-drag", "truth": "px4-sihsim-quadx"}
    result, _ = _fly(tmp_path, "figure8", duration_s=16.0, sensors="mocap", seed=15, **vehicles)
    assert result.tracking["rmse_m"] <= 0.08


def test_a_dropped_payload_is_noticed_within_0_3_s_and_learned_within_2_s(tmp_path: Path) -> None:
    drop = 'time_s = 8.0\neffect = "payload"\nvalues = { mass_kg = 0.0 }'
    result, log = _fly(tmp_path, _with_events(tmp_path, "payload-drop", drop), duration_s=14.0, seed=16)
    (at_us,) = _event_time_us(log)
    learner = log.tables["/learner"]
    changes, since_s = learner["changes"], (learner.t_us - at_us) * 1e-6
    told = since_s[changes > changes[since_s < 0.0][-1]]
    assert 0.0 <= told[0] <= 0.3
    width = learner["sigma_frd_mps2"][:, 2]
    before = float(np.median(width[(since_s > -1.0) & (since_s < 0.0)]))
    assert float(width[(since_s >= told[0]) & (since_s < told[0] + 0.02)].max()) > 5.0 * before
    # 1.25 times the believed mass lack a quarter of the weight's thrust, 2.5 m/s^2: what was learned of it must go
    expected = learner["residual_frd_mps2"][:, 2]
    assert abs(float(np.mean(expected[(since_s > -1.0) & (since_s < 0.0)]))) > 1.5
    assert abs(float(np.mean(expected[(since_s > 2.0) & (since_s < 3.0)]))) < 0.1
    assert result.gp["changes"] == 1
