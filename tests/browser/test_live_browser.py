"""The live view: a page in a real browser and Foxglove's WebSocket, both on loopback, neither in the flight's way."""

from __future__ import annotations

import http.client
import json
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "unit"))
from log_samples import Truth, tick_record

from flightstack.types import InputError
from flightstack_logs.live.recorder import LiveRecorder
from flightstack_logs.reader import read
from flightstack_logs.scene import Scene, SceneRegion, StoppingWay
from flightstack_logs.writer import FlightLog, Recorder
from tests.simulator import HOST, free_tcp_pair

CHROMIUM = Path("/usr/bin/chromium")


@pytest.fixture
def live() -> Iterator[tuple[LiveRecorder, int]]:
    port = free_tcp_pair()
    recorder = LiveRecorder(None, port)
    yield recorder, port
    recorder.close()


def flown(recorder: LiveRecorder) -> None:
    """A moment of a flight of which everything is told."""
    rotors = np.array([[0.1, 0.1, 0.0], [-0.1, -0.1, 0.0]])
    reference = np.column_stack([np.linspace(0.0, 2.0, 50), np.zeros(50), np.full(50, -1.0)])
    box = SceneRegion("box", (1.0, 0.0, -1.0), (2.0, 1.0, 1.0))
    site = (np.array([[0.0, -5.0, -1.0], [4.0, 5.0, -1.0], [0.0, -5.0, -1.0]]),)
    recorder.scene(0, Scene(rotors, 0.1, reference_ned_m=reference, region=box, site_ned_m=site))
    recorder.scene(0, StoppingWay(np.array([[0.25, -0.5, -1.0], [0.75, -0.5, -1.0]])))
    recorder.scene(0, SceneRegion("ellipsoid", (1.0, 0.0, -1.0), (1.0, 0.5, 0.5)))
    recorder.write("/vehicle/status", 0, ("OFFBOARD", True, False))
    recorder.write("/timing", 0, (12.0, 100.0, 3))
    recorder.event(0, "phase", "track")
    recorder.event(4000, "filter", "filter: <b>engaged</b>")
    recorder.tick(tick_record(100_000, (0.25, -0.5, -1.0)))
    recorder.truth(100_000, Truth(0, (0.25, -0.5, -1.0), (1.0, 0.0, 0.0, 0.0)))


def state_of(port: int, host: str = HOST) -> tuple[int, Any]:
    connection = http.client.HTTPConnection(HOST, port + 1, timeout=5.0)
    connection.putrequest("GET", "/state", skip_host=True)
    connection.putheader("Host", f"{host}:{port + 1}")
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, json.loads(body) if answer.status == 200 else None


def upgraded(port: int) -> tuple[socket.socket, bytes]:
    """A client of Foxglove's protocol, and the first that it was told."""
    client = socket.create_connection((HOST, port), timeout=5.0)
    client.sendall(
        f"GET / HTTP/1.1\r\nHost: {HOST}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
    )
    told = b""
    while b"serverInfo" not in told:
        told += client.recv(65536)
    return client, told


@pytest.mark.browser
@pytest.mark.skipif(not CHROMIUM.exists(), reason="no browser: /usr/bin/chromium is not installed")
def test_a_browser_shows_the_flight(live: tuple[LiveRecorder, int]) -> None:
    recorder, port = live
    flown(recorder)
    command = [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=1500"]
    command += ["--window-size=1000,800", "--dump-dom", f"http://{HOST}:{port + 1}/"]
    dom = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    figures = dict(re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", dom))
    assert (figures["mode"], figures["phase"], figures["armed"]) == ("OFFBOARD", "track", "yes")
    assert figures["position N E D"] == "0.25  -0.50  -1.00"
    assert (figures["loop late"], figures["missed"], figures["thrust"]) == ("12 us", "3", "0.440")
    assert "filter: filter: &lt;b&gt;engaged&lt;/b&gt;" in dom  # a name is a text, not a tag
    page = (Path(__file__).parents[2] / "logs/flightstack_logs/live/page.html").read_text()
    assert not re.findall(r"(?:https?:)?//[a-z0-9.-]+\.[a-z]{2,}", page)  # nothing from anywhere else


def test_foxglove_is_told_the_topics_of_the_log(live: tuple[LiveRecorder, int]) -> None:
    recorder, port = live
    flown(recorder)
    client, told = upgraded(port)
    assert told.startswith(b"HTTP/1.1 101")
    assert b"flightstack" in told
    client.close()


def test_the_page_answers_this_machine_alone(live: tuple[LiveRecorder, int]) -> None:
    recorder, port = live
    flown(recorder)
    status, state = state_of(port)
    assert status == 200
    assert state["now"]["pos_ned_m"] == [0.25, -0.5, -1.0]
    assert state["now"]["h"] is None  # NaN is no JSON
    assert state["scene"]["certified"]["shape"] == "ellipsoid"
    assert state["scene"]["site"][0][1] == [4.0, 5.0, -1.0]
    assert state["scene"]["way"][-1] == [0.75, -0.5, -1.0]
    assert state_of(port, "elsewhere.example")[0] == 403


def test_a_taken_port_is_one_line_and_leaves_the_other_free(live: tuple[LiveRecorder, int]) -> None:
    _, port = live
    with pytest.raises(InputError, match=rf"--live: port {port + 1} .*name another") as told:
        LiveRecorder(None, port)
    assert "\n" not in str(told.value)
    free = free_tcp_pair()
    with socket.create_server((HOST, free)), pytest.raises(InputError, match=f"port {free} "):
        LiveRecorder(None, free)
    with socket.create_server((HOST, free + 1)):
        pass


def test_browsers_that_never_read_or_go_away_change_nothing(tmp_path: Path) -> None:
    """The log is byte for byte that of a flight that nobody watched."""
    logs = []
    for watched in (False, True):
        path, port = tmp_path / f"{watched}.mcap", free_tcp_pair()
        log = FlightLog.open(path, metadata={})
        recorder: Recorder = LiveRecorder(log, port) if watched else log
        clients = []
        if watched:
            clients = [upgraded(port)[0], socket.create_connection((HOST, port + 1))]
            clients[1].sendall(b"GET /state HTTP/1.1\r\n")  # and never goes on
        for k in range(1500):
            recorder.tick(tick_record(k * 4000))
            if watched and k == 700:
                clients[0].close()
        recorder.close()
        for client in clients:
            client.close()
        logs.append(path.read_bytes())
    assert len(read(tmp_path / "True.mcap").tables["/tick"]) == 1500
    assert logs[0] == logs[1]


def test_a_kept_connection_sees_what_is_new_and_ends_with_the_flight() -> None:
    port = free_tcp_pair()
    recorder = LiveRecorder(None, port)
    connection = http.client.HTTPConnection(HOST, port + 1, timeout=5.0)

    def asked() -> Any:
        connection.request("GET", "/state")
        return json.loads(connection.getresponse().read())

    flown(recorder)
    first = asked()
    kept = connection.sock
    recorder.scene(200_000, StoppingWay(np.array([[0.25, -0.5, -1.0], [np.nan, 0.0, -1.0]])))
    recorder.event(204_000, "mode", "HOLD")
    second = asked()
    assert connection.sock is kept
    assert first["scene"]["way"] == [[0.25, -0.5, -1.0], [0.75, -0.5, -1.0]]
    assert second["scene"] == first["scene"] | {"way": [[0.25, -0.5, -1.0], [None, 0.0, -1.0]]}
    assert second["events"] == [*first["events"], [0.204, "mode", "HOLD"]]
    recorder.close()
    with pytest.raises((http.client.HTTPException, OSError)):
        asked()
