"""PX4's numbers on the wire that both ends need: modes, commands, results.  Facts of its MAVLink interface."""

from __future__ import annotations

from enum import IntEnum

AUTOPILOT_PX4 = 12
TYPE_QUADROTOR = 2
TYPE_GCS = 6
TYPE_ONBOARD_CONTROLLER = 18
COMPONENT_AUTOPILOT = 1
COMPONENT_GCS = 190

ARMED_BIT = 0x80
STATE_TERMINATED = 8
"""HEARTBEAT's system_status (MAV_STATE): terminated, killed, or locked down, armed or not."""

MAIN_OFFBOARD = 6
MODE_OFFBOARD = 0x00060000
MODE_HOLD = 0x03040000
MODE_LAND = 0x06040000

_MAIN_NAMES = {
    1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED", 10: "TERMINATION",
    11: "ALTITUDE_CRUISE",
}  # fmt: skip
_AUTO_NAMES = {
    1: "READY", 2: "TAKEOFF", 3: "HOLD", 4: "MISSION", 5: "RTL", 6: "LAND", 8: "FOLLOW", 9: "PRECLAND",
    10: "VTOL_TAKEOFF",
} | {sub: f"EXTERNAL{sub - 10}" for sub in range(11, 19)}  # fmt: skip
_POSITION_NAMES = {1: "ORBIT", 2: "POSITION_SLOW"}
"""Sub modes of the main mode POSCTL that are modes of their own: in an orbit nobody holds sticks."""


def main_mode(custom_mode: int) -> int:
    """PX4's main mode of a HEARTBEAT custom_mode."""
    return (custom_mode >> 16) & 0xFF


def sub_mode(custom_mode: int) -> int:
    """PX4's sub mode of a HEARTBEAT custom_mode."""
    return (custom_mode >> 24) & 0xFF


def describe_mode(custom_mode: int) -> str:
    """A custom_mode in PX4's words, e.g. AUTO.LAND."""
    main, sub = _MAIN_NAMES.get(main_mode(custom_mode), f"main mode {main_mode(custom_mode)}"), sub_mode(custom_mode)
    if main == "AUTO":
        return f"AUTO.{_AUTO_NAMES.get(sub, str(sub))}"
    return _POSITION_NAMES.get(sub, main) if main == "POSCTL" else main


class Cmd(IntEnum):
    """MAV_CMD numbers in use."""

    NAV_RETURN_TO_LAUNCH = 20
    NAV_LAND = 21
    NAV_TAKEOFF = 22
    DO_ORBIT = 34
    DO_SET_MODE = 176
    DO_CHANGE_SPEED = 178
    DO_SET_HOME = 179
    DO_REPOSITION = 192
    PREFLIGHT_REBOOT_SHUTDOWN = 246
    COMPONENT_ARM_DISARM = 400
    GET_MESSAGE_INTERVAL = 510
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5
    CANCELLED = 6


def describe_result(result: int) -> str:
    """A MAV_RESULT in words."""
    try:
        return Result(result).name.lower().replace("_", " ")
    except ValueError:
        return f"result {result}"
