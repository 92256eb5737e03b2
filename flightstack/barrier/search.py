"""The largest region of one axis while flying: ellipses about the centre, in steps of a few milliseconds.

Such an ellipse has two ratios, its slant and how fast it is for its width; its size is what the condition and the safe
set leave (`design.grow`).  The ledger depends on the ellipse, so each is grown until its own margins are no larger than
those that it was grown with.  Coarse at first, then finer about the best; a later search begins where the last ended.
`design.largest` searches finer, with more families, and takes seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from typing import NamedTuple, TypeVar

import numpy as np

from flightstack.barrier.condition import Setting
from flightstack.barrier.design import SafeSet, at_level, grow
from flightstack.barrier.design_search import farthest
from flightstack.barrier.margins import Ledger
from flightstack.barrier.records import Authority, AxisCertificate, Response
from flightstack.barrier.shapes import Barrier, Quadratic

_T = TypeVar("_T")
_SLANTS, _SPEEDS = (0.2, 0.35, 0.5), (0.7, 0.85, 1.0)
_STEPS = ((0.12, 0.12), (0.06, 0.06))
_SLANT_MOST, _SPEED_LEAST = 0.85, 0.3
_ROUNDS = 6
GROWING = ("eta", "off_m", "off_mps", "inner")
_LEAST_BRAKE_MPS2 = 0.05


class Ratios(NamedTuple):
    """An ellipse but for its size."""

    slant: float
    """p12 / sqrt(p11 p22)."""
    speed: float
    """Of the safe set's aspect: greatest speed for the width, or what braking stops in the half of it."""


Worth = Callable[[Barrier], float]


class Axis(NamedTuple):
    """One axis being designed."""

    axis: int
    safe: SafeSet
    authority: Authority
    response: Response


def ellipse(axis: Axis, ratios: Ratios) -> Quadratic:
    """The largest ellipse of these ratios in the safe set."""
    safe, authority = axis.safe, axis.authority
    at = int(np.argmin(np.abs(authority.v_mps)))
    up = float(-authority.u_low_mps2[at] - authority.error_low_mps2[at])
    down = float(authority.u_high_mps2[at] - authority.error_high_mps2[at])
    fast = math.sqrt(max(min(up, down), _LEAST_BRAKE_MPS2) * safe.limit_m)
    e, v = safe.limit_m, ratios.speed * min(fast, safe.limit_mps or fast)
    room = 1.0 - ratios.slant**2
    shape = Quadratic(0.0, 0.0, 1.0 / (e * e * room), ratios.slant / (e * v * room), 1.0 / (v * v * room))
    fitted = at_level(shape, (1.0 - 1e-9) / farthest(shape.rows[0], safe.table))
    assert isinstance(fitted, Quadratic)
    return fitted


def largest_steps(
    axis: Axis, ledger: Ledger, near: Ratios | None = None, worth: Worth = lambda barrier: barrier.area_m2ps
) -> Generator[None, None, tuple[AxisCertificate, Ratios] | None]:
    """The largest certificate of the axis and its ratios, or None; a pause after each piece of the work.

    `near`: the last result, about which alone this one looks; `worth` in place of the area: of a larger ellipse
    of the same ratios it must not be less.
    """
    starts = [Ratios(c, v) for v in _SPEEDS for c in _SLANTS] if near is None else [near]
    best: tuple[AxisCertificate, Ratios] | None = None
    for ratios in sorted(starts, key=lambda each: -worth(ellipse(axis, each))):  # the large ones spare the others
        best = yield from _better(axis, ledger, ratios, best, worth)
    for slant, speed in _STEPS if best is not None else ():
        assert best is not None
        c, v = best[1]
        for ratios in (Ratios(c - slant, v), Ratios(c + slant, v), Ratios(c, v - speed), Ratios(c, v + speed)):
            if 0.0 < ratios.slant <= _SLANT_MOST and ratios.speed >= _SPEED_LEAST:
                best = yield from _better(axis, ledger, ratios, best, worth)
    return best


def _better(
    axis: Axis, ledger: Ledger, ratios: Ratios, best: tuple[AxisCertificate, Ratios] | None, worth: Worth
) -> Generator[None, None, tuple[AxisCertificate, Ratios] | None]:
    """The ellipse of these ratios if it comes out worth more than the best."""
    shape = ellipse(axis, ratios)
    if best is not None and worth(shape) <= worth(best[0].barrier):
        return best
    found = yield from _grown(axis, ledger, shape, best[0].setting if best is not None else None)
    if found is None or (best is not None and worth(found.barrier) <= worth(best[0].barrier)):
        return best
    return found, ratios


def _grown(
    axis: Axis, ledger: Ledger, shape: Barrier, before: Setting | None
) -> Generator[None, None, AxisCertificate | None]:
    """One shape at its largest level, whose own ledger is no larger than the one that it was grown with.

    `before`: a setting that did for a shape like it.
    """
    setting = ledger.setting(shape)
    if before is not None:
        setting = setting._replace(**{part: max(getattr(setting, part), getattr(before, part)) for part in GROWING})
    for _ in range(_ROUNDS):
        design = grow(shape, axis.safe, setting, axis.authority, most=1.0)
        yield
        if design.barrier is None or design.cover is None:
            return None
        own = ledger.setting(design.barrier)
        if all(getattr(own, part) <= getattr(setting, part) for part in GROWING):
            return AxisCertificate(
                axis.axis, design.barrier, setting, axis.response, axis.authority, ledger.margins(design.barrier),
                design.cover.cells,
            )  # fmt: skip
        setting = setting._replace(**{part: 1.02 * max(getattr(own, part), getattr(setting, part)) for part in GROWING})
    return None
