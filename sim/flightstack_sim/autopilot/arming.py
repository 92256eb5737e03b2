"""The arming checks: which modes can be armed and run now, and the events that say why not.

PX4 evaluates them ten times a second and once more when somebody asks to arm; the words `can_arm` and `can_run` have
one bit a mode (bit number nav_state).  Reasons travel as EVENTs, re-sent when they change.
"""

from __future__ import annotations

from dataclasses import dataclass

from flightstack_sim.autopilot import modes, notices
from flightstack_sim.autopilot.modes import Mode
from flightstack_sim.autopilot.notices import Notice


@dataclass(frozen=True, slots=True)
class Conditions:
    """What the checks look at."""

    estimate_ready: bool
    offboard_signal: bool
    sticks: bool = False
    """Whether somebody's sticks are heard."""
    mission: bool = False
    """Whether a mission is loaded."""
    armed: bool = False
    """Whether it is armed already: nothing bars arming then."""
    position_valid: bool = True
    """Whether there is a horizontal position."""
    gcs_missing: bool = False
    """Whether a ground station is needed (NAV_DLL_ACT) and none is heard."""
    silent: tuple[str, ...] = ()
    """Of `notices.SILENT`, the sensors that give no data; they bar arming, not flying on."""


@dataclass(frozen=True, slots=True)
class Checks:
    """The verdict for one mode under one set of conditions."""

    conditions: Conditions
    mode: Mode
    can_arm: int
    can_run: int

    def arms(self, mode: Mode) -> bool:
        """Whether the vehicle may be armed in this mode."""
        return bool(self.can_arm & mode.bit)

    def runs(self, mode: Mode) -> bool:
        """Whether an armed vehicle may change to this mode."""
        return bool(self.can_run & mode.bit)


def check(mode: Mode, conditions: Conditions) -> Checks:
    """Evaluate every check; `mode` is the one chosen now (some modes bar arming as long as they are chosen)."""
    can_run = modes.KNOWN_WORD
    if not conditions.sticks:
        can_run &= ~modes.STICKS_WORD
    if not conditions.mission:
        can_run &= ~modes.MISSION_WORD
    if not conditions.offboard_signal:
        can_run &= ~modes.OFFBOARD.bit
    if not conditions.position_valid:
        can_run &= ~modes.POSITION_WORD
    ready = conditions.estimate_ready and not conditions.gcs_missing and not conditions.silent
    can_arm = can_run if ready else 0
    if mode.prevents_arming and not conditions.armed:
        can_arm &= ~modes.PREVENTS_ARMING_WORD
    return Checks(conditions, mode, can_arm, can_run)


def report(checks: Checks) -> tuple[Notice, ...]:
    """The burst of events that tells ground stations about the checks, in PX4's order.

    The summary's words of failing components hold one bit for every check that failed as an error or as a warning.
    """
    conditions = checks.conditions
    failed = []
    errors = warnings = 0
    if checks.mode.prevents_arming and not conditions.armed:
        barred = modes.PREVENTS_ARMING_WORD
        failed.append(notices.check_failed("check_modes_cannot_takeoff", 0x66, barred, notices.SYSTEM))
    if not conditions.mission:
        failed.append(notices.check_failed("check_modes_mission", 0x66, modes.MISSION_WORD, notices.SYSTEM))
    if not conditions.position_valid:
        failed.append(notices.check_failed("check_modes_local_pos", 0x33, modes.POSITION_WORD, notices.SYSTEM))
        errors |= 1 << notices.SYSTEM
    if not conditions.offboard_signal:
        barred = modes.OFFBOARD.bit
        failed.append(notices.check_failed("check_modes_offboard_signal", 0x33, barred, notices.SYSTEM))
        errors |= 1 << notices.SYSTEM
    if not conditions.sticks:
        failed.append(notices.check_failed("check_modes_manual_control", 0x44, ~0, notices.REMOTE_CONTROL))
        warnings |= 1 << notices.REMOTE_CONTROL
    if not conditions.estimate_ready:
        failed.append(notices.check_failed("check_estimator_heading_not_stable", 0x33, ~0, notices.SYSTEM))
        errors |= 1 << notices.SYSTEM
    if conditions.gcs_missing:
        failed.append(notices.check_failed("check_rc_dl_no_dllink", 0x33, ~0, notices.COMMUNICATION))
        errors |= 1 << notices.COMMUNICATION
    health = 0
    for name, component in (notices.SILENT[sensor] for sensor in conditions.silent):
        failed.append(notices.check_failed(name, 0x33, ~0, component, b"\0"))
        health |= 1 << component
    summary = notices.check_summary(errors, warnings, checks.can_arm, checks.can_run)
    return summary, *failed, notices.health_summary(health, 0)
