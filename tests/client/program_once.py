"""A program that asks once, as MAVSDK's examples do: streams a place, selects OFFBOARD, arms, and never asks again.

python tests/client/program_once.py udpin:127.0.0.1:14640 [HEIGHT_M]
"""

from __future__ import annotations

import sys

from shielded_program import HEIGHT_M, MAV, POSITION, Program

BEFORE, APART = 100, 25
"""Setpoints before OFFBOARD is selected, and between that and arming; 50 a second."""


def main(address: str, height_m: float) -> None:
    """Until somebody ends it."""
    program, ticks = Program(address), 0
    while True:
        program.ask(POSITION, 0.0, -height_m)
        ticks += 1
        if ticks == BEFORE:
            program.command(MAV.MAV_CMD_DO_SET_MODE, 1.0, 6.0)
        elif ticks == BEFORE + APART:
            program.command(MAV.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)


if __name__ == "__main__":
    main(sys.argv[1], float((*sys.argv, HEIGHT_M)[2]))
