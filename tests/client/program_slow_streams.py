"""`shielded_program.py` that asks once a second for attitude, position and IMU at 1 Hz, as a frugal program may.

python tests/client/program_slow_streams.py udpin:127.0.0.1:14640 [HEIGHT_M]
"""

from __future__ import annotations

import sys

import shielded_program

STREAMS = (31, 32, 105)
"""ATTITUDE_QUATERNION, LOCAL_POSITION_NED, HIGHRES_IMU."""


class Frugal(shielded_program.Program):
    """Asks for little."""

    def __init__(self, address: str) -> None:
        super().__init__(address)
        self._asks = 0

    def ask(self, mask: int, north: float, down: float, yaw_radps: float = 0.0) -> None:
        """A setpoint, and now and then slower streams."""
        self._asks += 1
        if self._asks % 50 == 0:
            for number in STREAMS:
                self.command(shielded_program.MAV.MAV_CMD_SET_MESSAGE_INTERVAL, float(number), 1e6)
        super().ask(mask, north, down, yaw_radps)


if __name__ == "__main__":
    shielded_program.Program = Frugal  # type: ignore[misc]
    shielded_program.main(sys.argv[1], float((*sys.argv, shielded_program.HEIGHT_M)[2]), 0.0)
