"""The paper's controller: u = u_FF + u_FB on top of the pole-placement nominal (Sections IV.A and V.A).

How the pieces combine.  The nominal answers tracking errors with a jerk and integrates it to an acceleration a_d
(`flightstack.trajectory.nominal_step`).  Flatness turns (a_d, jerk_d, snap_ref, yaw) into u_FF = (f_FF, omega_FF) and
an attitude.  The feedback then is, with r_d, v_d the *reference* position and velocity:

    f_FB     = Kp <z_b, r_d - r> + Kd <z_b, v_d - v>                     (f = -T, so it is subtracted from T)
    omega_FB = Ka e_R + Kr (omega_d - omega) + Kbar (y_d - y, x - x_d, 0)

e_R is twice the vector part of the quaternion from the present to the desired attitude, in body axes: for small
angles it is the paper's (phi_d - phi, theta_d - theta, psi_d - psi), without its singularity.  The Kbar term, right
only at yaw 0 in the paper, is turned by the vehicle's heading.  omega_FF is turned from the desired into the present
body axes.  So along body z the errors act at once (rotors are the only lag), sideways through the attitude.

Known lags are led: thrust by the rotors' time constant times its rate of change, body rates by the rate loop's delay
times the angular acceleration that the reference's snap asks for.

With no learner a constant unexplained acceleration d leaves a constant error: d / (p^2/3 + Kp) along body z and about
d / (p^2/3) sideways.  That is the paper's large error with the wrong model; learning removes it, gains need not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from flightstack.control.attitude import PROPOSAL, AttitudeGains, follow, reachable, together, vehicle_rows
from flightstack.frames import Rows3, rotation
from flightstack.jit import Entry, njit
from flightstack.model import Limits, Model
from flightstack.rows import L_CONFIDENCE, L_GAIN
from flightstack.trajectory import NominalGains, nominal_step
from flightstack.types import F64, Command, FlatOutput, Learned, Measurement, Proposal, made

_ALONG, _CONFIDENT = 2, 8
"""Of `controller_rows`."""
_RATE_FB = 5
"""Of a Proposal's row."""


@dataclass(frozen=True, slots=True)
class FeedbackGains:
    """Gains of u_FB; forces per believed kilogram, so that they suit every mass."""

    nominal: NominalGains = field(default_factory=NominalGains)
    thrust_p_ps2: float = 5.0
    """Kp / m: adds to the nominal's p^2/3 along body z, where only the rotors' lag (20-50 ms) limits it."""
    thrust_d_ps: float = 2.0
    """Kd / m: critical damping for Kp alone would be 4.5; the nominal damps too."""
    attitude_p_ps: float = 6.5
    """Ka of roll and pitch: 1 / (4 Ka) = 38 ms; with PX4's rate lag of 45-80 ms the attitude closes at zeta 0.9-0.7."""
    yaw_p_ps: float = 2.0
    """Ka of yaw, whose rate loop is four times slower (reaction torque only)."""
    rate_p: float = 0.15
    """Kr: adds to PX4's own rate feedback, hence small; more would only pass gyro noise on."""
    position_rate_radpms: float = 0.1
    """Kbar, rad/s per metre: against Ka a stiffness of g Kbar / Ka = 0.15 1/s^2; small, because it has no damping."""
    confident_share: float = 1.0
    """Gain schedule: the share of poles and Kd, and its square of Kp, left at full confidence in what is learned.
    1 keeps the gains fixed; what less costs: docs/decisions/0006."""


class ControlState(NamedTuple):
    """What the controller remembers: the nominal's correction (3,) NED m/s^2 and the time of the last step."""

    correction_ned_mps2: F64
    t_us: int


_DT_MAX_S = 0.05
"""A longer gap between two ticks counts as this long."""


class FlatnessController:
    """The controller above for one model; final, holds only constants."""

    __slots__ = ("_constants", "gains", "limits", "model")

    def __init__(self, model: Model, gains: FeedbackGains | None = None, limits: Limits | None = None) -> None:
        self.model = model
        self.gains = gains or FeedbackGains()
        self.limits = limits or Limits()
        self._constants = controller_rows(self.model, self.gains, self.limits)

    def init(self, now_us: int) -> ControlState:
        """Nothing corrected yet."""
        return ControlState(np.zeros(3), now_us)

    def healthy(self, state: ControlState) -> bool:
        """Whether the correction is finite."""
        return bool(np.isfinite(state.correction_ned_mps2).all())

    def step(
        self,
        state: ControlState,
        measurement: Measurement,
        reference: FlatOutput,
        learned: Learned,
        sent: Command,
        now_us: int,
    ) -> tuple[ControlState, Proposal]:
        """One step; what is learned is fed forward, and every thrust is scaled by the learned thrust gain."""
        row = np.empty(PROPOSAL)
        correction = state.correction_ned_mps2.copy()
        dt = min(max((now_us - state.t_us) * 1e-6, 0.0), _DT_MAX_S)
        thrust = _STEP.call(self._constants, correction, dt, reference.row, measurement.row, learned.row, row)
        return made(ControlState, (correction, now_us)), Proposal(thrust, row)


def controller_rows(model: Model, gains: FeedbackGains, limits: Limits) -> F64:
    """(9, 3) everything that does not change in flight, for one compiled call."""
    attitude = AttitudeGains(gains.attitude_p_ps, gains.yaw_p_ps, gains.rate_p)
    return np.array(
        [
            gains.nominal.pole_radps,
            gains.nominal.correction_max_mps2,
            (gains.thrust_p_ps2, gains.thrust_d_ps, gains.position_rate_radpms),
            *vehicle_rows(model, limits, attitude),
            (gains.confident_share, 0.0, 0.0),
        ]
    )


@njit
def control_step(
    constants: F64, correction: F64, dt: float, reference: F64, measured: F64, learned: F64, out: F64
) -> float:
    """Nominal, feed-forward and feedback: total thrust, the parts in `out`.

    `reference` (17,), `measured` (20,), `learned` (33,), `out` (20,): rows of FlatOutput, Measurement, Learned,
    Proposal.
    """
    pos_d, vel_d, acc_d, jerk_d = reference[0:3], reference[3:6], reference[6:9], reference[9:12]
    pos, vel, q, rate = measured[0:3], measured[3:6], measured[6:10], measured[10:13]
    acc, jerk, vehicle, gain = out[11:14], out[14:17], constants[3:8], learned[L_GAIN]
    scale = 1.0 - (1.0 - constants[_CONFIDENT, 0]) * learned[L_CONFIDENCE]
    wanted = pos_d, vel_d, acc_d, jerk_d
    nominal_step(correction, scale * constants[0], constants[1], wanted, (pos, vel), dt, acc, jerk)
    r = rotation(q)
    reached = reachable(acc, learned[0:3], vel_d, gain, vehicle)
    follow(vehicle, reached, jerk, reference, learned, gain, (r, rate), out)
    along_p = along_d = 0.0
    for i in range(3):
        along_p += r[i][2] * (pos_d[i] - pos[i])
        along_d += r[i][2] * (vel_d[i] - vel[i])
    force = scale * scale * constants[_ALONG, 0] * along_p + scale * constants[_ALONG, 1] * along_d
    out[1] = -vehicle[2, 0] * force / gain
    c, s = _heading(r)
    north, east = pos_d[0] - pos[0], pos_d[1] - pos[1]
    kbar = constants[_ALONG, 2]
    out[_RATE_FB] += kbar * (c * east - s * north)
    out[_RATE_FB + 1] -= kbar * (c * north + s * east)
    return together(out)


@njit
def _heading(r: Rows3) -> tuple[float, float]:
    """Cosine and sine of the body x axis' heading; north where it points straight up or down."""
    size = math.sqrt(r[0][0] * r[0][0] + r[1][0] * r[1][0])
    if size < 1e-6:
        return 1.0, 0.0
    return r[0][0] / size, r[1][0] / size


_STEP = Entry(control_step, "f8[:, ::1], f8[::1], f8, f8[::1], f8[::1], f8[::1], f8[::1]")
