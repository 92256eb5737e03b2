"""One definition of a gap and of what is left: CONTRACT's `closed`, and that nothing left open goes unsaid."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from flightstack.gap import concluded, pooled, workflow
from flightstack.gap.name import Selection, name
from flightstack.gap.records import Estimate, Figures, Gap, IdentifiedEffect, Samples, Unexplained
from flightstack.gap.report import words
from flightstack.gap.verdict import gap_of, unexplained
from flightstack.vehicle import Vehicle
from tests.gap_flights import as_samples, fly, quad, wander

NOTHING = Unexplained(False)
DRIVEN = Unexplained(True, ("airspeed",), 0.4)


def of_force(value: float) -> Figures:
    return Figures(value, None, None)


def test_a_gap_without_a_name_and_without_a_driver_is_said() -> None:
    """A payload on a real PX4: 1.70 over a floor of 0.80, its name taken back, was "no gap, agree within the noise"."""
    gap = gap_of(of_force(1.70), of_force(1.70), of_force(0.80))
    rest = unexplained(NOTHING, gap, named=False)
    assert rest == Unexplained(True, (), 1.0)
    assert words.verdict((), gap, rest) == ("bad", "not explained")
    assert "agree" not in words.sentence((), gap, rest)
    assert "depends on nothing that these logs show" in words.sentence((), gap, rest)


def test_below_twelve_tenths_of_the_floor_there_is_no_gap() -> None:
    gap = gap_of(of_force(0.95), of_force(0.95), of_force(0.80))
    assert gap.closed is None
    assert unexplained(DRIVEN, gap, named=False) == NOTHING


@pytest.mark.parametrize(
    ("before", "after", "rest", "expected"),
    [
        (8.0, 0.9, NOTHING, Unexplained(False, (), 1.0 - 7.1 / 7.2)),  # at the floor: nothing is left
        (8.0, 0.9, DRIVEN, Unexplained(False, (), 1.0 - 7.1 / 7.2)),  # a driver within the noise is a false alarm
        (8.0, 1.4, NOTHING, Unexplained(False, (), 1.0 - 6.6 / 7.2)),  # nearly closed, and nothing tells more
        (8.0, 1.4, DRIVEN, Unexplained(True, ("airspeed",), 1.0 - 6.6 / 7.2)),
        (8.0, 4.4, NOTHING, Unexplained(True, (), 0.5)),  # half of the gap is still open
    ],
)
def test_beside_names_the_share_left_is_what_is_not_closed(
    before: float, after: float, rest: Unexplained, expected: Unexplained
) -> None:
    left = unexplained(rest, gap_of(of_force(before), of_force(after), of_force(0.8)), named=True)
    assert (left.significant, left.depends_on) == (expected.significant, expected.depends_on)
    assert left.fraction == pytest.approx(expected.fraction)


def test_the_first_third_can_be_held_out_in_place_of_the_last() -> None:
    t_s = np.arange(0.0, 30.0, 0.01)
    flight = cast(Samples, SimpleNamespace(t_s=t_s, valid=np.ones(len(t_s), bool)))
    last, first = pooled.split([flight], []), pooled.split([flight], [], first=True)
    assert t_s[last.holdout[0]].min() == pytest.approx(20.0, abs=0.02)
    assert t_s[first.holdout[0]].max() == pytest.approx(10.0, abs=0.02)
    for each in (last, first):  # two seconds apart
        apart = np.abs(t_s[each.fit[0]][:, None] - t_s[each.holdout[0]][None, ::50]).min()
        assert apart >= 1.98


@pytest.mark.parametrize(
    ("named", "significant", "closed", "adopted"),
    [
        (True, False, 0.95, True),
        (True, False, 0.5, False),
        (True, True, 0.95, False),
        (False, False, 0.95, False),
        (True, False, None, False),
    ],
)
def test_what_the_last_third_taught_is_said_only_where_it_explains_all(
    monkeypatch: pytest.MonkeyPatch, named: bool, significant: bool, closed: float | None, adopted: bool
) -> None:
    turned = SimpleNamespace(
        found=(SimpleNamespace(name="new"),) * named, rejected=(), unexplained=Unexplained(significant)
    )
    of = pooled.FitHoldoutSplit((), (), ())
    monkeypatch.setattr(workflow, "concluded", lambda *given: (turned, given[1], None))
    monkeypatch.setattr(workflow, "held_out_gap", lambda *given: SimpleNamespace(closed=closed))
    said = (SimpleNamespace(found=(), rejected=()), of, None)
    got = workflow._turned_round(cast(Vehicle, None), (), cast(Any, said), "")
    assert (got is not said) == adopted


@pytest.mark.parametrize(
    ("late", "names", "adopted"),
    [(True, ("old", "new"), True), (True, ("new",), False), (False, ("old", "new"), False)],
)
def test_beside_names_what_comes_late_is_learned_from_only_where_they_stay(
    monkeypatch: pytest.MonkeyPatch, late: bool, names: tuple[str, ...], adopted: bool
) -> None:
    of = pooled.FitHoldoutSplit((), (), ())
    turned = SimpleNamespace(
        found=tuple(SimpleNamespace(name=each) for each in names), unexplained=NOTHING, rejected=()
    )
    monkeypatch.setattr(workflow.pooled, "split_by_power", lambda *given: of if late else None)
    monkeypatch.setattr(workflow, "concluded", lambda *given: (turned, given[1], None))
    monkeypatch.setattr(workflow, "held_out_gap", lambda *given: SimpleNamespace(closed=1.0))
    said = (SimpleNamespace(found=(SimpleNamespace(name="old"),), vehicle=None, rejected=()), of, None)
    got = workflow._turned_round(cast(Vehicle, None), (), cast(Any, said), "")
    assert (got is not said) == adopted


def hovers_until(moves_s: float) -> tuple[Samples, pooled.compare.Residual]:
    """A flight of 30 s that is off by five times its noise once it moves."""
    t_s = np.arange(0.0, 30.0, 0.01)
    y = np.ones((len(t_s), 12))
    y[t_s >= moves_s, 0] = 5.0
    flight = cast(Samples, SimpleNamespace(t_s=t_s, valid=np.ones(len(t_s), bool)))
    return flight, pooled.compare.Residual(y, np.ones(12))


@pytest.mark.parametrize("moves_s", [0.0, 21.0, 24.0])
def test_what_a_flight_is_off_by_is_held_out_by_its_last_third(monkeypatch: pytest.MonkeyPatch, moves_s: float) -> None:
    """Squares: 6 a row while it hovers, 30 once it moves; one that always moves needs no other split."""
    flight, off = hovers_until(moves_s)
    monkeypatch.setattr(pooled.compare, "residual", lambda *given: off)
    of = pooled.split_by_power(cast(Vehicle, None), [flight])
    if moves_s == 0.0:
        assert of is None
        return
    assert of is not None
    expected = moves_s + (2.0 / 3.0 * (6.0 * moves_s + 30.0 * (30.0 - moves_s)) - 6.0 * moves_s) / 30.0
    assert flight.t_s[of.holdout[0]].min() == pytest.approx(expected, abs=0.02)
    assert flight.t_s[of.fit[0]].max() == pytest.approx(expected - 2.0, abs=0.02)


@pytest.mark.parametrize(
    ("passes_s", "held_from_s"),
    [
        (((4, 7), (12, 15)), 12.0),  # both early: the last third of the time shows nothing of them
        (((22, 24), (27, 29)), 27.0),  # both late: nor do the first two
        (((3, 5), (9, 11), (15, 17), (21, 23)), 21.0),
        (((12, 15),), None),  # one only can't be learned from and judged by
        (((12, 14), (15, 17)), None),  # nor can two that are hardly apart
        ((), None),
    ],
)
def test_passes_are_parted_wherever_in_the_flight_they_are(
    monkeypatch: pytest.MonkeyPatch, passes_s: tuple[tuple[int, int], ...], held_from_s: float | None
) -> None:
    flight, off = hovers_until(30.0)
    for begin, end in passes_s:
        off.y[(flight.t_s >= begin) & (flight.t_s < end), 2] = 5.0
    monkeypatch.setattr(pooled.compare, "residual", lambda *given: off)
    of = pooled.split_by_passes(cast(Vehicle, None), [flight])
    if held_from_s is None:
        assert of is None
        return
    assert of is not None
    assert flight.t_s[of.holdout[0]].min() == pytest.approx(held_from_s)
    assert flight.t_s[of.fit[0]].max() == pytest.approx(held_from_s - 2.0, abs=0.02)


@pytest.mark.parametrize(
    ("named", "closed", "before", "adopted"),
    [
        (True, 0.2, 0.4, True),  # four and seven tenths of the rms: 0.96 and 0.84 of the mean square
        (True, 0.7, 0.2, False),
        (True, 0.2, 0.7, False),
        (False, 0.2, 0.2, False),
    ],
)
def test_what_the_last_of_the_disagreement_confirms_is_said_where_most_is_closed(
    monkeypatch: pytest.MonkeyPatch, named: bool, closed: float, before: float, adopted: bool
) -> None:
    """`closed` and `before`: what is left of 1 m/s^2 over a noise of nothing, by the new split and by the first."""

    def left(rms: float) -> Gap:
        return gap_of(of_force(1.0), of_force(rms), of_force(0.0))

    of = pooled.FitHoldoutSplit((), (), ())
    told = SimpleNamespace(found=("effect",) * named, rejected=(), unexplained=Unexplained(True))
    monkeypatch.setattr(workflow, "concluded", lambda *given: (told, of, left(closed)))
    monkeypatch.setattr(workflow, "held_out_gap", lambda *given: left(before))
    said = (SimpleNamespace(rejected=()), of, None)
    got = workflow._split_by_what_is_off(cast(Vehicle, None), of, cast(Any, said), "")
    assert (got is not said) == adopted


def test_a_name_of_one_parameter_whose_own_interval_holds_the_files_value_is_taken_back_before_it_is_refined(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """PX4's flight 53: a lag of 47.8 +- 1.8 ms for 48 was refined, with other names, to 42.7 +- 4.5 and told."""
    of = pooled.split([as_samples(fly(quad(), quad(), wander(), seconds=20.0, seed=3))], [])
    naming = name(quad(), of.flights, of.fit, of.holdout)
    assert not naming.found
    lag_s = quad().rotors.time_constant_s
    refined = []

    def pulled_away(_: Vehicle, named: Selection, of: pooled.FitHoldoutSplit) -> Any:
        refined.extend(each.name for each in named.found)
        return named, of

    monkeypatch.setattr(concluded, "_refined", pulled_away)
    for low, high, reaches in ((0.9, 1.05, False), (0.8, 0.95, True)):
        lag = IdentifiedEffect(
            "motor_lag", {"time_constant_s": Estimate(lag_s, *shares(lag_s, low, high))}, -50.0, 0.5, 0.0
        )
        told, _, _ = concluded._judged(quad(), replace(naming, found=(lag,)), of, lambda *given: None)
        assert ("motor_lag" in refined) is reaches
        assert any("estimated together" in each.reason for each in told.rejected) is not reaches


def shares(value: float, low: float, high: float) -> tuple[float, float, float]:
    """Of a value: the middle of a range, and its ends."""
    return value * (low + high) / 2.0, value * low, value * high
