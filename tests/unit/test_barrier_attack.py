"""The barrier campaign's own arithmetic, and its adversary's place in the stack; what it finds is tests/attack."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from certified import certificate

from benchmarks import attack_adversary, attack_block, gap_rough
from benchmarks.attack_adversary import GRADIENT, PUSH, Adversary, Seen
from benchmarks.attack_flight import Wire
from benchmarks.barrier_cases import PILOTS, TASKS
from benchmarks.gap_cases import kinds
from flightstack.cli.campaign.spec import load_spec
from flightstack.cli.campaign.task import function
from flightstack.seams import Controller
from flightstack.types import Command, FlatOutput, Learned, Measurement, Proposal

ROOT = Path(__file__).resolve().parents[2]


def _row(**more: Any) -> dict[str, Any]:
    row = {"share": 1.0, "least_h": 0.2, "outside": 0, "infeasible": 0, "falsified": 0, "premises": 10}
    return row | {"premises_true": 10} | more


def test_an_exit_counts_even_where_the_flight_ended_soon_after() -> None:
    s = attack_block.told([_row(), _row(share=0.02, outside=3, least_h=-0.4, falsified=1), {"lost": "a fault"}])
    assert (s["attacks"], s["left"], s["left_counted"], s["counted"], s["ended_early"]) == (3, 1, 0, 1, 1)
    assert (s["falsified"], s["barrier"]["min_h_truth"]) == (1, -0.4)
    assert s["failure"] == "1 left, 1 lost"
    assert attack_block.told([_row(infeasible=2)])["failure"] == "2 steps infeasible"
    assert attack_block.told([_row()])["failure"] == ""


@pytest.mark.parametrize("name", ["barrier", "barrier-filters", "dither", "gap-blind", "gap-rough", "planted-tilt"])
def test_the_campaign_files_name_tasks_and_values_that_there_are(name: str) -> None:
    spec = load_spec(ROOT / f"campaigns/{name}.toml")
    assert callable(function(spec.task))
    known = {
        "barrier": {"kind": attack_block.KINDS}, "gap-blind": {"kind": kinds()}, "gap-rough": {"kind": gap_rough.KINDS},
        "barrier-filters": {"pilot": PILOTS, "task": TASKS},
    }.get(name, {})  # fmt: skip
    values = {factor.name: factor.values for factor in (*spec.factors, *spec.fixed)}
    for factor, every in known.items():
        assert set(values[factor]) == set(every)
    if name.startswith("planted"):
        assert set(values) - {"planted", "seconds", "late_ms"} <= set(attack_adversary.Strategy._fields)


def test_a_copy_of_the_process_changes_nothing_here_and_its_fault_is_told() -> None:
    here = {"changed": False}

    def work() -> dict[str, Any]:
        here["changed"] = True
        return {"changed": here["changed"]}

    assert attack_block.apart(work) == {"changed": True}
    assert not here["changed"]

    def fails() -> dict[str, Any]:
        raise ValueError("no")

    assert attack_block.apart(fails) == {"lost": "ValueError('no')"}


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
