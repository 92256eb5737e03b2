"""What a flight keeps of its ticks until its end: the numbers that came, in little memory."""

from __future__ import annotations

import tracemalloc

import numpy as np

from flightstack.cli.barrier_score import RegionScore
from flightstack.cli.calibration import LearnedScore
from flightstack.cli.column import Column
from flightstack.cli.estimate_score import EstimateScore
from flightstack.cli.result import LoopTiming, TrackingScore
from flightstack.region import Region
from flightstack.types import Learned

ROWS = 20_000
NUMBERS = np.random.default_rng(1).normal(size=(ROWS, 3))


def test_rows_come_out_as_they_went_in() -> None:
    lists, arrays, single = Column(3), Column(3), Column()
    for row in NUMBERS:
        lists.extend(row.tolist())
        arrays.extend_bytes(row)
        single.append(row[0])
    np.testing.assert_array_equal(lists.table(), NUMBERS)
    np.testing.assert_array_equal(arrays.table(), NUMBERS)
    np.testing.assert_array_equal(single.table(), NUMBERS[:, 0])
    assert [*single] == NUMBERS[:, 0].tolist()
    assert (len(lists), len(arrays), len(single)) == (ROWS,) * 3
    assert len(Column()) == len(Column().table()) == 0
    assert Column(3).table().shape == (0, 3)


def test_a_part_of_a_row_is_kept_without_the_row() -> None:
    column, wide = Column(3), np.arange(1000.0)
    column.extend_bytes(wide[5:8])
    assert column.table().tolist() == [[5.0, 6.0, 7.0]]


def test_an_hour_of_ticks_takes_some_200_mb_and_not_a_gigabyte() -> None:
    """900,000 ticks without a truth: 23 numbers of 8 bytes each; kept as objects they took 1.1 kB a tick."""
    region = Region("ellipsoid", (0.0, 0.0, -1.5), (1.0, 1.0, 1.0), (1.0, 1.0, 1.0))
    tracking, estimate, learned = TrackingScore("estimate"), EstimateScore(), LearnedScore()
    judged, timing = RegionScore(region), LoopTiming(250)
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for i, row in enumerate(NUMBERS):
            place = tuple(row.tolist())
            tracking.add(place, (0.0, 0.0, -1.5))
            estimate.add(row.copy(), 0.1, None)
            learned.add(Learned(np.full(len(Learned.nothing().row), float(i))), None)
            judged.add(4000 * i, (*place, *place))
            timing.tick(4000 + i % 7, 4000)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert 1.25 * (after - before) >= 23 * 8 * ROWS, "all of it is kept"
    assert after - before < 1.25 * 23 * 8 * ROWS
