"""A process that makes certificates beside a flight, and the flight's end of the socket to it.

Nothing here waits unless it is asked to: what the socket does not take at once goes with the next call.  A process that
ends or goes wrong takes nothing with it: `lost` says why no answer will come.  It ends with the flight, however that
ends: by itself once the socket is closed, and on Linux at once.
"""

from __future__ import annotations

import gc
import os
import pickle
import select
import signal
import socket
import struct
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import get_context
from typing import Literal, NamedTuple, TypeVar

from threadpoolctl import threadpool_limits

from flightstack.barrier.certifier import OnlineCertifier, compile_all
from flightstack.barrier.certifier_config import CertifierState
from flightstack.barrier.records import Certificate
from flightstack.barrier.search import Ratios
from flightstack.learning.learner import LearnerState, Learnt
from flightstack.types import Learned
from mavlink_bridge.transport.machine import die_with_parent, stand_back

_LENGTH = struct.Struct("<Q")
_BUFFER = 1 << 20
"""Bytes: an order with full pools has some 300,000."""
_ENDED = "its process has ended"
_T = TypeVar("_T")


class Reply(NamedTuple):
    """What came of an order."""

    certificate: Certificate | None
    ratios: dict[tuple[int, int], Ratios]
    error: str


class CertifierProcess:
    """The flight's end."""

    def __init__(self) -> None:
        self.lost = "not begun"
        """Why no answer will come any more."""
        self.owed = False
        """An order was placed and its reply has not come."""
        self._out, self._in = memoryview(b""), bytearray()

    def begin(self, how: Literal["fork", "spawn"], niceness: int) -> None:
        """Start it: `spawn` takes a second or two of its own time, `fork` a few milliseconds and one thread only."""
        self._socket, theirs = socket.socketpair()
        for end in (self._socket, theirs):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
        self._socket.setblocking(False)
        self.lost = ""
        forked = (self._socket, os.getpid()) if how == "fork" else None
        context = get_context("fork") if how == "fork" else get_context("spawn")
        with theirs, warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which are the linear algebra's own
            arguments = (theirs, niceness, forked)
            self._process = context.Process(target=serve, args=arguments, name="certifier", daemon=True)
            try:
                self._process.start()
            except OSError as error:  # no memory, no process number: the flight can do without
                self.lose(f"its process could not be started: {error}")

    def end(self) -> None:
        """No flight any more, no process."""
        self.lose("ended")
        if self._process.pid is not None:
            self._process.kill()
            self._process.join()

    @property
    def pid(self) -> int | None:
        """Of the process."""
        return self._process.pid

    def fileno(self) -> int:
        """Of the socket, for whoever has the time to wait for it."""
        return self._socket.fileno()

    def place(self, message: bytes) -> None:
        """Order a certificate; only where nothing is owed."""
        self._out, self.owed = memoryview(_LENGTH.pack(len(message)) + message), True

    def push(self) -> None:
        """Send what is left of an order."""
        if self._out and not self.lost:
            self._guarded(self._send)

    def exchange(self) -> Reply | None:
        """Send and receive what goes without waiting; the reply if it is whole."""
        return None if self.lost else self._guarded(self._both)

    def waited(self, most_s: float) -> Reply | None:
        """The reply that is owed, waited for; None where it is lost, as it is after `most_s`."""
        until_s, poll = time.monotonic() + most_s, select.poll()
        while (reply := self.exchange()) is None and not self.lost:
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                self.lose(f"no answer for {most_s:.0f} s")
                break
            poll.register(self, select.POLLIN | select.POLLOUT if self._out else select.POLLIN)
            poll.poll(1e3 * left_s)
        return reply

    def lose(self, why: str) -> None:
        """Nothing is asked of it or taken from it any more."""
        if not self.lost:
            self.lost = why
            self._socket.close()

    def _guarded(self, deed: Callable[[], _T | None]) -> _T | None:
        try:
            return deed()
        except OSError:
            self.lose(_ENDED)
        except Exception as error:  # in flight nothing raises
            self.lose(f"{type(error).__name__}: {error}")
        return None

    def _send(self) -> None:
        with suppress(BlockingIOError):
            while self._out:
                self._out = self._out[self._socket.send(self._out) :]

    def _both(self) -> Reply | None:
        self._send()
        with suppress(BlockingIOError):
            while data := self._socket.recv(_BUFFER):
                self._in += data
            self.lose(_ENDED)
            return None
        return self._received()

    def _received(self) -> Reply | None:
        if len(self._in) < _LENGTH.size:
            return None
        (size,) = _LENGTH.unpack_from(self._in)
        if len(self._in) < _LENGTH.size + size:
            return None
        reply: Reply = pickle.loads(self._in[_LENGTH.size : _LENGTH.size + size])
        del self._in[: _LENGTH.size + size]
        self.owed = False
        return reply


def order(certifier: OnlineCertifier, learner: LearnerState | Learnt, learned: Learned, state: CertifierState) -> bytes:
    """All that `OnlineCertifier.work` goes by, as of now."""
    asked = CertifierState(version=state.version, widen_mps2=state.widen_mps2, ratios=state.ratios, turn=state.turn)
    asked.flown, asked.origin_ned_m = state.flown, state.origin_ned_m
    return pickle.dumps((certifier.here(), learner.evidence(), learned, asked), pickle.HIGHEST_PROTOCOL)


def made(message: bytes) -> Reply:
    """The reply to an order, here and now; in every process the same to the last bit."""
    try:
        certifier, learner, learned, state = pickle.loads(message)
        ready = None
        for piece in certifier.work(learner, learned, state):
            ready = piece
        return Reply(ready, state.ratios, "")
    except Exception as error:  # whatever it is, the flight goes on and its log says so
        return Reply(None, {}, f"{type(error).__name__}: {error}")


def serve(end: socket.socket, niceness: int, forked: tuple[socket.socket, int] | None) -> None:
    """The process: one certificate after the other until the flight's end of the socket is closed.

    forked: the flight's end, which a fork has as well, and the flight's process.
    """
    for word in (signal.SIGINT, signal.SIGTERM):  # the flight's business: it lands, and then closes the socket
        signal.signal(word, signal.SIG_IGN)
    if forked is not None:
        forked[0].close()
        die_with_parent(forked[1])
        gc.freeze()  # pages that are shared stay so
    stand_back(niceness)
    compile_all()
    with threadpool_limits(1, "blas"), end, suppress(OSError):
        while (message := _read(end)) is not None:
            answer = pickle.dumps(made(message), pickle.HIGHEST_PROTOCOL)
            end.sendall(_LENGTH.pack(len(answer)) + answer)


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
