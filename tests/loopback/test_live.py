"""`--live` from the command line: a flight is watched while it is flown, and a taken port is one line."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from flightstack.cli.main import _with_ports, main
from flightstack_logs.reader import read
from tests.simulator import HOST, free_tcp_pair, watching


def test_a_flight_is_watched_while_it_is_flown_and_its_log_is_as_ever(tmp_path: Path) -> None:
    port = free_tcp_pair()
    logs = []
    with watching(port) as seen:
        for name, more in (("a", ["--live", str(port)]), ("b", [])):
            log = tmp_path / f"{name}.mcap"
            flight = ["fly", "hover", "--duration", "1", "--no-learning", "--out", str(tmp_path), "--log", str(log)]
            with pytest.raises(SystemExit) as ended:
                main([*flight, *more])
            assert ended.value.code == 0
            logs.append(log.read_bytes())
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
