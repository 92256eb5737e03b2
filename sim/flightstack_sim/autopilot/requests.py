"""What the commander is asked and told each tick, and what it answers: plain tuples, by MAVLink's and PX4's numbers."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from flightstack_sim.autopilot.goal import Goal
from flightstack_sim.autopilot.notices import Notice

NEVER: Final = -(1 << 60)
CYCLE_US: Final = 100_000
"""Period of the arming checks and of the offboard signal's freshness."""
ESTIMATE_READY_US: Final = 3_900_000
"""PX4's estimator trusts its heading this long after boot."""
REPORT_US: Final = 2_000_000
"""Least time between two reports of the arming checks."""
FORCE: Final = 21196.0
"""COMPONENT_ARM_DISARM.param2 that disarms in the air (arming checks stay)."""

ACCEPTED: Final = 0
TEMPORARILY_REJECTED: Final = 1
DENIED: Final = 2

COMMAND_SET_MODE: Final = 176
COMMAND_ARM: Final = 400
COMMAND_TAKEOFF: Final = 22
COMMAND_LAND: Final = 21
COMMAND_RETURN: Final = 20
COMMAND_ORBIT: Final = 34
COMMAND_START: Final = 300
COMMAND_TERMINATE: Final = 185


class Sender(NamedTuple):
    """Who asked: the MAVLink link and the address on it."""

    link: int
    system: int
    component: int


class ModeRequest(NamedTuple):
    """Choose a mode by PX4's main and sub numbers."""

    sender: Sender
    main: int
    sub: int


class ArmRequest(NamedTuple):
    """COMPONENT_ARM_DISARM: `param` 1 arms, 0 disarms."""

    sender: Sender
    param: float
    force: bool


class FlyRequest(NamedTuple):
    """NAV_TAKEOFF, NAV_LAND or NAV_RETURN_TO_LAUNCH."""

    sender: Sender
    command: int
    altitude_m: float = math.nan
    """Of a take-off, above the sea; NaN takes MIS_TAKEOFF_ALT."""


class GoRequest(NamedTuple):
    """DO_REPOSITION or DO_ORBIT: a goal, and whether the mode shall change for it."""

    sender: Sender
    command: int
    goal: Goal
    changes_mode: bool = True


class StartRequest(NamedTuple):
    """MISSION_START: fly the mission, arming where need be."""

    sender: Sender


class TerminateRequest(NamedTuple):
    """DO_FLIGHTTERMINATION."""

    sender: Sender


Request = ModeRequest | ArmRequest | FlyRequest | GoRequest | StartRequest | TerminateRequest


class Answer(NamedTuple):
    """A COMMAND_ACK to send."""

    sender: Sender
    command: int
    result: int


class Inputs(NamedTuple):
    """What happened since the last step."""

    landed: bool
    last_setpoint_us: int
    """When the last accepted offboard setpoint came; NEVER before the first."""
    takeoff_done: bool = False
    """AUTO.TAKEOFF has reached its height."""
    requests: tuple[Request, ...] = ()
    gcs_at_us: int = NEVER
    """When a ground station's last heartbeat came, on any link."""
    battery_remaining: float = 1.0
    """Charge, 0..1."""
    position_valid: bool = True
    """Whether the estimate has a horizontal position."""
    breached: bool = False
    """Outside the geofence."""
    mission_valid: bool = False
    """A mission that can be flown is stored."""
    mission_over: bool = False
    """It has been flown to its end."""
    sticks_at_us: int = NEVER
    """When a pilot's sticks last came."""
    attitude_failed: bool = False
    """The failure detector's verdict."""
    silent: tuple[str, ...] = ()
    """Of `notices.SILENT`, the sensors that give no data."""
    mission_returns: bool = False
    """Its present item asks for Return."""


class Replies(NamedTuple):
    """What the vehicle says."""

    notices: tuple[Notice, ...]
    answers: tuple[Answer, ...]
