"""What is looked at before a flight: the vehicle file against PX4's parameters, and a dry run's checklist."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from flightstack.airframe import contradictions, unsettled_hover
from flightstack.cli.estimate_gate import EstimateGate
from flightstack.cli.preparation import Prepared
from flightstack.mission import Mission
from flightstack.types import TickRecord
from mavlink_bridge.checklist import Inspection, checklist
from mavlink_bridge.companion import Companion, CompanionConfig
from mavlink_bridge.handshake import State
from mavlink_bridge.hover_check import HoverCheck, RiseCheck
from mavlink_bridge.vehicle_params import loss_time_problem

_INSPECTION_S = 2.0
"""A dry run counts the streams for so long after all else has been found."""
_MEND = "; mend the vehicle file, or fly it as it is with --believe-file"


class Inspector:
    """Judges one vehicle; a planner, so that the first hover can be judged too."""

    def __init__(self, prepared: Prepared, *, believe_file: bool, dry_run: bool, dead_man: bool = True) -> None:
        self._believed, self._stack, self._dead_man = prepared.believed, prepared.stack, dead_man
        self._believe_file, self._dry_run = believe_file, dry_run
        self._companion: Companion | None = None
        self._hover: HoverCheck | None = None
        self._rise: RiseCheck | None = None
        self._counted: tuple[int, Counter[type]] | None = None
        self._rates_hz: dict[type, float] = {}
        self._protection = prepared.protection
        self.gate: EstimateGate | None = None
        """What the vehicle says against the sensors that certificates count on."""

    @property
    def lasts_s(self) -> float:
        """How long the streams are to be counted, seconds."""
        return _INSPECTION_S if self._dry_run else 0.0

    def attach(self, companion: Companion) -> None:
        """The companion whose vehicle is judged."""
        self._companion, self._rise = companion, RiseCheck(companion.stop)
        if not self._believe_file:
            self._hover = HoverCheck(self._stack.model, companion.view, companion.stop)

    def contradictions(self, values: Mapping[str, float]) -> list[str]:
        """What PX4's parameters say against the file, one line each; nothing where the file is to be believed."""
        return [] if self._believe_file else contradictions(values, self._believed, self._stack.model.hover_norm)

    def step(self, mission: Mission, t_s: float, record: TickRecord) -> Mission:
        """See Planner."""
        for check in (self._hover, self._rise):  # what the file has to do with it is told first
            if check is not None:
                check.step(mission, t_s, record)
        return mission

    def count(self, now_us: int) -> None:
        """Measure the streams' rates since the first call, at local time `now_us`."""
        assert self._companion is not None
        counts = self._companion.view.counts
        if self._counted is None:
            self._counted = now_us, counts.copy()
        elif (seconds := 1e-6 * (now_us - self._counted[0])) > 0.0:
            self._rates_hz = {kind: count / seconds for kind, count in (counts - self._counted[1]).items()}

    @property
    def found(self) -> list[str]:
        """Every contradiction that ended or would have prevented the flight."""
        companion = self._companion
        assert companion is not None
        if self._hover is not None and self._hover.contradiction:
            return [f"{self._hover.contradiction}{_MEND}"]
        judged = self._dry_run or companion.state is State.REFUSED
        if not judged:
            return []
        values = companion.view.params.values
        alone = companion.view.params.settled and not self._dead_man
        needed = loss_time_problem(values, dead_man=False) if alone else ""
        return [*([needed] if needed else []), *(f"{line}{_MEND}" for line in self.contradictions(values))]

    def checklist(self, config: CompanionConfig) -> list[dict[str, Any]]:
        """A dry run's `checklist`."""
        companion, model = self._companion, self._stack.model
        assert companion is not None
        values = companion.view.params.values
        found = Inspection(
            rates_hz=self._rates_hz,
            contradictions=self.contradictions(values),
            unsettled=unsettled_hover(values, model.hover_norm),
            reason=companion.reason,
            unprotected=self._protection.unattainable or (self.gate.look() if self.gate is not None else ""),
            protection=self._protection.words if self._protection.asked else "",
        )
        return [check._asdict() for check in checklist(companion.view, found, config, self._stack.limits)]
