"""JSBSim's XML, written: its components, and the units that it reckons in.

All terms (`flightstack.effects.expressions`) are in SI; only what goes into a force or a moment, or comes out of a
velocity, is converted.
"""

from __future__ import annotations

from typing import Final

from flightstack.effects.expressions import Term, term, times

FOOT_M: Final = 0.3048
INCH_M: Final = 0.0254
POUND_N: Final = 4.4482216152605
SLUG_KG: Final = POUND_N / FOOT_M
POUND_PER_SLUG: Final = 32.174049
"""JSBSim's own factor between weight and mass: with it masses arrive as given."""

XYZ = tuple[float, float, float]


def function(name: str, value: Term) -> str:
    """A named function: evaluated once a step, then a property of that name."""
    return f'<function name="{name}">{term(value)}</function>'


def declare(name: str, value: float) -> str:
    """A property of our own with its first value."""
    return f'<property value="{float(value)!r}">{name}</property>'


def state(name: str, value: Term) -> str:
    """A component that gives the property `name` a new value each step; the value may read the property's last one."""
    component = name.replace("/", "-")
    return (
        f'<fcs_function name="fcs/{component}"><function>{term(value)}</function><output>{name}</output></fcs_function>'
    )


def delayed(source: str, output: str, frames: int) -> str:
    """A component that hands `source` on after so many steps."""
    delay = f'<delay type="frames">{frames + 1}</delay>' if frames else ""
    component = output.replace("/", "-")
    return f'<actuator name="fcs/{component}"><input>{source}</input>{delay}<output>{output}</output></actuator>'


def location(frd_m: XYZ, *, name: str = "") -> str:
    """A place given in FRD from the file's origin, in JSBSim's structural frame (aft, right, up; inches)."""
    x, y, z = frd_m
    named = f' name="{name}"' if name else ""
    return f'<location{named} unit="IN"><x>{-x / INCH_M!r}</x><y>{y / INCH_M!r}</y><z>{-z / INCH_M!r}</z></location>'


def _direction(axis: XYZ) -> str:
    return "<direction>" + "".join(f"<{k}>{v!r}</{k}>" for k, v in zip("xyz", axis, strict=True)) + "</direction>"


def force(name: str, place: XYZ, axis: XYZ, *newton: Term, gain: float = 1.0, frame: str = "BODY") -> str:
    """A force along an axis of the frame (BODY: FRD, LOCAL: NED) at a place given in FRD from the file's origin.

    Its size is `gain` times the product of `newton`.
    """
    value = f"<function>{times(gain / POUND_N, *newton)}</function>"
    return f'<force name="{name}" frame="{frame}">{value}{location(place)}{_direction(axis)}</force>'


def moment(name: str, axis: XYZ, newton_metre: Term) -> str:
    """A moment about a body axis."""
    value = f"<function>{times(1.0 / (POUND_N * FOOT_M), newton_metre)}</function>"
    return f'<moment name="{name}" frame="BODY">{value}{_direction(axis)}</moment>'


def contact(name: str, place: XYZ, stiffness_npm: float, damping_nspm: float, friction: float) -> str:
    """A point that the ground pushes and rubs: spring and damper along the normal, Coulomb friction in the plane."""
    per_foot = FOOT_M / POUND_N
    return (
        f'<contact type="STRUCTURE" name="{name}">{location(place)}'
        f"<static_friction>{friction!r}</static_friction><dynamic_friction>{friction!r}</dynamic_friction>"
        f'<spring_coeff unit="LBS/FT">{stiffness_npm * per_foot!r}</spring_coeff>'
        f'<damping_coeff unit="LBS/FT/SEC">{damping_nspm * per_foot!r}</damping_coeff></contact>'
    )


def mass_balance(mass_kg: float, inertia_kgm2: XYZ, com_frd_m: XYZ, payload_kg: float) -> str:
    """Mass, moments of inertia about the CoM, the CoM's place, and a point mass there."""
    pounds = POUND_PER_SLUG / SLUG_KG
    ixx, iyy, izz = (value / (SLUG_KG * FOOT_M**2) for value in inertia_kgm2)
    point = (
        f'<pointmass name="payload"><weight unit="LBS">{payload_kg * pounds!r}</weight>'
        f"{location(com_frd_m, name='POINTMASS')}</pointmass>"
        if payload_kg
        else ""
    )
    return (
        f'<mass_balance><ixx unit="SLUG*FT2">{ixx!r}</ixx><iyy unit="SLUG*FT2">{iyy!r}</iyy>'
        f'<izz unit="SLUG*FT2">{izz!r}</izz><emptywt unit="LBS">{mass_kg * pounds!r}</emptywt>'
        f"{location(com_frd_m, name='CG')}{point}</mass_balance>"
    )
