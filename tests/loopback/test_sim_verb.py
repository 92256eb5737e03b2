"""`flightstack sim` as a program: several vehicles, another place, signals at any time."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pymavlink import mavutil

from flightstack.cli.main import main
from flightstack_logs.reader import read
from tests.simulator import ENVIRONMENT, HOST, free_ports

ENDS_WITHIN_S = 1.0
MOST_TO_END_S = 0.4
"""Of processor time, which a busy machine does not change."""


def processor_time_s(process: subprocess.Popen[str]) -> float:
    """Seconds so far, from the system's own count."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def run(*words: object) -> int:
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    code = end.value.code
    assert isinstance(code, int)
    return code


def ignore_ctrl_c() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def start(*words: object, **more: str) -> subprocess.Popen[str]:
    """In a shell's background: Ctrl-C is ignored from the beginning."""
    return subprocess.Popen(
        [sys.executable, "-m", "flightstack", "sim", *map(str, words)],
        env=ENVIRONMENT | more, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        preexec_fn=ignore_ctrl_c,
    )  # fmt: skip


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_within_a_second_while_it_compiles_in_the_background(
    tmp_path: Path, number: signal.Signals
) -> None:
    port, gcs_port = free_ports()
    sim = start("--port", port, "--gcs-port", gcs_port, NUMBA_CACHE_DIR=str(tmp_path))
    with sim:
        assert sim.stdout is not None
        assert "compiling" in sim.stdout.readline()
        began = time.monotonic()
        sim.send_signal(number)
        assert sim.wait(10.0) == 130
        assert time.monotonic() - began < ENDS_WITHIN_S
        assert "Traceback" not in sim.stdout.read()


def test_instances_have_px4s_ports_and_ids_a_taken_one_is_left_out_and_all_end_with_ctrl_c(tmp_path: Path) -> None:
    port, gcs_port = free_ports()
    clients = {i: mavutil.mavlink_connection(f"udpin:{HOST}:{port + i}") for i in (0, 2)}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind((HOST, port + 41))
        log, json_file = tmp_path / "flight.mcap", tmp_path / "sim.json"
        home = ("--home", "-33.5,151.25,20,90")
        sim = start(
            "--port", port, "--gcs-port", gcs_port, "--instances", 3, "--sysid", 7, *home, "--log", log,
            "--log-wire", "--json", json_file,
        )  # fmt: skip
        with sim:
            assert sim.stdout is not None
            said = [sim.stdout.readline() for _ in range(3)]
            assert sum("is up" in line for line in said) == 2
            assert any(f"port {port + 41}" in line and "instance 1" in line for line in said)
            for i, client in clients.items():
                heard = client.recv_match(type="GLOBAL_POSITION_INT", blocking=True, timeout=10.0)
                assert heard.get_srcSystem() == 7 + i
                assert (heard.lat, heard.lon) == (pytest.approx(-33.5e7, abs=100), pytest.approx(151.25e7, abs=100))
                assert heard.alt == pytest.approx(20_000, abs=500)
                assert heard.hdg == pytest.approx(9_000, abs=200)
                client.mav.ping_send(0, 5, 0, 0)
                assert client.recv_match(type="PING", blocking=True, timeout=10.0) is not None
            so_far_s = processor_time_s(sim)
            sim.send_signal(signal.SIGINT)
            _, status, used = os.wait4(sim.pid, 0)
            sim.returncode = os.waitstatus_to_exitcode(status)
            assert sim.returncode == 130
            # The interpreter doesn't look through all that was compiled one last time, which took 0.6 s.
            assert used.ru_utime + used.ru_stime - so_far_s < MOST_TO_END_S
    for client in clients.values():
        client.close()
    assert [one["system"] for one in json.loads(json_file.read_text())["instances"]] == [7, 9]
    for i in (1, 3):
        recorded = read(tmp_path / f"flight-{i}.mcap")
        assert {"/truth", "/mavlink/rx", "/mavlink/tx"} <= set(recorded.tables) | set(recorded.messages)


def test_a_plan_that_is_none_gets_a_line_on_the_console_and_the_other_vehicle_flies_on() -> None:
    port, gcs_port = free_ports()
    clients = [mavutil.mavlink_connection(f"udpin:{HOST}:{port + i}", source_system=255) for i in (0, 1)]
    with start("--port", port, "--gcs-port", gcs_port, "--instances", 2, PYTHONUNBUFFERED="1") as sim:
        assert sim.stdout is not None
        assert all("is up" in sim.stdout.readline() for _ in range(2))
        for client in clients:
            assert client.recv_match(type="HEARTBEAT", blocking=True, timeout=10.0) is not None
        for _ in range(3):  # the same once more: one line
            clients[0].mav.mission_count_send(1, 1, 65_535, 0)
            assert clients[0].recv_match(type="MISSION_ACK", blocking=True, timeout=10.0).type == 4
        clients[0].mav.mission_count_send(1, 1, 1, 0)
        assert clients[0].recv_match(type="MISSION_REQUEST_INT", blocking=True, timeout=10.0).seq == 0
        clients[0].mav.mission_item_int_send(1, 1, 0, 6, 31_999, 0, 1, 0, 0, 0, 0, 0, 0, 5.0, 0)
        assert clients[0].recv_match(type="MISSION_ACK", blocking=True, timeout=10.0).type == 3
        clients[1].mav.ping_send(0, 5, 0, 0)
        assert clients[1].recv_match(type="PING", blocking=True, timeout=10.0) is not None
        sim.send_signal(signal.SIGTERM)
        said = sim.stdout.read().splitlines()
    assert [line.partition(" s: ")[2] for line in said if " s: " in line] == [
        "vehicle 1: mission, fence or rally points refused: NO_SPACE",
        "vehicle 1: IGN MISSION_ITEM: Invalid item",
    ]
    for client in clients:
        client.close()


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("--home", "47,8,488"), "LAT,LON,ALT,HEADING"),
        (("--home", "nan,8,488,0"), "latitude"),
        (("--home", "47,8,1e9,0"), "altitude"),
        (("--bind", "10.255.255.254"), "10.255.255.254"),
        (("--bind", "no.such.host.invalid"), "no.such.host"),
        (("--sysid", "254", "--instances", "3"), "255"),
        (("--instances", "0"), "instances"),
    ],
)
def test_bad_arguments_get_one_line(words: tuple[str, ...], problem: str, capsys: pytest.CaptureFixture[str]) -> None:
    port, gcs_port = free_ports()
    assert run("sim", "--port", port, "--gcs-port", gcs_port, "--duration", 0.2, *words) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("error:")
    assert problem in lines[0]
