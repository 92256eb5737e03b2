"""The import rules of pyproject.toml speak of every module of the core, so that none can look upwards unseen."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_every_core_module_stands_in_the_lowest_layer() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    lowest = project["tool"]["importlinter"]["contracts"][0]["layers"][-1]
    found = {
        path.stem
        for path in (ROOT / "flightstack").iterdir()
        if (path.suffix == ".py" and path.stem != "__init__") or (path / "__init__.py").is_file()
    }
    assert {name.strip() for name in lowest.split(":")} == {
        f"flightstack.{name}" for name in found - {"__main__", "cli", "gap", "api", "testkit"}
    }
