"""A simulated flight whose companion may stand still or die, with the dead-man's state machine beside it, all in
simulated time: every run is the same."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import NamedTuple

from flightstack.cli.flight import FlyOptions, SimulatedFlight, prepare
from flightstack_logs.writer import FlightLog
from flightstack_sim.shell import ONBOARD
from mavlink_bridge.dead_man import DeadMan

TICK_MS = 4


class Truth(NamedTuple):
    """What the simulator knows of a moment."""

    t_us: int
    height_m: float
    tilt_deg: float
    sink_mps: float
    on_ground: bool


class GuardedFlight:
    """`step`: 4 ms of everybody; `stand_still`: 1 ms in which the companion does nothing."""

    def __init__(self, folder: Path, scenario: str, duration_s: float | None = None, *, dead_man: bool = True) -> None:
        options = FlyOptions(
            scenario=scenario,
            out=folder,
            learning=False,
            duration_s=duration_s,
            sensors="px4-sih",
            vehicle="px4-sihsim-quadx",
        )
        self.log = FlightLog.open(folder / "flight.mcap", metadata={}, overwrite=True)
        self.flight = SimulatedFlight(prepare(options), options, self.log)
        self.companion = self.flight.companion
        self.dead_man = DeadMan() if dead_man else None
        self.truths: list[Truth] = []
        self._word = self.companion.last_word(0)
        self._serial = 0
        self._waiting: list[bytes] = []
        """What has arrived and nobody has read."""
        self._acts = 0

    @property
    def mode(self) -> str:
        """The vehicle's."""
        return str(self.flight.shell.server.commander.state.mode.title)

    def begin(self, track_s: float) -> None:
        """Fly until so long after the track's beginning."""
        while self.companion.phase != "track":
            self.step()
            assert not self.companion.done, self.companion.reason
        for _ in range(round(track_s * 1e3 / TICK_MS)):
            self.step()

    def step(self) -> None:
        """4 ms of simulator, companion and dead-man."""
        for data in self._waiting:
            self.companion.receive_datagram(data, self.flight.t_us)
        self._waiting.clear()
        if self.dead_man is not None:
            report = self.dead_man.record
            if report.acts != self._acts:
                self._acts = report.acts
                self.companion.link.skip_sequence(report.sequence, self.companion.link.component)
            self.companion.hear_dead_man(report)
        self.flight.step()
        self._serial += 1
        self._word = self.companion.last_word(self.flight.t_us)._replace(serial=self._serial)
        self._let_the_dead_man_act()
        self._note()

    def stand_still(self, seconds: float) -> None:
        """Simulator and dead-man go on, the companion does not."""
        server = self.flight.shell.server
        for _ in range(round(seconds * 1e3)):
            server.advance(1)
            self._waiting += server.datagrams(ONBOARD)
            self._let_the_dead_man_act()
            self._note()

    def since(self, t_us: int) -> list[Truth]:
        """What happened after a moment."""
        return [truth for truth in self.truths if truth.t_us > t_us]

    def close(self) -> None:
        """End it."""
        self.flight.close()
        self.log.close()

    def _let_the_dead_man_act(self) -> None:
        dead_man, now_ns = self.dead_man, self.flight.t_us * 1000
        if dead_man is None or now_ns < dead_man.wake_ns:
            return
        heard = self._waiting if dead_man.reading else []
        if dead_man.reading:
            self._waiting = []
        for data in dead_man.step(now_ns, self._word, heard):
            self.flight.shell.server.receive(ONBOARD, data)

    def _note(self) -> None:
        plant = self.flight.vehicle.plant
        _, x, y, _ = plant.q_ned_frd
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y)))))
        self.truths.append(
            Truth(
                self.flight.t_us, -float(plant.pos_ned_m[2]), tilt, float(plant.vel_ned_mps[2]), bool(plant.on_ground)
            )
        )


def height_lost_m(truths: list[Truth], seconds: float = 1.0) -> float:
    """Greatest loss of height within the first seconds."""
    end_us = truths[0].t_us + seconds * 1e6
    return truths[0].height_m - min(truth.height_m for truth in truths if truth.t_us <= end_us)


def impact_mps(truths: list[Truth]) -> float:
    """Sink rate just before the first contact; 0 without one."""
    for before, truth in itertools.pairwise(truths):
        if truth.on_ground and not before.on_ground:
            return before.sink_mps
    return 0.0
