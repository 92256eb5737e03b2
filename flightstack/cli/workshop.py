"""Who makes certificates beside a flight, in a process of its own (`certifier_process`).

In real time (`Workshop`) a tick hands over what has been learned (a copy) and from then on asks whether the certificate
is there; neither ever blocks.  Where the process is lost the certificate in force stays in force and is watched as
before, nothing new is certified, and `lost` says why.

In lockstep (`Appointed`) each certificate comes a fixed number of ticks after it was asked for, and there the flight
waits for it.  Without a process, or where that is lost, it is made in that tick, with the same bytes: what is flown
does not depend on the machine.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from multiprocessing import parent_process
from typing import NamedTuple

from flightstack.barrier.certifier import OnlineCertifier
from flightstack.barrier.certifier_config import CertifierState
from flightstack.barrier.records import Certificate
from flightstack.cli.certifier_process import CertifierProcess, Reply, made, order
from flightstack.learning.learner import LearnerState, Learnt
from flightstack.types import Learned

_NICENESS = 5
"""The flight's own process comes first; beside two programs that compute a certificate still comes soon."""
_URGENT_TICKS, _TICKS = 125, 250
"""In lockstep, from the order to the certificate: with none in force or a falsified one, and otherwise."""
_WAIT_S = 20.0
"""For a certificate that takes 0.1 s: a process that takes longer is stuck."""


class Served(NamedTuple):
    """When a certificate came, or the word that there is none: what a replay can't work out."""

    call: int
    """Which call of `work`, from 0; one that was given up has no such record."""
    before: int
    """Ticks until the process was free for it."""
    after: int
    """Ticks from then on."""


class Workshop(CertifierProcess):
    """In real time; the process runs while this is entered and ends when the flight does."""

    def __init__(self) -> None:
        super().__init__()
        self._served: list[Served] = []
        self._calls = 0
        self._recorded: dict[int, Served] | None = None

    def count_anew(self) -> None:
        """Orders are numbered from 0 again, and `served` begins: a flight's log does."""
        self._calls = 0
        self._served.clear()

    @property
    def served(self) -> Sequence[Served]:
        """Every answer so far."""
        return self._served

    def again(self, served: Iterable[Served]) -> None:
        """From now on each answer comes when it came in a recorded flight, made in the tick that asks for it."""
        self.lost, self._recorded = "", {each.call: each for each in served}

    def __enter__(self) -> Workshop:
        self.begin("spawn", _NICENESS)
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def work(
        self, certifier: OnlineCertifier, learner: LearnerState | Learnt, learned: Learned, state: CertifierState
    ) -> Iterator[Certificate | None]:
        """As `OnlineCertifier.work`, of what the learner knows once the process is free: None until it is done."""
        call, before, after = self._calls, 0, 0
        self._calls += 1
        while self._is_busy(call, before):  # with an order that nobody waits for any more
            before += 1
            yield None
        message = self._ordered(certifier, learner, learned, state)
        while (reply := self._reply(call, after, message)) is None:
            after += 1
            yield None
        self._served.append(Served(call, before, after))
        state.ratios.clear()
        state.ratios.update(reply.ratios)
        yield reply.certificate

    def _is_busy(self, call: int, ticks: int) -> bool:
        if self._recorded is not None:
            return call in self._recorded and ticks < self._recorded[call].before
        return self.owed and not self.lost and self._sound() is None

    def _reply(self, call: int, ticks: int, message: bytes) -> Reply | None:
        """What came for the order, once it came; recorded: never for a call that was given up."""
        if self._recorded is None:
            return self._sound()
        then = self._recorded.get(call)
        return None if then is None or ticks < then.after else made(message)

    def _sound(self) -> Reply | None:
        """What came, if it is no error: such a process is asked for nothing more."""
        reply = self.exchange()
        if reply is None or not reply.error:
            return reply
        self.lose(reply.error)
        return None

    def _ordered(
        self, certifier: OnlineCertifier, learner: LearnerState | Learnt, learned: Learned, state: CertifierState
    ) -> bytes:
        try:
            message = order(certifier, learner, learned, state)
        except Exception as error:  # in flight nothing raises
            self.lose(f"{type(error).__name__}: {error}")
            return b""
        self.place(message)
        return message


class Appointed:
    """In lockstep; while this is entered a process does the work, where there is a second core for one."""

    def __init__(self) -> None:
        self.lost = ""
        """Why no certificate will come any more: never for want of a process."""
        self.served: Sequence[Served] = ()
        """Nothing that a replay could not work out."""
        self.process = CertifierProcess()

    def count_anew(self) -> None:
        """Nothing is numbered."""

    def __enter__(self) -> Appointed:
        if _may_fork():
            self.process.begin("fork", 0)
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.lost != "not begun":
            self.process.end()

    def work(
        self, certifier: OnlineCertifier, learner: LearnerState | Learnt, learned: Learned, state: CertifierState
    ) -> Iterator[Certificate | None]:
        """As `OnlineCertifier.work`, of what the learner knows now: None until the appointed tick."""
        urgent, process, placed = state.certificate is None or state.falsified, self.process, False
        message = order(certifier, learner, learned, state)
        for _ in range(_URGENT_TICKS if urgent else _TICKS):
            if placed:
                process.push()
            elif not process.owed or process.exchange() is not None:  # of an order that nobody waits for any more
                process.place(message)
                process.push()
                placed = True
            yield None
        reply = (process.waited(_WAIT_S) if placed else None) or made(message)
        self.lost = self.lost or reply.error
        state.ratios.clear()
        state.ratios.update(reply.ratios)
        yield None if self.lost else reply.certificate
        while True:
            yield None


def _may_fork() -> bool:
    """Whether a fork is allowed for (of one thread) and pays: on two cores that no pool of processes flies on."""
    if sys.platform != "linux" or threading.active_count() > 1 or parent_process() is not None:
        return False
    return len(os.sched_getaffinity(0)) > 1
