"""A look at a flight before it begins: can JSBSim express the vehicle, and what its timed events make of it?"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from flightstack.vehicle import Vehicle
from flightstack_sim.jsbsim.library import library
from flightstack_sim.jsbsim.plant import JsbsimPlant


class Tried(NamedTuple):
    """What a log should say of a flight on JSBSim."""

    version: str
    aircraft_xml: str
    """The aircraft at the flight's beginning."""


def try_out(truth: Vehicle, events: Iterable[tuple[str, Mapping[str, float]]]) -> Tried:
    """Load the aircraft, and those that the events (effect, values) make of it; InputError where JSBSim can't."""
    plant = JsbsimPlant(truth, seed=0)
    found = Tried(str(library().__version__), plant.aircraft_xml)
    for effect, values in events:
        plant.set_effect(effect, values)
    return found
