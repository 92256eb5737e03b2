"""`make mutants`: small faults put into the safety-relevant code, one at a time; the tests named for it must notice.

A mutant is one operator, constant or condition changed in a copy of the repository.  `TARGETS` names each file and the
tests that are to notice; mutants are drawn without replacement by a seed, so that a run can be repeated.  What survives
is listed by line.  A mutant that changes nothing survives rightly: `EQUAL` lists these with the reason.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numba  # noqa: F401
import pytest
import scipy.optimize  # noqa: F401

ROOT = Path(__file__).resolve().parents[1]
TIME_LIMIT_S = 240.0
UNIT = "tests/unit/"
CHECKER = (
    UNIT + "test_certificate_check.py", "-k", "not under_a_new_seal and not put_anywhere and not breaks_the_seal",
)  # fmt: skip
TARGETS: dict[str, tuple[str, ...]] = {
    "flightstack/guard.py": (UNIT + "test_guard.py",),
    "flightstack/safety_filter.py": (UNIT + "test_filter_rest.py", UNIT + "test_safety_filter.py"),
    "flightstack/barrier/condition.py": (UNIT + "test_barrier_condition.py",),
    "flightstack/barrier/margins.py": (
        UNIT + "test_margins.py",
        UNIT + "test_certificate_check.py::test_a_true_certificate_is_valid",
    ),
    "flightstack/governor.py": (UNIT + "test_governor.py",),
    "flightstack/certificate_check/ledger.py": CHECKER,
    "flightstack/certificate_check/condition.py": CHECKER,
    "mavlink_bridge/handshake.py": (
        UNIT + "test_handshake.py",
        UNIT + "test_architecture_page.py",
        UNIT + "test_companion.py",
    ),
    "mavlink_bridge/decide.py": (UNIT + "test_decide.py",),
    "mavlink_bridge/watchdogs.py": (UNIT + "test_watchdogs.py",),
    "mavlink_bridge/dead_man.py": (UNIT + "test_dead_man.py", "-k", "not process"),
    "flightstack/effects/ground_effect.py": ("tests/physics/test_effects.py",),
    "flightstack/effects/rotor_drag.py": ("tests/physics/test_effects.py",),
}
"""What is left out by `-k` takes longer than all the rest."""
_GOVERNOR = "flightstack/governor.py: "
EQUAL: dict[str, str] = {
    "mavlink_bridge/watchdogs.py: if shift == (0.0, 0.0, 0.0): 0.0 to 0.25": "a shift of nothing changes nothing",
    _GOVERNOR + "most = (math.inf, math.inf, 0.0, 1.0) 1.0 to 1.25": "where nothing is limited nothing is clipped",
    _GOVERNOR + "roll_pitch_max: float = 0.06 0.06 to 0.075": "a default, for the warm-up and for tests",
    _GOVERNOR
    + "if _torque_peak(torques, change, yaw) <= most: LtE to Lt": "what is just at the limit is cut to itself",
    _GOVERNOR
    + "change = _within(torques, wanted, (1.0, 0.0), y_max, True) 1.0 to 1.25": "yaw has no heading to be cut by",
    "flightstack/effects/ground_effect.py: scale=lambda size: 0.3, 0.3 to 0.375": "where a search begins, no physics",
    "flightstack/barrier/condition.py: far = -0.5 * (b + root) if b >= 0.0 else -0.5 * (b - root)  # the root without "
    "cancellation Add to Sub": "the same two roots, with fewer digits where the parabola is nearly a line",
    "flightstack/safety_filter.py: present, sign = abs(present_radps), 1.0 if present_radps >= 0.0 else -1.0 "
    "GtE to Gt": "at no rate both signs are alike",
}
"""`file: line: kind` -> why no test can tell."""
_COMPARES: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip
_CALLS = {"min": "max", "max": "min"}
_TABLES = {"_S": "REFUSED", "State": "REFUSED", "HandshakeEvent": "TIMEOUT"}
"""What an entry of the handshake's tables is replaced by."""


class Mutant(NamedTuple):
    """One change: the node's number in a walk of the tree, where it stands and what is done to it."""

    node: int
    line: int
    kind: str


def mutants_of(tree: ast.Module) -> Iterator[Mutant]:
    """Every mutant of a module; docstrings, annotations and imports are left alone."""
    skipped = {id(part) for node in ast.walk(tree) for part in _not_code(node)}
    for number, node in enumerate(ast.walk(tree)):
        if id(node) in skipped:
            continue
        kind = ""
        if isinstance(node, ast.Compare) and type(node.ops[0]) in _COMPARES:
            kind = f"{type(node.ops[0]).__name__} to {_COMPARES[type(node.ops[0])].__name__}"
        elif isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            kind = f"{type(node.op).__name__} to {_OPERATORS[type(node.op)].__name__}"
        elif isinstance(node, ast.BoolOp):
            kind = "And to Or" if isinstance(node.op, ast.And) else "Or to And"
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            kind = "not dropped"
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            kind = "minus dropped"
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _CALLS:
            kind = f"{node.func.id} to {_CALLS[node.func.id]}"
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
            kind = f"{node.value} to {not node.value}"
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in _TABLES:
            if node.attr != _TABLES[node.value.id]:
                kind = f"{node.value.id}.{node.attr} to {_TABLES[node.value.id]}"
        elif isinstance(node, ast.Constant) and isinstance(node.value, float):
            kind = f"{node.value} to {_other(node.value)}"
        if kind:
            yield Mutant(number, node.lineno, kind)


def _not_code(node: ast.AST) -> Iterator[ast.AST]:
    """Parts that no run executes for their value."""
    for name in ("annotation", "returns"):
        part = getattr(node, name, None)
        if isinstance(part, ast.AST):
            yield from ast.walk(part)
    if isinstance(node, ast.Subscript):
        yield from ast.walk(node.slice)


def _other(value: float) -> float:
    return 1.25 * value if value else 0.25


def mutated(source: str, mutant: Mutant) -> str:
    """The source with this change; the code after `ast.unparse`, so comments are gone."""
    tree = copy.deepcopy(ast.parse(source))
    node = next(node for number, node in enumerate(ast.walk(tree)) if number == mutant.node)
    if isinstance(node, ast.Compare):
        node.ops[0] = _COMPARES[type(node.ops[0])]()
    elif isinstance(node, ast.BinOp):
        node.op = _OPERATORS[type(node.op)]()
    elif isinstance(node, ast.BoolOp):
        node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
    elif isinstance(node, ast.UnaryOp):
        node.op = ast.UAdd() if isinstance(node.op, ast.USub) else node.op
        if isinstance(node.op, ast.Not):
            node.op, node.operand = ast.Not(), ast.UnaryOp(ast.Not(), node.operand)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        node.func.id = _CALLS[node.func.id]
    elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        node.attr = _TABLES[node.value.id]
    elif isinstance(node, ast.Constant):
        node.value = (not node.value) if isinstance(node.value, bool) else _other(float(node.value))  # type: ignore[arg-type]
    return ast.unparse(ast.fix_missing_locations(tree))


def notices(folder: Path, tests: tuple[str, ...]) -> bool:
    """Whether these tests fail there, or do not end.  A child of this process runs them: the libraries are there."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            code = _run_tests(folder, tests)
        finally:
            os._exit(code)
    until_s = time.monotonic() + TIME_LIMIT_S
    while time.monotonic() < until_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status != 0
        time.sleep(0.05)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return True


def _run_tests(folder: Path, tests: tuple[str, ...]) -> int:
    """pytest's exit code in the copy, whose packages this process has not imported."""
    os.setpgid(0, 0)
    os.chdir(folder)
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(nothing, number)
    parts = ("", "sim", "logs", "paper")
    own = {str(ROOT / name) for name in parts}
    sys.path[:] = [*(str(folder / name) for name in parts), *(path for path in sys.path if path and path not in own)]
    return int(pytest.main(["-x", "-q", "--no-header", "-p", "no:cacheprovider", "--runxfail", *tests]))


def copied(folder: Path) -> None:
    """The repository's tracked files as they are now."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)


def main() -> None:
    """Draw, run, list."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--each", type=int, default=12, help="mutants of each file")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=60.0, help="begin no mutant after this")
    parser.add_argument("files", nargs="*", help="of the table of targets; all where none is named")
    options = parser.parse_args()
    unknown = set(options.files) - TARGETS.keys()
    if unknown:
        sys.exit(f"error: no target: {', '.join(sorted(unknown))}; known: {', '.join(TARGETS)}")
    began_s, killed, survived = time.monotonic(), 0, []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copied(folder)
        for target in options.files or TARGETS:
            tests = TARGETS[target]
            if notices(folder, tests):
                sys.exit(f"error: {' '.join(tests)} fail without any fault")
            source = (folder / target).read_text()
            lines = source.splitlines()
            found = list(mutants_of(ast.parse(source)))
            for mutant in random.Random(options.seed).sample(found, min(options.each, len(found))):
                if time.monotonic() - began_s > 60.0 * options.minutes:
                    break
                where = f"{target}:{mutant.line} {mutant.kind}"
                (folder / target).write_text(mutated(source, mutant))
                if notices(folder, tests):
                    killed += 1
                    print(f"killed    {where}", flush=True)
                elif (why := EQUAL.get(f"{target}: {lines[mutant.line - 1].strip()} {mutant.kind}")) is not None:
                    print(f"equal     {where}: {why}", flush=True)
                else:
                    survived.append(where)
                    print(f"SURVIVED  {where}", flush=True)
            (folder / target).write_text(source)
            print(f"{target}: {killed} killed, {len(survived)} survived so far", flush=True)
    print(f"{killed} of {killed + len(survived)} mutants killed")


if __name__ == "__main__":
    main()
