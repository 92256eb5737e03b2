"""The pytest plugin: its fixtures, what it keeps of a failed flight, and that it costs nothing where it is not used."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import mavutil

from flightstack.api import read_log
from flightstack.errors import InputError
from flightstack.testkit import Px4Sim, Rates, SteppedVehicle
from flightstack.testkit.fleet import Fleet
from flightstack.testkit.px4_sim import Px4Options
from flightstack_sim.plant import NativePlant
from tests.simulator import ENVIRONMENT
from tests.thorough import thorough

pytest_plugins = ["pytester"]
TAKEOFF, ARM = 22, 400
ACCEPTED = 0
NOT_SET = (math.nan,) * 7


def drain(client: Any) -> list[Any]:
    messages = []
    while (message := client.recv_match()) is not None:
        messages.append(message)
    return messages


def take_off(px4: Px4Sim, client: Any) -> None:
    """One thread: speak, let time run, listen."""
    px4.step(5.0)
    drain(client)
    client.mav.command_long_send(1, 1, TAKEOFF, 0, *NOT_SET)
    client.mav.command_long_send(1, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0)
    px4.step(0.1)
    acks = [m for m in drain(client) if m.get_type() == "COMMAND_ACK"]
    assert [(ack.command, ack.result) for ack in acks] == [(TAKEOFF, ACCEPTED), (ARM, ACCEPTED)]


@pytest.mark.parametrize("run", range(2))
def test_one_thread_gets_the_same_bytes_in_every_run(px4_sim: Px4Sim, run: int, memo: dict[str, bytes]) -> None:
    client = mavutil.mavlink_connection(px4_sim.address, source_system=255, source_component=190)
    take_off(px4_sim, client)
    for _ in range(10):
        px4_sim.step(1.0)
        assert {"HEARTBEAT", "LOCAL_POSITION_NED"} <= {m.get_type() for m in drain(client)}
    client.close()
    assert px4_sim.truth.pos_ned_m[2] == pytest.approx(-2.5, abs=0.1)
    said = px4_sim.recording.bytes_of()
    assert memo.setdefault("said", said) == said
    assert len(said) > 100_000


@pytest.fixture(scope="module")
def memo() -> dict[str, bytes]:
    """What the first run said."""
    return {}


def test_time_moves_only_with_step_by_so_much(px4_sim: Px4Sim) -> None:
    assert px4_sim.now_s == 0.0
    px4_sim.serve()
    assert px4_sim.now_s == 0.0
    for _ in range(10):
        px4_sim.step(0.001)  # less than a tick: they add up
    assert px4_sim.now_s == pytest.approx(0.008)
    px4_sim.step(0.002)
    assert px4_sim.now_s == pytest.approx(0.012)
    for wrong in (-1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="step takes"):
            px4_sim.step(wrong)


def test_a_connection_in_memory_moves_time_while_it_waits(px4_sim: Px4Sim) -> None:
    client = px4_sim.connect()
    assert client.recv_match(type="HOME_POSITION", blocking=True, timeout=1.0) is None
    assert px4_sim.now_s == pytest.approx(1.0, abs=0.005)
    client.mav.ping_send(0, 5, 0, 0)
    assert client.recv_match(type="PING", condition="PING.seq==5", blocking=True, timeout=1.0) is not None
    assert client.recv_match(type="HOME_POSITION", blocking=True, timeout=10.0) is not None
    assert 3.0 < px4_sim.now_s < 7.0


def test_faults_and_parameters_are_set_between_two_steps(px4_sim: Px4Sim) -> None:
    assert px4_sim.param("MIS_TAKEOFF_ALT", 4.0) == 4.0
    client = px4_sim.connect()
    take_off(px4_sim, client)
    px4_sim.step(12.0)
    assert px4_sim.truth.pos_ned_m[2] == pytest.approx(-4.0, abs=0.1)
    px4_sim.fault("low-battery:0.04")
    px4_sim.step(0.5)
    assert px4_sim.mode.title == "Hold"
    assert px4_sim.step_until(lambda: px4_sim.mode.title == "Land", timeout_s=7.0)
    for wrong in ("no-such-fault", "low-battery:7"):
        with pytest.raises(InputError):
            px4_sim.fault(wrong)
    for name, value in (("NO_SUCH", 1.0), ("MIS_TAKEOFF_ALT", math.nan), ("NO_SUCH", None)):
        with pytest.raises(InputError, match=name):
            px4_sim.param(name, value)


def test_the_log_can_be_read_while_the_flight_goes_on(px4_sim: Px4Sim) -> None:
    px4_sim.step(1.0)
    log = read_log(px4_sim.log)
    assert log.complete
    assert len(log.tables["/truth"].t_us) == 250
    px4_sim.step(1.0)
    assert len(read_log(px4_sim.log).tables["/truth"].t_us) == 500


def test_a_fleet_moves_together_and_each_vehicle_has_its_own_client(px4_fleet: Callable[[int], Fleet]) -> None:
    fleet = px4_fleet(3)
    clients = [vehicle.connect() for vehicle in fleet]
    fleet.step(2.0)
    assert [vehicle.now_s for vehicle in fleet] == [pytest.approx(2.0)] * 3
    for number, client in enumerate(clients, 1):
        known = [message for message in drain(client) if message.get_type() == "HEARTBEAT"]
        assert {message.get_srcSystem() for message in known} == {number}


def test_a_fleet_of_nobody_and_a_speed_that_is_none_are_refused(px4_fleet: Callable[[int], Fleet]) -> None:
    for n in (0, -1):
        with pytest.raises(ValueError, match="one vehicle or more"):
            px4_fleet(n)
    for speed in (-1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="speed"):
            Px4Sim(Px4Options(speed=speed))


def test_a_first_start_says_in_pytests_terminal_that_it_compiles(tmp_path: Path) -> None:
    """It took a quarter of a minute without a word: what the kit logs is shown for failed tests only."""
    (tmp_path / "conftest.py").write_text(
        "from flightstack.testkit import px4_sim\n\n\n"
        "def compiling(say, *parts):\n"
        "    say('compiling (once on a new machine)')\n"
        "    raise px4_sim.InputError('that is all')  # a vehicle is not needed\n\n\n"
        "px4_sim.ensure_compiled = compiling\n"
    )
    (tmp_path / "test_it.py").write_text("def test_it(px4_sim): ...\n")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)],
        cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "px4_sim: compiling (once on a new machine)" in done.stdout


def test_a_socket_that_nobody_reads_holds_five_seconds_of_each_vehicle_of_a_fleet(
    px4_fleet: Callable[[int], Fleet],
) -> None:
    """Sent anew every 4 ms, one second of small datagrams filled it: a test that stepped 2 s found no heartbeat."""
    fleet = px4_fleet(2)
    clients = [mavutil.mavlink_connection(vehicle.address) for vehicle in fleet]
    fleet.step(0.5)
    for client in clients:
        while client.recv_match(blocking=False) is not None:
            pass
    fleet.step(5.0)
    for client in clients:
        kinds = [message.get_type() for message in iter(lambda one=client: one.recv_match(blocking=False), None)]
        assert kinds.count("HEARTBEAT") == 5
        client.close()


FAILS = """
def test_it_fails(px4_sim):
    px4_sim.step(0.5)
    assert px4_sim.truth.pos_ned_m[2] < -1.0, "it stands on the ground"

def test_it_passes(px4_sim):
    px4_sim.step(0.1)
"""


def test_a_failed_test_keeps_its_flight_and_says_where(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(FAILS)
    result = pytester.runpytest_inprocess("--px4-flights", "flights")
    result.assert_outcomes(passed=1, failed=1)
    text = result.stdout.str()
    kept = [Path(name) for name in re.findall(r"^(?:log|report) +(\S+)$", text, re.MULTILINE)]
    assert [path.suffix for path in kept] == [".mcap", ".html"]
    assert len(read_log(kept[0]).tables["/truth"].t_us) == 125
    assert "</html>" in kept[1].read_text()
    assert sorted(path.name for path in (pytester.path / "flights").iterdir()) == ["test_it_fails"]


def test_the_vehicle_that_flies_is_an_option(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_it(px4_sim):\n    assert px4_sim.server.vehicle.plant.vehicle.name == 'iris'\n")
    pytester.runpytest_inprocess("--px4-vehicle", "iris").assert_outcomes(passed=1)
    result = pytester.runpytest_inprocess("--px4-vehicle", "no-such")
    result.assert_outcomes(errors=1)
    assert "no-such" in result.stdout.str()


def test_the_plugin_imports_nothing_heavy() -> None:
    code = (
        "import sys, pytest; before = set(sys.modules); import flightstack.testkit.plugin;"
        "print(sorted(name for name in set(sys.modules) - before if '.' not in name))"
    )
    done = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['flightstack']"


def test_a_step_is_the_plant_s_own() -> None:
    vehicle = SteppedVehicle("quad-x", seed=3)
    plant = NativePlant(vehicle._vehicle.plant.vehicle, seed=0)  # no gusts: the seed does not matter
    command = np.array([0.7, 0.7, 0.69, 0.69])
    for _ in range(50):
        truth = vehicle.step(command)
        for _ in range(4):
            plant.step(command)
    assert truth == plant.truth()
    assert vehicle.now_s == pytest.approx(0.2)
    assert vehicle.estimate.pos_ned_m == pytest.approx(truth.pos_ned_m, abs=0.05)
    with pytest.raises(ValueError, match="4 motor commands"):
        vehicle.step([0.5] * 3)


def test_body_rates_are_flown_by_px4s_rate_loop() -> None:
    vehicle = SteppedVehicle()
    for _ in range(100):
        vehicle.step(Rates((0.0, 0.0, 0.0), 0.8))
    for _ in range(100):
        truth = vehicle.step(Rates((0.0, 0.0, 0.5), 0.6))
    assert truth.pos_ned_m[2] < -0.1
    assert truth.rate_frd_radps[2] == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("degc", [thorough(40.0), -20.0])
def test_thrust_goes_with_the_airs_density_and_sensors_tell_its_temperature(
    px4_fleet: Callable[[int], Fleet], degc: float
) -> None:
    """Ideal gas: at one pressure density goes with 1 / T; a hover needs T / T0 times the thrust of one at T0."""
    commands = []
    for px4, warmed in zip(px4_fleet(2), (False, True), strict=True):
        client = px4.connect()
        if warmed:
            px4.temperature(degc)
        px4.step(5.0)
        client.mav.command_long_send(0, 1, TAKEOFF, 0, *NOT_SET)
        client.mav.command_long_send(0, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0)
        px4.step(10.0)
        assert px4.truth.pos_ned_m[2] == pytest.approx(-2.5, abs=0.1)
        commands.append(float(np.mean(px4.server.vehicle.motor_command)))
        told = {m.temperature for m in drain(client) if m.get_type() == "HIGHRES_IMU"}
        assert told == {degc if warmed else 15.0}
    factor = px4.server.vehicle.plant.vehicle.rotors.thrust_model_factor
    usual, changed = (factor * command**2 + (1.0 - factor) * command for command in commands)
    assert changed / usual == pytest.approx((degc + 273.15) / (11.82 + 273.15), rel=0.005)
    with pytest.raises(InputError, match="from -60 to 60"):
        px4.temperature(math.nan)
