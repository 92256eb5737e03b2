"""The dead-man's process: shared memory, the flight's socket, a clock and `mavlink_bridge.dead_man`; nothing else.

Started by `transport.dead_man` with the isolated interpreter (no site packages), in a session of its own: Ctrl-C and
what ends the companion don't reach it.  Its standard input is the lifeline: it first carries the signing key, and its
end says that the companion is gone.
"""

from __future__ import annotations

import gc
import os
import select
import signal
import sys
import time

_LEAST_WAIT_MS = 1
_MOST_READ = 65_536
_MOST_DATAGRAMS = 4_096


def main(package: str, memory_fd: int, link_fd: int, key_size: int) -> None:
    """Serve until the companion wants no more of it, or is gone and its silence answered."""
    sys.path[:] = [*sys.path, package]
    import mmap

    from mavlink_bridge import dead_man_frames as frames
    from mavlink_bridge.dead_man import DeadMan
    from mavlink_bridge.transport.machine import lock_memory, raise_priority

    for word in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP):
        signal.signal(word, signal.SIG_IGN)  # the companion's business; it ends this process when it has landed
    raise_priority()
    memory = memoryview(mmap.mmap(memory_fd, frames.SHARED_SIZE))
    key = _exactly(0, key_size) if key_size else None
    link = _Link(link_fd)
    dead_man = DeadMan(key, stream=link.is_stream)
    lock_memory()
    gc.freeze()
    gc.disable()
    poll = select.poll()
    poll.register(0, select.POLLIN | select.POLLHUP)
    gone = False
    while not memory[frames.QUIT_AT]:
        companion = frames.CompanionRecord._make(frames.load(memory, frames.COMPANION_AT, frames.COMPANION_STRUCT))
        received = link.receive() if dead_man.reading else []
        for data in dead_man.step(time.monotonic_ns(), companion, received):
            link.send(data, companion.peer_host, companion.peer_port)
        frames.store(memory, frames.DEAD_MAN_AT, frames.DEAD_MAN_STRUCT, dead_man.record)
        if gone and dead_man.is_over(companion):
            return
        wait_ms = max(_LEAST_WAIT_MS, (dead_man.wake_ns - time.monotonic_ns()) / 1e6)
        if gone:
            time.sleep(wait_ms / 1e3)
        elif poll.poll(wait_ms) and not os.read(0, 64):
            gone = True


class _Link:
    """The socket or serial line that the companion holds, too; never blocks, never raises."""

    def __init__(self, fd: int) -> None:
        import _socket
        from stat import S_ISSOCK

        self._fd = fd
        self.is_stream = not S_ISSOCK(os.fstat(fd).st_mode)
        self._socket = None if self.is_stream else _socket.socket(fileno=fd)
        self._dont_wait = _socket.MSG_DONTWAIT

    def receive(self) -> list[bytes]:
        """Everything that has arrived."""
        found: list[bytes] = []
        try:
            while len(found) < _MOST_DATAGRAMS:
                if self._socket is not None:
                    found.append(self._socket.recv(_MOST_READ, self._dont_wait))
                elif data := os.read(self._fd, _MOST_READ):
                    found.append(data)
                else:
                    break
        except OSError:
            pass
        return found

    def send(self, data: bytes, host: int, port: int) -> None:
        """Send a frame to an IPv4 address; what can't go is lost."""
        try:
            if self._socket is None:
                os.write(self._fd, data)
            elif host:
                peer = (".".join(map(str, host.to_bytes(4, "big"))), port)
                self._socket.sendto(data, self._dont_wait, peer)
            else:
                self._socket.send(data, self._dont_wait)
        except OSError:
            pass


def _exactly(fd: int, size: int) -> bytes:
    data = b""
    while len(data) < size and (piece := os.read(fd, size - len(data))):
        data += piece
    return data


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:5]))
