"""What is known before take-off: how far the true mass and an unknown force may be from what is believed.

With the thrust vector f (believed newton per believed kilogram, NED, thrust is -f), mass ratio r = true / believed and
an unknown force w (m/s^2 of the true mass, any direction, |w| at most `force_weights` g), the true acceleration is

    a = g e_d + (drag - f) / r + w

so along each axis it lies in an interval that is affine in f and exact at its corners.  Everything that the model does
not explain counts as force: drag that it doesn't know, the ground's nearness, gusts.

A vehicle that can hardly lift itself is not flown: `require_authority` refuses knowledge whose worst corner (greatest
mass, force down, thrust limit) leaves less than 0.05 g upwards.  Source: PAPER, section V.B: mass 1.4 times the
believed one, 0.1 g of wind, thrust up to 1.8 believed weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flightstack.model import Limits, Model
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, InputError, Tuple3

DOWN = 2
LEAST_AUTHORITY_WEIGHTS = 0.05
"""Upward acceleration that must be left beyond carrying the vehicle, in g."""
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class InitialKnowledge:
    """Bounds that hold whatever the flight will show."""

    mass_ratio: tuple[float, float] = (0.8, 1.5)
    """True over believed mass: least, greatest."""
    force_weights: float = 0.15
    """Greatest unknown force in any direction, in true weights."""

    def interval(self, axis: int, force_mps2: F64) -> tuple[F64, F64]:
        """Least and greatest true acceleration (m/s^2) along an axis for a believed specific force along it.

        `force_mps2`, any shape: thrust and modelled drag by the believed mass, NED, so upward thrust is negative.
        """
        gravity = STANDARD_GRAVITY_MPS2 if axis == DOWN else 0.0
        ends = force_mps2 / self.mass_ratio[0], force_mps2 / self.mass_ratio[1]
        room = self.force_weights * STANDARD_GRAVITY_MPS2
        return gravity + np.minimum(*ends) - room, gravity + np.maximum(*ends) + room

    @property
    def gain(self) -> tuple[float, float]:
        """Least and greatest delivered over believed specific thrust."""
        return 1.0 / self.mass_ratio[1], 1.0 / self.mass_ratio[0]


def vertical_authority_weights(thrust_weights: float, mass_ratio: float, force_weights: Tuple3) -> float:
    """Upward acceleration (g) left at full thrust (believed weights), a horizontal force being balanced by tilt.

    `force_weights`: north, east, down, in true weights.  Minus infinity where thrust cannot even balance it.
    """
    thrust, across = thrust_weights / mass_ratio, math.hypot(force_weights[0], force_weights[1])
    if thrust <= across:
        return -math.inf
    return math.sqrt(thrust * thrust - across * across) - 1.0 - force_weights[2]


def require_authority(knowledge: InitialKnowledge, model: Model, limits: Limits, source: str = "knowledge") -> float:
    """The upward authority (g) left in the worst corner of the knowledge; InputError where it is below 0.05 g.

    Of all directions of the force, down leaves least: turning it sideways by an angle costs less than it gives back.
    """
    thrust = model.thrust_range_n(limits)[1] / model.weight_n
    heaviest, force = knowledge.mass_ratio[1], knowledge.force_weights
    left = vertical_authority_weights(thrust, heaviest, (0.0, 0.0, force))
    if left < LEAST_AUTHORITY_WEIGHTS - _ROUNDING:
        raise InputError(
            f"{source}: {thrust:.3g} believed weights of thrust, a mass up to {heaviest:.3g} times the believed one "
            f"and a force up to {force:.3g} g down leave {left:.3f} g to climb with; at least "
            f"{LEAST_AUTHORITY_WEIGHTS:g} g is needed: narrow mass_ratio or force_weights, or allow more thrust"
        )
    return left
