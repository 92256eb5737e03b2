"""`--live` from the command line: a flight is watched while it is flown, and a taken port is one line."""

from __future__ import annotations

import http.client
import json
import socket
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from flightstack.cli.main import _with_ports, main
from flightstack_logs.reader import read
from tests.simulator import HOST, free_tcp_pair


def watch(port: int, seen: list[dict[str, Any]], over: threading.Event) -> None:
    """What the page would show, as often as it can be had."""
    while not over.is_set():
        try:
            connection = http.client.HTTPConnection(HOST, port + 1, timeout=2.0)
            connection.request("GET", "/state")
            seen.append(json.loads(connection.getresponse().read()))
            connection.close()
        except OSError:
            time.sleep(0.01)


def test_a_flight_is_watched_while_it_is_flown_and_its_log_is_as_ever(tmp_path: Path) -> None:
    port, seen, over = free_tcp_pair(), list[dict[str, Any]](), threading.Event()
    watcher = threading.Thread(target=watch, args=(port, seen, over))
    watcher.start()
    logs = []
    for name, more in (("a", ["--live", str(port)]), ("b", [])):
        log = tmp_path / f"{name}.mcap"
        flight = ["fly", "hover", "--duration", "1", "--no-learning", "--out", str(tmp_path), "--log", str(log)]
        with pytest.raises(SystemExit) as ended:
            main([*flight, *more])
        assert ended.value.code == 0
        over.set()
        logs.append(log.read_bytes())
    watcher.join(10.0)
    assert logs[0] == logs[1]
    assert {"takeoff", "track", "land"} & {state["now"].get("phase") for state in seen}
    assert any(state["path"] and state["scene"].get("region", True) for state in seen)
    assert any(state["now"].get("mode") == "OFFBOARD" for state in seen)
    with socket.create_server((HOST, port + 1)):  # it has let go
        pass
    assert read(tmp_path / "a.mcap").complete


def test_a_taken_port_is_one_line_and_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    port = free_tcp_pair()
    with socket.create_server((HOST, port + 1)), pytest.raises(SystemExit) as ended:
        main(["fly", "hover", f"--live={port}", "--out", str(tmp_path)])
    assert ended.value.code == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert f"port {port + 1}" in line


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (["fly", "--live"], ["fly", "--live=8765"]),
        (["fly", "--live", "hover"], ["fly", "--live=8765", "hover"]),
        (["fly", "--live", "9000"], ["fly", "--live", "9000"]),
        (["fly", "--live=9000"], ["fly", "--live=9000"]),
        (["fly", "hover"], ["fly", "hover"]),
    ],
)
def test_live_alone_names_its_usual_port(given: list[str], meant: list[str]) -> None:
    assert _with_ports(given) == meant
