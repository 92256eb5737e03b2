"""JSBSim's XML, written: terms of its functions, its components, and the units that it reckons in.

A term is a number or the text of an element; all terms that this project writes are in SI, and only what goes into a
force or a moment, or comes out of a velocity, is converted.
"""

from __future__ import annotations

from typing import Final

FOOT_M: Final = 0.3048
INCH_M: Final = 0.0254
POUND_N: Final = 4.4482216152605
SLUG_KG: Final = POUND_N / FOOT_M
POUND_PER_SLUG: Final = 32.174049
"""JSBSim's own factor between weight and mass: with it masses arrive as given."""

Term = str | float
XYZ = tuple[float, float, float]


def term(value: Term) -> str:
    """A number as a value element; text as it is."""
    return value if isinstance(value, str) else f"<value>{float(value)!r}</value>"


def prop(name: str) -> str:
    """The value of a property."""
    return f"<property>{name}</property>"


def _call(name: str, terms: tuple[Term, ...]) -> str:
    return f"<{name}>{''.join(map(term, terms))}</{name}>"


def total(*terms: Term) -> str:
    """Their sum."""
    return term(terms[0]) if len(terms) == 1 else _call("sum", terms)


def times(*terms: Term) -> str:
    """Their product."""
    return term(terms[0]) if len(terms) == 1 else _call("product", terms)


def minus(first: Term, second: Term) -> str:
    """first - second."""
    return _call("difference", (first, second))


def over(first: Term, second: Term) -> str:
    """first / second."""
    return _call("quotient", (first, second))


def root(value: Term) -> str:
    """Square root."""
    return _call("sqrt", (value,))


def power(value: Term, exponent: float) -> str:
    """value to the power of exponent."""
    return _call("pow", (value, exponent))


def exponential(value: Term) -> str:
    """exp."""
    return _call("exp", (value,))


def sine(value: Term) -> str:
    """sin."""
    return _call("sin", (value,))


def cosine(value: Term) -> str:
    """cos."""
    return _call("cos", (value,))


def greatest(*terms: Term) -> str:
    """max."""
    return _call("max", terms)


def least(*terms: Term) -> str:
    """min."""
    return _call("min", terms)


def positive(value: Term) -> str:
    """1 where value > 0, else 0."""
    return _call("gt", (value, 0.0))


def normal(seed: int) -> str:
    """A standard normal number, a new one at each reading."""
    return f'<random seed="{seed}" mean="0" stddev="1"/>'


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
