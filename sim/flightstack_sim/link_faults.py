"""A bad link: datagrams that are lost, late, out of order, doubled or damaged, the same ones for the same seed.

A datagram's fate is drawn when it is sent: lost with probability `loss`; else damaged with `corrupt` (one to four of
its bits flip) and sent twice with `duplicate`; each copy arrives `delay` later, plus a time drawn evenly from 0 to
`jitter`, plus REORDER_DELAY with probability `reorder`.  Jitter alone lets later ones overtake, as on a real network.
Time is simulated time.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

REORDER_DELAY_US: Final = 12_000
"""What an out-of-order datagram is late by: a few of its successors, at the usual rates, come first."""
_MOST_FLIPS: Final = 4


@dataclass(frozen=True, slots=True)
class LinkQuality:
    """What happens to datagrams, shares 0..1 and microseconds."""

    loss: float = 0.0
    corrupt: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    delay_us: float = 0.0
    jitter_us: float = 0.0

    @property
    def perfect(self) -> bool:
        """Nothing happens to them."""
        return self == _PERFECT

    def with_settings(self, settings: tuple[tuple[str, float], ...], value: float) -> LinkQuality:
        """The same with a fault's settings; `value` in place of the setting of a fault that has but one."""
        if len(settings) == 1:
            field, scale = settings[0]
            return replace(self, **{field: value * scale})
        return replace(self, **dict(settings))


_PERFECT: Final = LinkQuality()


@dataclass(frozen=True, slots=True)
class LinkFault:
    """One fault of a link, for the table of faults."""

    name: str
    does: str
    value: float
    unit: str
    limits: tuple[float, float]
    settings: tuple[tuple[str, float], ...]
    """Field and scale of the one that the value sets, or several fields and their values."""


_SHARE: Final = ("0..1", (0.0, 1.0))
_MS: Final = ("ms", (0.0, 10_000.0))
LINK_FAULTS: Final = (
    LinkFault("link-loss", "a share of the datagrams is lost, both ways", 0.1, *_SHARE, (("loss", 1.0),)),
    LinkFault("link-delay", "datagrams take VALUE longer, both ways", 20.0, *_MS, (("delay_us", 1e3),)),
    LinkFault("link-jitter", "datagrams take 0 to VALUE longer, drawn for each", 20.0, *_MS, (("jitter_us", 1e3),)),
    LinkFault("link-duplicate", "a share of the datagrams comes twice", 0.1, *_SHARE, (("duplicate", 1.0),)),
    LinkFault("link-reorder", "a share of the datagrams is overtaken by later ones", 0.1, *_SHARE, (("reorder", 1.0),)),
    LinkFault("link-corrupt", "bits flip in a share of the datagrams", 0.01, *_SHARE, (("corrupt", 1.0),)),
    LinkFault(
        "link-degraded", "10 % loss, 0 to 20 ms jitter and 1 % damage at once", float("nan"), "", (0.0, 0.0),
        (("loss", 0.1), ("jitter_us", 20e3), ("corrupt", 0.01)),
    ),
)  # fmt: skip


class BadLink:
    """One direction of a link; `carry` takes what is sent now and gives what arrives now."""

    __slots__ = ("_flying", "_number", "_rng", "corrupted", "lost", "sent")

    def __init__(self, seed: int, direction: int) -> None:
        self._rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence((seed, 0x6C696E6B, direction))))
        self._flying: list[tuple[float, int, bytes]] = []
        self._number = 0
        self.sent = self.lost = self.corrupted = 0

    def carry(self, datagrams: list[bytes], quality: LinkQuality, now_us: int) -> list[bytes]:
        """Datagrams in the order of their arrival."""
        for data in datagrams:
            self._send(data, quality, now_us)
        arrived = []
        flying = self._flying
        while flying and flying[0][0] <= now_us:
            arrived.append(heapq.heappop(flying)[2])
        return arrived

    def _send(self, data: bytes, quality: LinkQuality, now_us: int) -> None:
        """Draw a datagram's fate: as many numbers whatever it is, so that one fault doesn't move another."""
        lost, damaged, doubled, *ways = self._rng.random(7).tolist()
        self.sent += 1
        if lost < quality.loss:
            self.lost += 1
            return
        if damaged < quality.corrupt:
            self.corrupted += 1
            data = self._damage(data)
        for copy in range(2 if doubled < quality.duplicate else 1):
            jitter, late = ways[2 * copy], ways[2 * copy + 1]
            at_us = now_us + quality.delay_us + jitter * quality.jitter_us
            if late < quality.reorder:
                at_us += REORDER_DELAY_US
            self._number += 1
            heapq.heappush(self._flying, (at_us, self._number, data))

    def _damage(self, data: bytes) -> bytes:
        damaged = bytearray(data)
        for place in self._rng.integers(0, 8 * len(data), 1 + int(self._rng.integers(_MOST_FLIPS))).tolist():
            damaged[place // 8] ^= 1 << place % 8
        return bytes(damaged)
