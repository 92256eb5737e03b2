"""Who looks on while the companion flies: observers are told, a planner may change the mission."""

from __future__ import annotations

from typing import Protocol

from flightstack.mission import Mission
from flightstack.types import TickRecord


class Observer(Protocol):
    """Who wants to know (the log, the progress bar).  Called inside the tick: must be quick and must not raise."""

    def on_event(self, t_us: int, name: str, text: str, severity: str) -> None:
        """A transition, a change of mode, a text of the vehicle; `t_us` in the vehicle's time."""

    def on_tick(self, record: TickRecord) -> None:
        """One tick of the stack."""

    def on_message(self, t_us: int, message: object) -> None:
        """A message of the identified vehicle, at vehicle time `t_us`; or several at once (`frequent.Heard`)."""


class MissionPlanner(Protocol):
    """Who changes the mission while it is flown."""

    def step(self, mission: Mission, t_s: float, record: TickRecord) -> Mission:
        """The mission from here on, after a tick at mission time `t_s`; mostly the same one."""
