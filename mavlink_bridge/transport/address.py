"""Addresses as users write them: `udpin:HOST:PORT`, `udpin://HOST:PORT`, `udpout:HOST:PORT`, `serial:DEVICE:BAUD`.

`udpin` listens and answers the first autopilot that speaks (others are not heard); `udpout` speaks first, from any free
port.
"""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from flightstack.types import InputError
from mavlink_bridge.framing import SIGNED, DatagramFraming, Frame, Framing, StreamFraming, frame_at
from mavlink_bridge.layout import CRC_EXTRAS
from mavlink_bridge.px4 import COMPONENT_AUTOPILOT
from mavlink_bridge.signing import Signer
from mavlink_bridge.transport.serial import SerialPort
from mavlink_bridge.transport.udp import LOOPBACK, UdpSocket

_FORMS = "udpin:HOST:PORT, udpout:HOST:PORT or serial:DEVICE:BAUD"
_ANY = "0.0.0.0"


@dataclass(frozen=True, slots=True)
class UdpIn:
    """Listen at `host` and `port`; the first autopilot becomes the peer."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class UdpOut:
    """Send to `host` and `port`."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class Serial:
    """A serial line."""

    device: str
    baud: int


class Transport(Protocol):
    """What every transport offers: nothing here blocks or raises."""

    other: int
    """System of another autopilot that speaks to it beside the one that is heard; 0: none."""

    def receive(self) -> bytes | None:
        """What has arrived, None where nothing has."""

    def receive_all(self) -> list[bytes]:
        """Everything that has arrived, in order."""

    def send(self, data: bytes) -> bool:
        """Send; whether it went."""

    def wait(self, timeout_s: float) -> bool:
        """Wait until something can be received; whether it can."""

    def fileno(self) -> int:
        """The file descriptor."""

    def close(self) -> None:
        """Give the port back."""


_PX4_BELOW = 40
"""A simulated PX4's links send to the port so far below their own, and answer one port for life: always this one."""


def parse_address(text: str) -> UdpIn | UdpOut | Serial:
    """The address; InputError where it is none."""
    kind, colon, rest = text.partition(":")
    if not colon or kind not in ("udpin", "udpout", "serial"):
        raise InputError(f"address {text!r} is not one: write {_FORMS}")
    first, colon, last = rest.removeprefix("//").rpartition(":")
    if kind == "serial":
        if not first or not _is_number(last) or int(last) == 0:
            raise InputError(
                f"address {text!r} is not a serial line: write serial:DEVICE:BAUD, as serial:/dev/ttyUSB0:921600"
            )
        return Serial(first, int(last))
    if not first or not _is_number(last) or not 1 <= int(last) <= 65535:
        raise InputError(
            f"address {text!r} has no host and port 1..65535: write {kind}:HOST:PORT, as {kind}:127.0.0.1:14540"
        )
    return UdpIn(first, int(last)) if kind == "udpin" else UdpOut(first, int(last))


def open_address(address: UdpIn | UdpOut | Serial | str, signer: Signer | None = None) -> Transport:
    """The transport at an address; InputError where it can't be opened.

    `udpin` answers the first autopilot for life (a router on this machine may change its port); with a `signer` the
    first one that signs rightly.
    """
    if isinstance(address, str):
        address = parse_address(address)
    if isinstance(address, Serial):
        return SerialPort.open(address.device, address.baud)
    if isinstance(address, UdpIn):
        greets = partial(_system_of_autopilot, signer)
        return UdpSocket.bind(address.host, address.port, greets=greets, drop_foreign=True, follow=True)
    near, peer = LOOPBACK if _is_loopback(address.host) else _ANY, (address.host, address.port)
    try:
        return UdpSocket.bind(near, max(0, address.port - _PX4_BELOW), peer=peer, latch=False, drop_foreign=True)
    except InputError:  # another program has it
        return UdpSocket.bind(near, 0, peer=peer, latch=False, drop_foreign=True)


def _system_of_autopilot(signer: Signer | None, data: bytes) -> int:
    """Whose frame a datagram begins with, 0 for all but autopilots: before the vehicle speaks anything may arrive."""
    found = frame_at(data, 0, CRC_EXTRAS) if data else None
    if not isinstance(found, Frame) or found.component != COMPONENT_AUTOPILOT:
        return 0
    vouched = signer is None or signer.vouches(data[: found.end], bool(found.flags & SIGNED))
    return found.system if vouched else 0


def framing_for(address: UdpIn | UdpOut | Serial) -> Framing:
    """How frames lie in what arrives from there."""
    return StreamFraming() if isinstance(address, Serial) else DatagramFraming()


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit()


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
