"""What the live page shows: the newest of everything, put down by the flight and rendered when a browser asks."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np

from flightstack.types import TickRecord
from flightstack_logs import scene as viewer

_PATH_POINTS = 600
_POINT_US = 200_000
_REFERENCE_POINTS = 300
_EVENTS = 40


class Board:
    """Written by the flight's thread, read by the page's; each entry is replaced as a whole, so no lock is needed.

    What stays as it is is rendered once: points and events as they come, the scene when a browser asks for a new one.
    """

    def __init__(self) -> None:
        self._now: dict[str, Any] = {}
        self._path: deque[str] = deque(maxlen=_PATH_POINTS)
        self._events: deque[str] = deque(maxlen=_EVENTS)
        self._scene: dict[str, Any] = {}
        self._texts: dict[str, tuple[Any, str]] = {}
        self._point_due_us = 0

    def tick(self, t_us: int, record: TickRecord) -> None:
        """One tick of the stack."""
        at, wanted = record.measurement.pos_ned_m, record.reference.pos_ned_m
        learned, filtered = record.learned, record.filtered
        self._now |= {
            "t_s": t_us * 1e-6,
            "pos_ned_m": at.tolist(),
            "reference_ned_m": wanted.tolist(),
            "error_m": math.dist(at, wanted),
            "h": filtered.h,
            "filter": filtered.status,
            "changed": filtered.intervened,
            "stage": learned.stage,
            "points": learned.points,
            "sigma_mps2": learned.sigma_frd_mps2.tolist(),
            "thrust": record.command.thrust_norm,
            "guard": record.guard,
        }
        if t_us >= self._point_due_us:
            self._point_due_us = t_us + _POINT_US
            self._path.append(_rendered(at))

    def truth(self, t_us: int, truth: Any) -> None:
        """The simulator's truth; without a companion it is also what moves."""
        self._now |= {"t_s": t_us * 1e-6, "true_ned_m": [float(value) for value in truth.pos_ned_m]}
        if "pos_ned_m" not in self._now and t_us >= self._point_due_us:
            self._point_due_us = t_us + _POINT_US
            self._path.append(_rendered(self._now["true_ned_m"]))

    def status(self, mode: str, armed: bool, landed: bool) -> None:
        """What the vehicle says of itself."""
        self._now |= {"mode": mode, "armed": armed, "landed": landed}

    def timing(self, late_us: float, missed: int) -> None:
        """How punctual the loop is."""
        self._now |= {"late_us": late_us, "missed": missed}

    def event(self, t_us: int, name: str, text: str) -> None:
        """Something happened."""
        self._events.append(_rendered((t_us * 1e-6, name, text)))
        if name == "phase":
            self._now["phase"] = text

    def scene(self, view: viewer.Shown) -> None:
        """What does not move, what a new certificate allows, or how the vehicle would stop."""
        if isinstance(view, viewer.SceneRegion):
            more: dict[str, Any] = {"certified": _region(view)}
        elif isinstance(view, viewer.StoppingWay):
            more = {"way": view.pos_ned_m}
        else:
            path = np.zeros((0, 3)) if view.reference_ned_m is None else view.reference_ned_m
            more = {"reference": path[:: max(1, len(path) // _REFERENCE_POINTS)], "site": list(view.site_ned_m)}
            if view.region is not None:
                more["region"] = _region(view.region)
        self._scene |= more

    def as_json(self) -> bytes:
        """All of it; what is not finite is null."""
        for name, value in list(self._scene.items()):
            if name not in self._texts or self._texts[name][0] is not value:
                self._texts[name] = value, f'"{name}":{_rendered(value)}'
        scene = ",".join(text for _, text in list(self._texts.values()))
        path, events = ",".join(self._path), ",".join(self._events)
        return (
            f'{{"now":{_rendered(dict(self._now))},"path":[{path}],"events":[{events}],"scene":{{{scene}}}}}'.encode()
        )


def _region(region: viewer.SceneRegion) -> dict[str, Any]:
    return {"shape": region.shape, "center": list(region.center_ned_m), "half": list(region.half_size_m)}


def _rendered(value: Any) -> str:
    return json.dumps(_finite(value), separators=(",", ":"))


def _finite(value: Any) -> Any:
    """For a page: to the millimetre and millisecond; what is not finite as null."""
    if isinstance(value, float):
        return round(value, 3) if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, np.ndarray):
        return _finite(value.tolist())
    if isinstance(value, Iterable) and not isinstance(value, str | bytes):
        return [_finite(each) for each in value]
    return value
