"""One MAVLink link of the simulated vehicle and what belongs to it: its streams, its transfers, who listens."""

from __future__ import annotations

from typing import Final

from flightstack_sim.autopilot.notices import Notice
from flightstack_sim.autopilot.params import Params
from flightstack_sim.autopilot.requests import NEVER
from flightstack_sim.plan_transfer import PlanTransfer
from flightstack_sim.plans import Plans
from flightstack_sim.protocols import ParameterList
from flightstack_sim.streams import LinkKind, LinkStreams
from mavlink_bridge import messages as m
from mavlink_bridge.link import Link

TEXT_CHUNK: Final = 50
PARAMS_PER_TICK: Final = 4


class Port:
    """A link; mutable."""

    __slots__ = ("gcs_at_us", "link", "parameters", "plans", "streams", "synced_us", "text_id")

    def __init__(self, kind: LinkKind, system: int, plans: Plans) -> None:
        self.link = Link(system, 1)
        self.streams = LinkStreams(kind)
        self.parameters = ParameterList()
        self.plans = PlanTransfer(plans)
        self.gcs_at_us = NEVER
        self.text_id = 0
        self.synced_us: int | None = None
        """When the last TIMESYNC that the client has answered was sent; None before it answered any."""

    def has_gcs(self, now_us: int, params: Params) -> bool:
        """Whether a ground station has been heard lately."""
        return now_us - self.gcs_at_us < params.get("COM_DL_LOSS_T") * 1e6

    def send_parameters(self, params: Params) -> None:
        """Some more of the parameters that were asked for."""
        if self.parameters.running:
            for item in self.parameters.take(params, PARAMS_PER_TICK):
                self.link.send(item)

    def tell(self, notice: Notice, event: m.Event | None, now_us: int, params: Params) -> None:
        """An EVENT in any case, a text to who hears from a ground station."""
        if notice.text and self.has_gcs(now_us, params):
            self._send_text(notice)
        if event is not None:
            self.link.send(event)

    def _send_text(self, notice: Notice) -> None:
        """A STATUSTEXT in chunks of 50."""
        self.text_id = self.text_id % 0xFFFF + 1
        for number in range(0, max(1, len(notice.text)), TEXT_CHUNK):
            chunk = notice.text[number : number + TEXT_CHUNK]
            self.link.send(m.Statustext(notice.severity, chunk, self.text_id, number // TEXT_CHUNK))
