"""Slower poles for flights that are governed throughout, so that noise and steps leave the governor room.

Noise: the nominal's jerk is 3 p^2 times the error of velocity, so that the estimate's noise makes rate commands of
3 p^2 sigma_v / g, and PX4's rate loop makes torque of them by its proportional gain.  Where that comes near the
governor's r_max, the governor holds back what steers along with the noise, and the loop swings.

Steps: with torque of r_max the vehicle's jerk changes by at most S = r_max alpha g.  The loop swings on after a step
where the poles are faster than `stopping.steady_pole_ps` (`tests/attack/test_fence.py`: a step of 2 m with quad-x,
which 4.96 rad/s end in a swing of metres, settles with 4.0).
"""

from __future__ import annotations

import math
from dataclasses import replace

from flightstack.barrier.estimate_bounds import K_SIGMA
from flightstack.control.feedback import FlatnessController
from flightstack.seams import Controller
from flightstack.site.stopping import StoppingCertificate, steady_pole_ps
from flightstack.types import STANDARD_GRAVITY_MPS2

_NOISE_SHARE = 1.0 / 3.0
"""Of r_max, for one standard deviation of the noise: three of them just fit."""
_APART_RADPS, _LEAST_POLE_RADPS = 1.5, 0.8
"""Where both bounds lie below the first, noise and steps want the same room at the same time and share it: room is as
the pole's square, so p^-2 is the sum of theirs.  A pole of 1.5 rad/s, forced on 1.42 and 1.43, swung by metres round a
figure of eight of 14 s a lap, which 1.0 rad/s follow (SIH of 0.7 kg; docs/px4.md)."""


def quieted(controller: Controller, made: StoppingCertificate) -> Controller:
    """The controller for a flight under a certificate; the same one where its poles are slow enough."""
    if not isinstance(controller, FlatnessController):
        return controller
    governor, pid = made.governor, made.governor.autopilot
    gain = max(pid["mc_rollrate_p"] * pid["mc_rollrate_k"], pid["mc_pitchrate_p"] * pid["mc_pitchrate_k"])
    sigma_mps = made.doubts[0].eps_v_mps / K_SIGMA
    noise = _NOISE_SHARE * governor.roll_pitch_max * STANDARD_GRAVITY_MPS2 / max(3.0 * gain * sigma_mps, 1e-9)
    steady_ps = steady_pole_ps(made.snap_mps4, controller.model.motor_lag_s)
    most = min(math.sqrt(noise), steady_ps)
    if most < _APART_RADPS:
        most = max(1.0 / math.hypot(1.0 / math.sqrt(noise), 1.0 / steady_ps), _LEAST_POLE_RADPS)
    nominal = controller.gains.nominal
    north, east, down = nominal.pole_radps
    if max(north, east) <= most:
        return controller
    slower = replace(nominal, pole_radps=(min(north, most), min(east, most), down))
    return FlatnessController(controller.model, replace(controller.gains, nominal=slower), controller.limits)
