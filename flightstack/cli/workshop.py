"""Certificates made in a process of their own: a flight in real time can't wait for them, and needn't.

A tick hands over what has been learned (a copy) and from then on asks whether the certificate is there; neither ever
blocks: what the socket does not take at once goes with the next tick.  A process that ends or goes wrong takes nothing
with it: the certificate in force stays in force and is watched as before, nothing new is certified, and `lost` says
why.
"""

from __future__ import annotations

import pickle
import signal
import socket
import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from multiprocessing import get_context
from typing import NamedTuple

from threadpoolctl import threadpool_limits

from flightstack.barrier.certifier import OnlineCertifier, compile_all
from flightstack.barrier.certifier_config import CertifierState
from flightstack.barrier.records import Certificate
from flightstack.barrier.search import Ratios
from flightstack.learning.learner import LearnerState, Learnt
from flightstack.types import Learned
from mavlink_bridge.transport.machine import stand_back

_LENGTH = struct.Struct("<Q")
_BUFFER = 1 << 20
"""Bytes: an order with full pools has some 300,000."""
_NICENESS = 5
"""The flight's own process comes first; beside two programs that compute a certificate still comes soon."""
_JOIN_S = 2.0
_ENDED = "its process has ended"


class Served(NamedTuple):
    """When a certificate came, or the word that there is none: what a replay can't work out."""

    call: int
    """Which call of `work`, from 0; one that was given up has no such record."""
    before: int
    """Ticks until the process was free for it."""
    after: int
    """Ticks from then on."""


class _Reply(NamedTuple):
    certificate: Certificate | None
    ratios: dict[tuple[int, int], Ratios]
    error: str


class Workshop:
    """The flight's end of that process, which runs while this is entered and ends when the flight does."""

    def __init__(self) -> None:
        self.lost = "not begun"
        """Why no certificate will come any more."""
        self._owed = False
        """An order was placed and its reply has not come."""
        self._out, self._in = memoryview(b""), bytearray()
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
        self._socket, theirs = socket.socketpair()
        for end in (self._socket, theirs):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
        self._socket.setblocking(False)
        self.lost = ""
        with theirs:
            self._process = get_context("spawn").Process(target=serve, args=(theirs,), name="certifier", daemon=True)
            try:
                self._process.start()
            except OSError as error:  # no memory, no process number: the flight can do without
                self._lose(f"its process could not be started: {error}")
        return self

    def __exit__(self, *_: object) -> None:
        self._lose("ended")
        if self._process.pid is None:
            return
        self._process.join(_JOIN_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    @property
    def pid(self) -> int | None:
        """Of the process."""
        return self._process.pid

    def fileno(self) -> int:
        """Of the socket, for whoever has the time to wait for it."""
        return self._socket.fileno()

    def work(
        self, certifier: OnlineCertifier, learner: LearnerState | Learnt, learned: Learned, state: CertifierState
    ) -> Iterator[Certificate | None]:
        """As `OnlineCertifier.work`, of what the learner knows once the process is free: None until it is done."""
        call, before, after = self._calls, 0, 0
        self._calls += 1
        while self._is_busy(call, before):  # with an order that nobody waits for any more
            before += 1
            yield None
        self._order(certifier, learner, learned, state)
        while (reply := self._reply(call, after)) is None:
            after += 1
            yield None
        self._served.append(Served(call, before, after))
        state.ratios.clear()
        state.ratios.update(reply.ratios)
        yield reply.certificate

    def _is_busy(self, call: int, ticks: int) -> bool:
        if self._recorded is not None:
            return call in self._recorded and ticks < self._recorded[call].before
        return self._owed and not self.lost and self._exchange() is None

    def _reply(self, call: int, ticks: int) -> _Reply | None:
        """What came for the order, once it came; recorded: never for a call that was given up."""
        if self._recorded is None:
            return self._exchange()
        then = self._recorded.get(call)
        return None if then is None or ticks < then.after else _made(bytes(self._out[_LENGTH.size :]))

    def _order(
        self, certifier: OnlineCertifier, learner: LearnerState | Learnt, learned: Learned, state: CertifierState
    ) -> None:
        asked = CertifierState(version=state.version, widen_mps2=state.widen_mps2, ratios=state.ratios, turn=state.turn)
        asked.flown, asked.origin_ned_m = state.flown, state.origin_ned_m
        try:
            what = (certifier.here(), learner.evidence(), learned, asked)
            message = pickle.dumps(what, pickle.HIGHEST_PROTOCOL)
        except Exception as error:  # in flight nothing raises
            self._lose(f"{type(error).__name__}: {error}")
            return
        self._out, self._owed = memoryview(_LENGTH.pack(len(message)) + message), True

    def _exchange(self) -> _Reply | None:
        """Send and receive what goes without waiting; the reply if it is whole."""
        if self.lost:
            return None
        try:
            with suppress(BlockingIOError):
                while self._out:
                    self._out = self._out[self._socket.send(self._out) :]
            with suppress(BlockingIOError):
                while data := self._socket.recv(_BUFFER):
                    self._in += data
                self._lose(_ENDED)
                return None
            return self._received()
        except OSError:
            self._lose(_ENDED)
            return None
        except Exception as error:  # in flight nothing raises
            self._lose(f"{type(error).__name__}: {error}")
            return None

    def _received(self) -> _Reply | None:
        if len(self._in) < _LENGTH.size:
            return None
        (size,) = _LENGTH.unpack_from(self._in)
        if len(self._in) < _LENGTH.size + size:
            return None
        reply: _Reply = pickle.loads(self._in[_LENGTH.size : _LENGTH.size + size])
        del self._in[: _LENGTH.size + size]
        self._owed = False
        if reply.error:
            self._lose(reply.error)
            return None
        return reply

    def _lose(self, why: str) -> None:
        if not self.lost:
            self.lost = why
            self._socket.close()


def serve(end: socket.socket) -> None:
    """The process: one certificate after the other until the flight's end of the socket is closed."""
    for word in (signal.SIGINT, signal.SIGTERM):  # the flight's business: it lands, and then closes the socket
        signal.signal(word, signal.SIG_IGN)
    stand_back(_NICENESS)
    compile_all()
    with threadpool_limits(1, "blas"), end, suppress(OSError):
        while (message := _read(end)) is not None:
            answer = pickle.dumps(_made(message), pickle.HIGHEST_PROTOCOL)
            end.sendall(_LENGTH.pack(len(answer)) + answer)


def _made(message: bytes) -> _Reply:
    try:
        certifier, learner, learned, state = pickle.loads(message)
        ready = None
        for piece in certifier.work(learner, learned, state):
            ready = piece
        return _Reply(ready, state.ratios, "")
    except Exception as error:  # whatever it is, the flight goes on and its log says so
        return _Reply(None, {}, f"{type(error).__name__}: {error}")


def _read(end: socket.socket) -> bytes | None:
    """The next message; None where there is no more."""
    head = _exactly(end, _LENGTH.size)
    return None if head is None else _exactly(end, _LENGTH.unpack(head)[0])


def _exactly(end: socket.socket, size: int) -> bytes | None:
    parts = bytearray()
    while len(parts) < size:
        data = end.recv(min(size - len(parts), _BUFFER))
        if not data:
            return None
        parts += data
    return bytes(parts)
