"""Slower poles where the estimate is so noisy that its noise alone would use up what the governor lets through.

The nominal's jerk is 3 p^2 times the error of velocity, so that the estimate's noise makes rate commands of
3 p^2 sigma_v / g, and PX4's rate loop makes torque of them by its proportional gain.  Where that comes near the
governor's r_max, the governor holds back what steers along with the noise, and the loop swings.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flightstack.barrier.estimate_bounds import K_SIGMA
from flightstack.barrier.torque import GovernorTerms
from flightstack.control.feedback import FlatnessController
from flightstack.seams import Controller
from flightstack.types import STANDARD_GRAVITY_MPS2

_NOISE_SHARE = 1.0 / 3.0
"""Of r_max, for one standard deviation of the noise: three of them just fit."""
_LEAST_POLE_RADPS = 1.5


def quieted(controller: Controller, governor: GovernorTerms, eps_v_mps: float) -> Controller:
    """The controller for flights that are governed throughout; the same one where the noise leaves room.

    eps_v_mps: bound of the error of horizontal velocity, K_SIGMA standard deviations.
    """
    if not isinstance(controller, FlatnessController):
        return controller
    pid = governor.autopilot
    gain = max(pid["mc_rollrate_p"] * pid["mc_rollrate_k"], pid["mc_pitchrate_p"] * pid["mc_pitchrate_k"])
    sigma_mps = eps_v_mps / K_SIGMA
    allowed = _NOISE_SHARE * governor.roll_pitch_max * STANDARD_GRAVITY_MPS2 / max(3.0 * gain * sigma_mps, 1e-9)
    most = max(float(np.sqrt(allowed)), _LEAST_POLE_RADPS)
    nominal = controller.gains.nominal
    north, east, down = nominal.pole_radps
    if max(north, east) <= most:
        return controller
    slower = replace(nominal, pole_radps=(min(north, most), min(east, most), down))
    return FlatnessController(controller.model, replace(controller.gains, nominal=slower), controller.limits)
