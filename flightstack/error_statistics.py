"""How an autopilot's estimate errs, as statistics: what the state observer and the bounds of the estimate are made of.

Each axis of position, velocity and acceleration carries a first-order Gauss-Markov error (standard deviation, time
constant), position a bias that is constant in a flight, the accelerometer white noise.  The acceleration's error is
that of the attitude: specific force turned into the world by an attitude that is off by (tilt, heading) is off by

    sideways    hypot(g tilt, a heading)        up and down    a tilt

a the horizontal acceleration that the vehicle flies with, and by what the accelerometer's bias leaves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flightstack.types import STANDARD_GRAVITY_MPS2, Tuple3

ACROSS_MPS2 = 3.0
"""Horizontal acceleration that errors of attitude are counted at: beyond what any region is flown with."""


class ErrorStatistics(NamedTuple):
    """Standard deviations along north, east, down, and time constants."""

    sensors: str
    """Name of the sensors' grade."""
    pos_std_m: Tuple3
    pos_time_s: float
    pos_bias_std_m: Tuple3
    vel_std_mps: Tuple3
    vel_time_s: float
    acc_std_mps2: Tuple3
    """Of attitude and accelerometer bias together."""
    acc_time_s: float
    acc_noise_mps2_rthz: Tuple3
    """White noise density of the accelerometer."""
    independent: bool = True
    """Whether position, velocity and acceleration err independently, as the state observer takes them to."""


def acceleration_errors(tilt_rad: float, heading_rad: float, bias_mps2: float) -> Tuple3:
    """Standard deviations (m/s^2) along north, east, down of the attitude's and the accelerometer bias' errors."""
    across = math.hypot(STANDARD_GRAVITY_MPS2 * tilt_rad, ACROSS_MPS2 * heading_rad, bias_mps2)
    return across, across, math.hypot(ACROSS_MPS2 * tilt_rad, bias_mps2)
