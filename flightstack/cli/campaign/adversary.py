"""The adversary of a search: pushes in flight, the reference's phases, when a fault begins; within what is declared.

What it does is written into the scenario file as timed events, so `fly` flies it again.  A push is a constant force on
top of the truth's, of at most the force that the scenario declares as possible (0.15 of the believed weight where it
declares nothing).
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from flightstack.cli import files
from flightstack.cli.campaign.plan import Plan, Planner, parsed
from flightstack.errors import InputError
from flightstack.scenario import Scenario
from flightstack.toml_text import toml_text
from flightstack.types import Tuple3
from flightstack.vehicle import Vehicle

_PUSHES = 2
_PER_PUSH = 5
"""Begin, duration, strength, azimuth, elevation."""
_LONGEST_S = 4.0
_SHORTEST_S = 0.1
_FORCE_WEIGHTS = 0.15


class Adversary:
    """Turns shares of the unit cube into what happens in flight."""

    dimensions = _PUSHES * _PER_PUSH + 3 + 1

    def __init__(self, planner: Planner) -> None:
        self._planner = planner

    def against(self, plan: Plan, shares: Sequence[float]) -> Plan:
        """The plan with the adversary in it; as it was where it is no flight anyway."""
        try:
            scenario = parsed(plan)
            believed, _ = files.load_vehicle(_text(plan.values.get("fly.vehicle")))
            truth = scenario.truth_vehicle(believed)
        except InputError:
            return plan
        data = tomllib.loads(plan.text)
        told: dict[str, Any] = {}
        events, told["adversary.pushes"] = _events(scenario, believed, truth, shares[: _PUSHES * _PER_PUSH])
        data["events"] = [*data.get("events", []), *events]
        phases = shares[_PUSHES * _PER_PUSH : _PUSHES * _PER_PUSH + 3]
        trajectory = dict(data.get("trajectory", {}))
        if trajectory.get("kind") == "sinusoid":
            told["adversary.phase_rad"] = [2.0 * math.pi * share for share in phases]
            data["trajectory"] = trajectory | {"phase_rad": [_wrapped(p) for p in told["adversary.phase_rad"]]}
        fault = data.get("flight", {}).get("fault", "none")
        if fault != "none" and "@" not in fault and "," not in fault:
            told["adversary.fault_s"] = round(shares[-1] * scenario.duration_s, 3)
            data["flight"] = data["flight"] | {"fault": f"{fault}@{told['adversary.fault_s']:g}"}
        data.pop("checks", None)
        return replace(plan, text=toml_text(data), values={**plan.values, **told})


def _text(value: Any) -> str | None:
    return None if value in (None, "none") else str(value)


def _wrapped(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)


def _events(
    scenario: Scenario, believed: Vehicle, truth: Vehicle, shares: Sequence[float]
) -> tuple[list[dict[str, Any]], list[list[float]]]:
    """Timed constant forces, and what they are: begin s, duration s, north, east, down N."""
    declared = _FORCE_WEIGHTS if scenario.knowledge is None else scenario.knowledge.force_weights
    most_n = declared * believed.weight_n
    base = {key: truth.effects.get("constant_force", {}).get(key, 0.0) for key in ("north_n", "east_n", "down_n")}
    pushes = sorted(
        _push(shares[k * _PER_PUSH : (k + 1) * _PER_PUSH], scenario.duration_s, most_n) for k in range(_PUSHES)
    )
    events = []
    for k, (begin_s, duration_s, *force) in enumerate(pushes):
        end_s = begin_s + duration_s
        if k + 1 < len(pushes):
            end_s = min(end_s, pushes[k + 1][0])
        inside = _within(
            (base["north_n"] + force[0], base["east_n"] + force[1], base["down_n"] + force[2]), most_n, base
        )
        events.append({"time_s": begin_s, "effect": "constant_force", "values": inside})
        events.append({"time_s": end_s, "effect": "constant_force", "values": base})
    return events, [list(push) for push in pushes]


def _push(shares: Sequence[float], duration_s: float, most_n: float) -> tuple[float, float, float, float, float]:
    begin, lasts, strength, turn, upward = shares
    begin_s = begin * duration_s
    lasts_s = _SHORTEST_S * (_LONGEST_S / _SHORTEST_S) ** lasts
    azimuth, up = 2.0 * math.pi * turn, 2.0 * upward - 1.0
    flat = math.sqrt(1.0 - up * up)
    strength_n = most_n * strength
    return (
        begin_s, lasts_s, strength_n * flat * math.cos(azimuth), strength_n * flat * math.sin(azimuth),
        -strength_n * up,
    )  # fmt: skip


def _within(force: Tuple3, most_n: float, base: dict[str, float]) -> dict[str, float]:
    """The whole force, shortened to what is declared; what the truth has beyond that stays."""
    most_n = max(most_n, math.hypot(*base.values()))
    length = math.hypot(*force)
    scale = min(1.0, most_n / length) if length > 0.0 else 1.0
    return dict(zip(base, (scale * part for part in force), strict=True))
