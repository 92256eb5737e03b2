"""By which rules a blind case was flown and judged: cases are counted together only where these are the same.

The rules are the code that draws, flies and judges a case and all of the workflow but its page, without comments,
docstrings and layout.

    python -m benchmarks.gap_rules      says which they are
"""

from __future__ import annotations

import ast
import hashlib
from functools import cache
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[1]
_FILES = (
    "benchmarks/gap_cases.py",
    "benchmarks/gap_draw.py",
    "benchmarks/gap_flights.py",
    "benchmarks/gap_judge.py",
    "benchmarks/gap_mcap.py",
    "benchmarks/gap_pilot.py",
    *sorted(path.relative_to(_ROOT).as_posix() for path in (_ROOT / "flightstack" / "effects").glob("*.py")),
    *sorted(
        path.relative_to(_ROOT).as_posix()
        for path in (_ROOT / "flightstack" / "gap").rglob("*.py")
        if "report" not in path.relative_to(_ROOT).parts
    ),
)


@cache
def rules() -> str:
    """Ten digits that change with the rules."""
    digest = hashlib.sha256()
    for name in _FILES:
        digest.update(name.encode())
        digest.update(meaning((_ROOT / name).read_text(encoding="utf-8")).encode())
    return digest.hexdigest()[:10]


def meaning(source: str) -> str:
    """A file's code without comments, docstrings and layout."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [each for each in body if not _is_text(each)]  # type: ignore[attr-defined]
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "decide":
            del node.args[1:]  # a decision's unit, reason and measured sensitivity are no rules
    return ast.dump(tree)


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


if __name__ == "__main__":
    print(rules())
