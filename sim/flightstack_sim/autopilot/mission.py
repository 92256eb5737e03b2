"""A stored mission as it is flown: item after item, from where it was left.

What moves: take-off, waypoints, loiter (without end, for a time, to a height), land, return.  What only acts: delay,
speed, jump.  Other items that PX4 takes (cameras, gripper ...) count as done at once.  On the way up, and where a
mission is resumed below its next height, the vehicle climbs first.  After the last item it holds, as PX4 does.
Judged when it is stored: places that are none on this globe, take-off that isn't first, a landing at the beginning,
places outside the fence; such a mission can't be chosen.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from flightstack.geodesy import LocalFrame
from flightstack.types import Tuple3
from flightstack_sim.autopilot import notices
from flightstack_sim.autopilot.notices import Notice
from flightstack_sim.autopilot.params import Params
from flightstack_sim.autopilot.setpoint import HOLD, NAN, ControlKind, ControlSetpoint
from flightstack_sim.plans import MISSION, Item, ItemCmd, Plans

_TAKEOFFS: Final = (ItemCmd.TAKEOFF, ItemCmd.VTOL_TAKEOFF)
_LANDS: Final = (ItemCmd.LAND, ItemCmd.VTOL_LAND)
_LOITERS: Final = (ItemCmd.LOITER_UNLIMITED, ItemCmd.LOITER_TIME, ItemCmd.LOITER_TO_ALT)
_FLOWN: Final = frozenset({*_TAKEOFFS, *_LANDS, *_LOITERS, ItemCmd.WAYPOINT})
_LEAST_RADIUS_M: Final = 0.05
_MOST_AT_ONCE: Final = 50
"""Items that are done in one tick; the rest in the next: a mission of jumps must not stop the clock."""
_FASTEST_MPS: Final = 20.0
_MOST_NEWS: Final = 10
"""Items told as reached in one go: jumps must not fill the link either."""


_YAW: Final = 3
"""Among an item's parameters."""


class MissionFlight:
    """One vehicle's mission.  `reached` is the last item that was done, -1: none."""

    __slots__ = (
        "_climb_down_m",
        "_frame",
        "_home",
        "_item_us",
        "_jumped",
        "_jumps",
        "_landing",
        "_outside",
        "_params",
        "_plans",
        "_setpoint",
        "_version",
        "_within_us",
        "cruise_mps",
        "finished",
        "news", "reached",
        "returns",
        "valid",
    )  # fmt: skip

    def __init__(
        self, plans: Plans, params: Params, frame: LocalFrame, outside: Callable[[float, float], bool]
    ) -> None:
        self._plans, self._params, self._frame, self._outside = plans, params, frame, outside
        self._version = self._jumps = 0
        self.valid = False
        """Whether there is one that can be flown."""
        self.finished = False
        self.returns = False
        """An item asks for Return."""
        self.reached = -1
        self.news: list[int] = []
        """Items that were done since somebody has emptied this."""
        self.cruise_mps: float | None = None
        """A speed that an item has asked for since it was last looked at."""
        self._home: Tuple3 = (0.0, 0.0, 0.0)
        self._jumped: dict[int, int] = {}
        self._restart()

    def _restart(self) -> None:
        """Begin the current item anew."""
        self._setpoint: ControlSetpoint | None = None
        self._climb_down_m = NAN
        self._landing = False
        self._within_us = self._item_us = -1

    def renew(self) -> tuple[Notice, ...]:
        """Take over what a client has stored since; what is to be said about it."""
        if self._version == self._plans.version[MISSION]:
            return ()
        self._version = self._plans.version[MISSION]
        self.finished, self.reached = False, -1
        self._jumped.clear()
        self._restart()
        problem = self._problem()
        self.valid = bool(self._plans.mission) and problem is None
        return (problem,) if problem is not None else ()

    def _problem(self) -> Notice | None:
        """Why the stored mission can't be flown; None: it can, or there is none."""
        moved = False
        for number, item in enumerate(self._plans.mission, 1):
            if item.command not in _FLOWN:
                continue
            if not (abs(item.x) <= 90.0 and abs(item.y) <= 180.0):
                return notices.mission_rejected(f"item {number}: no place on the globe")
            if item.command in _TAKEOFFS and moved:
                return notices.mission_rejected("takeoff not first waypoint item")
            if item.command in _LANDS and not moved:
                return notices.mission_rejected("starts with landing")
            if item.command == ItemCmd.WAYPOINT and self._outside(*self._frame.to_local(item.x, item.y)):
                return notices.outside_fence(number)
            moved = True
        return None

    def start(self, home_ned_m: Tuple3 | None, pos_ned_m: Tuple3, *, landed: bool) -> tuple[Notice, ...]:
        """The mode has been entered, armed."""
        self._home = home_ned_m if home_ned_m is not None else (0.0, 0.0, 0.0)
        if self.finished:  # once more, from the beginning
            self.finished, self._plans.current = False, 0
        self.returns = False
        self._restart()
        said = [notices.EXECUTING_MISSION]
        item = next((one for one in self._plans.mission[self._plans.current :] if one.command in _FLOWN), None)
        if item is not None and item.command not in _LANDS:
            down_m = self._down_m(item, pos_ned_m)
            if landed or down_m < pos_ned_m[2] - self._params.get("NAV_MC_ALT_RAD"):
                self._climb_down_m = down_m
                said.append(notices.climbs(self._home[2] - down_m))
        return tuple(said)

    def step(self, pos_ned_m: Tuple3, now_us: int, *, landed: bool) -> ControlSetpoint:
        """The setpoint of this tick."""
        if self._jumps != self._plans.jumps:
            self._jumps = self._plans.jumps
            self.finished = False
            self._restart()
        for _ in range(_MOST_AT_ONCE):
            items, at = self._plans.mission, self._plans.current
            if self.finished or not at < len(items):
                break
            if not self._done(items[at], pos_ned_m, now_us, landed):
                break
            self._next(items[at], at, len(items))
        return self._setpoint if self._setpoint is not None else HOLD

    def _next(self, item: Item, at: int, count: int) -> None:
        """This item is done."""
        self.reached = at
        if len(self.news) < _MOST_NEWS:
            self.news.append(at)
        following = at + 1
        if item.command == ItemCmd.JUMP:
            following = self._jump(item, at, count)
        if following >= count:
            self.finished = True
            return
        self._plans.current = following
        kept = self._setpoint
        self._restart()
        self._setpoint = kept  # until the next item has its own

    def _jump(self, item: Item, at: int, count: int) -> int:
        """Where a jump leads: its target as often as it says (-1: always), then on; on where there is no such item."""
        target, times = item.params[0], item.params[1]
        if not (math.isfinite(target) and 0 <= target < count and math.isfinite(times)):
            return at + 1
        done = self._jumped.get(at, 0)
        if times >= 0 and done >= times:
            self._jumped[at] = 0
            return at + 1
        self._jumped[at] = done + 1
        return int(target)

    def _done(self, item: Item, pos_ned_m: Tuple3, now_us: int, landed: bool) -> bool:
        """Fly or do an item; whether that is done."""
        if self._item_us < 0:
            self._item_us = now_us
            if item.command in _FLOWN:
                self._setpoint = self._setpoint_of(item, pos_ned_m)
        if item.command in _FLOWN:
            return self._flown(item, pos_ned_m, now_us, landed)
        if item.command in (ItemCmd.DELAY, ItemCmd.CONDITION_DELAY):
            return not now_us - self._item_us < 1e6 * item.params[0]  # NaN: no delay
        if item.command == ItemCmd.CHANGE_SPEED and 0.0 < item.params[1] < math.inf:
            self.cruise_mps = min(item.params[1], _FASTEST_MPS)
        if item.command == ItemCmd.RETURN:
            self.returns = True
        return True

    def _flown(self, item: Item, pos_ned_m: Tuple3, now_us: int, landed: bool) -> bool:
        """Whether an item that has a place is done."""
        height_ok_m = self._params.get("NAV_MC_ALT_RAD")
        if not math.isnan(self._climb_down_m):
            if abs(pos_ned_m[2] - self._climb_down_m) > height_ok_m:
                return False
            self._climb_down_m = NAN
            if item.command not in _TAKEOFFS:
                self._setpoint = self._setpoint_of(item, pos_ned_m)
        assert self._setpoint is not None
        north, east, down = self._setpoint.pos_ned_m
        if item.command in _TAKEOFFS:
            return abs(pos_ned_m[2] - down) <= height_ok_m
        radius_m = self._params.get("NAV_ACC_RAD")
        if item.command == ItemCmd.WAYPOINT and item.params[1] > _LEAST_RADIUS_M:
            radius_m = item.params[1]
        there = math.hypot(pos_ned_m[0] - north, pos_ned_m[1] - east) <= radius_m
        if item.command in _LANDS:
            if there and not self._landing:
                self._landing = True
                self._setpoint = ControlSetpoint(ControlKind.LAND, pos_ned_m=(north, east, NAN))
            return self._landing and landed
        there = there and abs(pos_ned_m[2] - down) <= height_ok_m
        if self._within_us < 0 and there:
            self._within_us = now_us
        if self._within_us < 0 or item.command == ItemCmd.LOITER_UNLIMITED:
            return False
        if item.command == ItemCmd.LOITER_TO_ALT:
            return True
        return not now_us - self._within_us < 1e6 * item.params[0]  # NaN: no wait

    def _down_m(self, item: Item, pos_ned_m: Tuple3) -> float:
        """An item's height; the vehicle's own where it names none."""
        if not math.isfinite(item.z):
            return pos_ned_m[2]
        return self._home[2] - item.z if item.above_home else self._frame.altitude_m - item.z

    def _setpoint_of(self, item: Item, pos_ned_m: Tuple3) -> ControlSetpoint:
        if not math.isnan(self._climb_down_m):
            return ControlSetpoint(ControlKind.TAKEOFF, pos_ned_m=(NAN, NAN, self._climb_down_m))
        if item.command in _TAKEOFFS:
            return ControlSetpoint(ControlKind.TAKEOFF, pos_ned_m=(NAN, NAN, self._down_m(item, pos_ned_m)))
        north, east = pos_ned_m[:2]
        if item.x or item.y:
            north, east = self._frame.to_local(item.x, item.y)
        down_m = pos_ned_m[2] if item.command in _LANDS else self._down_m(item, pos_ned_m)
        yaw_deg = item.params[_YAW]
        yaw = math.remainder(math.radians(yaw_deg), 2.0 * math.pi) if math.isfinite(yaw_deg) else NAN
        return ControlSetpoint(ControlKind.GOTO, pos_ned_m=(north, east, down_m), yaw_rad=yaw)
