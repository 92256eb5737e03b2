"""A vehicle that is exactly what the filter's model says, integrated in steps of 0.5 ms, and certificates by hand."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from measured import measured

from flightstack.barrier.condition import Setting
from flightstack.barrier.records import Authority, AxisCertificate, Budget, Certificate, Response
from flightstack.barrier.shapes import Barrier, Quadratic
from flightstack.frames import quat_from_rotation_vector, quat_multiply, quat_to_matrix
from flightstack.types import F64, Command, Measurement

G = 9.81
STEP_US = 500


class Plant:
    """Point mass with a lagging thrust axis and lagging rotors; commands act late."""

    def __init__(
        self, specific: float, curve: float, gain: float, push: F64, rotor_lag_s: float, rate_lag_s: float,
        delay_us: int, norm: float,
    ) -> None:  # fmt: skip
        self.specific, self.curve, self.gain, self.push = specific, curve, gain, push
        self.rotor_lag_s, self.rate_lag_s, self.delay_us = rotor_lag_s, rate_lag_s, delay_us
        self.t_us, self.pos, self.vel = 0, np.zeros(3), np.zeros(3)
        self.q, self.rate, self.norm = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), norm
        self._acting: tuple[float, F64] = (norm, np.zeros(3))
        self._queue: deque[tuple[int, float, F64]] = deque()

    def send(self, command: Command) -> None:
        self._queue.append((command.t_us + self.delay_us, command.thrust_norm, command.rate_frd_radps.copy()))

    def advance(self, to_us: int) -> None:
        while self.t_us < to_us:
            while self._queue and self._queue[0][0] <= self.t_us:
                _, norm, rate = self._queue.popleft()
                self._acting = (norm, rate)
            self._step(STEP_US * 1e-6)
            self.t_us += STEP_US

    def _step(self, dt: float) -> None:
        norm, rate = self._acting
        spin = math.exp(-dt / self.rotor_lag_s) if self.rotor_lag_s else 0.0
        turn = math.exp(-dt / self.rate_lag_s) if self.rate_lag_s else 0.0
        before = self.acceleration()
        self.norm = norm + spin * (self.norm - norm)
        after = rate + turn * (self.rate - rate)
        if self.rate.any() or after.any():
            self.q = quat_multiply(self.q, quat_from_rotation_vector(0.5 * dt * (self.rate + after)))
            self.q /= np.linalg.norm(self.q)
        self.rate = after
        now = self.acceleration()
        self.pos = self.pos + dt * self.vel + dt * dt * (before / 3.0 + now / 6.0)
        self.vel = self.vel + 0.5 * dt * (before + now)

    def acceleration(self) -> F64:
        force = self.gain * self.specific * (self.curve * self.norm**2 + (1.0 - self.curve) * self.norm)
        return np.array([0.0, 0.0, G]) + self.push - force * quat_to_matrix(self.q)[:, 2]

    def measurement(self) -> Measurement:
        return measured(self.t_us, self.pos, self.vel, self.q, self.rate, np.zeros(3), np.full(4, np.nan), 0, 0, 0)


def authority(low: float, high: float, error: float, offset: float = 0.0, gain: float = 0.0) -> Authority:
    """The same at every speed."""
    v = np.array([-20.0, 20.0])
    two = np.ones(2)
    return Authority(v, offset * two, gain * two, low * two, high * two, error * two, error * two)


def crossed(limit_m: float, mu: float, c: float, share: float = 1.0) -> Quadratic:
    """|e| <= limit with a cross term: P11 = 1 / limit^2 + c^2 / mu; `share` scales all lengths."""
    scale = 1.0 / (share * share)
    return Quadratic(0.0, 0.0, scale * (1.0 / limit_m**2 + c * c / mu), scale * c, scale * mu)


def certificate(
    axes: dict[int, tuple[Barrier, Setting, Response, Authority]], budget: Budget, *,
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0), version: int = 1,
) -> Certificate:  # fmt: skip
    """A certificate whose proof is somebody else's business."""
    rows = tuple(
        AxisCertificate(i, barrier, setting, response, reach, (), np.zeros((0, 6)))
        for i, (barrier, setting, response, reach) in axes.items()
    )
    return Certificate("sound", centre, rows, budget, 0.05, 3.0, {}, version)
