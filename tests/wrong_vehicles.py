"""Vehicle files that are wrong for the vehicle that they are made from, each in one way that would make it fall."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from flightstack.vehicle import Vehicle


def _rotors(vehicle: Vehicle, order: tuple[int, ...], turns: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)) -> Vehicle:
    """Another order of places and turning directions, those besides multiplied."""
    rotors = vehicle.rotors
    places, ratios = rotors.position_m[list(order)], rotors.torque_ratio_m[list(order)] * np.array(turns)
    return replace(vehicle, rotors=replace(rotors, position_m=places, torque_ratio_m=ratios))


def _moved(vehicle: Vehicle, places: np.ndarray) -> Vehicle:
    return replace(vehicle, rotors=replace(vehicle.rotors, position_m=vehicle.rotors.position_m * places))


def _plus(vehicle: Vehicle) -> Vehicle:
    """The same arms turned by 45 degrees."""
    half = np.sqrt(0.5)
    turn = np.array([[half, -half, 0.0], [half, half, 0.0], [0.0, 0.0, 1.0]])
    return replace(vehicle, rotors=replace(vehicle.rotors, position_m=vehicle.rotors.position_m @ turn.T))


def _thrust(vehicle: Vehicle, factor: float) -> Vehicle:
    return replace(vehicle, rotors=replace(vehicle.rotors, max_thrust_n=vehicle.rotors.max_thrust_n * factor))


WRONG: dict[str, Callable[[Vehicle], Vehicle]] = {
    "right and left swapped": lambda v: _rotors(v, (2, 3, 0, 1)),
    "front and rear swapped": lambda v: _rotors(v, (3, 2, 1, 0)),
    "Betaflight's order": lambda v: _rotors(v, (3, 0, 1, 2)),
    "two rotors swapped": lambda v: _rotors(v, (0, 1, 3, 2)),
    "all turn the other way": lambda v: _rotors(v, (0, 1, 2, 3), (-1.0, -1.0, -1.0, -1.0)),
    "one turns the other way": lambda v: _rotors(v, (0, 1, 2, 3), (1.0, 1.0, -1.0, 1.0)),
    "plus for X": _plus,
    "one arm half as long": lambda v: _moved(v, np.array([[0.5] * 3, [1.0] * 3, [1.0] * 3, [1.0] * 3])),
    "two fifths of the thrust missing": lambda v: _thrust(v, 0.6),
    "two and a half times the thrust": lambda v: _thrust(v, 2.5),
}
"""Words -> the wrong vehicle of a right one."""
