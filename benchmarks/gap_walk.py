"""The way of a log to a named effect as a reader meets it: every function of `gap/` once, in order of its first call.

    python -m benchmarks.gap_walk [CASE]     every stop, on a case of benchmarks.gap_frozen

A stop is a stay in one file; the counts are part of `make house`.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import FrameType

from benchmarks.gap_frozen import CASES, files
from flightstack.cli.files import load_vehicle
from flightstack.gap import workflow

ROOT = Path(workflow.__file__).parent


def walk(case: str = "payload") -> list[tuple[str, str]]:
    """(file, function) in the order of first calls."""
    log, vehicle = files(case)
    met: dict[tuple[str, str], None] = {}

    def follow(frame: FrameType, event: str, argument: object) -> None:
        path, name = Path(frame.f_code.co_filename), frame.f_code.co_name
        if event == "call" and name.isidentifier() and name != "__init__" and path.is_relative_to(ROOT):
            met.setdefault((path.relative_to(ROOT).as_posix(), frame.f_code.co_qualname))

    believed = load_vehicle(str(vehicle))[0]
    sys.setprofile(follow)
    try:
        workflow.analyse([log], believed)
    finally:
        sys.setprofile(None)
    return list(met)


def stops(met: list[tuple[str, str]]) -> list[str]:
    """The files, each time the walk comes into one."""
    return [file for k, (file, _) in enumerate(met) if not k or met[k - 1][0] != file]


def counts(met: list[tuple[str, str]]) -> str:
    """One line."""
    way = stops(met)
    return f"log to named effect: {len(met)} functions in {len(way)} stops, {len(set(way))} files"


def main() -> None:
    """Every stop, and the counts."""
    met = walk(*[argument for argument in sys.argv[1:] if argument in CASES][:1])
    for k, (file, function) in enumerate(met):
        print(f"{file if not k or met[k - 1][0] != file else '':28}{function}")
    print(counts(met))


if __name__ == "__main__":
    main()
