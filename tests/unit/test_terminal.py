"""What is said where nobody looks at a terminal, and how little is loaded before a typo is told."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Group
from rich.table import Table

from flightstack.cli import terminal, versions
from flightstack.cli.controllers import CONTROLLERS
from flightstack.cli.shipped import CONTROLLER_WORDS

ROOT = Path(__file__).resolve().parents[2]


def test_without_a_terminal_lines_are_neither_wrapped_nor_padded(capsys: pytest.CaptureFixture[str]) -> None:
    table = Table("name", "what it is", title="[bold]things[/]")
    table.add_row("a", "word " * 60)
    table.add_row("longer name", "[green]kept[/] \\[north]")
    terminal.show(Group("first", table))
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["first", "things", "name  what it is", f"a  {('word ' * 60).strip()}", "longer name  kept [north]"]


def test_without_a_terminal_progress_is_one_line_for_each_phase_on_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    with terminal.progress("flying hover") as show:
        for k in range(100):
            show(0.01 * k, "takeoff" if k < 20 else "track")
    said = capsys.readouterr()
    assert said.out.splitlines() == ["flying hover: takeoff, 0 %", "flying hover: track, 20 %"]
    assert said.err == ""


@pytest.mark.parametrize("where", ["a pipe that nobody reads", "a full disk"])
def test_words_that_nobody_takes_end_nothing(tmp_path: Path, where: str) -> None:
    """A flight on a real PX4 ended in Hold when the program that read its words did."""
    lines = (
        "from flightstack.cli import terminal",
        "with terminal.progress('flying') as show:",
        "    for phase in 'abc': show(0.5, phase)",
        "terminal.show('done')",
        f"open({str(tmp_path / 'after')!r}, 'w').close()",
    )
    read_end, write_end = os.pipe()
    os.close(read_end)
    with open("/dev/full" if where == "a full disk" else write_end, "wb") as out:
        done = subprocess.run([sys.executable, "-c", "\n".join(lines)], stdout=out, stderr=subprocess.PIPE, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert (tmp_path / "after").exists()


@pytest.mark.parametrize(
    "arguments",
    [["--help"], ["-h"], ["--version"], ["fly", "--help"], ["fly", "-h"], ["log", "-h"], ["log", "info", "-h"],
     ["certify", "-h"], ["fly", "no-such"], ["fly", "hover", "--controller", "x"], ["fly", "hover", "--vehicle", "x"],
     ["fligh"], ["fly", "--hlp"]],
)  # fmt: skip
def test_help_and_typos_load_nothing_that_takes_time(arguments: list[str]) -> None:
    """Half a second of imports is what a wait for help is made of; what is loaded does not depend on the machine."""
    code = (
        "import json, sys\n"
        "from flightstack.cli import main\n"
        "try:\n"
        f"    main.main({arguments!r})\n"
        "except SystemExit as end:\n"
        "    print()\n"
        "    print(json.dumps([end.code, sorted(set(sys.modules) & {'numpy', 'numba', 'scipy', 'rich', 'mcap'})]))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    exit_code, loaded = json.loads(done.stdout.splitlines()[-1])
    assert loaded == []
    typo = bool({"no-such", "x", "fligh", "--hlp"} & set(arguments))
    assert exit_code == (2 if typo else 0)
    assert done.stderr.startswith("error: ") is typo
    assert done.stderr.count("\n") == typo


_SAID = """import sys
from flightstack.cli import terminal

before = set(sys.modules)
for console in (terminal.output, terminal.errors):
    console.print("[bold]taken back[/] at 12:car:03, 3 m/s²")
print(sorted(set(sys.modules) - before))
"""


def test_words_are_said_as_they_stand_and_load_nothing() -> None:
    """A shield that said what it had done looked for pictures in its words: an import of 12 ms in the air."""
    done = subprocess.run([sys.executable, "-c", _SAID], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["taken back at 12:car:03, 3 m/s²", "[]"]
    assert done.stderr.splitlines() == ["taken back at 12:car:03, 3 m/s²"]


def test_the_simulator_loads_neither_certificates_nor_logs() -> None:
    """They were half of its imports: a second of processor time at every start."""
    heavy = ("scipy.special", "foxglove", "flightstack.barrier.certifier", "flightstack.certificate_check")
    code = f"import sys, flightstack.cli.simulate\nprint(sorted(set(sys.modules) & {set(heavy)!r}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_controller_is_told_in_the_help_and_none_that_is_not_there() -> None:
    assert list(CONTROLLER_WORDS) == list(CONTROLLERS)


def test_the_version_is_that_of_the_project_and_the_commit_that_of_this_checkout() -> None:
    told = versions.versions()
    assert f'version = "{told["flightstack"]}"' in (ROOT / "pyproject.toml").read_text()
    if (ROOT / ".git").exists():
        head = subprocess.run(["git", "-C", str(ROOT), "rev-parse", "HEAD"], capture_output=True, text=True, check=True)
        assert head.stdout.startswith(told["git_commit"].removesuffix("-dirty"))
    assert versions.version_of("no-such-distribution") == ""


def test_a_wheel_knows_the_commit_that_it_was_built_of_and_asks_nobody_elses_repository(tmp_path: Path) -> None:
    """The hook alone is run, as the build runs it; then the package is imported from inside another repository."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a checkout")
    hook = pytest.importorskip("hatchling.builders.hooks.plugin.interface")
    assert hook
    sys.path.insert(0, str(ROOT))
    try:
        from hatch_build import CommitHook
    finally:
        sys.path.remove(str(ROOT))
    made: dict[str, dict[str, str]] = {"force_include": {}}
    build = CommitHook(str(ROOT), {}, None, None, "", "wheel")  # type: ignore[arg-type]
    build.initialize("standard", made)
    ((source, place),) = made["force_include"].items()
    package = tmp_path / "site"
    (package / "flightstack" / "cli").mkdir(parents=True)
    for name in ("flightstack/__init__.py", "flightstack/cli/__init__.py", "flightstack/cli/versions.py"):
        (package / name).write_text((ROOT / name).read_text())
    (package / place).write_text(Path(source).read_text())
    build.finalize("standard", made, "")
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    code = "from flightstack.cli.versions import commit; print(commit())"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", f"import sys; sys.path.insert(0, {str(package)!r}); {code}"],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip() == versions.commit() != ""
    assert not Path(source).exists()
