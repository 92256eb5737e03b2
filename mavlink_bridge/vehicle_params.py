"""The vehicle's parameters that matter to an offboard flight: asked for, awaited, judged.  Sans-IO.

PX4 has no rate limit on the body rates of an offboard setpoint; its MC_*RATE_MAX are what its owner allows, and are
kept to here.  PX4 undoes THR_MDL_FAC's curve before the motors, so the same curve is applied to what is sent.
SERVO_OUTPUT_RAW is scaled by the outputs' own limits, which a simulated PX4 does not have: there it is 1000 to 2000.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flightstack.airframe import GEOMETRY, hover_setpoint, unsettled_hover
from flightstack.jit import njit
from flightstack.model import Model
from flightstack.types import F64, Tuple3, Tuple4
from mavlink_bridge import messages as m
from mavlink_bridge.link import Link

NEEDED = ("COM_OF_LOSS_T", "COM_OBL_RC_ACT", "THR_MDL_FAC", "MPC_THR_HOVER")
"""Without these nobody flies."""
RATE_LIMITS = ("MC_ROLLRATE_MAX", "MC_PITCHRATE_MAX", "MC_YAWRATE_MAX")
_OUTPUTS = 8
_FUNCTIONS = tuple(f"PWM_MAIN_FUNC{i}" for i in range(1, _OUTPUTS + 1))
_FIRST_MOTOR = 101
_MOTORS = 4
OPTIONAL = (*RATE_LIMITS, "MC_BAT_SCALE_EN", "NAV_DLL_ACT", *_FUNCTIONS, *GEOMETRY)
"""A PX4 may lack them, or be too old to say that it does."""
_RETRY_US = 300_000
_TRIES_NEEDED = 20
_TRIES_OPTIONAL = 8
_LOSS_T_RANGE_S = (0.1, 2.0)
_LOSS_T_ALONE_S = 0.5
"""Longest COM_OF_LOSS_T without a dead-man: in half a second a figure of eight tilts by some 60 degrees."""
_LEAST_RATE_DEGPS = 30.0
_DEADLY = {6: "terminate", 7: "disarm"}


class Outputs(NamedTuple):
    """Which SERVO_OUTPUT_RAW values are the four motors, and the pulses that mean 0 and 1."""

    channels: tuple[int, int, int, int] = (0, 1, 2, 3)
    low_us: Tuple4 = (1000.0, 1000.0, 1000.0, 1000.0)
    high_us: Tuple4 = (2000.0, 2000.0, 2000.0, 2000.0)

    def commands(self, pwm_us: tuple[int, ...]) -> Tuple4:
        """Normalised commands, 0..1; below the low pulse is stopped."""
        a, b, c, d = motor_commands(np.array(pwm_us, np.float64), self.row).tolist()
        return a, b, c, d

    @property
    def row(self) -> F64:
        """(12,) all of it, for compiled code."""
        return np.array([*self.channels, *self.low_us, *self.high_us], np.float64)


@njit
def motor_commands(pulses: F64, outputs: F64) -> F64:
    """As `Outputs.commands`; `outputs` (12,): an Outputs' row."""
    out, inside = np.empty(4), True
    for i in range(4):
        low, high = outputs[4 + i], outputs[8 + i]
        out[i] = (pulses[int(outputs[i])] - low) / (high - low)
        inside = inside and 0.0 <= out[i] <= 1.0
    if not inside:
        for i in range(4):
            out[i] = min(1.0, max(0.0, out[i]))
    return out


@dataclass(slots=True)
class _Asked:
    tries: int = 0
    sent_us: int = -1


class ParamReader:
    """Asks for every parameter until it is told, refused, or asked for often enough."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self.outputs_row = Outputs().row
        """`outputs_now` for compiled code, the same array for good."""
        self.outputs_now = Outputs()
        self._wanted: list[str] = []
        """Which pulse limits are wanted by then."""
        self._absent: set[str] = set()
        self._asked: dict[str, _Asked] = {name: _Asked() for name in (*NEEDED, *OPTIONAL)}

    def ask(self, link: Link, system: int, now_us: int) -> None:
        """Send what is due."""
        for name in self._wanted:
            if name not in self._asked:
                self._asked[name] = _Asked()
        for name in self._open():
            asked = self._asked[name]
            if asked.sent_us < 0 or now_us - asked.sent_us >= _RETRY_US:
                asked.tries, asked.sent_us = asked.tries + 1, now_us
                link.send(m.ParamRequestRead(system, 1, name, -1))

    def take(self, message: object) -> None:
        """PARAM_VALUE or PARAM_ERROR; others mean nothing here."""
        if isinstance(message, m.ParamValue) and message.param_id in self._asked:
            value = float(message.value)
            if math.isfinite(value):
                self.values[message.param_id] = value
                self.outputs_now, self._wanted = self.outputs, self._limits_wanted()
        elif isinstance(message, m.ParamError) and message.param_id in self._asked:
            self._absent.add(message.param_id)

    @property
    def outputs_now(self) -> Outputs:
        """`outputs` as of the last parameter that came."""
        return self._outputs

    @outputs_now.setter
    def outputs_now(self, outputs: Outputs) -> None:
        self._outputs, self.outputs_row[:] = outputs, outputs.row

    @property
    def needs_dead_man(self) -> bool:
        """Whether PX4 would go on with the last body rates for too long."""
        return self.values.get("COM_OF_LOSS_T", math.inf) > _LOSS_T_ALONE_S

    @property
    def missing(self) -> list[str]:
        """The needed ones that were not told."""
        return [name for name in NEEDED if name not in self.values]

    @property
    def settled(self) -> bool:
        """Nothing more is to be expected."""
        return not self.missing and not self._open() and all(name in self._asked for name in self._wanted)

    @property
    def rate_max_radps(self) -> Tuple3:
        """The rates that the vehicle's owner allows; infinite where not told."""
        roll, pitch, yaw = (math.radians(self.values.get(name, math.inf)) for name in RATE_LIMITS)
        return roll, pitch, yaw

    @property
    def outputs(self) -> Outputs:
        """How SERVO_OUTPUT_RAW is to be read; the usual four where the vehicle says nothing of its outputs."""
        channels = self._channels()
        if channels is None:
            return Outputs()
        low = [self.values.get(f"PWM_MAIN_MIN{c + 1}", 1000.0) for c in channels]
        high = [self.values.get(f"PWM_MAIN_MAX{c + 1}", 2000.0) for c in channels]
        if not all(below < above for below, above in zip(low, high, strict=True)):
            return Outputs(channels)
        (a, b, c, d), (e, f, g, h) = low, high
        return Outputs(channels, (a, b, c, d), (e, f, g, h))

    def _channels(self) -> tuple[int, int, int, int] | None:
        found = {int(self.values.get(name, 0.0)): channel for channel, name in enumerate(_FUNCTIONS)}
        places = [found.get(_FIRST_MOTOR + motor) for motor in range(_MOTORS)]
        a, b, c, d = places
        return None if a is None or b is None or c is None or d is None else (a, b, c, d)

    def _limits_wanted(self) -> list[str]:
        channels = self._channels()
        if channels is None:
            return []
        return [f"PWM_MAIN_{end}{channel + 1}" for channel in channels for end in ("MIN", "MAX")]

    def _open(self) -> list[str]:
        return [
            name
            for name, asked in self._asked.items()
            if name not in self.values
            and name not in self._absent
            and asked.tries < (_TRIES_NEEDED if name in NEEDED else _TRIES_OPTIONAL)
        ]


def findings(values: Mapping[str, float], *, dead_man: bool = True) -> list[tuple[str, str]]:
    """Every parameter that is judged, and one line why the vehicle should not be flown with it, empty where it may.

    dead_man: somebody answers the companion's silence before PX4 does.
    """
    judged = [("COM_OF_LOSS_T", loss_time_problem(values, dead_man=dead_man))]
    for name in RATE_LIMITS:
        too_low = values.get(name, math.inf) < _LEAST_RATE_DEGPS
        judged.append(
            (name, f"{name} is {values[name]:g} deg/s: that leaves no control; set it to {_LEAST_RATE_DEGPS:g} or more")
            if too_low
            else (name, "")
        )
    action = int(values.get("COM_OBL_RC_ACT", -1.0))
    problem = (
        f"COM_OBL_RC_ACT is {action} ({_DEADLY[action]}): a lost link would stop the motors in the air; "
        "set it to 5 (hold), 4 (land) or 3 (return)"
        if action in _DEADLY
        else ""
    )
    return [*judged, ("COM_OBL_RC_ACT", problem)]


def loss_time_problem(values: Mapping[str, float], *, dead_man: bool) -> str:
    """Why COM_OF_LOSS_T is not as it has to be, one line; empty where it is."""
    low, high = _LOSS_T_RANGE_S
    loss_t_s = values.get("COM_OF_LOSS_T", math.nan)
    if _LOSS_T_ALONE_S < loss_t_s <= high and not dead_man:
        return (
            f"COM_OF_LOSS_T is {loss_t_s:g} s and no dead-man runs: PX4 would go on with the last body rates for so "
            f"long; fly with the dead-man or set it to {low:g} to {_LOSS_T_ALONE_S:g} s"
        )
    if low <= loss_t_s <= high:
        return ""
    return (
        f"COM_OF_LOSS_T is {loss_t_s:g} s: PX4 goes on with the last body rates for so long; "
        f"set it to {low:g} to {high:g} s"
    )


def unsafe(values: Mapping[str, float], *, dead_man: bool = True) -> str:
    """Why the vehicle should not be flown as it is set, one line; empty where it may."""
    return next((problem for _, problem in findings(values, dead_man=dead_man) if problem), "")


def remarks(values: Mapping[str, float], model: Model) -> str:
    """What was read and what is made of it, for the log."""
    factor, believed = values.get("THR_MDL_FAC", 0.0), hover_setpoint(values, model.hover_norm)
    loss_t_s = values.get("COM_OF_LOSS_T", math.nan)
    risk = ": should the link break, the last body rates go on for so long, 0.2 to 0.5 s is better"
    parts = [
        f"COM_OF_LOSS_T {loss_t_s:g} s{risk if loss_t_s > _LOSS_T_ALONE_S else ''}",
        f"COM_OBL_RC_ACT {values.get('COM_OBL_RC_ACT', math.nan):g}",
        f"THR_MDL_FAC {factor:g}",
        f"MPC_THR_HOVER {values.get('MPC_THR_HOVER', math.nan):.2f}, by the vehicle file {believed:.2f}",
    ]
    if unsettled := unsettled_hover(values, model.hover_norm):
        parts.append(unsettled)
    if values.get("MC_BAT_SCALE_EN", 0.0):
        parts.append("MC_BAT_SCALE_EN is on: PX4 changes thrust with the battery, too; better switch it off")
    return "; ".join(parts)
