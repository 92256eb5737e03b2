"""PX4's modes on the wire; the expected numbers are those of a real PX4 (its AVAILABLE_MODES and HEARTBEATs)."""

from __future__ import annotations

import pytest

from flightstack_sim.autopilot import modes

# (custom_mode, standard_mode, properties, name) in the order in which PX4 1.18 lists them
AVAILABLE = [
    (65536, 0, 1, "Manual"),
    (131072, 4, 0, ""),
    (196608, 1, 0, ""),
    (67371008, 6, 1, ""),
    (50593792, 0, 1, "Hold"),
    (84148224, 5, 1, ""),
    (33751040, 0, 1, "Position Slow"),
    (720896, 0, 1, "Altitude Cruise"),
    (327680, 0, 1, "Acro"),
    (655360, 0, 3, "Termination"),
    (393216, 0, 1, "Offboard"),
    (458752, 0, 1, "Stabilized"),
    (33816576, 8, 1, ""),
    (100925440, 7, 1, ""),
    (134479872, 0, 1, "Follow Target"),
    (151257088, 0, 1, "Precision Landing"),
    (16973824, 2, 1, ""),
    (168034304, 0, 1, "VTOL Takeoff"),
]


def test_the_listed_modes_are_those_of_px4_in_its_order() -> None:
    listed = [(mode.custom_mode, mode.standard_mode, mode.properties, mode.label) for mode in modes.LISTED_MODES]
    assert listed == AVAILABLE


def test_eight_external_slots_follow_the_listed_modes() -> None:
    assert modes.EXTERNAL_SLOTS[0] == 184811520
    assert modes.EXTERNAL_SLOTS[-1] == 302252032
    assert len(modes.LISTED_MODES) + len(modes.EXTERNAL_SLOTS) == 26


@pytest.mark.parametrize(
    ("mode", "armed", "attitude", "expected"),
    [
        (modes.HOLD, False, False, 0x1D),
        (modes.HOLD, True, False, 0x9D),
        (modes.HOLD, True, True, 0x9D),
        (modes.OFFBOARD, False, False, 0x01),
        (modes.OFFBOARD, False, True, 0x01),
        (modes.OFFBOARD, True, False, 0x81),
        (modes.OFFBOARD, True, True, 0x91),
        (modes.RTL, True, False, 0x9D),
        (modes.LAND, True, False, 0x9D),
        (modes.POSCTL, False, False, 0x51),
    ],
)
def test_base_mode_is_what_px4_sends(mode: modes.Mode, armed: bool, attitude: bool, expected: int) -> None:
    assert modes.base_mode(mode, armed=armed, attitude_controlled=attitude) == expected


@pytest.mark.parametrize(
    ("main", "sub", "mode"),
    [
        (6, 0, modes.OFFBOARD),
        (6, 77, modes.OFFBOARD),
        (4, 3, modes.HOLD),
        (4, 1, modes.HOLD),
        (4, 6, modes.LAND),
        (4, 5, modes.RTL),
        (4, 2, modes.TAKEOFF),
        (3, 0, modes.POSCTL),
        (3, 2, modes.POSITION_SLOW),
        (4, 99, None),
        (4, 11, None),
        (99, 0, None),
        (0, 0, None),
        (-1, -1, None),
    ],
)
def test_a_mode_is_found_by_its_two_numbers(main: int, sub: int, mode: modes.Mode | None) -> None:
    assert modes.mode_for(main, sub) is mode


def test_every_mode_has_its_own_nav_state() -> None:
    states = [mode.nav_state for mode in modes.MODES]
    assert len(set(states)) == len(states)
    assert states == sorted(states)
