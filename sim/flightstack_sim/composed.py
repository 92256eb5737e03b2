"""The effects' physics put together by place (`flightstack.effects.record.Place`), in the table's order, compiled.

Compiled code can't loop over a table of functions: each function here calls the one that holds the effects before, then
its own effect.  Inlined, nothing is left of that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flightstack.effects import EFFECTS
from flightstack.effects.record import Place
from flightstack.jit import njit


def _change(earlier: Any, physics: Any) -> Callable[..., Any]:
    def changed(p: Any) -> None:
        earlier(p)
        physics(p)

    return changed


def _sum(earlier: Any, physics: Any) -> Callable[..., Any]:
    def total(start: float, *arguments: Any) -> Any:
        return earlier(start, *arguments) + physics(*arguments)

    return total


def _vector_sum(earlier: Any, physics: Any) -> Callable[..., Any]:
    def total(start: Any, *arguments: Any) -> Any:
        x, y, z = earlier(start, *arguments)
        more = physics(*arguments)
        return (x + more[0], y + more[1], z + more[2])

    return total


def _product(earlier: Any, physics: Any) -> Callable[..., Any]:
    def total(start: float, p: Any, *arguments: Any) -> Any:
        value = earlier(start, p, *arguments)
        return value * physics(p, value, *arguments)

    return total


def _composed(name: str, place: Place, link: Callable[..., Any]) -> Any:
    def nothing(start: Any, *arguments: Any) -> Any:
        return start

    nothing.__name__ = name
    function = njit(nothing)
    for effect in EFFECTS.values():
        if effect.place == place:
            linked = link(function, effect.physics)
            linked.__name__ = name
            function = njit(linked)
    return function


change = _composed("change", "parameters", _change)
"""(p): what the effects make of the vehicle's parameters."""
added_thrust = _composed("added_thrust", "added thrust", _sum)
"""(start, p, thrust_n, hub_air): start and what the rotor gains."""
thrust = _composed("thrust", "thrust factor", _product)
"""(start, p, hub_air, height_m): start times all factors, each of which knows the thrust so far."""
hub_force = _composed("hub_force", "hub force", _vector_sum)
"""(start, p, speed_radps, hub_air): start and the forces at one hub."""
hub_torque = _composed("hub_torque", "hub torque", _vector_sum)
"""(start, p, speed_radps, hub_air): start and the torques of one rotor."""
body_force = _composed("body_force", "body force", _vector_sum)
"""(start, p, air): start and the forces at the CoM."""
body_torque = _composed("body_torque", "body torque", _vector_sum)
"""(start, p, rate): start and the torques."""
world_force = _composed("world_force", "world force", _vector_sum)
"""(start, p): start and the forces fixed in the world, NED."""
wind = _composed("wind", "wind", _vector_sum)
"""(start, p): start and the steady velocities of the air, NED."""
SUMS = ("added_thrust", "thrust", "hub_force", "hub_torque", "body_force", "body_torque", "world_force", "wind")
"""What gives `start` back where no effect acts."""
