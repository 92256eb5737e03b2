"""What becomes of a flight whose companion stood still and whose vehicle the dead-man gave to PX4's Hold.  Sans-IO.

A short stall whose Hold is the dead-man's own, touched by nobody else, is taken back: OFFBOARD again, at most once in
`AGAIN_US`.  After a longer one, or where anybody else changed the mode, the vehicle stays where it is: hands off.
"""

from __future__ import annotations

from mavlink_bridge import px4
from mavlink_bridge.dead_man_frames import NOBODY, DeadManRecord
from mavlink_bridge.vehicle_view import VehicleView

SHORT_US = 500_000
"""Stalls below this are taken back."""
AGAIN_US = 10_000_000
HOLD_EFFECTIVE_US = 150_000
"""A Hold that is not seen so long after it was sent, with OFFBOARD still reported, was lost (measured: 25 ms)."""
RETAKE_LIMIT_US = 1_000_000


class Stalls:
    """The dead-man's deeds as the companion sees them."""

    def __init__(self) -> None:
        self.report: DeadManRecord = NOBODY
        self.taken_back = 0
        """How often OFFBOARD was taken back."""
        self._known_hold_ns = 0
        self._taken_us = -AGAIN_US
        self._stall_us = self._held_us = 0
        """Of the last stall: its length, and after how long Hold was commanded."""

    def hear(self, report: DeadManRecord) -> None:
        """Take the dead-man's last word."""
        self.report = report

    @property
    def is_held(self) -> bool:
        """Whether the dead-man commanded a Hold that nothing was made of yet."""
        return bool(self.report.hold_ns) and self.report.hold_ns != self._known_hold_ns

    def own_hold(self, custom_mode: int) -> bool:
        """Whether the vehicle is in a Hold of the dead-man's that nobody else touched."""
        return bool(self.report.hold_ns) and not self.report.touched and custom_mode == px4.MODE_HOLD

    def judge(self, now_us: int) -> str:
        """After `is_held`: why the flight ends in Hold, empty where it is taken back; then it counts as known."""
        self._known_hold_ns = self.report.hold_ns
        ended_us = max(now_us, self.report.alive_ns // 1000)  # we may have been stopped after looking at the clock
        self._stall_us = ended_us - self.report.silent_ns // 1000
        self._held_us = (self.report.hold_ns - self.report.silent_ns) // 1000
        if self.report.touched:
            return "somebody else changed the mode meanwhile"
        if self._stall_us >= SHORT_US:
            return f"too long to take back (limit {1e-6 * SHORT_US:g} s)"
        if now_us - self._taken_us < AGAIN_US:
            return f"taken back {(now_us - self._taken_us) * 1e-6:.1f} s ago already"
        self._taken_us = now_us
        return ""

    @property
    def words(self) -> str:
        """The last stall that was judged, in words; what the dead-man reports since may be about another one."""
        stall_ms, held_ms = 1e-3 * self._stall_us, 1e-3 * self._held_us
        return f"no setpoint for {stall_ms:.0f} ms, the dead-man commanded Hold after {held_ms:.0f} ms"

    def hold_is_settled(self, view: VehicleView) -> bool:
        """Whether OFFBOARD may be commanded: Hold has been seen."""
        seen_us = self.report.hold_ns // 1000
        return bool(self.report.held_ns) or (view.mode_at_us > seen_us and view.custom_mode == px4.MODE_HOLD)

    def hold_was_lost(self, view: VehicleView) -> bool:
        """Whether the vehicle is still in OFFBOARD although Hold was commanded."""
        late_us = self.report.hold_ns // 1000 + HOLD_EFFECTIVE_US
        return not self.report.held_ns and view.in_offboard and view.mode_at_us > late_us
