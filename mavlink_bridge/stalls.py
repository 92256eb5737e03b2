"""What becomes of a flight whose companion stood still and whose vehicle the dead-man gave to PX4's Hold.  Sans-IO.

A short stall whose Hold is the dead-man's own, touched by nobody else, is taken back: OFFBOARD again, at most once in
`AGAIN_US`.  A stall while OFFBOARD is being taken back is part of that, as long as nobody steers for at most
`UNSTEERED_MAX_US` in all.  After a longer one, or where anybody else changed the mode, the vehicle stays where it is:
hands off.
"""

from __future__ import annotations

from mavlink_bridge import px4
from mavlink_bridge.dead_man_frames import NOBODY, DeadManRecord
from mavlink_bridge.vehicle_view import VehicleView

SHORT_US = 500_000
"""Stalls below this are taken back."""
AGAIN_US = 10_000_000
UNSTEERED_MAX_US = 1_000_000
"""A stall of 0.5 s and a take-back as long: stalls within one may last no longer."""
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
        self._asked_us = -2 * RETAKE_LIMIT_US
        """When the dead-man first asked for the Hold that it told of last."""
        self._taken_us = -AGAIN_US
        self._silent_us = 0
        """Since when nobody steers, at the last stall that was judged."""
        self._late_until_us = 0
        """A Hold that was taken for lost may be seen until then."""
        self._answered_us = 0
        """When the vehicle last said that it takes a mode that our own system asked for."""
        self._stall_us = self._held_us = 0
        """Of the last stall: its length, and after how long Hold was commanded."""

    def hear(self, report: DeadManRecord) -> None:
        """Take the dead-man's last word."""
        self.report = report
        if report.hold_ns:
            self._asked_us = report.hold_ns // 1000

    @property
    def is_held(self) -> bool:
        """Whether the dead-man commanded a Hold that nothing was made of yet."""
        return bool(self.report.hold_ns) and self.report.hold_ns != self._known_hold_ns

    def own_hold(self, custom_mode: int) -> bool:
        """Whether the vehicle is in a Hold of the dead-man's that nobody else touched."""
        return bool(self.report.hold_ns) and not self.report.touched and custom_mode == px4.MODE_HOLD

    def judge(self, now_us: int, *, is_taking_back: bool = False) -> str:
        """After `is_held`: why the flight ends in Hold, empty where it is taken back; then it counts as known.

        `is_taking_back`: OFFBOARD is not back from the stall before.
        """
        self._known_hold_ns = self.report.hold_ns
        ended_us = max(now_us, self.report.alive_ns // 1000)  # we may have been stopped after looking at the clock
        silent_us = self.report.silent_ns // 1000
        self._stall_us = ended_us - silent_us
        self._held_us = self.report.hold_ns // 1000 - silent_us
        if self.report.touched:
            return "somebody else changed the mode meanwhile"
        if self._stall_us >= SHORT_US:
            return f"too long to take back (limit {1e-6 * SHORT_US:g} s)"
        if is_taking_back:
            unsteered_us = ended_us - self._silent_us
            if unsteered_us > UNSTEERED_MAX_US:
                return f"nobody steered for {1e-6 * unsteered_us:.1f} s (limit {1e-6 * UNSTEERED_MAX_US:g} s)"
            return ""
        if now_us - self._taken_us < AGAIN_US:
            return f"taken back {(now_us - self._taken_us) * 1e-6:.1f} s ago already"
        self._taken_us, self._silent_us = now_us, silent_us
        return ""

    def is_back(self, now_us: int, *, hold_seen: bool = True) -> None:
        """OFFBOARD was taken back; or the Hold was never seen, and nothing had to be."""
        self.taken_back += 1
        self._late_until_us = 0 if hold_seen else now_us + RETAKE_LIMIT_US

    def mode_was_granted(self, now_us: int) -> None:
        """The vehicle accepts a mode that our own system, the dead-man or we, asked for."""
        self._answered_us = now_us

    def is_late_hold(self, custom_mode: int, now_us: int) -> bool:
        """Whether a mode that is seen now is the Hold that was taken for lost: a busy vehicle obeys late, and says so.

        Without its answer to our own system since then the Hold is a pilot's.
        """
        answered = self._answered_us > self.report.hold_ns // 1000
        return answered and now_us < self._late_until_us and self.own_hold(custom_mode)

    def asked_lately(self, custom_mode: int, now_us: int) -> str:
        """That the dead-man asked for Hold shortly before one that it does not know for its own; else empty.

        Nobody can tell whose that is: a busy vehicle obeys late.  It is left alone, but not called a pilot's.
        """
        ago_us = now_us - self._asked_us
        if custom_mode != px4.MODE_HOLD or ago_us > RETAKE_LIMIT_US:
            return ""
        return f", {1e-6 * ago_us:.1f} s after the dead-man had asked for Hold"

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
