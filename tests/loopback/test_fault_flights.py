"""Faults in flight, over MAVLink, simulator and companion together.

What the autopilot does follows PX4's documentation at its default parameters: lost setpoints COM_OF_LOSS_T 1 s plus
at most a cycle of its checks, ground station COM_DL_LOSS_T 10 s and COM_FAIL_ACT_T 5 s in Hold, and so on.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.faults import fly_fault
from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.main import main
from mavlink_bridge.handshake import State
from tests.thorough import ONLY_THEN

CYCLE_S = 0.1
WATCHDOGS_S = 5.0
LANDS_WITHIN_S = 40.0


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("setpoint-loss@2", [(1.0, "Return")]),
        ("setpoint-loss:5@2", [(1.0, "Hold")]),
        ("gcs-loss:3@2", [(10.0, "Hold"), (15.0, "Land")]),
        ("low-battery@2", [(0.0, "Hold"), (5.0, "Return")]),
        ("low-battery:0.04@2", [(0.0, "Hold"), (5.0, "Land")]),
        ("geofence@2", [(0.0, "Hold")]),
    ],
)
def test_the_autopilot_reacts_as_the_table_says(fault: str, expected: list[tuple[float, str]]) -> None:
    """Each mode at its time or within two cycles of it; a heartbeat (1 Hz) may be as old as a second when it is cut."""
    slack_s = 1.0 if "gcs" in fault else 0.0
    lands = expected[-1][1] in ("Return", "Land")
    flown = fly_fault(fault, limit_s=LANDS_WITHIN_S if lands else 3.0)
    seen = [(t_s, mode) for t_s, mode, failsafe in flown.modes if failsafe][: len(expected)]
    assert [mode for _, mode in seen] == [mode for _, mode in expected]
    for (t_s, _), (due_s, _) in zip(seen, expected, strict=True):
        assert due_s - slack_s - 1e-6 <= t_s <= due_s + 2 * CYCLE_S
    assert flown.companion == State.PILOT.value  # hands off: the mode was not its own doing
    if lands:
        assert flown.disarmed_s < LANDS_WITHIN_S
        assert 0.0 < flown.speed_at_ground_mps < 1.2  # MPC_LAND_SPEED 0.7 m/s


def test_an_estimate_without_a_position_ends_on_the_ground() -> None:
    flown = fly_fault("estimator-loss@2", limit_s=LANDS_WITHIN_S)
    assert flown.modes[-1][1] == "Descend"
    assert flown.modes[-1][0] < WATCHDOGS_S
    assert flown.disarmed_s < LANDS_WITHIN_S
    assert 0.0 < flown.speed_at_ground_mps < 1.2
    assert flown.drift_m < 3.0


@pytest.mark.parametrize(
    ("fault", "mode", "within_s"),
    [
        ("position-stale@2", "Land", 1.0),
        ("position-frozen@2", "Land", 0.5),
        ("attitude-loss@2", "Land", 1.0),
        ("clock-jump@2", "Hold", 0.5),
    ],
)
def test_the_companion_hands_back_what_it_can_not_trust(fault: str, mode: str, within_s: float) -> None:
    """Each within the time that a second's flight at the present speed allows; what it hands back to is PX4's own."""
    flown = fly_fault(fault, limit_s=3.0)
    at_s, seen, by_failsafe = flown.modes[0]
    assert (seen, by_failsafe) == (mode, False)
    assert at_s < within_s


def test_a_counted_reset_ends_nothing() -> None:
    flown = fly_fault("ekf-reset:1@2", limit_s=3.0)
    assert flown.modes == ()
    assert flown.companion == State.OFFBOARD.value


def _tracked(fault: str | None, folder: Path, *, seed: int = 0) -> dict[str, object]:
    options = FlyOptions(scenario="figure8", duration_s=8.0, fault=fault, seed=seed, out=folder, learning=False)
    return fly(options, report_wanted=lambda result: False).as_json()


@ONLY_THEN
def test_tracking_degrades_gracefully_on_a_bad_link(tmp_path: Path) -> None:
    """10 % loss, 20 ms jitter, 1 % damage, both ways: a lap at up to 3.3 m/s, flown to its end.

    20 ms more latency at 3.3 m/s are 7 cm that a controller could not know; 15 cm is within grace, metres are not.
    """
    clean = _tracked(None, tmp_path / "clean")
    bad = _tracked("link-degraded", tmp_path / "bad", seed=1)
    assert bad["completed"] is True
    assert bad["tracking"]["max_m"] < 0.15  # type: ignore[index]
    assert bad["tracking"]["rmse_m"] < 5.0 * clean["tracking"]["rmse_m"]  # type: ignore[index]


def test_delay_doubles_disorder_and_damage_together_end_no_flight(tmp_path: Path) -> None:
    fault = "link-delay:10,link-duplicate:0.2,link-reorder:0.2,link-corrupt:0.05"
    options = FlyOptions(scenario="hover", duration_s=2.0, fault=fault, out=tmp_path, learning=False)
    result = fly(options, report_wanted=lambda result: False).as_json()
    assert result["completed"] is True
    assert result["tracking"]["max_m"] < 0.15


@ONLY_THEN
def test_the_same_seed_flies_the_same_bad_link_bit_for_bit(tmp_path: Path) -> None:
    def figures(folder: str) -> object:
        options = FlyOptions(scenario="hover", duration_s=1.0, fault="link-degraded", out=tmp_path / folder, seed=4)
        return fly(options, report_wanted=lambda result: False).as_json()["tracking"]

    assert figures("a") == figures("b")


def test_an_unknown_fault_is_one_line_and_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for verb in (["fly", "hover", "--out", str(tmp_path)], ["sim", "--duration", "1"]):
        with pytest.raises(SystemExit) as stop:
            main([*verb, "--fault", "meteorite"])
        assert stop.value.code == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert line.startswith("error: fault 'meteorite'")
        assert "setpoint-loss" in line


def test_a_flight_with_a_fault_fails_and_says_so_in_its_log(tmp_path: Path) -> None:
    from flightstack_logs.reader import read

    options = FlyOptions(scenario="hover", fault="setpoint-loss@1", out=tmp_path)
    result = fly(options, report_wanted=lambda result: False)
    assert not result.passed
    events = read(tmp_path / "flight.mcap").tables["/events"]
    assert ("fault", "setpoint-loss begins") in list(zip(events["name"], events["text"], strict=True))


def test_who_hands_over_at_a_low_battery_says_so(tmp_path: Path) -> None:
    """PX4 itself says "Failsafe activated, entering Hold for 5 seconds"; SYS_STATUS has the charge, once a second."""
    options = FlyOptions(
        scenario="hover", duration_s=8.0, fault="low-battery:0.1@2,low-battery:0.06@5", out=tmp_path, learning=False
    )
    result = fly(options, report_wanted=lambda result: False).as_json()
    assert result["completed"] is False
    assert "not by this companion: hands off (vehicle says: " in str(result["reason"])
    assert "battery at 10 %" in str(result["reason"])
