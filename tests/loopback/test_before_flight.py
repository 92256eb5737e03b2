"""What `offboard` finds before a flight, on a simulator of its own: wrong vehicle files, the checklist."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from simulator import free_ports, simulator
from wrong_vehicles import WRONG

from flightstack.cli import files
from flightstack.cli import main as cli
from flightstack.vehicle import vehicle_to_toml


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    port, gcs_port = free_ports()
    with simulator(port, gcs_port, speed=1.0):
        yield f"udpin:127.0.0.1:{port}"


def _offboard(address: str, tmp_path: Path, *arguments: object) -> tuple[int, dict[str, object]]:
    file = tmp_path / "flight.json"
    words = ["offboard", "--connect", address, "--out", tmp_path / "out", "--json", file, *arguments]
    with pytest.raises(SystemExit) as stop:
        cli.main([str(word) for word in words])
    return int(stop.value.code or 0), json.loads(file.read_text())


@pytest.mark.parametrize("words", WRONG)
def test_a_wrong_vehicle_file_is_refused_before_anything_moves(
    address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: str
) -> None:
    """The simulated PX4 is set up for quad-x, as its owner would have done."""
    file = tmp_path / "wrong.toml"
    file.write_text(vehicle_to_toml(WRONG[words](files.load_vehicle("quad-x")[0])))
    code, result = _offboard(address, tmp_path, "--vehicle", file, "--arm", "--scenario", "hover", "--duration", 1)
    assert code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == len(result["contradictions"]) > 0
    assert all(line.startswith("error: ") and "--believe-file" in line for line in lines)
    assert result["completed"] is False
    assert result["flight_time_s"] == 0.0


def test_a_dry_run_returns_the_checklist_and_sends_no_setpoint(
    address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, result = _offboard(address, tmp_path, "--dry-run")
    said = capsys.readouterr().out
    assert code == 0, said
    assert result["completed"] is None
    checks = {check["check"]: check for check in result["checklist"]}
    assert all(set(check) == {"check", "ok", "said"} for check in result["checklist"])
    assert all(check["ok"] for check in result["checklist"])
    wanted = {
        "vehicle", "version", "COM_OF_LOSS_T", "COM_OBL_RC_ACT", "MPC_THR_HOVER", "vehicle file", "ATTITUDE_QUATERNION",
        "LOCAL_POSITION_NED", "HIGHRES_IMU", "estimate", "round trip", "verdict",
    }  # fmt: skip
    assert wanted <= set(checks)
    assert list(checks)[-1] == "verdict"
    assert all(name in said for name in wanted)
    assert "1.18" in checks["version"]["said"]
    rate_hz = float(checks["HIGHRES_IMU"]["said"].split()[0])
    assert rate_hz == pytest.approx(246.0, rel=0.15)  # PX4 gives 246 Hz for 250 asked; this machine may be busy


def test_a_dry_run_tells_all_that_is_wrong_and_ends_like_the_refusal(
    address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(vehicle_to_toml(WRONG["all turn the other way"](files.load_vehicle("quad-x")[0])))
    code, result = _offboard(address, tmp_path, "--dry-run", "--vehicle", file)
    assert code == 2
    checks = {check["check"]: check for check in result["checklist"]}
    assert not checks["vehicle file"]["ok"]
    assert checks["vehicle file"]["said"].count("turns clockwise") == 2
    assert not checks["verdict"]["ok"]
    assert checks["round trip"]["ok"]  # it went on to the end
    assert capsys.readouterr().err.count("error: ") == 4


def test_a_dry_run_that_hears_nobody_says_so(tmp_path: Path) -> None:
    port, _ = free_ports()
    code, result = _offboard(f"udpin:127.0.0.1:{port}", tmp_path, "--dry-run", "--timeout", 0.5)
    assert code == 1
    assert result["completed"] is None
    assert [check["check"] for check in result["checklist"]] == ["vehicle", "verdict"]
    assert "no heartbeat" in result["checklist"][-1]["said"]


def test_a_file_that_is_to_be_believed_is_flown_with_whatever_px4_says(address: str, tmp_path: Path) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(vehicle_to_toml(WRONG["two fifths of the thrust missing"](files.load_vehicle("quad-x")[0])))
    code, result = _offboard(address, tmp_path, "--vehicle", file, "--believe-file", "--dry-run")
    assert code == 0
    assert result["contradictions"] == []


def test_a_dry_run_tells_what_protection_would_lack(address: str, tmp_path: Path) -> None:
    """By the bounds of the sensors that are named; nothing is against motion capture, which the simulator has."""
    words = ("--dry-run", "--scenario", "paper-tracking")
    code, result = _offboard(address, tmp_path, *words, "--sensors", "px4-sih")
    check = {each["check"]: each for each in result["checklist"]}["protection"]
    assert code == 1
    assert not check["ok"]
    assert "position east is known to 1." in check["said"]
    code, result = _offboard(address, tmp_path, *words)
    assert code == 0, result["checklist"]
    assert {each["check"]: each for each in result["checklist"]}["protection"]["said"].startswith("sound")


def test_a_vehicle_that_contradicts_its_sensors_is_told_in_its_own_words(tmp_path: Path) -> None:
    """Estimates of GPS, taken for those of motion capture as the scenario says."""
    port, gcs_port = free_ports()
    with simulator(port, gcs_port, "--sensors", "gps", speed=1.0):
        code, result = _offboard(f"udpin:127.0.0.1:{port}", tmp_path, "--dry-run", "--scenario", "paper-tracking")
    assert code == 1
    check = {each["check"]: each for each in result["checklist"]}["protection"]
    assert check["said"].startswith("the vehicle says that it knows its position across to")
