"""`--set-params FILE`: parameters of the vehicle for one flight, set before it and put back after it.

What stood before is written to a journal before the first parameter is changed, one file for each vehicle, and the
journal is removed when all is back.  A flight that ends with the vehicle still armed (the pilot has it) or a program
that was killed leaves it: the next `offboard` that meets the vehicle disarmed puts the values back first.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flightstack.types import InputError
from mavlink_bridge.link import Link
from mavlink_bridge.param_session import ParamSession
from mavlink_bridge.signing import Signer
from mavlink_bridge.transport.address import Serial, Transport, UdpIn, UdpOut, framing_for
from mavlink_bridge.transport.clock import monotonic_us

SCHEMA = "flightstack.param-journal/1"
_ANSWER_LIMIT_S = 10.0
_DISARM_LIMIT_S = 3.0
"""So long the end of a flight waits for the vehicle to be disarmed."""
_SLICE_S = 0.02


@dataclass(frozen=True, slots=True)
class VehicleLink:
    """How the vehicle is reached."""

    transport: Transport
    address: UdpIn | UdpOut | Serial
    signer: Signer | None
    timeout_s: float
    """To wait for the first heartbeat."""

    def session(self, names: list[str]) -> ParamSession:
        """A new session that reads these parameters."""
        return ParamSession(Link(240, 191, framing=framing_for(self.address), signing=self.signer), names)

    def run(self, session: ParamSession, done: Callable[[], bool], limit_s: float) -> bool:
        """Exchange bytes until `done`, a problem, or the limit; whether it is done."""
        end_s = time.monotonic() + limit_s
        while not done() and not session.problem and time.monotonic() < end_s:
            now_us = monotonic_us()
            for data in self.transport.receive_all():
                session.receive(data, now_us)
            session.step(now_us)
            for data in session.to_send():
                self.transport.send(data)
            self.transport.wait(_SLICE_S)
        return done() and not session.problem


@dataclass(slots=True)
class Change:
    """What was set for a flight."""

    before: dict[str, float] = field(default_factory=dict)
    during: dict[str, float] = field(default_factory=dict)
    restored: bool | None = None
    """None where nothing was set."""

    def as_json(self) -> list[dict[str, Any]]:
        """The JSON's `parameters_set`."""
        return [
            {"name": name, "before": self.before[name], "set": value, "restored": self.restored}
            for name, value in self.during.items()
        ]


def journal_folder() -> Path:
    """Where journals lie: the user's state folder."""
    state = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(state) / "flightstack" / "parameters"


@contextmanager
def parameters_set(wire: VehicleLink, values: Mapping[str, float], say: Callable[[str], None]) -> Iterator[Change]:
    """The vehicle with these parameters inside the block, as it was after it; InputError where that can't be had."""
    change = Change()
    if not values and not any(journal_folder().glob("*.json")):
        yield change
        return
    session = wire.session(list(values))
    if not wire.run(session, lambda: session.identified, wire.timeout_s):
        if values:
            raise InputError(
                session.problem or f"no vehicle answered within {wire.timeout_s:g} s: no parameter was set"
            )
        yield change  # the companion says what is wrong
        return
    journal = journal_folder() / f"{session.uid:016x}-{session.system}.json"
    _put_back(wire, journal, say)
    if not values:
        yield change
        return
    if not wire.run(session, lambda: session.settled, _ANSWER_LIMIT_S):
        raise InputError(f"{session.problem or 'the vehicle does not tell its parameters'}: no parameter was set")
    change.before = {name: session.stored[name].value for name in values}
    change.during = dict(values)
    _write_journal(journal, change.before)
    try:
        session.write(values)
        if not wire.run(session, lambda: session.settled, _ANSWER_LIMIT_S):
            raise InputError(f"{session.problem or 'the vehicle does not take its parameters'}: put back")
        say(", ".join(f"{name} {change.before[name]:g} -> {value:g}" for name, value in values.items()))
        yield change
    finally:
        change.restored = _put_back(wire, journal, say)


def _put_back(wire: VehicleLink, journal: Path, say: Callable[[str], None]) -> bool:
    """Set what the journal says and remove it; whether the vehicle is as it was."""
    if not journal.exists():
        return True
    values = _read_journal(journal)
    session = wire.session(list(values))
    known = wire.run(session, lambda: session.settled, _ANSWER_LIMIT_S)
    if known:
        wire.run(session, lambda: not session.armed, _DISARM_LIMIT_S)
        session.write(values)
        if wire.run(session, lambda: session.settled, _ANSWER_LIMIT_S):
            journal.unlink(missing_ok=True)
            say("parameters put back: " + ", ".join(f"{name} {value:g}" for name, value in values.items()))
            return True
    why = session.problem or "the vehicle does not answer"
    say(f"parameters not put back ({why}); the next run that meets the vehicle disarmed does it, by {journal}")
    return False


def _write_journal(path: Path, before: Mapping[str, float]) -> None:
    """On the disk before anything is changed."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        with part.open("w") as file:
            json.dump({"schema": SCHEMA, "parameters": dict(before)}, file)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}: without a journal no parameter is set") from None


def _read_journal(path: Path) -> dict[str, float]:
    try:
        data = json.loads(path.read_text())
        if data["schema"] != SCHEMA:
            raise ValueError
        return {str(name): float(value) for name, value in data["parameters"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"{path}: not a journal of parameters; look at it, put them back by hand and remove it"
        ) from None
