"""Where the learner and the safety filter join the tick, and what stands there without them.

Both keep their state explicit and outside: `init` gives it, every call returns the next one.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from flightstack.types import F64, Command, FlatOutput, Measurement

_NOTHING = np.zeros((2, 3))


class Learner(Protocol):
    """Learns what the model does not explain."""

    enabled: bool

    def init(self) -> object:
        """State before the first sample."""
        ...

    def step(self, state: object, measurement: Measurement, sent: Command, reference: FlatOutput) -> tuple[object, F64]:
        """Learn from a measurement and the command sent before it; predict for now.

        The prediction (2, 3) is the unexplained acceleration and its time derivative, NED m/s^2 and m/s^3.
        """
        ...


class SafetyFilter(Protocol):
    """Makes a command safe."""

    enabled: bool

    def init(self) -> object:
        """State before the first command."""
        ...

    def step(
        self, state: object, measurement: Measurement, command: Command, learned: F64, reference: FlatOutput
    ) -> tuple[object, Command]:
        """The safe command nearest to `command`."""
        ...


class NoLearner:
    """Nothing is learned: zeros."""

    enabled = False

    def init(self) -> object:
        """No state."""
        return None

    def step(self, state: object, measurement: Measurement, sent: Command, reference: FlatOutput) -> tuple[object, F64]:
        """Zeros (2, 3)."""
        return state, _NOTHING


class NoFilter:
    """Every command passes."""

    enabled = False

    def init(self) -> object:
        """No state."""
        return None

    def step(
        self, state: object, measurement: Measurement, command: Command, learned: F64, reference: FlatOutput
    ) -> tuple[object, Command]:
        """The command as it is."""
        return state, command
