"""The options that several verbs have: one definition each."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from enum import StrEnum
from functools import wraps
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, get_type_hints

import typer


class SensorGrade(StrEnum):
    """Grades of sensors and estimate."""

    mocap = "mocap"
    gps = "gps"
    px4_sih = "px4-sih"
    px4_sih_ekf = "px4-sih-ekf"


class PlantName(StrEnum):
    """Plants that can fly."""

    native = "native"
    jsbsim = "jsbsim"


def _no_option(path: Path | None) -> Path | None:
    """A file, not the next option: `--json --no-learning` forgot it."""
    if path is not None and str(path).startswith("-"):
        raise typer.BadParameter(f"a file is expected, not {path}: write ./{path} for one of that name")
    return path


ScenarioArgument = Annotated[str, typer.Argument(help="A shipped scenario, a .toml file, or `waypoints`.")]
WaypointsArgument = Annotated[str | None, typer.Argument(help="The file of `waypoints` (.toml or .csv).")]
VehicleOption = Annotated[str | None, typer.Option(help="Vehicle that the controller believes in: name or .toml file.")]
JsonOption = Annotated[
    Path | None, typer.Option("--json", callback=_no_option, help="Write the machine-readable result to this file.")
]
LogOption = Annotated[Path | None, typer.Option("--log", callback=_no_option, help="Write the log to this file.")]
LogWireOption = Annotated[
    bool, typer.Option("--log-wire", help="Log every MAVLink datagram too (some 30 kB more a second).")
]
LiveOption = Annotated[
    int | None,
    typer.Option(
        "--live", min=1, max=65_534, metavar="[PORT]",
        help="Show it while it flies, on this machine only: Foxglove WebSocket on PORT (8765), a page on PORT + 1.",
    ),
]  # fmt: skip
OutOption = Annotated[
    Path | None, typer.Option("--out", callback=_no_option, help="Folder for log and report (default: new, in runs/).")
]
DurationOption = Annotated[float | None, typer.Option(help="Track for so many seconds instead of the scenario's.")]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of all randomness: the same seed flies the same flight.")]
ControllerOption = Annotated[str, typer.Option(help="Controller: one of those named below.", metavar="NAME")]
NoLearningOption = Annotated[bool, typer.Option("--no-learning", help="Fly without the learner.")]
LearnedOption = Annotated[Path | None, typer.Option(help="File of hyper-parameters for the learner to begin with.")]
NoFilterOption = Annotated[bool, typer.Option("--no-filter", help="Fly without the barrier filter.")]
AsPublishedOption = Annotated[
    bool, typer.Option("--as-published", help="Fly the paper's own filter, which can't be certified robustly.")
]
PhysicsForPx4Option = Annotated[
    bool, typer.Option("--px4-hil", help="Be the physics behind a real PX4, which connects to --hil-port.")
]
HilPortOption = Annotated[
    int, typer.Option("--hil-port", min=1, max=65_535, help="TCP port of --px4-hil (PX4 instance i: 4560 + i).")
]
SetParamsOption = Annotated[
    str | None,
    typer.Option(
        "--set-params", help="Set these PX4 parameters for the flight, put back after it: name or .toml file."
    ),
]
BelieveFileOption = Annotated[
    bool, typer.Option("--believe-file", help="Fly though PX4's rotors or hover thrust contradict the vehicle file.")
]
CertificateOption = Annotated[Path | None, typer.Option(help="Fly inside the region of this certificate (.json).")]
SiteOption = Annotated[
    Path | None,
    typer.Option("--site", help="Keep the vehicle in this site (.toml, .plan, .geojson; vehicle: the stored fence)."),
]
HomeOption = Annotated[
    str | None,
    typer.Option(
        "--home", help="Where the vehicle stands: degrees, metres above the sea.", metavar="LAT,LON,ALT,HEADING"
    ),
]
UnprotectedOption = Annotated[
    bool, typer.Option("--unprotected-ok", help="Exit 0 even where protection was asked for and not had, or left.")
]
TruthOption = Annotated[str | None, typer.Option(help="Vehicle that really flies; the controller never sees it.")]
SigningKeyOption = Annotated[
    Path | None,
    typer.Option(help="Sign with the key in this file (MAVLink 2) and hear nothing unsigned.", metavar="FILE"),
]
SensorsOption = Annotated[SensorGrade | None, typer.Option(help="Grade of sensors (default: the scenario's).")]
PlantOption = Annotated[PlantName, typer.Option(help="Physics.")]
FaultOption = Annotated[
    str | None,
    typer.Option(
        help="Inject faults: NAME[:VALUE][@SECONDS after take-off][+DURATION], several with commas.", metavar="NAME"
    ),
]


def asks(*offers: type) -> Callable[[Callable[[Any], None]], Callable[..., None]]:
    """Make a function of one namespace a verb that has the options of these classes, in their order.

    An annotation is an option, its value the default; one that has none must be given.  Enumerations come as text.
    """
    none = inspect.Parameter.empty
    offered = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=vars(offer).get(name, none), annotation=hint)
        for offer in offers
        for name, hint in get_type_hints(offer, include_extras=True).items()
    ]

    def verb_of(function: Callable[[Any], None]) -> Callable[..., None]:
        @wraps(function)
        def run(**given: Any) -> None:
            plain = {name: value.value if isinstance(value, StrEnum) else value for name, value in given.items()}
            function(SimpleNamespace(**plain))

        run.__signature__ = inspect.Signature(offered)  # type: ignore[attr-defined]
        run.__annotations__ = {option.name: option.annotation for option in offered}
        return run

    return verb_of
