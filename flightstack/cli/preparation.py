"""What every flight is made of: the options that all have, the files that they name, and the stack that flies.

`fly` and `offboard` add what is their own: a simulated vehicle, an address.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType

from flightstack.barrier.provenance import Trail
from flightstack.cli import files
from flightstack.cli.calibration import TimedLearner
from flightstack.cli.controllers import build
from flightstack.cli.protection import FULL, NONE, STATE_ONLY, Protection, ProtectionOptions, protect
from flightstack.cli.quiet import quieted
from flightstack.cli.recorder import LogObserver, path_of, scene_of, write_heard_alone
from flightstack.cli.site import TimedSiteFilter, envelope, load_site
from flightstack.cli.vehicle_gains import tuned
from flightstack.cli.versions import versions
from flightstack.governor import Governor
from flightstack.learning.learner import GpLearner, LearnerConfig
from flightstack.learning.stored import parse_stored
from flightstack.mission import require_run_up
from flightstack.model import Model
from flightstack.scenario import Scenario
from flightstack.seams import Learner
from flightstack.stack import Stack
from flightstack.types import InputError
from flightstack.vehicle import Vehicle, vehicle_to_toml
from flightstack.warmup import warm_up
from flightstack_logs.log_clock import LogClock
from flightstack_logs.topics import CERTIFICATE, SITE_OUTLINES, Attachment
from flightstack_logs.writer import FlightLog, Recorder

DEFAULT_CONTROLLER = "flatness"
STATE_ONLY_CONTROLLER = "state-gp"
"""Its learner knows the state alone, as the paper words it: with a wrong mass it claims what physics refutes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightOptions(ProtectionOptions):
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
    log_wire: bool = False
    """Every datagram goes into the log as well."""
    live: int | None = None
    """Port of the live view; None: there is none."""
    out: Path | None = None

    @property
    def stack_as_written(self) -> bool:
        """Scenario, vehicle and stack are those that the scenario's checks were written for."""
        given = (self.vehicle, self.duration_s, self.learned)
        default = self.learning and self.controller == DEFAULT_CONTROLLER and all(value is None for value in given)
        return default and self.protection_as_written

    def grade(self, scenario: Scenario) -> str:
        """Grade of the sensors that fly."""
        return scenario.sensors


@dataclass(frozen=True, slots=True)
class Prepared:
    """The files of a flight, read and checked, and the stack built of them."""

    scenario: Scenario
    believed: Vehicle
    stack: Stack
    protection: Protection
    settings: Mapping[str, str]
    """What was asked for, for the log."""
    carried: Mapping[str, str]
    """Name and text of the files that the log carries."""
    log_wire: bool = False

    def with_more(self, settings: Mapping[str, str], carried: Mapping[str, str] | None = None) -> Prepared:
        """The same with what a verb adds."""
        return replace(self, settings={**self.settings, **settings}, carried={**self.carried, **(carried or {})})

    def warm_up(self) -> None:
        """Compile what a tick calls and what writes it to a log: no tick waits for it."""
        record = warm_up(self.stack, self.scenario)
        with TemporaryDirectory() as folder, closing(FlightLog.open(Path(folder) / "log.mcap", metadata={})) as log:
            log.tick(record)
            write_heard_alone(log)

    def observer(self, log: Recorder, clock: LogClock, *, truth: bool) -> LogObserver:
        """What puts a flight into `log`; `truth`: which has the true vehicle too."""
        site = self.protection.site
        lines = () if site is None else site.lines_ned_m
        scene = partial(scene_of, self.scenario, self.believed, path_of(self.scenario), lines, truth=truth)
        timed = self.protection.filter
        way = timed.way_ned_m if isinstance(timed, TimedSiteFilter) else None
        return LogObserver(log, clock, scene, way_ned_m=way, certifier=self.protection.watched)

    @property
    def attachments(self) -> tuple[Attachment, ...]:
        """The files that the log carries, the settings last."""
        files_of = {**self.carried, "settings.json": json.dumps(dict(self.settings), indent=1)}
        return tuple(Attachment.of_text(name, text) for name, text in files_of.items())

    def open_log(self, path: Path, clock: Mapping[str, str]) -> FlightLog:
        """Begin the flight's log; `clock`: of which date (`log_clock.clock_metadata`)."""
        metadata = {"settings": self.settings, "versions": versions(), "clock": clock}
        return FlightLog.open(
            path, metadata=metadata, attachments=self.attachments, overwrite=True, compact=True, wire=self.log_wire
        )


Gains = Mapping[str, float] | Callable[[Scenario, Vehicle], Mapping[str, float]]


def prepare_flight(
    options: FlightOptions, gains: Gains = MappingProxyType({}), on_read: Callable[[], None] = lambda: None
) -> Prepared:
    """Read and check everything before anything moves; InputError with one line where something is wrong.

    gains: what the vehicle has of `[autopilot]`, in place of what its file says; or what tells it of scenario and file.
    on_read: called when all files are read and before much is calculated, which on a new machine is compiled first.
    """
    files.require_place_of_a_log(options.log)
    scenario, scenario_file = _scenario(options)
    filed, vehicle_file = files.load_vehicle(options.vehicle)
    believed = tuned(filed, gains(scenario, filed) if callable(gains) else gains)
    if believed is not filed:
        vehicle_file = replace(vehicle_file, text=vehicle_to_toml(believed))
    learned = None if options.learned is None else files.read_text(options.learned)
    model, name = Model.from_vehicle(believed), controller_name(options)
    controller, learner = build(name, model, scenario.limits, learning=options.learning)
    if learned is not None:
        learner = _learner(learned, name, believed, model, options)
    on_read()
    protection = protect(options, scenario, believed, model, _knows(name, learner), options.grade(scenario))
    if protection.site is not None:
        controller = quieted(controller, protection.site.certificate)
        scenario = protection.site.track.of(scenario)
    if protection.watched is not None:
        protection.watched.trail = Trail(vehicle_file.text)
    if isinstance(learner, GpLearner) and protection.estimate is not None:
        learner = learner.from_afar(protection.estimate.away_m)
    if protection.given is not None:  # settle inside it first, so that the filter engages before the track begins
        scenario = replace(scenario, climb_to_m=-protection.given.centre_ned_m[2])
    settings = {
        "scenario": scenario.name,
        "vehicle": believed.name,
        "controller": name,
        "learning": "on" if learner.enabled else "off",
        "filter": protection.words,
        "duration_s": f"{scenario.duration_s:g}",
    }
    carried = {"scenario.toml": scenario_file.text, "vehicle.toml": vehicle_file.text}
    if learned is not None:
        settings["learned"] = str(learned.path)
        carried[f"learned{learned.path.suffix}"] = learned.text
    if options.site is not None:
        settings["site"] = str(options.site)
        carried[f"site{options.site.suffix}"] = files.read_text(options.site).text
        assert protection.site is not None
        carried[SITE_OUTLINES] = protection.site.outlines
    if protection.certificate is not None:
        settings["certificate"] = protection.certificate_from
        carried[CERTIFICATE] = protection.certificate
    stack = Stack(
        model,
        scenario.limits,
        controller=controller,
        learner=TimedLearner(learner) if learner.enabled else learner,
        certifier=protection.certifier,
        safety_filter=protection.filter,
        governor=Governor(believed) if protection.filter.enabled else None,
    )
    return Prepared(scenario, believed, stack, protection, settings, carried, options.log_wire)


def _scenario(options: FlightOptions) -> tuple[Scenario, files.TextFile]:
    """The scenario as it is to be flown, within its site, and its file."""
    scenario, file = files.load_scenario(options.scenario, options.waypoints)
    if options.duration_s is not None:
        scenario = scenario.with_duration(options.duration_s)
    require_run_up(scenario)
    if options.site is not None:
        scenario = replace(scenario, limits=envelope(scenario.limits, load_site(options.site, options.place)))
    return scenario, file


def _knows(controller: str, learner: Learner) -> str:
    """What the learner knows that a certificate may rest on."""
    if not isinstance(learner, GpLearner):
        return NONE
    return STATE_ONLY if controller == STATE_ONLY_CONTROLLER else FULL


def controller_name(options: FlightOptions) -> str:
    """Name of the controller that flies."""
    name = options.controller
    if not options.as_published:
        return name
    if name not in (DEFAULT_CONTROLLER, STATE_ONLY_CONTROLLER) or not options.learning or options.learned is not None:
        raise InputError(
            f"--as-published flies the paper's controller with a learner, at most with --controller "
            f"{STATE_ONLY_CONTROLLER}: leave out other controllers, --no-learning and --learned"
        )
    return name


def _learner(file: files.TextFile, controller: str, believed: Vehicle, model: Model, options: FlightOptions) -> Learner:
    """The learner that begins with stored hyper-parameters."""
    if not options.learning or controller != DEFAULT_CONTROLLER:
        raise InputError(f"--learned {file.path}: goes with --controller {DEFAULT_CONTROLLER} and learning only")
    priors = parse_stored(file.text, str(file.path), believed).priors
    return GpLearner(model, LearnerConfig(priors=priors))
