"""`flightstack reproduce`: the parts in two processes, then the table, the figures and the page.

What is finished is kept at once (`parts`): an interrupted run goes on where it was, if it asks for the same.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import queue
import signal
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

from flightstack.cli import files
from flightstack.cli.versions import versions
from flightstack.types import InputError
from flightstack_paper.parts import PartStore, sources_hash
from flightstack_paper.plan import PaperPart, parts_of
from flightstack_paper.rows import ResultLine, table

SCHEMA = "flightstack.paper/1"
PROCESSES = 2
_LOOK_S = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class ReproduceOptions:
    """What `reproduce` was asked for."""

    out: Path
    quick: bool = False
    plant: str | None = None
    """Fly on this one alone; None: native, and in a full run JSBSim too."""
    seed: int = 0


@dataclass(slots=True)
class ReproduceResult:
    """What came of a run."""

    rows: list[ResultLine]
    head: dict[str, Any]
    """When, with what, how long."""
    figures: list[str]
    """File names."""
    failed: dict[str, str] = field(default_factory=dict)
    """Part -> why."""
    stopped: str = ""
    """Why it ended early; then there are no rows."""

    def as_json(self) -> dict[str, Any]:
        """The `flightstack.paper/1` object."""
        return {"schema": SCHEMA, **self.head, "figures": self.figures, "rows": [row.as_json() for row in self.rows]}


def reproduce(
    options: ReproduceOptions,
    *,
    stop_requested: Callable[[], str] = lambda: "",
    on_progress: Callable[[float, str], None] = lambda share, phase: None,
    parts_wanted: Callable[[tuple[str, ...], int, bool], list[PaperPart]] | None = None,
) -> ReproduceResult:
    """Compute, fly, write; InputError before anything is computed where the folder can't be written."""
    from flightstack.cli.compiled import ensure_compiled

    plants = plants_of(options)
    made_with = versions()
    key = {
        "version": made_with["flightstack"], "git_commit": made_with["git_commit"], "sources": sources_hash(),
        "seed": options.seed, "quick": options.quick, "plants": list(plants),
    }  # fmt: skip
    parts = PartStore(options.out, key)
    began = time.monotonic()
    ensure_compiled(lambda text: on_progress(0.0, text))
    wanted = (
        parts_of(plants, options.seed, quick=options.quick)
        if parts_wanted is None
        else parts_wanted(plants, options.seed, options.quick)
    )
    taken_up = sum(parts.load(part.name) is not None for part in wanted)
    results, stopped = _compute(wanted, parts, stop_requested, on_progress)
    head = {
        "date": str(date.today()), "command": command(options), "version": key["version"],
        "git_commit": key["git_commit"], "seed": options.seed, "quick": options.quick, "plants": key["plants"],
        "wall_time_s": time.monotonic() - began, "parts": len(wanted), "taken_up": taken_up,
    }  # fmt: skip
    failed = {name: found["failed"] for name, found in results.items() if "failed" in found}
    if stopped:
        return ReproduceResult([], head, [], failed, stopped)
    on_progress(0.99, "figures and page")
    return _write(options, plants, results, head, failed)


def command(options: ReproduceOptions) -> str:
    """How to run it again."""
    plant = f" --plant {options.plant}" if options.plant else ""
    return f"flightstack reproduce --out DIR{' --quick' * options.quick}{plant} --seed {options.seed}"


def plants_of(options: ReproduceOptions) -> tuple[str, ...]:
    """Those that fly, the first one's rows under their plain ids; InputError where the one asked for isn't here."""
    from flightstack_sim.jsbsim.library import library

    if options.plant == "native" or (options.plant is None and options.quick):
        return ("native",)
    try:
        library()
    except InputError:
        if options.plant is not None:
            raise
        return ("native",)
    return ("native", "jsbsim") if options.plant is None else (options.plant,)


def _write(
    options: ReproduceOptions,
    plants: tuple[str, ...],
    results: dict[str, dict[str, Any]],
    head: dict[str, Any],
    failed: dict[str, str],
) -> ReproduceResult:
    from flightstack_paper.figures import draw
    from flightstack_paper.page import markdown, page

    rows = table(results, plants, options.seed, quick=options.quick)
    figures = draw(results, plants, options.seed, options.out)
    result = ReproduceResult(rows, head, [figure.file for figure in figures], failed)
    files.write_text(options.out / "table.md", markdown(rows, head))
    files.write_text(options.out / "report.html", page(rows, figures, head, results, options.out))
    files.write_json(options.out / "results.json.part", result.as_json())
    (options.out / "results.json.part").replace(options.out / "results.json")  # last: it says that all is there
    return result


def _compute(
    wanted: list[PaperPart],
    parts: PartStore,
    stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None],
) -> tuple[dict[str, dict[str, Any]], str]:
    """Every part's result, from the folder or from two processes; and why it was stopped, if it was."""
    results = {part.name: found for part in wanted if (found := parts.load(part.name)) is not None}
    left = [part for part in wanted if part.name not in results]
    if not left:
        return results, ""
    context = multiprocessing.get_context("spawn")
    told: Any = context.Queue()
    stop: Any = context.Event()
    progress = _Progress(wanted, set(results), on_progress)
    stopped = ""
    with ProcessPoolExecutor(min(PROCESSES, len(left)), context, _begin, (told, stop)) as pool:
        running: dict[Future[dict[str, Any]], PaperPart] = {
            pool.submit(_run, part, str(parts.place(part.name))): part for part in left
        }
        while running:
            done, _ = wait(running, timeout=_LOOK_S)
            for future in done:
                part = running.pop(future)
                if future.cancelled():
                    continue
                found = _result_of(future)
                results[part.name] = found
                if "failed" not in found:
                    parts.save(part.name, found)
                progress.finished(part)
            progress.hear(told)
            if not stopped and (stopped := stop_requested()):
                stop.set()
                for future in running:
                    future.cancel()
    return results, stopped


def _result_of(future: Future[dict[str, Any]]) -> dict[str, Any]:
    try:
        return future.result()
    except BrokenProcessPool:
        return {"failed": "its process ended: was there enough memory?"}


class _Progress:
    """What is done, counted by what the parts are expected to take."""

    def __init__(self, parts: list[PaperPart], done: set[str], show: Callable[[float, str], None]) -> None:
        self._costs = {part.name: part.cost_s for part in parts}
        self._shares = dict.fromkeys(done, 1.0)
        self._show = show

    def finished(self, part: PaperPart) -> None:
        """A part is there."""
        self._shares[part.name] = 1.0
        self._tell(part.name)

    def hear(self, told: Any) -> None:
        """What the processes say of the parts under way."""
        name = ""
        while True:
            try:
                name, share = told.get_nowait()
            except (queue.Empty, OSError, EOFError):
                break
            if self._shares.get(name, 0.0) < 1.0:
                self._shares[name] = min(share, 0.99)
        if name:
            self._tell(name)

    def _tell(self, name: str) -> None:
        done = sum(self._costs[each] * share for each, share in self._shares.items())
        self._show(0.98 * done / sum(self._costs.values()), name)


_TOLD: Any = None
_STOP: Any = None


def _begin(told: Any, stop: Any) -> None:
    """A process of the pool: Ctrl-C is the parent's business."""
    global _TOLD, _STOP
    _TOLD, _STOP = told, stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.environ.setdefault("MPLBACKEND", "Agg")


def _run(part: PaperPart, folder: str) -> dict[str, Any]:
    """One part, in a process of the pool; what goes wrong is its result."""
    from flightstack_paper.work import KINDS, PartContext, PartFailed

    last = 0.0

    def show(share: float, phase: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > _LOOK_S:
            last = now
            _TOLD.put((part.name, share))

    bench = PartContext(Path(folder), lambda: "stopped by the user" if _STOP.is_set() else "", show)
    try:
        found = json.loads(json.dumps(KINDS[part.kind](bench, **part.given)))  # as a resumed run will read it
        return {"failed": "stopped"} if _STOP.is_set() else found
    except (PartFailed, InputError) as error:
        return {"failed": " ".join(str(error).split())}
    except Exception as error:  # the other parts, and the report, are worth having all the same
        return {"failed": f"{type(error).__name__}: {error}"}
