"""The dead-man's frames against the codec, pymavlink and fastcrc; its rules, one by one; its process."""

from __future__ import annotations

import math
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from companions import build
from fastcrc.crc16 import mcrf4xx
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavlink_bridge import dead_man_frames as frames
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.dead_man import GIVE_UP_NS, MS, SILENCE_NS, WATCH_NS, DeadMan, levelling_rates
from mavlink_bridge.layout import CRC_EXTRAS
from mavlink_bridge.link import Link
from mavlink_bridge.signing import STAMPS_PER_SECOND, SecretKey, Signer
from mavlink_bridge.transport import dead_man
from mavlink_bridge.transport.dead_man import DeadManProcess, DeadManWatch
from mavlink_bridge.transport.udp import LOOPBACK, UdpSocket

KEY = bytes(range(32))
NOW_NS = 1_000_000 * MS
WORD = frames.CompanionRecord(
    serial=7, sent_ns=NOW_NS, stamp_us=5_000_000, next_stamp=1000, heard_stamp=0, q_w=1.0, q_x=0.0, q_y=0.0, q_z=0.0,
    thrust_norm=0.5, thrust_factor=0.0, flags=frames.ACTIVE | frames.IN_OFFBOARD, system=1, own_system=240,
    own_component=191, sequence=250, peer_host=0, peer_port=0,
)  # fmt: skip
OFFBOARD, HOLD, POSITION, RTL = 0x00060000, 0x03040000, 0x00030000, 0x05040000


# ---------------------------------------------------------------- frames


@given(st.binary(max_size=280), st.integers(0, 255))
def test_the_checksum_is_mavlinks(data: bytes, extra: int) -> None:
    assert frames.checksum(data, extra) == mcrf4xx(data + bytes([extra]))


def test_the_crc_extras_are_the_dialects() -> None:
    for number, extra in frames.EXTRAS.items():
        known = CRC_EXTRAS.get(number, m.BY_ID[number].crc_extra if number in m.BY_ID else None)
        assert extra == known, number


def _heard(data: list[bytes], signing: Signer | None = None) -> list[object]:
    ear = Link(9, 9, signing=signing)
    for one in data:
        ear.receive_datagram(one, 0)
    return [received.message for received in ear.take_events()]


def test_setpoints_and_commands_are_what_the_codec_reads() -> None:
    rates = (0.25, -0.5, 0.0)
    setpoint = frames.build(82, (5060, 1.0, 0.0, 0.0, 0.0, *rates, 0.5, 1, 1, 128), 3, WORD)
    command = frames.build(76, (1.0, 4.0, 3.0, *(math.nan,) * 4, 176, 1, 1, 0), 4, WORD)
    ear = Link(9, 9)
    ear.receive_datagram(setpoint, 0)
    ear.receive_datagram(command, 0)
    first, second = ear.take_events()
    assert (first.system, first.component, first.seq) == (240, 191, 3)
    assert first.message == m.SetAttitudeTarget(5_060_000, 1, 1, 128, (1.0, 0.0, 0.0, 0.0), rates, 0.5)
    assert second.message.command == 176
    assert second.message.params[:3] == (1.0, 4.0, 3.0)
    assert (second.message.target_system, second.message.target_component) == (1, 1)


def _vehicle(*messages: object, system: int = 1, signing: Signer | None = None) -> list[bytes]:
    link = Link(system, 1, signing=signing)
    for message in messages:
        link.send(message)
    return link.datagrams_to_send()


def test_what_the_vehicle_says_is_read_as_the_codec_wrote_it() -> None:
    q, rates = (0.5, -0.5, 0.5, 0.5), (0.1, 0.2, 0.3)
    data = _vehicle(
        m.Heartbeat(2, 12, 0x81, OFFBOARD, 4),
        m.CurrentMode(0, HOLD, HOLD),
        m.AttitudeQuaternion(8_000, q, rates),
        m.CommandAck(176, 0, 0, 0, 240, 191),
        m.Timesync(0, 1, 1, 1),
    )
    whole = b"".join(data)
    for reader, pieces in (
        (frames.Reader(None, stream=False), data),
        (frames.Reader(None, stream=False), [whole]),
        (frames.Reader(None, stream=True), [whole[i : i + 7] for i in range(0, len(whole), 7)]),
    ):
        found = [item for piece in pieces for item in reader.read(piece, WORD)]
        assert [number for number, _ in found] == [0, 436, 31, 77]
        assert found[0][1][0] == OFFBOARD
        assert found[0][1][3] == 0x81
        assert found[1][1][0] == HOLD
        assert found[2][1][1:5] == q
        assert found[3][1][:2] == (176, 0)
        assert found[3][1][4] == 240


@given(st.lists(st.binary(max_size=60), max_size=5))
def test_whatever_arrives_is_survived_and_what_follows_is_read(noise: list[bytes]) -> None:
    for stream in (False, True):
        reader = frames.Reader(None, stream=stream)
        for data in noise:
            reader.read(data, WORD)
        for _ in range(40 if stream else 1):  # a stray length may swallow some of a stream
            found = reader.read(_vehicle(m.CurrentMode(0, HOLD, HOLD))[0], WORD)
        assert found
        assert found[-1][1][0] == HOLD


def test_other_systems_and_broken_frames_do_not_count() -> None:
    reader = frames.Reader(None, stream=False)
    (foreign,) = _vehicle(m.CurrentMode(0, HOLD, HOLD), system=2)
    (good,) = _vehicle(m.CurrentMode(0, HOLD, HOLD))
    assert not reader.read(foreign, WORD)
    assert not reader.read(good[:-1] + bytes([good[-1] ^ 1]), WORD)


# ---------------------------------------------------------------- levelling


def _tilt(rotation: Rotation) -> float:
    return float(np.arccos(np.clip(rotation.as_matrix()[2, 2], -1.0, 1.0)))


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_the_rates_turn_any_attitude_to_level_the_shortest_way(roll: float, pitch: float, yaw: float) -> None:
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    x, y, z, w = rotation.as_quat()
    p, q, cosine = levelling_rates((w, x, y, z))
    tilt = _tilt(rotation)
    assert cosine == pytest.approx(math.cos(tilt), abs=1e-9)
    assert math.hypot(p, q) == pytest.approx(min(3.0, 6.0 * tilt), abs=1e-4)
    if 0.01 < tilt < 3.1:
        dt = 0.001
        after = rotation * Rotation.from_rotvec(np.array([p, q, 0.0]) * dt)
        assert tilt - _tilt(after) == pytest.approx(math.hypot(p, q) * dt, rel=1e-3)


@pytest.mark.parametrize("q", [(math.nan,) * 4, (0.0, 3.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)])
def test_no_attitude_and_no_tilt_are_no_rotation(q: tuple[float, float, float, float]) -> None:
    assert levelling_rates(q)[:2] == (0.0, 0.0)


# ---------------------------------------------------------------- rules


def _run(
    dead_man: DeadMan, word: frames.CompanionRecord, until_ns: int, heard: dict[int, list[bytes]] | None = None
) -> list[tuple[int, object]]:
    """Steps at the times that it asks for, from the word's own time on; what was said, with its time after silence."""
    said, now_ns = [], word.sent_ns
    left = dict(heard or {})
    while now_ns <= until_ns:
        arrived = []
        for at_ns in [at for at in left if at <= now_ns] if dead_man.reading else []:
            arrived += left.pop(at_ns)
        said += [(now_ns - word.sent_ns, message) for message in _heard(dead_man.step(now_ns, word, arrived))]
        now_ns = max(dead_man.wake_ns, now_ns + 1)
    return said


def _holds(said: list[tuple[int, object]]) -> list[int]:
    return [at for at, one in said if isinstance(one, m.CommandLong) and one.command == px4.Cmd.DO_SET_MODE]


def test_nothing_is_said_while_the_companion_speaks_or_nothing_is_streamed() -> None:
    assert not _run(DeadMan(), WORD, NOW_NS + SILENCE_NS - 1)
    assert not _run(DeadMan(), WORD._replace(flags=0), NOW_NS + 100 * SILENCE_NS)


def test_silence_is_answered_by_levelling_rates_at_once_and_by_hold() -> None:
    tilted = Rotation.from_euler("ZYX", [1.0, 0.0, 0.5]).as_quat()
    word = WORD._replace(q_w=tilted[3], q_x=tilted[0], q_y=tilted[1], q_z=tilted[2], thrust_factor=0.4)
    said = _run(DeadMan(), word, NOW_NS + 2 * GIVE_UP_NS)
    at, first = said[0]
    assert SILENCE_NS <= at < SILENCE_NS + MS
    assert isinstance(first, m.SetAttitudeTarget)
    assert first.type_mask == 128
    assert first.rate_frd_radps == pytest.approx((-3.0, 0.0, 0.0), abs=1e-6)
    lifted = 0.5 / math.cos(0.5)
    assert first.thrust_norm == pytest.approx(0.4 * lifted**2 + 0.6 * lifted, rel=1e-6)
    holds = _holds(said)
    assert holds[0] <= SILENCE_NS + 20 * MS
    assert len(holds) > 5  # again and again, as nothing is heard
    told = [one for _, one in said]
    for place in (place for place, one in enumerate(told) if isinstance(one, m.CommandLong) and one.command == 176):
        attitude, rates = told[place - 2 : place]  # PX4 begins Hold by the last attitude that it was told
        assert isinstance(attitude, m.SetAttitudeTarget)
        assert isinstance(rates, m.SetAttitudeTarget)
        assert (attitude.type_mask, rates.type_mask) == (7, 128)
        assert attitude.q_ned_frd == pytest.approx((word.q_w, word.q_x, word.q_y, word.q_z), abs=1e-6)
        assert attitude.thrust_norm == rates.thrust_norm > 0.4
    assert said[-1][0] <= SILENCE_NS + GIVE_UP_NS + 10 * MS  # then PX4's own failsafe


def test_an_answer_in_offboard_brings_hold_at_once_and_hold_seen_brings_silence() -> None:
    mode = {NOW_NS + 54 * MS: _vehicle(m.CurrentMode(0, OFFBOARD, OFFBOARD))}
    mode[NOW_NS + 80 * MS] = _vehicle(m.CurrentMode(0, HOLD, HOLD))
    dead_man = DeadMan()
    said = _run(dead_man, WORD, NOW_NS + GIVE_UP_NS, mode)
    assert _holds(said) == [pytest.approx(55 * MS, abs=1.1 * MS)]
    assert said[-1][0] <= 81 * MS
    assert dead_man.record.held_ns
    assert not dead_man.record.touched
    assert dead_man.is_over(WORD)


@pytest.mark.parametrize("at_ms", [20, 52])
@pytest.mark.parametrize("mode", [HOLD, POSITION])
def test_a_mode_of_somebody_else_means_silence(at_ms: int, mode: int) -> None:
    dead_man = DeadMan()
    said = _run(dead_man, WORD, NOW_NS + GIVE_UP_NS, {NOW_NS + at_ms * MS: _vehicle(m.CurrentMode(0, mode, mode))})
    assert not _holds(said)
    assert at_ms > 50 or not said
    assert dead_man.record.touched


def test_a_disarmed_vehicle_is_left_alone() -> None:
    said = _run(DeadMan(), WORD, NOW_NS + GIVE_UP_NS, {NOW_NS: _vehicle(m.Heartbeat(2, 12, 0x01, OFFBOARD, 4))})
    assert not said


def test_without_an_answer_hold_is_only_commanded_where_offboard_had_been_seen() -> None:
    assert not _holds(_run(DeadMan(), WORD._replace(flags=frames.ACTIVE), NOW_NS + GIVE_UP_NS))


@pytest.mark.parametrize("touch", ["mode", "command"])
def test_whoever_touches_the_hold_is_remembered(touch: str) -> None:
    theirs = m.CurrentMode(0, POSITION, POSITION) if touch == "mode" else m.CommandAck(176, 0, 0, 0, 255, 190)
    heard = {
        NOW_NS + 54 * MS: _vehicle(m.CurrentMode(0, OFFBOARD, OFFBOARD)),
        NOW_NS + 80 * MS: _vehicle(m.CurrentMode(0, HOLD, HOLD)),
        NOW_NS + 200 * MS: _vehicle(theirs),
    }
    dead_man = DeadMan()
    _run(dead_man, WORD, NOW_NS + WATCH_NS, heard)
    assert dead_man.record.touched


@pytest.mark.parametrize("told", [None, RTL, OFFBOARD])
def test_who_was_frozen_too_only_asks_until_it_is_told_offboard(told: int | None) -> None:
    """A machine that was suspended: PX4's own failsafe may have acted, and what is read first is of before."""
    dead_man = DeadMan()
    dead_man.step(NOW_NS, WORD, [])
    now_ns, answer_ns = NOW_NS + 3_000 * MS, NOW_NS + 3_040 * MS  # later than it waits for otherwise
    backlog, said = _vehicle(m.Heartbeat(2, 12, 0x81, OFFBOARD, 4)), []
    while now_ns < NOW_NS + 3_200 * MS:
        heard = backlog if dead_man.reading else []
        backlog = [] if dead_man.reading else backlog
        if told is not None and now_ns >= answer_ns and dead_man.reading:
            heard, answer_ns = _vehicle(m.CurrentMode(0, told, told)), now_ns + 1_000 * MS
        said += [(now_ns, message) for message in _heard(dead_man.step(now_ns, WORD, heard))]
        now_ns = max(dead_man.wake_ns, now_ns + 1)
    before = [one for at, one in said if at < NOW_NS + 3_040 * MS]
    assert before
    assert all(isinstance(one, m.CommandLong) and one.command == px4.Cmd.REQUEST_MESSAGE for one in before)
    assert bool(_holds(said)) is (told == OFFBOARD)
    assert any(isinstance(one, m.SetAttitudeTarget) for _, one in said) is (told == OFFBOARD)


def test_a_companion_that_is_back_is_left_alone_and_answered_again_later() -> None:
    dead_man = DeadMan()
    _run(dead_man, WORD, NOW_NS + 53 * MS)
    back = WORD._replace(serial=8, sent_ns=NOW_NS + 60 * MS)
    assert not dead_man.step(NOW_NS + 60 * MS, back, [])
    assert not dead_man.reading
    assert _run(dead_man, back, back.sent_ns + 60 * MS)
    assert dead_man.record.acts == 2


@pytest.mark.parametrize(
    ("sent_ms", "flags", "stands"),
    [(0, frames.ACTIVE | frames.IN_OFFBOARD, True), (100, frames.ACTIVE | frames.IN_OFFBOARD, False),
     (100, frames.ACTIVE, True)],
    ids=["stopped on its way", "in OFFBOARD since", "taking back"],
)  # fmt: skip
def test_a_second_silence_in_its_own_hold_finds_it_untouched(sent_ms: int, flags: int, stands: bool) -> None:
    """Stopped between the stamp of its word and the word itself (one of 70 stalls on a real PX4), or in a take-back."""
    dead_man = DeadMan()
    _run(dead_man, WORD, NOW_NS + 80 * MS, {NOW_NS + 54 * MS: _vehicle(m.CurrentMode(0, OFFBOARD, OFFBOARD))})
    hold_ns = dead_man.record.hold_ns
    assert hold_ns
    back = WORD._replace(serial=8, sent_ns=NOW_NS + sent_ms * MS, flags=flags)
    now_ns = NOW_NS + 101 * MS
    dead_man.step(now_ns, back, [])
    while dead_man.record.acts < 2:
        now_ns = dead_man.wake_ns
        dead_man.step(now_ns, back, [])
    assert (dead_man.record.hold_ns == hold_ns) is stands
    dead_man.step(now_ns + MS, back, _vehicle(m.CurrentMode(0, HOLD, HOLD)))
    assert (dead_man.record.held_ns > 0) is stands
    assert bool(dead_man.record.touched) is not stands


def test_sequence_numbers_go_on_from_the_companions() -> None:
    dead_man = DeadMan()
    dead_man.step(NOW_NS + SILENCE_NS, WORD, [])
    sent = dead_man.step(NOW_NS + SILENCE_NS, WORD, []) + dead_man.step(NOW_NS + SILENCE_NS + 15 * MS, WORD, [])
    assert [data[4] for data in sent] == [(250 + i) & 0xFF for i in range(len(sent))]
    assert dead_man.record.sequence == (250 + len(sent)) & 0xFF


def test_on_the_ground_nothing_is_lifted() -> None:
    said = _run(DeadMan(), WORD._replace(thrust_norm=0.0), NOW_NS + GIVE_UP_NS)
    assert _holds(said)
    assert not any(isinstance(one, m.SetAttitudeTarget) for _, one in said)


# ---------------------------------------------------------------- signing


def test_signed_words_are_taken_by_the_vehicle_and_unsigned_modes_are_not_believed() -> None:
    stamps = 500 * STAMPS_PER_SECOND
    word = WORD._replace(next_stamp=stamps, heard_stamp=stamps - 5)
    theirs = Signer(SecretKey(KEY), lambda: stamps)
    dead_man = DeadMan(KEY)
    dead_man.step(NOW_NS + SILENCE_NS, word, [])
    sent = dead_man.step(NOW_NS + SILENCE_NS, word, _vehicle(m.CurrentMode(0, POSITION, POSITION)))
    messages = _heard(sent, signing=theirs)
    assert [type(one) for one in messages] == [m.SetAttitudeTarget, m.CommandLong]
    assert not dead_man.record.touched  # the unsigned word of another mode meant nothing
    old = Signer(SecretKey(KEY), lambda: stamps - 100)
    dead_man.step(NOW_NS + SILENCE_NS + MS, word, _vehicle(m.CurrentMode(0, POSITION, POSITION), signing=old))
    assert not dead_man.record.touched  # recorded before, replayed now
    true = Signer(SecretKey(KEY), lambda: stamps + 10)
    dead_man.step(NOW_NS + SILENCE_NS + 2 * MS, word, _vehicle(m.CurrentMode(0, POSITION, POSITION), signing=true))
    assert dead_man.record.touched


# ---------------------------------------------------------------- process


@pytest.fixture
def wire() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Our end of a link and the vehicle's."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs,
    ):
        ours.bind((LOOPBACK, 0))
        theirs.bind((LOOPBACK, 0))
        yield ours, theirs


def _word_now(theirs: socket.socket) -> frames.CompanionRecord:
    host, port = theirs.getsockname()
    return WORD._replace(
        sent_ns=time.monotonic_ns(), peer_host=int.from_bytes(socket.inet_aton(host), "big"), peer_port=port
    )


def _collect(theirs: socket.socket, seconds: float) -> list[bytes]:
    found, deadline = [], time.monotonic() + seconds
    while (left := deadline - time.monotonic()) > 0.0 and len(found) < 3:
        if select.select([theirs], [], [], left)[0]:
            found.append(theirs.recv(4096))
    return found


def test_its_process_speaks_within_milliseconds_after_silence_is_small_and_ends(
    wire: tuple[socket.socket, socket.socket],
) -> None:
    ours, theirs = wire
    with DeadManProcess(ours.fileno()) as process:
        maps = Path(f"/proc/{process.pid}/maps")
        if maps.exists():
            assert "numpy" not in maps.read_text()
            (rss,) = [line for line in Path(f"/proc/{process.pid}/status").read_text().splitlines() if "VmRSS" in line]
            assert int(rss.split()[1]) < 20_000  # kB
        assert os.getsid(process.pid) != os.getsid(0)
        process.publish(_word_now(theirs))
        messages = _heard(_collect(theirs, 5.0))
        assert [type(one) for one in messages] == [m.SetAttitudeTarget, m.CommandLong, m.SetAttitudeTarget] or (
            messages[2].command == px4.Cmd.DO_SET_MODE  # type: ignore[attr-defined]
        )
        record = process.read()
        assert record.acts == 1
        assert record.began_ns - record.silent_ns >= SILENCE_NS
        os.kill(process.pid, signal.SIGINT)  # Ctrl-C is the companion's business
        assert not process.has_ended
    assert process.has_ended


@pytest.mark.parametrize("still_ms", [0, 700])
def test_a_process_that_stands_still_is_noticed_and_one_late_look_is_not_taken_for_it(
    wire: tuple[socket.socket, socket.socket], monkeypatch: pytest.MonkeyPatch, still_ms: int
) -> None:
    """Our clock is put ahead in place of waiting; a first look after a stall of ours finds it late, too."""
    companion, _ = build()
    ours, _ = wire
    with UdpSocket.bind(LOOPBACK, 0) as transport, DeadManProcess(ours.fileno()) as process:
        watch = DeadManWatch(process, companion, transport)
        later_ms = iter([700, still_ms, still_ms])
        monkeypatch.setattr(dead_man, "monotonic_us", lambda: process.read().alive_ns // 1000 + 1000 * next(later_ms))
        for _ in range(75):
            watch.hear()
        assert watch.ended == ("the dead-man's process stands still" if still_ms else "")


def test_its_process_signs_with_the_companions_key(wire: tuple[socket.socket, socket.socket]) -> None:
    ours, theirs = wire
    stamp = 700 * STAMPS_PER_SECOND
    with DeadManProcess(ours.fileno(), Signer(SecretKey(KEY), lambda: stamp)) as process:
        command = Path(f"/proc/{process.pid}/cmdline")
        if command.exists():
            assert KEY.hex() not in command.read_bytes().hex()
        process.publish(_word_now(theirs)._replace(next_stamp=stamp))
        data = _collect(theirs, 5.0)
    assert _heard(data, signing=Signer(SecretKey(KEY), lambda: stamp))
    assert not _heard(data, signing=Signer(SecretKey(bytes(32)), lambda: stamp))


_DIES = """
import os, socket, sys, time
from mavlink_bridge import dead_man_frames as f
from mavlink_bridge.transport.dead_man import DeadManProcess
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("127.0.0.1", 0))
p = DeadManProcess(s.fileno()).__enter__()
peer = (0x7F000001, int(sys.argv[1]))
p.publish(f.CompanionRecord(1, time.monotonic_ns(), 0, 0, 0, 1., 0., 0., 0., .5, 0., 3, 1, 240, 191, 0, *peer))
print(p.pid, flush=True)
os.kill(os.getpid(), 9)
"""


def test_its_process_outlives_a_killed_companion_answers_and_then_ends(
    wire: tuple[socket.socket, socket.socket],
) -> None:
    _, theirs = wire
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", _DIES, str(theirs.getsockname()[1])]
    killed = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert _heard(_collect(theirs, 5.0))
    deadline = time.monotonic() + 10.0
    while _is_alive(int(killed.stdout)) and time.monotonic() < deadline:
        select.select([], [], [], 0.02)
    assert not _is_alive(int(killed.stdout))


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    return not state.exists() or state.read_text().rpartition(")")[2].split()[0] != "Z"
