"""The published search for mu, in flight: h_mu is certified anew with the learned residual while mu still falls.

As published: the margin is k sigma, mu counts as accepted where the left side of the
sampling condition is nowhere negative (`published.accepted`).  What is wrong with that is said in `published`; here it
is repeated as it was.  It begins with the region as it is, mu = 1 / b_d^2 (6.3 in the paper's scenario), unproven.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.barrier.budgets import budget
from flightstack.barrier.posterior import Accelerations
from flightstack.barrier.published import Basis, certificate, learned, least_mu, with_mu
from flightstack.barrier.records import Authority, Certificate
from flightstack.calibration import STAGES
from flightstack.learning.learner import LearnerState
from flightstack.model import Limits, Model
from flightstack.region import Region
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Filtered, Learned, Measurement, Tuple3

GAMMA_PS = 2.0
K_SIGMA = 3.0
DELTA = 0.0027
"""Of one bound of three sigma; as published it is taken for all states at once."""
TAU = 0.05
PERIOD_US = 1_000_000
LEAST_GAIN = 0.01
"""A new certificate is worth it from so large a share of mu on."""
_USED = float(STAGES.index("used"))
_SPEEDS = 41
_DOWN = 2


class PublishedCertifierState(NamedTuple):
    """What the certifier remembers."""

    mu: float
    version: int
    due_us: int


class PublishedCertifier:
    """The published certifier of one believed vehicle and region; final, holds only constants."""

    __slots__ = ("_limits", "_model", "_region")
    enabled = True

    def __init__(self, model: Model, limits: Limits, region: Region) -> None:
        self._model, self._limits, self._region = model, limits, region

    def init(self) -> PublishedCertifierState:
        """Nothing certified yet."""
        return PublishedCertifierState(self._region.semi_axes_mps[_DOWN] ** -2, 0, -1)

    def step(
        self,
        state: PublishedCertifierState,
        learner: object,
        measurement: Measurement,
        learned: Learned,
        filtered: Filtered,
    ) -> tuple[PublishedCertifierState, Certificate | None]:
        """The region as given at first; once a second, where the learner is used, the least mu that is accepted."""
        now_us = measurement.t_us
        if state.version == 0:
            state = PublishedCertifierState(state.mu, 1, now_us + PERIOD_US)
            return state, self._certificate(state, None)
        if now_us < state.due_us:
            return state, None
        state = state._replace(due_us=now_us + PERIOD_US)
        if learned.stage < _USED or not isinstance(learner, LearnerState):
            return state, None
        known = Accelerations.live(learner, self._model)
        mu = self._least(known, state.mu)
        if not mu < (1.0 - LEAST_GAIN) * state.mu:
            return state, None
        state = state._replace(mu=mu, version=state.version + 1)
        return state, self._certificate(state, known)

    def _least(self, known: Accelerations, mu: float) -> float:
        """The least accepted mu from `mu` down; infinity where not even that is accepted."""
        limit_m = self._region.semi_axes_m[_DOWN]
        farthest = 2.0 / math.sqrt(self._physical_mu(limit_m))
        speeds = np.linspace(-farthest, farthest, _SPEEDS)
        bounds = learned(lambda v, f: self._along(known, _DOWN, v, f), self._thrust_mps2, K_SIGMA, speeds)
        return least_mu(limit_m, GAMMA_PS, bounds, TAU, start=mu, tolerance=1e-4)

    def _physical_mu(self, limit_m: float) -> float:
        """A mu below which even the believed vehicle without gravity could not brake: what speeds may matter."""
        return 1.0 / (limit_m * self._thrust_mps2[1])

    @property
    def _thrust_mps2(self) -> tuple[float, float]:
        least, greatest = self._model.thrust_range_n(self._limits)
        return least / self._model.mass_kg, greatest / self._model.mass_kg

    def _along(self, known: Accelerations, axis: int, v_mps: F64, thrust_mps2: float) -> tuple[F64, F64]:
        """Mean and sigma of an axis' acceleration at speeds along it, thrust leaning as balances forces from aside.

        No mu may forget what the lean takes from the vertical; a sideways axis has thrust upright.
        """
        speed, thrust = np.zeros((2, len(v_mps), 3))
        speed[:, axis], thrust[:, _DOWN] = v_mps, thrust_mps2
        if axis == _DOWN:
            thrust[:, :2] = self._balance(known)
            across = np.hypot(thrust[:, 0], thrust[:, 1])
            thrust[:, _DOWN] = np.sqrt(np.maximum(thrust_mps2**2 - across**2, (0.1 * thrust_mps2) ** 2))
        mean, sigma, _ = known.at(axis, speed, thrust, np.zeros(len(v_mps)))
        return mean, sigma

    def _balance(self, known: Accelerations) -> F64:
        """(2,) north and east parts of the thrust vector that balance what pushes aside at rest."""
        still, none = np.zeros((2, 3)), np.zeros(2)
        upright = np.array([[0.0, 0.0, 0.8], [0.0, 0.0, 1.6]]) * STANDARD_GRAVITY_MPS2
        down = known.at(_DOWN, still, upright, none)[0]
        gain = max(float(down[0] - down[1]) / (0.8 * STANDARD_GRAVITY_MPS2), 0.2)
        return np.array([float(known.at(i, still, upright, none)[0][0]) / gain for i in (0, 1)])

    def _certificate(self, state: PublishedCertifierState, known: Accelerations | None) -> Certificate:
        region = with_mu(self._region, state.mu)
        authorities = tuple(self._authority(axis, region.semi_axes_mps, known) for axis in range(3))
        north, east, down = authorities
        box = budget(self._model, self._limits)
        basis = Basis(GAMMA_PS, K_SIGMA, DELTA, (north, east, down), box, {"mu": state.mu})
        return certificate(region, basis, state.version)

    def _authority(self, axis: int, fastest_mps: Tuple3, known: Accelerations | None) -> Authority:
        """What upright thrust does to an axis, by the learner or, before there is one, by the model."""
        v = np.linspace(-fastest_mps[axis], fastest_mps[axis], _SPEEDS)
        least, greatest = self._thrust_mps2
        ends = [self._along(known, axis, v, f) if known else self._believed(axis, v, f) for f in (greatest, least)]
        (low, low_sigma), (high, high_sigma) = ends
        gain = (high - low) / (greatest - least)
        return Authority(v, high + gain * least, gain, low, high, K_SIGMA * low_sigma, K_SIGMA * high_sigma)

    def _believed(self, axis: int, v_mps: F64, thrust_mps2: float) -> tuple[F64, F64]:
        weight = self._model.weight_n / self._model.mass_kg
        mean = weight - thrust_mps2 if axis == _DOWN else 0.0
        return np.full(len(v_mps), mean), np.zeros(len(v_mps))
