"""Before the flight: everything that was looked at, whether it is as a flight needs it, and what was seen.  Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from flightstack.model import Limits
from mavlink_bridge import messages as m
from mavlink_bridge.decide import CompanionConfig, estimate_is_good
from mavlink_bridge.px4 import AUTOPILOT_PX4, TYPE_QUADROTOR
from mavlink_bridge.requests import STREAMS
from mavlink_bridge.vehicle_params import OPTIONAL, findings
from mavlink_bridge.vehicle_view import VehicleView

_ENOUGH = 0.5
"""Share of the rate asked for that a stream without a limit of its own must reach."""
_MODE_HZ = 1.0
"""CURRENT_MODE comes with every change and at 2 Hz besides, whatever is asked for; an older one than 1.5 s is not
trusted in flight."""
_VERSION_KINDS = {0: "dev", 64: "alpha", 128: "beta", 192: "rc", 255: "release"}


class ChecklistEntry(NamedTuple):
    """One thing looked at; `said`: what was seen, or what is wrong with it."""

    check: str
    ok: bool
    said: str


class Inspection(NamedTuple):
    """What a dry run found besides the vehicle's own messages."""

    rates_hz: Mapping[type, float]
    """Measured rate of every kind of message."""
    contradictions: Sequence[str]
    """What PX4's parameters say against the vehicle file."""
    unsettled: str
    """What only the first hover can decide; empty: nothing."""
    reason: str
    """Why a flight would not have begun; empty: it would."""
    protection: str = ""
    """What would protect it, where protection is asked for."""
    unprotected: str = ""
    """Why it would not be protected all the same."""


def checklist(view: VehicleView, found: Inspection, config: CompanionConfig, limits: Limits) -> list[ChecklistEntry]:
    """The checklist, the verdict last; it stops where nothing more could be heard."""
    checks = list(_checks(view, found, config, limits))
    failed = [check.check for check in checks if not check.ok]
    said = found.reason or (f"not as a flight needs it: {', '.join(failed)}" if failed else "ready to fly")
    return [*checks, ChecklistEntry("verdict", not failed and not found.reason, said)]


def _checks(view: VehicleView, found: Inspection, config: CompanionConfig, limits: Limits) -> Iterator[ChecklistEntry]:
    heartbeat = view.heartbeat
    if heartbeat is None:
        yield ChecklistEntry("vehicle", False, "no heartbeat of an autopilot")
        return
    known = heartbeat.autopilot == AUTOPILOT_PX4 and heartbeat.type == TYPE_QUADROTOR
    armed = ", armed" if view.armed else ""
    what = "PX4, quadrotor" if known else f"MAV_AUTOPILOT {heartbeat.autopilot}, MAV_TYPE {heartbeat.type}"
    yield ChecklistEntry("vehicle", known and not view.armed, f"{what}, in {view.mode_name}{armed}")
    if view.version is None:
        yield ChecklistEntry("version", False, "AUTOPILOT_VERSION was not answered")
        return
    yield ChecklistEntry("version", True, version_words(view.version))
    yield from _parameters(view, config.dead_man)
    yield ChecklistEntry(
        "vehicle file", not found.contradictions, "; ".join(found.contradictions) or found.unsettled or _agreed(view)
    )
    yield from _streams(found.rates_hz, limits)
    yield ChecklistEntry(
        "estimate", estimate_is_good(view.estimator_flags), f"ESTIMATOR_STATUS flags {view.estimator_flags:#x}"
    )
    yield ChecklistEntry(
        "landed state", view.on_ground, {1: "on the ground"}.get(view.landed_state, f"{view.landed_state}")
    )
    if found.protection:
        yield ChecklistEntry("protection", not found.unprotected, found.unprotected or found.protection)
    trip_s = 1e-6 * view.round_trip_us
    yield ChecklistEntry("round trip", 0.0 < trip_s <= config.round_trip_max_s, f"{1e3 * trip_s:.1f} ms")


def _parameters(view: VehicleView, dead_man: bool) -> Iterator[ChecklistEntry]:
    values = view.params.values
    for name in view.params.missing:
        yield ChecklistEntry(name, False, "not told, and nobody flies without it")
    for name, problem in findings(values, dead_man=dead_man):
        if name in values:
            yield ChecklistEntry(name, not problem, problem or f"{values[name]:g}")
    for name in ("THR_MDL_FAC", "MPC_THR_HOVER"):
        if name in values:
            yield ChecklistEntry(name, True, f"{values[name]:g}")
    if (scaled := values.get("MC_BAT_SCALE_EN")) is not None:
        yield ChecklistEntry(
            "MC_BAT_SCALE_EN", not scaled, "on: PX4 changes thrust with the battery" if scaled else "0"
        )


def _agreed(view: VehicleView) -> str:
    untold = [name for name in OPTIONAL if name.startswith("CA_ROTOR") and name not in view.params.values]
    return f"agrees as far as PX4 tells ({untold[0]} is not told)" if untold else "rotors and hover thrust agree"


def _streams(rates_hz: Mapping[type, float], limits: Limits) -> Iterator[ChecklistEntry]:
    """Streams that the state is made of must be young enough at every tick; the others at half the rate asked for."""
    age_max_us = {
        m.AttitudeQuaternion: limits.attitude_age_max_us,
        m.LocalPositionNed: limits.position_age_max_us,
        m.HighresImu: limits.imu_age_max_us,
    }
    for message, interval_us in STREAMS:
        if interval_us <= 0:
            continue
        asked_hz, seen_hz = 1e6 / interval_us, rates_hz.get(message, 0.0)
        needed_hz = _MODE_HZ if message is m.CurrentMode else _ENOUGH * asked_hz
        if message in age_max_us:
            needed_hz = 1e6 / age_max_us[message]
        words = f"{seen_hz:.0f} Hz (asked for {asked_hz:.0f}, needs {needed_hz:.0f})"
        if message is m.GpsRawInt and seen_hz == 0.0:
            needed_hz, words = 0.0, "none comes: no receiver, so no satellites that can be lost"
        yield ChecklistEntry(m.BY_EVENT[message].name, seen_hz >= needed_hz, words)


def version_words(version: m.AutopilotVersion) -> str:
    """PX4's version and git hash."""
    number = version.flight_sw_version
    kind = _VERSION_KINDS.get(number & 0xFF, f"type {number & 0xFF}")
    git = bytes(reversed(version.flight_custom_version)).hex()[:8]
    return f"PX4 {number >> 24}.{number >> 16 & 0xFF}.{number >> 8 & 0xFF} {kind}, git {git}"
