"""Signing, held against pymavlink's own: what one signs the other takes, and what one refuses so does the other."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from companions import flying
from fake_px4 import LAND, exchange

from flightstack.types import InputError
from mavlink_bridge import messages as m
from mavlink_bridge.framing import StreamFraming
from mavlink_bridge.handshake import State
from mavlink_bridge.layout import dialect
from mavlink_bridge.link import Link
from mavlink_bridge.signing import STAMPS_PER_SECOND, SecretKey, Signer, parse_key
from mavlink_bridge.transport.address import open_address
from mavlink_bridge.transport.clock import signing_stamp
from mavlink_bridge.transport.key_file import AHEAD, KeyFile, state_path
from mavlink_bridge.transport.udp import UdpSocket

KEY, OTHER = bytes(range(32)), bytes(range(1, 33))
NOW = 375_000_000 * STAMPS_PER_SECOND
"""In November 2026."""
HEARTBEAT = m.Heartbeat(2, 12, 0x81, 0x60000, 4)


def _signer(key: bytes = KEY, now: Callable[[], int] = lambda: NOW, **given: Any) -> Signer:
    return Signer(SecretKey(key), now, **given)


def _theirs(key: bytes = KEY, *, stamp: int = NOW, system: int = 1, link_id: int = 0) -> Any:
    """pymavlink's end, signing and demanding signatures."""
    end = dialect.MAVLink(None, srcSystem=system, srcComponent=1)
    end.robust_parsing = True
    end.signing.secret_key = bytearray(key)
    end.signing.sign_outgoing = True
    end.signing.timestamp = stamp
    end.signing.link_id = link_id
    return end


def _heartbeat(end: Any) -> bytes:
    return bytes(dialect.MAVLink_heartbeat_message(2, 12, 0x81, 0x60000, 4, 3).pack(end))


def _heard(end: Any, data: bytes) -> list[str]:
    """Names of what pymavlink takes from a datagram."""
    return [message.get_type() for message in end.parse_buffer(bytearray(data)) or []]


def _sent(link: Link, *messages: Any) -> list[bytes]:
    for message in messages:
        link.send(message)
    return link.datagrams_to_send()


def _received(link: Link, *datagrams: bytes) -> int:
    for data in datagrams:
        link.receive_datagram(data, 0)
    count = 0
    while link.next_event() is not None:
        count += 1
    return count


def _counts(link: Link) -> dict[str, int]:
    names = ("received", "bad_signature", "unsigned", "replayed")
    return {name: count for name, count in link.stats.as_dict().items() if name in names and count}


def test_pymavlink_takes_what_we_sign_and_refuses_another_key() -> None:
    ours = Link(240, 191, signing=_signer())
    for data, name in zip(_sent(ours, HEARTBEAT, m.Timesync(0, 5, 1, 1)), ("HEARTBEAT", "TIMESYNC"), strict=True):
        assert name not in _heard(_theirs(OTHER), data)
        assert _heard(_theirs(), data) == [name]


def test_one_receiver_of_pymavlinks_takes_a_whole_run_of_ours_once() -> None:
    ours, theirs = Link(240, 191, signing=_signer()), _theirs()
    sent = _sent(ours, *[HEARTBEAT] * 50)
    taken = sum(_heard(theirs, data) == ["HEARTBEAT"] for data in sent)
    assert taken == 50  # in one tick of the clock: stamps grow all the same
    assert sum(_heard(theirs, data) == ["HEARTBEAT"] for data in sent) == 0


def test_we_take_what_pymavlink_signs() -> None:
    link, theirs = Link(240, 191, signing=_signer()), _theirs()
    assert _received(link, *(_heartbeat(theirs) for _ in range(20))) == 20
    assert _counts(link) == {"received": 20}
    assert link.stats.signed == 20


def test_frames_of_another_key_are_dropped_and_counted() -> None:
    link = Link(240, 191, signing=_signer())
    assert _received(link, _heartbeat(_theirs(OTHER))) == 0
    data = bytearray(_heartbeat(_theirs()))
    for at in range(-13, 0):  # link id, stamp, hash: any altered byte
        altered = bytearray(data)
        altered[at] ^= 0x10
        assert _received(link, bytes(altered)) == 0
    assert _counts(link) == {"bad_signature": 14}


def test_unsigned_frames_are_dropped_and_counted() -> None:
    link = Link(240, 191, signing=_signer())
    unsigned = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    old = bytes(dialect.MAVLink_heartbeat_message(2, 12, 0x81, 0x60000, 4, 3).pack(unsigned, force_mavlink1=True))
    assert _received(link, _heartbeat(unsigned), old, *_sent(Link(1, 1), HEARTBEAT)) == 0
    assert _counts(link) == {"unsigned": 3}


def test_a_radios_own_status_is_never_signed_and_comes_in() -> None:
    link = Link(240, 191, signing=_signer())
    radio = dialect.MAVLink(None, srcSystem=51, srcComponent=68)
    data = bytes(dialect.MAVLink_radio_status_message(200, 190, 80, 40, 45, 3, 1).pack(radio))
    link.receive_datagram(data, 0)
    received = link.next_event()
    assert received is not None
    assert received.message == m.RadioStatus(200, 190, 80, 40, 45, 3, 1)


def test_replayed_frames_are_dropped_and_counted() -> None:
    link, theirs = Link(240, 191, signing=_signer()), _theirs()
    first, second, third = (_heartbeat(theirs) for _ in range(3))
    assert _received(link, first, third, first, second, third) == 2
    assert _counts(link) == {"received": 2, "replayed": 3}


def test_every_link_id_component_and_system_is_a_stream_of_its_own() -> None:
    link = Link(240, 191, signing=_signer())
    ends = [_theirs(), _theirs(link_id=1), _theirs(system=2)]
    assert _received(link, *(_heartbeat(end) for end in ends)) == 3  # all with the same stamp


@pytest.mark.parametrize(("behind_s", "taken"), [(0, 1), (59, 1), (61, 0), (3600, 0)])
def test_a_new_stream_may_lie_a_minute_behind_at_most(behind_s: int, taken: int) -> None:
    """As pymavlink's receiver decides."""
    link, theirs = Link(240, 191, signing=_signer()), _theirs()
    data = _heartbeat(_theirs(stamp=NOW - behind_s * STAMPS_PER_SECOND))
    assert _received(link, data) == taken
    assert (_heard(theirs, data) == ["HEARTBEAT"]) == bool(taken)
    assert link.stats.replayed == 1 - taken


def test_stamps_grow_although_the_clock_goes_back() -> None:
    times = iter([NOW, NOW + 5, NOW - 10**9, NOW + 6, NOW + 3])
    ours, theirs = Link(240, 191, signing=_signer(now=lambda: next(times))), _theirs()
    assert all(_heard(theirs, data) == ["HEARTBEAT"] for data in _sent(ours, *[HEARTBEAT] * 5))


def test_a_peer_whose_clock_leads_is_followed() -> None:
    """A companion without a clock: its first stamps would be too old for a peer that has heard it in its good days."""
    ours = Link(240, 191, signing=_signer(now=lambda: 1000))
    assert _received(ours, _heartbeat(_theirs(stamp=NOW))) == 1
    theirs = _theirs(stamp=NOW)
    assert _heard(theirs, _sent(ours, HEARTBEAT)[0]) == ["HEARTBEAT"]


@pytest.mark.parametrize("chunk", [1, 7, 100])
def test_a_signed_stream_in_pieces_gives_every_message(chunk: int) -> None:
    link, theirs = Link(240, 191, framing=StreamFraming(), signing=_signer()), _theirs()
    stream = b"".join(_heartbeat(theirs) for _ in range(10)) + bytes(300)
    pieces = [stream[at : at + chunk] for at in range(0, len(stream), chunk)]
    assert _received(link, *pieces) == 10


def test_a_signed_flight_flies_and_an_unsigned_pilot_is_not_heard() -> None:
    """Both ends sign; a frame that says another mode, unsigned or signed with another key, changes nothing."""
    companion, _, vehicle, now = flying(_signer(), _signer())
    for signer in (None, _signer(OTHER)):
        forger = Link(1, 1, signing=signer)
        forger.send(m.CurrentMode(0, 0x00030000, 0x00030000))
        for data in forger.datagrams_to_send():
            companion.receive_datagram(data, now)
    now = exchange(companion, vehicle, 0.5, start_us=now)
    assert companion.state is State.OFFBOARD
    assert companion.link.stats.unsigned == companion.link.stats.bad_signature == 1
    companion.stop("enough")
    exchange(companion, vehicle, 1.0, start_us=now)
    assert vehicle.mode == LAND


# ---------------------------------------------------------------- the file


def test_with_a_key_only_a_signed_word_makes_a_peer() -> None:
    """Unsigned, of another key, replayed: none of them may turn the companion away from its vehicle for life."""
    with UdpSocket.bind("127.0.0.1", 0) as probe:
        where = probe.address
    with UdpSocket.bind("127.0.0.1", 0, peer=where) as stranger, UdpSocket.bind("127.0.0.1", 0, peer=where) as vehicle:
        old = _heartbeat(_theirs(stamp=NOW - 120 * STAMPS_PER_SECOND))
        good = _heartbeat(_theirs())
        signer = _signer()
        with closing(open_address("udpin:{}:{}".format(*where), signer)) as listener:
            unsigned = _heartbeat(dialect.MAVLink(None, srcSystem=1, srcComponent=1))
            for word in (unsigned, _heartbeat(_theirs(OTHER)), old):
                stranger.send(word)
            vehicle.send(good)
            assert listener.wait(5.0)
            assert listener.receive_all() == [good]
            assert isinstance(listener, UdpSocket)
            assert (listener.peer, listener.foreign) == (vehicle.address, 3)
        link = Link(240, 191, signing=signer)
        assert _received(link, good) == 1  # what made the peer is still to be taken


def _key_file(tmp_path: Path, content: bytes = KEY, mode: int = 0o600) -> Path:
    path = tmp_path / "link.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize(
    "content", [KEY, KEY.hex().encode(), KEY.hex().upper().encode() + b"\n", b" " + KEY.hex().encode()]
)
def test_a_key_is_32_bytes_or_64_hexadecimal_digits(content: bytes) -> None:
    ours = Link(240, 191, signing=Signer(parse_key(content, "x"), lambda: NOW))
    assert _heard(_theirs(), _sent(ours, HEARTBEAT)[0]) == ["HEARTBEAT"]


@pytest.mark.parametrize(
    "content", [b"", KEY[:31], KEY + b"1", b"correct horse battery staple", b"g" * 64, KEY.hex()[:-2].encode()]
)
def test_what_is_no_key_is_said_in_one_line_without_its_content(content: bytes, tmp_path: Path) -> None:
    path = _key_file(tmp_path, content)
    with pytest.raises(InputError, match="64 hexadecimal digits") as caught:
        KeyFile.open(path)
    assert "\n" not in str(caught.value)
    assert not content or content.decode("latin1") not in str(caught.value)


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604, 0o620, 0o700, 0o666])
def test_a_key_that_others_may_use_is_refused(mode: int, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="chmod 600") as caught:
        KeyFile.open(_key_file(tmp_path, mode=mode))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("mode", [0o600, 0o400])
def test_a_key_of_its_owner_alone_is_taken_and_its_state_is_as_private(mode: int, tmp_path: Path) -> None:
    path = _key_file(tmp_path, mode=mode)
    KeyFile.open(path).close()
    assert stat.S_IMODE(state_path(path).stat().st_mode) == 0o600
    assert KEY.hex() not in state_path(path).read_text()


def test_a_key_that_is_absent_or_no_file_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "absent", tmp_path):
        with pytest.raises(InputError, match=str(path)):
            KeyFile.open(path)
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(InputError, match="is no file"):
        KeyFile.open(tmp_path / "pipe")


def test_a_key_in_use_is_not_used_twice(tmp_path: Path) -> None:
    path = _key_file(tmp_path)
    first = KeyFile.open(path)
    with pytest.raises(InputError, match="in use by another program"):
        KeyFile.open(path)
    first.close()
    KeyFile.open(path).close()


def test_the_key_shows_nowhere(tmp_path: Path) -> None:
    file = KeyFile.open(_key_file(tmp_path))
    shown = repr(parse_key(KEY, "x")) + repr(file.signer) + str(vars(file.signer)) + repr(file)
    file.close()
    for form in (KEY.hex(), repr(KEY), repr(bytearray(KEY))):
        assert form not in shown


def test_no_stamp_is_used_twice_although_the_program_is_killed_and_the_clock_goes_back(tmp_path: Path) -> None:
    """Killed: what is in the state file at that moment is all that is left; the clock then says 1970."""
    path = _key_file(tmp_path)
    first = KeyFile.open(path)
    link = Link(240, 191, signing=first.signer)
    frames = _sent(link, *[HEARTBEAT] * 100)
    left = state_path(path).read_text()
    first.close()
    state_path(path).write_text(left)
    second = KeyFile.open(path)
    second.signer._stamp_now = lambda: 0
    after = _sent(Link(240, 191, signing=second.signer), HEARTBEAT)[0]
    second.close()
    stamps = [int.from_bytes(frame[-12:-6], "little") for frame in frames]
    assert int.from_bytes(after[-12:-6], "little") > max(stamps)
    assert (
        json.loads(left)["next_stamp"] <= signing_stamp() + AHEAD
    )  # and not so far ahead that a peer would be cut off


def test_frames_replayed_to_a_restarted_program_are_dropped(tmp_path: Path) -> None:
    path = _key_file(tmp_path)
    first = KeyFile.open(path)
    theirs = _theirs(stamp=signing_stamp())
    old = [_heartbeat(theirs) for _ in range(5)]
    assert _received(Link(240, 191, signing=first.signer), *old) == 5
    first.close()
    second = KeyFile.open(path)
    link = Link(240, 191, signing=second.signer)
    assert _received(link, *old, _heartbeat(theirs)) == 1
    assert link.stats.replayed == 5
    second.close()


def test_what_was_heard_before_a_kill_lies_behind_what_was_written_ahead(tmp_path: Path) -> None:
    path = _key_file(tmp_path)
    file = KeyFile.open(path)
    theirs = _theirs(stamp=signing_stamp())
    old = _heartbeat(theirs)
    _received(Link(240, 191, signing=file.signer), old)
    file._try_to_write(AHEAD)  # what the thread does every 2 s
    left = state_path(path).read_text()
    newer = [_heartbeat(theirs) for _ in range(100)]  # heard after it, before the kill
    file.close()
    state_path(path).write_text(left)
    again = KeyFile.open(path)
    link = Link(240, 191, signing=again.signer)
    assert _received(link, old, *newer) == 0
    theirs.signing.timestamp += AHEAD
    assert _received(link, _heartbeat(theirs)) == 1
    again.close()


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"schema": "x"}', '{"schema": "flightstack.signing/1", "next_stamp": -1, "streams": {}}']
)
def test_a_damaged_state_is_said_in_one_line(text: str, tmp_path: Path) -> None:
    path = _key_file(tmp_path)
    state_path(path).write_text(text)
    with pytest.raises(InputError, match="damaged"):
        KeyFile.open(path)
    state_path(path).unlink()
    KeyFile.open(path).close()  # the key was let go
