"""Names of what comes along: vehicles, scenarios, controllers.  Needs no numpy, so that a typo is told at once."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path

from flightstack.errors import InputError

_DATA = Path(__file__).resolve().parent.parent / "data"
_ONE = {"vehicles": "vehicle", "scenarios": "scenario", "params": "set of parameters", "controllers": "controller"}

CONTROLLER_WORDS = {
    "flatness": "flatness control that feeds forward what the Gaussian process learns",
    "pd": "the paper's without learning: flatness feed-forward and PD feedback",
    "pid": "the same with integral action",
    "indi": "incremental nonlinear dynamic inversion of the linear acceleration",
    "dob": "flatness control with a disturbance observer in place of the learner",
    "px4": "PX4's own position control: P position, PID velocity, hover thrust estimate",
    "state-gp": "the paper's learner: a Gaussian process on the state alone, without thrust gain",
}
"""What each controller is, for --help and docs; how it is built says `controllers`."""


def shipped_names(kind: str) -> list[str]:
    """Names of the shipped `vehicles` or `scenarios`, sorted."""
    return sorted(path.stem for path in (_DATA / kind).glob("*.toml"))


def path_of(kind: str, name: str) -> Path:
    """The file of a name or a path to one's own; InputError, one line, where there is none of that name."""
    given = Path(name)
    if given.suffix == ".toml" or os.sep in name:
        return given
    shipped = _DATA / kind / f"{name}.toml"
    if shipped.is_file():
        return shipped
    known = ", ".join(shipped_names(kind))
    raise InputError(f"no {_ONE[kind]} named {name!r}: name a .toml file or one of {known}")


def require_controller(name: str, known: Collection[str] = CONTROLLER_WORDS) -> None:
    """InputError for a controller that nobody knows."""
    if name not in known:
        raise InputError(f"no controller named {name!r}: use one of {', '.join(known)}")


def require_names(scenario: str, controller: str, *vehicles: str | None) -> None:
    """InputError, one line, for the first name that nothing has; whether files can be read is seen later."""
    if scenario != "waypoints":
        _require_file("scenarios", scenario)
    for vehicle in vehicles:
        if vehicle is not None:
            _require_file("vehicles", vehicle)
    require_controller(controller)


def _require_file(kind: str, name: str) -> None:
    path = path_of(kind, name)
    if not path.exists():
        raise InputError(f"{path}: No such file or directory")
