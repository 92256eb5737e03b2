"""Rate gains are read from the vehicle before a protected flight: what is certified counts on those that fly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from simulator import HOST, free_ports, simulator

from flightstack.api import load_vehicle, vehicle_to_toml
from flightstack.autopilot import autopilot_of
from flightstack.cli import vehicle_gains
from flightstack.cli.flight import FlyOptions, prepare
from flightstack.cli.main import main
from flightstack.cli.vehicle_gains import ask_gains, changed, tuned
from flightstack.types import InputError

SITE = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = 12.0
inside = [[-30.0, -30.0], [30.0, -30.0], [30.0, 30.0], [-30.0, 30.0]]
"""
QUAD, _ = load_vehicle("quad-x")


def test_a_vehicle_with_other_gains_is_flown_by_them_or_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "field.toml").write_text(SITE)
    true = tmp_path / "true.toml"
    true.write_text(vehicle_to_toml(tuned(QUAD, {"mc_rollrate_k": 0.5, "imu_dgyro_cutoff": 30.0})))
    port, gcs_port = free_ports()
    flight = ["offboard", "--connect", f"udpin:{HOST}:{port}", "--site", str(tmp_path / "field.toml"), "--dry-run"]
    with simulator(port, gcs_port, "--vehicle", str(true)):
        gains = ask_gains(f"udpin:{HOST}:{port}", None, 20.0, QUAD)
        with pytest.raises(SystemExit) as ended:
            main([*flight, "--out", str(tmp_path)])
        assert ended.value.code == 0
    assert gains == pytest.approx(autopilot_of(tuned(QUAD, {"mc_rollrate_k": 0.5, "imu_dgyro_cutoff": 30.0})))
    said = capsys.readouterr()
    words = said.out + said.err
    assert words.count("as the vehicle has it, not as its file: MC_ROLLRATE_K 0.5 (1), IMU_DGYRO_CUTOFF 30 (20)") == 1


def test_nobody_there_is_one_line_before_anything_is_prepared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "field.toml").write_text(SITE)
    port, _ = free_ports()
    with pytest.raises(SystemExit) as ended:
        main([
            "offboard", "--connect", f"udpin:{HOST}:{port}", "--site", str(tmp_path / "field.toml"),
            "--timeout", "0.3", "--out", str(tmp_path / "out"),
        ])  # fmt: skip
    assert ended.value.code == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert "no vehicle answered" in line
    assert "rate gains" in line


def test_a_simulated_flight_is_certified_with_the_gains_that_its_autopilot_flies(tmp_path: Path) -> None:
    """Gains are tuned on what flies: dead time in the believed file alone lowers the file's K, not the autopilot's."""
    believed, truth = (tmp_path / f"{name}.toml" for name in ("believed", "truth"))
    text = vehicle_to_toml(QUAD)
    believed.write_text(text + "[effects.transport_delay]\ndelay_s = 0.02\n")
    truth.write_text(text)
    late, _ = load_vehicle(str(believed))
    assert autopilot_of(late)["mc_rollrate_k"] < 0.95 * autopilot_of(QUAD)["mc_rollrate_k"]
    (tmp_path / "field.toml").write_text(SITE)
    made = prepare(FlyOptions(scenario="hover", vehicle=str(believed), truth=str(truth), site=tmp_path / "field.toml"))
    flown = autopilot_of(made.flight.believed, made.truth)
    site = made.flight.protection.site
    assert site is not None
    assert flown["mc_rollrate_k"] == autopilot_of(QUAD)["mc_rollrate_k"]
    assert dict(site.certificate.governor.autopilot) == flown
    assert "mc_rollrate_k" in made.flight.carried["vehicle.toml"]  # the log says with which
    assert tuned(QUAD, autopilot_of(QUAD)) is QUAD
    assert not changed(QUAD, autopilot_of(QUAD))


def test_a_gain_that_the_vehicle_does_not_tell_is_not_guessed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It answers MAV_PARAM_ERROR for a name that it does not know, as an older PX4's parameter would be."""
    known = vehicle_gains.AUTOPILOT_PARAMS["mc_yaw_tq_cutoff"]._replace(name="MC_OF_NO_PX4")
    monkeypatch.setitem(vehicle_gains.AUTOPILOT_PARAMS, "mc_yaw_tq_cutoff", known)
    port, gcs_port = free_ports()
    with simulator(port, gcs_port):
        with pytest.raises(InputError, match=r"does not tell MC_OF_NO_PX4.*state mc_yaw_tq_cutoff"):
            ask_gains(f"udpin:{HOST}:{port}", None, 20.0, QUAD)
        stated = replace(QUAD, autopilot={"mc_yaw_tq_cutoff": 2.0})
        gains = ask_gains(f"udpin:{HOST}:{port}", None, 20.0, stated)
    assert "mc_yaw_tq_cutoff" not in gains
    assert len(gains) == len(vehicle_gains.AUTOPILOT_PARAMS) - 1
