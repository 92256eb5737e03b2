"""Between PX4's offboard link and a port of its own: keeps back, loses, doubles and shuffles what passes."""

from __future__ import annotations

import heapq
import math
import random
import socket
import threading
import time
from typing import NamedTuple, Self


class Manner(NamedTuple):
    """What a relay does to datagrams; each gets its own draw."""

    up_s: float = 0.0
    """Kept back on the way to PX4."""
    down_s: float = 0.0
    """And on the way from PX4."""
    jitter_s: float = 0.0
    """As much more at most, both ways: what was sent later may come sooner."""
    lost: float = 0.0
    doubled: float = 0.0
    burst_s: float = 0.0
    """Both ways what comes is kept back until the next multiple of this, as a radio that sleeps does."""
    up_cut: bool = False
    down_cut: bool = False


class Relay:
    """Passes datagrams on in its `manner`, which may be changed at any time."""

    def __init__(self, px4_port: int, manner: Manner) -> None:
        self.port = px4_port + 1000
        self.manner = manner
        self._vehicle, self._companion = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._vehicle.bind(("127.0.0.1", px4_port))
        self._companion.bind(("127.0.0.1", 0))
        self._vehicle.settimeout(0.0)
        self._companion.settimeout(0.0)
        self._draw = random.Random(1)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()
        self._vehicle.close()
        self._companion.close()

    def _run(self) -> None:
        waiting: list[tuple[float, int, bool, bytes]] = []
        px4, count = None, 0
        while not self._stop.is_set():
            time.sleep(0.0005)
            for upwards, sock in ((False, self._vehicle), (True, self._companion)):
                while (got := _next(sock)) is not None:
                    px4 = px4 if upwards else got[1]
                    for due_s in self._due(upwards):
                        count += 1
                        heapq.heappush(waiting, (due_s, count, upwards, got[0]))
            while waiting and waiting[0][0] <= time.monotonic():
                _, _, upwards, data = heapq.heappop(waiting)
                if upwards:
                    _send(self._vehicle, data, px4)
                else:
                    _send(self._companion, data, ("127.0.0.1", self.port))

    def _due(self, upwards: bool) -> list[float]:
        """When the copies of a datagram go on; none where it is lost."""
        manner, draw = self.manner, self._draw
        if (manner.up_cut if upwards else manner.down_cut) or draw.random() < manner.lost:
            return []
        now_s = time.monotonic() + (manner.up_s if upwards else manner.down_s)
        if manner.burst_s:
            now_s = math.ceil(now_s / manner.burst_s) * manner.burst_s
        return [now_s + draw.random() * manner.jitter_s for _ in range(2 if draw.random() < manner.doubled else 1)]


def _next(sock: socket.socket) -> tuple[bytes, tuple[str, int]] | None:
    try:
        return sock.recvfrom(4096)
    except OSError:
        return None


def _send(sock: socket.socket, data: bytes, to: tuple[str, int] | None) -> None:
    if to is not None:
        try:
            sock.sendto(data, to)
        except OSError:
            return
