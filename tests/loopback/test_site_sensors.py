"""A site is kept by margins for the sensors that were named: a vehicle that says that it has worse ones is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from simulator import HOST, free_ports, simulator

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
