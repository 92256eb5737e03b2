"""The largest region on the ground: what a finished exploration has learned, designed with all the time it takes.

In flight a region is an ellipse about the centre inside an ellipse of allowed speeds (`search`).  Afterwards nothing
presses: every family of `design.largest`, in the strip |e| <= limit, with the bounds asked for up to several speeds
(the further a speed lies from what was flown, the wider they are), and of all that close the one with the largest area
on its worst slice.  It is the last certificate of its flight and may spend all that is left of delta (`knowledge`).
The ledger depends on the barrier, so each design is repeated until its own margins are no larger than those that it
was made with.
"""

from __future__ import annotations

import numpy as np

from flightstack.barrier.certifier import OnlineCertifier
from flightstack.barrier.condition import Setting
from flightstack.barrier.design import SafeSet, largest, worst_slice_area
from flightstack.barrier.knowledge import Knowledge
from flightstack.barrier.margins import Ledger
from flightstack.barrier.posterior import Accelerations
from flightstack.barrier.records import AxisCertificate, Certificate
from flightstack.barrier.search import GROWING, Axis
from flightstack.barrier.shapes import Quadratic
from flightstack.learning.learner import LearnerState, Learnt
from flightstack.types import F64, Learned

_SPEEDS_MPS = (1.2, 1.5, 1.8, 2.0, 2.2, 2.4, 2.7, 3.0)
FAMILIES = ("quadratic", "stopping")
"""Of regions that are tried."""
_ROUNDS = 10
_EASE, _SPARE, _BETTER = 0.75, 1.01, 1.003


def settled(
    certifier: OnlineCertifier,
    learner: LearnerState | Learnt,
    learned: Learned,
    axis: int,
    *,
    version: int,
    widen_mps2: F64,
) -> Certificate | None:
    """The largest certificate of one axis that what was learned allows; None where nothing closes."""
    best: Certificate | None = None
    most, thrust = 0.0, certifier.config.thrusts[0]
    *_, known = Accelerations.frozen_steps(learner, certifier.model)
    assert known is not None
    for speed_mps in _SPEEDS_MPS:
        limit_m = certifier.safe[axis].limit_m
        safe = {**certifier.safe, axis: SafeSet(limit_m, speed_mps)}
        asked = certifier.asked(safe)
        knowledge: Knowledge | None = None
        for piece in asked.bounds_steps(known, version, widen_mps2, thrust, last=True):
            knowledge = piece
        assert knowledge is not None
        one, needs = asked.axis_of(axis, knowledge, learned)
        for family in FAMILIES:
            found = designed(one._replace(safe=SafeSet(limit_m)), needs, family)
            area = 0.0 if found is None else worst_area(found)
            if found is not None and area > most:
                best, most = asked.certificate(knowledge, (found,)), area
    return best


def worst_area(axis: AxisCertificate) -> float:
    """Area on the worst slice, over all accelerations and commands under way, m^2/s."""
    at = axis.authority
    low, high = float(at.u_low_mps2.max()), float(at.u_high_mps2.min())
    return worst_slice_area(axis.barrier, axis.response, low, high, axis.setting.inner)


def designed(axis: Axis, needs: Ledger, family: str) -> AxisCertificate | None:
    """The largest barrier of a family whose own ledger is no larger than the one that it was made with, or None.

    Larger barriers mostly need less of it, so that a ledger that was too large is tried again at what it gave.
    """
    fast = float(axis.authority.v_mps.max())
    setting = needs.setting(Quadratic(0.0, 0.0, axis.safe.limit_m**-2, 0.2 / (axis.safe.limit_m * fast), fast**-2))
    best: AxisCertificate | None = None
    for _ in range(_ROUNDS):
        design = largest(axis.safe, setting, axis.authority, axis.response, family=family)
        if design.barrier is None or design.cover is None:
            if best is not None:
                break
            setting = _scaled(setting, setting, _EASE)  # perhaps a larger one needs less
            continue
        own, margins = needs(design.barrier)
        if all(getattr(own, part) <= getattr(setting, part) for part in GROWING):
            found = AxisCertificate(
                axis.axis, design.barrier, setting, axis.response, axis.authority, margins, design.cover.cells
            )
            if best is not None and worst_area(found) <= _BETTER * worst_area(best):
                break
            best = found
        setting = _scaled(setting, own, _SPARE)
    return best


def _scaled(setting: Setting, of: Setting, by: float) -> Setting:
    return setting._replace(**{part: by * float(np.float64(getattr(of, part))) for part in GROWING})
