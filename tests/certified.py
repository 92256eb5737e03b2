"""Certificates and filters' words for tests of what is round the filter: made up, nothing in them is proven."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flightstack.barrier.condition import Setting
from flightstack.barrier.file import certificate_to_json
from flightstack.barrier.records import MARGINS, Authority, AxisCertificate, Budget, Certificate, Margin, Response
from flightstack.barrier.shapes import Barrier, Quadratic
from flightstack.cli import protection
from flightstack.learning.stored import vehicle_hash
from flightstack.types import Filtered, changed
from flightstack.vehicle import Vehicle

CENTRE = (0.1, -0.2, -1.5)


def authority(axis: int) -> Authority:
    """The same at every speed: -3 to 3 m/s^2 sideways, -6 to 4 down."""
    v, one = np.linspace(-3.0, 3.0, 7), np.ones(7)
    low, high, gain = (-6.0, 4.0, 1.0) if axis == 2 else (-3.0, 3.0, 0.0)
    return Authority(v, 9.0 * gain * one, gain * one, low * one, high * one, 0.1 * one, 0.1 * one)


def axis_certificate(axis: int, barrier: Barrier) -> AxisCertificate:
    """One axis; its margins are 0.01, 0.02, ... m/s^2."""
    margins = tuple(Margin(name, 0.01 * (i + 1), f"figure {i} <of {axis}>") for i, name in enumerate(MARGINS))
    cells = np.array([[-0.1, 0.1, -0.1, 0.1, 0.5, 1.25]])
    setting, response = Setting(4.0, 0.01, 0.05, 0.006), Response(0.15, 0.0075, 0.02)
    return AxisCertificate(axis, barrier, setting, response, authority(axis), margins, cells)


def certificate(semi_m: float = 1.0, semi_mps: float = 0.5, **changes: Any) -> Certificate:
    """Upright ellipses on all three axes."""
    axes = tuple(axis_certificate(i, Quadratic(0.0, 0.0, semi_m**-2, 0.0, semi_mps**-2)) for i in range(3))
    given: dict[str, Any] = {
        "mode": "sound", "centre_ned_m": CENTRE, "axes": axes, "budget": Budget.square(5.0, 15.0, 17.0, 0.6),
        "delta": 0.01, "k_sigma": 4.3, "knowledge": {}, "version": 0,
    }  # fmt: skip
    return Certificate(**(given | changes))


def says(status: int, **more: Any) -> Filtered:
    """What a filter says in this status; 3 and more change the command."""
    told = {"h": 0.4, "h_state": 0.5, "version": 0.0, "margins_ned_ps": (1.0, 2.0, 3.0)}
    return changed(Filtered.nothing(), status=float(status), intervened=float(status >= 3), **(told | more))


def for_the_papers_path(scale: float = 1.0, version: int = 5) -> Certificate:
    """The region of `paper-tracking`, or so much of it, with accelerations and lags that are true of its vehicle.

    1.4 times the believed mass, 0.1 g to the north.  Nothing covers it: it is for flying through the filter, no proof.
    """
    v, one = np.linspace(-3.0, 3.0, 7), np.ones(7)
    axes = []
    for axis, (semi_m, semi_mps) in enumerate(((2.0, 1.2), (1.5, 1.35), (1.0, 0.6))):
        e, speed, slant = scale * semi_m, scale * semi_mps, 0.3
        room = 1.0 - slant * slant
        shape = Quadratic(0.0, 0.0, 1.0 / (e * e * room), slant / (e * speed * room), 1.0 / (speed * speed * room))
        offset, gain, low, high, response = 0.0, 0.0, -2.0, 2.0, Response(1.0 / 6.5, 0.03 / 6.5, 0.008)
        if axis == 0:
            offset, low, high = 0.98, -1.02, 2.98
        elif axis == 2:
            offset, gain, response = 9.81, 1.0 / 1.4, Response(0.03, 0.0, 0.008)
            low, high = offset - gain * 16.5, offset - gain * 8.0
        table = Authority(v, offset * one, gain * one, low * one, high * one, 0.15 * one, 0.15 * one)
        setting = Setting(2.0, 0.02, 0.1, 0.004)
        made = axis_certificate(axis, shape)
        axes.append(replace(made, authority=table, response=response, setting=setting))
    box = Budget.square(8.0, 16.5, 17.6, 0.6)
    return Certificate("sound", (0.0, 0.0, -1.5), tuple(axes), box, 0.05, 4.5, {}, version)


@contextmanager
def unchecked() -> Iterator[None]:
    """Made-up certificates may be flown: the independent checker, which refuses them, is not asked."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(protection, "require_checked", lambda path: None)
        patch.setattr(protection, "require_premises", lambda path, certificate, sensors: None)
        yield


def write(path: Path, certificate: Certificate, vehicle: Vehicle) -> Path:
    """The certificate's file, made out for a vehicle."""
    known = {"vehicle": vehicle.name, "vehicle_hash": vehicle_hash(vehicle)}
    path.write_text(certificate_to_json(replace(certificate, knowledge=known)))
    return path
