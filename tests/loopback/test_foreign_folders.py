"""A user's own packages of everyday names beside the working directory must not get in the way of ours."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

NAMES = ("app", "sim", "logs", "gap", "paper", "vehicles", "core", "utils")
CALLS = (
    ["-m", "flightstack", "scenarios"],
    ["-c", "import flightstack_sim.plant, flightstack_logs.reader, mavlink_bridge.link, flightstack.gap.workflow"],
)


@pytest.mark.parametrize("call", CALLS, ids=["command line", "imports"])
def test_packages_of_the_user_do_not_shadow_ours(tmp_path: Path, call: list[str]) -> None:
    for name in NAMES:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('the user\\'s own package was imported')\n")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    ran = subprocess.run(
        [sys.executable, *call], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120
    )
    assert ran.returncode == 0, ran.stderr
