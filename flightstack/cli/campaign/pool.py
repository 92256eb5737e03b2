"""Workers on this machine: forked from one warm process, watched, and replaced where one crashes or never ends."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from flightstack.cli.campaign.outcomes import CRASHED, TIMED_OUT
from flightstack.cli.campaign.plan import Plan
from flightstack.cli.campaign.wire import Lines

ATTEMPTS = 2
"""A flight whose process ended or stood still is flown once more: it may have been the machine."""
_WAIT_S = 0.1
_GOODBYE_S = 2.0


@dataclass(slots=True)
class Done:
    """A flight that is accounted for."""

    plan: Plan
    row: dict[str, Any]
    """outcome, reason, result, wall_s."""
    folder: Path
    """Where its log lies, if it is kept."""
    attempts: int = 1
    worker: str = ""


@dataclass(slots=True)
class Worker:
    """One process, and what it flies."""

    pid: int
    lines: Lines
    plan: Plan | None = None
    folder: Path = field(default_factory=Path)
    began_s: float = 0.0
    share: float = 0.0

    def fileno(self) -> int:
        """For select."""
        return self.lines.fileno()


class Nursery:
    """The process that workers are forked from."""

    def __init__(self, module: str) -> None:
        ours, theirs = socket.socketpair()
        path = os.pathsep.join(filter(None, sys.path))
        command = [sys.executable, "-P", "-m", module, str(theirs.fileno())]
        self._process = subprocess.Popen(
            command,
            pass_fds=(theirs.fileno(),),
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=None if os.environ.get("FLIGHTSTACK_WORKER_ERRORS") else subprocess.DEVNULL,
        )
        theirs.close()
        self._ours, self._lines = ours, Lines(ours)
        self._ended: dict[int, str] = {}
        self._warm = False

    def start(self) -> Worker:
        """A new worker; the first one waits until the nursery is warm."""
        while not self._warm:
            self._warm = self._lines.receive().get("warm", False)
        ours, theirs = socket.socketpair()
        try:
            socket.send_fds(self._ours, [b"w"], [theirs.fileno()])
            while "pid" not in (message := self._lines.receive()):
                self._ended[int(message["ended"])] = str(message["how"])
            return Worker(int(message["pid"]), Lines(ours))
        except (OSError, EOFError):
            ours.close()
            raise EOFError("the nursery is gone") from None
        finally:
            theirs.close()

    def how_ended(self, pid: int, timeout_s: float = _GOODBYE_S) -> str:
        """How a worker ended, in words."""
        until = time.monotonic() + timeout_s
        while pid not in self._ended and (left := until - time.monotonic()) > 0.0:
            if self._lines.ready(left):
                message = self._lines.receive()
                if "ended" in message:
                    self._ended[int(message["ended"])] = str(message["how"])
        return self._ended.pop(pid, "unknown how")

    def close(self) -> None:
        """End it, and with it all of its workers."""
        self._lines.close()
        try:
            self._process.wait(_GOODBYE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class Pool:
    """So many workers; `run` gives each flight back once it is accounted for, in the order in which they end."""

    def __init__(self, workers: int, folder: Path, keep: str, module: str = "flightstack.cli.campaign.nursery") -> None:
        self._count, self._folder, self._keep, self._module = workers, folder, keep, module
        self._nursery: Nursery | None = None
        self._workers: list[Worker] = []
        self._attempts: dict[int, int] = {}
        self._again: deque[Plan] = deque()
        self.started_s: list[float] = []
        """What each worker's start took."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def shares(self) -> float:
        """Flights' worth of what is being flown."""
        return sum(worker.share for worker in self._workers if worker.plan is not None)

    def run(self, plans: Iterable[Plan], stop: Callable[[], str], idle: Callable[[], None]) -> Iterator[Done]:
        """Fly them; after `stop` says why, nothing new is begun and what is being flown is left."""
        waiting = iter(plans)
        while True:
            self._feed(waiting)
            if not any(worker.plan for worker in self._workers):
                return
            for worker in self._ready():
                if (done := self._hear(worker)) is not None:
                    yield done
            idle()
            if stop():
                return

    def _feed(self, waiting: Iterator[Plan]) -> None:
        while len(busy := [w for w in self._workers if w.plan is not None]) < self._count:
            plan = self._again.popleft() if self._again else next(waiting, None)
            if plan is None:
                return
            for worker in [w for w in self._workers if w.plan is None and w.lines.ready(0.0)]:  # it ended while idle
                self._dismiss(worker)
            free = [worker for worker in self._workers if worker not in busy]
            self._give(free[0] if free else self._start(), plan)

    def _start(self) -> Worker:
        began = time.monotonic()
        try:
            self._nursery = self._nursery or Nursery(self._module)
            worker = self._nursery.start()
        except EOFError:
            self._drop_nursery()
            self._nursery = Nursery(self._module)
            worker = self._nursery.start()
        self._workers.append(worker)
        self.started_s.append(time.monotonic() - began)
        return worker

    def _give(self, worker: Worker, plan: Plan) -> None:
        self._attempts[plan.flight] = self._attempts.get(plan.flight, 0) + 1
        worker.plan, worker.began_s, worker.share = plan, time.monotonic(), 0.0
        worker.folder = self._folder / f"{plan.flight:06d}"
        shutil.rmtree(worker.folder, ignore_errors=True)
        job = {"text": plan.text, "folder": str(worker.folder), "keep": self._keep, "kept": plan.kept}
        with contextlib.suppress(EOFError):  # it is gone: seen when it is listened to
            worker.lines.send(job)

    def _ready(self) -> list[Worker]:
        """Workers that have something to say, or no time left."""
        flying = [worker for worker in self._workers if worker.plan is not None]
        said = select.select(flying, [], [], _WAIT_S)[0]
        now_s = time.monotonic()
        late = [w for w in flying if w not in said and w.plan and now_s - w.began_s > w.plan.limit_s]
        return [*said, *late]

    def _hear(self, worker: Worker) -> Done | None:
        assert worker.plan is not None
        plan = worker.plan
        if not worker.lines.ready(0.0):
            os.kill(worker.pid, signal.SIGKILL)
            return self._lost(worker, TIMED_OUT, f"did not end within {plan.limit_s:.0f} s of wall time")
        try:
            message = worker.lines.receive()
            while "row" not in message:
                worker.share = float(message["share"])
                if not worker.lines.pending:
                    return None
                message = worker.lines.receive()
        except EOFError:
            return self._lost(worker, CRASHED, f"its process ended: {self._how_ended(worker.pid)}")
        worker.plan = None
        return Done(plan, message["row"], worker.folder, self._attempts.pop(plan.flight), f"pid {worker.pid}")

    def _how_ended(self, pid: int) -> str:
        try:
            return "unknown how" if self._nursery is None else self._nursery.how_ended(pid)
        except EOFError:  # the nursery is gone too: the next worker gets another
            self._drop_nursery()
            return "killed with all others"

    def _drop_nursery(self) -> None:
        if self._nursery is not None:
            self._nursery.close()
            self._nursery = None

    def _dismiss(self, worker: Worker) -> None:
        worker.lines.close()
        self._workers.remove(worker)

    def _lost(self, worker: Worker, outcome: str, reason: str) -> Done | None:
        plan, folder = worker.plan, worker.folder
        assert plan is not None
        self._dismiss(worker)
        attempts = self._attempts[plan.flight]
        if attempts < ATTEMPTS:
            self._again.append(plan)
            return None
        del self._attempts[plan.flight]
        wall_s = time.monotonic() - worker.began_s
        row = {"outcome": outcome, "reason": reason, "result": None, "wall_s": wall_s}
        return Done(plan, row, folder, attempts, f"pid {worker.pid}")

    def close(self) -> None:
        """End all workers."""
        for worker in self._workers:
            with contextlib.suppress(OSError):
                os.kill(worker.pid, signal.SIGKILL)
            worker.lines.close()
        self._workers.clear()
        self._drop_nursery()
