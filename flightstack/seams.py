"""Where controller, learner, certifier and safety filter join the tick, and what stands there without the others.

All keep their state explicit and outside: `init` gives it, every call returns the next one.  A state that is handed in
is used up: what holds much (a learner's store) is changed in place.
"""

from __future__ import annotations

from typing import Any, Protocol

from flightstack.barrier.records import Certificate
from flightstack.governor import GovernorLimits
from flightstack.types import F64, Command, Filtered, FlatOutput, Learned, Measurement, Proposal

_NOTHING = Learned.nothing()
_UNFILTERED = Filtered.nothing()


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

    def init(self, origin_ned_m: F64) -> Any:
        """State before the first command; regions are relative to the origin, (3,)."""
        ...

    def adopt(self, state: Any, certificate: Certificate) -> Any:
        """From now on keep to this certificate."""
        ...

    def governed(self, state: Any) -> GovernorLimits | None:
        """What torque and thrust are to be kept in while what is adopted is in force; None: nothing."""
        ...

    def in_force(self, state: Any) -> F64 | None:
        """The certificate that is in force, for compiled code (`barrier.packed`); None: there is none."""
        ...

    def bend(self, state: Any, setpoint: FlatOutput) -> FlatOutput:
        """The reference that the controller is to follow: one far outside the region would wind it up."""
        ...

    def step(
        self, state: Any, measurement: Measurement, command: Command, sent: Command, learned: Learned
    ) -> tuple[Any, Command, Filtered]:
        """The safe command nearest to `command`; `sent` is the command of the tick before, as it went out."""
        ...


class Certifier(Protocol):
    """Certifies in flight what has been learned."""

    enabled: bool

    def init(self) -> Any:
        """State before the first tick."""
        ...

    def step(
        self, state: Any, learner: Any, measurement: Measurement, learned: Learned, filtered: Filtered
    ) -> tuple[Any, Certificate | None]:
        """A certificate to keep to from this tick on, or None; `learner` is the learner's state, `filtered` what the
        filter said at the tick before."""
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

    def init(self, origin_ned_m: F64) -> object:
        """No state."""
        return None

    def adopt(self, state: object, certificate: Certificate) -> object:
        """Nothing keeps to it."""
        return state

    def governed(self, state: object) -> GovernorLimits | None:
        """Nothing is kept."""
        return None

    def in_force(self, state: object) -> F64 | None:
        """None."""
        return None

    def bend(self, state: object, setpoint: FlatOutput) -> FlatOutput:
        """The reference as it is."""
        return setpoint

    def step(
        self, state: object, measurement: Measurement, command: Command, sent: Command, learned: Learned
    ) -> tuple[object, Command, Filtered]:
        """The command as it is."""
        return state, command, _UNFILTERED


class NoCertifier:
    """Nothing is certified in flight."""

    enabled = False

    def init(self) -> object:
        """No state."""
        return None

    def step(
        self, state: object, learner: object, measurement: Measurement, learned: Learned, filtered: Filtered
    ) -> tuple[object, None]:
        """No certificate."""
        return state, None
