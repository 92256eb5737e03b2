"""What the shield does between two ticks: datagrams go on first, and are read afterwards.

Reading one takes three times as long as sending it on, and what came with it would wait.
"""

from __future__ import annotations

import time

from flightstack.cli.shield_frames import is_one_frame
from flightstack.cli.shield_router import TIMESYNC_ID, ShieldRouter
from mavlink_bridge.transport.address import Transport
from mavlink_bridge.transport.udp import UdpSocket

MOST_AT_ONCE = 32
"""Datagrams of the program between two looks at the clock: whatever it pours out, the vehicle gets its setpoints."""
_KEPT_MOST = 1_000_000


class Passing:
    """Between one vehicle and one program."""

    def __init__(self, router: ShieldRouter, vehicle: Transport, program: UdpSocket) -> None:
        self._router, self._vehicle, self._program = router, vehicle, program
        self.latencies_us: list[float] = []
        """What passing a batch took."""

    def step(self, now_us: int, came_ns: int) -> bool:
        """Pass on what has come by `came_ns` (`time.perf_counter_ns`); whether the program was heard."""
        passed, unread = 0, []
        for data in self._vehicle.receive_all():
            if is_one_frame(data, TIMESYNC_ID):  # nothing of the router's own can be in it
                self._program.send(data)
                unread.append(data)
                passed += 1
                continue
            unread = self._read(unread, now_us)  # the vehicle's word is read in its order
            for kept in self._router.from_vehicle(data, now_us):
                self._program.send(kept)
                passed += 1
        heard = self._program.receive_all(MOST_AT_ONCE)
        for data in heard:
            for kept in self._router.from_program(data, now_us):
                self._vehicle.send(kept)
                passed += 1
        if passed and len(self.latencies_us) < _KEPT_MOST:
            self.latencies_us.append((time.perf_counter_ns() - came_ns) * 1e-3)
        self._read(unread, now_us)
        return bool(heard)

    def _read(self, unread: list[bytes], now_us: int) -> list[bytes]:
        """All of it passes as it is, so what the router makes of it for the program is what went on."""
        for data in unread:
            self._router.from_vehicle(data, now_us)
        return []
