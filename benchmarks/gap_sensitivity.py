"""How much every decision of the gap workflow decides: one at a time at half and at one and a half times its value.

    python -m benchmarks.gap_sensitivity trace [MINUTES]   which decisions could change anything in which frozen case
    python -m benchmarks.gap_sensitivity run [MINUTES]     changes them where they could; goes on where it was cut off
    python -m benchmarks.gap_sensitivity keep              writes what is known into flightstack/gap/decisions.py

A trace runs each case of `benchmarks.gap_frozen` once with numbers that watch themselves: a comparison that would come
out otherwise at one of the two other values, or an array that would differ, is noted.  Where nothing is noted no
verdict can change, and no run is needed.  Results lie in runs/gap-sensitivity by the digest of the workflow's rules.
"""

from __future__ import annotations

import ast
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from benchmarks.gap_frozen import CASES, Verdict, verdict, words
from benchmarks.gap_rules import rules
from flightstack.gap import decisions

TABLE = Path(decisions.__file__)
FACTORS = (0.5, 1.5)
ALWAYS = ("turbulence", "three")
"""Cases on which each decision is tried anyway: a number that goes into an array is not watched any longer."""
FOLDER = Path(__file__).resolve().parents[1] / "runs" / "gap-sensitivity"
MOST_CASES = 4
"""A decision is changed on at most so many of the cases where it could matter, until two said something else."""


def rows(source: str | None = None) -> dict[str, float]:
    """Name -> value of every row of the table."""
    text = TABLE.read_text(encoding="utf-8") if source is None else source
    return {
        node.targets[0].id: float(eval(compile(ast.Expression(node.value.args[0]), "table", "eval")))
        for node in ast.parse(text).body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
        if isinstance(node.value, ast.Call) and isinstance(node.value.func, ast.Name) and node.value.func.id == "decide"
    }


@contextmanager
def holding(changed: dict[str, float]) -> Iterator[None]:
    """The workflow with other values of these rows, and of what the table derives from them."""
    space = {name: getattr(decisions, name) for name in ("EFFECTS", *rows())} | changed
    for node in ast.parse(TABLE.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id.isupper():
            if node.targets[0].id not in space:
                space[node.targets[0].id] = eval(compile(ast.Expression(node.value), "table", "eval"), dict(space))
    before = [
        (module, name, getattr(module, name))
        for loaded, module in list(sys.modules.items())
        if loaded.startswith("flightstack.gap")
        for name in space
        if name != "EFFECTS" and hasattr(module, name)
    ]
    for module, name, _ in before:
        setattr(module, name, space[name])
    try:
        yield
    finally:
        for module, name, value in before:
            setattr(module, name, value)


class Watched(float):
    """A decision that notes where half its value (`low`) or one and a half times it (`high`) makes a difference."""

    low: float
    high: float
    noted: set[str]

    @staticmethod
    def made(value: float, low: float, high: float, noted: set[str]) -> Watched:
        """A number that notes in `noted`."""
        made = Watched(value)
        made.low, made.high, made.noted = low, high, noted
        return made

    __hash__ = float.__hash__

    def _told(self, parts: list[Any]) -> Any:
        """The first of three results, watched where all are numbers, else with a note of what differs."""
        if parts[0] is NotImplemented:
            return NotImplemented
        if all(isinstance(x, float) for x in parts):
            return Watched.made(*map(float, parts), self.noted) if len(set(parts)) > 1 else parts[0]
        for other, which in zip(parts[1:], ("low", "high"), strict=True):
            if not np.array_equal(parts[0], other, equal_nan=True):
                self.noted.add(which)
        return parts[0]

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **kwargs: Any) -> Any:
        """An operation with arrays, at all three values."""
        if kwargs.get("out") is not None:
            self.noted.update(("low", "high"))
            return getattr(ufunc, method)(*map(_plain, inputs), **kwargs)
        given = [[_at(x, which) for x in inputs] for which in ("", "low", "high")]
        return self._told([getattr(ufunc, method)(*each, **kwargs) for each in given])


def _plain(x: Any) -> Any:
    return float.__pos__(x) if isinstance(x, Watched) else x


def _at(x: Any, which: str) -> Any:
    return getattr(x, which) if which and isinstance(x, Watched) else _plain(x)


def _operator(name: str) -> Callable[..., Any]:
    own = getattr(float, name)

    def operator(self: Watched, *others: Any) -> Any:
        if others and isinstance(others[0], np.ndarray):
            return NotImplemented
        given = [float(x) if isinstance(x, np.generic | int) else x for x in others]
        if any(isinstance(x, Watched) for x in given):  # of two decisions each may matter
            self.noted.update(("low", "high"))
            given[0].noted.update(("low", "high"))
        parts = [own(_at(self, w), *(_at(x, w) for x in given)) for w in ("", "low", "high")]
        return self._told(parts)

    return operator


for _name in ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow"):
    setattr(Watched, f"__{_name}__", _operator(f"__{_name}__"))
    setattr(Watched, f"__r{_name}__", _operator(f"__r{_name}__"))
for _name in ("lt", "le", "gt", "ge", "eq", "ne", "neg", "abs", "round", "int", "trunc", "bool"):
    setattr(Watched, f"__{_name}__", _operator(f"__{_name}__"))


def trace(minutes: float) -> None:
    """Runs each case plainly and with watching numbers; keeps what was noted."""
    until = time.monotonic() + 60.0 * minutes
    done = {row["case"] for row in _kept("trace")}
    for case in CASES:
        if case in done or time.monotonic() > until:
            continue
        noted: dict[str, set[str]] = {name: set() for name in rows()}
        watching = {n: Watched.made(v, *(f * v for f in FACTORS), noted[n]) for n, v in rows().items()}
        began = time.process_time()
        plain = json.loads(json.dumps(verdict(case)))
        cpu_s = time.process_time() - began
        with holding(dict(watching)):
            again = words(verdict(case))
        which = {name: sorted(each) for name, each in noted.items() if each}
        _append("trace", {"case": case, "cpu_s": cpu_s, "noted": which, "verdict": plain})
        odd = "" if words(plain) == again else f", BUT SAYS {again}"
        print(f"{case}: {cpu_s:.1f} s, {len(which)} decisions could matter{odd}", flush=True)


def run(minutes: float) -> None:
    """Changes each decision where it could matter, cheapest cases first."""
    until = time.monotonic() + 60.0 * minutes
    traces = sorted(_kept("trace"), key=lambda row: float(row["cpu_s"]))
    done = {(row["decision"], row["factor"], row["case"]): row for row in _kept("run")}
    for tried in range(MOST_CASES):
        for name, value in rows().items():
            for factor, which in zip(FACTORS, ("low", "high"), strict=True):
                could = [row for row in traces if which in row["noted"].get(name, ())]
                could += [row for row in traces if row["case"] in ALWAYS[len(could) :] and row not in could]
                changed = sum(done.get((name, factor, row["case"]), {}).get("other", False) for row in could[:tried])
                if tried >= len(could) or changed >= 2 or (name, factor, could[tried]["case"]) in done:
                    continue
                if time.monotonic() > until:
                    return
                case = could[tried]["case"]
                said = _changed(name, factor * value, case, could[tried]["verdict"])
                row = {"decision": name, "factor": factor, "case": case} | said
                done[name, factor, case] = row
                _append("run", row)


def _changed(name: str, value: float, case: str, base: Verdict) -> dict[str, Any]:
    """Whether the verdict's words are others, and whether any of its figures is."""
    try:
        with holding({name: value}):
            now = json.loads(json.dumps(verdict(case)))
    except Exception as error:  # so far off that arithmetic fails: it decides, too
        return {"other": True, "moved": True, "says": f"{type(error).__name__}: {error}"[:200]}
    return {"other": words(now) != words(base), "moved": now != base, "says": words(now)}


def keep() -> None:
    """Writes the counts of verdicts that changed into the table's rows (format it afterwards)."""
    text, runs, traces = TABLE.read_text(encoding="utf-8"), _kept("run"), _kept("trace")
    lines = text.splitlines()
    for node in reversed(ast.parse(text).body):
        if not (isinstance(node, ast.Assign) and isinstance(node.value, ast.Call)):
            continue
        name = ast.unparse(node.targets[0])
        mine = [[row for row in runs if (row["decision"], row["factor"]) == (name, factor)] for factor in FACTORS]
        counts = [count for some in mine for count in (sum(row["other"] for row in some), len(some))]
        counts.insert(0, sum(name in row["noted"] for row in traces))
        moved = sum(row["moved"] for some in mine for row in some)
        print(
            f"{name:24} could matter in {counts[0]:2} of {len(traces)}, figures moved {moved:2}, verdicts {counts[1:]}"
        )
        row = ", ".join(ast.unparse(argument) for argument in node.value.args[:3])
        lines[node.lineno - 1 : node.end_lineno] = [f"{name} = decide({row}, ({', '.join(map(str, counts))}))"]
    TABLE.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _kept(what: str) -> list[dict[str, Any]]:
    path = FOLDER / f"{what}-{rules()}.jsonl"
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def _append(what: str, row: dict[str, Any]) -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    with (FOLDER / f"{what}-{rules()}.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def main() -> int:
    """One of the three."""
    minutes = float(sys.argv[2]) if len(sys.argv) > 2 else 7.0
    verbs: dict[str, Callable[[], None]] = {
        "trace": lambda: trace(minutes),
        "run": lambda: run(minutes),
        "keep": keep,
    }
    if len(sys.argv) < 2 or sys.argv[1] not in verbs:
        sys.exit((__doc__ or "").strip())
    verbs[sys.argv[1]]()
    return 0


if __name__ == "__main__":
    sys.exit(main())
