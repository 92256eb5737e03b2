"""A flight of a campaign as one scenario file: what `flightstack fly FILE` flies again, bit for bit."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from flightstack.cli import files
from flightstack.cli.campaign import keys
from flightstack.cli.campaign.spec import CampaignSpec, Factor
from flightstack.cli.campaign.task import function, task_text
from flightstack.cli.filed import FILES
from flightstack.cli.shipped import path_of
from flightstack.scenario import Scenario, parse_scenario
from flightstack.toml_text import toml_text

_TASK_S = 120.0
"""A task may take as long as a flight with such a track."""
Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Plan:
    """What a worker needs to fly one flight."""

    flight: int
    seed: int
    scenario: str
    """Its name, as fly's JSON has it."""
    values: Values
    """Of every factor."""
    text: str
    """The scenario file."""
    limit_s: float
    """Wall time that it may take."""
    kept: bool = False
    """Its log is kept whatever comes of it."""


class Planner:
    """Turns drawn values into plans; the scenarios are read once."""

    def __init__(self, spec: CampaignSpec) -> None:
        self.spec = spec
        if spec.task:
            function(spec.task)
        self._read: dict[str, tuple[Scenario, dict[str, Any]]] = {}
        for name in spec.scenarios:
            scenario, file = files.load_scenario(name)
            self._read[name] = scenario, tomllib.loads(file.text)
        self._factors = {factor.name: factor for factor in (*spec.factors, *spec.fixed)}

    @property
    def digest(self) -> str:
        """Of all that decides what the flights are: the campaign's file, the scenarios, the files that options name."""
        data = tomllib.loads(self.spec.text)
        for key in ("keep", "table", "most_failures", "timeout_s", "count"):
            data.pop(key, None)
        named = {name: self._of_file(name) for factor in self._factors.values() for name in _files_of(factor)}
        told = [data, [read for _, read in self._read.values()], named]
        return hashlib.sha256(json.dumps(told, sort_keys=True, default=str).encode()).hexdigest()[:20]

    @staticmethod
    def _of_file(name: str) -> str:
        try:
            return path_of("vehicles", name).read_text(encoding="utf-8")
        except (OSError, ValueError):
            return ""

    def plan(self, flight: int, values: Values, seed: int, events: list[dict[str, Any]] | None = None) -> Plan:
        """The plan of a flight; `events`: timed effects on top of the scenario's."""
        if self.spec.task:
            text = task_text(self.spec.task, values, seed)
            return Plan(flight, seed, self.spec.task, values, text, self.spec.limit_s(_TASK_S))
        name = str(values.get("scenario", self.spec.scenarios[0]))
        scenario, data = self._read[name]
        truth: dict[str, Any] = {}
        grade: dict[str, Any] = {}
        options: dict[str, Any] = {}
        places = {keys.VEHICLE: truth, keys.GRADE: grade, keys.OPTION: options}
        for factor_name, value in values.items():
            factor = self._factors.get(factor_name)
            if factor is not None and factor.sort in places:
                places[factor.sort][factor.key] = value
        told = dict(data)
        if truth:
            told["truth"] = {**data.get("truth", {}), "vehicle": truth}
        if grade:
            told["grade"] = grade
        if events:
            told["events"] = [*data.get("events", []), *events]
        if truth or grade or options or events:  # the checks are those of the scenario as it is written
            told.pop("checks", None)
        told["flight"] = {**data.get("flight", {}), **options, "seed": seed}
        duration_s = options.get("duration", scenario.duration_s)
        return Plan(flight, seed, scenario.name, values, toml_text(told), self.spec.limit_s(float(duration_s)))


def parsed(plan: Plan) -> Scenario:
    """The plan's scenario; InputError where its text is none."""
    return parse_scenario(plan.text, f"flight {plan.flight}")


def _files_of(factor: Factor) -> list[str]:
    return [value for value in factor.values if factor.key in FILES and isinstance(value, str) and value != "none"]
