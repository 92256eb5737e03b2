"""Several vehicles that move together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import overload

from flightstack.testkit.px4_sim import Px4Sim

STEP_S = 0.004


class Fleet(Sequence[Px4Sim]):
    """Vehicles with system ids 1 to n; `step` moves all of them, 4 ms of each in turn."""

    def __init__(self, vehicles: Sequence[Px4Sim]) -> None:
        self._vehicles = tuple(vehicles)

    def __len__(self) -> int:
        return len(self._vehicles)

    @overload
    def __getitem__(self, index: int) -> Px4Sim: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Px4Sim]: ...

    def __getitem__(self, index: int | slice) -> Px4Sim | Sequence[Px4Sim]:
        return self._vehicles[index]

    @property
    def now_s(self) -> float:
        """The vehicles' time since boot, s."""
        return self._vehicles[0].now_s

    def step(self, seconds: float) -> None:
        """Let the time of all run so long."""
        if not 0.0 <= seconds < math.inf:
            raise ValueError(f"step takes a time of 0 s or more, not {seconds!r}")
        left_s = seconds
        while left_s > 1e-9:
            for vehicle in self._vehicles:
                vehicle.advance(min(STEP_S, left_s))
            left_s -= STEP_S
        for vehicle in self._vehicles:
            vehicle.end_step()

    def close(self) -> None:
        """Give all ports back."""
        for vehicle in self._vehicles:
            vehicle.close()
