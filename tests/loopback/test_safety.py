"""What goes wrong in flight, end to end: the pilot takes over, the companion dies, the disk is full."""

from __future__ import annotations

import json
import math
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from flightstack.cli.flight import FlyOptions, SimulatedFlight, prepare
from flightstack.types import TickRecord
from flightstack_logs.reader import read
from flightstack_logs.writer import FlightLog
from flightstack_sim.shell import ONBOARD
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.companion import Companion, CompanionConfig
from mavlink_bridge.handshake import State
from mavlink_bridge.link import Link
from tests.branches import branching

ROOT = Path(__file__).resolve().parents[2]
HOLD = (1.0, 4.0, 3.0)
LAND = (1.0, 4.0, 6.0)


@pytest.fixture(scope="module")
def hovering(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedFlight]:
    """A hover that has been tracking for a second."""
    folder = tmp_path_factory.mktemp("hovering")
    options = FlyOptions(scenario="hover", out=folder)
    log = FlightLog.open(folder / "flight.mcap", metadata={})
    flying = SimulatedFlight(prepare(options), options, log)
    while flying.companion.phase != "track":
        flying.step()
        assert not flying.companion.done
    _advance(flying, 1.0)
    yield flying
    flying.close()
    log.close()


@pytest.fixture
def flight(hovering: SimulatedFlight, request: pytest.FixtureRequest) -> SimulatedFlight:
    branching(request)
    return hovering


def _advance(flight: SimulatedFlight, seconds: float) -> None:
    for _ in range(round(seconds * 250)):
        flight.step()


def _pilot(flight: SimulatedFlight, command: int, params: tuple[float, ...]) -> None:
    """A ground station on the same link sends a command."""
    station = Link(255, 190)
    full = (*params, *(0.0,) * (7 - len(params)))
    station.send(m.CommandLong(1, 1, command, 0, full))  # type: ignore[arg-type]
    for data in station.datagrams_to_send():
        flight.shell.server.receive(ONBOARD, data)


@pytest.mark.parametrize("mode", [HOLD, LAND])
def test_when_the_pilot_changes_the_mode_the_companion_falls_silent_and_px4_keeps_the_vehicle(
    flight: SimulatedFlight, mode: tuple[float, ...]
) -> None:
    _pilot(flight, px4.Cmd.DO_SET_MODE, mode)
    _advance(flight, 0.4)
    assert flight.companion.state is State.PILOT
    assert not flight.companion.completed
    at = flight.vehicle.plant.pos_ned_m.copy()
    _advance(flight, 8.0)
    assert not flight.companion.link.datagrams_to_send()
    assert float(np.linalg.norm(flight.vehicle.plant.pos_ned_m[:2] - at[:2])) < 0.5
    state = flight.shell.server.commander.state
    if mode == LAND:
        assert flight.vehicle.plant.on_ground
        assert not state.armed
    else:
        assert state.armed
        assert state.mode.sub == int(HOLD[2])  # never back to OFFBOARD


def test_a_pilots_kill_switch_is_respected(flight: SimulatedFlight) -> None:
    _pilot(flight, px4.Cmd.COMPONENT_ARM_DISARM, (0.0, 21196.0))
    _advance(flight, 3.0)
    assert flight.companion.state is State.PILOT
    assert not flight.shell.server.commander.state.armed
    assert flight.vehicle.plant.on_ground


def test_a_companion_that_dies_in_flight_leaves_a_vehicle_that_px4s_failsafe_lands(flight: SimulatedFlight) -> None:
    for _ in range(30 * 250):  # its last setpoint is 1 s old: PX4 returns and lands
        flight.shell.advance(4)
        if not flight.shell.server.commander.state.armed:
            break
    assert not flight.shell.server.commander.state.armed
    assert flight.vehicle.plant.on_ground
    assert float(np.abs(flight.vehicle.plant.vel_ned_mps).max()) < 0.01


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedFlight]:
    """A figure of eight at speed, 3 s into its track."""
    folder = tmp_path_factory.mktemp("turned")
    options = FlyOptions(scenario="figure8", out=folder, learning=False)
    log = FlightLog.open(folder / "flight.mcap", metadata={})
    flying = SimulatedFlight(prepare(options), options, log)
    while flying.companion.phase != "track":
        flying.step()
    _advance(flying, 3.0)
    yield flying
    flying.close()
    log.close()


@pytest.fixture
def turning(turned: SimulatedFlight, request: pytest.FixtureRequest) -> SimulatedFlight:
    branching(request)
    return turned


@pytest.fixture(scope="module")
def rolled(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedFlight]:
    """The same with a real PX4's noise, at the first moment after 2 s of it at which the vehicle turns at 1 rad/s."""
    folder, sih = tmp_path_factory.mktemp("rolled"), "px4-sihsim-quadx"
    options = FlyOptions(
        scenario="figure8", out=folder, learning=False, vehicle=sih, truth=sih, sensors="px4-sih"
    )  # fmt: skip
    log = FlightLog.open(folder / "flight.mcap", metadata={})
    flying = SimulatedFlight(prepare(options), options, log)
    while flying.companion.phase != "track":
        flying.step()
    _advance(flying, 2.0)
    end_us = flying.t_us + 8_000_000
    while float(np.linalg.norm(flying.vehicle.plant.rate_frd_radps[:2])) < 1.0:
        flying.step()
        assert flying.t_us < end_us
    yield flying
    flying.close()
    log.close()


@pytest.fixture
def rolling(rolled: SimulatedFlight, request: pytest.FixtureRequest) -> SimulatedFlight:
    branching(request)
    return rolled


@pytest.mark.parametrize(("loss_t_s", "least_rad", "most_rad"), [(1.0, 1.0, math.pi), (0.2, 0.0, math.radians(35.0))])
def test_both_dead_only_a_short_loss_time_keeps_the_vehicle_upright(
    rolling: SimulatedFlight, loss_t_s: float, least_rad: float, most_rad: float
) -> None:
    """PX4, measured: OFFBOARD ends COM_OF_LOSS_T + 0 to 0.1 s after the last setpoint; until then the rates go on.

    That is what no dead-man answers (a machine without power).  On a real PX4 figure8 tilted by 64 to 124 degrees with
    1 s and by 33 to 41 with 0.2 s, at whatever rate it was turning.
    """
    turning = rolling
    vehicle, commander = turning.vehicle, turning.shell.server.commander
    vehicle.params.set("COM_OF_LOSS_T", loss_t_s)
    speed = float(np.linalg.norm(vehicle.plant.vel_ned_mps))
    assert speed > 1.0
    start, tilt_rad = turning.t_us, 0.0
    while commander.state.mode.title == "Offboard":
        turning.shell.advance(4)
        tilt_rad = max(tilt_rad, _tilt_rad(turning))
    assert least_rad <= tilt_rad <= most_rad
    assert loss_t_s <= (turning.t_us - start) * 1e-6 <= loss_t_s + 0.104
    restarted = _restarted(turning)
    sink_mps = impact_mps = 0.0
    for _ in range(60 * 250):
        turning.step()
        if vehicle.plant.on_ground and not impact_mps:
            impact_mps = sink_mps
        sink_mps = float(vehicle.plant.vel_ned_mps[2])
        if not commander.state.armed:
            break
    assert 0.0 < impact_mps < 1.5
    assert vehicle.plant.on_ground
    assert not commander.state.armed
    _advance(turning, 10.0)  # and it stays there: nobody takes off again
    assert vehicle.plant.on_ground
    assert restarted.state is State.REFUSED
    assert "already armed" in restarted.reason


def test_last_words_alone_level_a_turning_vehicle_until_px4s_failsafe_acts(turning: SimulatedFlight) -> None:
    """The worst case: of all that was said last only one setpoint arrives, and the command to hold is lost."""
    plant, commander = turning.vehicle.plant, turning.shell.server.commander
    assert _tilt_rad(turning) > 0.1
    height_m = -float(plant.pos_ned_m[2])
    turning.companion.say_last_words("a bug")
    word, *_ = [data for data in turning.companion.link.datagrams_to_send() if _is_setpoint(data)]
    turning.shell.server.receive(ONBOARD, word)
    while commander.state.mode.title == "Offboard":
        turning.shell.advance(4)
    assert _tilt_rad(turning) < 0.03
    assert -float(plant.pos_ned_m[2]) > height_m - 0.5
    assert float(np.abs(plant.rate_frd_radps).max()) < 0.1


def test_last_words_end_in_px4s_hold(turning: SimulatedFlight) -> None:
    plant, commander = turning.vehicle.plant, turning.shell.server.commander
    turning.companion.say_last_words("a bug")
    for data in turning.companion.link.datagrams_to_send():
        turning.shell.server.receive(ONBOARD, data)
    turning.shell.advance(8)
    assert commander.state.mode.title == "Hold"
    for _ in range(6 * 250):
        turning.shell.advance(4)
        assert not plant.on_ground
    assert commander.state.mode.title == "Hold"
    assert float(np.linalg.norm(plant.vel_ned_mps)) < 0.1


def _tilt_rad(flight: SimulatedFlight) -> float:
    w, x, y, z = flight.vehicle.plant.q_ned_frd
    return float(np.arccos(np.clip(w * w - x * x - y * y + z * z, -1.0, 1.0)))


def _is_setpoint(data: bytes) -> bool:
    ear = Link(9, 9)
    ear.receive_datagram(data, 0)
    received = ear.next_event()
    return received is not None and isinstance(received.message, m.SetAttitudeTarget)


def _restarted(flight: SimulatedFlight) -> Companion:
    """A new companion on the same link, as a supervisor would start it: without --arm."""
    flight.companion = Companion(
        Link(240, 191), flight.score.prepared.stack, flight.scenario, _Deaf(), CompanionConfig()
    )
    return flight.companion


class _Deaf:
    """An observer that notes nothing."""

    def on_event(self, t_us: int, name: str, text: str, severity: str) -> None:
        pass

    def on_tick(self, record: TickRecord) -> None:
        pass

    def on_message(self, t_us: int, message: object) -> None:
        pass


def test_a_full_disk_ends_the_log_and_not_the_flight(tmp_path: Path) -> None:
    def little_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000))

    command = [sys.executable, "-m", "flightstack", "fly", "hover", "--duration", "5"]
    command += ["--out", str(tmp_path), "--json", str(tmp_path / "r.json")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, preexec_fn=little_room
    )
    assert done.returncode == 1, done.stderr
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("error: log ")
    assert "File too large" in lines[0]
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["completed"] is True  # flown to the end and landed
    assert result["log_complete"] is False
    log = read(tmp_path / "flight.mcap")
    assert not log.complete
    assert len(log.tables["/truth"]) > 10
