"""The governor of rate commands: keeps the torque that PX4's rate loop asks for so small that no rotor saturates.

A rate command makes the autopilot ask for torque, and torque takes thrust: where a rotor reaches the end of its
command PX4 lowers the collective thrust, and unevenly turning rotors lift more than even ones.  Neither is in a
certificate's bound of acceleration unless torque itself is bounded.  So while a certificate is in force, the governor
has the last word on every command, the guard's brake included:

* it runs the rate loop (`rate_loop`, five copies for what is not known of it) on the commands that are sent;
* it moves wanted rates towards those of the least torque, as little as does, until the torque predicted for the next
  40 ms (yaw 200 ms) with the command held is at most r_max (of roll and pitch together, as their hypotenuse) and y_max,
  in every copy.  Roll and pitch are cut as what they turn the lean by, to north and to east, each change at the same
  size: r_max / sqrt(2) and more is there for either, so who shakes one axis does not take from the other what keeps
  the vehicle in its region, whatever its heading;
* it keeps the collective command in [D, 1 - D], and the rates in what PX4's owner allows (MC_*RATE_MAX).

With no rotor's command further than D from the collective one nothing saturates, so PX4's airmode does not matter
either, and the loop stays the linear one that is modelled.  What remains of thrust's error is the rotors' curve:
`barrier.torque` bounds it for the ledger, and chooses the limits.

A command within its bounds passes bit for bit.  With no certificate in force every command does; the model runs all the
same.  A filter engages half a second after its certificate came at the earliest: by then the loop has calmed down.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from flightstack.autopilot import autopilot_of
from flightstack.jit import Entry, njit
from flightstack.model import thrust_to_norm
from flightstack.rate_loop import (
    A2,
    B0,
    B1,
    BODY,
    LAGGED,
    LANES,
    MODELS,
    RATE,
    STATE,
    TORQUE,
    Z1,
    Z2,
    constants_of,
    couple,
    step_lanes,
)  # fmt: skip
from flightstack.types import F64, Command, made
from flightstack.vehicle import Vehicle

STEP_US = 1000
_STEPS_MOST = 100
"""A pause between commands longer than so many steps counts as this long: the loop has settled by then."""
_TILT_STEPS = 40
_YAW_STEP_S, _YAW_STEPS = 0.004, 50
_TILT, _YAW = 4 * MODELS, 2 * MODELS
"""Lanes of a prediction: as things are, then the answer to a unit step; of roll and pitch, of yaw."""
_HALVINGS = 12
_GOLDEN = 0.5 * (3.0 - math.sqrt(5.0))
_NEVER = -1


class GovernorLimits(NamedTuple):
    """What is kept, in units of PX4's normalised torque and thrust."""

    roll_pitch_max: float = 0.06
    """r_max: greatest hypotenuse of roll and pitch torque."""
    yaw_max: float = 0.03
    """y_max."""
    margin: float = 0.1
    """D: the collective command keeps so far from 0 and from 1, as PX4 mixes it."""

    def command_range(self, undone: float) -> tuple[float, float]:
        """Least and greatest collective command; `undone`: THR_MDL_FAC, whose curve PX4 undoes after mixing."""
        return thrust_to_norm(self.margin, 1.0, undone), thrust_to_norm(1.0 - self.margin, 1.0, undone)


@lru_cache(maxsize=4)
def _command_range(limits: GovernorLimits, undone: float) -> tuple[float, float]:
    """`GovernorLimits.command_range`, which each tick asks for."""
    return limits.command_range(undone)


_NORM = 3
"""Of the memory, after the body rates."""


class _Loop(NamedTuple):
    """The rate loop's constants for all lanes of the model, of a prediction of roll and pitch, of one of yaw; PX4's
    rate limits."""

    model: F64
    tilt: F64
    yaw: F64
    rate_max: F64


class _Buffers(NamedTuple):
    """Written in each tick; `out` (3,) the rates to send."""

    target: F64
    coupling: F64
    work: F64
    torques: F64
    out: F64


class GovernorState(NamedTuple):
    """What one tick hands to the next; the arrays are written in place."""

    memory: F64
    """(3 + 1 + STATE * LANES,) rates and collective command sent last, then the model's state."""
    t_us: int = _NEVER
    """Up to when the model has run."""


class Governor:
    """The governor of one believed vehicle; holds constants and buffers for one tick."""

    __slots__ = ("_buffers", "_loop", "_undone")

    def __init__(self, vehicle: Vehicle) -> None:
        autopilot = autopilot_of(vehicle)
        rate_max = np.radians([autopilot[f"mc_{axis}rate_max"] for axis in ("roll", "pitch", "yaw")])
        self._undone = autopilot["thr_mdl_fac"]
        tilt = constants_of(vehicle)[:, : 2 * MODELS]
        yaw = constants_of(vehicle, step_s=_YAW_STEP_S)[:, 2 * MODELS :]
        yaw[B0], yaw[B1 : A2 + 1] = (
            1.0,
            0.0,
        )  # the gyro filter's 6 ms are nothing to yaw, and its state is of 1 ms steps
        tilt, yaw = (np.hstack([each, each]).ravel() for each in (tilt, yaw))
        self._loop = _Loop(constants_of(vehicle).ravel(), tilt, yaw, rate_max)
        sizes = _TILT, _TILT + _YAW, STATE * _TILT, _YAW_STEPS * _TILT, 3
        self._buffers = _Buffers(*(np.zeros(size) for size in sizes))
        self.step(self.init(), Command(0, 0.0, 0.5, np.full(3, 0.1)), GovernorLimits())

    def init(self) -> GovernorState:
        """At rest, nothing sent."""
        return GovernorState(np.zeros(4 + STATE * LANES))

    def step(
        self, state: GovernorState, command: Command, limits: GovernorLimits | None, heading_rad: float = 0.0
    ) -> tuple[GovernorState, float, F64 | None]:
        """The state after sending; collective command and rates (3,) to send; rates None where they pass as they are.

        `limits` None: nothing is limited, the model runs all the same; `heading_rad`: of the vehicle, from north.
        """
        rate, norm = command.rate_frd_radps, command.thrust_norm
        roll, pitch, yaw = rate.tolist()
        if not math.isfinite(norm + roll + pitch + yaw):  # PX4 does not take it either
            return state, norm, None
        if state.t_us == _NEVER:
            state.memory[4 + LAGGED * LANES : 4 + (LAGGED + 1) * LANES] = norm
        steps = 0 if state.t_us == _NEVER else min(max((command.t_us - state.t_us) // STEP_US, 0), _STEPS_MOST)
        behind = command.t_us - state.t_us - steps * STEP_US
        t_us = command.t_us if state.t_us == _NEVER or not 0 <= behind < STEP_US else command.t_us - behind
        most = (math.inf, math.inf, 0.0, 1.0)
        if limits is not None:
            most = (limits.roll_pitch_max, limits.yaw_max, *_command_range(limits, self._undone))
        ahead = (math.sin(heading_rad), math.cos(heading_rad)) if math.isfinite(heading_rad) else (0.0, 1.0)
        norm, changed = _GOVERN.call(state.memory, *self._loop, *self._buffers, rate, norm, int(steps), most, ahead)
        after = made(GovernorState, (state.memory, t_us))
        return after, norm, self._buffers.out.copy() if changed else None

    @staticmethod
    def torque(state: GovernorState) -> F64:
        """(3, MODELS) normalised torque of each copy at present."""
        torque: F64 = state.memory[4:].reshape(STATE, 3, MODELS)[TORQUE]
        return torque


@njit
def govern(
    memory: F64, model: F64, tilt: F64, yaw: F64, rate_max: F64, target: F64, coupling: F64, work: F64, torques: F64,
    out: F64, rate: F64, norm: float, steps: int, bounds: tuple[float, float, float, float],
    ahead: tuple[float, float],
) -> tuple[float, bool]:  # fmt: skip
    """`_govern`; flat, for a named tuple that crosses into compiled code costs a third of the step."""
    loop, buffers = _Loop(model, tilt, yaw, rate_max), _Buffers(target, coupling, work, torques, out)
    return _govern(memory, loop, buffers, rate, norm, steps, bounds, ahead)


@njit
def _govern(
    memory: F64, loop: _Loop, buffers: _Buffers, rate: F64, norm: float, steps: int,
    bounds: tuple[float, float, float, float], ahead: tuple[float, float],
) -> tuple[float, bool]:  # fmt: skip
    """Run the model for `steps` on what was sent last, then bound what is sent now: rates into `buffers.out` (3,).

    bounds: r_max, y_max, least and greatest collective command; ahead: sine and cosine of the heading.
    """
    state, target, coupling, out = memory[4:], buffers.target, buffers.coupling, buffers.out
    r_max, y_max, least, greatest = bounds
    for axis in range(3):
        for m in range(MODELS):
            target[axis * MODELS + m] = memory[axis]
    for _ in range(steps):
        couple(state, loop.model, coupling)
        step_lanes(state, loop.model, target, coupling, memory[_NORM], LANES, 0.001)
    changed = False
    for axis in range(3):
        out[axis] = rate[axis]
    if r_max < np.inf:
        norm = min(max(norm, least), greatest)
        for axis in range(3):
            most = loop.rate_max[axis]
            out[axis] = min(max(rate[axis], -most), most)
        couple(state, loop.model, coupling)
        for j in range(MODELS):  # beyond what roll and pitch are predicted with
            coupling[_TILT + j] = coupling[2 * MODELS + j]
        present = state[RATE * LANES], state[RATE * LANES + MODELS], state[RATE * LANES + 2 * MODELS]
        work, torques = buffers.work, buffers.torques
        _pack(state, 0, 2 * MODELS, work)
        _predict_tilt(work, loop.tilt, coupling, target, norm, present, torques)
        wanted = out[0] - present[0], out[1] - present[1]
        change = _within(torques, wanted, ahead, r_max, False)
        if change != wanted:
            out[0], out[1] = present[0] + change[0], present[1] + change[1]
        _pack(state, 2 * MODELS, 3 * MODELS, work)
        for j in range(_YAW):
            work[Z1 * _YAW + j] = work[Z2 * _YAW + j] = 0.0
            work[RATE * _YAW + j] = work[BODY * _YAW + j]
        _predict_yaw(work, loop.yaw, coupling[_TILT:], target, norm, present[2], torques)
        wanted = out[2] - present[2], 0.0
        change = _within(torques, wanted, (1.0, 0.0), y_max, True)
        if change != wanted:
            out[2] = present[2] + change[0]
        changed = out[0] != rate[0] or out[1] != rate[1] or out[2] != rate[2]
    for axis in range(3):
        memory[axis] = out[axis]
    memory[_NORM] = norm
    return norm, changed


@njit
def _pack(state: F64, first: int, last: int, work: F64) -> None:
    """The lanes from first to last, and as many at rest but for the collective command: ready to be predicted."""
    count = last - first
    for row in range(STATE):
        for j in range(count):
            work[row * 2 * count + j] = state[row * LANES + first + j]
            work[row * 2 * count + count + j] = state[row * LANES + first + j] if row == LAGGED else 0.0


@njit
def _predict_tilt(
    work: F64, constants: F64, coupling: F64, target: F64, norm: float, present: tuple[float, float, float],
    torques: F64,
) -> None:  # fmt: skip
    """Torques of the next steps at the present rates, and of a unit step of each axis (`_TILT` lanes a step)."""
    for j in range(MODELS):
        target[j], target[MODELS + j] = present[0], present[1]
        target[2 * MODELS + j] = target[3 * MODELS + j] = 1.0
        coupling[2 * MODELS + j] = coupling[3 * MODELS + j] = 0.0
    for k in range(_TILT_STEPS):
        step_lanes(work, constants, target, coupling, norm, _TILT, 0.001)
        for j in range(_TILT):
            torques[k * _TILT + j] = work[TORQUE * _TILT + j]


@njit
def _predict_yaw(
    work: F64, constants: F64, coupling: F64, target: F64, norm: float, present: float, torques: F64
) -> None:  # fmt: skip
    """The same of yaw alone."""
    for j in range(MODELS):
        target[j], target[MODELS + j], coupling[MODELS + j] = present, 1.0, 0.0
    for k in range(_YAW_STEPS):
        step_lanes(work, constants, target, coupling, norm, _YAW, _YAW_STEP_S)
        for j in range(_YAW):
            torques[k * _YAW + j] = work[TORQUE * _YAW + j]


@njit
def _within(
    torques: F64, change: tuple[float, float], ahead: tuple[float, float], most: float, yaw: bool
) -> tuple[float, float]:
    """The change of roll and pitch rate (of yaw rate, and 0) that keeps the torque within `most`: beyond those of the
    least torque, what it turns the lean by to north and to east, cut at the same size, the greatest that does."""
    if _torque_peak(torques, change, yaw) <= most:
        return change
    size = abs(change[0]) + abs(change[1])
    first = _least(torques, 0, size, yaw)
    second = 0.0 if yaw else _least(torques, MODELS, size, yaw)
    roll, pitch = change[0] - first, change[1] - second
    north, east = pitch * ahead[1] + roll * ahead[0], pitch * ahead[0] - roll * ahead[1]
    low, high = 0.0, max(abs(north), abs(east))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        roll, pitch = _cut(north, east, middle, ahead)
        if _torque_peak(torques, (first + roll, second + pitch), yaw) <= most:
            low = middle
        else:
            high = middle
    roll, pitch = _cut(north, east, low, ahead)
    return first + roll, second + pitch


@njit
def _cut(north: float, east: float, most: float, ahead: tuple[float, float]) -> tuple[float, float]:
    """Changes of roll and pitch rate that turn the lean to north and to east so much, each by `most` at most."""
    n, e = min(max(north, -most), most), min(max(east, -most), most)
    return n * ahead[0] - e * ahead[1], n * ahead[1] + e * ahead[0]


@njit
def _least(torques: F64, first: int, size: float, yaw: bool) -> float:
    """The change of one rate, up to `size` either way, with the least peak of torque: convex, so by golden section."""
    low, high = -size, size
    for _ in range(_HALVINGS):
        one, two = low + _GOLDEN * (high - low), high - _GOLDEN * (high - low)
        if _axis_peak(torques, first, one, yaw) <= _axis_peak(torques, first, two, yaw):
            high = two
        else:
            low = one
    return 0.5 * (low + high)


@njit
def _axis_peak(torques: F64, first: int, change: float, yaw: bool) -> float:
    """The greatest torque of any copy in any step of the axis whose lanes begin at `first`."""
    if yaw:
        return _peak(torques, _YAW_STEPS, _YAW, first, MODELS, change)
    return _peak(torques, _TILT_STEPS, _TILT, first, 2 * MODELS, change)


@njit
def _torque_peak(torques: F64, change: tuple[float, float], yaw: bool) -> float:
    """The same of roll and pitch together (of yaw): any copy of either in any step."""
    along = _axis_peak(torques, 0, change[0], yaw)
    across = 0.0 if yaw else _axis_peak(torques, MODELS, change[1], yaw)
    return math.sqrt(along * along + across * across)


@njit
def _peak(torques: F64, steps: int, lanes: int, first: int, apart: int, change: float) -> float:
    """The greatest torque of any copy in any step."""
    greatest = 0.0
    for k in range(steps):
        at = k * lanes + first
        for j in range(MODELS):
            greatest = max(greatest, abs(torques[at + j] + change * torques[at + apart + j]))
    return greatest


__all__ = ["Governor", "GovernorLimits", "GovernorState", "govern"]


_GOVERN = Entry(govern, "f8[::1], " * 11 + "f8, i8, UniTuple(f8, 4), UniTuple(f8, 2)")
