"""What the companion hears: the vehicle's messages into its view, everybody else's into who is on the link."""

from __future__ import annotations

import math
from typing import Any

from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.decide import Situation
from mavlink_bridge.frequent import FrequentReader, Heard, Taking
from mavlink_bridge.link import Link, Received
from mavlink_bridge.onlookers import Observer
from mavlink_bridge.voice import Voice
from mavlink_bridge.watchdogs import Watchdogs

_ANSWERS = (m.CommandAck, m.Timesync)
_MODES = (m.Heartbeat, m.CurrentMode)
_RARE = frozenset({*_ANSWERS, *_MODES, m.Statustext, m.ParamValue})
"""What is more to the companion than something to look at."""
_SAME = 1e-6
"""Share: PX4's floats have 24 bits."""
_RIVALS = (m.SetAttitudeTarget, m.SetPositionTargetLocalNed, m.SetPositionTargetGlobalInt)


class Hearing:
    """Fills `now` from the link; messages pass the watchdogs first."""

    def __init__(self, link: Link, now: Situation, watch: Watchdogs, voice: Voice, observer: Observer) -> None:
        self._link, self._now, self._watch, self._voice, self._observer = link, now, watch, voice, observer
        self._mode_seen = -1
        self._taking = Taking(now.view, watch)

    def take_all(self, t_us: int, now_us: int) -> None:
        """Everything that has arrived; vehicle and local time."""
        now, link = self._now, self._link
        if now.system == 0:
            now.unvouched = link.refused
        for received in link.take_events():
            if received.system == now.system != 0 and received.component == px4.COMPONENT_AUTOPILOT:
                self._take(received.message, t_us, now_us)
            elif received.system == link.system and received.component == link.component:
                now.rival = now.rival or "another companion is on this link (our own system and component speak)"
            elif isinstance(received.message, _RIVALS) and received.system != now.system:
                now.rival = now.rival or f"system {received.system} sends offboard setpoints on this link"
            elif now.system == 0:
                self._meet(received, t_us, now_us)
            elif isinstance(received.message, m.Heartbeat) and received.message.autopilot == px4.AUTOPILOT_PX4:
                now.foreign_system = received.system

    def _meet(self, received: Received, t_us: int, now_us: int) -> None:
        """Before anyone is identified only heartbeats of autopilots count."""
        message = received.message
        if isinstance(message, m.Heartbeat) and received.component == px4.COMPONENT_AUTOPILOT:
            self._now.system = self._voice.system = received.system
            self._link.expect_peer(received.system)
            self._link.read_runs(FrequentReader(received.system, received.component))
            self._take(message, t_us, now_us)

    def _take(self, message: Any, t_us: int, now_us: int) -> None:
        kind, view = type(message), self._now.view
        if kind is Heard:
            self._taking.take(message, now_us)
            self._observer.on_message(t_us, message)
            return
        rare = kind in _RARE
        if rare and kind in _ANSWERS and message.target_system not in (0, self._link.system):
            return  # somebody else's answer
        before = view.params.values.get(message.param_id) if kind is m.ParamValue else None
        view.update(self._watch.see(message), now_us)
        self._observer.on_message(t_us, message)
        if not rare:
            return
        if kind is m.CommandAck:
            self._now.commands.acknowledge(message)
            if message.command == px4.Cmd.DO_SET_MODE and message.result == px4.Result.ACCEPTED:
                self._now.stalls.mode_was_granted(now_us)
        elif kind is m.Statustext:
            self._observer.on_event(t_us, "statustext", message.text, "warning" if message.severity <= 4 else "info")
        elif kind is m.ParamValue:
            if before is not None and view.params.values[message.param_id] != before:
                self._parameter_changed(message.param_id, before, t_us)
            self._count_on(message, t_us)
        elif kind in _MODES and view.custom_mode != self._mode_seen:
            self._mode_seen = view.custom_mode
            self._observer.on_event(t_us, "mode", f"vehicle is in {view.mode_name}", "info")

    def _count_on(self, message: m.ParamValue, t_us: int) -> None:
        """Whether a parameter is still what certificates count on."""
        counted = self._now.config.counted.get(message.param_id)
        if counted is None or math.isclose(message.value, counted, rel_tol=_SAME, abs_tol=1e-12):
            return
        if not self._now.gains_changed:
            text = (
                f"{message.param_id} is {message.value:g} now, certificates count on {counted:g}: none holds any more"
            )
            self._observer.on_event(t_us, "parameters", text, "warning")
        self._now.gains_changed = True

    def _parameter_changed(self, name: str, before: float, t_us: int) -> None:
        """Somebody else set a parameter that was read already: PX4 tells every link."""
        params = self._now.view.params
        self._now.parameters_changed = True
        self._voice.heed(params)
        text = f"{name} is {params.values[name]:g} now, was {before:g}: set by someone else"
        self._observer.on_event(t_us, "parameters", text, "warning")
