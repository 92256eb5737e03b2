"""When a vehicle that began at rest on the ground has left it: before that it is to turn gently only.

Held by the ground a vehicle can't turn as it is told, so that an autopilot's rate loop winds up: one rotor ends at its
limit and takes the collective with it (PX4 lowers that for the sake of torque), and the vehicle tips over, or stands
until it comes free at full thrust.  PX4's own take-off avoids corrections until it flies, too.  None at all would let
wind carry a vehicle off that is nearly as light as it pushes.  So each rate is at most 0.5 rad/s (of which PX4's
default gains make an eighth of the range of torque in half a second) until

    the upward acceleration felt, less its slow mean, adds up to 0.15 m/s, forgotten within half a second, or
    the estimate moves at 0.5 m/s

At rest on the ground an accelerometer feels gravity whatever the thrust; its bias is in the slow mean.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.types import STANDARD_GRAVITY_MPS2, Command, Measurement

_FELT_MPS = 0.15
"""White noise of 1 m/s^2 in each sample at 250 Hz adds up to 0.03."""
_MOVING_MPS = 0.5
"""Six deviations of what the GPS grade states."""
_FORGOTTEN_S = 0.5
GENTLE_RADPS = 0.5
_SLOW_S = 2.0
_DT_MAX_S = 0.05


class LiftOff(NamedTuple):
    """Whether the vehicle still stands where it began, and what it felt of late."""

    stands: bool = False
    felt_mps: float = 0.0
    """Upwards."""
    level_mps2: float = STANDARD_GRAVITY_MPS2
    """Slow mean of the specific force, upwards."""

    def step(self, seen: Measurement, dt_s: float) -> LiftOff:
        """One tick on; once it flies it stays so."""
        if not self.stands:
            return self
        dt_s = min(max(dt_s, 0.0), _DT_MAX_S)
        up_mps2 = -float(seen.specific_force_frd_mps2[2])
        felt = self.felt_mps + dt_s * (up_mps2 - self.level_mps2 - self.felt_mps / _FORGOTTEN_S)
        if felt > _FELT_MPS or math.hypot(*seen.vel_ned_mps) > _MOVING_MPS:
            return LiftOff()
        return LiftOff(True, felt, self.level_mps2 + dt_s / _SLOW_S * (up_mps2 - self.level_mps2))

    def of(self, command: Command) -> Command:
        """The command with gentle rates while the vehicle stands."""
        rate = command.rate_frd_radps
        if not self.stands or float(np.abs(rate).max()) <= GENTLE_RADPS:
            return command
        return command._replace(rate_frd_radps=np.clip(rate, -GENTLE_RADPS, GENTLE_RADPS))
