"""A companion with a short hover to fly and an observer that remembers, for tests; and one that is flying already."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from fake_px4 import REST, FakePx4, exchange

from flightstack.model import Model
from flightstack.scenario import parse_scenario
from flightstack.stack import Stack
from flightstack.types import TickRecord, Tuple3
from flightstack.vehicle import parse_vehicle
from mavlink_bridge.companion import Companion, CompanionConfig
from mavlink_bridge.handshake import State
from mavlink_bridge.link import Link, Signing

ROOT = Path(__file__).resolve().parents[2]
HOVER_S = 60.0
VEHICLE = parse_vehicle((ROOT / "flightstack/data/vehicles" / "quad-x.toml").read_text(), "quad-x")
MODEL = Model.from_vehicle(VEHICLE)


@dataclass
class Notes:
    """An observer that remembers."""

    events: list[tuple[int, str, str, str]] = field(default_factory=list)
    ticks: list[TickRecord] = field(default_factory=list)

    def on_event(self, t_us: int, name: str, text: str, severity: str) -> None:
        self.events.append((t_us, name, text, severity))

    def on_tick(self, record: TickRecord) -> None:
        self.ticks.append(record)

    def on_message(self, t_us: int, message: object) -> None:
        pass

    def texts(self, name: str) -> list[str]:
        return [text for _, event, text, _ in self.events if event == name]


def build(
    *, arm: bool = True, dry_run: bool = False, duration_s: float = 1.0, signing: Signing | None = None
) -> tuple[Companion, Notes]:
    text = (ROOT / "flightstack/data/scenarios" / "hover.toml").read_text()
    scenario = parse_scenario(text, "hover").with_duration(duration_s)
    notes = Notes()
    config = CompanionConfig(arm=arm, dry_run=dry_run)
    stack = Stack(MODEL, limits=scenario.limits)
    return Companion(Link(240, 191, signing=signing), stack, scenario, notes, config), notes


class Flying(NamedTuple):
    """A flight that hovers on its track."""

    companion: Companion
    notes: Notes
    vehicle: FakePx4
    now_us: int


def flying(signing: Signing | None = None, theirs: Signing | None = None) -> Flying:
    """A companion in OFFBOARD on a vehicle that follows its reference perfectly."""
    companion, notes = build(duration_s=HOVER_S, signing=signing)
    vehicle = FakePx4(signing=theirs)

    def motion(now_us: int) -> tuple[Tuple3, Tuple3, Tuple3]:
        if companion.mission is None:
            return REST, REST, REST
        point = companion.mission.reference((now_us - companion.flight_start_us) * 1e-6)
        return tuple(point.pos_ned_m.tolist()), tuple(point.vel_ned_mps.tolist()), tuple(point.acc_ned_mps2.tolist())

    vehicle.motion = motion

    def on_track() -> bool:
        if companion.ticks:
            vehicle.landed = 2
        return companion.phase == "track"

    now = exchange(companion, vehicle, 60.0, until=on_track)
    assert companion.state is State.OFFBOARD
    return Flying(companion, notes, vehicle, now)
