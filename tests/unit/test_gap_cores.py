"""Work on several cores, and what is made once: every part is done, and nothing is taken for something else."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from flightstack.gap.cores import on_cores, share
from flightstack.gap.remembered import Remembered


def test_every_part_is_done_once_and_the_parts_of_a_part_where_it_is() -> None:
    done = np.zeros((40, 30), dtype=int)
    where: list[set[int]] = [set() for _ in done]

    def part(k: int) -> None:
        def inner(rows: slice) -> None:
            done[k, rows] += 1
            where[k].add(threading.get_ident())

        share(inner, done.shape[1], least=5)

    on_cores(part, range(len(done)))
    assert (done == 1).all()
    assert all(len(threads) == 1 for threads in where)
    share(lambda rows: part(rows.start), 1, least=100)  # and after it as before
    assert done[0].tolist() == [2] * 30


def test_what_fails_in_any_part_is_said() -> None:
    def part(k: int) -> None:
        if k == 7:
            raise ValueError("the eighth")

    with pytest.raises(ValueError, match="the eighth"):
        on_cores(part, range(8))


def test_a_result_is_made_once_for_the_same_objects_and_bytes_and_the_oldest_is_forgotten() -> None:
    remembered, made = Remembered[int](2), []

    def ask(depends: bytes, *of: object) -> int:
        return remembered(lambda: made.append(1) or len(made), *of, depends=depends)  # type: ignore[func-returns-value]

    one, other = [1.0], [1.0]
    assert [ask(b"a", one), ask(b"a", one), ask(b"a", other)] == [1, 1, 2]
    assert ask(b"a", one) == 1
    assert ask(b"b", one) == 3, "that of the other, asked for longest ago, makes room"
    assert [ask(b"a", one), ask(b"a", other)] == [1, 4]
