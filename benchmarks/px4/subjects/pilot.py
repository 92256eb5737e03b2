"""The pilot takes over in the middle of figure8: the companion is silent and stays so."""

from __future__ import annotations

import time

from benchmarks.px4.companion import start
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4, log_folder

ASKED = (
    "A mode chosen by the pilot in the middle of figure8 stands: the companion ends with exit code 1, PX4 does not go "
    "back to OFFBOARD within 5 s, nothing touches the ground at more than 1.5 m/s."
)
RUNS = 3
AIRBORNE_M, FLOWN_S, WATCHED_S, SOFT_MPS = 1.5, 8.0, 5.0, 1.5
TAKEOFF_LIMIT_S = 150.0
"""With the start of a process on a busy machine."""
OFFBOARD = 6
MODES = (("Hold", 4.0, 3.0), ("Return", 4.0, 5.0), ("Land", 4.0, 6.0))
"""Words, main mode, sub mode."""


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` flights for every mode."""
    return [_mode(bench, words, main, sub, runs) for words, main, sub in MODES]


def _mode(bench: Bench, words: str, main: float, sub: float, runs: int) -> Row:
    notes = []
    for number in range(runs):
        with Px4(bench) as px4:
            companion = start(px4, log_folder(bench, f"pilot-{words.lower()}"), "figure8")
            try:
                if not px4.wait(lambda: px4.height_m > AIRBORNE_M, TAKEOFF_LIMIT_S):
                    notes.append(f"run {number}: did not take off")
                    continue
                time.sleep(FLOWN_S)
                px4.command(176, 1.0, main, sub)
                chosen_s = time.monotonic()
                px4.wait(lambda: px4.mode >> 16 & 0xFF != OFFBOARD, 2.0)
                back = px4.wait(lambda: px4.mode >> 16 & 0xFF == OFFBOARD, WATCHED_S)
                code = companion.wait(30.0)
            finally:
                companion.kill()
            low = [truth.vel_d_mps for truth in px4.truth if truth.up_m < 0.1 and truth.at_s > chosen_s]
        if back or code != 1 or max(low, default=0.0) > SOFT_MPS:
            notes.append(f"run {number}: exit {code}, OFFBOARD again {back}, ground at {max(low, default=0.0):.1f} m/s")
    return Row(f"the pilot chooses {words}", f"{runs - len(notes)} of {runs} left alone", not notes, runs, notes)
