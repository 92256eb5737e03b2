"""`flightstack log replay`: a flight's recorded inputs run through today's stack, compared with what it did then.

The log holds all that the companion was given: every message that it goes by with the time of its step
(`recorded_inputs`), the files and the settings, and of `offboard` this machine's clock at each step and what the
dead-man said.  The companion of today gets them again, step by step, and writes its own tables, which are compared with
the recorded ones, bit for bit.  What explains a tick is in the log 25 times a second only; the digest of each tick
tells from which one on anything differs.  Certificates that were made beside a flight in real time come at the tick at
which they came then.
"""

from __future__ import annotations

import math
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flightstack.cli.compiled import ensure_compiled
from flightstack.cli.flight import TICK_MS, FlyOptions, Setup, prepare
from flightstack.cli.offboard import OffboardOptions, companion_of
from flightstack.cli.preparation import Prepared, prepare_flight
from flightstack.cli.recorded_inputs import recorded_inputs
from flightstack.cli.recorder import LogObserver
from flightstack.cli.replayed import DIGEST, Replayed, differences_of
from flightstack.cli.workshop import Served, Workshop
from flightstack.types import InputError, TickRecord
from flightstack_logs.log_clock import LogClock
from flightstack_logs.reader import read
from flightstack_logs.tables import Log
from flightstack_logs.topics import CERTIFICATE, RESULT
from flightstack_logs.writer import COMPACT_FLUSH_PERIOD_US, FlightLog
from mavlink_bridge import messages
from mavlink_bridge.companion import Companion, MissionPlanner
from mavlink_bridge.dead_man_frames import NOBODY, DeadManRecord
from mavlink_bridge.link import Link
from mavlink_bridge.px4 import COMPONENT_AUTOPILOT

_EXPLORATION = "ExplorationPlanner"
_FASTER, _WATCHED = "FasterPlanner", "FlownSpeeds"
"""Of `certify --site`: the one that explores, and the one that changes no mission."""
_STOPPED = "the user asked to stop ("
_LOST = "filter: certifies nothing more"


def replay(
    path: Path, *, tolerance: float = 0.0, on_progress: Callable[[float, str], None] = lambda share, phase: None
) -> Replayed:
    """Replay the flight of a log; InputError, one line, where it holds none that can be replayed.

    Numbers count as the same up to `tolerance` (absolute, or relative to the recorded one).
    """
    log = read(path, as_logged=True)
    settings = _settings(log)
    ensure_compiled(lambda text: on_progress(0.0, text))
    with tempfile.TemporaryDirectory() as folder:
        again = Path(folder) / "again.mcap"
        _run(log, _flight_of(log, settings, Path(folder)), again, on_progress)
        new = read(again)
    until_us = _whole_until_us(log)
    found = differences_of(log, new, tolerance, until_us)
    digest = next((each for each in found if each.field == DIGEST), None)
    differing = [each for each in found if each is not digest]
    first_s = digest.first_s if digest is not None and tolerance == 0.0 else None
    until_s = None if until_us is None else 1e-6 * until_us
    return Replayed(str(path), len(log.tables["/tick"]), tolerance == 0.0, differing, first_s, until_s)


def _whole_until_us(log: Log) -> int | None:
    """Up to when a log that was cut off (or mended since) holds everything; None where the flight wrote its end.

    What is packed of all topics is written together: only the last of these times may be there in part.
    """
    if log.complete and log.attachment(RESULT) is not None:
        return None
    return log.span_us[1] - COMPACT_FLUSH_PERIOD_US


def _settings(log: Log) -> Mapping[str, str]:
    """How it was flown; InputError where that can't be flown again."""
    settings = _replayable(log)
    if "/tick" not in log.tables:
        raise InputError(f"log {log.path}: never armed: the stack was never run, so there is nothing to replay")
    return settings


def _replayable(log: Log) -> Mapping[str, str]:
    settings = log.metadata.get("settings", {})
    if log.kind != "mcap" or "pace" not in settings:
        raise InputError(f"log {log.path}: holds no flight of `flightstack fly` or `offboard`; nothing to replay")
    if "connect" in settings and "/step" not in log.tables:
        raise InputError(f"log {log.path}: does not say when each step was; it is of another version")
    if (planner := settings.get("planner", _EXPLORATION)) not in (_EXPLORATION, _FASTER, _WATCHED):
        raise InputError(f"log {log.path}: planned on the way by {planner}; only certify's explorers are known")
    return settings


@dataclass(frozen=True, slots=True)
class _Flight:
    """A recorded flight, ready to be given its inputs again."""

    prepared: Prepared
    companion: Callable[[LogObserver], Companion]
    steps: Sequence[tuple[int, int, int]]
    """Log time, time at which was received, time at which was decided; microseconds."""


def _flight_of(log: Log, settings: Mapping[str, str], folder: Path) -> _Flight:
    if any(text.startswith(_LOST) for text in _texts(log)):
        raise InputError(f"log {log.path}: the process that made certificates was lost, at a time that is not known")
    if "connect" in settings:
        return _of_offboard(log, settings, folder)
    setup, planner = _prepared(log, settings, folder)
    _answer_as(log, setup.flight)

    def companion(observer: LogObserver) -> Companion:
        flight = setup.flight
        return Companion(Link(240, 191), flight.stack, flight.scenario, observer, setup.companion, planner)

    times = range(TICK_MS * 1000, log.span_us[1] + 1, TICK_MS * 1000)
    return _Flight(setup.flight, companion, [(now_us, now_us, now_us) for now_us in times])


def _of_offboard(log: Log, settings: Mapping[str, str], folder: Path) -> _Flight:
    try:
        options = OffboardOptions(
            **_common(log, settings, folder),
            connect=settings["connect"],
            arm=settings["arm"] == "True",
            dry_run=settings["dry_run"] == "True",
            believe_file=settings["believe_file"] == "True",
            heartbeat_timeout_s=float(settings["heartbeat_timeout_s"]),
            dead_man=settings["dead_man"] == "on",
            where=_place(settings["place"]),
        )
    except (KeyError, ValueError) as error:
        raise _unknown(log, error) from None
    prepared = prepare_flight(options)
    _answer_as(log, prepared)
    times = log.tables["/step"].t_us.tolist()
    steps = [
        (t_us, *each) for t_us, each in zip(times, _rows(log, "/step", ("received_us", "decided_us")), strict=True)
    ]
    return _Flight(prepared, lambda to: companion_of(Link(240, 191), options, prepared, to)[0], steps)


def _answer_as(log: Log, prepared: Prepared) -> None:
    """Certificates that were made beside the flight come when they came; InputError where that is not in the log."""
    workshop, table = prepared.protection.workshop, log.tables.get("/certifier")
    if not isinstance(workshop, Workshop):
        return
    if table is None and any(text.startswith("filter: certificate ") for text in _texts(log)):
        raise InputError(f"log {log.path}: does not say when its certificates were ready; it is of another version")
    workshop.again(map(Served._make, () if table is None else _rows(log, "/certifier", Served._fields)))


def _rows(log: Log, topic: str, names: Sequence[str]) -> list[tuple[Any, ...]]:
    """Columns of a table, row by row; InputError where it lacks one."""
    try:
        columns = [log.tables[topic][name].tolist() for name in names]
    except KeyError as error:
        raise _unknown(log, error) from None
    return list(zip(*columns, strict=True))


def _texts(log: Log) -> list[str]:
    return [str(text) for text in log.tables["/events"]["text"]] if "/events" in log.tables else []


def _place(words: str) -> tuple[float, float] | None:
    latitude, longitude = (float(word) for word in words.split()) if words else (math.nan, math.nan)
    return None if math.isnan(latitude) else (latitude, longitude)


def _unknown(log: Log, error: Exception) -> InputError:
    return InputError(f"log {log.path}: does not say how it was flown ({error}); it is of another version")


def _prepared(log: Log, settings: Mapping[str, str], folder: Path) -> tuple[Setup, MissionPlanner | None]:
    """The flight, ready to be given its inputs again, and what planned it on the way."""
    try:
        options = FlyOptions(**_common(log, settings, folder), realtime=settings["pace"] != "lockstep")
    except (KeyError, ValueError) as error:
        raise _unknown(log, error) from None
    if settings.get("planner", _WATCHED) == _WATCHED:
        return prepare(options), None
    from flightstack.cli.certify import EXPLORE_S, ExplorationPlanner, prepare_certify
    from flightstack.cli.certify_site import prepare_explored
    from flightstack.explore import Explorer

    try:
        explore_s = float(settings[EXPLORE_S])
    except (KeyError, ValueError):
        raise InputError(
            f"log {log.path}: was explored by rules that it does not name, or by another version"
        ) from None
    options = replace(options, duration_s=explore_s)
    if settings["planner"] == _FASTER:
        return prepare_explored(options)
    setup = prepare_certify(options)
    assert setup.flight.protection.watched is not None
    return setup, ExplorationPlanner(Explorer(), setup.flight.protection.watched)


def _common(log: Log, settings: Mapping[str, str], folder: Path) -> dict[str, Any]:
    """The options that all flights have, their files laid out in a folder; KeyError or ValueError where one lacks."""
    laid: dict[str, Path] = {}
    for item in log.attachments:
        if (name := Path(item.name).name) in ("", ".."):  # no file's name, and none of ours
            continue
        laid[name] = folder / name
        laid[name].write_bytes(item.data)
    scenario, words = laid["scenario.toml"], settings["filter"]
    waypoints = settings["scenario"] == "waypoints"
    return {
        "scenario": "waypoints" if waypoints else str(scenario),
        "waypoints": str(scenario) if waypoints else None,
        "vehicle": str(laid["vehicle.toml"]),
        "duration_s": float(settings["duration_s"]),
        "controller": settings["controller"],
        "learning": settings["learning"] == "on" or settings["controller"] != "flatness",
        "learned": next((path for name, path in laid.items() if name.startswith("learned")), None),
        "filtering": words != "off: --no-filter",
        "as_published": words.startswith("as-published"),
        "certificate": laid.get(CERTIFICATE) if "certificate" in settings else None,
        "site": next((path for name, path in laid.items() if name.startswith("site.")), None),
        "sensors": settings.get("sensors"),
    }


def records_of(log: Log) -> list[TickRecord]:
    """Every tick of today's stack on a log's inputs; InputError where it holds no flight in lockstep."""
    settings = _replayable(log)
    ensure_compiled(lambda text: None)
    found: list[TickRecord] = []
    with tempfile.TemporaryDirectory() as folder:
        flight = _flight_of(log, settings, Path(folder))
        _run(log, flight, Path(folder) / "again.mcap", lambda share, phase: None, found.append)
    return found


def _run(
    log: Log,
    flight: _Flight,
    path: Path,
    on_progress: Callable[[float, str], None],
    on_record: Callable[[TickRecord], None] | None = None,
) -> None:
    """Give today's companion what the recorded one was given; its tables go into a log of their own."""
    messages.prepare()
    inputs, stops, reports = deque(recorded_inputs(log)), _stops(log), deque(_dead_man(log))
    out = FlightLog.open(path, metadata={}, compact=True)
    observer = flight.prepared.observer(out, clock := LogClock(out, zero_us=0, utc_us=0), truth=True)
    observer.record_to = on_record
    companion = flight.companion(observer)
    observer.companion = companion
    vehicle, report = Link(1, COMPONENT_AUTOPILOT), None
    try:
        for count, (t_us, received_us, decided_us) in enumerate(flight.steps):
            clock.step(t_us)
            if t_us in stops:
                companion.stop(stops[t_us])
            while inputs and inputs[0].t_us <= t_us:
                vehicle.send(inputs.popleft().message)
            for data in vehicle.datagrams_to_send():
                companion.receive_datagram(data, received_us)
            while reports and reports[0][0] <= t_us:
                report = reports.popleft()
            if report is not None:
                companion.hear_dead_man(*report[1:])
            companion.step(decided_us)
            companion.link.datagrams_to_send()
            if count % 250 == 0:
                on_progress(count / len(flight.steps), companion.phase)
    finally:
        out.close()


def _dead_man(log: Log) -> Iterator[tuple[int, DeadManRecord, str]]:
    """Log time, what the dead-man had done, and why it was no more."""
    table = log.tables.get("/dead_man")
    if table is None:
        return
    names = [name for name in DeadManRecord._fields if name in table.columns]
    for t_us, (ended, *row) in zip(table.t_us.tolist(), _rows(log, "/dead_man", ("ended", *names)), strict=True):
        report = NOBODY._replace(**dict(zip(names, row, strict=True)))
        yield t_us, report, "the dead-man's process has ended" if ended else ""


def _stops(log: Log) -> dict[int, str]:
    """At which step the user's wish to end the flight was seen, and its words."""
    events = log.tables.get("/events")
    if events is None:
        return {}
    return {
        int(t_us): str(text).partition(_STOPPED)[2].removesuffix(")")
        for t_us, name, text in zip(events.t_us, events["name"], events["text"], strict=True)
        if name == "state" and _STOPPED in str(text)
    }
