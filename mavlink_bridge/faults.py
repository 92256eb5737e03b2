"""Everything that can go wrong round the companion: one table, `faults.toml`.

A row says what happens, how it is noticed and from when on, what is done about it, how long that takes (from the fault
to the companion's deed, measured in the test that the row names), and the test.  `docs/safety.md` holds the same table,
and a test keeps both and the tests' names together.

PX4 goes on with the last setpoint that it got until COM_OF_LOSS_T has passed.  So whoever stops sending says safe last
words first: level, no rotation, the thrust that carried so far; then a mode of PX4's.
"""

from __future__ import annotations

import tomllib
from enum import Enum
from importlib import resources
from typing import NamedTuple


class Reaction(Enum):
    """What the companion does."""

    REREFERENCE = "goes on: the jump is taken out of the position, nothing is chased"
    LAND = "hands back: safe words until PX4 is seen in its Land"
    HOLD = "hands back: safe words until PX4 is seen in its Hold, then silence"
    HANDS_OFF = "hands off: silence, no way back but a new run"
    STOP = "brakes, then PX4's Land"
    REFUSE = "refuses before the flight, one line says why; no setpoint is sent"
    DROP = "drops the frame and counts it"
    PX4 = "nothing: PX4's own offboard-loss failsafe acts"
    DEAD_MAN = "the dead-man levels by body rates and commands PX4's Hold"
    RETAKE = "the dead-man levels and commands PX4's Hold; OFFBOARD is taken back, at most once in 10 s"


class FaultReaction(NamedTuple):
    """A row."""

    what: str
    """In words."""
    noticed: str
    """By what, and from when on."""
    reaction: Reaction
    after_s: float | None
    """From the fault to the deed, measured by the test (250 Hz lockstep); None where time has no meaning."""
    test: str
    """File under tests/ and name of the test that shows it."""


_TABLE = tomllib.loads(resources.files("mavlink_bridge").joinpath("faults.toml").read_text(encoding="utf-8"))
FAULTS: dict[str, FaultReaction] = {
    name: FaultReaction(row["what"], row["noticed"], Reaction[row["reaction"]], row.get("after_s"), row["test"])
    for name, row in _TABLE.items()
}
