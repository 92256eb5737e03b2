"""A certifier whose region may become faster with each certificate: how Algorithm 1 grows it.

It begins with the region's distances and moderate speeds.  Once that has been certified for `identify_s`, every
certificate that reaches the speed allowed so far allows `factor` times as much for the next, up to `most_mps`; the
distances stay the region's.  (To ask for every speed at once would also ask what is known at speeds that nothing was
ever learned at.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from flightstack.barrier.certifier import OnlineCertifier
from flightstack.barrier.certifier_config import CertifierConfig, CertifierState, Elsewhere, Thrust
from flightstack.barrier.design import SafeSet, safe_sets
from flightstack.barrier.estimate_bounds import EstimateBounds
from flightstack.barrier.initial import InitialKnowledge
from flightstack.barrier.records import Certificate
from flightstack.learning.learner import LearnerState
from flightstack.model import Limits, Model
from flightstack.region import Region
from flightstack.types import Filtered, Learned, Measurement

VERTICAL = CertifierConfig(axes=(2,), thrusts=(Thrust(0.6, math.inf, 1.4), Thrust(0.6, 1.4, 1.4)))
"""The vertical axis alone, while it is explored: thrust across as far as the identification leans."""
_GAMMA_SHARE = 0.75
"""Of the speed over the distance of what was asked for: where a large region is slow, h may change slowly only, and
what the estimate is off by costs the less."""
_DOUBTS_ACROSS = 3.5
"""Speed across as a multiple of what the estimate is known to: in a hover the vehicle follows what its estimate is off
by, so that both are off by about as much."""
_LESS = Thrust(0.75, 1.25, 0.8)
"""Where the estimate is poor: less thrust and less lean are known sooner, and to less."""
SETTLED_NEED_MPS2, SETTLED_ACROSS_MPS = 0.3, 0.35
"""The same of what comes of it: little thrust across, little speed."""


@dataclass(frozen=True, slots=True)
class GrowthConfig:
    """How it grows."""

    identify_s: float = 4.5
    """The first certificate stands for so long: the identification hover."""
    factor: float = 1.3
    reached: float = 0.85
    """Share of the speed allowed at which it counts as reached."""
    first_mps: float = 1.4
    """Speed that the first certificate may reach, where the region's own is less: in a slow region the doubt about the
    estimated speed is a large share of h, and nothing is left to certify."""
    most_mps: float = 3.0
    across_mps: float = 0.55
    """Speed along an axis that is not certified, up to which the bounds of the others are asked for: the identification
    and the doubt about it."""


def vertical_for(estimate: EstimateBounds) -> CertifierConfig:
    """The vertical axis alone while a path is flown, with estimates as good as these."""
    poor = _DOUBTS_ACROSS * max(estimate.vel_mps) > GrowthConfig().across_mps
    return replace(VERTICAL, estimate=estimate, thrusts=(_LESS, *VERTICAL.thrusts) if poor else VERTICAL.thrusts)


@dataclass(slots=True)
class GrowthState:
    """What it remembers; changed in place."""

    inner: CertifierState
    certifier: OnlineCertifier
    first_us: int = -1
    """When the first certificate came."""


class GrowingCertifier:
    """The certifier of one believed vehicle and a region that grows; holds only constants."""

    __slots__ = ("_first", "config")
    enabled = True

    def __init__(
        self, model: Model, limits: Limits, region: Region, *, initial: InitialKnowledge | None = None,
        certifier: CertifierConfig | None = None, config: GrowthConfig | None = None,
        elsewhere: Elsewhere | None = None,
    ) -> None:  # fmt: skip
        inner = certifier or CertifierConfig()
        slowest = min(region.semi_axes_mps[axis] / region.semi_axes_m[axis] for axis in inner.axes)
        inner = replace(inner, gamma_ps=min(inner.gamma_ps, _GAMMA_SHARE * slowest))
        self.config = config or GrowthConfig()
        across = [max(self.config.across_mps, _DOUBTS_ACROSS * doubt_mps) for doubt_mps in inner.estimate.vel_mps]
        safe = {axis: SafeSet(region.semi_axes_m[axis], across[axis]) for axis in range(3)}
        for axis, each in safe_sets(region, inner.axes).items():
            safe[axis] = replace(each, limit_mps=max(each.limit_mps or 0.0, self.config.first_mps))
        self._first = OnlineCertifier(
            model, limits, region, initial=initial, config=inner, safe=safe, elsewhere=elsewhere
        )

    @staticmethod
    def settled(certifier: OnlineCertifier) -> OnlineCertifier:
        """The same for what is flown afterwards: less lean and less speed along the axes that are not certified."""
        doubt_mps, config = certifier.config.estimate.vel_mps, certifier.config
        safe = {
            i: each
            if i in config.axes
            else replace(each, limit_mps=max(SETTLED_ACROSS_MPS, _DOUBTS_ACROSS * doubt_mps[i]))
            for i, each in certifier.safe.items()
        }
        thrusts = tuple(each._replace(lateral_mps2=SETTLED_NEED_MPS2) for each in config.thrusts)
        return OnlineCertifier(
            certifier.model, certifier.limits, certifier.region, initial=certifier.initial,
            config=replace(config, thrusts=thrusts), safe=safe,
        )  # fmt: skip

    def init(self) -> GrowthState:
        """Nothing certified yet."""
        return GrowthState(self._first.init(), self._first)

    def step(
        self, state: GrowthState, learner: LearnerState, measurement: Measurement, learned: Learned, filtered: Filtered
    ) -> tuple[GrowthState, Certificate | None]:
        """The present certifier's step; where its region has reached what it may, the next certifier."""
        state.inner, certificate = state.certifier.step(state.inner, learner, measurement, learned, filtered)
        if certificate is not None and state.first_us < 0:
            state.first_us = measurement.t_us
        standing = state.first_us >= 0 and measurement.t_us - state.first_us >= 1e6 * self.config.identify_s
        held = state.inner.certificate
        if standing and held is not None and state.inner.work is None:
            allowed = self.allowed(state.certifier.safe, held)
            if allowed != state.certifier.safe:
                state.certifier = state.certifier.asked(allowed)
        return state, certificate

    def allowed(self, safe: dict[int, SafeSet], held: Certificate) -> dict[int, SafeSet]:
        """Each axis' safe set after a certificate: faster where that has reached the speed that it may."""
        allowed = dict(safe)
        for each in held.axes:
            limit = safe[each.axis].limit_mps
            _, _, slow, fast = each.barrier.box
            if limit is not None and max(-slow, fast) >= self.config.reached * limit:
                faster = min(self.config.factor * limit, self.config.most_mps)
                allowed[each.axis] = replace(safe[each.axis], limit_mps=faster)
        return allowed
