"""Transport delay: commands act late.

Past commands lie in a ring at the end of the state row, one entry a step.  A delay of n + f steps reads between two
entries: a command held for a step and delayed by a fraction of it acts, on average over the step, as their mixture.
"""

from __future__ import annotations

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import D_DELAY_STEPS, P_DT, S_COMMAND, S_CURSOR, S_RING, place
from flightstack.jit import njit
from flightstack.types import F64

DELAY = place("transport_delay", "delay_s")


@njit
def change(p: F64) -> None:
    """The delay in steps."""
    p[D_DELAY_STEPS] = p[DELAY] / p[P_DT]


@njit
def push(row: F64) -> None:
    """Put the row's new command into the ring: saturated at 0..1, and a motor whose command is not a number stands."""
    entries = (row.shape[0] - S_RING) // 4
    cursor = int(row[S_CURSOR]) + 1
    if cursor >= entries:
        cursor = 0
    row[S_CURSOR] = cursor
    at = S_RING + 4 * cursor
    for i in range(4):
        value = row[S_COMMAND + i]
        if value > 1.0:
            value = 1.0
        elif not value >= 0.0:  # also where it is NaN
            value = 0.0
        row[S_COMMAND + i] = value
        row[at + i] = value


@njit
def delayed(p: F64, row: F64, motor: int) -> float:
    """The command of one motor that acts now."""
    entries = (row.shape[0] - S_RING) // 4
    steps = p[D_DELAY_STEPS]
    cursor = int(row[S_CURSOR])
    if steps == 0.0:
        return float(row[S_RING + 4 * cursor + motor])
    whole = int(steps)
    fraction = steps - whole
    newer = cursor - whole
    if newer < 0:
        newer += entries
    older = newer - 1 if newer > 0 else entries - 1
    new, old = row[S_RING + 4 * newer + motor], row[S_RING + 4 * older + motor]
    return float((1.0 - fraction) * new + fraction * old)


EFFECT = Effect(
    name="transport_delay",
    params=(ParamSpec("delay_s", "s", 0.0, 0.0, 0.25),),
    kind="command",
    place="parameters",
    physics=change,
    equation="commands act late",
    source="dead time of a digital link with a hold of one step",
    words="a transport delay",
    scale=lambda size: 0.005,
    needs=("motor", "command"),
    manoeuvre="rate doublets and a thrust chirp up to 8 Hz, logged at 250 Hz",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"delay_s": 0.0125},
    has_states=True,
    turns_only=True,
)
