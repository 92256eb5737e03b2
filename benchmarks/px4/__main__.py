"""`python -m benchmarks.px4 [SUBJECT ...]` flies subjects and writes their tables; see the package's text."""

from __future__ import annotations

import argparse
import importlib
import os
import pkgutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.px4 import subjects
from benchmarks.px4.records import Bench
from benchmarks.px4.station import Px4
from benchmarks.px4.table import block, put

PAGE = Path("docs/px4.md")


def main() -> int:
    """Fly the subjects and write their tables; 1 where one was not reached, 2 where there is no PX4."""
    names = sorted(module.name for module in pkgutil.iter_modules(subjects.__path__))
    parser = argparse.ArgumentParser(prog="python -m benchmarks.px4")
    parser.add_argument("subject", nargs="*", metavar="SUBJECT", help="all, or of " + ", ".join(names))
    parser.add_argument("--runs", type=int, help="flights a subject instead of its own number")
    parser.add_argument("--instance", type=int, default=0, help="PX4's instance; ports follow from it")
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--out", type=Path, default=Path("runs/px4"))
    parser.add_argument("--prefix", default="", metavar="WORDS", help="before the companion's command, as `chrt -f 20`")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # PX4 ends with us
    if unknown := set(given.subject) - set(names):
        parser.error(f"no subject {', '.join(sorted(unknown))}: choose from {', '.join(names)}")
    home = Path(os.environ.get("PX4_HOME", ""))
    if not os.access(home / "run.sh", os.X_OK):
        print("error: set PX4_HOME to a folder with an executable run.sh INSTANCE [sih|hil]", file=sys.stderr)
        return 2
    prefix = tuple(given.prefix.split())
    bench = Bench(home.resolve(), given.out.resolve(), given.instance, prefix)
    with Px4(bench) as px4:
        px4.wait(lambda: bool(px4.version), 5.0)
        version = px4.version or "unknown version"
    priority = f", companion by `{given.prefix}`" if given.prefix else ""
    reached = True
    for name in given.subject or names:
        module = importlib.import_module(f"{subjects.__name__}.{name}")
        rows = module.run(bench, given.runs or module.RUNS)
        made_with = f"{time.strftime('%Y-%m-%d')}, PX4 {version}, flightstack {_commit()}{priority}."
        text = block(name, module.ASKED, rows, made_with)
        print(text, flush=True)
        put(given.page, name, text)
        reached = reached and all(row.reached is not False for row in rows)
    return 0 if reached else 1


def _commit() -> str:
    done = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    return done.stdout.strip() or "of unknown commit"


if __name__ == "__main__":
    sys.exit(main())
