"""Finding and reading the user's files: vehicles, scenarios, the outputs' places.  Every failure is one clear line."""

from __future__ import annotations

import json
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from flightstack.cli.shipped import path_of
from flightstack.cli.shipped import shipped_names as shipped_names
from flightstack.scenario import Scenario, parse_scenario, waypoints_scenario
from flightstack.types import InputError
from flightstack.vehicle import Vehicle, parse_vehicle
from flightstack.waypoints import parse_waypoints
from mavlink_bridge.param_file import ParamFile, parse_params

if TYPE_CHECKING:
    from flightstack.cli.result import FlightResult

DEFAULT_VEHICLE = "quad-x"


@dataclass(frozen=True, slots=True)
class TextFile:
    """A text and where it came from."""

    path: Path
    text: str


MOST_CHARACTERS = 10_000_000
"""Of a text: what is larger, or has no end (`/dev/zero`), took all of the machine's memory."""


def read_text(path: Path) -> TextFile:
    """A UTF-8 text file; InputError where it can't be read or is larger than 10 MB."""
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(MOST_CHARACTERS + 1)
        if len(text) > MOST_CHARACTERS:
            raise InputError(f"{path}: is larger than the {MOST_CHARACTERS / 1e6:.0f} MB that are read of a text file")
        return TextFile(path, text)
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file (UTF-8 expected)") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None


def find(kind: str, name: str) -> TextFile:
    """A name of a shipped file or a path to one's own."""
    return read_text(path_of(kind, name))


def load_vehicle(name: str | None) -> tuple[Vehicle, TextFile]:
    """The vehicle of a name or path (None: the default)."""
    file = find("vehicles", name or DEFAULT_VEHICLE)
    return parse_vehicle(file.text, str(file.path)), file


def load_params(name: str | None) -> ParamFile:
    """The parameters of a file to set, by name or path (None: none)."""
    if name is None:
        return ParamFile({})
    file = find("params", name)
    return parse_params(file.text, str(file.path))


def load_scenario(name: str, waypoints: str | None = None) -> tuple[Scenario, TextFile]:
    """The scenario of a name or path; `waypoints` needs its file, no other scenario takes one."""
    if name == "waypoints":
        if waypoints is None:
            raise InputError("scenario waypoints needs a file of waypoints (.toml or .csv)")
        file = read_text(Path(waypoints))
        return waypoints_scenario(parse_waypoints(file.text, waypoints), waypoints), file
    if waypoints is not None:
        raise InputError(f"scenario {name} takes no file; only `waypoints` does")
    file = find("scenarios", name)
    return parse_scenario(file.text, str(file.path)), file


def new_run_folder(scenario: str, seed: int | None) -> Path:
    """A fresh folder below `runs/` of the working directory, named by time, scenario and seed."""
    stamp = time.strftime("%Y%m%d-%H%M%S")
    name = f"{stamp}-{scenario}" + (f"-seed{seed}" if seed is not None else "")
    for attempt in range(1000):
        folder = Path("runs") / (name if attempt == 0 else f"{name}-{attempt + 1}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise InputError(f"{folder}: {error.strerror}; choose a place with --out") from None
        return folder
    raise InputError(f"runs/{name}: too many runs of this name; choose a place with --out")


def write_json(path: Path | None, data: object) -> None:
    """Write a JSON result (None: nobody asked for it); InputError where that can't be done."""
    if path is not None:
        write_text(path, json.dumps(data, indent=1) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file, its folder too; InputError where that can't be done, and what was there before stays."""
    part = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if is_stream(path):
            path.write_text(text, encoding="utf-8")
            return
        target = path.resolve()
        part = target.with_name(target.name + ".part")
        part.write_text(text, encoding="utf-8")
        part.replace(target)
    except OSError as error:
        with suppress(OSError):
            if part is not None:
                part.unlink(missing_ok=True)
        raise InputError(f"{path}: {error.strerror}; choose another place for the result") from None


def is_stream(path: Path) -> bool:
    """Whether it is no file of its own: a device, a pipe, what this process has open (/dev/stdout, also with `>`)."""
    if path.is_relative_to("/dev/shm"):  # a folder in memory like any other
        return path.exists() and not path.is_file()
    return path.is_relative_to("/dev") or path.is_relative_to("/proc") or (path.exists() and not path.is_file())


def require_place_of_a_log(path: Path | None) -> None:
    """InputError for a device or a pipe: a log is read again after the flight, and a pipe that nobody reads waits."""
    if path is not None and is_stream(path) and not path.is_dir():
        raise InputError(f"log {path}: a device or a pipe can't be read again; choose a file")


def write_flight_report(log_path: Path, report_path: Path, result: FlightResult) -> None:
    """Turn the log into the flight's page; `result.report` says where, or `result.report_problem` why not."""
    from flightstack_logs.reader import read
    from flightstack_logs.report.log_input import from_log
    from flightstack_logs.report.page import write_report

    try:
        result.report = str(report_path)
        report_path.parent.mkdir(parents=True, exist_ok=True)  # the log may lie elsewhere
        write_report(from_log(read(log_path), result.as_json()), report_path)
    except (InputError, OSError, MemoryError) as error:
        result.report = None
        words = "not enough memory for it; `flightstack log report` makes it elsewhere"
        result.report_problem = f"no report: {words if isinstance(error, MemoryError) else error}"
