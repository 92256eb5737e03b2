"""After the shield stood still and its dead-man gave the vehicle to PX4's Hold: OFFBOARD again, or disarmed.  Sans-IO.

OFFBOARD is taken back after a short stall whose Hold nobody else touched, as `Stalls` allows, while the program speaks.
A busy vehicle may obey that Hold only after it was taken for lost: then it is taken back again.  Where it is not taken
back and the vehicle has not risen since it was armed, it is landed and disarmed: nobody would fly it or switch it off.
"""

from __future__ import annotations

from typing import Any

from mavlink_bridge import px4
from mavlink_bridge.requests import DISARM, CommandQueue, set_mode
from mavlink_bridge.stalls import RETAKE_LIMIT_US, Stalls
from mavlink_bridge.vehicle_view import VehicleView

RISEN_M = 0.5
"""Above the place of arming; PX4 calls loud motors on the ground a flight, and its Hold then hovers there."""


class AfterStall:
    """Of one vehicle."""

    def __init__(self, view: VehicleView, commands: CommandQueue) -> None:
        self._view, self._commands = view, commands
        self.stalls = Stalls()
        """The dead-man's deeds."""
        self.since_us = -1
        """Since when OFFBOARD is being taken back; -1: it is not."""
        self.disarms = ""
        """Why the vehicle is being disarmed, in words; empty once it is."""
        self._has_risen = False
        """Since it was armed."""
        self._lines: list[str] = []

    @property
    def is_taking_back(self) -> bool:
        """OFFBOARD is being taken back."""
        return self.since_us >= 0

    def acknowledge(self, ack: Any, now_us: int) -> None:
        """Take a COMMAND_ACK to our own system: of the dead-man's commands, too."""
        self._commands.acknowledge(ack)
        if ack.command == px4.Cmd.DO_SET_MODE and ack.result == px4.Result.ACCEPTED:
            self.stalls.mode_was_granted(now_us)

    def step(self, now_us: int, *, speaks: bool, is_blind: bool, height_m: float) -> None:
        """`speaks`: the program does; `is_blind`: the vehicle's attitude is too old to fly by; `height_m`: above the
        place of arming, NaN where that is not known."""
        stalls, view = self.stalls, self._view
        self._has_risen = view.armed and (self._has_risen or not height_m < RISEN_M)
        if stalls.is_held:
            refused = stalls.judge(now_us, is_taking_back=self.is_taking_back)
            self.since_us = -1 if refused else now_us
            if self._has_risen:
                self._lines.append(f"{stalls.words}: {refused or 'OFFBOARD is taken back'}")
        elif not self.is_taking_back and speaks and stalls.is_late_hold(view.custom_mode, now_us):
            self.since_us = now_us
        if self.is_taking_back:
            self._take_back(now_us, speaks=speaks, is_blind=is_blind)
        self._switch_off(now_us)

    def look(self) -> list[str]:
        """What is to be said since the last look."""
        lines, self._lines = self._lines, []
        return lines

    def _take_back(self, now_us: int, *, speaks: bool, is_blind: bool) -> None:
        stalls, view = self.stalls, self._view
        settled, ours = stalls.hold_is_settled(view), stalls.own_hold(view.custom_mode)
        over = now_us - self.since_us > RETAKE_LIMIT_US or not speaks
        if view.in_offboard and (settled or stalls.hold_was_lost(view)):
            stalls.is_back(now_us, hold_seen=settled)
            self.since_us = -1
        elif over or (settled and not ours):
            self.since_us = -1
        elif settled and not is_blind:
            self._commands.ensure(set_mode(px4.MODE_OFFBOARD), now_us)

    def _switch_off(self, now_us: int) -> None:
        """PX4 itself refuses to be disarmed in the air, and disarms where it has landed."""
        view = self._view
        if not view.armed:
            self.disarms = ""
        if not view.armed or self._has_risen or self.is_taking_back or not self.stalls.own_hold(view.custom_mode):
            return
        if not self.disarms:
            self.disarms = f"stalled while arming: {self.stalls.words}: landed and disarmed"
            self._lines.append(self.disarms)
        self._commands.ensure(DISARM if view.on_ground else set_mode(px4.MODE_LAND), now_us)
