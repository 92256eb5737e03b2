"""Filling the cache of compiled functions, once on a new machine and after each change of the compiled sources.

It is done in a process of its own: one that had run the compiler was seen to need 7 s for a flight that takes 5 s where
the same functions come from the cache (on a noisy machine; its heap is large and scattered).  Each part compiles what
its users call and no more; of two programs that begin at once, one compiles and the other waits for it.  A flight's
part takes two processes, which share what they compile through the cache.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

from flightstack.jit import cache_folder, is_kept, machine_key, sources_key
from flightstack.quick_compiling import locked, quick_compiling
from flightstack.types import InputError
from mavlink_bridge.transport.machine import stand_back

SIMULATOR, JSBSIM, FLIGHT, SITE, CERTIFY, GAP = "simulator", "jsbsim", "flight", "site", "certify", "gap"
PARTS = (SIMULATOR, JSBSIM, FLIGHT, SITE, CERTIFY, GAP)
"""The simulated vehicle on the native plant; on JSBSim; the one on the native plant and the companion; what `--site`
and the shield need beside those; what an exploration does; what `gap` calls, the simulated vehicle included."""
_COMPANION, _SIMULATED = _HALVES = "companion", "simulated"
"""What a second process compiles meanwhile: of a flight's part what a companion calls, and the link, but for what the
first compiles; of the gap's the simulator."""
_SCENARIOS = ("paper-tracking", "minimum-snap")
_EVERY_S = 5.0
_FIELD = """schema = "flightstack.site/1"
ceiling_m = 20.0
inside = [[-30.0, -30.0], [30.0, -30.0], [30.0, 30.0], [-30.0, 30.0]]
"""


def ensure_compiled(say: Callable[[str], None], *parts: str) -> None:
    """Return when the cache holds what `parts` (none: a flight) need; where that fails they are compiled when used.

    `say` hears what goes on, every few seconds.
    """
    missing = [part for part in parts or (FLIGHT,) if not compiled(part)]
    if not missing:
        return
    say(
        "compiling (once on a new machine)"
        if is_kept()
        else "compiling (at each start: no folder can be written for it)"
    )
    with _compiling(*missing) as child:
        try:
            assert child.stdout is not None
            for line in child.stdout:
                say(line.rstrip())
            child.wait()
        finally:
            child.kill()


def compiled_first(
    on_progress: Callable[[float, str], None], site: Path | None, plant: str = "native", *more: str
) -> Callable[[], None]:
    """What compiles all that a flight needs, elsewhere: a process that has run the compiler flies more slowly.

    `more`: parts that it needs beside.
    """
    parts = (FLIGHT, *[SITE] * (site is not None), *[JSBSIM] * (plant == JSBSIM), *more)
    return lambda: ensure_compiled(lambda text: on_progress(0.0, text), *parts)


def _compiling(*parts: str) -> subprocess.Popen[str]:
    """A process that compiles; what it prints can be read."""
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "flightstack.cli.compiled", *parts],
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
            "NUMBA_CACHE_DIR": str(cache_folder()),  # where none can be kept it is this process's own
        },
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )


def compiled(part: str) -> bool:
    """Whether the cache holds what a part needs."""
    return _marker(part).exists() or (part == SIMULATOR and _marker(FLIGHT).exists())


def _marker(part: str) -> Path:
    return cache_folder() / f"{part}-is-compiled-{sources_key()}-{machine_key()}"


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
    alone = {SITE: _compile_site, CERTIFY: _compile_certify}
    if part in alone:
        alone[part]()
        return
    if part == GAP:
        with _compiling(_SIMULATED) as other:
            _compile_gap()
            other.wait()
        return
    if part in (FLIGHT, _COMPANION):
        from flightstack.cli.flight import FlyOptions, prepare, warm_up_all
        from mavlink_bridge import frequent

        if part == _COMPANION:
            prepare(FlyOptions(scenario=_SCENARIOS[0], filtering=False)).flight.warm_up()
            frequent.prepare()
            prepare(FlyOptions(scenario=_SCENARIOS[0])).flight.warm_up()  # by now the other has compiled its filter
            return
        with _compiling(_COMPANION) as other:  # meanwhile: filter and certifier, then the simulator
            setups = [prepare(FlyOptions(scenario=scenario)) for scenario in _SCENARIOS]
            compile_part(SIMULATOR)
            other.wait()
        for setup in setups:
            warm_up_all(setup)
        return
    from flightstack.cli.files import load_vehicle
    from flightstack_sim.grade import load_grade
    from flightstack_sim.warmup import warm_up

    vehicle, _ = load_vehicle(None)
    with suppress(InputError):  # not every machine has JSBSim
        warm_up(vehicle, load_grade("mocap"), part if part == JSBSIM else "native")


def _compile_site() -> None:
    """A field large enough for any shipped vehicle; its certificate is searched for, which `kept` remembers."""
    from flightstack.cli.flight import FlyOptions, prepare, warm_up_all

    with TemporaryDirectory() as folder:
        field = Path(folder) / "site.toml"
        field.write_text(_FIELD)
        warm_up_all(prepare(FlyOptions(scenario=_SCENARIOS[0], site=field)))


def _compile_certify() -> None:
    """Targets and legs of an exploration, and the design that settles it, on an axis with room to spare."""
    import numpy as np
    from numba.core import types

    from flightstack import arcs
    from flightstack.barrier.condition import Setting
    from flightstack.barrier.design import SafeSet, largest, worst_slice_area
    from flightstack.barrier.records import Authority, AxisCertificate, Response
    from flightstack.barrier.settle import FAMILIES
    from flightstack.barrier.shapes import Quadratic
    from flightstack.explore import Explorer
    from flightstack.targets import TargetSearch, limits, reachable, transit
    from flightstack.trajectory import hover

    speeds, one = np.linspace(-3.0, 3.0, 31), np.ones(31)
    authority = Authority(speeds, 9.81 * one, 0.7 * one, -2.6 * one, 9.0 * one, 0.2 * one, 0.2 * one)
    barrier, response = Quadratic(0.0, 0.0, 4.0, 0.5, 1.5), Response(0.05, 0.0, 0.02)
    cell = np.array([[-0.1, 0.1, -0.2, 0.2, 0.0, 0.5]])
    axis = AxisCertificate(2, barrier, Setting(4.0, 0.01, 0.05, 0.008), response, authority, (), cell)
    explorer, search = Explorer(), TargetSearch()
    explorer.step(explorer.init(0.0, np.zeros(3)), 0.0, None, hover((0.0, 0.0, 0.0)).at(0.0))
    reachable(axis, limits(axis, search)[0], search)
    transit(axis, 0.0, 0.1, search)
    for family in FAMILIES:
        largest(SafeSet(0.5), axis.setting, authority, response, family=family)
    worst_slice_area(barrier, response, -2.0, 2.0, 0.0)
    arcs.share_at(0.0)
    arcs.at.compile((types.Array(types.float64, 2, "C"), types.float64))  # type: ignore[attr-defined]


def _compile_gap() -> None:
    """What prepares, simulates and judges a flight, for the kinds of arrays that it is called with."""
    from numba.core import types

    from flightstack.gap import evaluated, filters, rotor_state
    from flightstack.gap.naming.whitening import whiten
    from flightstack.model import thrust_to_norm

    row, table, block = (types.Array(types.float64, dimensions, "C") for dimensions in (1, 2, 3))
    by_column, read_only = types.Array(types.float64, 2, "F"), types.Array(types.float64, 3, "C", readonly=True)
    number, numbers = types.int64, types.Array(types.int64, 1, "C")
    every: tuple[tuple[Any, ...], ...] = (
        (evaluated.windows_loop, table, table, numbers, numbers, block, table, block, block),
        (evaluated.states_loop, table, table, table, row, block),
        (whiten, row, block, number, numbers, table),
        (whiten, row, read_only, number, numbers, table),
        (filters._pass, table, table, table),
        (filters._pass, table, table, by_column),
        (filters._recursion, row, row, table, types.float64),
        (rotor_state.run_rotors, row, table, number, row, table),
        (rotor_state.run_load, row, table, table, types.boolean, row, table, table),
        (thrust_to_norm, *(types.float64,) * 3),
    )
    for function, *kinds in every:
        function.compile(tuple(kinds))


def main(parts: list[str]) -> None:
    """Compile these parts (none: all that a flight calls), then leave a mark in the cache for each."""
    stand_back()  # two processes that compile in real time leave nobody a processor for a minute
    for part in parts or [FLIGHT]:
        if part in _HALVES:
            _end_with(sys.stdin)
            with quick_compiling():
                compile_part(part)
            continue
        with locked("compiling"):
            if not compiled(part):
                _tell_progress()
                with quick_compiling():
                    compile_part(part)
                _marker(part).touch()


def _end_with(pipe: IO[str]) -> None:
    """End this process when whoever holds the other end of `pipe` has ended."""

    def watch() -> None:
        pipe.read()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    main(sys.argv[1:])
