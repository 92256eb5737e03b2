"""What a foreign program asks for, as the stack's controller: rates and attitudes as they are, places by PX4's law."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from flightstack.frames import quat_conjugate, quat_multiply
from flightstack.model import Model, thrust_to_norm
from flightstack.rows import YAW, YAW_RATE
from flightstack.seams import Controller
from flightstack.types import F64, Command, FlatOutput, Learned, Measurement, Proposal
from flightstack_sim.autopilot.setpoint import ControlKind, ControlSetpoint
from mavlink_bridge.messages import SetAttitudeTarget
from mavlink_bridge.voice import yaw_of

_ATTITUDE_PS = np.array([6.5, 6.5, 2.8])
"""PX4's MC_ROLL_P, MC_PITCH_P, MC_YAW_P."""
_PROPOSAL = 20
_NO_THRUST, _NO_ATTITUDE = 64, 128
"""SET_ATTITUDE_TARGET.type_mask."""


class Relay:
    """The controller; `wish` is what the program asked for last, None: hold the reference."""

    def __init__(self, inner: Controller, model: Model) -> None:
        self.inner, self.model = inner, model
        self.wish: ControlSetpoint | None = None
        self.gain = 1.0
        """Delivered over believed thrust per mass: places are flown with as much more."""
        self.thrust_model_factor = 0.0
        """The vehicle's THR_MDL_FAC, whose curve PX4 undoes: a setpoint's thrust is before it."""

    def init(self, now_us: int) -> Any:
        """The inner controller's."""
        return self.inner.init(now_us)

    def healthy(self, state: Any) -> bool:
        """The inner controller's."""
        return self.inner.healthy(state)

    def step(
        self, state: Any, measurement: Measurement, reference: FlatOutput, learned: Learned, sent: Command, now_us: int
    ) -> tuple[Any, Proposal]:
        """Thrust and body rates as asked for, or what flies the reference."""
        state, proposal = self.inner.step(state, measurement, reference, learned, sent, now_us)
        wish = self.wish
        if wish is None or wish.kind not in (ControlKind.RATE, ControlKind.ATTITUDE):
            return state, replace(proposal, thrust_n=proposal.thrust_n / self.gain)
        row = np.full(_PROPOSAL, np.nan)
        if wish.kind is ControlKind.RATE:
            row[17:20] = np.nan_to_num(np.array(wish.rate_frd_radps), nan=0.0)
        else:
            row[17:20] = _towards(wish, measurement.q_ned_frd)
        wire = wish.thrust_norm if math.isfinite(wish.thrust_norm) else 0.0
        norm = thrust_to_norm(min(max(wire, 0.0), 1.0), 1.0, self.thrust_model_factor)
        return state, replace(proposal, row=row, thrust_n=self.model.thrust_of(norm))


def _towards(wish: ControlSetpoint, q_ned_frd: F64) -> F64:
    """Body rates towards an attitude, the shorter way round; the yaw rate is fed forward."""
    error = quat_multiply(quat_conjugate(q_ned_frd), np.array(wish.q_ned_frd))
    sign = 1.0 if error[0] >= 0.0 else -1.0
    rate: F64 = 2.0 * sign * error[1:] * _ATTITUDE_PS
    if math.isfinite(wish.yaw_rate_radps):
        rate[2] += wish.yaw_rate_radps
    return rate


def is_whole(message: SetAttitudeTarget) -> bool:
    """Whether all that its mask says is given is a number: what is not is nobody's wish, where PX4 would fly by it."""
    q, rates, mask = message.q_ned_frd, message.rate_frd_radps[:2], message.type_mask
    given = (*(rates if mask & _NO_ATTITUDE else q), 0.0 if mask & _NO_THRUST else message.thrust_norm)
    return all(map(math.isfinite, given))


def reference_of(wish: ControlSetpoint, measurement: Measurement) -> FlatOutput:
    """What is to be followed: along what is not asked for, the vehicle's own state."""
    row = np.zeros(17)
    row[:6], row[YAW] = measurement.row[:6], yaw_of(measurement.q_ned_frd)
    if wish.kind is not ControlKind.POSITION:
        return FlatOutput(row)
    for i in range(3):
        place, speed, push = wish.pos_ned_m[i], wish.vel_ned_mps[i], wish.acc_ned_mps2[i]
        row[i] = place if math.isfinite(place) else row[i]
        row[3 + i] = speed if math.isfinite(speed) else (0.0 if math.isfinite(place) else row[3 + i])
        row[6 + i] = push if math.isfinite(push) else 0.0
    row[YAW] = wish.yaw_rad if math.isfinite(wish.yaw_rad) else row[YAW]
    row[YAW_RATE] = wish.yaw_rate_radps if math.isfinite(wish.yaw_rate_radps) else 0.0
    return FlatOutput(row)


def hold_of(place_ned_m: F64, yaw_rad: float) -> FlatOutput:
    """At rest at a place."""
    row = np.zeros(17)
    row[:3], row[YAW] = place_ned_m, yaw_rad
    return FlatOutput(row)
