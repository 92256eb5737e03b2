"""The verb `shield` as a process whose program comes back from another port and whose vehicle restarts."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from pymavlink.dialects.v20 import common
from simulator import ENVIRONMENT, HOST, free_ports, simulator

SITE = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = 6.0
inside = [[-30.0, -20.0], [30.0, -20.0], [30.0, 20.0], [-30.0, 20.0]]
"""
LONG_S = 90.0
"""To be ready on a busy machine that has to compile first."""


@contextmanager
def shielding(folder: Path, port: int, served: int) -> Iterator[subprocess.Popen[str]]:
    """As a process that waits for a program."""
    site = folder / "field.toml"
    site.write_text(SITE)
    words = [sys.executable, "-m", "flightstack", "shield", "--connect", f"udpin:{HOST}:{port}"]
    words += ["--serve", f"udpin:{HOST}:{served}", "--site", str(site), "--json", str(folder / "shield.json")]
    with subprocess.Popen(
        words, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as shield:
        try:
            yield shield
        finally:
            shield.kill()


def answered_s(served: int, within_s: float) -> float:
    """A program on a port of its own that sends heartbeats: after how long it hears the vehicle."""
    mav, began = common.MAVLink(None, srcSystem=245), time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:
        program.settimeout(0.25)
        while time.monotonic() - began < within_s:
            program.sendto(mav.heartbeat_encode(6, 8, 0, 0, 4).pack(mav), (HOST, served))
            try:
                if program.recv(2048):
                    return time.monotonic() - began
            except (TimeoutError, ConnectionRefusedError):
                continue
    raise AssertionError(f"nothing within {within_s} s")


def test_a_program_that_restarts_is_served_and_a_vehicle_that_restarts_ends_the_shield(tmp_path: Path) -> None:
    """The first program's port was kept for good; a restarted vehicle was flown by where it had been."""
    (port, gcs_port), (served, _) = free_ports(), free_ports()
    with ExitStack() as until_the_end:
        with simulator(port, gcs_port, speed=1.0):
            shield = until_the_end.enter_context(shielding(tmp_path, port, served))
            answered_s(served, LONG_S)
            assert answered_s(served, 20.0) > 1.0  # not while the first may still speak
        with simulator(port, gcs_port, speed=1.0):
            assert shield.wait(30.0) == 1
            assert shield.stderr is not None
            said = [line for line in shield.stderr.read().splitlines() if line.startswith("error:")]
    assert len(said) == 1
    assert "the vehicle restarted" in said[0]
    result = json.loads((tmp_path / "shield.json").read_text())
    assert result["ended"] in said[0]
    assert result["ticks"] == 0
