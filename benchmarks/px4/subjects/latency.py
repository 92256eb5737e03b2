"""The age of commands at the motors, as the companion finds it from SERVO_OUTPUT_RAW; with 10 ms more on the way."""

from __future__ import annotations

import socket
import threading
import time
from collections import deque
from statistics import mean

from benchmarks.px4.companion import fly
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import OFFBOARD_PORT, Px4

ASKED = (
    "Hover at default parameters: the latency of commands found within 2 ms of what it is (10 ms more on the way from "
    "companion to PX4 are found as such), or called unknown."
)
RUNS = 2
MORE_S, WITHIN_S = 0.010, 0.002


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` hovers straight, through a relay, and through a relay that keeps the commands back."""
    straight = [_hover(bench, None) for _ in range(runs)]
    relayed = [_hover(bench, 0.0) for _ in range(runs)]
    later = [_hover(bench, MORE_S) for _ in range(runs)]
    known = [each for each in relayed if each is not None]
    found = [each - mean(known) for each in later if each is not None and known]
    good = all(abs(each - MORE_S) <= WITHIN_S for each in found)
    return [
        Row("straight", _words(straight), None, runs),
        Row("through a relay", _words(relayed), None, runs),
        Row(f"through a relay, {1e3 * MORE_S:.0f} ms later", f"{_words(later)}; {_words(found)} more", good, runs),
    ]


def _words(latencies_s: list[float | None] | list[float]) -> str:
    return ", ".join("unknown" if each is None else f"{1e3 * each:.1f} ms" for each in latencies_s)


def _hover(bench: Bench, delay_s: float | None) -> float | None:
    with Px4(bench) as px4:
        if delay_s is None:
            flown = fly(bench, px4, "hover")
        else:
            with _Relay(OFFBOARD_PORT + px4.instance, delay_s) as relay:
                flown = fly(bench, px4, "hover", "--connect", f"udpin:127.0.0.1:{relay.port}")
    found: float | None = flown.result.get("link", {}).get("command_latency_s")
    print(f"delay {delay_s}: exit {flown.code}, {found}", flush=True)
    return found


class _Relay:
    """Between PX4's offboard link and a port of its own; what the companion sends waits for `delay_s`."""

    def __init__(self, px4_port: int, delay_s: float) -> None:
        self.port = px4_port + 1000
        self._delay_s = delay_s
        self._vehicle, self._companion = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._vehicle.bind(("127.0.0.1", px4_port))
        self._companion.bind(("127.0.0.1", 0))
        self._vehicle.settimeout(0.0)
        self._companion.settimeout(0.0)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> _Relay:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()
        self._vehicle.close()
        self._companion.close()

    def _run(self) -> None:
        waiting: deque[tuple[float, bytes]] = deque()
        px4 = None
        while not self._stop.is_set():
            time.sleep(0.0005)
            while (got := _next(self._vehicle)) is not None:
                data, px4 = got
                _send(self._companion, data, ("127.0.0.1", self.port))
            while (got := _next(self._companion)) is not None:
                waiting.append((time.monotonic() + self._delay_s, got[0]))
            while waiting and waiting[0][0] <= time.monotonic():
                _send(self._vehicle, waiting.popleft()[1], px4)


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
