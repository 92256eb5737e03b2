"""No page names a file, a target, a verb or an option that is not there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.main import get_command

from flightstack.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
PLACE = re.compile(
    r"`((?:flightstack|sim|logs|paper|mavlink_bridge|tests|benchmarks|docs|examples)/[\w./-]*\w(?:\.\w+)?/?)`"
)


def anchors(page: Path) -> set[str]:
    """Headings as GitHub and the site make anchors of them."""
    heads = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_links_and_files_are_there(page: Path) -> None:
    text = page.read_text()
    for target in LINK.findall(text):
        if target.startswith(("http://", "https://", "mailto:")):
            continue
        name, _, anchor = target.partition("#")
        place = (page.parent / name).resolve() if name else page
        assert place.exists(), f"{target}: no such file"
        if anchor:
            assert anchor in anchors(place), f"{target}: no such heading"
    if "decisions" not in page.parts and page.name != "CHANGELOG.md":  # what was decided keeps the names of its day
        for name in PLACE.findall(text):
            if "NAME" in name:
                continue
            assert (ROOT / name).exists() or list(ROOT.glob(name + "*")), f"`{name}` is not there"


def test_every_make_target_that_a_page_names_is_there() -> None:
    made = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for page in PAGES:
        if page.name == "CHANGELOG.md" or "decisions" in page.parts:
            continue
        for target in re.findall(r"(?:^|`|\$ |\n)make ([a-z][a-z0-9-]+)\b(?!_)", page.read_text()):
            assert target in made, f"{page.name}: make {target}"


def test_every_verb_and_option_in_a_code_block_is_there() -> None:
    root = get_command(app)
    checked = 0
    for page in PAGES:
        for block in re.findall(r"```(?:sh|ini)?\n(.*?)```", page.read_text(), re.DOTALL):
            for line in block.splitlines():
                found = re.search(r"(?:^|[/ =])flightstack ((?!sim &)[a-z].*)", line.split("  #")[0].split(" # ")[0])
                if (
                    line.startswith("Description=")
                    or not found
                    or page.name == "CHANGELOG.md"
                    or "decisions" in page.parts
                ):
                    continue
                words = found[1].split()
                command = root
                while words and words[0] in getattr(command, "commands", {}):
                    command = command.commands[words.pop(0)]  # type: ignore[attr-defined]
                assert command is not root, f"{page.name}: {line}"
                known = {name for p in command.params for name in (*p.opts, *p.secondary_opts)} | {"--help", "-h"}
                for word in words:
                    if word.startswith("--"):
                        assert word.split("=")[0] in known, f"{page.name}: {line}: {word}"
                checked += 1
    assert checked > 30
