"""`--set-params FILE`: parameters of the vehicle for one flight, set before it and put back after it.

What stood before is written to a journal before the first parameter is changed, one file for each vehicle, and the
journal is removed when all is back; what somebody else has set meanwhile is left as it is.  A flight that ends with
the vehicle still armed (the pilot has it) or a program that was killed leaves it: the next `offboard` that meets the
vehicle disarmed puts the values back first.
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
    left: frozenset[str] = frozenset()
    """Set by somebody else meanwhile, and not put back."""

    def as_json(self) -> list[dict[str, Any]]:
        """The JSON's `parameters_set`."""
        return [
            {
                "name": name,
                "before": self.before[name],
                "set": value,
                "restored": self.restored and name not in self.left,
            }
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
    _write_journal(journal, change)
    try:
        session.write(values)
        if not wire.run(session, lambda: session.settled, _ANSWER_LIMIT_S):
            raise InputError(f"{session.problem or 'the vehicle does not take its parameters'}: put back")
        say(", ".join(f"{name} {change.before[name]:g} -> {value:g}" for name, value in values.items()))
        yield change
    finally:
        change.restored = _put_back(wire, journal, say, change)


def _put_back(wire: VehicleLink, journal: Path, say: Callable[[str], None], change: Change | None = None) -> bool:
    """Set what the journal says and remove it; whether that was done.  `change` is told what was left as it is."""
    if not journal.exists():
        return True
    values, during = _read_journal(journal)
    session = wire.session(list(values))
    known = wire.run(session, lambda: session.settled, _ANSWER_LIMIT_S)
    if known:
        wire.run(session, lambda: not session.armed, _DISARM_LIMIT_S)
        others = {n for n in during if n in values and not (session.has(n, during[n]) or session.has(n, values[n]))}
        if others:
            now = ", ".join(f"{name} {session.stored[name].value:g}" for name in sorted(others))
            say(f"left as somebody else set it: {now}")
        values = {name: value for name, value in values.items() if name not in others}
        if change is not None:
            change.left = frozenset(others)
        session.write(values)
        if wire.run(session, lambda: session.settled, _ANSWER_LIMIT_S):
            journal.unlink(missing_ok=True)
            back = ", ".join(f"{name} {value:g}" for name, value in values.items())
            say(f"parameters put back: {back or 'none'}")
            return True
    why = session.problem or "the vehicle does not answer"
    say(f"parameters not put back ({why}); the next run that meets the vehicle disarmed does it, by {journal}")
    return False


def _write_journal(path: Path, change: Change) -> None:
    """On the disk before anything is changed."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        with part.open("w") as file:
            json.dump({"schema": SCHEMA, "parameters": change.before, "set": change.during}, file)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}: without a journal no parameter is set") from None


def _read_journal(path: Path) -> tuple[dict[str, float], dict[str, float]]:
    """What stood before and what was set (older journals do not say), by name."""
    try:
        data = json.loads(path.read_text())
        if data["schema"] != SCHEMA:
            raise ValueError
        before, during = (
            {str(name): float(value) for name, value in table.items()}
            for table in (data["parameters"], data.get("set", {}))
        )
        return before, during
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"{path}: not a journal of parameters; look at it, put them back by hand and remove it"
        ) from None
