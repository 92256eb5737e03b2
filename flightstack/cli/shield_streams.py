"""The streams that the shield flies by, kept fast: a program may ask for slower ones on the same link.  Sans-IO."""

from __future__ import annotations

import math
from typing import Any

from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.requests import CommandQueue
from mavlink_bridge.vehicle_view import VehicleView

_STREAMS = ((m.AttitudeQuaternion, 4_000), (m.LocalPositionNed, 8_000), (m.HighresImu, 4_000), (m.CurrentMode, 20_000),
            (m.ExtendedSysState, 100_000), (m.GpsRawInt, 200_000))  # fmt: skip
_NEEDED_US = {m.id_of(kind): interval_us for kind, interval_us in _STREAMS}
_AGAIN_US = 2_000_000
_SLOW_US = 30_000
_FIXES_AGAIN_US = 1_000_000
COMMAND_IDS = frozenset(map(m.id_of, (m.CommandLong, m.CommandInt)))


class ShieldStreams:
    """Of one vehicle."""

    def __init__(self, view: VehicleView, commands: CommandQueue) -> None:
        self._view, self._commands = view, commands
        self._asked_us = self._requested_us = -1_000_000_000
        self._is_slowed = False

    def note(self, command: Any) -> None:
        """A program's command: where it makes one of the streams slower than is needed, all are asked for at once."""
        if command is None or command.command != px4.Cmd.SET_MESSAGE_INTERVAL:
            return
        number, interval_us = command.params[:2]
        needed_us = _NEEDED_US.get(int(number)) if math.isfinite(number) else None
        self._is_slowed |= needed_us is not None and not 0.0 < interval_us <= needed_us

    def ask(self, now_us: int, *, lacks_place: bool, lacks_fixes: bool) -> None:
        """Before each step of the commands; `lacks_place`: where the local frame lies is not known yet;
        `lacks_fixes`: nothing is heard of the satellites any more."""
        if self._is_slowed or (lacks_fixes and now_us - self._requested_us >= _FIXES_AGAIN_US):
            self._is_slowed = False
            self._request(now_us)
        if now_us - self._asked_us < _AGAIN_US:
            return
        self._asked_us = now_us
        if lacks_place:
            for one in (m.GpsGlobalOrigin, m.HomePosition):
                self._commands.request((px4.Cmd.REQUEST_MESSAGE, (float(m.id_of(one)),)), now_us)
        if self._are_slow(now_us):
            self._request(now_us)

    def _request(self, now_us: int) -> None:
        self._requested_us = now_us
        for kind, interval_us in _STREAMS:
            what = (float(m.id_of(kind)), float(interval_us))
            self._commands.request((px4.Cmd.SET_MESSAGE_INTERVAL, what), now_us)

    def _are_slow(self, now_us: int) -> bool:
        streams, t_us = self._view.streams, self._view.clock.vehicle_us(now_us)
        oldest = min(streams.attitude_us, streams.position_us, streams.imu_us)
        return oldest < 0 or t_us - oldest > _SLOW_US or self._view.landed_state == 0
