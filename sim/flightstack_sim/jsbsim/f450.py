"""JSBSim's own F450, a DJI quadrotor: its mass, gear, drag, motors and propellers as JSBSim ships them.

A vehicle file named `f450` flies as this aircraft: propellers with thrust and power tables over the advance ratio,
turned by brushless motors.  Left out are its autopilot and sensors, which are this project's; mass and inertia are the
vehicle file's (the same numbers), so that a flight may change them.  Only what acts from outside can be added to it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final
from xml.etree import ElementTree

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.types import InputError
from flightstack.vehicle import Vehicle
from flightstack_sim.jsbsim import air, text
from flightstack_sim.jsbsim.aircraft import IDLE, Aircraft, Effects

if TYPE_CHECKING:
    from collections.abc import Mapping

NAME: Final = "f450"
_SECTIONS: Final = ("Metrics", "Gear", "Propulsion", "Effectors", "Aero")
_ESC: Final = tuple(f"fcs/cmdEsc{place}_nd" for place in ("FR", "AL", "FL", "AR"))
"""Front right, aft left, front left, aft right: PX4's order."""
TAKEN: Final = frozenset(
    {"payload", "inertia", "steady_wind", "constant_force", "turbulence"}
    | {name for name, spec in EFFECTS.items() if spec.kind == "sensor"}
)
"""Effects that can be added to it."""
GEAR_M: Final = 0.1524
_GEAR_SPRING_NPM: Final = 3000.0
_FEET: Final = ('type="BOGEY"', 'type="STRUCTURE"')
"""Its contacts are shipped as wheels, on which any wind would roll it away."""
_PLACE_M: Final = 1e-6
_FULL_RPM: Final = 10_604.6
_SPIN_UP_FRAMES: Final = 400
"""JSBSim's propellers can't be given a speed: they run up to what the commands ask for, in about 60 ms."""


def refuse(vehicle: Vehicle) -> None:
    """InputError where the vehicle has an effect that would change JSBSim's own model."""
    for name, values in vehicle.effects.items():
        if name not in TAKEN and not EFFECTS[name].is_null(values):
            raise InputError(
                f"{vehicle.name}: effects.{name} cannot be added to JSBSim's own F450 (its rotors, drag and gear are "
                f"JSBSim's); it takes {', '.join(sorted(TAKEN))}. Or fly --plant native"
            )


def write(vehicle: Vehicle, shipped: Path, *, dt_s: float, gravity_mps2: float, seed: int) -> Aircraft:
    """The aircraft; `shipped`: the folder of JSBSim's data."""
    refuse(vehicle)
    sections = _shipped(shipped)
    _check_places(vehicle, sections["Propulsion.xml"])
    effects = Effects(vehicle)
    still = EFFECTS["turbulence"].is_null(vehicle.effects.get("turbulence", {}))
    gusts = air.STILL if still else air.gusts(effects, dt_s, seed)
    ix, iy, iz = (a * b for a, b in zip(vehicle.inertia_kgm2.tolist(), effects.xyz("inertia"), strict=True))
    body = text.mass_balance(vehicle.mass_kg, (ix, iy, iz), (0.0, 0.0, 0.0), effects("payload", "mass_kg"))
    declared = "".join(text.declare(name, value) for name, value in {**dict.fromkeys(_ESC, 0.0), **gusts.first}.items())
    xml = (
        f'<?xml version="1.0"?>\n<fdm_config name="{NAME}" version="2.0" release="BETA">'
        f'<metrics file="Metrics.xml"/>{body}<ground_reactions file="Gear.xml"/><propulsion file="Propulsion.xml"/>'
        f'<system file="Effectors.xml"/><flight_control name="{NAME}">{declared}'
        f'<channel name="{NAME}">{"".join(gusts.components)}</channel></flight_control>'
        f'<aerodynamics file="Aero.xml"/>'
        f"<external_reactions>{air.constant_force(effects, (0.0, 0.0, 0.0))}</external_reactions></fdm_config>\n"
    )
    engines = tuple(f"propulsion/engine[{i}]" for i in range(4))
    rpm = tuple(f"{engine}/propeller-rpm" for engine in engines)
    return Aircraft(
        name=NAME,
        files={f"{NAME}.xml": xml, **sections},
        commands=_ESC,
        thrusts=tuple(f"{engine}/thrust-lbs" for engine in engines),
        thrust_unit_n=text.POUND_N,
        speeds=rpm,
        speed_unit=1.0 / _FULL_RPM,
        states=tuple(gusts.first),
        voltage=None,
        settle_frames=_SPIN_UP_FRAMES,
        rest_height_m=GEAR_M - vehicle.total_mass_kg * gravity_mps2 * 0.375 / _GEAR_SPRING_NPM,
        idle=tuple(name for name in IDLE if name not in ("Aerodynamics", "Atmosphere", "Propulsion")),
        first={**gusts.first, **air.wind(effects)},
    )


def _check_places(vehicle: Vehicle, propulsion: str) -> None:
    """InputError where the file's rotors sit elsewhere than JSBSim's: they would fly where JSBSim has them."""
    places = [
        (-float(thruster.findtext("location/x", "nan")), float(thruster.findtext("location/y", "nan")))
        for thruster in ElementTree.fromstring(propulsion).iter("thruster")
    ]
    own = vehicle.rotors.position_m[:, :2]
    if len(places) != len(own) or not np.allclose(places, own, atol=_PLACE_M):
        said = ", ".join(f"({x:g}, {y:g})" for x, y in places)
        raise InputError(
            f"{vehicle.name}: its rotors are not where JSBSim's own F450 has them (x, y: {said} m), which flies under "
            "that name: give the vehicle another name, or fly --plant native"
        )


def _shipped(folder: Path) -> Mapping[str, str]:
    """The sections that JSBSim ships."""
    found = {}
    for section in _SECTIONS:
        path = folder / "aircraft" / "F450" / f"{section}.xml"
        try:
            found[path.name] = path.read_text(encoding="utf-8").replace(*_FEET)
        except OSError as error:
            raise InputError(f"--plant jsbsim: JSBSim's F450 is incomplete: {path}: {error.strerror}") from None
    return found
