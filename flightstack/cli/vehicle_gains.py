"""The rate gains and filters that a vehicle really has: certificates, governor and ways out count on them.

They are read before a protected flight, and stand in place of what the vehicle file says or leaves to PX4's defaults.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace

from flightstack.autopilot import autopilot_of, float32
from flightstack.autopilot_params import AUTOPILOT_PARAMS
from flightstack.cli.set_params import VehicleLink
from flightstack.types import InputError
from flightstack.vehicle import Vehicle
from mavlink_bridge.param_session import Stored
from mavlink_bridge.signing import Signer
from mavlink_bridge.transport.address import open_address, parse_address

_ANSWER_LIMIT_S = 5.0
_SAME = 1e-6
"""Share: PX4's floats have 24 bits."""


def tuned(vehicle: Vehicle, gains: Mapping[str, float]) -> Vehicle:
    """The vehicle with these values of `[autopilot]`; the very same where it has them already."""
    return replace(vehicle, autopilot={**vehicle.autopilot, **gains}) if _others(vehicle, gains) else vehicle


def ask_gains(connect: str, signer: Signer | None, within_s: float, file: Vehicle) -> dict[str, float]:
    """`[autopilot]` of the vehicle at an address.

    InputError where nobody answers in time, a value is beyond what a vehicle file may say, or one is neither told nor
    stated in the file: PX4's default would be a guess.
    """
    address = parse_address(connect)
    with closing(open_address(address, signer)) as transport:
        wire = VehicleLink(transport, address, signer, within_s)
        met = wire.session([])
        if not wire.run(met, lambda: met.identified, within_s):
            raise InputError(
                f"no vehicle answered at {connect} within {within_s:g} s: its rate gains, on which every protection "
                "counts, are not known"
            )
        stored: dict[str, Stored] = {}
        open_names = {param.name for param in AUTOPILOT_PARAMS.values()}
        while open_names:  # a name that is refused ends a session: the others are asked for again
            session = wire.session(sorted(open_names))
            wire.run(session, lambda session=session: session.settled, _ANSWER_LIMIT_S)  # type: ignore[misc]
            stored |= session.stored
            refused = open_names.intersection(session.problem.split())
            open_names -= refused | set(stored)
            if not refused:
                break
    gains = {}
    for key, param in AUTOPILOT_PARAMS.items():
        if param.name not in stored:
            if key not in file.autopilot:
                raise InputError(
                    f"the vehicle does not tell {param.name}, on which every protection counts: state {key} in "
                    "[autopilot] of the vehicle file"
                )
            continue
        value = gains[key] = stored[param.name].value
        if not param.minimum <= value <= param.maximum:
            raise InputError(
                f"{param.name} is {value:g} on the vehicle: nothing is certified outside "
                f"{param.minimum:g} to {param.maximum:g}"
            )
    return gains


def counted_on(believed: Vehicle) -> dict[str, float]:
    """What certificates and governor take the vehicle's parameters for, by PX4's names."""
    return {AUTOPILOT_PARAMS[key].name: value for key, value in autopilot_of(believed).items()}


def changed(vehicle: Vehicle, gains: Mapping[str, float]) -> str:
    """What the vehicle has otherwise than its file, in words; empty where nothing."""
    words = [f"{AUTOPILOT_PARAMS[key].name} {gains[key]:g} ({has:g})" for key, has in _others(vehicle, gains).items()]
    return f"as the vehicle has it, not as its file: {', '.join(words)}" if words else ""


def _others(vehicle: Vehicle, gains: Mapping[str, float]) -> dict[str, float]:
    """What the file has of the gains that are others; of rotors that nobody can mix nothing: they are refused."""
    try:
        has = autopilot_of(vehicle)
    except InputError:
        return {}
    same = {k: math.isclose(has[k], float32(v), rel_tol=_SAME, abs_tol=1e-12) for k, v in gains.items()}
    return {key: has[key] for key, is_same in same.items() if not is_same}
