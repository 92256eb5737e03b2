"""The tuned gains of every controller: the file's text to checked records and back (`flightstack.gains/1`).

One table per controller, its keys the fields of the records that the controller is built from; `GAINS` says which.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields
from typing import Any

from flightstack.checked import load_toml, number, only, table, words
from flightstack.control.attitude import AttitudeGains
from flightstack.control.feedback import FeedbackGains
from flightstack.control.observer import ObserverGains
from flightstack.control.pid import PidGains
from flightstack.control.px4_position import Px4Gains
from flightstack.trajectory import NominalGains
from flightstack.types import InputError

SCHEMA = "flightstack.gains/1"
_MAX = 200.0
"""No gain or cut-off of these controllers means anything beyond."""


@dataclass(frozen=True, slots=True)
class FlatnessGains:
    """The flatness controller's gains but the attitude's, as one flat table."""

    pole_xy_radps: float = NominalGains().pole_radps[0]
    pole_z_radps: float = NominalGains().pole_radps[2]
    thrust_p_ps2: float = FeedbackGains().thrust_p_ps2
    thrust_d_ps: float = FeedbackGains().thrust_d_ps
    position_rate_radpms: float = FeedbackGains().position_rate_radpms

    def with_attitude(self, attitude: AttitudeGains) -> FeedbackGains:
        """The record that the controller takes."""
        pole = (self.pole_xy_radps, self.pole_xy_radps, self.pole_z_radps)
        return FeedbackGains(
            NominalGains(pole),
            self.thrust_p_ps2,
            self.thrust_d_ps,
            attitude.attitude_p_ps,
            attitude.yaw_p_ps,
            attitude.rate_p,
            self.position_rate_radpms,
        )


Group = AttitudeGains | FlatnessGains | PidGains | ObserverGains | Px4Gains

GAINS: Mapping[str, tuple[type[Any], ...]] = {
    "flatness": (AttitudeGains, FlatnessGains),
    "pd": (AttitudeGains, PidGains),
    "pid": (AttitudeGains, PidGains),
    "indi": (AttitudeGains, PidGains, ObserverGains),
    "dob": (AttitudeGains, FlatnessGains, ObserverGains),
    "px4": (AttitudeGains, Px4Gains),
}
"""Table of the file -> the records that its keys fill."""


@dataclass(frozen=True, slots=True)
class Tuned:
    """The gains of one controller and where they come from."""

    origin: str
    """One line: procedure, date, what became of it."""
    score_m: float
    """The tuning's figure of merit."""
    groups: tuple[Group, ...]
    """One record for each type in GAINS, in its order."""


def parse_gains(text: str, source: str) -> Mapping[str, Tuned]:
    """Every controller's gains; InputError in one line names `source`, the key and what is allowed."""
    data = load_toml(text, source, SCHEMA, GAINS)
    tuned = {}
    for name, types in GAINS.items():
        if name not in data:
            raise InputError(f"{source}: the table [{name}] is missing")
        where, values = f"{source}: {name}", table(data, name, source)
        only(values, ("origin", "score_m", *(field.name for kind in types for field in fields(kind))), where)
        groups = tuple(
            kind(**{field.name: _gain(values, field.name, where) for field in fields(kind)}) for kind in types
        )
        score = number(values.get("score_m"), f"{where}.score_m", 0.0, 1e3)
        tuned[name] = Tuned(words(values.get("origin"), f"{where}.origin"), score, groups)
    return tuned


def gains_to_toml(tuned: Mapping[str, Tuned], heading: str) -> str:
    """The file's text, `heading` its first comment; `parse_gains` gives the same gains back, bit for bit."""
    lines = [f"# {line}".rstrip() for line in heading.splitlines()]
    lines.append(f'schema = "{SCHEMA}"')
    for name, entry in tuned.items():
        lines += ["", f"[{name}]", f'origin = "{entry.origin}"', f"score_m = {entry.score_m!r}"]
        for group in entry.groups:
            named = zip(fields(group), astuple(group), strict=True)
            lines += [f"{field.name} = {float(value)!r}" for field, value in named]
    return "\n".join(lines) + "\n"


def _gain(values: Mapping[str, object], key: str, where: str) -> float:
    return number(values.get(key), f"{where}.{key}", 0.0, _MAX)
