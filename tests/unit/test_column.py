"""What a flight keeps of its ticks until its end: the numbers that came, in little memory."""

from __future__ import annotations

import tracemalloc

import numpy as np
from log_samples import tick_record

from flightstack.cli.column import Column
from flightstack.cli.result import LoopTiming
from flightstack.cli.ticks import FlownTicks

ROWS = 20_000
NUMBERS = np.random.default_rng(1).normal(size=(ROWS, 3))


def test_rows_come_out_as_they_went_in() -> None:
    lists, arrays, single = Column(3), Column(3), Column()
    for row in NUMBERS:
        lists.extend(row.tolist())
        arrays.extend_bytes(row.tobytes())
        single.append(row[0])
    np.testing.assert_array_equal(lists.table(), NUMBERS)
    np.testing.assert_array_equal(arrays.table(), NUMBERS)
    np.testing.assert_array_equal(single.table(), NUMBERS[:, 0])
    assert [*single] == NUMBERS[:, 0].tolist()
    assert (len(lists), len(arrays), len(single)) == (ROWS,) * 3
    assert len(Column()) == len(Column().table()) == 0
    assert Column(3).table().shape == (0, 3)


def test_an_hour_of_ticks_takes_some_200_mb_and_not_a_gigabyte() -> None:
    """900,000 ticks without a truth: 26 numbers of 8 bytes each; kept as objects they took 1.1 kB a tick."""
    ticks, timing, record = FlownTicks(), LoopTiming(250), tick_record(1)
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for i, row in enumerate(NUMBERS):
            ticks.add((4000 * i, 0, True, 0), record, record.reference.row, row.copy())
            timing.tick(4000 + i % 7, 4000)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert 1.25 * (after - before) >= 26 * 8 * ROWS, "all of it is kept"
    assert after - before < 1.25 * 26 * 8 * ROWS
