"""tshark with a dissector generated from MAVLink's own XML reads every frame that the simulator sends as it was meant.

`make decoder`: needs tshark (Debian's package of that name).  The frames go into a capture file; every field of every
message of the dialect is compared.  Messages that pymavlink's XML lacks are named and left out.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pymavlink.dialects.v20 as dialects
import pytest

from flightstack.vehicle import parse_vehicle
from flightstack_sim.grade import load_grade
from flightstack_sim.server import Server
from flightstack_sim.simulated_vehicle import simulated_vehicle
from mavlink_bridge import messages as m
from mavlink_bridge.codec import Row
from mavlink_bridge.layout import EXTENSIONS, LACKING
from mavlink_bridge.link import Link

pytestmark = pytest.mark.client

ROOT = Path(__file__).resolve().parents[2]
USER0 = 147
"""Link type of the capture: the generated dissector takes it for bare MAVLink."""
ASKED = (148, 300, 242, 24, 253, 115, 49, 26, 375, 24, 264, 436, 435)


class Told(Link):
    """A link that remembers the messages beside their frames."""

    def __init__(self, link: Link) -> None:
        self.frames: list[tuple[Any, bytes]] = []
        self._link, self._send = link, link.send
        link.send = self._sent  # type: ignore[method-assign]

    def _sent(self, message: Any, *, component: int | None = None) -> None:
        self._send(message, component=component)
        self.frames.append((message, self._link._outgoing[-1]))


def _flight() -> list[tuple[Any, bytes]]:
    """Everything that was sent on both links in a flight: boot, questions, take-off, orbit, failsafe, landing."""
    vehicle = parse_vehicle((ROOT / "flightstack/data/vehicles" / "quad-x.toml").read_text(), "quad-x.toml")
    server = Server(simulated_vehicle(vehicle, vehicle, load_grade("gps"), seed=1))
    told = [Told(server.link(0)), Told(server.link(1))]
    client = Link(245, 190)
    nan = (math.nan,) * 6

    def say(*sent: Any) -> None:
        for message in sent:
            client.send(message)
        for data in client.datagrams_to_send():
            server.receive(0, data)
            server.receive(1, data)

    def run(seconds: float) -> None:
        for _ in range(round(250 * seconds)):
            server.advance(4)
            server.datagrams(0), server.datagrams(1)

    run(5.0)
    say(m.Heartbeat(6, 8, 0, 0, 4), m.ParamRequestList(1, 1), m.Ping(1, 1, 0, 0), m.Timesync(0, 5, 1, 1))
    say(*(m.CommandLong(1, 1, 512, 0, (float(number), 0.0, *nan[:5])) for number in ASKED))
    say(m.MissionRequestList(1, 1, 0), m.ParamRequestRead(1, 1, "NO_SUCH", -1))
    say(m.CommandLong(1, 1, 400, 0, (1.0, *nan)), m.CommandLong(1, 1, 22, 0, (math.nan, *nan)))
    run(6.0)
    lat, lon = round(server.view.frame.latitude_deg * 1e7), round(server.view.frame.longitude_deg * 1e7)
    say(m.CommandInt(1, 1, 5, 34, 0, 0, (4.0, 2.0, 0.0, math.nan, lat, lon, 494.0)))
    run(3.0)
    say(m.CommandLong(1, 1, 21, 0, (math.nan, *nan)))
    run(7.0)
    return told[0].frames + told[1].frames


def _capture(frames: list[bytes]) -> bytes:
    packets = [struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, USER0)]
    for number, frame in enumerate(frames):
        packets.append(struct.pack("<IIII", number // 1000, number % 1000, len(frame), len(frame)) + frame)
    return b"".join(packets)


def _decoded(frames: list[bytes], folder: Path) -> list[dict[str, list[str]]]:
    """Field name -> values as tshark prints them, frame by frame."""
    xml = Path(next(iter(dialects.__path__))) / "development.xml"
    lua, capture = folder / "mavlink", folder / "flight.pcap"
    generator = [sys.executable, "-m", "pymavlink.tools.mavgen", "--lang", "WLua", "--wire-protocol", "2.0"]
    subprocess.run([*generator, "-o", str(lua), str(xml)], check=True, capture_output=True)
    capture.write_bytes(_capture(frames))
    done = subprocess.run(
        ["tshark", "-X", f"lua_script:{lua}.lua", "-r", str(capture), "-T", "json", "--no-duplicate-keys"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return [_leaves(packet["_source"]["layers"]) for packet in json.loads(done.stdout)]


def _leaves(tree: Any) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}

    def walk(node: Any, name: str) -> None:
        if isinstance(node, dict):
            for key, value in node.items():
                walk(value, key)
        elif isinstance(node, list):
            for value in node:
                walk(value, name)
        else:
            found.setdefault(name.removeprefix("mavlink_proto."), []).append(node)

    walk(tree, "")
    return found


def _wire_values(row: Row, message: Any) -> dict[str, tuple[float, float]]:
    """What each numeric field shall be on the wire, from the message's SI values and the row's units; and the unit."""
    known = {field.name: field for field in row.layout.fields}
    values: dict[str, tuple[float, float]] = {}
    for name, source in row.wires.items():
        value = getattr(message, name)
        flat = value if isinstance(value, tuple) else (value,)
        fields = [(part, known[part]) for part in source.names]
        places = [
            (part if not field.length else f"{part}_{index}", field)
            for part, field in fields
            for index in range(field.elements)
        ]
        if any(field.is_bytes for _, field in fields):
            continue
        for (place, field), number in zip(places, flat, strict=True):
            if isinstance(number, float) and math.isnan(number) and source.unknown is not None:
                values[place] = source.unknown, 1.0
            elif source.per:
                low, high = field.integer_range
                values[place] = min(max(number * source.per, low), high), source.per
            elif place == "param_value":  # this row keeps the float's bits
                values[place] = m.param_value(number, m.PARAM_REAL32), 1.0
            else:
                values[place] = number / source.times, 1.0
    return values


def _same(ours: float, per: float, theirs: str) -> bool:
    """As printed: six digits of a float; whole numbers may have been rounded either way.

    Where the XML has a multiplier ("unitless * 100"), the dissector prints the field divided by it.
    """
    number = float(int(theirs, 16) if theirs.startswith("0x") else theirs)
    if math.isnan(ours):
        return math.isnan(number)
    return any(
        number * unit == ours or abs(number * unit - ours) <= max(1.0 if per != 1.0 else 0.0, 1e-5 * abs(ours))
        for unit in (1.0, per)
    )


@pytest.mark.skipif("FLIGHTSTACK_DECODER" not in os.environ, reason="its own target: make decoder")
@pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed: apt-get install tshark")
def test_tshark_reads_every_frame_as_it_was_meant(tmp_path: Path) -> None:
    sent = [(message, frame) for message, frame in _flight()]
    readable = [(a, b) for a, b in sent if m.BY_EVENT[type(a)].name not in LACKING]
    decoded = _decoded([frame for _, frame in readable], tmp_path)
    assert len(decoded) == len(readable) > 5000
    compared: dict[str, int] = {}
    for (message, frame), fields in zip(readable, decoded, strict=True):
        row = m.BY_EVENT[type(message)]
        assert fields["msgid"] == [str(row.id)], row.name
        assert [int(fields[key][0]) for key in ("sysid", "compid", "sequence")] == [frame[5], frame[6], frame[4]]
        later = EXTENSIONS.get(row.name, "")  # fields that pymavlink's XML doesn't have yet
        for name, (ours, per) in _wire_values(row, message).items():
            key = f"{row.name}_{name}"
            if key not in fields:
                assert name in later or ours == 0.0, key
                continue
            assert _same(ours, per, fields[key][0]), (key, ours, fields[key])
            compared[row.name] = compared.get(row.name, 0) + 1
    assert len(compared) > 35
    left_out = {m.BY_EVENT[type(message)].name for message, _ in sent} & set(LACKING)
    print(f"{len(readable)} frames, {sum(compared.values())} fields of {len(compared)} messages; left out: {left_out}")
