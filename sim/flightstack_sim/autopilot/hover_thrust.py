"""PX4's hover thrust estimate: the collective thrust that carries the vehicle, whatever it weighs.

    sample = vertical thrust setpoint / (1 + upward acceleration / g)

goes through a first-order low-pass while the vehicle is in the air, in every armed mode; on the ground the estimate is
MPC_THR_HOVER.  PX4 has a Kalman filter here; a low-pass of about its settling time stands for it.  In the air means:
not landed, and once IN_AIR_M above where it stood (thrust that the ground still shares in says nothing).
"""

from __future__ import annotations

import math

from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack_sim.autopilot.params import Params

TIME_CONSTANT_S = 2.0
IN_AIR_M = 0.5
LEAST, MOST = 0.1, 0.9
_LEAST_LOAD_FACTOR = 0.3
"""Below this 1 + a/g (nearly falling) a sample says more about noise than about weight."""


class HoverThrust:
    """The estimate of one vehicle: `value`, 0.1 to 0.9."""

    __slots__ = ("_in_air", "_initial", "_stood_down_m", "_weight", "value")

    def __init__(self, params: Params, dt_s: float) -> None:
        self._weight = dt_s / (dt_s + TIME_CONSTANT_S)
        self._in_air = False
        self._stood_down_m = 0.0
        self.configure(params)
        self.value = self._initial

    def configure(self, params: Params) -> None:
        """Where the next flight's estimate starts."""
        self._initial = min(max(params.get("MPC_THR_HOVER"), LEAST), MOST)

    def update(self, thrust: float, state: F64, *, landed: bool) -> None:
        """One step: collective thrust setpoint and the estimate's state (13,)."""
        if landed:
            self._in_air = False
            self._stood_down_m = float(state[2])
            self.value = self._initial
            return
        _, _, down_m, _, _, _, _, x, y, _, _, _, acc_down = state.tolist()
        self._in_air = self._in_air or down_m < self._stood_down_m - IN_AIR_M
        load_factor = 1.0 - acc_down / STANDARD_GRAVITY_MPS2
        if self._in_air and load_factor > _LEAST_LOAD_FACTOR and math.isfinite(thrust):
            sample = thrust * (1.0 - 2.0 * (x * x + y * y)) / load_factor
            self.value += self._weight * (min(max(sample, LEAST), MOST) - self.value)
