"""A learner's store as a certificate takes it: kernel, noise, calibration and points, copied (`posterior`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from flightstack.barrier.confidence import Colour
from flightstack.gp import Kernel
from flightstack.learning.store import INFLATION, Evidence, Store
from flightstack.types import F64, I64

DRIFT_S = 2.0


class Drift(NamedTuple):
    """What noise wanders by, as a first-order Gauss-Markov process: in every output alike, apart from the others."""

    variance: float = 0.0
    """(m/s^2)^2; 0: none."""
    time_s: float = DRIFT_S

    def between(self, one_us: I64, other_us: I64) -> F64:
        """(M, N) covariances of windows that end at these stamps, (M,) and (N,)."""
        apart = np.abs(one_us[:, None] - other_us[None, :])
        found: F64 = self.variance * np.exp(-1e-6 / self.time_s * apart)
        return found


_STEADY = Drift()


@dataclass(frozen=True, slots=True, eq=False)
class Process:
    """A store's Gaussian process and calibration, copied."""

    kernel: Kernel
    noise_var: float
    x: F64
    """(N, D) the sampler's columns."""
    y: F64
    """(N, P) residuals, tilt axes."""
    excess: F64
    """(P,) variance that the kernel does not know, (m/s^2)^2, with the learner's inflation."""
    colour: Colour = field(default_factory=lambda: Colour.white(1))
    """Factors on the posterior standard deviation, and remainders."""
    spans_us: I64 = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    """(N, 2) stamps of the first and last sample of each point's window; none where it is not known."""
    drift: Drift = _STEADY
    """None where the stamps are not known."""
    force: Kernel | None = None
    """As `StorePrior`; what of it the data want is in the kernel (`sized_steps`)."""

    @classmethod
    def of(cls, store: Store, x: F64, y: F64) -> Process:
        """These points with the store's kernel, noise and calibration."""
        excess = INFLATION**2 * store.excess
        return cls(store.gp.kernel, store.gp.noise_var, x, y, excess, Colour.white(len(excess)))

    @classmethod
    def resting_on(cls, evidence: Evidence, chosen: I64 | None = None) -> Process:
        """As many points as a store holds, that reach as far as all of the evidence; `chosen`: which, where known."""
        chosen = evidence.chosen(evidence.capacity) if chosen is None else chosen
        x, y, spans_us = evidence.places[chosen], evidence.values[chosen], evidence.spans_us[chosen]
        excess = INFLATION**2 * evidence.excess
        return cls(
            evidence.kernel, evidence.noise_var, x, y, excess, Colour.white(len(excess)), spans_us, force=evidence.force
        )

    def as_json(self) -> dict[str, object]:
        """Plain numbers, lists and tables."""
        inflation, remainder = (np.broadcast_to(part, self.excess.shape).tolist() for part in self.colour)
        drift = {"drift": self.drift._asdict()} if self.drift.variance > 0.0 else {}
        return {
            "kernel": self.kernel.to_dict(), "noise_var": self.noise_var,
            "inflation": inflation, "remainder_mps2": remainder,
            "excess": self.excess.tolist(), "x": self.x.tolist(), "y": self.y.tolist(),
            "windows_us": self.spans_us.tolist(), **drift,
        }  # fmt: skip

    @property
    def correlations(self) -> F64:
        """(N, N) the drift's, of a variance of one, column by column."""
        return self.drift._replace(variance=1.0).between(self.spans_us[:, 1], self.spans_us[:, 1]).T

    @property
    def bytes(self) -> bytes:
        """x, then y: little-endian doubles, row by row."""
        return np.ascontiguousarray(self.x, "<f8").tobytes() + np.ascontiguousarray(self.y, "<f8").tobytes()
