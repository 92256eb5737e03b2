"""`flightstack sim` in a process of its own, for clients that nobody here wrote."""

from __future__ import annotations

import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest

HOST = "127.0.0.1"
TOO_LATE_S = 0.02
"""A bare loop that is this late leaves nobody the 8 ms that a flight in real time has to spare."""
SPEED = 4
SIM_ENDS_AFTER_S = 600.0
"""Of simulated time: the simulator ends by itself should nobody stop it."""
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "PYTHONUNBUFFERED": "1"}


def free_ports() -> tuple[int, int]:
    """A port to hear the simulator on, whose neighbour 40 above (the simulator's own) is free too, and another."""
    while True:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one, socket.socket(
            socket.AF_INET, socket.SOCK_DGRAM
        ) as other, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:  # fmt: skip
            one.bind((HOST, 0))
            ground.bind((HOST, 0))
            port = int(one.getsockname()[1])
            try:
                other.bind((HOST, port + 40))
            except (OSError, OverflowError):
                continue
            return port, int(ground.getsockname()[1])


def free_tcp_pair() -> int:
    """A TCP port that is free, as is the next one."""
    while True:
        with socket.create_server((HOST, 0)) as one:
            port = int(one.getsockname()[1])
            try:
                with socket.create_server((HOST, port + 1)):
                    return port
            except (OSError, OverflowError):
                continue


@contextmanager
def watching(port: int, every_s: float = 0.03) -> Iterator[list[dict[str, Any]]]:
    """What the page of `--live=PORT` would show, looked at every `every_s` while inside."""
    seen: list[dict[str, Any]] = []
    over = threading.Event()

    def watch() -> None:
        while not over.wait(every_s):
            try:
                with closing(http.client.HTTPConnection(HOST, port + 1, timeout=2.0)) as connection:
                    connection.request("GET", "/state")
                    with connection.getresponse() as answer:
                        seen.append(json.loads(answer.read()))
            except (OSError, http.client.HTTPException):
                continue  # nobody is there yet, or any more

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield seen
    finally:
        over.set()
        watcher.join(10.0)


@contextmanager
def simulator(port: int, gcs_port: int, *more: str, speed: float = SPEED) -> Iterator[None]:
    """Up and running inside; `more` goes to its command line."""
    command = [sys.executable, "-m", "flightstack", "sim", "--port", port, "--gcs-port", gcs_port]
    command += ["--speed", speed, "--duration", SIM_ENDS_AFTER_S, *more]
    with subprocess.Popen(
        [str(word) for word in command],
        env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    ) as sim:  # fmt: skip
        try:
            assert sim.stdout is not None
            said = ""
            for line in sim.stdout:
                said += line
                if "is up" in line:
                    break
            assert "is up" in said, said
            yield
        finally:
            sim.send_signal(signal.SIGINT)
            try:
                sim.wait(10.0)
            finally:
                sim.kill()


@contextmanager
def bare_loop() -> Iterator[list[float]]:
    """By how much a loop that does nothing but wait 4 ms was late at worst while inside, s: what this machine gives."""
    worst_s, over = [0.0], threading.Event()

    def wait() -> None:
        due_s = time.monotonic()
        while not over.is_set():
            due_s = max(due_s + 0.004, time.monotonic())
            over.wait(due_s - time.monotonic())
            worst_s[0] = max(worst_s[0], time.monotonic() - due_s)

    waiter = threading.Thread(target=wait)
    waiter.start()
    try:
        yield worst_s
    finally:
        over.set()
        waiter.join(10.0)


def skip_where_too_busy(said: str, bare_s: list[float]) -> None:
    """Skip a test in real time whose flight ended for lack of time, where a bare loop beside it had none either."""
    if bare_s[0] > TOO_LATE_S and any(
        reason in said for reason in ("overrun", "link too slow", "stalled-long", "stale-")
    ):
        pytest.skip(
            f"this machine is too busy ({1e3 * bare_s[0]:.0f} ms late with nothing to do): {said.splitlines()[-1]}"
        )
