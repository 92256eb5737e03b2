"""The architecture page shows the tables of today, and names only files that exist."""

import importlib.util
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_diagrams_are_those_of_the_tables() -> None:
    spec = importlib.util.spec_from_file_location("draw", ROOT / "docs" / "draw.py")
    assert spec is not None
    assert spec.loader is not None
    draw = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(draw)
    page = draw.PAGE.read_text(encoding="utf-8")
    assert page.count("<!-- drawn:") == len(draw.DRAWN)
    assert draw.redrawn(page) == page, "run: python docs/draw.py"


def test_every_file_and_folder_that_a_page_names_is_there() -> None:
    folders = "flightstack|sim|logs|paper|mavlink_bridge|tests|benchmarks|docs|examples"
    missing = [
        f"{page.name}: {name}"
        for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
        for name in re.findall(rf"`((?:{folders})/[\w./-]*)`", page.read_text(encoding="utf-8"))
        if not (ROOT / name).exists()
    ]
    assert not missing
