"""`make bench`: the table that it writes is what it compares with."""

from __future__ import annotations

import math

import pytest

from benchmarks.bench import (
    BEGIN,
    COMPILED,
    END,
    PAGE,
    PYTHON,
    UNHELD,
    Part,
    behind,
    check,
    multiples,
    processor,
    table,
    tables,
)


def lines(step_us: float) -> list[Part]:
    parts = [
        Part(COMPILED, "product", COMPILED, lambda: 50.0),
        Part(PYTHON, "pass", PYTHON, lambda: 0.25),
        Part("plant", "step", COMPILED, iter((3.0 * step_us, step_us, 2.0 * step_us)).__next__),
        Part("p99", "step", UNHELD, lambda: 900.0),
    ]
    for _ in range(3):
        for part in parts:
            part.turn()
    return parts


def test_the_least_turn_counts_and_what_is_written_is_read_again() -> None:
    found = multiples(table(lines(step_us=10.0)))
    assert found == {COMPILED: 1.0, PYTHON: 1.0, "plant": 0.2}, "a 99th percentile is held to nothing"


def test_a_part_that_lost_a_quarter_of_its_speed_is_named() -> None:
    then = multiples(table(lines(step_us=10.0)))
    assert not behind(then, multiples(table(lines(step_us=13.3))))
    slow = behind(then, multiples(table(lines(step_us=13.5))))
    assert list(slow) == ["plant"]
    assert slow["plant"].startswith("plant: 0.27 times")
    assert not behind(then, {}), "a part that is gone is not slow"


def test_the_page_has_tables() -> None:
    found = tables(PAGE.read_text("utf-8").partition(BEGIN)[2].partition(END)[0])
    assert found
    for own in map(multiples, found.values()):
        assert len(own) >= 10
        assert all(math.isfinite(value) and value > 0.0 for value in own.values())


def test_each_kind_of_processor_is_held_to_its_own_table() -> None:
    parts, stated = slowing(10.0, 20.0)
    other = table(lines(step_us=20.0)).replace(processor(), "8 cores of an abacus (bead)")
    assert list(tables(f"{other}\n\n{stated}")) == ["8 cores of an abacus (bead)", processor()]
    assert tables(f"{other}\n\n{stated}")[processor()] == stated
    assert "plant: 0.4 times its kernel, 0.2 are stated" in check(parts, f"{stated}\n\n{other}")


def slowing(before_us: float, *turns_us: float) -> tuple[list[Part], str]:
    """Lines whose plant takes these times in turn, and the table of one that took `before_us`."""
    stated = table(lines(step_us=before_us))
    parts = [each for each in lines(step_us=before_us) if each.name != "plant"]
    times = iter(turns_us)
    return [*parts, Part("plant", "step", COMPILED, lambda: next(times, turns_us[-1]))], stated


def test_a_short_form_fails_where_a_part_stays_slow() -> None:
    assert "plant: 0.4 times its kernel, 0.2 are stated" in check(*slowing(10.0, 20.0))


def test_a_busy_neighbour_is_waited_for() -> None:
    assert check(*slowing(10.0, 20.0, 20.0, 20.0, 20.0, 11.0)) == ""


def test_what_goes_through_shared_memory_is_not_held() -> None:
    parts, stated = slowing(10.0, 20.0)
    parts[-1].held = False
    assert check(parts, stated) == ""


def test_another_processor_is_held_to_nothing_and_that_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    parts, stated = slowing(10.0, 20.0)
    assert check(parts, stated.replace(processor(), "8 cores of an abacus (bead)")) == ""
    said = capsys.readouterr().out
    assert "not compared" in said
    assert said.count("\n") == 1, "a table of what was not measured"
