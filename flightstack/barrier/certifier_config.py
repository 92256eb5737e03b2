"""What a certifier is told and what it remembers: constants, state, and who may do its work beside the flight."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from flightstack.barrier.estimate_bounds import BENCH, EstimateBounds
from flightstack.barrier.falsify import Witness
from flightstack.barrier.flown import NOTHING_PLANNED, FlownPath
from flightstack.barrier.lateness import Lateness
from flightstack.barrier.margins import USUAL, Doubts
from flightstack.barrier.records import Certificate
from flightstack.barrier.search import Ratios
from flightstack.barrier.torque import GovernorTerms
from flightstack.learning.learner import LearnerState, Learnt
from flightstack.types import F64, Learned

if TYPE_CHECKING:
    from flightstack.barrier.certifier import OnlineCertifier


STEER_PS = 10.0
"""1 / T of the filter's steering.  What the model does not know moves z by T E: with 6.5 seed 16 of paper-tracking
engages 8 s later, with 14 no sooner."""


class Thrust(NamedTuple):
    """What a budget asks for.  With more thrust a region may be faster, but lag and delay cost more; what is left to
    one side is not there upwards."""

    least_hovers: float = 0.85
    most_hovers: float = math.inf
    lateral_mps2: float = 1.5
    """Acceleration to either side beyond what balances forces."""


@dataclass(frozen=True, slots=True)
class CertifierConfig:
    """Constants of a certifier."""

    axes: tuple[int, ...] = (0, 1, 2)
    gamma_ps: float = 0.5
    inside_ps: float = 20.0
    """How much steeper the class-K function is inside (`condition`), vertically."""
    inside_lateral_ps: float = 20.0
    """The same sideways.  The steeper, the faster the filter turns thrust round, which the governor's torque bounds;
    the gentler, the earlier it holds back what is flown well inside."""
    dt_s: float = 0.004
    """Longest time between two commands of a loop that is never late; of one that was, see `Lateness`."""
    delta: float = 0.05
    nodes: int = 8
    slice_only: bool = False
    """Bounds on the slice of no speed and no lean across each axis alone: the vertical experiment."""
    sensors: str = "bench"
    """Name of what the estimate comes from."""
    estimate: EstimateBounds = BENCH
    """How far it may be off, at the thrust of hover."""
    jitter_s: float = 0.002
    """By how much a message may come late, where none came later (`Lateness`); half of what the delay is known to, the
    other half is the learner's."""
    doubts: Doubts = USUAL
    attitude_p_ps: float = STEER_PS
    """The filter's steering law: 1 / T."""
    thrusts: tuple[Thrust, ...] = (Thrust(),)
    """Of the budget, one after the other in each search."""
    every_s: float = 1.0
    growth: float = 1.02
    surer: float = 0.9
    """Share of the held bounds of acceleration that are worth a certificate of the same size."""
    governor: GovernorTerms | None = None
    """What bounds torque while a certificate is in force."""
    spared_h: float = -math.inf
    """h that a first certificate must give to all that was flown of late and is planned, and another as much or no less
    than the one before it: one that gives less bends what is flown well inside."""
    planned: F64 = field(default_factory=NOTHING_PLANNED.copy, compare=False)
    """Places and speeds (n, 6) that are planned, NED from where the flight begins."""
    room_h: float = 0.05
    """h that the vehicle must have in a certificate that is taken."""


@dataclass(slots=True)
class CertifierState:
    """What a certifier remembers; changed in place by its steps."""

    origin_ned_m: F64 | None = None
    """Where the flight began: the first measurement."""
    work: Iterator[Certificate | None] | None = None
    certificate: Certificate | None = None
    area: float = 0.0
    """Of the product of the axes' regions."""
    version: int = 0
    begun_us: int = -(10**12)
    wait_s: float = 0.0
    """Until the next, from the beginning of the last; twice as long after each that came to nothing."""
    changes: float = 0.0
    widen_mps2: F64 = field(default_factory=lambda: np.zeros(3))
    witness: Witness = field(default_factory=Witness)
    falsified: str = ""
    ratios: dict[tuple[int, int], Ratios] = field(default_factory=dict)
    """Where each axis' last search with each of the thrusts ended."""
    turn: int = 0
    """Of the thrusts."""
    flown: FlownPath = field(default_factory=FlownPath)
    lateness: Lateness = field(default_factory=Lateness)


class Elsewhere(Protocol):
    """Where certificates are made beside the flight: a tick only asks whether one is there."""

    lost: str
    """Why none will come any more; empty while they may."""

    def count_anew(self) -> None:
        """Orders are numbered from 0 again, and `served` begins: a flight's log does."""
        ...

    @property
    def served(self) -> Sequence[tuple[int, int, int]]:
        """When each answer came: number of the order, ticks until it was begun, ticks from then."""
        ...

    def work(
        self, certifier: OnlineCertifier, learner: LearnerState | Learnt, learned: Learned, state: CertifierState
    ) -> Iterator[Certificate | None]:
        """As the certifier's own `work`, of what the learner knows when this is first asked."""
        ...
