"""`make house`: the counts that the project holds itself to, by one command.

Code lines are lines without docstrings, comments and blanks.
"""

from __future__ import annotations

import ast
import io
import tokenize
from collections import Counter
from pathlib import Path

from benchmarks.gap_walk import counts, walk

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("flightstack", "sim/flightstack_sim", "mavlink_bridge", "logs/flightstack_logs", "paper/flightstack_paper")
LONG_FILE, LONG_FUNCTION, MANY_PARAMETERS, LARGE_INDEX = 400, 60, 8, 2
_NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}


def code_lines(source: str, tree: ast.Module) -> int:
    """Lines that hold code."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def gap_numbers() -> tuple[int, int]:
    """Rows of the table of decisions, and the other names of modules in `gap/` whose value holds a number."""
    decisions = others = 0
    for path in sorted((ROOT / "flightstack/gap").rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
                continue
            if isinstance(node.value, ast.Call) and ast.unparse(node.value.func) == "decide":
                decisions += 1
                continue
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            values = [each.value for each in ast.walk(node.value) if isinstance(each, ast.Constant)]
            if any(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
                others += len(target.elts) if isinstance(target, ast.Tuple) else 1
    return decisions, others


def main() -> None:
    """Print the table."""
    classes: Counter[str] = Counter()
    long_files, long_functions, many, indices = [], [], [], 0
    print(f"{'package':28}{'files':>7}{'code lines':>12}")
    total = 0
    for package in PACKAGES:
        files, lines = sorted((ROOT / package).rglob("*.py")), 0
        for path in files:
            source = path.read_text(encoding="utf-8")
            tree, place = ast.parse(source), path.relative_to(ROOT)
            lines += code_lines(source, tree)
            if source.count("\n") > LONG_FILE:
                long_files.append(f"{place} {source.count(chr(10))}")
            for node in ast.walk(tree):
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    classes[node.name] += 1
                elif isinstance(node, ast.FunctionDef):
                    length = (node.end_lineno or node.lineno) - node.lineno + 1
                    arguments = node.args
                    count = len(arguments.posonlyargs) + len(arguments.args) + len(arguments.kwonlyargs)
                    count -= bool(arguments.args and arguments.args[0].arg in ("self", "cls"))
                    if length > LONG_FUNCTION:
                        long_functions.append(f"{place}:{node.lineno} {node.name} {length}")
                    if count > MANY_PARAMETERS:
                        many.append(f"{place}:{node.lineno} {node.name} {count}")
                elif isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant):
                    indices += isinstance(node.slice.value, int) and node.slice.value > LARGE_INDEX
        total += lines
        print(f"{package:28}{len(files):7}{lines:12}")
    print(f"{'together':28}{'':7}{total:12}")
    twice = sorted(name for name, count in classes.items() if count > 1)
    for words, found in (
        (f"files above {LONG_FILE} lines", long_files),
        (f"functions above {LONG_FUNCTION} lines", long_functions),
        (f"functions above {MANY_PARAMETERS} parameters", many),
        ("public class names used twice", twice),
    ):
        print(f"\n{words}: {len(found)}")
        for line in found:
            print(f"  {line}")
    print(f"\nliteral subscripts above {LARGE_INDEX}: {indices}")
    decisions, others = gap_numbers()
    print(f"\nnumbers with a name in flightstack/gap: {decisions} decisions, {others} of physics, formats and numerics")
    print(counts(walk()))


if __name__ == "__main__":
    main()
