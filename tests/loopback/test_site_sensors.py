"""A site is kept by margins for the sensors that were named: a vehicle that says that it has worse ones is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from simulator import HOST, free_ports, simulator

from flightstack.cli import files
from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.main import main

SITE = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = 60.0
inside = [[-60.0, -60.0], [60.0, -60.0], [60.0, 60.0], [-60.0, 60.0]]
"""


def test_with_gps_a_site_for_mocap_is_not_flown_and_the_checklist_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A real PX4 that said 0.29 m was "ready", with 1.57 m at rest, because `--sensors` was left out."""
    (tmp_path / "field.toml").write_text(SITE)
    port, gcs_port = free_ports()
    words = ["offboard", "--connect", f"udpin:{HOST}:{port}", "--site", str(tmp_path / "field.toml"), "--scenario"]
    with simulator(port, gcs_port, "--sensors", "gps"):
        for more in (["--dry-run"], ["--arm"]):
            filed = ["--json", str(tmp_path / "flight.json"), "--out", str(tmp_path / "-".join(["out", *more]))]
            with pytest.raises(SystemExit) as ended:
                main([*words, "hover", *filed, *more])
            assert ended.value.code == 1
            said = capsys.readouterr().err
            result = json.loads((tmp_path / "flight.json").read_text())
            if "--dry-run" in more:
                (check,) = (each for each in result["checklist"] if each["check"] == "protection")
                assert not check["ok"]
                assert "the vehicle says that it knows its position" in check["said"]
            else:
                assert result["flight_time_s"] == 0.0
                (line,) = (line for line in said.splitlines() if line.startswith("error:"))
                assert "with mocap sensors that would be" in line
                assert "--sensors" in line


def test_with_a_real_px4s_noise_a_site_flight_does_not_swing_round_a_slow_figure(tmp_path: Path) -> None:
    """A figure of eight of 14 s a lap (1.3 m/s^2): it was flown up to 2.4 m beside it, by truth, leaning by 43 degrees,
    because the controller's pole was faster than what noise and steps together leave of the governor's room."""
    figure = files.load_scenario("figure8")[1].text.replace("period_s = 8.0", "period_s = 14.0")
    (tmp_path / "figure.toml").write_text(figure)
    (tmp_path / "field.toml").write_text(SITE.replace("60.0, ", "200.0, ").replace("60.0]", "200.0]"))
    text = files.load_vehicle("px4-sihsim-quadx")[1].text
    lines = ["mass_kg = 0.7" if line.startswith("mass_kg") else line for line in text.splitlines()]
    (tmp_path / "light.toml").write_text("\n".join(lines) + "\n")
    flown = fly(
        FlyOptions(
            scenario=str(tmp_path / "figure.toml"), vehicle=str(tmp_path / "light.toml"), sensors="px4-sih-ekf",
            site=tmp_path / "field.toml", duration_s=6.0, out=tmp_path, unprotected_ok=True,
        ),
        report_wanted=lambda result: False,
    ).as_json()  # fmt: skip
    assert flown["tracking"]["of"] == "truth"
    assert flown["tracking"]["max_m"] < 1.0
    assert flown["barrier"]["exits"] == 0
