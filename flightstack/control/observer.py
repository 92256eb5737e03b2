"""Disturbance observer: measured less modelled specific force, low-passed, is what the model does not explain.

The learner's own `flightstack.learning.sampler` gives the difference in body axes, at the thrust that acted: what was
sent, delayed by the identified latency and by the rotors' lag.  Turned into NED it passes a second-order Butterworth
low-pass, whose state holds its time derivative too, so that both can be fed forward.  Filtering the difference is the
same as filtering both sides alike: the synchronised filters that incremental control needs.
Source: W.-H. Chen, J. Yang, L. Guo, S. Li, "Disturbance-Observer-Based Control and Related Methods", 2016.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flightstack.frames import quat_to_matrix
from flightstack.jit import njit
from flightstack.learning.sampler import S_APPLIED, S_DELAY, S_LATENCY, S_OK, S_TARGET_FRD, SAMPLE, Sampler
from flightstack.model import Model
from flightstack.rows import L_APPLIED, L_DELAY, L_FED, L_LATENCY, L_STAGE
from flightstack.types import F64, Command, FlatOutput, Learned, Measurement

FILTER = 7
"""Numbers of the low-pass: estimate (3) m/s^2 and its rate (3) m/s^3, NED, and whether it has begun."""
_BEGUN = 6
_MAX_MPS2 = 8.0
_MAX_MPS3 = 40.0
_DAMPING = math.sqrt(0.5)


@dataclass(frozen=True, slots=True)
class ObserverGains:
    """The observer's only number."""

    cutoff_radps: float = 8.0
    """Of the low-pass: faster follows sooner and passes more of the accelerometer's noise."""


@njit
def observe(cutoff: float, state: F64, sample: F64, q: F64, dt: float) -> None:
    """One step of the low-pass by the implicit Euler rule, stable for every cut-off; `state` (FILTER,) in place.

    `sample` (SAMPLE,) of the sampler; one that is not fit changes nothing.
    """
    if sample[S_OK] == 0.0:
        return
    r = quat_to_matrix(q)
    step = cutoff * dt
    for i in range(3):
        raw = 0.0
        for k in range(3):
            raw += r[i, k] * sample[S_TARGET_FRD + k]
        if state[_BEGUN] == 0.0:
            state[i] = raw
        pull = cutoff * step * (raw - state[i])
        state[3 + i] = (state[3 + i] + pull) / (1.0 + 2.0 * _DAMPING * step + step * step)
        state[i] += dt * state[3 + i]
    state[_BEGUN] = 1.0


@njit
def feed_forward(state: F64, learned: F64) -> None:
    """Add the estimate to what is learned: acceleration and its derivative, clipped; `learned` (33,) in place."""
    for i in range(3):
        learned[i] += min(max(state[i], -_MAX_MPS2), _MAX_MPS2)
        if abs(state[i]) < _MAX_MPS2:
            learned[3 + i] += min(max(state[3 + i], -_MAX_MPS3), _MAX_MPS3)


class ObserverState:
    """What the observer remembers; changed in place by its steps."""

    __slots__ = ("fed", "filter", "memory", "sample", "t_us")

    def __init__(self, memory: F64) -> None:
        self.memory = memory
        self.sample = np.zeros(SAMPLE)
        self.filter = np.zeros(FILTER)
        self.t_us = -1
        self.fed = 0


class DisturbanceObserver:
    """The observer as a learner: before any controller that feeds forward what is learned."""

    __slots__ = ("_cutoff", "_sampler")

    enabled = True

    def __init__(self, model: Model, gains: ObserverGains) -> None:
        self._cutoff = gains.cutoff_radps
        self._sampler = Sampler(model)

    def init(self) -> ObserverState:
        """Nothing seen yet."""
        return ObserverState(self._sampler.init())

    def step(
        self, state: ObserverState, measurement: Measurement, sent: Command, reference: FlatOutput
    ) -> tuple[ObserverState, Learned]:
        """Take in the measurement; the estimate is fed forward as it is, thrust's own error included."""
        self._sampler.step(state.memory, measurement, sent, state.sample)
        dt = min((measurement.t_us - state.t_us) * 1e-6, 0.05) if state.t_us >= 0 else 0.0
        state.t_us = measurement.t_us
        learned = Learned.nothing()
        _learn(self._cutoff, state.filter, state.sample, measurement.row, dt, learned.row)
        state.fed += int(state.sample[S_OK])
        learned.row[L_FED] = state.fed
        return state, learned


@njit
def _learn(cutoff: float, state: F64, sample: F64, measured: F64, dt: float, out: F64) -> None:
    """`observe` and write a Learned's row `out` (33,), which holds nothing learned."""
    observe(cutoff, state, sample, measured[6:10], dt)
    feed_forward(state, out)
    out[L_STAGE] = 3.0 if state[_BEGUN] != 0.0 else 0.0
    r = quat_to_matrix(measured[6:10])
    for i in range(3):
        out[9 + i] = r[0, i] * state[0] + r[1, i] * state[1] + r[2, i] * state[2]
        if sample[S_OK] != 0.0:
            out[15 + i] = sample[S_TARGET_FRD + i]
    out[L_APPLIED], out[L_LATENCY], out[L_DELAY] = sample[S_APPLIED], sample[S_LATENCY], sample[S_DELAY]
