"""What pushes to one side all the time on flights that keep their heading: in the world, in the body, or seemingly.

There a force, a wind, an accelerometer's bias and a tilt of the sensors are told apart by no more than what the
vehicle's leaning does to them.  In: a verdict whose model leaves something open, or stays far from the sensors' noise;
out: the same with one of the four at most, in a class with the others.

In front of a wall of fans a vehicle that kept its heading was told a sensor's tilt of 14 degrees, alone; a Crazyflie
indoors a wind of 4 m/s and, against it, an accelerometer that errs by 1.6 m/s^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flightstack.gap.classes import together
from flightstack.gap.concluded import Said, fitted_without, held_out_gap
from flightstack.gap.held import far_from_noise, interval_contains_nominal, upright
from flightstack.gap.name import Selection
from flightstack.gap.naming.estimate import STEADY_PUSHES
from flightstack.gap.records import IdentifiedEffect, Samples
from flightstack.gap.track import track
from flightstack.gap.verdict import closed_power, unexplained
from flightstack.vehicle import Vehicle
from flightstack_logs.turn import headings

_TURNS = 0.9
"""Mean resultant length of the headings below which they tell world from body: 26 degrees of deviation (Mardia)."""


def with_one_push(vehicle: Vehicle, said: Said) -> Said:
    """The verdict with the one of several steady pushes that, alone, leaves the least; `said` where one at most is
    named, the flights turn, or the model is a good one."""
    naming, of, gap = said
    open_ = naming.unexplained.significant or far_from_noise(gap)
    if not open_ or len(_pushes(naming)) < 2 or _turns(of.flights):
        return said
    tried = (_with_only(vehicle, (naming, of, gap), name) for name in _pushes(naming))
    naming, of, gap = max(tried, key=lambda each: closed_power(each[2]))
    left = unexplained(naming.unexplained, gap, named=bool(naming.found))
    return replace(naming, unexplained=left), of, gap


def _with_only(vehicle: Vehicle, said: Said, push: str) -> Said:
    """The verdict with this of the pushes, the other names fitted again; what is then sure to be nothing, or a wind
    that blows up or down, goes, too."""
    gone = [name for name in _pushes(said[0]) if name != push]
    while gone:
        said = fitted_without(vehicle, said, gone, "on one heading it is one class with another that is named")
        found = said[0].found
        gone = list(interval_contains_nominal(found)[-1:]) or [f.name for f in found if upright(f)]
    naming = said[0].as_wide_as_it_varies().with_guessed_numbers()
    return naming, said[1], held_out_gap(vehicle, naming, said[1])


def _pushes(naming: Selection) -> list[str]:
    return [f.name for f in naming.found if f.name in STEADY_PUSHES]


def on_one_heading(found: tuple[IdentifiedEffect, ...], flights: Sequence[Samples]) -> tuple[IdentifiedEffect, ...]:
    """The names, where no flight turns, each steady push in a class with the others."""
    if _turns(flights):
        return found
    names = {f.name for f in found}
    felt = any("accel_frd_mps2" not in track(s).missing for s in flights)
    twins = [n for n in STEADY_PUSHES if n not in names and (felt or n != "accelerometer_bias")]
    return tuple(together(f, tuple(twins)) if f.name in STEADY_PUSHES else f for f in found)


def _turns(flights: Sequence[Samples]) -> bool:
    heads = [headings(s.q_ned_frd[s.valid]) for s in flights]
    yaw = np.concatenate(heads) if heads else np.empty(0)
    yaw = yaw[np.isfinite(yaw)]
    return not len(yaw) or bool(abs(np.mean(np.exp(1j * yaw))) < _TURNS)
