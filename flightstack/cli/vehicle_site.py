"""What a vehicle says of its site before a flight: where it is on the globe, and the fence that is stored in it."""

from __future__ import annotations

import json
import math
import tempfile
from contextlib import closing
from pathlib import Path

import numpy as np

from flightstack.barrier.estimate_bounds import EstimateBounds, contradiction
from flightstack.cli.site import read_site
from flightstack.geodesy import LocalFrame
from flightstack.types import InputError
from flightstack_sim.fence import Shape, shapes_of
from flightstack_sim.plans import FENCE, Item
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.link import Link, Received
from mavlink_bridge.transport.address import framing_for, open_address, parse_address
from mavlink_bridge.transport.clock import monotonic_us
from mavlink_bridge.vehicle_view import VehicleView

STORED = Path("vehicle")
"""`--site vehicle`: the fence that is stored in the vehicle."""
_AGAIN_US = 300_000
CARRIED_M = 3.0
"""What an estimate with GPS may wander while the vehicle stands."""
_KEPT: list[tempfile.TemporaryDirectory[str]] = []
"""Files of stored fences, for as long as the program runs."""


class Questions:
    """Where a vehicle is, and where asked for its fence; sans-IO."""

    def __init__(self, link: Link, *, fence: bool) -> None:
        self.link = link
        self.place: tuple[float, float] | None = None
        """Latitude, longitude."""
        self._items: dict[int, Item] = {}
        self._count = None if fence else 0
        self._system, self._asked_us = 0, -_AGAIN_US

    @property
    def is_answered(self) -> bool:
        """Nothing is open."""
        return self.place is not None and self._count is not None and len(self._items) >= self._count

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Of the stored fence."""
        return shapes_of(tuple(self._items[i] for i in sorted(self._items)))

    def take(self, received: Received, now_us: int) -> None:
        """A message of the vehicle."""
        message = received.message
        if isinstance(message, m.Heartbeat) and message.autopilot == px4.AUTOPILOT_PX4:
            self._system = received.system
        elif isinstance(message, m.GlobalPositionInt):
            self.place = message.lat_deg, message.lon_deg
        elif isinstance(message, m.MissionCount) and message.mission_type == FENCE:
            self._count, self._asked_us = message.items, -_AGAIN_US
        elif isinstance(message, m.MissionItemInt) and message.mission_type == FENCE:
            *params, x, y, z = message.params
            one, two, three, four = params
            place = 1e-7 * x, 1e-7 * y, float(z)
            item = Item(message.frame, message.command, message.autocontinue, (one, two, three, four), *place)
            self._items[message.seq], self._asked_us = item, -_AGAIN_US
            if self._count is not None and len(self._items) >= self._count:
                self.link.send(m.MissionAck(self._system, px4.COMPONENT_AUTOPILOT, 0, FENCE))

    def step(self, now_us: int) -> None:
        """Ask what is not known yet."""
        if now_us - self._asked_us < _AGAIN_US:
            return
        self._asked_us = now_us
        if not self._system:
            self.link.send(m.Heartbeat(px4.TYPE_ONBOARD_CONTROLLER, 8, 0, 0, 4))
        elif self._count is None:
            self.link.send(m.MissionRequestList(self._system, px4.COMPONENT_AUTOPILOT, FENCE))
        elif len(self._items) < self._count:
            missing = next(i for i in range(self._count) if i not in self._items)
            self.link.send(m.MissionRequestInt(self._system, px4.COMPONENT_AUTOPILOT, missing, FENCE))


def carried(view: VehicleView, laid_round: tuple[float, float] | None) -> str:
    """Why a vehicle on the ground no longer stands where its site on the globe was laid out round (None: it has none),
    which goes with it; empty where it does."""
    if laid_round is None or view.place is None or view.armed:
        return ""
    away_m = math.hypot(*LocalFrame(*laid_round, 0.0).to_local(*view.place))
    return (
        f"the vehicle was carried {away_m:.1f} m since its site was laid out; start anew" if away_m > CARRIED_M else ""
    )


def unknowing(view: VehicleView, bounds: EstimateBounds | None, sensors: str) -> str:
    """What a vehicle on the ground says of itself against the sensors that its site's margins are for, one line."""
    if bounds is None or view.armed:
        return ""
    said = contradiction(bounds, sensors, view.accuracy_m, np.zeros(3))
    return said and f"{said}; name the sensors that it has with --sensors"


def as_plan(shapes: tuple[Shape, ...]) -> str:
    """A stored fence as QGroundControl writes one."""
    polygons, circles = [], []
    for shape in shapes:
        if len(shape.corners_deg) == 1:
            circle = {"center": shape.corners_deg[0], "radius": shape.radius_m}
            circles.append({"inclusion": shape.inside, "circle": circle})
        else:
            polygons.append({"inclusion": shape.inside, "polygon": shape.corners_deg})
    return json.dumps({"fileType": "Plan", "geoFence": {"polygons": polygons, "circles": circles}})


def ask_vehicle(site: Path, connect: str, within_s: float) -> tuple[Path, tuple[float, float] | None]:
    """A site's file, and latitude and longitude of the vehicle where the site is on the globe (None: not told in time).

    `STORED` is read from the vehicle into a file; InputError where it stores no fence.
    """
    stored = site == STORED and not site.exists()
    if not stored and not read_site(site).is_global:
        return site, None
    address = parse_address(connect)
    questions = Questions(Link(240, 191, framing=framing_for(address)), fence=stored)
    with closing(open_address(address)) as transport:
        until_us = monotonic_us() + int(1e6 * within_s)
        while (now_us := monotonic_us()) < until_us and not questions.is_answered:
            transport.wait(0.05)
            for data in transport.receive_all():
                questions.link.receive_datagram(data, now_us)
            for received in questions.link.take_events():
                questions.take(received, now_us)
            questions.step(now_us)
            for data in questions.link.datagrams_to_send():
                transport.send(data)
    if stored:
        if not questions.shapes:
            raise InputError(f"--site vehicle: the vehicle at {connect} told of no stored fence within {within_s:g} s")
        _KEPT.append(tempfile.TemporaryDirectory(prefix="flightstack-"))
        site = Path(_KEPT[-1].name) / "vehicle.plan"
        site.write_text(as_plan(questions.shapes), encoding="utf-8")
    return site, questions.place
