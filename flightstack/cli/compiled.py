"""Filling the cache of compiled functions, once on a new machine and after each change of the compiled sources.

It is done in a process of its own: one that had run the compiler was seen to need 7 s for a flight that takes 5 s where
the same functions come from the cache (on a noisy machine; its heap is large and scattered).
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from flightstack.jit import cache_folder, sources_key
from flightstack.types import InputError

_MARKER = "flight-is-compiled"
_SCENARIOS = ("paper-tracking", "minimum-snap")


def ensure_compiled(say: Callable[[str], None]) -> None:
    """Return when the cache holds what a flight needs; a failure only means that it is compiled later, in process."""
    if _marker().exists():
        return
    say("compiling (once on a new machine)")
    path = os.pathsep.join(filter(None, sys.path))
    subprocess.run(
        [sys.executable, "-P", "-m", "flightstack.cli.compiled"],
        env={**os.environ, "PYTHONPATH": path},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=False,
    )


def _marker() -> Path:
    return cache_folder() / f"{_MARKER}-{sources_key()}"


def main() -> None:
    """Compile everything that a flight calls, then leave a mark in the cache."""
    from flightstack.cli.flight import FlyOptions, prepare, warm_up_all

    for scenario in _SCENARIOS:
        warm_up_all(prepare(FlyOptions(scenario=scenario)))
    with suppress(InputError):  # not every machine has JSBSim
        warm_up_all(prepare(FlyOptions(scenario=_SCENARIOS[0], plant="jsbsim")))
    _marker().touch()


if __name__ == "__main__":
    main()
