"""`flightstack` in a process of its own, against a PX4 of `station`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.px4.records import Bench
from benchmarks.px4.station import Px4, log_folder
from flightstack.cli.files import load_vehicle

VEHICLE = "px4-sihsim-quadx"
"""The vehicle file of PX4's internal simulator at its default parameters."""
MASS_KG = 0.7
"""Of SIH where there is a site: at its 1 kg its thrust is too little for a certificate from the prior."""
LIMIT_S = 300.0


class Flown(NamedTuple):
    """What became of a run: exit code, the JSON (empty where none was written), all that was said, the folder."""

    code: int
    result: dict[str, Any]
    said: str
    folder: Path


def command(px4: Px4, folder: Path, scenario: str, *more: str, arm: bool = True) -> list[str]:
    """`flightstack offboard` for this PX4 (`fly --px4-hil` where it waits for its physics), its files in `folder`."""
    words = [*px4.bench.prefix, sys.executable, "-m", "flightstack"]
    filed = ["--out", str(folder), "--json", str(folder / "flight.json")]
    if px4.kind == "hil":
        return [*words, "fly", scenario, "--px4-hil", "--hil-port", str(px4.hil_port), *filed, *more]
    words += ["offboard", "--connect", px4.address, "--scenario", scenario, *filed]
    if "--vehicle" not in more:
        words += ["--vehicle", VEHICLE]
    return [*words, *(["--arm"] if arm else []), *more]


def start(px4: Px4, folder: Path, scenario: str, *more: str) -> subprocess.Popen[bytes]:
    """Start the companion and return at once; what it says goes to `companion.txt`."""
    said = (folder / "companion.txt").open("wb")
    return subprocess.Popen(command(px4, folder, scenario, *more), stdout=said, stderr=subprocess.STDOUT)


def fly(bench: Bench, px4: Px4, scenario: str, *more: str, arm: bool = True) -> Flown:
    """Fly a scenario to its end."""
    folder = log_folder(bench, scenario)
    done = subprocess.run(
        command(px4, folder, scenario, *more, arm=arm),
        capture_output=True, text=True, timeout=LIMIT_S, check=False,
    )  # fmt: skip
    (folder / "companion.txt").write_text(done.stdout + done.stderr)
    file = folder / "flight.json"
    result = json.loads(file.read_text()) if file.exists() else {}
    return Flown(done.returncode, result, done.stdout + done.stderr, folder)


def light_vehicle(folder: Path) -> Path:
    """The vehicle file of such a mass, written into `folder`."""
    text = load_vehicle("px4-sihsim-quadx")[1].text
    lines = [f"mass_kg = {MASS_KG}" if line.startswith("mass_kg") else line for line in text.splitlines()]
    file = folder / "light.toml"
    file.write_text("\n".join(lines) + "\n")
    return file
