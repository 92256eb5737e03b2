"""The barrier campaign's own arithmetic, and its adversary's place in the stack; what it finds is tests/attack."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from certified import certificate

from benchmarks import attack_adversary, barrier_attack, campaign
from benchmarks.attack_adversary import GRADIENT, PUSH, Adversary, Seen
from benchmarks.attack_flight import Wire
from flightstack.seams import Controller
from flightstack.types import Command, FlatOutput, Learned, Measurement, Proposal


def test_the_upper_limit_is_clopper_pearsons() -> None:
    limit = barrier_attack.upper_limit(0, 5000)
    assert limit == pytest.approx(1.0 - 0.05 ** (1.0 / 5000), rel=1e-9)  # closed form where nothing was hit
    assert barrier_attack.upper_limit(1, 10) == pytest.approx(0.394163, abs=1e-6)  # published tables
    assert barrier_attack.upper_limit(0, 0) is None
    assert barrier_attack.upper_limit(3, 3) == 1.0


def _row(**more: Any) -> dict[str, Any]:
    row = {"share": 1.0, "least_h": 0.2, "outside": 0, "infeasible": 0, "falsified": 0, "premises": 10}
    return row | {"premises_true": 10} | more


def _block(*rows: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"engaged_s": 15.0, "refused": "", "flights": list(rows), "cpu_s": 1.0} | more


def test_an_exit_counts_even_where_the_flight_ended_soon_after() -> None:
    s = barrier_attack.summary([_block(_row(), _row(share=0.02, outside=3, least_h=-0.4, falsified=1))])
    assert (s["left"], s["counted"], s["ended_early"], s["falsified"]) == (1, 1, 1, 1)
    assert s["least_h"] == -0.4


def test_refused_truths_and_truths_without_a_certificate_are_counted_apart() -> None:
    s = barrier_attack.summary(
        [_block(_row()), _block(refused="too heavy", engaged_s=None), _block(engaged_s=None), _block(lost="fault")]
    )
    assert (s["blocks"], s["refused"], s["truths"], s["engaged"], s["lost"]) == (4, 1, 2, 1, 1)


def test_a_campaign_in_which_the_planted_fault_shows_no_exit_has_not_passed() -> None:
    planted = next(name for name, kind in barrier_attack.KINDS.items() if not kind.torque)
    sound = next(name for name, kind in barrier_attack.KINDS.items() if kind.torque)
    flights = [_row() for _ in range(60)]
    good = [_block(*flights, kind=sound), _block(*flights[:-1], _row(outside=1), kind=planted)]
    assert barrier_attack.passed({"blocks": good})
    assert not barrier_attack.passed({"blocks": [good[0], _block(*flights, kind=planted)]})
    assert not barrier_attack.passed({"blocks": [_block(_row(outside=1), kind=sound), good[1]]})
    assert not barrier_attack.passed({"blocks": [_block(_row(infeasible=1), kind=sound), good[1]]})


def test_the_page_has_a_row_for_each_kind() -> None:
    blocks = [_block(_row(), kind=name) for name in barrier_attack.KINDS]
    head = {"date": "", "machine": "", "cores": 2, "python": "", "git_commit": "abc", "wall_s": 60.0}
    text = barrier_attack.page(head | {"blocks": blocks}, "make campaign-barrier")
    for name in barrier_attack.KINDS:
        assert f"| {name} | 1 | 0 | 1 of 1, 100 % | 1 | 1 | 0 |" in text


def test_wherever_the_campaign_is_cut_each_kind_has_had_its_share() -> None:
    jobs = barrier_attack.jobs_of(False)
    kinds = {name: kind for name, kind in barrier_attack.KINDS.items() if barrier_attack.there(kind.scenario)}
    assert len(set(jobs)) == len(jobs) == sum(kind.blocks for kind in kinds.values())
    half = [job[0] for job in jobs[: len(jobs) // 2]]
    for name, kind in kinds.items():
        assert abs(half.count(name) - 0.5 * kind.blocks) <= 1.5


def test_after_its_time_a_campaign_begins_nothing_new_and_goes_on_later(tmp_path: Path) -> None:
    journal = tmp_path / "journal.jsonl"
    jobs: list[campaign.Job] = [("a", k) for k in range(40)]
    campaign.run_all(jobs, abs_of, journal, 1, minutes=0.0)
    first = campaign.held_in(journal)
    assert 1 <= len(first) < 40
    campaign.run_all(jobs, abs_of, journal, 1)
    assert campaign.held_in(journal) == {job: job[1] for job in jobs}


def abs_of(job: tuple[str, int]) -> int:
    """A job for another process."""
    return abs(job[1])


def test_a_copy_of_the_process_changes_nothing_here_and_its_fault_is_told() -> None:
    here = {"changed": False}

    def work() -> dict[str, Any]:
        here["changed"] = True
        return {"changed": here["changed"]}

    assert barrier_attack._apart(work) == {"changed": True}
    assert not here["changed"]

    def fails() -> dict[str, Any]:
        raise ValueError("no")

    assert barrier_attack._apart(fails) == {"lost": "ValueError('no')"}


def test_messages_on_the_wire_are_late_and_keep_their_order() -> None:
    wire = Wire(10.0, 4.0, np.random.default_rng(1))
    for k in range(50):
        wire.send(k, 1000 * k)
    assert wire.arrived(9_999) == []
    seen: list[int] = []
    for now_us in range(0, 70_000, 500):
        arrived = wire.arrived(now_us)
        assert all(now_us - 1000 * k >= 10_000 for k in arrived)
        seen += arrived
    assert seen == list(range(50))


class _Still:
    def init(self, now_us: int) -> None:
        return None

    def healthy(self, state: Any) -> bool:
        return True

    def step(self, state: Any, *_: Any) -> tuple[Any, Proposal]:
        return state, Proposal(12.0, np.zeros(20))


def _step(seen: Seen, pos: tuple[float, float, float]) -> Proposal:
    inner: Controller = _Still()
    adversary = Adversary(inner, seen, 0, (3.0, 20.0), np.array([4.0, 4.0, 2.0]))
    row = np.zeros(20)
    row[:3], row[6] = pos, 1.0
    measurement = Measurement(0, row, 0, 0, 0)
    sent = Command(0, 12.0, 0.5, np.zeros(3))
    state = adversary.init(0)
    return adversary.step(state, measurement, FlatOutput(np.zeros(17)), Learned.nothing(), sent, 100_000)[1]


@pytest.mark.parametrize("above", [True, False])
def test_it_pushes_where_h_falls(above: bool) -> None:
    made = certificate()
    place = np.array(made.centre_ned_m) + np.array([0.3, 0.0, -0.3 if above else 0.3])
    fast = np.array([0.2, 0.0, -0.2 if above else 0.2])
    level = np.array([1.0, 0.0, 0.0, 0.0])
    seen = Seen(np.zeros(3), lambda: (place, fast, level), made, PUSH._replace(vertical=GRADIENT))
    proposal = _step(seen, tuple(place))
    assert proposal.thrust_n == (20.0 if above else 3.0)  # further up, further down
    assert proposal.rate_frd_radps[1] < -1.0  # nose down: towards north
    assert seen.h == pytest.approx(1.0 - 0.09 - 0.16)


def test_without_a_strategy_the_nominal_controller_flies() -> None:
    level = np.array([1.0, 0.0, 0.0, 0.0])
    seen = Seen(np.zeros(3), lambda: (np.zeros(3), np.zeros(3), level), certificate(), None)
    assert _step(seen, (0.0, 0.0, 0.0)).thrust_n == 12.0


def test_the_searched_strategies_stay_in_the_cube() -> None:
    rng = np.random.default_rng(3)
    points = [attack_adversary.drawn(rng) for _ in range(3)]
    made = np.array([attack_adversary.near(points, rng) for _ in range(500)])
    assert made.min() >= 0.0
    assert made.max() <= 1.0
    assert made.std(axis=0).min() > 0.05
