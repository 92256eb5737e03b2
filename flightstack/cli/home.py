"""`--home`: where the simulated vehicle stands at first."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flightstack.geodesy import PX4_SIH, LocalFrame
from flightstack.types import InputError

_HIGHEST_M, _LOWEST_M = 9_000.0, -500.0
_NEAREST_POLE_DEG = 89.0


@dataclass(frozen=True, slots=True)
class Home:
    """Where the vehicle stands at first and which way it looks."""

    frame: LocalFrame = PX4_SIH
    heading_deg: float = 0.0

    @property
    def heading_rad(self) -> float:
        """For the plant."""
        return math.radians(self.heading_deg)


HOME = Home()
"""PX4's internal simulator's place, looking north."""


def parse_home(text: str | None) -> Home:
    """LAT,LON,ALT,HEADING in degrees and metres above the sea; None: HOME."""
    if text is None:
        return HOME
    try:
        latitude, longitude, altitude, heading = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"--home {text}: write LAT,LON,ALT,HEADING, as 47.3977,8.5456,488,0") from None
    for name, value, low, high in (
        ("latitude", latitude, -_NEAREST_POLE_DEG, _NEAREST_POLE_DEG),
        ("longitude", longitude, -180.0, 180.0),
        ("altitude", altitude, _LOWEST_M, _HIGHEST_M),
        ("heading", heading, -360.0, 360.0),
    ):
        if not low <= value <= high:
            raise InputError(f"--home {text}: the {name} must lie in {low:g}..{high:g}")
    return Home(LocalFrame(latitude, longitude, altitude), heading)
