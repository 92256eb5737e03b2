"""Whether two logs hold the same flight, and whether what was named makes the file's vehicle another one.

An effect of the table changes one thing of a vehicle.  Another vehicle differs in all that its body and motors are:
thrust for its mass, moments of inertia, how fast its rotors answer.  Each may be far off alone (a file's thrust was
measured badly, a load was taped on), and then it is named; only all together are refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from flightstack.gap.decisions import LEAST_FLIGHT_S, MOSTLY, OTHER_EACH, OTHER_LARGER, OTHER_TOGETHER, TENTH
from flightstack.gap.records import IdentifiedEffect, Samples
from flightstack.gap.simulate import value
from flightstack.types import F64
from flightstack.vehicle import Vehicle

_LIFT, _TURN, _ANSWER = math.log(1.25), math.log(1.5), math.log(3.0)
"""Logarithms of the factors by which one effect changes thrust for its mass, inertia and lag on a vehicle that is
still the file's: such a change counts one."""


def same_flight(a: Samples, b: Samples) -> bool:
    """Whether two logs hold the same sensors' noise at the same times of their clocks: one flight recorded twice.

    A simulator may draw the same noise for each of its flights: then their velocities differ.
    """
    if a.dt_s < b.dt_s:
        a, b = b, a
    common = (a.t_s >= b.t_s[0]) & (a.t_s <= b.t_s[-1])
    if common.sum() * a.dt_s < LEAST_FLIGHT_S:
        return False

    def both(name: str) -> tuple[F64, F64]:
        own, theirs = getattr(a, name)[common], getattr(b, name)
        return own, np.stack([np.interp(a.t_s[common], b.t_s, column) for column in theirs.T], axis=1)

    x, y = (np.diff(each, axis=0) for each in both("accel_frd_mps2"))
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    if not x @ y > MOSTLY * np.sqrt((x @ x) * (y @ y)):  # nothing known: 0 is not above 0
        return False
    v, w = both("vel_ned_mps")
    seconds = max(1, round(common.sum() * a.dt_s))
    moved, apart = (
        np.nansum([np.nanmean(part, axis=0) ** 2 for part in np.array_split(each, seconds)]) for each in (v, v - w)
    )
    return bool(apart <= TENTH**2 * moved)


def vehicle_mismatch(
    believed: Vehicle, corrected: Vehicle, found: Sequence[IdentifiedEffect], *, unexplained: bool
) -> str:
    """How the log's vehicle differs, in words, where it can't be the file's; else empty."""
    if {"body.inertia_kgm2", "rotors.max_thrust_n"} <= set(believed.ranges):  # a file that says that it guesses
        return ""
    names = {each.name for each in found}
    if "inertia" not in names or not names & {"payload", "thrust_scale"}:
        return ""
    lift = _factor(believed, corrected, "thrust_scale", "scale") * believed.total_mass_kg / corrected.total_mass_kg
    turns = [_factor(believed, corrected, "inertia", f"scale_{axis}") for axis in "xyz"]
    answer = _factor(believed, corrected, "motor_lag", "time_constant_s")
    off_lift = abs(math.log(lift)) / _LIFT
    off_turns = [math.log(turn) / _TURN for turn in turns]
    off_turn = max(map(abs, off_turns))
    total = off_lift + off_turn + abs(math.log(answer)) / _ANSWER
    larger = min(off_turns) > 1.0 or max(off_turns) < -1.0
    if min(off_lift, off_turn) < OTHER_EACH or not (
        total >= OTHER_TOGETHER or (total >= OTHER_LARGER and larger and unexplained)
    ):
        return ""
    said = ", ".join(f"{turn:.2g}" for turn in turns)
    return f"thrust for its mass is {lift:.2g}, inertia {said} and motor lag {answer:.2g} times the file's"


def _factor(believed: Vehicle, corrected: Vehicle, effect: str, parameter: str) -> float:
    return value(corrected, effect, parameter) / value(believed, effect, parameter)
