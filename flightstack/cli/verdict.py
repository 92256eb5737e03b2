"""What a flight is judged by: whether it was flown, and whether it was protected.

Flown: the vehicle rose to half of the height of its first climb, followed what was asked within a stated distance (rms)
and touched down softly.  An autopilot that lands and disarms is no proof of any of these: a vehicle that never left the
ground "lands" too.

Protected: the filter kept to a certificate; from when to when, and whether the region was left meanwhile.  A figure
that is not known (there is no truth on a real vehicle) never counts as a good one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from flightstack.mission import LEAST_RISE, never_flew
from flightstack.types import F64

MOST_RMS_M = 0.5
MOST_RMS_ROUGH_M = 1.0
"""With GPS, and on a real vehicle, whose own estimate is all that is known."""
MOST_TOUCHDOWN_MPS = 1.5
_NEAR_GROUND_M = 0.5
"""The estimate's greatest speed downwards so near to where it comes to rest is that of the touchdown.

Above, a descent may be faster, and an estimate at rest wanders.
"""

HELD, LEFT, NONE, OFF = "held", "left", "none", "off"
"""Verdicts on the protection: kept to, left, asked for but never there, not asked for."""

Spans = Sequence[tuple[float, float]]


@dataclass(slots=True)
class Ascent:
    """How high the vehicle rose, and how fast it came down; fed tick by tick from the start of the take-off."""

    rose_m: float | None = None
    """Greatest height above the start before the command to land."""
    _impact_mps: float | None = None
    _on_ground: bool = True
    _vel_ned_mps: Sequence[float] | F64 = (0.0, 0.0, 0.0)
    _descent: list[tuple[float, float]] = field(default_factory=list)

    def height(self, height_m: float) -> None:
        """One tick before the command to land: height above the start."""
        self.rose_m = height_m if self.rose_m is None else max(self.rose_m, height_m)

    def true_contact(self, vel_ned_mps: Sequence[float] | F64, on_ground: bool) -> None:
        """One tick of the truth: velocity (3,) and whether the ground is touched; the hardest touch counts."""
        if on_ground and not self._on_ground:
            self._impact_mps = max(self._impact_mps or 0.0, math.hypot(*self._vel_ned_mps))
        self._on_ground, self._vel_ned_mps = on_ground, vel_ned_mps

    def estimated_descent(self, pos_down_m: float, down_mps: float) -> None:
        """One sample of the estimate after the command to land: where it is and how fast, downwards."""
        self._descent.append((pos_down_m, down_mps))

    @property
    def touchdown_mps(self) -> float | None:
        """Speed at which the ground was touched; None where that is not known."""
        if self._impact_mps is not None or not self._descent:
            return self._impact_mps
        rest_m = self._descent[-1][0]
        return max((down for at_m, down in self._descent if rest_m - at_m <= _NEAR_GROUND_M), default=0.0)


_MUCH_STOPPED = 0.05
"""Of a flight's ticks: more is why it was not where it was asked to be."""


@dataclass(frozen=True, slots=True)
class Flown:
    """The figures that say whether a flight was flown."""

    first_height_m: float
    """Of the first climb, above the start."""
    rose_m: float | None
    touchdown_mps: float | None
    most_rms_m: float

    def shortcoming(self, rmse_m: float | None, stopped_share: float = 0.0) -> str:
        """Why a flight that came to its end was not flown, one line; empty where it was.

        `stopped_share`: of the ticks in which a site's filter followed its way out.
        """
        wanted_m = LEAST_RISE * self.first_height_m
        if self.rose_m is None or not self.rose_m >= wanted_m:
            return never_flew(self.rose_m, self.first_height_m)
        if rmse_m is None:
            return "nothing of what was asked was flown: no tick of the track was scored"
        if not rmse_m <= self.most_rms_m:
            said = f"did not fly what was asked: {rmse_m:.2f} m rms from it, at most {self.most_rms_m:g} m counts"
            if stopped_share < _MUCH_STOPPED:
                return said
            share = f"{stopped_share:.0%}"
            return (
                f"{said}; the site's filter stopped it in {share} of the ticks: fly slower, or farther from its edges"
            )
        if self.touchdown_mps is None:
            return "its touchdown was not seen"
        if not self.touchdown_mps <= MOST_TOUCHDOWN_MPS:
            return f"hit the ground at {self.touchdown_mps:.1f} m/s, at most {MOST_TOUCHDOWN_MPS:g} m/s counts"
        return ""


def most_rms_m(of: str, sensors: str) -> float:
    """How far off (rms) a flight may be, by whom it is judged (truth, estimate) and its grade of sensors."""
    return MOST_RMS_M if of == "truth" and sensors == "mocap" else MOST_RMS_ROUGH_M


def protection_of(asked: bool, spans: Spans, region: dict[str, Any], exits: int | None = None) -> str:
    """The verdict on a flight's protection from its spans and `RegionScore.summary`.

    Where there is no truth the estimate decides, and where neither is known nothing was held.  `exits`: ticks outside
    the site, where there is one: then it decides.
    """
    if not asked:
        return OFF
    if not spans:
        return NONE
    if exits is not None:
        return LEFT if exits else HELD
    least = region["min_h_estimate"] if region["violations"] is None else region["min_h_truth"]
    if least is None:
        return NONE
    return LEFT if region["violations"] or least < 0.0 else HELD


def spans_words(spans: Spans) -> str:
    """ "protected from t1 to t2" in seconds since take-off; "not protected" where there is no span."""
    if not spans:
        return "not protected"
    total_s = sum(to_s - from_s for from_s, to_s in spans)
    if len(spans) == 1:
        return f"protected from {spans[0][0]:.1f} s to {spans[0][1]:.1f} s"
    return f"protected from {spans[0][0]:.1f} s to {spans[-1][1]:.1f} s, {total_s:.1f} s in {len(spans)} parts"
