"""A campaign's flights on a Dask cluster that exists already: `--scheduler ADDR`.

A task flies one plan in a process of its own beside the Dask worker, so that a flight that crashes or never ends is
known as such, and its row comes back like any other.  What the cluster loses is handed out again: a worker that was
killed, a worker that stands still (after three times a flight's wall time another one gets the flight as well, and the
first row counts), a scheduler that went away, for as long as it may take to come back.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

from flightstack.cli.campaign.outcomes import CRASHED
from flightstack.cli.campaign.plan import Plan
from flightstack.cli.campaign.pool import ATTEMPTS, Done, Pool
from flightstack.cli.versions import versions
from flightstack.errors import InputError

_NURSERY = "flightstack.cli.campaign.nursery"
_CONNECT_S = 10.0
_PATIENCE_S = 1800.0
"""So long a scheduler may be away."""
_POLL_S = 0.05
_STALLED = 3.0
"""Times its wall time after which a flight is given to another worker too."""
_KEPT = ("flight.mcap", "report.html")
_here = threading.local()


def fly_remote(plan: dict[str, Any], keep: str, module: str, version: str) -> dict[str, Any]:
    """On a worker of the cluster: a row, and the files that are kept, name -> bytes."""
    if version != (own := version_of_code()):
        raise InputError(f"a worker of the cluster has flightstack {own}, the campaign {version}")
    pool = getattr(_here, "pool", None)
    if pool is None or _here.kind != (keep, module):
        folder = Path(tempfile.mkdtemp(prefix="flightstack-campaign-"))
        pool = _here.pool = Pool(1, folder, keep, module)
        _here.kind = (keep, module)
    done = next(iter(pool.run([Plan(**plan)], lambda: "", lambda: None)))
    files = {name: (done.folder / name).read_bytes() for name in _KEPT if (done.folder / name).is_file()}
    for name in files:
        (done.folder / name).unlink()
    return {"row": done.row, "attempts": done.attempts, "files": files}


def version_of_code() -> str:
    """What must agree between the campaign and the cluster."""
    known = versions()
    return f"{known['flightstack']} {known['git_commit']}".strip()


@dataclass(slots=True)
class _Task:
    """A plan that the cluster has."""

    plan: Plan
    futures: list[Any]
    since_s: float
    lost: int = 0


class Cluster:
    """The executor; `run` as `Pool.run`."""

    def __init__(self, address: str, folder: Path, keep: str, module: str = _NURSERY) -> None:
        self._address, self._folder, self._keep, self._module = address, folder, keep, module
        self._client = self._connect()
        self._version = version_of_code()
        self._count = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    @property
    def shares(self) -> float:
        """What is being flown is not known in parts."""
        return 0.0

    def _connect(self, timeout_s: float | None = None) -> Any:
        try:
            from distributed import Client as connect
        except ImportError:
            raise InputError("--scheduler needs Dask: pip install 'flightstack[cluster]'") from None
        untyped: Any = connect
        try:
            return untyped(
                self._address, timeout=timeout_s or _CONNECT_S, set_as_default=False, name="flightstack-campaign"
            )
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError(f"--scheduler {self._address}: no scheduler answers there ({_words(error)})") from None

    def _close(self) -> None:
        with suppress(Exception):  # whatever a connection that is half gone says
            self._client.close(timeout=2)

    def run(self, plans: Iterable[Plan], stop: Callable[[], str], idle: Callable[[], None]) -> Iterator[Done]:
        """Fly them; each flight once, in the order in which they end."""
        waiting, tasks = iter(plans), dict[int, _Task]()
        while True:
            if self._client.status != "running":
                self._reconnect(tasks, stop, idle)
            with suppress(OSError, TimeoutError):
                self._hand_out(waiting, tasks)
            if not tasks or stop():
                self._cancel(tasks)
                return
            for task in list(tasks.values()):
                if (done := self._look_at(task)) is not None:
                    del tasks[task.plan.flight]
                    self._cancel({0: task})
                    yield done
            idle()
            time.sleep(_POLL_S)

    def _hand_out(self, waiting: Iterator[Plan], tasks: dict[int, _Task]) -> None:
        threads = sum(worker["nthreads"] for worker in self._client.scheduler_info(n_workers=-1)["workers"].values())
        while len(tasks) < max(2 * threads, 2):
            plan = next(waiting, None)
            if plan is None:
                return
            tasks[plan.flight] = _Task(plan, [], time.monotonic())
            tasks[plan.flight].futures += self._submit(plan)

    def _submit(self, plan: Plan, workers: list[str] | None = None) -> list[Any]:
        """The future of a plan handed out; none where the scheduler has gone away at this moment."""
        self._count += 1
        key = f"flight-{plan.flight}-{self._count}-{time.time_ns()}"
        with suppress(Exception):  # a client that is closing raises what it likes; the plan is handed out again
            future = self._client.submit(
                fly_remote, asdict(plan), self._keep, self._module, self._version, pure=False, key=key,
                workers=workers, allow_other_workers=bool(workers),
            )  # fmt: skip
            return [future]
        return []

    def _look_at(self, task: _Task) -> Done | None:
        """The flight, if it is accounted for; what was lost is handed out again."""
        for future in task.futures:
            if future.status == "finished":
                with suppress(OSError, TimeoutError):
                    return self._done(task, future.result(timeout=_CONNECT_S))
        for future in [each for each in task.futures if each.status in ("error", "cancelled", "lost")]:
            task.futures.remove(future)
            if future.status == "error":
                error = future.exception()
                if isinstance(error, InputError):
                    raise error
                task.lost += 1
                if task.lost >= ATTEMPTS and not task.futures:
                    row = {"outcome": CRASHED, "reason": f"the cluster lost it: {_words(error)}", "result": None}
                    return self._done(task, {"row": row | {"wall_s": 0.0}, "attempts": task.lost, "files": {}})
        if not task.futures:
            task.futures += self._submit(task.plan)
            task.since_s = time.monotonic()
        elif time.monotonic() - task.since_s > _STALLED * task.plan.limit_s:
            task.futures += self._submit(task.plan, self._others(task))
            task.since_s = time.monotonic()
        return None

    def _others(self, task: _Task) -> list[str] | None:
        """Workers that do not have this flight already."""
        keys = {future.key for future in task.futures}
        with suppress(OSError, TimeoutError):
            held = self._client.processing()
            return [worker for worker, flying in held.items() if not keys & set(map(str, flying))] or None
        return None

    def _done(self, task: _Task, answer: dict[str, Any]) -> Done:
        folder = self._folder / f"{task.plan.flight:06d}"
        row = answer["row"]
        for name, data in answer["files"].items():
            with suppress(OSError):  # a full disk costs the log
                folder.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(data)
        return Done(task.plan, row, folder, int(answer["attempts"]), "cluster")

    def _cancel(self, tasks: dict[int, _Task]) -> None:
        left = [future for task in tasks.values() for future in task.futures if future.status == "pending"]
        with suppress(Exception):  # they are of no use any more, whoever still has them
            if left:
                self._client.cancel(left, force=True)

    def _reconnect(self, tasks: dict[int, _Task], stop: Callable[[], str], idle: Callable[[], None]) -> None:
        """Wait for the scheduler; then everything that it had is handed out again."""
        self._close()
        until = time.monotonic() + _PATIENCE_S
        while True:
            try:
                self._client = self._connect(2.0)
                break
            except InputError:
                if stop() or time.monotonic() > until:
                    raise
                idle()
        for task in tasks.values():
            task.futures = self._submit(task.plan)
            task.since_s = time.monotonic()


def _words(error: BaseException | None) -> str:
    text = " ".join(str(error).split())
    return text[:160] or type(error).__name__
