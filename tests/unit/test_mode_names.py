"""Modes in PX4's words, by its custom_mode (main << 16 | sub << 24), px4_custom_mode.h of PX4 v1.16."""

from __future__ import annotations

import pytest

from mavlink_bridge.px4 import describe_mode


@pytest.mark.parametrize(
    ("main", "sub", "name"),
    [
        (3, 0, "POSCTL"),
        (3, 1, "ORBIT"),
        (3, 2, "POSITION_SLOW"),
        (4, 3, "AUTO.HOLD"),
        (4, 10, "AUTO.VTOL_TAKEOFF"),
        (4, 11, "AUTO.EXTERNAL1"),
        (4, 18, "AUTO.EXTERNAL8"),
        (4, 30, "AUTO.30"),
        (6, 0, "OFFBOARD"),
        (11, 0, "ALTITUDE_CRUISE"),
        (12, 0, "main mode 12"),
    ],
)
def test_a_mode_has_px4s_name(main: int, sub: int, name: str) -> None:
    """DO_ORBIT's mode is a sub mode of POSCTL: a flight that was taken by it was said to have gone to POSCTL."""
    assert describe_mode(main << 16 | sub << 24) == name
