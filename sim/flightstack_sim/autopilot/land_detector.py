"""PX4's land detector for a multirotor: ground contact, then maybe landed, then landed.

Each stage needs the one before it and its own conditions for 0.33 s:
  ground contact  no vertical and no horizontal movement, low thrust (below 60 % of the way from MPC_THR_MIN to
                  MPC_THR_HOVER), and a descent asked for that doesn't happen, where vertical velocity is controlled
  maybe landed    nearly no thrust (10 % of that way) and no rotation
  landed          nothing more
A disarmed vehicle counts as landed.  All stages end at once when their conditions do; once landed, 2.5 times the
vertical movement is put up with.  In body-rate offboard no descent is known of, low thrust alone does.  Free fall is
not detected.  Conditions after PX4's documentation; the 60 % and the 0.33 s (documented: 0.3) are those of a recorded
PX4 landing.
"""

from __future__ import annotations

import math

from flightstack_sim.autopilot.params import Params

STAGE_S = 0.33
LOW_THRUST_SHARE, NO_THRUST_SHARE = 0.6, 0.1
LANDED_FACTOR = 2.5
"""Vertical movement that ends the landed state, over that which prevents it."""
DESCENT_FACTOR = 1.1
"""A descent counts as asked for above this times LNDMC_Z_VEL_MAX."""


class LandDetector:
    """Stages of one vehicle; starts landed."""

    __slots__ = (
        "_contact_s",
        "_landed_s",
        "_low_thrust",
        "_maybe_s",
        "_no_thrust",
        "_rate_max",
        "_xy_max",
        "_z_max",
        "ground_contact",
        "landed",
        "maybe_landed",
    )

    def __init__(self, params: Params) -> None:
        self.ground_contact = self.maybe_landed = self.landed = True
        self._contact_s = self._maybe_s = self._landed_s = STAGE_S
        self.configure(params)

    def configure(self, params: Params) -> None:
        """Take thresholds from the parameters."""
        least, hover = params.get("MPC_THR_MIN"), params.get("MPC_THR_HOVER")
        self._low_thrust = least + LOW_THRUST_SHARE * (hover - least)
        self._no_thrust = least + NO_THRUST_SHARE * (hover - least)
        self._z_max = min(params.get("LNDMC_Z_VEL_MAX"), params.get("MPC_LAND_SPEED") / DESCENT_FACTOR)
        self._xy_max = params.get("LNDMC_XY_VEL_MAX")
        self._rate_max = math.radians(params.get("LNDMC_ROT_MAX"))

    def lifted(self, thrust: float) -> bool:
        """Whether an armed vehicle's thrust alone says that it flies: all stages end, whatever the rest."""
        if not thrust >= self._low_thrust:  # also where it is NaN
            return False
        self.ground_contact = self.maybe_landed = self.landed = False
        self._contact_s = self._maybe_s = self._landed_s = 0.0
        return True

    def update(
        self,
        *,
        armed: bool,
        thrust: float,
        vel_ned_mps: tuple[float, float, float],
        rate_frd_radps: tuple[float, float, float],
        descent_setpoint_mps: float,
        dt_s: float,
    ) -> None:
        """One step; `descent_setpoint_mps` is the vertical velocity asked for, NaN where there is none."""
        if not armed:
            self.ground_contact = self.maybe_landed = self.landed = True
            self._contact_s = self._maybe_s = self._landed_s = STAGE_S
            return
        thrust = thrust if math.isfinite(thrust) else 0.0
        if self.lifted(thrust):
            return
        north, east, down = vel_ned_mps
        z_max = LANDED_FACTOR * self._z_max if self.landed else self._z_max
        still = abs(down) < z_max and north * north + east * east < self._xy_max**2
        stuck = math.isnan(descent_setpoint_mps) or descent_setpoint_mps >= DESCENT_FACTOR * self._z_max
        contact = still and stuck
        self._contact_s = self._contact_s + dt_s if contact else 0.0
        self.ground_contact = contact and self._contact_s >= STAGE_S
        turning = max(map(abs, rate_frd_radps)) > self._rate_max
        maybe = self.ground_contact and thrust < self._no_thrust and not turning
        self._maybe_s = self._maybe_s + dt_s if maybe else 0.0
        self.maybe_landed = maybe and self._maybe_s >= STAGE_S
        self._landed_s = self._landed_s + dt_s if self.maybe_landed else 0.0
        self.landed = self.maybe_landed and self._landed_s >= STAGE_S
