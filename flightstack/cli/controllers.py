"""The controllers that `--controller` names: one table, and the stack round each of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from flightstack.cli import files
from flightstack.cli.shipped import require_controller
from flightstack.control.attitude import AttitudeGains
from flightstack.control.feedback import FlatnessController
from flightstack.control.gains import FlatnessGains, Tuned, parse_gains
from flightstack.control.indi import IndiController
from flightstack.control.observer import DisturbanceObserver, ObserverGains
from flightstack.control.pid import PidController, PidGains
from flightstack.control.px4_position import Px4Controller, Px4Gains
from flightstack.learning.learner import GpLearner
from flightstack.model import Limits, Model
from flightstack.seams import Controller, Learner, NoLearner

Built = tuple[Controller, Learner]


@dataclass(frozen=True, slots=True)
class ControllerEntry:
    """One controller."""

    gains: str
    """Its table in controllers/gains.toml."""
    build: Callable[..., Built]
    """(model, limits, *groups of gains) -> controller and learner."""


def _flatness(model: Model, limits: Limits, attitude: AttitudeGains, gains: FlatnessGains) -> Built:
    return FlatnessController(model, gains.with_attitude(attitude), limits), GpLearner(model)


def _state_gp(model: Model, limits: Limits, attitude: AttitudeGains, gains: FlatnessGains) -> Built:
    return FlatnessController(model, gains.with_attitude(attitude), limits), GpLearner(model, inputs="state")


def _dob(model: Model, limits: Limits, attitude: AttitudeGains, gains: FlatnessGains, observer: ObserverGains) -> Built:
    return FlatnessController(model, gains.with_attitude(attitude), limits), DisturbanceObserver(model, observer)


def _pid(model: Model, limits: Limits, attitude: AttitudeGains, gains: PidGains) -> Built:
    return PidController(model, limits, attitude, gains), NoLearner()


def _indi(model: Model, limits: Limits, attitude: AttitudeGains, gains: PidGains, increments: ObserverGains) -> Built:
    return IndiController(model, limits, attitude, gains, increments), NoLearner()


def _px4(model: Model, limits: Limits, attitude: AttitudeGains, gains: Px4Gains) -> Built:
    return Px4Controller(model, limits, attitude, gains), NoLearner()


CONTROLLERS: Mapping[str, ControllerEntry] = {
    "flatness": ControllerEntry("flatness", _flatness),
    "pd": ControllerEntry("pd", _pid),
    "pid": ControllerEntry("pid", _pid),
    "indi": ControllerEntry("indi", _indi),
    "dob": ControllerEntry("dob", _dob),
    "px4": ControllerEntry("px4", _px4),
    "state-gp": ControllerEntry("flatness", _state_gp),
}
"""Name -> how it is built; what it is says `shipped.CONTROLLER_WORDS`."""


def load_gains() -> Mapping[str, Tuned]:
    """The shipped gains of every table."""
    file = files.find("controllers", "gains")
    return parse_gains(file.text, str(file.path))


def build(
    name: str, model: Model, limits: Limits, *, learning: bool = True, gains: Mapping[str, Tuned] | None = None
) -> Built:
    """The controller of a name and its learner (none where `learning` is off); InputError for an unknown name."""
    require_controller(name, CONTROLLERS)
    row = CONTROLLERS[name]
    tuned = (load_gains() if gains is None else gains)[row.gains]
    controller, learner = row.build(model, limits, *tuned.groups)
    return controller, learner if learning else NoLearner()
