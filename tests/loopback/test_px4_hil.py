"""`sim --px4-hil` against a stand-in for PX4 (`hil_peer`): lockstep, sensors, motors, and what can go wrong on the way.

The stand-in flies the vehicle with another codec, another mixer and another motor curve than the simulator's: where a
rotor's place, number or turning sense differed, it would fall over.  What sensors shall read on the ground is physics:
gravity, the standard atmosphere, Earth's field.
"""

from __future__ import annotations

import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hil_peer import HOST, Peer, euler

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "PYTHONUNBUFFERED": "1"}
GIVE_UP_S = 60.0


def _free_port() -> int:
    with socket.socket() as sock:
        sock.bind((HOST, 0))
        return int(sock.getsockname()[1])


@contextmanager
def _simulator(port: int, *more: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "flightstack", "sim", "--px4-hil", "--hil-port", str(port), *more]
    with subprocess.Popen(
        command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as sim:  # fmt: skip
        try:
            assert sim.stdout is not None
            assert "waiting for PX4" in sim.stdout.readline()
            yield sim
        finally:
            sim.kill()


def _interrupt(sim: subprocess.Popen[str]) -> tuple[int, str]:
    """Ctrl-C: exit code and what was said after it."""
    sim.send_signal(signal.SIGINT)
    said, errors = sim.communicate(timeout=GIVE_UP_S)
    assert "Traceback" not in errors
    return sim.returncode, said


@pytest.fixture(scope="module")
def flown() -> tuple[Peer, dict[str, tuple[float, float, float]]]:
    """On the ground for 2 s, up to 2 m, then 2 m north, 1 m west and turned by 0.6 rad."""
    port, seen = _free_port(), {}
    with _simulator(port, "--speed", "50") as sim:
        peer = Peer(port)
        peer.fly(2.0, armed=False)
        peer.in_company = 0  # before PX4's first answer time runs freely
        peer.target = (0.0, 0.0, 2.0, 0.0)
        peer.fly(6.0, armed=True)
        seen["up"] = peer.state()
        peer.target = (2.0, -1.0, 2.0, 0.6)
        peer.fly(8.0, armed=True)
        seen["there"] = peer.state()
        peer.close()
        code, _ = _interrupt(sim)
        assert code == 130
    return peer, seen


def test_the_stand_in_flies_it_in_lockstep(flown: tuple[Peer, dict[str, tuple[float, float, float]]]) -> None:
    peer, seen = flown
    assert seen["up"] == pytest.approx((0.0, 0.0, 2.0), abs=0.2)
    assert seen["there"] == pytest.approx((2.0, -1.0, 2.0), abs=0.25)
    assert euler(peer.heard["HIL_STATE_QUATERNION"][-1].attitude_quaternion)[2] == pytest.approx(0.6, abs=0.1)
    assert peer.in_company <= 3  # of 3,500: an answer is waited for 0.25 s, which a busy machine may hold this peer up
    stamps = np.array([message.time_usec for message in peer.heard["HIL_SENSOR"]])
    assert set(np.diff(stamps)) == {4000}
    assert 0 < stamps[0] < 100_000


def test_the_sensors_come_at_their_rates_with_their_bits(flown: tuple[Peer, object]) -> None:
    """Accelerometer and gyro with every message; field 80 Hz or so, air 50 Hz, GPS at most 10 Hz, truth as asked."""
    heard = flown[0].heard
    sensors = heard["HIL_SENSOR"]
    seconds = 0.004 * len(sensors)
    fields = np.array([message.fields_updated for message in sensors])
    assert np.all(fields & 0x3F == 0x3F)
    assert set(fields & ~0x3F) <= {0, 0x1C0, 0x1A00, 0x1BC0}  # PX4 takes each group whole or not at all
    assert np.count_nonzero(fields & 0x1C0) / seconds == pytest.approx(1.0 / 0.012, rel=0.02)
    assert np.count_nonzero(fields & 0x1A00) / seconds == pytest.approx(50.0, rel=0.02)
    assert 5.0 <= len(heard["HIL_GPS"]) / seconds <= 10.2
    assert len(heard["HIL_STATE_QUATERNION"]) / seconds == pytest.approx(250.0, rel=0.02)
    assert len(heard["HEARTBEAT"]) / seconds == pytest.approx(1.0, rel=0.1)
    assert {message.id for message in sensors} == {0}
    assert heard["COMMAND_ACK"][0].result == 0


def test_on_the_ground_the_sensors_read_gravity_the_atmosphere_and_earths_field(flown: tuple[Peer, object]) -> None:
    """g 9.80665; the standard atmosphere at 489.4 m is 955.8 hPa; 0.48 gauss, 63 degrees down, at Zurich."""
    sensors = [message for message in flown[0].heard["HIL_SENSOR"] if message.time_usec < 1_900_000]
    accel = np.array([(s.xacc, s.yacc, s.zacc) for s in sensors])
    gyro = np.array([(s.xgyro, s.ygyro, s.zgyro) for s in sensors])
    assert accel.mean(axis=0) == pytest.approx((0.0, 0.0, -9.80665), abs=0.1)
    assert gyro.mean(axis=0) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    for noise in (accel.std(axis=0), gyro.std(axis=0)):
        assert np.all(noise > 1e-3)  # PX4 takes a sensor that never changes for a dead one
        assert np.all(noise < 0.5)
    pressure = np.array([s.abs_pressure for s in sensors if s.fields_updated & 0x200])
    assert pressure.mean() == pytest.approx(1013.25 * (1.0 - 489.4 / 44330.8) ** 5.25588, abs=0.1)
    assert 0.001 < pressure.std() < 0.05
    mag = np.array([(s.xmag, s.ymag, s.zmag) for s in sensors if s.fields_updated & 0x40]).mean(axis=0)
    assert float(np.linalg.norm(mag)) == pytest.approx(0.48, abs=0.02)
    assert math.degrees(math.atan2(mag[2], math.hypot(mag[0], mag[1]))) == pytest.approx(63.4, abs=1.5)


def test_gps_tells_the_place_of_px4s_own_simulator_within_its_error(flown: tuple[Peer, object]) -> None:
    fixes = flown[0].heard["HIL_GPS"]
    first = fixes[0]
    assert (first.lat * 1e-7, first.lon * 1e-7) == pytest.approx((47.397742, 8.545594), abs=1e-5)  # 1e-5 deg: 1.1 m
    assert first.alt * 1e-3 == pytest.approx(489.4, abs=2.5)
    assert all((fix.fix_type, fix.satellites_visible) == (3, 10) for fix in fixes)
    assert all(0 < fix.eph < 300 and 0 < fix.epv < 500 for fix in fixes)  # PX4 asks for 3 m and 5 m
    assert max(abs(fix.vd) for fix in fixes) < 400
    stamps = [fix.time_usec for fix in fixes]
    assert stamps == sorted(set(stamps))


def test_the_gyro_reads_the_true_rates_and_the_accelerometer_the_thrust(flown: tuple[Peer, object]) -> None:
    heard = flown[0].heard
    rates = {message.time_usec: message for message in heard["HIL_STATE_QUATERNION"]}
    pairs = [(s, rates[s.time_usec]) for s in heard["HIL_SENSOR"] if s.time_usec in rates]
    flying = [(s, t) for s, t in pairs if s.time_usec > 4_000_000]
    turn = np.array([(s.zgyro, t.yawspeed) for s, t in flying])
    assert np.abs(turn[:, 0] - turn[:, 1]).mean() < 0.05
    assert turn[:, 1].max() > 0.2  # it did turn, to the right
    assert np.mean([s.zacc for s, _ in flying]) == pytest.approx(-9.8, abs=0.3)


def test_noise_on_the_line_and_hostile_controls_are_survived_and_the_next_px4_starts_afresh() -> None:
    port = _free_port()
    with _simulator(port, "--speed", "50") as sim:
        rough = Peer(port)
        rough.fly(0.3, armed=False)
        rough.socket.sendall(bytes(range(256)) * 4 + b"\xfd\xfe" * 40 + b"GET / HTTP/1.1\r\n\r\n")
        rough.fly(0.3, armed=True, controls=lambda: [math.nan, math.inf, -math.inf, 3e38])
        rough.fly(0.3, armed=True, controls=lambda: [0.9] * 4)
        assert rough.state()[2] > 0.0
        rough.close()  # in the air
        fresh = Peer(port)
        fresh.fly(0.5, armed=False)
        assert fresh.heard["HIL_SENSOR"][0].time_usec < 100_000
        assert fresh.state()[2] == pytest.approx(0.0, abs=0.01)
        fresh.close()
        code, said = _interrupt(sim)
    assert code == 130
    assert said.count("a client has connected") == 2
    assert said.count("the client has gone") == 2


def test_a_px4_that_falls_silent_is_not_waited_for_for_ever() -> None:
    """In lockstep, then no answers: after some patience time runs on, and Ctrl-C is heard."""
    port = _free_port()
    with _simulator(port, "--speed", "50") as sim:
        peer = Peer(port)
        peer.fly(0.2, armed=False)
        count = len(peer.heard["HIL_SENSOR"])
        limit = time.monotonic() + GIVE_UP_S
        while len(peer.heard["HIL_SENSOR"]) < count + 50:
            assert time.monotonic() < limit
            peer.hear()
        code, _ = _interrupt(sim)
        peer.close()
    assert code == 130


def test_without_a_client_ctrl_c_ends_it_with_130() -> None:
    with _simulator(_free_port()) as sim:
        code, _ = _interrupt(sim)
    assert code == 130


def test_a_busy_port_and_a_fault_are_one_line_and_code_2() -> None:
    with socket.socket() as other:
        other.bind((HOST, 0))
        other.listen(1)
        port = str(other.getsockname()[1])
        for more in (["--hil-port", port], ["--hil-port", str(_free_port()), "--fault", "gcs-loss"]):
            done = subprocess.run(
                [sys.executable, "-m", "flightstack", "sim", "--px4-hil", *more],
                env=ENVIRONMENT, capture_output=True, text=True, check=False, timeout=GIVE_UP_S,
            )  # fmt: skip
            assert done.returncode == 2
            (line,) = done.stderr.strip().splitlines()
            assert line.startswith("error: ")
