"""Incremental nonlinear dynamic inversion of the linear acceleration.

The thrust vector is changed by what the measured acceleration lacks of the wanted one, from where it was:

    t_d = t_f + (a_f - a_d),     t = (T / m) z_b,  a_d from the PD law of `flightstack.control.pid`

t_f and a_f, the applied thrust vector and the measured acceleration, pass the same filter: whatever acts on the vehicle
besides thrust is in their difference and need not be known.  With a believed drag the increment counts from the model's
whole force, so that the reference's drag stays fed forward.  The filtered difference's derivative leads the attitude.
Sources: E. Smeur, G. de Croon, Q. Chu, "Cascaded incremental nonlinear dynamic inversion for MAV disturbance
rejection", 2018; E. Tal, S. Karaman, "Accurate Tracking of Aggressive Quadrotor Trajectories Using Incremental
Nonlinear Dynamic Inversion and Differential Flatness", 2021.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flightstack.control.attitude import PROPOSAL, AttitudeGains
from flightstack.control.observer import FILTER, ObserverGains, feed_forward, observe
from flightstack.control.pid import MEMORY, PidGains, Remembered, pid_constants, pid_step
from flightstack.jit import njit
from flightstack.learning.sampler import SAMPLE, Sampler
from flightstack.model import Limits, Model
from flightstack.types import F64, Command, FlatOutput, Learned, Measurement, Proposal


class IndiState(NamedTuple):
    """What the controller remembers: the PD law's and the filter's numbers, and the sampler's (used up in place)."""

    law: Remembered
    sampled: F64


class IndiController:
    """The law above for one model; final, holds only constants."""

    __slots__ = ("_constants", "_sampler")

    def __init__(
        self, model: Model, limits: Limits, attitude: AttitudeGains, gains: PidGains, increments: ObserverGains
    ) -> None:
        law = pid_constants(model, limits, attitude, gains)
        self._constants = np.vstack([law, np.full((1, 3), increments.cutoff_radps)])
        self._sampler = Sampler(model)

    def init(self, now_us: int) -> IndiState:
        """Nothing measured yet."""
        return IndiState(Remembered(np.zeros(MEMORY + FILTER), now_us), self._sampler.init())

    def healthy(self, state: IndiState) -> bool:
        """Whether the filters are finite."""
        return state.law.healthy

    def step(
        self, state: IndiState, measurement: Measurement, reference: FlatOutput, learned: Learned, sent: Command,
        now_us: int,
    ) -> tuple[IndiState, Proposal]:  # fmt: skip
        """One step; `sent` and what was sent before it say which thrust the accelerometer felt."""
        row, memory, sample = np.empty(PROPOSAL), state.law.row.copy(), np.empty(SAMPLE)
        self._sampler.step(state.sampled, measurement, sent, sample)
        dt = state.law.seconds_until(now_us)
        thrust = _step(self._constants, memory, sample, dt, reference.row, measurement.row, learned.row, row)
        return IndiState(Remembered(memory, now_us), state.sampled), Proposal(thrust, row)


@njit
def _step(
    constants: F64, memory: F64, sample: F64, dt: float, reference: F64, measured: F64, learned: F64,
    out: F64,
) -> float:  # fmt: skip
    """Filter step, then the PD law with its estimate known; `memory` (MEMORY + FILTER,) in place."""
    known = learned.copy()
    observe(constants[-1, 0], memory[MEMORY:], sample, measured[6:10], dt)
    feed_forward(memory[MEMORY:], known)
    return pid_step(constants, memory[0:MEMORY], dt, reference, measured, known, out)
