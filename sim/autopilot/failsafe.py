"""Failsafes: from what was lost and the parameters to what the autopilot does about it.

Source: PX4 user guide "Safety (failsafe) configuration"; the offboard rows were measured without sticks, when every
answer that hands over to a pilot (Position, Altitude, Manual) falls through to NAV_RCL_ACT.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from sim.autopilot import modes
from sim.autopilot.modes import Mode
from sim.autopilot.params import Params


class Action(IntEnum):
    """What a failsafe does, mildest first; the numbers are those of PX4's failsafe event."""

    NONE = 0
    HOLD = 5
    RETURN = 6
    LAND = 7
    DISARM = 9
    TERMINATE = 10


ACTION_MODES: Final[dict[Action, Mode]] = {
    Action.HOLD: modes.HOLD,
    Action.RETURN: modes.RTL,
    Action.LAND: modes.LAND,
    Action.TERMINATE: modes.TERMINATION,
}
"""The mode that an action flies in; DISARM has none."""

_ON_OFFBOARD_LOSS: Final = {3: Action.RETURN, 4: Action.LAND, 5: Action.HOLD, 6: Action.TERMINATE, 7: Action.DISARM}
_ON_STICKS_LOSS: Final = {
    1: Action.HOLD,
    2: Action.RETURN,
    3: Action.LAND,
    5: Action.TERMINATE,
    6: Action.DISARM,
}


def on_offboard_loss(params: Params) -> Action:
    """The action when OFFBOARD is wanted and its setpoints have stopped (COM_OBL_RC_ACT, NAV_RCL_ACT)."""
    chosen = _ON_OFFBOARD_LOSS.get(int(params.get("COM_OBL_RC_ACT")))
    if chosen is None:
        chosen = _ON_STICKS_LOSS.get(int(params.get("NAV_RCL_ACT")), Action.LAND)
    return chosen


def evaluate(intended: Mode, *, armed: bool, offboard_signal: bool, params: Params) -> Action:
    """The most severe action that anything calls for now."""
    if not armed:
        return Action.NONE
    if intended is modes.OFFBOARD and not offboard_signal:
        return on_offboard_loss(params)
    return Action.NONE
