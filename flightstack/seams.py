"""Where controller, learner and safety filter join the tick, and what stands there without the latter two.

All keep their state explicit and outside: `init` gives it, every call returns the next one.  A state that is handed in
is used up: what holds much (a learner's store) is changed in place.
"""

from __future__ import annotations

from typing import Any, Protocol

from flightstack.types import Command, FlatOutput, Learned, Measurement, Proposal

_NOTHING = Learned.nothing()


class Controller(Protocol):
    """Turns a measurement and a point of the reference into thrust and body rates.

    Its state is `Any` to those outside: each controller has its own.
    """

    def init(self, now_us: int) -> Any:
        """State before the first step."""
        ...

    def step(
        self, state: Any, measurement: Measurement, reference: FlatOutput, learned: Learned, sent: Command, now_us: int
    ) -> tuple[Any, Proposal]:
        """One step; `sent` is the command of the tick before, as it went to the vehicle."""
        ...

    def healthy(self, state: Any) -> bool:
        """Whether the state is fit to go on from; where it is not, the stack begins anew with `init`."""
        ...


class Learner(Protocol):
    """Learns what the model does not explain."""

    enabled: bool

    def init(self) -> Any:
        """State before the first sample."""
        ...

    def step(self, state: Any, measurement: Measurement, sent: Command, reference: FlatOutput) -> tuple[Any, Learned]:
        """Learn from a measurement and the command sent before it; predict for now."""
        ...


class SafetyFilter(Protocol):
    """Makes a command safe."""

    enabled: bool

    def init(self) -> Any:
        """State before the first command."""
        ...

    def step(
        self, state: Any, measurement: Measurement, command: Command, learned: Learned, reference: FlatOutput
    ) -> tuple[Any, Command]:
        """The safe command nearest to `command`."""
        ...


class NoLearner:
    """Nothing is learned."""

    enabled = False

    def init(self) -> object:
        """No state."""
        return None

    def step(
        self, state: object, measurement: Measurement, sent: Command, reference: FlatOutput
    ) -> tuple[object, Learned]:
        """The model as believed."""
        return state, _NOTHING


class NoFilter:
    """Every command passes."""

    enabled = False

    def init(self) -> object:
        """No state."""
        return None

    def step(
        self, state: object, measurement: Measurement, command: Command, learned: Learned, reference: FlatOutput
    ) -> tuple[object, Command]:
        """The command as it is."""
        return state, command
