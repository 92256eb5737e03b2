"""The kinds of parts, and how a process computes one.  Everything is imported only where it is needed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class PartContext:
    """What a part may use beside its arguments."""

    folder: Path
    """Where it may leave files; made by whoever writes there."""
    stop_requested: Callable[[], str] = lambda: ""
    on_progress: Callable[[float, str], None] = lambda share, phase: None


class PartFailed(Exception):
    """A part that could not be brought to its end; the text says why, one line."""


def _example1(bench: PartContext, starts: int) -> dict[str, Any]:
    from flightstack_paper.example import measure

    return measure(starts)


def _theory(bench: PartContext) -> dict[str, Any]:
    from flightstack_paper.theory import measure

    return measure()


def _tracking(bench: PartContext, **given: Any) -> dict[str, Any]:
    from flightstack_paper.tracking import TrackingFlight, fly

    return fly(TrackingFlight(**given), bench)


def _inputs(bench: PartContext, **given: Any) -> dict[str, Any]:
    from flightstack_paper.inputs import Study, study

    asked = Study(**{**given, "displacements_m": tuple(given.get("displacements_m", ()))})
    try:
        rows = study(asked, stop_requested=bench.stop_requested, on_progress=bench.on_progress)
    except RuntimeError as error:
        raise PartFailed(str(error)) from None
    return {"rows": rows}


def _certify(bench: PartContext, **given: Any) -> dict[str, Any]:
    from flightstack_paper.exploration import Exploration, explore

    return explore(Exploration(**given), bench)


KINDS: Mapping[str, Callable[..., dict[str, Any]]] = {
    "example1": _example1,
    "theory": _theory,
    "tracking": _tracking,
    "inputs": _inputs,
    "certify": _certify,
}
"""Name -> (bench, arguments) -> a result that JSON can hold."""
