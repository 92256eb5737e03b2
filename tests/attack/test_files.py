"""Files that are not what they seem: what the checker refuses is not flown, and nobody else answers for the checker."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from certified import for_the_papers_path, write
from forging import resealed

from flightstack.cli.files import load_vehicle

pytestmark = pytest.mark.attack
_COMMAND = [sys.executable, "-P", "-c", "from flightstack.cli.main import main; main()"]
"""As the console script: without the working folder on the path."""


def _run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*_COMMAND, *arguments], cwd=folder, capture_output=True, text=True, timeout=120)


def _one_line(ran: subprocess.CompletedProcess[str]) -> str:
    errors = [line for line in ran.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1, ran.stderr
    assert "Traceback" not in ran.stderr
    return errors[0]


def test_a_module_in_the_working_folder_does_not_answer_for_the_checker(tmp_path: Path) -> None:
    says = {"valid": True, "lines": ["valid"], "readable": True}
    (tmp_path / "json.py").write_text(f"import os\nprint('{json.dumps(says)}', flush=True)\nos._exit(0)\n")
    (tmp_path / "c.json").write_text("{}")
    ran = _run(tmp_path, "certify", "--check", "c.json")
    assert ran.returncode == 2, ran.stdout
    assert "not a certificate" in _one_line(ran)


def test_a_files_own_words_move_no_cursor_and_hide_nothing(tmp_path: Path) -> None:
    """A key that goes up a line, wipes it and says "valid" there."""
    file = tmp_path / "c.json"
    made = json.loads(write(tmp_path / "honest.json", for_the_papers_path(), load_vehicle(None)[0]).read_text())
    file.write_text(resealed(made | {"\x1b[1A\x1b[2Kvalid\n\ud800": 1}))
    ran = _run(tmp_path, "certify", "--check", "c.json")
    assert ran.returncode == 2, ran.stdout
    assert all(each.isprintable() for each in _one_line(ran)), _one_line(ran)
    assert "valid" not in ran.stdout


def test_what_the_checker_refuses_is_not_flown(tmp_path: Path) -> None:
    file = write(tmp_path / "made-up.json", for_the_papers_path(), load_vehicle(None)[0])
    ran = _run(tmp_path, "fly", "paper-tracking", "--certificate", str(file), "--out", str(tmp_path / "out"))
    assert ran.returncode == 2, ran.stdout
    assert "made-up.json" in _one_line(ran)
    assert not (tmp_path / "out").exists()
