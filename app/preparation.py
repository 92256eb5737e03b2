"""What every flight is made of: the options that all have, the files that they name, and the stack that flies.

`fly` and `offboard` add what is their own: a simulated vehicle, an address.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from app import files
from app.calibration import TimedLearner
from app.controllers import build
from flightstack.learning.learner import GpLearner, LearnerConfig
from flightstack.learning.stored import parse_stored
from flightstack.model import Model
from flightstack.scenario import Scenario
from flightstack.stack import Stack
from flightstack.types import InputError
from flightstack.vehicle import Vehicle
from logs.topics import Attachment

DEFAULT_CONTROLLER = "flatness"


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightOptions:
    """What any flight may be asked for; names as given on the command line.  Abstract: each verb has its own."""

    scenario: str
    waypoints: str | None = None
    vehicle: str | None = None
    duration_s: float | None = None
    controller: str = DEFAULT_CONTROLLER
    learning: bool = True
    learned: Path | None = None
    """File of hyper-parameters to begin with."""
    log: Path | None = None
    out: Path | None = None

    @property
    def stack_as_written(self) -> bool:
        """Scenario, vehicle and stack are those that the scenario's checks were written for."""
        given = (self.vehicle, self.duration_s, self.learned)
        return self.learning and self.controller == DEFAULT_CONTROLLER and all(value is None for value in given)


@dataclass(frozen=True, slots=True)
class Prepared:
    """The files of a flight, read and checked, and the stack built of them."""

    scenario: Scenario
    believed: Vehicle
    stack: Stack
    settings: dict[str, str]
    attachments: tuple[Attachment, ...]


def prepare_flight(options: FlightOptions) -> Prepared:
    """Read and check everything before anything moves; InputError with one line where something is wrong."""
    scenario, scenario_file = files.load_scenario(options.scenario, options.waypoints)
    if options.duration_s is not None:
        scenario = scenario.with_duration(options.duration_s)
    believed, vehicle_file = files.load_vehicle(options.vehicle)
    learned = None if options.learned is None else files.read_text(options.learned)
    stack = build_stack(options, scenario, believed, learned)
    settings = {
        "scenario": scenario.name,
        "vehicle": believed.name,
        "controller": options.controller,
        "learning": "on" if stack.learner.enabled else "off",
        "duration_s": f"{scenario.duration_s:g}",
    }
    carried = {"scenario.toml": scenario_file.text, "vehicle.toml": vehicle_file.text}
    if learned is not None:
        settings["learned"] = str(learned.path)
        carried[f"learned{learned.path.suffix}"] = learned.text
    return Prepared(scenario, believed, stack, settings, tuple(text_file(*item) for item in carried.items()))


def build_stack(options: FlightOptions, scenario: Scenario, believed: Vehicle, learned: files.TextFile | None) -> Stack:
    """The stack that the options name, its learner timed."""
    model, limits = Model.from_vehicle(believed), scenario.limits
    controller, learner = build(options.controller, model, limits, learning=options.learning)
    if learned is not None:
        if not options.learning or options.controller != DEFAULT_CONTROLLER:
            raise InputError(f"--learned {learned.path}: goes with --controller {DEFAULT_CONTROLLER} and learning only")
        priors = parse_stored(learned.text, str(learned.path), believed).priors
        learner = GpLearner(model, LearnerConfig(priors=priors))
    return Stack(model, limits, controller=controller, learner=TimedLearner(learner) if learner.enabled else learner)


def text_file(name: str, text: str) -> Attachment:
    """A text file carried inside the log."""
    return Attachment(name, f"application/{name.rpartition('.')[2]}", text.encode())


def settings_file(settings: dict[str, str]) -> Attachment:
    """The run's settings, carried inside the log."""
    return text_file("settings.json", json.dumps(settings, indent=1))
