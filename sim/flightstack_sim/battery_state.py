"""What the autopilot says of the battery.

A vehicle file with a [battery] gives the voltage; the charge is read off it as PX4's voltage-based estimate does.
Without one it is PX4's simulated battery: 4.05 V a cell when full, falling linearly while armed to SIM_BAT_MIN_PCT
in SIM_BAT_DRAIN seconds, where it stays.
"""

from __future__ import annotations

from typing import Final

from flightstack_sim.autopilot.params import Params

CELL_FULL_V: Final = 4.05
CELL_EMPTY_V: Final = 3.6
CURRENT_A: Final = -1.0
"""PX4's simulator doesn't know the current."""


class BatteryState:
    """Voltage and remaining charge (0..1), renewed by `update`."""

    __slots__ = ("_armed_s", "_params", "_t_us", "forced", "remaining", "voltage_v")

    def __init__(self, params: Params) -> None:
        self._params = params
        self._armed_s = 0.0
        self._t_us = 0
        self.remaining = 1.0
        self.forced: float | None = None
        """Charge that a fault pretends."""
        self.voltage_v = params.get("BAT1_N_CELLS") * CELL_FULL_V

    def update(self, t_us: int, *, armed: bool, plant_v: float) -> None:
        """Advance to `t_us`; `plant_v` is the plant's terminal voltage, 0 where it has no battery."""
        step_s, self._t_us = (t_us - self._t_us) * 1e-6, t_us
        cells = max(1.0, self._params.get("BAT1_N_CELLS"))
        if self.forced is not None:
            self.remaining = self.forced
            self.voltage_v = cells * (CELL_EMPTY_V + (CELL_FULL_V - CELL_EMPTY_V) * self.forced)
            return
        if plant_v > 0.0:
            self.voltage_v = plant_v
            share = (plant_v / cells - CELL_EMPTY_V) / (CELL_FULL_V - CELL_EMPTY_V)
            self.remaining = min(max(share, 0.0), 1.0)
            return
        if armed:
            self._armed_s += step_s
        least = self._params.get("SIM_BAT_MIN_PCT") / 100.0
        drained = (1.0 - least) * self._armed_s / self._params.get("SIM_BAT_DRAIN")
        self.remaining = max(least, 1.0 - drained)
        self.voltage_v = cells * (CELL_EMPTY_V + (CELL_FULL_V - CELL_EMPTY_V) * self.remaining)
