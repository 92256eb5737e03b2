"""Filling the cache of compiled functions, once on a new machine and after each change of the compiled sources.

It is done in a process of its own: one that had run the compiler was seen to need 7 s for a flight that takes 5 s where
the same functions come from the cache (on a noisy machine; its heap is large and scattered).  Each part compiles what
its users call and no more; of two programs that begin at once, one compiles and the other waits for it.
"""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from flightstack.jit import cache_folder, sources_key
from flightstack.typed_once import typed_once
from flightstack.types import InputError

SIMULATOR, JSBSIM, FLIGHT = "simulator", "jsbsim", "flight"
PARTS = (SIMULATOR, JSBSIM, FLIGHT)
"""The simulated vehicle on the native plant; on JSBSim; both and the companion."""
_SCENARIOS = ("paper-tracking", "minimum-snap")
_EVERY_S = 5.0


def ensure_compiled(say: Callable[[str], None], part: str = FLIGHT) -> None:
    """Return when the cache holds what `part` needs; a failure only means that it is compiled later, in process.

    `say` hears what goes on, every few seconds.
    """
    if compiled(part):
        return
    say("compiling (once on a new machine)")
    path = os.pathsep.join(filter(None, sys.path))
    child = subprocess.Popen(
        [sys.executable, "-P", "-m", "flightstack.cli.compiled", part],
        env={**os.environ, "PYTHONPATH": path},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    with child:
        try:
            assert child.stdout is not None
            for line in child.stdout:
                say(line.rstrip())
            child.wait()
        finally:
            child.kill()


def compiled(part: str) -> bool:
    """Whether the cache holds what a part needs; a flight's code holds the others'."""
    return _marker(part).exists() or _marker(FLIGHT).exists()


def _marker(part: str) -> Path:
    return cache_folder() / f"{part}-is-compiled-{sources_key()}"


@contextmanager
def _alone() -> Iterator[None]:
    """Nobody else compiles meanwhile; where there are no locks, all do."""
    try:
        file = (cache_folder() / "compiling.lock").open("w")
    except OSError:
        yield
        return
    with file:
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _tell_progress() -> None:
    """From now on a line every few seconds says how many functions are compiled."""
    from numba.core import event

    class Counter(event.Listener):  # type: ignore[misc]
        began_s = told_s = time.monotonic()
        count = 0

        def on_start(self, event: object) -> None:
            pass

        def on_end(self, event: object) -> None:
            self.count += 1
            now_s = time.monotonic()
            if now_s - self.told_s >= _EVERY_S:
                self.told_s = now_s
                print(f"compiling: {self.count} functions in {now_s - self.began_s:.0f} s", flush=True)

    event.register("numba:compile", Counter())


def compile_part(part: str) -> None:
    """Compile everything that a part calls, in this process."""
    if part == FLIGHT:
        from flightstack.cli.flight import FlyOptions, prepare, warm_up_all

        for scenario in _SCENARIOS:
            warm_up_all(prepare(FlyOptions(scenario=scenario)))
        with suppress(InputError):  # not every machine has JSBSim
            warm_up_all(prepare(FlyOptions(scenario=_SCENARIOS[0], plant=JSBSIM)))
        return
    from flightstack.cli.files import load_vehicle
    from flightstack_sim.grade import load_grade
    from flightstack_sim.warmup import warm_up

    vehicle, _ = load_vehicle(None)
    with suppress(InputError):  # not every machine has JSBSim
        warm_up(vehicle, load_grade("mocap"), "native" if part == SIMULATOR else part)


def main(parts: list[str]) -> None:
    """Compile these parts (none: all that a flight calls), then leave a mark in the cache for each."""
    for part in parts or [FLIGHT]:
        with _alone():
            if not compiled(part):
                _tell_progress()
                with typed_once():
                    compile_part(part)
                _marker(part).touch()


if __name__ == "__main__":
    main(sys.argv[1:])
