"""What a flight's score keeps of each tick, as it came; everything is worked out of it when the flight is over."""

from __future__ import annotations

from struct import Struct
from typing import TYPE_CHECKING, Any

import numpy as np

from flightstack.cli.column import Column
from flightstack.types import F64, I64, Learned, Mask, TickRecord, Tuple3

if TYPE_CHECKING:
    from flightstack_sim.plant import Truth

_HEAD = Struct("=4d")
_STATE, _PLACE = slice(0, 6), slice(0, 3)
"""Position and velocity in a row of a measurement, position in one of a reference."""
_LEARNED = slice(Learned.residual_frd_mps2.place.start, Learned.target_frd_mps2.place.stop)
"""Residual, sigma and target in a row of what is learned."""
_SAID, _SAID_ENDS = 25, (4, 10, 13, 16)
_TRUE, _TRUE_ENDS = 20, (3, 6, 9, 12, 16)
"""Numbers of a tick, and where they part."""


class FlownTicks:
    """The ticks from take-off to the command to land."""

    def __init__(self) -> None:
        self._said, self._true = Column(_SAID), Column(_TRUE)

    def add(
        self, head: tuple[int, int, bool, int], record: TickRecord, reference: F64, disagreement_ned_mps: F64
    ) -> None:
        """What the stack knew at a tick; `head`: as the first four of `TickTable`, `reference` (17,): as followed."""
        parts: Any = (
            record.measurement.row[_STATE],
            reference[_PLACE],
            disagreement_ned_mps,
            record.learned.row[_LEARNED],
        )
        self._said.extend_bytes(b"".join((_HEAD.pack(*head), *parts)))

    def add_truth(self, place_ned_m: Tuple3, true_ned_m: Tuple3, truth: Truth) -> None:
        """What was true at it; `place_ned_m`: where it counts as having been, `true_ned_m`: where it was."""
        self._true.extend(
            (*place_ned_m, *true_ned_m, *truth.vel_ned_mps, *truth.specific_force_frd_mps2, *truth.motor_u,
             *truth.q_ned_frd)
        )  # fmt: skip

    def table(self, start_ned_m: F64) -> TickTable:
        """All of them; `start_ned_m` (3,): where the flight began, as estimated."""
        return TickTable(self._said.table(), self._true.table(), start_ned_m)


class TickTable:
    """Columns of n ticks, in their order; positions are NED from where the flight began."""

    def __init__(self, said: F64, true: F64, start_ned_m: F64) -> None:
        head, state, wanted, self.disagreement_ned_mps, learned = np.split(said, _SAID_ENDS, axis=1)
        self.t_us: F64 = head[:, 0].copy()
        self.in_force: I64 = head[:, 1].astype(np.int64)
        """(n,) how many certificates had come."""
        self.tracked: Mask = head[:, 2] > 0.0
        """(n,) whether it is one of the track."""
        self.premises: I64 = head[:, 3].astype(np.int64)
        """(n,) 0: the filter was not engaged, 1: it was, 2: and a premise was broken."""
        self.estimated_ned_m, self.followed_ned_m = state[:, :3], wanted
        """(n, 3) position and reference as they were, from the estimate's own origin."""
        self.state = np.hstack([state[:, :3] - start_ned_m, state[:, 3:]])
        """(n, 6) position and velocity as estimated."""
        self.wanted_ned_m: F64 = wanted - start_ned_m
        """(n, 3) the reference."""
        self.learned = np.split(learned, 3, axis=1)
        """(n, 3) each: expected residual, its deviation, the residual as measured; body FRD, m/s^2."""
        self.place_ned_m: F64 = self.state[:, :3]
        """(n, 3) where it counts as having been: the truth where there is one."""
        self.true_state: F64 | None = None
        """(n, 6) as `state`; None without a truth."""
        self.motion: tuple[F64, F64, F64, F64] | None = None
        """(n, 3) true specific force, (n, 4) motors, (n, 3) velocity, (n, 4) attitude; None without a truth."""
        if len(true):
            self.place_ned_m, pos, vel, force, motor_u, q = np.split(true, _TRUE_ENDS, axis=1)
            self.true_state, self.motion = np.hstack([pos, vel]), (force, motor_u, vel, q)
