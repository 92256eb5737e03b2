"""Certificates of a stop as files, `flightstack.stopping/6` (JSON): what was learned, and all that follows from it.

A file says for which vehicle, sensors, mass, force and speed it holds, the ledger, both loops with their tubes, and how
hard the vehicle brakes; `certify --check` works the tubes and the braking out anew, with code of its own.  To fly by,
the same numbers are made from the believed vehicle, and have to agree.
"""

from __future__ import annotations

import json
from typing import Any

from flightstack.checked import number
from flightstack.site import backup as b
from flightstack.site.stopping import ANY_SPEED_MPS, Prior, StoppingCertificate
from flightstack.site.tube import LoopBounds, Tube
from flightstack.types import STANDARD_GRAVITY_MPS2, InputError

SCHEMA = "flightstack.stopping/6"
_AGREE = 1e-6
SPEEDS_MPS = (1.0, 3.0, 5.0)
_WAY = {
    "across_mps2": b.ACROSS, "lean_mps2": b.LEAN, "jerk_mps3": b.JERK, "slow_mps4": b.SNAP, "fast_mps4": b.SNAP_FAST,
    "fast_mps": b.FAST, "ease": b.EASE, "fade_ps": b.FADE, "stoppable": b.STOPPABLE, "rest_radius_m": b.REST_RADIUS,
    "most_radius_m": b.MOST_RADIUS, "per_lean_s2": b.PER_LEAN, "per_turn_s6pm": b.PER_TURN,
}  # fmt: skip
"""Of the row of the least gain, and of the greatest."""


def as_json(made: StoppingCertificate, vehicle: str, vehicle_hash: str, sensors: str, learned: dict[str, Any]) -> str:
    """The file's text; `learned`: where its prior comes from."""
    least = made.rows[0]
    loops = {name: _loop(tube, made.doubts[i], made.lags_s[i]) for i, (name, tube) in enumerate(_tubes(made).items())}
    said = {
        "schema": SCHEMA,
        "vehicle": vehicle,
        "vehicle_hash": vehicle_hash,
        "sensors": sensors,
        "prior": dict(made.prior._asdict()),
        "learned": learned,
        "ledger": [dict(line._asdict()) for line in made.ledger],
        **loops,
        "turning": {
            "snap_mps4": made.turning.sure_mps4,
            "lean_mps2": float(least[b.LEAN]),
            "fastest_mps3": min(made.turning.rate_radps * STANDARD_GRAVITY_MPS2, b.FASTEST * float(least[b.JERK])),
        },
        "way_least": {name: float(least[at]) for name, at in _WAY.items()},
        "way_most": {name: float(made.rows[-1][at]) for name, at in _WAY.items()},
        "braking": {
            "thrust_mps2": made.thrust_mps2,
            "least_thrust_mps2": made.least_mps2,
            "across_mps2": float(least[b.ACROSS]),
            "up_mps2": float(least[b.UP]),
            "down_mps2": float(least[b.DOWN]),
        },
        "stops_within_m": {f"{speed:g} m/s": made.stopping_way_m(speed, 0.0) for speed in SPEEDS_MPS},
    }
    return json.dumps(said, indent=1) + "\n"


def _tubes(made: StoppingCertificate) -> dict[str, Tube]:
    return {"across": made.across, "along": made.along}


def _loop(tube: Tube, doubts: LoopBounds, lags_s: tuple[float, float]) -> dict[str, float]:
    gains = {name: float(value) for name, value in tube.gains._asdict().items()}
    return {
        "lag_s": lags_s[0],
        "rotors_s": lags_s[1],
        **{name: float(value) for name, value in doubts._asdict().items()},
        **gains,
        "radius_m": float(tube.radius_m[-1]),
        "demand_mps2": tube.demand_mps2,
    }


def prior_of(text: str, source: str, vehicle_hash: str, sensors: str) -> Prior:
    """What a file says of mass, force and speed; InputError where it is none, or of another vehicle or sensors."""
    try:
        said = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{source}: not valid JSON: {error}") from None
    if not isinstance(said, dict) or said.get("schema") != SCHEMA:
        raise InputError(
            f'{source}: not a certificate of a stop (schema "{SCHEMA}"): a site needs one, made by `certify --site`'
        )
    if said.get("vehicle_hash") != vehicle_hash:
        raise InputError(f"{source}: made for another vehicle ({said.get('vehicle')!r}); certify this one")
    if said.get("sensors") != sensors:
        raise InputError(f"{source}: made for {said.get('sensors')!r} sensors, this flight has {sensors}")
    prior = said.get("prior")
    if not isinstance(prior, dict):
        raise InputError(f"{source}: prior is missing")
    low = number(prior.get("mass_low"), f"{source}: prior.mass_low", 0.5, 2.0)
    high = number(prior.get("mass_high"), f"{source}: prior.mass_high", low, 2.0)
    force = number(prior.get("force_g"), f"{source}: prior.force_g", 0.0, 0.5)
    return Prior(low, high, force, number(prior.get("speed_mps"), f"{source}: prior.speed_mps", 0.0, ANY_SPEED_MPS))


def _by_name(said: Any) -> dict[str, Any]:
    """A file's tables, the ledger's lines among them by their names."""
    lines = said.get("ledger") if isinstance(said, dict) else None
    named = {str(line.get("name")): line for line in lines or () if isinstance(line, dict)}
    return {**named, **said} if isinstance(said, dict) else named


def require_same(text: str, source: str, made: StoppingCertificate) -> None:
    """InputError where any number of the file is not the one that follows from its prior for this vehicle."""
    said, again = (_by_name(json.loads(each)) for each in (text, as_json(made, "", "", "", {})))
    for part in (
        "across",
        "along",
        "turning",
        "way_least",
        "way_most",
        "braking",
        "stops_within_m",
        *(line.name for line in made.ledger),
    ):
        for key, value in again[part].items():
            found = said.get(part, {}).get(key) if isinstance(said.get(part), dict) else None
            if isinstance(value, str):
                continue
            if not isinstance(found, int | float) or not abs(found - value) <= _AGREE * max(1.0, abs(value)):
                raise InputError(f"{source}: {part}.{key} = {found} does not follow from its prior ({value:.6g})")
