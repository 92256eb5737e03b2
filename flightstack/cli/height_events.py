"""The estimated height held against the barometer's: told where they part, and nothing else follows.

Measured on a real PX4 with SIH: its height errs by up to 1.6 m while position and velocity agree, and the barometer
shows it (correlation with the true error -0.97 in one flight).  On a vehicle the barometer errs as well, by its own
propellers, wind and weather: so this ends no flight.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from mavlink_bridge import messages as m
from mavlink_bridge.frequent import AT, DOWN, IMU, POSITION, Heard

APART_M, TOGETHER_M = 1.0, 0.5
"""Told from the first on; told again only after the second."""
_SMOOTHED_US = 1_000_000
_PRESSURE_ALT = 0x0800
"""Of HIGHRES_IMU.fields_updated."""
_ALTITUDE, _FIELDS = AT[IMU] + 12, AT[IMU] + 14
"""Places in what is heard."""


class HeightEvents:
    """Tells that estimated and barometric height have parted since the flight began."""

    def __init__(self, tell: Callable[[int, str, str, str], None]) -> None:
        self._tell = tell
        self._up_m = self._gap_m = self._zero_m = math.nan
        self._t_us = 0
        self._begun = self._apart = False

    def begin(self) -> None:
        """The flight begins: what the two differ by now is their datum."""
        self._begun, self._zero_m = True, self._gap_m

    def on_message(self, t_us: int, message: object) -> None:
        """A message of the vehicle."""
        if isinstance(message, m.LocalPositionNed):
            self._up_m = -message.pos_ned_m[2]
        elif isinstance(message, m.HighresImu) and message.fields_updated & _PRESSURE_ALT:
            self._barometer(t_us, message.t_us, message.pressure_alt_m)

    def on_heard(self, t_us: int, heard: Heard) -> None:
        """Several messages of the vehicle at once."""
        item = heard.row.item
        for number in heard.numbers:
            if number == POSITION:
                self._up_m = -item(DOWN)
            elif number == IMU and int(item(_FIELDS)) & _PRESSURE_ALT:
                self._barometer(t_us, int(item(AT[IMU])), item(_ALTITUDE))

    def _barometer(self, t_us: int, stamp_us: int, altitude_m: float) -> None:
        gap_m = self._up_m - altitude_m
        if not math.isfinite(gap_m):
            return
        share = min(1.0, (stamp_us - self._t_us) / _SMOOTHED_US) if math.isfinite(self._gap_m) else 1.0
        self._t_us = stamp_us
        self._gap_m = gap_m if share == 1.0 else self._gap_m + share * (gap_m - self._gap_m)
        self._judge(t_us)

    def _judge(self, t_us: int) -> None:
        apart_m = self._gap_m - self._zero_m
        if not self._begun or abs(apart_m) < (TOGETHER_M if self._apart else APART_M) or math.isnan(apart_m):
            self._apart = False
        elif not self._apart:
            self._apart = True
            side = "above" if apart_m > 0.0 else "below"
            words = f"estimate: the estimated height is {abs(apart_m):.1f} m {side} the barometer's since take-off"
            self._tell(t_us, "estimate", f"{words}: one of the two is wrong", "warning")
