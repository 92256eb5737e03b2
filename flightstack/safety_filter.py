"""The safety filter: the command nearest to the wanted one that keeps the vehicle in its certified region.

Every tick: carry the state to the moment when this command begins to act (`barrier.response`), ask for each certified
axis which accelerations meet the barrier condition (`barrier.condition`: an interval), and take the acceleration
nearest to the wanted one in these intervals and in what tilt, body rates and thrust allow (`barrier.qp`).  Rows are
never softened.  Where there is no such acceleration, the certified fallback brakes: each axis' best command, in closed
form, without a solver.

A wanted command that is safe passes bit for bit.  So does its yaw rate, if it asks for little torque: yaw is turned by
rotors that run unevenly, and these lift more than even ones of the same mean command (thrust is the square of it).
The filter engages once h, of the predicted and of the measured state, has been at least 0.05 for half a second.
"""

from __future__ import annotations

import math
from operator import le
from typing import NamedTuple

import numpy as np

from flightstack.barrier.assess import (
    CHANGED,
    DOUBTFUL,
    ENGAGED,
    FALSIFIED,
    INFEASIBLE,
    PASSED,
    ROWS,
    UNCERTIFIED,
    UNSOLVED,
    WAITING,
    WORK,
    assess,
    fallback,
    settle,
    steer,
)  # fmt: skip
from flightstack.barrier.certifier_config import STEER_PS
from flightstack.barrier.condition import doubt_of
from flightstack.barrier.falsify import HAND_OVER
from flightstack.barrier.packed import pack
from flightstack.barrier.qp import NearestPoint
from flightstack.barrier.records import AxisCertificate, Certificate
from flightstack.barrier.response import M_GOOD_SINCE, M_MODE, new_memory, remember
from flightstack.barrier.shapes import piece_at
from flightstack.barrier.torque import within
from flightstack.governor import GovernorLimits
from flightstack.jit import Entry
from flightstack.model import Limiter, Limits, Model
from flightstack.rows import ATTITUDE, F_INTERVENED, F_ITERATIONS, F_RESIDUAL, F_STATUS, F_THRUST, F_VERSION, F_WANTED
from flightstack.types import F64, Command, Filtered, FlatOutput, Learned, Measurement

__all__ = ["CHANGED", "INFEASIBLE", "PASSED", "UNCERTIFIED", "UNSOLVED", "WAITING", "BarrierFilter", "FilterState"]

_SAME_MPS2 = 1e-6
"""A change below this is none."""
_YAW_RATE = 12
"""Its place in a Measurement's row."""
_NOWHERE = np.full(3, -np.inf)
_PLACES = 101
_YAW_FASTER_RADPS, _YAW_SLOWER_RADPS = 0.2, 0.4
"""How far an engaged filter lets the commanded yaw rate be from the present one, to turn faster and to turn slower.
PX4's default yaw gain makes 0.2 times that the unevenness of the commands: 0.04 beside 0.5 in hover lifts 0.6 % more.
Without a bound late links make yaw swing at 2 rad/s, rotors at speeds of 3 to 1: 1 to 2 m/s^2 more than asked for."""
_ROOM_H = 0.05
"""h that a place of rest has beyond all doubts."""
_EMPTY = np.full(len(Filtered.nothing().row), np.nan)


class FilterState(NamedTuple):
    """Everything that one tick hands to the next; `memory` and `packed` are written in place."""

    origin_ned_m: F64
    memory: F64
    """Rotors, engagement, commands sent: `response.new_memory`."""
    certificate: Certificate | None
    packed: F64
    """The same for compiled code: `assess.pack`."""
    rest_ned_m: F64
    """(2, 3) between which places the vehicle may rest, with room; infinite along what is not certified."""
    handed_over: bool = False
    """What it kept to was falsified, and nothing else is there: commands pass."""
    governor: GovernorLimits | None = None
    """What the certificate asks of the governor; None: nothing."""


class BarrierFilter:
    """The filter for one believed vehicle; holds constants, the solver and buffers for one tick."""

    enabled = True
    __slots__ = ("_high", "_limiter", "_low", "_qp", "_rows", "_work", "attitude_p_ps", "limits", "model")

    def __init__(self, model: Model, limits: Limits, attitude_p_ps: float = STEER_PS) -> None:
        """`attitude_p_ps`: how fast body rates steer the thrust axis to where it is wanted (1 / T), as the certificate
        of a lateral axis has it."""
        self.model, self.limits, self.attitude_p_ps = model, limits, attitude_p_ps
        self._limiter = Limiter(model, limits)
        self._qp = NearestPoint(ROWS)
        self._rows, self._work = np.zeros((ROWS, 3)), np.zeros(WORK)
        self._low, self._high = np.zeros(ROWS), np.zeros(ROWS)
        self.compile()

    def compile(self) -> None:
        """Call everything that a tick may need, once: no flight waits for the compiler when a certificate comes."""
        still, row = np.zeros(3), np.zeros(len(_EMPTY))
        state = self.init(still)
        remember(state.memory, 0.0, 0.5, still)
        level = np.zeros(20)
        level[ATTITUDE] = 1.0
        assess(
            state.memory, state.packed, level, (0.0, 0.0, 0.0), still, (0.5, still, 0.5, still),
            (self._work, self._rows, self._low, self._high), row,
        )  # fmt: skip
        self._qp.solve(np.ones((ROWS, 3)), np.zeros(ROWS), np.ones(ROWS), np.full(3, 2.0))
        fallback(row, row[8:11].copy())
        settle(state.packed, self._work, steer(state.packed, self._work, still, still.copy()), still, row)

    def init(self, origin_ned_m: F64) -> FilterState:
        """Nothing certified, nothing sent; regions are relative to the origin, (3,)."""
        self._qp.forget()
        packed = pack(None, self.model, self.limits, self.attitude_p_ps)
        return FilterState(origin_ned_m.copy(), new_memory(), None, packed, np.stack([_NOWHERE, -_NOWHERE]))

    def adopt(self, state: FilterState, certificate: Certificate) -> FilterState:
        """Keep to this certificate from now on.

        For the same region (centre and axes), grown or shrunk, an engaged filter stays so: where the state is outside,
        it is led back in.  For another region it stays engaged only if the state is inside.  One that was falsified,
        with nothing left to keep to, ends the filtering: by its model commands would be changed wrongly.
        """
        if certificate.knowledge.get(HAND_OVER):
            return state._replace(certificate=certificate, handed_over=True)
        before = state.certificate
        if before is not None and _region(before) != _region(certificate) and state.memory[0, M_MODE] == ENGAGED:
            state.memory[0, M_MODE] = DOUBTFUL
        limits = within(self.limits, self.model, certificate.governor)
        packed = pack(certificate, self.model, limits, self.attitude_p_ps)
        rest, terms = _rest(certificate) + state.origin_ned_m, certificate.governor
        return state._replace(
            certificate=certificate, packed=packed, rest_ned_m=rest, handed_over=False,
            governor=None if terms is None else terms.limits,
        )  # fmt: skip

    def governed(self, state: FilterState) -> GovernorLimits | None:
        """Those of the certificate that is in force from half a second before engaging: then torque is calm.

        Not before: GPS noise beside bounded torque rocks a lean that nothing limits, and it would never engage.
        """
        memory = state.memory
        if state.governor is None or state.handed_over:
            return None
        if not (memory.item(0, M_MODE) > 0.0 or memory.item(0, M_GOOD_SINCE) < math.inf):
            return None
        return state.governor

    def in_force(self, state: FilterState) -> F64 | None:
        """The certificate, engaged or not."""
        return None if state.certificate is None or state.handed_over else state.packed

    def bend(self, state: FilterState, setpoint: FlatOutput) -> FlatOutput:
        """While engaged, the reference brought to the nearest place of rest inside the region, where it is outside.

        The filter alone would keep the vehicle inside as well.  But a controller whose reference stays out of reach
        asks for ever more along that axis and has nothing left to hold its place along the others.
        """
        if state.memory.item(0, M_MODE) != ENGAGED or state.handed_over:
            return setpoint
        row, (low, high) = setpoint.row, state.rest_ned_m.tolist()
        if all(map(le, low, at := row[:3].tolist())) and all(map(le, at, high)):
            return setpoint
        inside = np.clip(row[:3], low, high)
        bent = row.copy()
        bent[:3] = inside
        bent[3:15] *= np.tile(inside == row[:3], 4)
        return FlatOutput(bent)

    def step(
        self, state: FilterState, measurement: Measurement, command: Command, sent: Command, learned: Learned
    ) -> tuple[FilterState, Command, Filtered]:
        """The safe command nearest to `command`; `sent` is the command of the tick before, as it went out."""
        row = _EMPTY.copy()
        row[F_INTERVENED], row[F_THRUST] = 0.0, command.thrust_n
        certificate, packed, work = state.certificate, state.packed, self._work
        if certificate is None:
            remember(state.memory, float(sent.t_us), sent.thrust_norm, sent.rate_frd_radps)
            row[F_STATUS] = UNCERTIFIED
            return state, command, Filtered(row)
        if state.handed_over:
            remember(state.memory, float(sent.t_us), sent.thrust_norm, sent.rate_frd_radps)
            row[F_STATUS], row[F_VERSION] = FALSIFIED, certificate.version
            return state, command, Filtered(row)
        times_us = (float(sent.t_us), float(measurement.t_us), float(command.t_us))
        status = _ASSESS.call(
            state.memory, packed, measurement.row, times_us, state.origin_ned_m,
            (sent.thrust_norm, sent.rate_frd_radps, command.thrust_norm, command.rate_frd_radps),
            (work, self._rows, self._low, self._high), row,
        )  # fmt: skip
        row[F_STATUS], row[F_ITERATIONS], row[F_VERSION] = status, 0.0, certificate.version
        kept = status == WAITING and row.item(F_INTERVENED) == 1.0
        if (status == WAITING and not kept) or not math.isfinite(row.item(F_WANTED)):  # no number: the guard judges
            return state, command, Filtered(row)
        if kept:
            rate = command.rate_frd_radps.copy()
            return state, self._steered(state, command, row[11:14].copy(), rate, row), Filtered(row)
        wanted_yaw = command.rate_frd_radps.item(2)
        yaw = _gently(wanted_yaw, measurement.row.item(_YAW_RATE), self.limits.rate_max_radps[2])
        if status == PASSED and yaw == wanted_yaw:
            return state, command, Filtered(row)
        u, rate = np.empty(3), command.rate_frd_radps.copy()
        rate[2] = yaw
        if status == CHANGED:
            solution = self._qp.solve(self._rows, self._low, self._high, row[8:11])
            u, row[F_ITERATIONS], row[F_RESIDUAL] = solution.x, solution.iterations, solution.residual
            if not solution.solved:
                status = row[F_STATUS] = UNSOLVED
            elif (
                max(abs(u[0] - row[F_WANTED]), abs(u[1] - row[F_WANTED + 1]), abs(u[2] - row[F_WANTED + 2]))
                < _SAME_MPS2
            ):
                status = row[F_STATUS] = PASSED
        if status == PASSED:
            if yaw == wanted_yaw:
                return state, command, Filtered(row)
            row[F_STATUS], row[F_INTERVENED] = CHANGED, 1.0
            return state, command._replace(rate_frd_radps=rate), Filtered(row)
        if status != CHANGED:
            fallback(row, u)
        return state, self._steered(state, command, u, rate, row), Filtered(row)

    def _steered(self, state: FilterState, command: Command, u: F64, rate: F64, row: F64) -> Command:
        """The command that has the accelerations u (3,), and into `row` what it really does."""
        norm = steer(state.packed, self._work, u, rate)
        safe, _ = self._limiter.limit(self.model.thrust_of(norm), rate, command.t_us)
        settle(state.packed, self._work, safe.thrust_norm, safe.rate_frd_radps, row)
        row[F_INTERVENED] = 1.0
        return safe


def _gently(wanted_radps: float, present_radps: float, most_radps: float) -> float:
    """The yaw rate nearest to the wanted one that asks for little torque; never beyond the limit."""
    present, sign = abs(present_radps), 1.0 if present_radps >= 0.0 else -1.0
    least = min(present - _YAW_FASTER_RADPS, max(present - _YAW_SLOWER_RADPS, 0.0))
    allowed = sign * min(max(sign * wanted_radps, least), present + _YAW_FASTER_RADPS)
    return min(max(allowed, -most_radps), most_radps)


def _rest(certificate: Certificate) -> F64:
    """(2, 3) FilterState.rest_ned_m relative to the start."""
    rest = np.stack([_NOWHERE, -_NOWHERE])
    for axis in certificate.axes:
        low, high = axis.barrier.box[:2]
        places = np.linspace(low, high, _PLACES)
        ends = [next((e for e in way.tolist() if _rests(axis, e)), 0.0) for way in (places, places[::-1])]
        rest[:, axis.axis] = certificate.centre_ned_m[axis.axis] + np.array(ends)
    return rest


def _rests(axis: AxisCertificate, e_m: float) -> bool:
    """Whether the vehicle may rest at a distance from the centre, with room."""
    setting = axis.setting
    for row in axis.barrier.rows:
        h, he, hv = piece_at(row, e_m, 0.0)
        if not h - setting.inner - doubt_of(row, he, hv, setting.off_m, setting.off_mps) >= _ROOM_H:
            return False
    return True


def _region(certificate: Certificate) -> tuple[object, ...]:
    return certificate.centre_ned_m, tuple(axis.axis for axis in certificate.axes)


_ASSESS = Entry(
    assess,
    "f8[:, ::1], f8[::1], f8[::1], UniTuple(f8, 3), f8[::1], Tuple((f8, f8[::1], f8, f8[::1])), "
    "Tuple((f8[::1], f8[:, ::1], f8[::1], f8[::1])), f8[::1]",
)
