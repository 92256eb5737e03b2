"""The companion's end of the dead-man: starts its process, tells it of every tick, hears what it did.

Both processes hold the same socket (or serial line); in flight the companion alone reads and writes it, so that the
dead-man costs the flight no time and its death takes nothing away.  Between them lies shared memory: no lock, no wait.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from mmap import mmap
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Protocol, final

from flightstack.types import InputError
from mavlink_bridge import dead_man_frames as frames
from mavlink_bridge.dead_man_frames import NOBODY, CompanionRecord, DeadManRecord
from mavlink_bridge.link import Link
from mavlink_bridge.signing import Signer
from mavlink_bridge.stalls import Stalls
from mavlink_bridge.transport import dead_man_process
from mavlink_bridge.transport.address import Transport
from mavlink_bridge.transport.clock import monotonic_us

_PACKAGE: Final = Path(__file__).resolve().parents[2]
_READY_S: Final = 5.0
_ENDS_WITHIN_S: Final = 1.0
_LOOK_TICKS: Final = 25
_STILL_US: Final = 500_000
"""It wakes every 50 ms at least; whoever has not for so long answers nobody's silence."""
_STILL_LOOKS: Final = 2
"""In a row: after a stall of both the companion may be the first to look."""
_AUTOPILOT: Final = 1
NO_DEAD_MAN: Final[dict[str, Any]] = {"running": False, "acted": 0, "taken_back": 0}


@final
class DeadManProcess:
    """The process while this is entered; `publish` after each tick, `read` before it."""

    def __init__(self, link_fd: int, signer: Signer | None = None) -> None:
        """link_fd: file descriptor of the socket or serial line of the flight."""
        self._link_fd, self.signer = link_fd, signer
        self._serial = 0
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> DeadManProcess:
        with tempfile.TemporaryFile() as file:
            file.truncate(frames.SHARED_SIZE)
            self._memory = memoryview(mmap(file.fileno(), frames.SHARED_SIZE))
            key = b"" if self.signer is None else self.signer.secret()
            numbers = (file.fileno(), self._link_fd, len(key))
            command = [sys.executable, "-I", "-S", dead_man_process.__file__, str(_PACKAGE), *map(str, numbers)]
            try:
                self._process = subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, pass_fds=numbers[:2],
                    start_new_session=True,
                )  # fmt: skip
                assert self._process.stdin is not None
                self._process.stdin.write(key)
                self._process.stdin.flush()
            except OSError as error:
                raise InputError(
                    f"the dead-man's process can't be started ({error}): fly with --no-dead-man"
                ) from error
        self._await()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        process = self._process
        if process is None:
            return
        self._memory[frames.QUIT_AT] = 1
        with suppress(OSError):
            assert process.stdin is not None
            process.stdin.close()
        try:
            process.wait(_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    @property
    def pid(self) -> int:
        """Of the process."""
        assert self._process is not None
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        """Whether the process is gone; reaps it, costs a system call."""
        return self._process is None or self._process.poll() is not None

    def publish(self, record: CompanionRecord) -> None:
        """Tell the dead-man of a tick; its `serial` is set here."""
        self._serial += 1
        frames.store(self._memory, frames.COMPANION_AT, frames.COMPANION_STRUCT, record._replace(serial=self._serial))

    def read(self) -> DeadManRecord:
        """What it did last."""
        return DeadManRecord._make(frames.load(self._memory, frames.DEAD_MAN_AT, frames.DEAD_MAN_STRUCT))

    def _await(self) -> None:
        """Return once it is there; InputError where it does not come."""
        deadline = time.monotonic() + _READY_S
        while self.read() == NOBODY:
            if self.has_ended or time.monotonic() > deadline:
                self.__exit__(None, None, None)
                raise InputError("the dead-man's process does not start: fly with --no-dead-man, COM_OF_LOSS_T <= 0.5")
            time.sleep(0.001)


class SetpointSource(Protocol):
    """Whoever streams setpoints: a companion, or the shield's router."""

    link: Link

    @property
    def stalls(self) -> Stalls:
        """What the dead-man did, and what became of it."""
        ...

    def hear_dead_man(self, report: DeadManRecord, ended: str = "") -> None:
        """Take what the dead-man did of late; `ended`: why there is none any more."""
        ...

    def last_word(self, sent_us: int) -> CompanionRecord:
        """What the dead-man has to know if nothing follows; `sent_us`: local time of what was sent last."""
        ...

    def say_last_words(self, reason: str) -> None:
        """The process is about to end, whatever the cause."""
        ...


class DeadManWatch:
    """Who commands, and the dead-man beside: `hear` before each step, `tell` once its words have gone out."""

    def __init__(self, process: DeadManProcess, companion: SetpointSource, transport: Transport) -> None:
        self._process, self._companion, self._transport = process, companion, transport
        self._acts = self._ticks = self._still = 0
        self.ended = ""
        """Why there is none any more; empty while there is."""
        self.report = NOBODY
        """What it did last, as of the last `hear`."""
        self._peer: tuple[tuple[str, int] | None, int] = (None, 0)
        self._signer = process.signer

    def summary(self) -> dict[str, Any]:
        """What became of it, for the flight's result."""
        return {"running": not self.ended, "acted": self._acts, "taken_back": self._companion.stalls.taken_back}

    def hear(self) -> None:
        """What the dead-man did of late; now and then, whether it is there at all."""
        report = self.report = self._process.read()
        if report.acts != self._acts:
            self._acts = report.acts
            link = self._companion.link
            link.skip_sequence(report.sequence, link.component)
        self._ticks += 1
        if not self.ended and self._ticks % _LOOK_TICKS == 0:
            self._still = self._still + 1 if monotonic_us() - report.alive_ns // 1000 > _STILL_US else 0
            if self._process.has_ended:
                self.ended = "the dead-man's process has ended"
            elif self._still >= _STILL_LOOKS:
                self.ended = "the dead-man's process stands still"
        self._companion.hear_dead_man(report, self.ended)

    def tell(self) -> None:
        """What has gone out."""
        record = self._companion.last_word(monotonic_us())
        peer = getattr(self._transport, "peer", None)
        if peer is not self._peer[0]:
            self._peer = (peer, 0 if peer is None else _ipv4(peer[0]))
        if self._peer[1]:
            record = record._replace(peer_host=self._peer[1], peer_port=self._peer[0][1])  # type: ignore[index]
        if self._signer is not None:
            heard = self._signer.newest_of(record.system, _AUTOPILOT)
            record = record._replace(next_stamp=self._signer.next_stamp, heard_stamp=heard)
        self._process.publish(record)


def _ipv4(host: str) -> int:
    """A dotted address as a number, 0 where it is none."""
    try:
        return int.from_bytes(bytes(map(int, host.split("."))), "big")
    except ValueError:
        return 0
