"""What a client has stored in the vehicle: a mission, a geofence, rally points; which items PX4 takes.

Answers to bad items are PX4's, measured: an item that it does not know is UNSUPPORTED, a frame UNSUPPORTED_FRAME, a
fence's polygon of less than three corners an ERROR; coordinates that are none on this globe, NaN and polygons that
cross themselves are stored, and judged when they are to be flown.
"""

from __future__ import annotations

import math
import struct
import zlib
from enum import IntEnum
from typing import Final, NamedTuple

from flightstack.autopilot import float32

MISSION, FENCE, RALLY = 0, 1, 2
KINDS: Final = (MISSION, FENCE, RALLY)
ALL: Final = 255
MOST: Final = {MISSION: 65_534, FENCE: 64, RALLY: 32}
"""Items of each kind that fit; 0 of any other."""


class MissionResult(IntEnum):
    """MAV_MISSION_RESULT."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID_PARAM1 = 6
    CANCELLED = 15


class ItemCmd(IntEnum):
    """MAV_CMD numbers of items that mean something here."""

    WAYPOINT = 16
    LOITER_UNLIMITED = 17
    LOITER_TIME = 19
    RETURN = 20
    LAND = 21
    TAKEOFF = 22
    LOITER_TO_ALT = 31
    VTOL_TAKEOFF = 84
    VTOL_LAND = 85
    DELAY = 93
    CONDITION_DELAY = 112
    JUMP = 177
    CHANGE_SPEED = 178
    FENCE_RETURN = 5000
    POLYGON_INSIDE = 5001
    POLYGON_OUTSIDE = 5002
    CIRCLE_INSIDE = 5003
    CIRCLE_OUTSIDE = 5004
    RALLY_POINT = 5100


POLYGONS: Final = (ItemCmd.POLYGON_INSIDE, ItemCmd.POLYGON_OUTSIDE)
CIRCLES: Final = (ItemCmd.CIRCLE_INSIDE, ItemCmd.CIRCLE_OUTSIDE)
_NOT_IN_A_MISSION: Final = frozenset({*POLYGONS, *CIRCLES, ItemCmd.RALLY_POINT})
_ROI: Final = (80, 201)
_ROI_KINDS: Final = {2: (0, 1, 2), 6: (0, 3), 0: (0, 3), 3: (0, 3), 5: (0, 3)}
_RETURNED: Final[dict[int, str]] = {
    ItemCmd.WAYPOINT: "pp0h", ItemCmd.LOITER_UNLIMITED: "00ph", ItemCmd.LOITER_TIME: "pfpf", ItemCmd.LAND: "0w0h",
    ItemCmd.TAKEOFF: "000h", ItemCmd.VTOL_TAKEOFF: "000h", ItemCmd.VTOL_LAND: "000h", ItemCmd.LOITER_TO_ALT: "fp0f",
}  # fmt: skip
"""What a download gives back of an item's four parameters: p as it came, h a heading from 0 to 360 degrees, f 1 where
it was above 0, w a whole number of 16 bits, 0 nothing."""
_PLACED: Final = frozenset({16, 17, 19, 21, 22, 31, 80, 84, 85, 195, 201, 212, 400, 4501, 5000, *_NOT_IN_A_MISSION})
_UNPLACED: Final = frozenset(
    {20, 80, 93, 112, 114, 177, 178, 179, 187, 189, 196, 197, 200, 201, 203, 204, 205, 206, 211, 212, 214, 260, 400}
    | {530, 534, 2000, 2001, 2003, 2500, 2501, 3000, 42600}
)
_FRAME_MISSION: Final = 2
ABOVE_SEA: Final = (0, 5)
ABOVE_HOME: Final = (3, 6)
_LEAST_CORNERS: Final = 3


class Item(NamedTuple):
    """One item as it came; `x`, `y` are degrees where it has a place, else plain parameters."""

    frame: int
    command: int
    autocontinue: int
    params: tuple[float, float, float, float]
    x: float
    y: float
    z: float

    @property
    def placed(self) -> bool:
        """Whether x, y, z are a place on the globe."""
        return self.frame != _FRAME_MISSION

    @property
    def above_home(self) -> bool:
        """Whether z counts from home's height, not from the sea."""
        return self.frame in ABOVE_HOME


def judge(item: Item, kind: int) -> MissionResult:
    """What PX4 answers to an item of a plan of this kind."""
    if item.frame in (*ABOVE_SEA, *ABOVE_HOME):
        known = item.command in _PLACED
    elif item.frame == _FRAME_MISSION:
        known = item.command in _UNPLACED
    else:
        return MissionResult.UNSUPPORTED_FRAME
    if not known:
        return MissionResult.UNSUPPORTED
    if item.command in _ROI and _whole(item.params[0]) not in _ROI_KINDS[item.frame]:
        return MissionResult.INVALID_PARAM1
    if kind == MISSION and item.command in _NOT_IN_A_MISSION:
        return MissionResult.ERROR
    if kind == FENCE and item.command in POLYGONS and corners(item) < _LEAST_CORNERS:
        return MissionResult.ERROR
    return MissionResult.ACCEPTED


def returned(item: Item, kind: int) -> Item:
    """What a download gives back of an item: PX4 keeps what it understands of it."""
    if kind == FENCE:
        if not item.placed:
            item = item._replace(x=0.0, y=0.0)
        kept = item.command in (*CIRCLES, ItemCmd.WAYPOINT, ItemCmd.LOITER_TIME, ItemCmd.CHANGE_SPEED)
        first = float(corners(item)) if item.command in POLYGONS else item.params[0] if kept else 0.0
        return item._replace(
            frame=ABOVE_SEA[0] if item.placed else item.frame, autocontinue=0, params=(first, 0.0, 0.0, 0.0)
        )
    if item.placed:
        forms = _RETURNED.get(item.command, "0000")
        item = item._replace(command=_ROI[1]) if item.command == _ROI[0] else item
    else:
        forms = "wwpp" if item.command == ItemCmd.JUMP else "pppp"
        item = item._replace(x=float32(item.x), y=float32(item.y))
    one, two, three, four = (_formed(form, value) for form, value in zip(forms, item.params, strict=True))
    return item._replace(autocontinue=item.autocontinue & 1, params=(one, two, three, four))


def _formed(form: str, value: float) -> float:
    if form == "h":
        return value % 360.0 if math.isfinite(value) else math.nan
    if form == "f":
        return float(value > 0.0)
    if form == "w":
        return float(_whole(value) & 0xFFFF)
    return value if form == "p" else 0.0


def _whole(value: float) -> int:
    """Towards 0; of what is no number of 32 bits, the least one."""
    return int(value) if abs(value) < 2.0**31 else -(2**31)


def corners(item: Item) -> int:
    """Of a fence's polygon, as each of its corners states it."""
    count = item.params[0]
    return int(count + 0.5) if 0.0 <= count < 65_535.0 else 0


def checksum(items: tuple[Item, ...]) -> int:
    """A number that tells one plan from another; 0 for an empty one."""
    digest = 0
    for item in items:
        digest = zlib.crc32(struct.pack("<HHB7d", *item[:3], *item.params, *item[4:]), digest)
    return digest


class Plans:
    """One vehicle's plans, shared by its links."""

    __slots__ = ("_items", "current", "ids", "in_transfer", "jumps", "version")

    def __init__(self) -> None:
        self._items: dict[int, tuple[Item, ...]] = dict.fromkeys(KINDS, ())
        self.ids = dict.fromkeys(KINDS, 0)
        """Checksums, for MISSION_CURRENT and the like."""
        self.version = dict.fromkeys(KINDS, 0)
        """Counts what clients have stored."""
        self.current = 0
        """The mission item that is flown or flown next."""
        self.jumps = 0
        """Counts how often a client has chosen the current item."""
        self.in_transfer = False
        """One upload at a time, on whatever link."""

    def items(self, kind: int) -> tuple[Item, ...]:
        """The plan of a kind; empty where there is none."""
        return self._items.get(kind, ())

    @property
    def mission(self) -> tuple[Item, ...]:
        """The mission."""
        return self._items[MISSION]

    @property
    def fence(self) -> tuple[Item, ...]:
        """The geofence."""
        return self._items[FENCE]

    def store(self, kind: int, items: tuple[Item, ...], current: int = 0) -> None:
        """Replace a plan; the same once more changes nothing, as on PX4."""
        number = checksum(items)
        if items and number == self.ids[kind]:
            return
        self._items[kind], self.ids[kind] = items, number
        self.version[kind] += 1
        if kind == MISSION:
            self.current = current

    def set_current(self, seq: int) -> None:
        """A client wants this item flown next."""
        self.current = seq
        self.jumps += 1

    def clear(self, kind: int) -> None:
        """Delete one plan, or all."""
        for one in KINDS if kind == ALL else (kind,):
            if one in KINDS:
                self.store(one, ())
