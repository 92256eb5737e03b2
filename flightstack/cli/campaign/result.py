"""What came of a campaign: `flightstack.campaign-result/1`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from flightstack.cli.campaign.grouped import grouped
from flightstack.cli.campaign.outcomes import CRASHED, FAILED, OUTCOMES, TIMED_OUT
from flightstack.cli.campaign.spec import CampaignSpec
from flightstack.cli.campaign.statistics import Entry, Influence, clopper_pearson, influences, worst
from flightstack.cli.verdict import LEFT, NONE, OFF

WORST_BY = (("tracking.rmse_m", True), ("barrier.min_h_truth", False))
"""Field of fly's JSON, and whether the greatest is the worst."""
SHOWN_WORST = 5
KEPT_WORST = 3


def replay_name(flight: int) -> str:
    """Where a flight's scenario file lies, from the campaign's folder."""
    return f"replays/{flight:06d}.toml"


def worst_by(spec: CampaignSpec) -> list[tuple[str, bool]]:
    """Fields by which the worst flights are told, that of the search first."""
    first = [] if spec.search is None else [(spec.search.target, spec.search.maximise)]
    return first + [each for each in WORST_BY if each[0] not in [name for name, _ in first]]


@dataclass(slots=True)
class CampaignResult:
    """The figures of all flights."""

    spec: CampaignSpec
    entries: list[Entry]
    influences: list[Influence] = field(default_factory=list)
    stopped: str = ""
    """Why not all was flown; empty where it was."""
    reflown: tuple[int, int] = (0, 0)
    """Flights that were flown again for their logs, and how many of them gave the same row."""
    search: dict[str, Any] | None = None

    @property
    def outcomes(self) -> dict[str, int]:
        """Flights by outcome."""
        counted = Counter(str(entry["outcome"]) for entry in self.entries)
        return {name: counted[name] for name in OUTCOMES}

    @property
    def rates(self) -> list[dict[str, Any]]:
        """Of each outcome, and of the protection where it was asked for."""
        flights = len(self.entries)
        counted = list(self.outcomes.items())
        verdicts = [(entry["result"] or {}).get("protection", OFF) for entry in self.entries]
        rows = [_rate(name, count, flights) for name, count in counted]
        if asked := [verdict for verdict in verdicts if verdict != OFF]:
            rows += [_rate(f"protection {name}", asked.count(name), len(asked)) for name in (LEFT, NONE)]
        return rows

    @property
    def worst(self) -> list[dict[str, Any]]:
        """The worst flights by each figure."""
        kept = {entry["flight"]: entry for entry in self.entries}
        return [
            {
                "flight": flight, "value": value, "of": name, "replay": replay_name(flight),
                "log": kept[flight]["log"], "report": kept[flight]["report"],
            }
            for name, greatest in worst_by(self.spec)
            for flight, value in worst(self.entries, name, greatest, SHOWN_WORST)
        ]  # fmt: skip

    @property
    def table(self) -> list[dict[str, Any]]:
        """What the file's [table] asks for."""
        return [] if self.spec.table is None else grouped(self.spec.table, self.entries)

    @property
    def too_many_failures(self) -> str:
        """One line where more flights went wrong than the file allows."""
        wrong = sum(self.outcomes[name] for name in (FAILED, CRASHED, TIMED_OUT))
        most = self.spec.most_failures
        return "" if most is None or wrong <= most else f"{wrong} flights went wrong, most_failures = {most}"

    def as_json(self) -> dict[str, Any]:
        """summary.json; the same whoever flew."""
        found = {
            "schema": "flightstack.campaign-result/1",
            "campaign": self.spec.path.name,
            "flights": len(self.entries),
            "outcomes": self.outcomes,
            "rates": self.rates,
            "worst": self.worst,
            "factors": [
                {"factor": each.factor, "effect": each.effect, "p_value": each.p_value, "words": each.words}
                for each in self.influences
            ],
            "reflown": {"flights": self.reflown[0], "equal": self.reflown[1]},
        }
        if self.spec.table is not None:
            found["table"] = self.table
        return found if self.search is None else found | {"search": self.search}


def extremes(spec: CampaignSpec, entries: Sequence[Entry]) -> list[int]:
    """Flights whose logs are kept because they are the worst by some figure."""
    found = [f for name, greatest in worst_by(spec) for f, _ in worst(entries, name, greatest, KEPT_WORST)]
    return sorted(set(found))


def assess(spec: CampaignSpec, entries: Sequence[Entry]) -> CampaignResult:
    """Everything that is counted."""
    return CampaignResult(spec, list(entries), influences(entries, [factor.name for factor in spec.factors]))


def _rate(of: str, count: int, flights: int) -> dict[str, Any]:
    rate = count / flights if flights else None
    return {"of": of, "count": count, "flights": flights, "rate": rate, "ci95": list(clopper_pearson(count, flights))}
