"""An aircraft's surroundings in JSBSim's words: velocity through the air, wind, gusts, a constant force."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from flightstack.effects.expressions import cosine, exponential, greatest, minus, normal, prop, root, sine, times, total
from flightstack_sim.jsbsim import text
from flightstack_sim.jsbsim.text import FOOT_M, XYZ

if TYPE_CHECKING:
    from flightstack_sim.jsbsim.aircraft import Effects

_P, _Q, _R = (prop(f"velocities/{letter}-rad_sec") for letter in "pqr")
_NED = ("north", "east", "down")
_SQRT3 = math.sqrt(3.0)
_LEAST_AIRSPEED_MPS = 1.0


def body_air(axes: Collection[str], *, still: bool, speed: bool) -> str:
    """air/x, y, z of these axes: velocity through the air, FRD, m/s; air/speed of all three.

    In `still` air it is that over the ground, and JSBSim need not work out what depends on the wind.
    """
    parts = [
        text.function(f"air/{axis}", times(FOOT_M, prop(f"velocities/{letter}{'' if still else '-aero'}-fps")))
        for axis, letter in zip("xyz", "uvw", strict=True)
        if axis in axes
    ]
    if speed:
        squares = total(*(times(prop(f"air/{axis}"), prop(f"air/{axis}")) for axis in "xyz"))
        parts.append(text.function("air/speed", root(squares)))
    return "".join(parts)


def hub_air(number: int, arm: XYZ, axes: Collection[str]) -> str:
    """rotor/air-x, y, z-N of these axes: the hub's velocity through the air, omega x r included."""
    x, y, z = arm
    added = {"x": ((z, _Q), (-y, _R)), "y": ((x, _R), (-z, _P)), "z": ((y, _P), (-x, _Q))}
    return "".join(
        text.function(
            f"rotor/air-{axis}-{number}",
            total(prop(f"air/{axis}"), *(times(length, rate) for length, rate in added[axis] if length)),
        )
        for axis in axes
    )


def down_axis() -> str:
    """world/down-x, y, z: the world's down axis in the body."""
    phi, theta = prop("attitude/phi-rad"), prop("attitude/theta-rad")
    axis = {
        "x": times(-1.0, sine(theta)),
        "y": times(sine(phi), cosine(theta)),
        "z": times(cosine(phi), cosine(theta)),
    }
    return "".join(text.function(f"world/down-{name}", value) for name, value in axis.items())


def hub_height(arm: XYZ) -> str:
    """Height of a hub over the ground, m."""
    below = total(*(times(length, prop(f"world/down-{axis}")) for axis, length in zip("xyz", arm, strict=True)))
    return minus(times(FOOT_M, prop("position/h-agl-ft")), below)


def constant_force(effects: Effects, com: XYZ) -> str:
    """The effect constant_force: up to three forces along the world's axes."""
    axes: tuple[XYZ, XYZ, XYZ] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return "".join(
        text.force(f"constant-{name}", com, axis, value, frame="LOCAL")
        for name, axis, value in zip(_NED, axes, effects.xyz("constant_force"), strict=True)
        if value
    )


def wind(effects: Effects) -> dict[str, float]:
    """The effect steady_wind: JSBSim's own wind, the air's velocity over ground."""
    return {
        f"atmosphere/wind-{name}-fps": value / FOOT_M
        for name, value in zip(_NED, effects.xyz("steady_wind"), strict=True)
    }


class GustComponents(NamedTuple):
    """Components that blow, and their states' first values."""

    components: tuple[str, ...]
    first: Mapping[str, float]


STILL = GustComponents((), {})


def gusts(effects: Effects, dt_s: float, seed: int) -> GustComponents:
    """The effect turbulence: Dryden filters (MIL-F-8785C's forms) on JSBSim's noise, into its gust velocity.

    JSBSim's own turbulence takes its sigma and length from the height over sea level and a wind at 20 ft, and dies away
    with the airspeed: it can't be given those of the effect.  Along the wind z' = (n - z) V/L; across and down two such
    lags in a row, read as (sqrt(3) z1 + (1 - sqrt(3)) z2) / sqrt(2).
    """
    sigma, length = effects("turbulence", "sigma_mps"), effects("turbulence", "length_m")
    rng = np.random.default_rng(seed)
    seeds = [int(value) for value in rng.integers(1, 2**30, size=3)]
    draws = [float(value) for value in rng.standard_normal(5)]
    steady = effects.xyz("steady_wind")
    through = [minus(times(FOOT_M, prop(f"velocities/v-{n}-fps")), w) for n, w in zip(_NED, steady, strict=True)]
    speed = greatest(root(total(*(times(v, v) for v in through))), _LEAST_AIRSPEED_MPS)
    components = [
        text.state("gust/decay", exponential(times(-dt_s / length, speed))),
        text.state("gust/noise", root(minus(1.0, times(prop("gust/decay"), prop("gust/decay"))))),
    ]
    first = {"gust/decay": 1.0, "gust/noise": 0.0, "gust/along": draws[0]}
    components.append(_lag("along", seeds[0]))
    for i, name in enumerate(("across", "vertical")):
        z1, z2 = draws[1 + 2 * i], draws[2 + 2 * i]
        first |= {f"gust/{name}": z1, f"gust/{name}-before": z1, f"gust/{name}-two": 0.5 * (z1 + z2)}
        components += [
            text.state(f"gust/{name}-before", prop(f"gust/{name}")),
            _lag(name, seeds[1 + i]),
            text.state(f"gust/{name}-two", _second_lag(name)),
        ]
    return GustComponents((*components, *_world_gust(sigma, steady)), first)


def _lag(name: str, seed: int) -> str:
    """A state of unit variance that forgets by gust/decay in each step."""
    value = total(times(prop("gust/decay"), prop(f"gust/{name}")), times(prop("gust/noise"), normal(seed)))
    return text.state(f"gust/{name}", value)


def _second_lag(name: str) -> str:
    """The second of two lags follows the mean of the first over the step."""
    mean = times(0.5, total(prop(f"gust/{name}"), prop(f"gust/{name}-before")))
    return total(times(prop("gust/decay"), prop(f"gust/{name}-two")), times(minus(1.0, prop("gust/decay")), mean))


def _world_gust(sigma_mps: float, steady: XYZ) -> tuple[str, str, str]:
    """The gust of the filters' states as JSBSim's gust velocity, NED."""

    def mixed(name: str) -> str:
        return times(
            math.sqrt(0.5),
            total(times(_SQRT3, prop(f"gust/{name}")), times(1.0 - _SQRT3, prop(f"gust/{name}-two"))),
        )

    horizontal = math.hypot(steady[0], steady[1])
    cos, sin = (steady[0] / horizontal, steady[1] / horizontal) if horizontal > 0.0 else (1.0, 0.0)
    scale = sigma_mps / FOOT_M
    along, across, vertical = prop("gust/along"), mixed("across"), mixed("vertical")
    return (
        text.state("atmosphere/gust-north-fps", times(scale, minus(times(cos, along), times(sin, across)))),
        text.state("atmosphere/gust-east-fps", times(scale, total(times(sin, along), times(cos, across)))),
        text.state("atmosphere/gust-down-fps", times(scale, vertical)),
    )


def fdm_config(
    name: str, *, mass_balance: str, ground_reactions: str, flight_control: str, external_reactions: str, reference: XYZ
) -> str:
    """An aircraft file of its sections; `reference`: the aerodynamic reference point, FRD from the file's origin."""
    metrics = (
        '<metrics><wingarea unit="M2">1</wingarea><wingspan unit="M">1</wingspan><chord unit="M">1</chord>'
        f"{text.location(reference, name='AERORP')}</metrics>"
    )
    return (
        f'<?xml version="1.0"?>\n<fdm_config name="{name}" version="2.0" release="BETA">{metrics}{mass_balance}'
        f"<ground_reactions>{ground_reactions}</ground_reactions><propulsion/>"
        f'<flight_control name="{name}">{flight_control}</flight_control><aerodynamics/>'
        f"<external_reactions>{external_reactions}</external_reactions></fdm_config>\n"
    )
