"""Failsafes: from what was lost and the parameters to what the autopilot does about it, and when.

Every cause that calls for something stands in a list with its action; the most severe one flies.  Where the action
leaves time for a pilot (lost ground station, battery, fence) Hold comes first for COM_FAIL_ACT_T; a lost offboard
stream gets none.  An action ends when its cause does, or, for some causes, only with the next mode that is chosen
or a disarm.  A mode chosen while a failsafe flies takes the vehicle over; the failsafe is no more than a warning
then, until something new goes wrong.  What can't be flown (no position, say) falls through to what can:
Hold, Return, Land, Descend, Terminate.

Source: PX4 user guide "Safety (failsafe) configuration" and PX4's failsafe state machine; the offboard rows were
measured without sticks, when every answer that hands over to a pilot (Position, Altitude, Manual) becomes NAV_RCL_ACT.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, IntEnum, auto
from typing import Final, NamedTuple

from flightstack_sim.autopilot import modes
from flightstack_sim.autopilot.modes import Mode, Need
from flightstack_sim.autopilot.params import Params


class Action(IntEnum):
    """What a failsafe does, mildest first; the numbers are those of PX4's failsafe event."""

    NONE = 0
    WARN = 1
    HOLD = 5
    RETURN = 6
    LAND = 7
    DESCEND = 8
    DISARM = 9
    TERMINATE = 10


class Cause(IntEnum):
    """Why; the numbers are those of PX4's failsafe event."""

    GENERIC = 0
    MANUAL_CONTROL_LOSS = 1
    GCS_LOSS = 2
    BATTERY_LOW = 3
    BATTERY_CRITICAL = 4
    BATTERY_EMERGENCY = 5


class Warning(IntEnum):
    """How empty the battery is, as BATTERY_STATUS has it less one."""

    NONE = 0
    LOW = 1
    CRITICAL = 2
    EMERGENCY = 3


class Ends(Enum):
    """What ends an action."""

    WITH_ITS_CAUSE = auto()
    ON_MODE_CHANGE = auto()
    NEVER = auto()


class Takeover(IntEnum):
    """Whether a mode that is chosen meanwhile takes over, and whether Hold comes first; least to most restrictive."""

    AT_ONCE = 0
    AT_ONCE_NO_DELAY = 1
    AFTER_HOLD = 2
    NEVER = 3


class FailsafeStatus(NamedTuple):
    """What the failsafes look at."""

    intended: Mode
    armed: bool
    can_run: int
    """Modes that could fly now, by PX4's bits."""
    offboard_signal: bool = True
    gcs_lost: bool = False
    battery: Warning = Warning.NONE
    breached: bool = False
    """Outside the geofence."""
    sticks_lost: bool = False
    """A pilot's sticks were heard since arming, and are no more."""
    attitude_failed: bool = False
    """The failure detector has seen an attitude that no flight has."""


class Selected(NamedTuple):
    """What flies: `action` over NONE and WARN replaces the intention; `then`: what follows a Hold for `delay_s`."""

    action: Action = Action.NONE
    cause: Cause = Cause.GENERIC
    then: Action = Action.NONE
    delay_s: int = 0
    announce: bool = False
    """It is new, or worse than what was: to be said."""


ACTION_MODES: Final[dict[Action, Mode]] = {
    Action.HOLD: modes.HOLD,
    Action.RETURN: modes.RTL,
    Action.LAND: modes.LAND,
    Action.DESCEND: modes.DESCEND,
    Action.TERMINATE: modes.TERMINATION,
}
"""The mode that an action flies in; DISARM has none."""
_FALLING: Final = (Action.HOLD, Action.RETURN, Action.LAND, Action.DESCEND)

_ON_OFFBOARD_LOSS: Final = {3: Action.RETURN, 4: Action.LAND, 5: Action.HOLD, 6: Action.TERMINATE, 7: Action.DISARM}
_ON_LINK_LOSS: Final = {
    1: Action.HOLD,
    2: Action.RETURN,
    3: Action.LAND,
    5: Action.TERMINATE,
    6: Action.DISARM,
}
_ON_BREACH: Final = {1: Action.WARN, 2: Action.HOLD, 3: Action.RETURN, 4: Action.TERMINATE, 5: Action.LAND}
_ON_CRITICAL: Final = {1: Action.RETURN, 2: Action.LAND, 3: Action.RETURN}
_ON_EMERGENCY: Final = {1: Action.RETURN, 2: Action.LAND, 3: Action.LAND}
_LEAST_DELAY_S: Final = 0.1
_BREAKER: Final = 121212.0
"""CBRK_FLIGHTTERM: the failure detector must not end the flight."""
_NO_GCS_NEEDED: Final = (modes.LAND, modes.PRECLAND)


def on_offboard_loss(params: Params) -> Action:
    """The action when OFFBOARD is wanted and its setpoints have stopped (COM_OBL_RC_ACT, NAV_RCL_ACT)."""
    chosen = _ON_OFFBOARD_LOSS.get(int(params.get("COM_OBL_RC_ACT")))
    if chosen is None:
        chosen = _ON_LINK_LOSS.get(int(params.get("NAV_RCL_ACT")), Action.LAND)
    return chosen


def battery_warning(remaining: float, params: Params) -> Warning:
    """How bad a charge (0..1) is (BAT_LOW_THR, BAT_CRIT_THR, BAT_EMERGEN_THR)."""
    if remaining < params.get("BAT_EMERGEN_THR"):
        return Warning.EMERGENCY
    if remaining < params.get("BAT_CRIT_THR"):
        return Warning.CRITICAL
    return Warning.LOW if remaining < params.get("BAT_LOW_THR") else Warning.NONE


def runs(mode: Mode, can_run: int) -> bool:
    """Whether a mode could fly now."""
    return bool(can_run & mode.bit)


class _Wanted(NamedTuple):
    """What one cause calls for."""

    action: Action
    cause: Cause = Cause.GENERIC
    ends: Ends = Ends.WITH_ITS_CAUSE
    takeover: Takeover = Takeover.AFTER_HOLD


@dataclass(slots=True)
class _Standing:
    """A cause in the list."""

    wanted: _Wanted
    takeover: Takeover
    present: bool = True
    """Its cause is there still."""


def _on_gcs_loss(status: FailsafeStatus, params: Params, at_arming: Warning) -> _Wanted | None:
    action = _ON_LINK_LOSS.get(int(params.get("NAV_DLL_ACT")), Action.NONE)
    if not status.gcs_lost or status.intended in _NO_GCS_NEEDED or action is Action.NONE:
        return None
    final = action in (Action.TERMINATE, Action.DISARM)
    ends = Ends.NEVER if action is Action.TERMINATE else Ends.ON_MODE_CHANGE
    return _Wanted(action, Cause.GCS_LOSS, ends, Takeover.NEVER if final else Takeover.AFTER_HOLD)


def _on_sticks_loss(status: FailsafeStatus, params: Params, at_arming: Warning) -> _Wanted | None:
    action = _ON_LINK_LOSS.get(int(params.get("NAV_RCL_ACT")), Action.NONE)
    if not status.sticks_lost or action is Action.NONE:
        return None
    final = action in (Action.TERMINATE, Action.DISARM)
    ends = Ends.NEVER if action is Action.TERMINATE else Ends.ON_MODE_CHANGE
    return _Wanted(action, Cause.MANUAL_CONTROL_LOSS, ends, Takeover.NEVER if final else Takeover.AFTER_HOLD)


def _on_attitude_failure(status: FailsafeStatus, params: Params, at_arming: Warning) -> _Wanted | None:
    if not status.attitude_failed:
        return None
    if params.get("CBRK_FLIGHTTERM") == _BREAKER:
        return _Wanted(Action.WARN)
    return _Wanted(Action.TERMINATE, ends=Ends.NEVER, takeover=Takeover.NEVER)


def _on_breach(status: FailsafeStatus, params: Params, at_arming: Warning) -> _Wanted | None:
    action = _ON_BREACH.get(int(params.get("GF_ACTION")), Action.NONE)
    if not status.breached or action is Action.NONE:
        return None
    if action is Action.TERMINATE:
        return _Wanted(action, ends=Ends.NEVER, takeover=Takeover.NEVER)
    if action is Action.HOLD:  # at once, and the pilot can leave again
        return _Wanted(action, ends=Ends.ON_MODE_CHANGE, takeover=Takeover.AT_ONCE_NO_DELAY)
    return _Wanted(action, ends=Ends.WITH_ITS_CAUSE if action is Action.WARN else Ends.ON_MODE_CHANGE)


def _on_battery(level: Warning, cause: Cause, acts: dict[int, Action]) -> Callable[..., _Wanted | None]:
    def wanted(status: FailsafeStatus, params: Params, at_arming: Warning) -> _Wanted | None:
        if status.battery is not level:
            return None
        acting = status.battery > at_arming  # armed with a low battery: the same level is no news
        return _Wanted(acts.get(int(params.get("COM_LOW_BAT_ACT")), Action.WARN) if acting else Action.WARN, cause)

    return wanted


def _fallback(status: FailsafeStatus, params: Params, at_arming: Warning) -> _Wanted | None:
    """The intended mode can't go on: no setpoints, or no estimate that it needs."""
    action, intended = Action.NONE, status.intended
    if intended is modes.OFFBOARD and not status.offboard_signal:
        action = on_offboard_loss(params)
        intended = ACTION_MODES.get(action, intended)
    if intended.need is Need.STICKS:  # lost sticks are another cause's business
        return None if intended is not modes.POSCTL or runs(modes.HOLD, status.can_run) else _Wanted(Action.RETURN)
    if action is not Action.DISARM and intended is not modes.TERMINATION and not runs(intended, status.can_run):
        action = Action.RETURN
    return None if action is Action.NONE else _Wanted(action, takeover=Takeover.AT_ONCE)


_CAUSES: Final[dict[str, Callable[[FailsafeStatus, Params, Warning], _Wanted | None]]] = {
    "sticks": _on_sticks_loss,
    "ground station": _on_gcs_loss,
    "fence": _on_breach,
    "battery low": _on_battery(Warning.LOW, Cause.BATTERY_LOW, {}),
    "battery critical": _on_battery(Warning.CRITICAL, Cause.BATTERY_CRITICAL, _ON_CRITICAL),
    "battery emergency": _on_battery(Warning.EMERGENCY, Cause.BATTERY_EMERGENCY, _ON_EMERGENCY),
    "attitude": _on_attitude_failure,
    "mode": _fallback,
}
"""Every cause, in the order in which PX4 looks at them."""


class Failsafe:
    """The failsafes of one vehicle; `selected` is what they call for now."""

    __slots__ = (
        "_at_arming",
        "_configured_us",
        "_delay_us",
        "_last_us",
        "_new_warning",
        "_params",
        "_standing",
        "_start_delay_us",
        "_taken_over",
        "selected",
    )

    def __init__(self, params: Params) -> None:
        self._params = params
        self.selected = Selected()
        self._standing: dict[str, _Standing] = {}
        self._delay_us = 0.0
        self._configured_us = self._start_delay_us = -1.0
        self._last_us = -1
        self._taken_over = False
        self._new_warning = False
        self._at_arming = Warning.NONE

    def reset(self) -> None:
        """Armed or disarmed: start anew."""
        self.selected = Selected()
        self._standing.clear()
        self._taken_over = False
        self._delay_us = 0.0

    def update(self, status: FailsafeStatus, now_us: int, *, chosen: bool) -> Selected:
        """Advance to `now_us`; `chosen`: somebody has just chosen a mode."""
        step_us = now_us - self._last_us if self._last_us >= 0 else 0
        self._last_us = now_us
        if not status.armed:
            self.reset()
            self._at_arming = status.battery
            return self.selected
        configured_us = self._params.get("COM_FAIL_ACT_T") * 1e6
        if configured_us != self._configured_us:
            self._configured_us = self._start_delay_us = configured_us
        if chosen or self._taken_over:
            self._drop_ended()
        self._delay_us = max(0.0, self._delay_us - step_us)
        self._look(status)
        before = self.selected
        if before.action > Action.HOLD or self._taken_over or not runs(modes.HOLD, status.can_run):
            self._delay_us = 0.0
        selected = self._select(status, chosen=chosen)
        waiting = selected.then is not Action.NONE
        most_us = self._configured_us  # the wait comes back four times slower than it is used up
        left_us = self._start_delay_us - step_us if waiting else min(self._start_delay_us + step_us / 4.0, most_us)
        self._start_delay_us = max(0.0, left_us)
        worse = selected.action > before.action or (selected.action is not Action.NONE and self._new_warning)
        self._new_warning = False
        self.selected = selected._replace(announce=worse)
        return self.selected

    def _drop_ended(self) -> None:
        """A mode was chosen: what waited for that and has no cause any more is over."""
        ended = [
            name for name, one in self._standing.items() if not one.present and one.wanted.ends is Ends.ON_MODE_CHANGE
        ]
        for name in ended:
            del self._standing[name]

    def _look(self, status: FailsafeStatus) -> None:
        """Bring the list up to date."""
        for name, cause in _CAUSES.items():
            wanted, standing = cause(status, self._params, self._at_arming), self._standing.get(name)
            if wanted is None:
                if standing is not None:
                    standing.present = False
                    if standing.wanted.ends is Ends.WITH_ITS_CAUSE:
                        del self._standing[name]
            elif standing is not None:
                standing.present = True
                standing.wanted = standing.wanted._replace(action=wanted.action)
            else:
                self._add(name, wanted)

    def _add(self, name: str, wanted: _Wanted) -> None:
        takeover = wanted.takeover
        if takeover is Takeover.AFTER_HOLD:
            takeover = Takeover.AT_ONCE_NO_DELAY
            if self._params.get("COM_FAIL_ACT_T") > _LEAST_DELAY_S:
                takeover = Takeover.AT_ONCE
                if wanted.action is not Action.WARN and self._delay_us == 0.0:
                    self._delay_us = self._start_delay_us
        self._standing[name] = _Standing(wanted, takeover)
        if wanted.action is Action.WARN:
            self._new_warning = True
        else:
            self._taken_over = False

    def _select(self, status: FailsafeStatus, *, chosen: bool) -> Selected:
        """The most severe action, the Hold before it, or no more than a warning where somebody took over."""
        if self.selected.action is Action.TERMINATE:
            return Selected(Action.TERMINATE)
        action, cause, takeover = Action.NONE, Cause.GENERIC, Takeover.AT_ONCE
        for one in self._standing.values():
            takeover = max(takeover, one.takeover)
            if one.wanted.action > action:
                action, cause = one.wanted.action, one.wanted.cause
        then = Action.NONE
        if self._delay_us > 0.0 and not self._taken_over and takeover is not Takeover.NEVER:
            if action > Action.WARN and action not in (Action.DISARM, Action.TERMINATE):
                then, action = action, Action.HOLD
        wants = chosen and self.selected.action is action
        if action in _FALLING and takeover is not Takeover.NEVER and (self._taken_over or wants):
            fallen = _fallback(status, self._params, self._at_arming)
            action, then, self._taken_over = fallen.action if fallen else Action.WARN, Action.NONE, True
        else:
            self._taken_over = False
        action = _possible(action, status.can_run)
        landing = status.intended is modes.LAND and runs(modes.LAND, status.can_run)
        if landing and Action.RETURN in (action, then):
            action, then = Action.WARN, Action.NONE
        return Selected(action, cause, then, int((self._delay_us + 500_000) // 1_000_000))


def _possible(action: Action, can_run: int) -> Action:
    """The action, or the next one down that can be flown."""
    if action not in _FALLING:
        return action
    for candidate in _FALLING[_FALLING.index(action) :]:
        if runs(ACTION_MODES[candidate], can_run):
            return candidate
    return Action.TERMINATE
