"""What is kept between flights: kernels and noise fitted to recorded flights, tied to vehicle and data by hashes.

`flightstack.learned/1`, JSON.  A file of another vehicle is refused: its residuals are another model's.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from flightstack.checked import number, only
from flightstack.gp import Kernel, fit, kernel_from_dict
from flightstack.learning.priors import Priors, StorePrior, default_priors
from flightstack.learning.windows import SampleWindows
from flightstack.types import F64, InputError
from flightstack.vehicle import Vehicle, vehicle_to_toml

SCHEMA = "flightstack.learned/1"
LEAST_WINDOWS = 100
MOST_WINDOWS = 500
"""Likelihoods cost the cube of it; more windows are thinned evenly."""
_NOISE_RANGE = (1e-8, 1e2)


@dataclass(frozen=True, slots=True)
class StoredPriors:
    """Fitted priors and where they come from."""

    priors: Priors
    vehicle: str
    vehicle_hash: str
    data_hash: str
    windows: int
    """Points fitted to."""


def vehicle_hash(vehicle: Vehicle) -> str:
    """SHA-256 of the believed vehicle as text; its name counts too."""
    return hashlib.sha256(vehicle_to_toml(vehicle).encode()).hexdigest()


def fit_priors(vehicle: Vehicle, data: SampleWindows, *, seed: int = 0) -> StoredPriors:
    """Hyper-parameters of greatest marginal likelihood, starting from the default priors; InputError if too few."""
    count = len(data.x)
    if count < LEAST_WINDOWS:
        raise InputError(f"{count} windows of flight are too few to fit; at least {LEAST_WINDOWS} (6 s) are needed")
    keep = np.unique(np.linspace(0, count - 1, min(count, MOST_WINDOWS)).astype(int))
    x, y, rate_x, rate_y = (part[keep] for part in data)
    start = default_priors()
    priors = Priors(
        _fitted(start.lateral, x, y[:, :2], seed), _fitted(start.vertical, x, y[:, 2:], seed),
        _fitted(start.rates, rate_x, rate_y, seed),
    )  # fmt: skip
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in data)).hexdigest()
    return StoredPriors(priors, vehicle.name, vehicle_hash(vehicle), digest, len(keep))


def _fitted(prior: StorePrior, x: F64, y: F64, seed: int) -> StorePrior:
    found = fit(prior.kernel, prior.noise_var, x, y, seed=seed, restarts=0)
    return StorePrior(found.kernel, found.noise_var, prior.force)


def to_json(stored: StoredPriors) -> str:
    """The file's text."""
    stores = {
        item.name: {"kernel": prior.kernel.to_dict(), "noise_var": prior.noise_var}
        for item in fields(Priors)
        for prior in (getattr(stored.priors, item.name),)
    }
    head = {
        "schema": SCHEMA,
        "vehicle": stored.vehicle,
        "vehicle_hash": stored.vehicle_hash,
        "data_hash": stored.data_hash,
        "windows": stored.windows,
    }
    return json.dumps(head | {"stores": stores}, indent=1) + "\n"


def parse_stored(text: str, source: str, vehicle: Vehicle) -> StoredPriors:
    """The priors of a file; InputError names what is wrong, and refuses a file fitted for another vehicle."""
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{source}: not valid JSON: {error}") from None
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise InputError(f'{source}: not a "{SCHEMA}" file')
    only(data, ("schema", "vehicle", "vehicle_hash", "data_hash", "windows", "stores"), source)
    if data.get("vehicle_hash") != vehicle_hash(vehicle):
        raise InputError(
            f"{source}: fitted for vehicle {data.get('vehicle')!r} with another vehicle file; fit again with "
            f"`flightstack learn LOG --vehicle {vehicle.name}`"
        )
    stores = data.get("stores")
    if not isinstance(stores, Mapping):
        raise InputError(f"{source}: stores must be a table")
    only(stores, tuple(item.name for item in fields(Priors)), f"{source}: stores")
    usual = default_priors()
    priors = Priors(
        *(
            replace(
                _prior(stores.get(item.name), f"{source}: stores.{item.name}"), force=getattr(usual, item.name).force
            )
            for item in fields(Priors)
        )
    )
    count = int(number(data.get("windows"), f"{source}: windows", 1, 1e9))
    return StoredPriors(priors, str(data.get("vehicle")), str(data["vehicle_hash"]), str(data.get("data_hash")), count)


def _prior(data: object, where: str) -> StorePrior:
    if not isinstance(data, Mapping):
        raise InputError(f"{where} is missing")
    only(data, ("kernel", "noise_var"), where)
    kernel: Kernel = kernel_from_dict(data.get("kernel"), f"{where}.kernel")
    return StorePrior(kernel, number(data.get("noise_var"), f"{where}.noise_var", *_NOISE_RANGE))
