"""What the autopilot says of itself: one table of PX4's events with their wording.

PX4 says most things twice: as an EVENT (id 410: a number with arguments, for ground stations that know the names) and
as a STATUSTEXT.  An event's number is the component (1) in the top byte over 24 bits of FNV-1a of its name, a property
of MAVLink's events interface.  Levels (internal << 4 | external): 2 critical, 3 error, 4 warning, 6 info, 8 protocol.
Texts end in a tab where PX4's do: clients that read EVENTs drop those lines.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

CRITICAL: Final = 2
INFO: Final = 6


class Notice(NamedTuple):
    """One thing said: an EVENT, a STATUSTEXT, or both."""

    event_id: int
    """0: no EVENT."""
    log_levels: int
    arguments: bytes
    severity: int
    """MAV_SEVERITY of the text."""
    text: str
    """Empty: no STATUSTEXT."""
    console: str = ""
    """What the console says where nothing is said on the wire."""


def event_id(name: str, component: int = 1) -> int:
    """The number of a named event."""
    digest = 0x811C9DC5
    for byte in name.encode():
        digest = (digest ^ byte) * 0x01000193 & 0xFFFFFFFF
    return component << 24 | digest & 0xFFFFFF


def _said(name: str, levels: int, severity: int, text: str, arguments: bytes = b"") -> Notice:
    return Notice(event_id(name), levels, arguments, severity, text + "\t")


# Reasons of arming and disarming (PX4's arm_disarm_reason).
BY_COMMAND: Final = 4
BY_MISSION_START: Final = 5
BY_LANDING: Final = 6
BY_PREFLIGHT: Final = 7
BY_FAILSAFE: Final = 14
_REASONS: Final = {
    BY_COMMAND: "external command",
    BY_MISSION_START: "mission start",
    BY_LANDING: "landing",
    BY_PREFLIGHT: "auto preflight disarming",
    BY_FAILSAFE: "failsafe",
}

ARMING_DENIED: Final = _said(
    "commander_arm_denied_resolve_failures", 0x62, CRITICAL, "Arming denied: Resolve system health failures first"
)
DISARMING_DENIED: Final = _said("commander_disarm_denied_not_landed", 0x62, CRITICAL, "Disarming denied: not landed")
TAKEOFF_DETECTED: Final = _said("commander_takeoff_detected", 0x66, INFO, "Takeoff detected")
LANDING_DETECTED: Final = _said("commander_landing_detected", 0x66, INFO, "Landing detected")
UNSUPPORTED_MAIN_MODE: Final = _said("commander_unsupported_main_mode", 0x33, CRITICAL, "Unsupported main mode")
UNSUPPORTED_AUTO_MODE: Final = _said("commander_unsupported_auto_mode", 0x33, CRITICAL, "Unsupported auto mode")
LANDING_HERE: Final = _said("commander_landing_current_pos", 0x66, INFO, "Landing at current position")
RETURNING: Final = _said("commander_rtl", 0x66, INFO, "Returning to launch")
RTL_LANDS: Final = _said("rtl_land_at_destination", 0x66, INFO, "RTL: land at destination")
GCS_LOST: Final = _said("commander_gcs_lost", 0x64, INFO, "Connection to ground station lost")
GCS_REGAINED: Final = _said("commander_dl_regained", 0x66, INFO, "GCS connection regained")
NO_DATA: Final = "Preflight Fail: No valid data from {} 0\t"
NO_GCS: Final = Notice(0, 0, b"", 4, "Preflight Fail: No connection to the ground control station\t")
REPOSITION_REJECTED: Final = _said("commander_reposition_rejected", 0x63, CRITICAL, "Reposition command rejected")
ORBIT_REJECTED: Final = Notice(0, 0, b"", CRITICAL, "Orbit command rejected")
READY: Final = Notice(0, 0, b"", INFO, "Ready for takeoff!\t")
HEADING_NOT_STABLE: Final = Notice(0, 0, b"", CRITICAL, "Preflight Fail: heading estimate not stable\t")


# The mission protocol's.
PLAN_BUSY: Final = _said("mavlink_mission_getlist_busy", 0x33, CRITICAL, "WPM: REJ. CMD: Busy")
PLAN_REQUEST_BUSY: Final = _said("mavlink_mission_mis_req_ignored_busy", 0x33, CRITICAL, "WPM: REJ. CMD: Busy")
PLAN_COUNT_IGNORED: Final = _said("mavlink_mission_ignore_mis_count", 0x33, CRITICAL, "WPM: IGN MISSION_COUNT: Busy")
PLAN_CLEAR_IGNORED: Final = _said("mavlink_mission_ignore_clear", 0x33, CRITICAL, "WPM: IGN CLEAR CMD: Busy")
PLAN_CURRENT_BUSY: Final = _said("mavlink_mission_state_busy", 0x33, CRITICAL, "WPM: IGN WP CURR CMD: Busy")
PLAN_NOT_IN_LIST: Final = _said("mavlink_mission_seq_out_of_bounds", 0x33, CRITICAL, "WPM: WP CURR CMD: Not in list")
PLAN_UNEXPECTED: Final = _said("mavlink_mission_wp_unexpected", 0x33, CRITICAL, "WPM: REJ. CMD: Req. WP was unexpected")
PLAN_LIST_IGNORED: Final = _said(
    "mavlink_mission_req_ignored", 0x44, INFO, "Mission download request ignored, already active"
)
PLAN_NO_TRANSFER: Final = _said("mavlink_mission_no_transfer", 0x33, CRITICAL, "IGN MISSION_ITEM: No transfer")
PLAN_ITEM_BUSY: Final = _said("mavlink_mission_mis_item_busy", 0x33, CRITICAL, "IGN MISSION_ITEM: Busy")
PLAN_ITEM_INVALID: Final = _said("mavlink_mission_mis_item_invalid", 0x33, CRITICAL, "IGN MISSION_ITEM: Invalid item")
PLAN_ITEM_PARTNER: Final = _said(
    "mavlink_mission_item_partner_id_mismatch", 0x33, CRITICAL, "REJ. MIS ITEM: partner id mismatch"
)
PLAN_REQUEST_PARTNER: Final = _said(
    "mavlink_mission_partner_id_mismatch2", 0x33, CRITICAL, "WPM: REJ. CMD: partner id mismatch"
)
PLAN_ACK_PARTNER: Final = _said(
    "mavlink_mission_partner_id_mismatch", 0x33, CRITICAL, "REJ. WP CMD: partner id mismatch"
)
PLAN_TIMEOUT: Final = _said("mavlink_mission_op_timeout", 0x33, CRITICAL, "Operation timeout")
FENCE_LEFT: Final = Notice(0, 0, b"", CRITICAL, "Geofence: approaching or outside geofence\t")
FENCE_WITHOUT_HOME: Final = Notice(0, 0, b"", CRITICAL, "Geofence invalid, doesn't contain Home position\t")
FENCE_WITHOUT_VEHICLE: Final = Notice(
    0, 0, b"", CRITICAL, "Geofence invalid, doesn't contain current vehicle position\t"
)
OUTSIDE_FENCE: Final = Notice(0, 0, b"", CRITICAL, "Reposition is outside geofence\t")

TERMINATED: Final = Notice(0, 0, b"", CRITICAL, "Preflight Fail: Flight termination active\t")
EXECUTING_MISSION: Final = Notice(0, 0, b"", INFO, "Executing Mission\t")
NO_VALID_MISSION: Final = Notice(0, 0, b"", CRITICAL, "Mission start denied! No valid mission\t")


def mission_rejected(why: str) -> Notice:
    """A stored mission can't be flown."""
    return Notice(0, 0, b"", CRITICAL, f"Mission rejected: {why}\t")


def outside_fence(number: int) -> Notice:
    """A stored mission leads out of the fence."""
    return Notice(0, 0, b"", CRITICAL, f"Geofence violation for waypoint {number}\t")


def climbs(height_m: float) -> Notice:
    """A mission begins with a climb."""
    return Notice(0, 0, b"", INFO, f"Climb to {height_m:.1f} meters above home\t")


def armed(reason: int) -> Notice:
    """The motors are live."""
    return _said("commander_armed_by", 0x66, INFO, f"Armed by {_REASONS[reason]}", struct.pack("<B", reason))


def disarmed(reason: int) -> Notice:
    """The motors are off."""
    return _said("commander_disarmed_by", 0x66, INFO, f"Disarmed by {_REASONS[reason]}", struct.pack("<B", reason))


def failsafe(intended_custom_mode: int, action: int, cause: int = 0, then: int = 0, delay_s: int = 0) -> Notice:
    """A failsafe took over; `action`, `then` (after a Hold of `delay_s`) and `cause`: the numbers of `failsafe.py`.

    The text is the same for all but the Hold, the event names the cause where PX4's has a name.
    """
    head = struct.pack("<I", intended_custom_mode)
    if then:
        text, arguments = f"Failsafe activated, entering Hold for {delay_s} seconds", struct.pack("<BH", then, delay_s)
        if cause:
            return _said("commander_failsafe_enter_hold", 0x42, CRITICAL, text, head + arguments + bytes([cause]))
        return _said("commander_failsafe_enter_generic_hold", 0x42, CRITICAL, text, head + arguments)
    text = "Failsafe activated"
    if action == _WARN:
        if cause in _BATTERY_WARNINGS:
            return _said(*_BATTERY_WARNINGS[cause], CRITICAL, text)
        if cause:
            return _said("commander_failsafe_enter_warn", 0x44, CRITICAL, text, head + bytes([cause]))
        return _said("commander_failsafe_enter_generic_warn", 0x44, CRITICAL, text, head)
    if cause:
        return _said("commander_failsafe_enter", 0x42, CRITICAL, text, head + bytes([action, cause]))
    return _said("commander_failsafe_enter_generic", 0x42, CRITICAL, text, head + bytes([action]))


_WARN: Final = 1
_BATTERY_WARNINGS: Final = {
    3: ("commander_failsafe_enter_low_bat", 0x64),
    4: ("commander_failsafe_enter_crit_bat_warn", 0x62),
    5: ("commander_failsafe_enter_crit_low_bat_warn", 0x60),
}


def unsupported_arm_param(value: float) -> Notice:
    """COMPONENT_ARM_DISARM with something else than 0 or 1."""
    text = f"Unsupported ARM_DISARM param: {value:.3f}"
    return _said("commander_unsupported_arm_disarm_param", 0x33, CRITICAL, text, struct.pack("<f", value))


def mode_not_available(title: str, custom_mode: int, nav_state: int) -> Notice:
    """A mode was asked for that can't run now."""
    arguments = struct.pack("<IB", custom_mode, nav_state)
    text = f"Switching to {title} is currently not available"
    return _said("commander_modeswitch_not_avail", 0x62, CRITICAL, text, arguments)


def takeoff_altitude(height_m: float) -> Notice:
    """A take-off that names no height takes MIS_TAKEOFF_ALT."""
    arguments = struct.pack("<f", height_m)
    text = f"Using default takeoff altitude: {height_m:.1f} m"
    return _said("navigator_takeoff_default_alt", 0x66, INFO, text, arguments)


def return_start(altitude_m: int, above_m: int) -> Notice:
    """Return has begun: at which altitude (above the sea) and how far above its destination."""
    arguments = struct.pack("<ii", altitude_m, above_m)
    return _said(
        "vrtl_return_at", 0x66, INFO, f"RTL: start return at {altitude_m} m ({above_m} m above destination)", arguments
    )


# --- the burst that reports the arming checks ---

SYSTEM: Final = 20
REMOTE_CONTROL: Final = 7
COMMUNICATION: Final = 12
"""Health components (bit numbers) that the checks report under."""
_HEALTH_PRESENT: Final = 0x38021C0A
SILENT: Final = {"Baro": ("check_baro_no_data", 1), "Compass": ("check_mag_no_data", 27)}
"""Sensors that may give no data: the check that fails then, and its health component."""
_ANY_MODE: Final = 0xFFFFFFFF


def _event(name: str, levels: int, arguments: bytes) -> Notice:
    return Notice(event_id(name), levels, arguments, 0, "")


def check_summary(errors: int, warnings: int, can_arm: int, can_run: int) -> Notice:
    """First of the burst: failing components and the modes (bits by nav_state) that can be armed and run."""
    arguments = struct.pack("<BIIII", 0, errors, warnings, can_arm, can_run)
    return _event("commander_arming_check_summary", 0x88, arguments)


def check_failed(name: str, levels: int, modes: int, component: int, more: bytes = b"") -> Notice:
    """One failing check, the modes that it bars, and what else the event tells."""
    return _event(name, levels, struct.pack("<IB", modes & _ANY_MODE, component) + more)


def health_summary(errors: int, warnings: int) -> Notice:
    """Last of the burst."""
    return _event("commander_health_summary", 0x88, struct.pack("<BIII", 0, _HEALTH_PRESENT, errors, warnings))


def plan_refused(result: str) -> Notice:
    """Where PX4 answers on the wire only."""
    return Notice(0, 0, b"", CRITICAL, "", f"mission, fence or rally points refused: {result}")
