"""Has the estimate lost its satellites, and does it get worse for it?  Sans-IO.

Without satellites PX4 goes by its IMU and calls its position good for EKF2_NOAID_TOUT, 5 s, while height and velocity
run away and position, velocity and IMU agree with one another.  Two of its own words tell: GPS_RAW_INT that there is no
fix any more, and ESTIMATOR_STATUS by how much its position is worse.  Each alone means nothing: indoors GPS comes and
goes beside motion capture, and an accuracy changes with every manoeuvre.

Measured on a real PX4 with SIH (15 ms each way, 3 flights): no fix is told within 0.13 s; the stated accuracy across,
0.29 to 0.30 m with satellites, is 0.45 m after 1.0 s and 0.9 m after 3 s.  True height and estimate part by 0.15 to
0.6 m/s, and from 1.8 m one of five flights met the ground after 2.9 s.

Silence is another matter: PX4 says so once a second where its receiver has gone, so a stream that says nothing for
longer was stopped by another station on the link, and is asked for again before it counts.
"""

from __future__ import annotations

import math

from mavlink_bridge import messages as m

_FIX_3D = 3
_WORSE = 1.5
"""Of the stated accuracy across, against the one at the last fix: more than it varies with satellites (1.03)."""
_NO_FIX_US = 500_000
"""Eight fixes a second, or five: three of them in a row are no lost datagram."""
_SILENT_US = 1_200_000
"""PX4 without a receiver speaks once a second."""
_UNSTATED_US = 2_000_000
"""Where the estimator states no accuracy, or nothing was heard of the satellites, though asked for again."""


class AidWatch:
    """Takes GPS_RAW_INT and ESTIMATOR_STATUS with their local times of receipt."""

    __slots__ = ("_accuracy_m", "_fix_us", "_heard_us", "_reference_m")

    def __init__(self) -> None:
        self._fix_us = self._heard_us = -1
        """When the last fix came, and the last word at all; -1: there was none, so none is missed."""
        self._accuracy_m = self._reference_m = math.nan
        """Stated now, and with the last fix."""

    def gps(self, fix_type: int, now_us: int) -> None:
        """A GPS_RAW_INT."""
        self._heard_us = now_us
        if fix_type >= _FIX_3D:
            self._fix_us, self._reference_m = now_us, self._accuracy_m

    def estimator(self, status: m.EstimatorStatus) -> None:
        """An ESTIMATOR_STATUS."""
        self._accuracy_m = status.pos_horiz_accuracy_m

    def is_silent(self, now_us: int) -> bool:
        """There were fixes, and now no word for longer than a PX4 keeps silent by itself."""
        return self._fix_us >= 0 and now_us - self._heard_us > _SILENT_US

    def is_lost(self, now_us: int) -> bool:
        """No satellites for a while, and the position is the worse for it."""
        if self._fix_us < 0 or (without_us := now_us - self._fix_us) <= _NO_FIX_US:
            return False
        worse = self._accuracy_m / self._reference_m if self._reference_m > 0.0 else math.nan
        if math.isnan(worse) or self._heard_us == self._fix_us:
            return not worse < _WORSE and without_us > _UNSTATED_US
        return worse >= _WORSE
