"""MAVLink 2 signing: who may speak on a link, and that nobody says an old thing again.  Sans-IO.

A signature is a link id (1 byte), a stamp (6 bytes, little-endian, tens of microseconds since 2015-01-01 UTC) and the
first 6 bytes of SHA-256 over the secret key, the frame up to and with its CRC, link id and stamp.  A frame counts if
its signature is right and its stamp is newer than the last one of the same system, component and link id; the first one
of such a stream may lie a minute behind what is known of the time at most.  Stamps that are sent always grow, whatever
the clock does.  Unsigned frames count only where radios put them in themselves: RADIO_STATUS.
Source: mavlink.io/en/guide/message_signing.html; the tests' oracle is pymavlink's own signing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from hashlib import sha256
from hmac import compare_digest
from typing import final

from flightstack.types import InputError
from mavlink_bridge.framing import SIGNATURE_SIZE

KEY_SIZE = 32
STAMPS_PER_SECOND = 100_000
RADIO_STATUS = 109
_OFTEN_HEX = 2 * KEY_SIZE
_HASH_SIZE = 6
_STAMP_MAX = (1 << 48) - 1
_NEW_STREAM_BEHIND = 60 * STAMPS_PER_SECOND

Stream = tuple[int, int, int]
"""System, component, link id."""


_SENDER = slice(5, 7)
"""System and component in a frame of MAVLink 2."""


@final
class SecretKey:
    """32 secret bytes that never show themselves."""

    __slots__ = ("_bytes",)

    def __init__(self, secret: bytes) -> None:
        if len(secret) != KEY_SIZE:
            raise ValueError(f"a signing key has {KEY_SIZE} bytes")
        self._bytes = secret

    def __repr__(self) -> str:
        return "SecretKey(...)"

    def __reduce__(self) -> str:
        raise TypeError("a signing key is not to be copied")

    def hash_of(self, frame: bytes, head: bytes) -> bytes:
        """The signature's own 6 bytes for a frame (CRC included) and its link id and stamp."""
        return sha256(self._bytes + frame + head).digest()[:_HASH_SIZE]

    def secret(self) -> bytes:
        """The bytes themselves, for a process of ours that signs too; never to be shown or stored."""
        return self._bytes


def parse_key(data: bytes, where: str) -> SecretKey:
    """A key file's content: 32 bytes as they are, or 64 hexadecimal digits; InputError (without the content) if not."""
    if len(data) == KEY_SIZE:
        return SecretKey(data)
    try:
        text = data.decode("ascii").strip()
        if len(text) == _OFTEN_HEX:
            return SecretKey(bytes.fromhex(text))
    except ValueError:
        pass
    raise InputError(
        f"signing key {where} is none: it must hold {KEY_SIZE} bytes or {_OFTEN_HEX} hexadecimal digits "
        f"(make one with: umask 077; head -c {KEY_SIZE} /dev/urandom > FILE)"
    )


@final
class Signer:
    """Signs what one link sends and judges what it receives."""

    def __init__(
        self,
        key: SecretKey,
        stamp_now: Callable[[], int],
        *,
        link_id: int = 0,
        next_stamp: int = 0,
        seen: Mapping[Stream, int] | None = None,
    ) -> None:
        """`stamp_now`: the time in stamps, may jump.  `next_stamp`, `seen`: what an earlier run left."""
        self._key, self._stamp_now, self._link_id = key, stamp_now, link_id
        self.next_stamp = next_stamp
        """No stamp from here on has been used."""
        self.seen: dict[Stream, int] = dict(seen or {})
        """The newest stamp of each stream."""
        self.refused = 0
        """Frames that did not count, those included with which a stranger began to speak."""

    def secret(self) -> bytes:
        """The key's bytes, for the dead-man, which signs with a link id of its own."""
        return self._key.secret()

    def newest_of(self, system: int, component: int) -> int:
        """Newest stamp heard of a sender, 0 before the first."""
        return max(
            (stamp for (one, other, _), stamp in self.seen.items() if (one, other) == (system, component)), default=0
        )

    def signature(self, frame: bytes) -> bytes:
        """The 13 bytes to append to an outgoing frame whose signed flag is set."""
        stamp = min(max(self._stamp_now(), self.next_stamp), _STAMP_MAX)
        self.next_stamp = stamp + 1
        head = bytes((self._link_id,)) + stamp.to_bytes(6, "little")
        return head + self._key.hash_of(frame, head)

    def judge(self, frame: bytes, signed: bool, number: int, now_us: int) -> str:
        """Empty where a received frame (whole, signature included) may be used, else the counter it belongs to."""
        fault, stream, stamp = self._weigh(frame, signed, number)
        if stream is not None:
            self.seen[stream] = stamp
            self.next_stamp = max(self.next_stamp, min(stamp, _STAMP_MAX))  # a peer with the better clock leads
        self.refused += bool(fault)
        return fault

    def vouches(self, frame: bytes, signed: bool) -> bool:
        """Whether a frame that nobody has taken yet is rightly signed and new; it is still to be judged."""
        vouched = self._weigh(frame, signed, -1)[0] == ""
        self.refused += not vouched
        return vouched

    def _weigh(self, frame: bytes, signed: bool, number: int) -> tuple[str, Stream | None, int]:
        """The counter it belongs to, empty where it is good; its stream and stamp where they count from now on."""
        if not signed:
            return "" if number == RADIO_STATUS else "unsigned", None, 0
        body, head, given = frame[:-SIGNATURE_SIZE], frame[-SIGNATURE_SIZE:-_HASH_SIZE], frame[-_HASH_SIZE:]
        if not compare_digest(self._key.hash_of(body, head), given):
            return "bad_signature", None, 0
        stamp = int.from_bytes(head[1:], "little")
        stream = (*body[_SENDER], head[0])
        last = self.seen.get(stream)
        if last is None:
            last = max(self._stamp_now(), self.next_stamp) - _NEW_STREAM_BEHIND - 1
        if stamp <= last:
            return "replayed", None, 0
        return "", stream, stamp
