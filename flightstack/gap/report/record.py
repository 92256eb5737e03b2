"""What the page of a gap analysis shows: one frozen object that knows nothing of files, simulators or HTML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from flightstack.gap.records import (
    Across,
    ChannelResidual,
    Figures,
    Finding,
    Gap,
    IdentifiedEffect,
    Offset,
    Rejected,
    Unexplained,
)
from flightstack.types import F64


@dataclass(frozen=True, slots=True)
class Step:
    """The held-out gap when one more effect is in the model; the first is the model as it was."""

    name: str
    """Effect, or empty for the model as it was."""
    figures: Figures


@dataclass(frozen=True, slots=True)
class Shown:
    """Whether these logs could have shown an effect, and what would."""

    effect: str
    level: str
    """shown: its size here is known; weak: only if large; hidden: not in these logs."""
    words: str
    """What limits it, or how well it would be known."""
    manoeuvre: str = ""
    """What to fly, where it is not shown."""
    sizes: Mapping[str, float] = field(default_factory=dict)
    """Parameter -> smallest change that these logs would have named, inf: none."""
    share: float | None = None
    """The same for all that the file has of the effect, off by one factor; None: it has none, or it is named."""


@dataclass(frozen=True, slots=True, eq=False)
class RegimeRow:
    """Rms of the disagreement in one regime, before and after; NaN where the log has none of it."""

    regime: str
    seconds: float
    before: F64
    """(6,) in the order of gap.records.SIGNALS."""
    after: F64
    """(6,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One flight over time: measured and simulated, both through the same low-pass."""

    name: str
    t_s: F64
    """(n,) since the flight began."""
    measured: F64
    """(n, 6) in the order of gap.records.SIGNALS, NaN where not usable."""
    before: F64
    """(n, 6) simulated with the model as it was."""
    after: F64
    """(n, 6) simulated with the corrected model."""
    noise: F64
    """(6,) expected standard deviation from the sensors alone."""
    held_out_s: tuple[tuple[float, float], ...]
    """Spans that were kept for the verdict."""


@dataclass(frozen=True, slots=True, eq=False)
class LogQuality:
    """One log as the data check saw it."""

    name: str
    kind: str
    seconds: float
    """Of it used; 0 where refused."""
    findings: tuple[Finding, ...]
    offsets: tuple[Offset, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class GapReport:
    """Everything the page shows."""

    sentence: str
    vehicle: str
    gap: Gap
    found: tuple[IdentifiedEffect, ...]
    rejected: tuple[Rejected, ...]
    unexplained: Unexplained
    where: tuple[ChannelResidual, ...]
    steps: tuple[Step, ...] = ()
    regimes: tuple[RegimeRow, ...] = ()
    shown: tuple[Shown, ...] = ()
    traces: tuple[Trace, ...] = ()
    logs: tuple[LogQuality, ...] = ()
    checks: tuple[tuple[str, str], ...] = ()
    """What else was verified: name and finding in words."""
    takes: tuple[str, ...] = ()
    """Numbers of the companion's model that the correction changes, in words."""
    across: tuple[Across, ...] = ()
    """Of several flights: what each says alone of what was named, or taken back for it."""
    learner: tuple[str, ...] = ()
    """Effects that the companion's model can't express: its learner has to take them."""
    untold: str = ""
    """A level force that no log of this kind tells from its autopilot's own estimates, in words; else empty."""
