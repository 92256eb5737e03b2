"""PX4's failure detector, its attitude part: tilted too far for too long.

FD_FAIL_R and FD_FAIL_P (degrees, 0: off) for FD_FAIL_R_TTRI and FD_FAIL_P_TTRI seconds.  What follows is the failsafe's
business: flight termination, unless CBRK_FLIGHTTERM holds it back (as it does by default), then a warning.
Source: PX4 user guide, "Safety", failure detector.
"""

from __future__ import annotations

import math
from typing import Final

from flightstack.types import Tuple4
from flightstack_sim.autopilot.params import Params

_AXES: Final = ("R", "P")


class FailureDetector:
    """One vehicle's; `failed` once it has happened, until it is disarmed."""

    __slots__ = ("_over_us", "_params", "failed")

    def __init__(self, params: Params) -> None:
        self._params = params
        self._over_us = [-1, -1]
        self.failed = False

    def look(self, q_ned_frd: Tuple4, now_us: int, *, armed: bool) -> None:
        """Once a tick or less."""
        if not armed:
            self.failed = False
            self._over_us = [-1, -1]
            return
        w, x, y, z = q_ned_frd
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
        for index, angle in enumerate((roll, pitch)):
            limit = math.radians(self._params.get(f"FD_FAIL_{_AXES[index]}"))
            if limit <= 0.0 or abs(angle) <= limit:
                self._over_us[index] = -1
            elif self._over_us[index] < 0:
                self._over_us[index] = now_us
            elif now_us - self._over_us[index] >= 1e6 * self._params.get(f"FD_FAIL_{_AXES[index]}_TTRI"):
                self.failed = True
