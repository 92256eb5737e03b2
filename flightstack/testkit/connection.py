"""A pymavlink connection to a `Px4Sim` without a socket: waiting for a message moves the vehicle's time."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

from pymavlink import mavutil

if TYPE_CHECKING:
    from flightstack.testkit.px4_sim import Px4Sim

TICK_S = 0.004


class Connection(mavutil.mavfile):  # type: ignore[misc]
    """A `mavfile`; the time-outs of `recv_match` are the vehicle's seconds."""

    def __init__(self, px4: Px4Sim, link: int, source_system: int = 255, source_component: int = 190) -> None:
        super().__init__(None, f"memory:{link}", source_system, source_component)
        self._px4, self._link = px4, link
        self._arrived: deque[bytes] = deque()

    def deliver(self, data: bytes) -> None:
        """A datagram of the vehicle's."""
        self._arrived.append(data)

    def recv(self, n: int | None = None) -> bytes:
        """The next datagram that has arrived, empty where there is none."""
        return self._arrived.popleft() if self._arrived else b""

    def write(self, buf: bytes) -> None:
        """Send."""
        self._px4.send(self._link, bytes(buf))

    def select(self, timeout: float) -> bool:
        """Wait for 4 ms of the vehicle's time."""
        self._px4.step(TICK_S)
        return bool(self._arrived)

    def recv_match(
        self, condition: Any = None, type: Any = None, blocking: bool = False, timeout: float | None = None
    ) -> Any:
        """As pymavlink's; with `blocking` the vehicle's time runs until it comes, `timeout` of its seconds at most."""
        end_s = None if timeout is None else self._px4.now_s + timeout
        while True:
            found = super().recv_match(condition, type)
            if found is not None or not blocking or (end_s is not None and self._px4.now_s >= end_s):
                return found
            self.select(TICK_S)

    def close(self) -> None:
        """Nothing to give back."""
