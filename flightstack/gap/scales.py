"""How large a change of each parameter is one that matters on a given vehicle: for steps, priors and conditioning."""

from __future__ import annotations

from flightstack.effects import EFFECTS
from flightstack.effects.record import Size
from flightstack.types import STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle


def natural_scale(vehicle: Vehicle, effect: str, parameter: str) -> float:
    """A change of this parameter that moves the motion by some percent; positive, in the parameter's unit."""
    hover = min(1.0, (vehicle.mass_kg * STANDARD_GRAVITY_MPS2 / vehicle.max_total_thrust_n) ** 0.5)
    size = Size(
        mass_kg=vehicle.total_mass_kg,
        weight_n=vehicle.weight_n,
        inertia_kgm2=float(vehicle.inertia_kgm2.mean()),
        arm_m=float((vehicle.rotors.position_m[:, :2] ** 2).sum(axis=1).mean()) ** 0.5,
        turning_radps=4.0 * hover * vehicle.rotors.max_speed_radps,
    )
    scale = EFFECTS[effect].scale(size)
    return float(scale if isinstance(scale, float) else scale[parameter])
