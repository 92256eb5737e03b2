"""The arming checks and the events that report them; the payloads are those a real PX4 sent."""

from __future__ import annotations

import pytest

from flightstack_sim.autopilot import arming, modes, notices
from flightstack_sim.autopilot.arming import Conditions

READY = Conditions(estimate_ready=True, offboard_signal=False)
STREAMING = Conditions(estimate_ready=True, offboard_signal=True)
NOT_READY = Conditions(estimate_ready=False, offboard_signal=True, sticks=True, mission=True)

SUMMARY, MISSION, OFFBOARD, STICKS, CANNOT, HEALTH = (
    0x01A893E0, 0x0105C2D9, 0x012F1DC7, 0x0106ED29, 0x011C8F61, 0x011D3727,
)  # fmt: skip


def burst(mode: modes.Mode, conditions: Conditions) -> list[tuple[int, int, str]]:
    """(event id, log levels, arguments without trailing zeros) of the report."""
    report = arming.report(arming.check(mode, conditions))
    return [(notice.event_id, notice.log_levels, notice.arguments.rstrip(b"\0").hex()) for notice in report]


def test_in_hold_without_a_stream_the_events_are_px4s_byte_for_byte() -> None:
    assert burst(modes.HOLD, READY) == [
        (SUMMARY, 0x88, "000000100080000000b03a7f80b03a7f80"),
        (MISSION, 0x66, "0800000014"),
        (OFFBOARD, 0x33, "0040000014"),
        (STICKS, 0x44, "ffffffff07"),
        (HEALTH, 0x88, "000a1c0238"),
    ]


def test_with_a_stream_the_offboard_event_is_gone_and_its_bit_is_set() -> None:
    assert burst(modes.HOLD, STREAMING) == [
        (SUMMARY, 0x88, "000000000080000000b07a7f80b07a7f80"),
        (MISSION, 0x66, "0800000014"),
        (STICKS, 0x44, "ffffffff07"),
        (HEALTH, 0x88, "000a1c0238"),
    ]


def test_in_a_landing_mode_arming_is_barred_for_all_such_modes() -> None:
    assert burst(modes.LAND, READY) == [
        (SUMMARY, 0x88, "000000100080000000900a4380b03a7f80"),
        (CANNOT, 0x66, "20303c0014"),
        (MISSION, 0x66, "0800000014"),
        (OFFBOARD, 0x33, "0040000014"),
        (STICKS, 0x44, "ffffffff07"),
        (HEALTH, 0x88, "000a1c0238"),
    ]


@pytest.mark.parametrize("mode", modes.MODES, ids=lambda mode: mode.title)
def test_nothing_arms_before_the_estimate_is_ready(mode: modes.Mode) -> None:
    assert not arming.check(mode, NOT_READY).arms(mode)


@pytest.mark.parametrize(
    ("mode", "conditions", "arms"),
    [
        (modes.HOLD, READY, True),
        (modes.TAKEOFF, READY, True),
        (modes.OFFBOARD, READY, False),
        (modes.OFFBOARD, STREAMING, True),
        (modes.POSCTL, STREAMING, False),
        (modes.MANUAL, STREAMING, False),
        (modes.ALTCTL, STREAMING, False),
        (modes.STABILIZED, STREAMING, False),
        (modes.POSCTL, Conditions(True, False, sticks=True), True),
        (modes.LAND, STREAMING, False),
        (modes.RTL, STREAMING, False),
        (modes.MISSION, STREAMING, False),
    ],
)
def test_a_mode_arms_only_with_what_it_needs(mode: modes.Mode, conditions: Conditions, arms: bool) -> None:
    assert arming.check(mode, conditions).arms(mode) is arms


def test_landing_runs_without_sticks_stream_or_mission() -> None:
    checks = arming.check(modes.HOLD, READY)
    assert checks.runs(modes.LAND)
    assert checks.runs(modes.RTL)
    assert not checks.runs(modes.OFFBOARD)
    assert not checks.runs(modes.POSCTL)


@pytest.mark.parametrize(
    ("notice", "event_id", "levels", "arguments", "text"),
    [
        (notices.armed(notices.BY_COMMAND), 0x0190CAF3, 0x66, "04", "Armed by external command\t"),
        (notices.disarmed(notices.BY_PREFLIGHT), 0x01F46777, 0x66, "07", "Disarmed by auto preflight disarming\t"),
        (notices.disarmed(notices.BY_LANDING), 0x01F46777, 0x66, "06", "Disarmed by landing\t"),
        (notices.TAKEOFF_DETECTED, 0x01414569, 0x66, "", "Takeoff detected\t"),
        (notices.LANDING_DETECTED, 0x019638AC, 0x66, "", "Landing detected\t"),
        (notices.failsafe(0x00060000, 6), 0x01DEDBD0, 0x42, "0000060006", "Failsafe activated\t"),
        (notices.DISARMING_DENIED, 0x018AB9B5, 0x62, "", "Disarming denied: not landed\t"),
        (
            notices.ARMING_DENIED, 0x0102089D, 0x62, "", "Arming denied: Resolve system health failures first\t",
        ),
        (
            notices.return_start(495, 5), 0x01522694, 0x66, "ef01000005000000",
            "RTL: start return at 495 m (5 m above destination)\t",
        ),
        (notices.RTL_LANDS, 0x0102D3AA, 0x66, "", "RTL: land at destination\t"),
        (notices.UNSUPPORTED_MAIN_MODE, 0x012A3F67, 0x33, "", "Unsupported main mode\t"),
        (notices.unsupported_arm_param(2.0), 0x01253B9D, 0x33, "00000040", "Unsupported ARM_DISARM param: 2.000\t"),
    ],
)  # fmt: skip
def test_what_the_vehicle_says_is_what_px4_said_byte_for_byte(
    notice: notices.Notice, event_id: int, levels: int, arguments: str, text: str
) -> None:
    assert (notice.event_id, notice.log_levels, notice.arguments.hex()) == (event_id, levels, arguments)
    assert notice.text == text
