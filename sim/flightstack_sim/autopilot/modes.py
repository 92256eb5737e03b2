"""PX4's flight modes as one table: how each looks on the wire and what it needs.

HEARTBEAT, CURRENT_MODE, AVAILABLE_MODES, DO_SET_MODE, the arming checks and the failsafes all read it.
`nav_state` is PX4's internal number of the mode (bit `nav_state` of the can_arm / can_run words in its events).
custom_mode = main << 16 | sub << 24.
Source: PX4 user guide "Flight Modes"; the figures were measured on PX4 1.18 with its SIH simulator.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import Final


class Need(Enum):
    """What a mode needs to run, besides a ready estimate."""

    NOTHING = auto()
    STICKS = auto()
    MISSION = auto()
    OFFBOARD_SIGNAL = auto()


# base_mode bits (MAV_MODE_FLAG)
CUSTOM: Final = 0x01
AUTO_BITS: Final = 0x1C  # auto, stabilize, guided
ATTITUDE_BIT: Final = 0x10
ARMED_BIT: Final = 0x80


@dataclass(frozen=True, slots=True, eq=False)
class Mode:
    """One flight mode; there is one object of each."""

    nav_state: int
    title: str
    main: int
    sub: int
    base_bits: int
    """HEARTBEAT.base_mode without the custom, armed and (OFFBOARD only) attitude bits."""
    standard_mode: int = 0
    """MAV_STANDARD_MODE of CURRENT_MODE and AVAILABLE_MODES."""
    need: Need = Need.NOTHING
    prevents_arming: bool = False
    """Arming is refused in this mode ("Mode not suitable for arming")."""
    kept_after_disarm: bool = True
    """False for the modes that end with a landing: after a disarm the mode chosen before them comes back."""
    label: str = ""
    """Name in AVAILABLE_MODES; empty where the standard mode says it."""
    properties: int = 1
    """MAV_MODE_PROPERTY of AVAILABLE_MODES: 1 advanced, 2 not user-selectable."""

    @property
    def custom_mode(self) -> int:
        """HEARTBEAT.custom_mode."""
        return self.main << 16 | self.sub << 24

    @property
    def bit(self) -> int:
        """The mode's bit in PX4's can_arm and can_run words."""
        return 1 << self.nav_state


_STICKS = Need.STICKS
MANUAL: Final = Mode(0, "Manual", 1, 0, 0x50, need=_STICKS, label="Manual")
ALTCTL: Final = Mode(1, "Altitude", 2, 0, 0x50, 4, _STICKS, properties=0)
POSCTL: Final = Mode(2, "Position", 3, 0, 0x50, 1, _STICKS, properties=0)
MISSION: Final = Mode(3, "Mission", 4, 4, AUTO_BITS, 6, Need.MISSION)
HOLD: Final = Mode(4, "Hold", 4, 3, AUTO_BITS, label="Hold")
RTL: Final = Mode(5, "Return", 4, 5, AUTO_BITS, 5, prevents_arming=True, kept_after_disarm=False)
POSITION_SLOW: Final = Mode(6, "Position Slow", 3, 2, 0x50, need=_STICKS, label="Position Slow")
ALTITUDE_CRUISE: Final = Mode(8, "Altitude Cruise", 11, 0, 0x50, need=_STICKS, label="Altitude Cruise")
ACRO: Final = Mode(10, "Acro", 5, 0, 0x40, need=_STICKS, label="Acro")
DESCEND: Final = Mode(12, "Descend", 4, 6, AUTO_BITS, prevents_arming=True, kept_after_disarm=False)
TERMINATION: Final = Mode(
    13, "Termination", 10, 0, 0, prevents_arming=True, kept_after_disarm=False, label="Termination", properties=3
)
OFFBOARD: Final = Mode(14, "Offboard", 6, 0, 0, need=Need.OFFBOARD_SIGNAL, label="Offboard")
STABILIZED: Final = Mode(15, "Stabilized", 7, 0, 0x50, need=_STICKS, label="Stabilized")
TAKEOFF: Final = Mode(17, "Takeoff", 4, 2, AUTO_BITS, 8, kept_after_disarm=False)
LAND: Final = Mode(18, "Land", 4, 6, AUTO_BITS, 7, prevents_arming=True, kept_after_disarm=False)
FOLLOW: Final = Mode(19, "Follow Target", 4, 8, AUTO_BITS, prevents_arming=True, label="Follow Target")
PRECLAND: Final = Mode(
    20, "Precision Landing", 4, 9, AUTO_BITS, prevents_arming=True, kept_after_disarm=False, label="Precision Landing"
)
ORBIT: Final = Mode(21, "Orbit", 3, 1, AUTO_BITS, 2, prevents_arming=True, kept_after_disarm=False)
VTOL_TAKEOFF: Final = Mode(22, "VTOL Takeoff", 4, 10, AUTO_BITS, kept_after_disarm=False, label="VTOL Takeoff")

MODES: Final[tuple[Mode, ...]] = (
    MANUAL, ALTCTL, POSCTL, MISSION, HOLD, RTL, POSITION_SLOW, ALTITUDE_CRUISE, ACRO, DESCEND, TERMINATION, OFFBOARD,
    STABILIZED, TAKEOFF, LAND, FOLLOW, PRECLAND, ORBIT, VTOL_TAKEOFF,
)  # fmt: skip
"""Every mode, in the order of nav_state."""

LISTED_MODES: Final[tuple[Mode, ...]] = tuple(mode for mode in MODES if mode is not DESCEND)
"""The modes of AVAILABLE_MODES, in PX4's order; the eight empty external slots follow them."""

EXTERNAL_SLOTS: Final[tuple[int, ...]] = tuple(4 << 16 | sub << 24 for sub in range(11, 19))
"""custom_mode of the places for external modes, all empty here."""

MAIN_AUTO: Final = 4
_EMPTY_STATES: Final = (7, 9, 11, 16, 31)

# What a client may choose; "ready" and "hold" are both Hold.
_BY_WIRE: Final = {(mode.main, mode.sub): mode for mode in MODES if mode is not DESCEND} | {(4, 1): HOLD}

# The mode table's bits as PX4 words.
POSITION_WORD: Final = sum(
    mode.bit
    for mode in (
        POSCTL, POSITION_SLOW, MISSION, HOLD, RTL, TAKEOFF, LAND, FOLLOW, PRECLAND, ORBIT, VTOL_TAKEOFF,
    )
)  # fmt: skip
"""Modes that need a horizontal position; OFFBOARD needs what its setpoints ask for, Descend needs none."""
STICKS_WORD: Final = sum(mode.bit for mode in MODES if mode.need is Need.STICKS)
MISSION_WORD: Final = MISSION.bit
PREVENTS_ARMING_WORD: Final = sum(mode.bit for mode in MODES if mode.prevents_arming)
KNOWN_WORD: Final = sum(mode.bit for mode in MODES) | sum(1 << state for state in _EMPTY_STATES)


def mode_for(main: int, sub: int) -> Mode | None:
    """The mode that a client names by main and sub mode; None where there is none.

    A main mode without sub modes ignores the sub number, as PX4 does.
    """
    mode = _BY_WIRE.get((main, sub))
    if mode is None and main not in (3, MAIN_AUTO):
        mode = _BY_WIRE.get((main, 0))
    return mode


def base_mode(mode: Mode, *, armed: bool, attitude_controlled: bool) -> int:
    """HEARTBEAT.base_mode; in OFFBOARD the attitude bit depends on what the setpoints ask for."""
    bits = CUSTOM | mode.base_bits
    if armed:
        bits |= ARMED_BIT
        if mode is OFFBOARD and attitude_controlled:
            bits |= ATTITUDE_BIT
    return bits
