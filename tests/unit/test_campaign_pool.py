"""Workers that crash, stand still or are killed: every flight is accounted for once, and none outlives its campaign."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from flightstack.cli.campaign.plan import Plan
from flightstack.cli.campaign.pool import Done, Pool


def _plan(flight: int, text: str, limit_s: float = 60.0) -> Plan:
    return Plan(flight, flight, "x", {}, text, limit_s)


@pytest.fixture
def pool(tmp_path: Path) -> Iterator[Pool]:
    with Pool(2, tmp_path, "failures", module="strange_flights") as opened:
        yield opened


def _run(pool: Pool, plans: list[Plan]) -> dict[int, Done]:
    done = list(pool.run(plans, lambda: "", lambda: None))
    assert len(done) == len({each.plan.flight for each in done}) == len(plans)
    return {each.plan.flight: each for each in done}


def test_what_crashes_or_never_ends_is_counted_and_the_others_are_flown(pool: Pool) -> None:
    texts = ["fine", "segfault", "fine", "exit", "hang", *["fine"] * 6]
    done = _run(pool, [_plan(i, text, 0.5 if text == "hang" else 60.0) for i, text in enumerate(texts)])
    assert [done[i].row["outcome"] for i in range(5)] == ["completed", "crashed", "completed", "crashed", "timed-out"]
    assert all(done[i].row["outcome"] == "completed" for i in range(5, 11))
    assert "SIGSEGV" in done[1].row["reason"]
    assert "exit code 7" in done[3].row["reason"]
    assert [done[i].attempts for i in (1, 3, 4)] == [2, 2, 2]


def test_a_flight_whose_worker_was_killed_once_is_flown_again(pool: Pool) -> None:
    done = _run(pool, [_plan(0, "once"), _plan(1, "fine")])
    assert done[0].row["outcome"] == "completed"
    assert done[0].attempts == 2


def test_a_killed_nursery_is_replaced(pool: Pool) -> None:
    assert _run(pool, [_plan(0, "fine")])[0].row["outcome"] == "completed"
    assert pool._nursery is not None
    os.kill(pool._nursery._process.pid, signal.SIGKILL)
    done = _run(pool, [_plan(i, "fine") for i in range(1, 5)])
    assert all(each.row["outcome"] == "completed" for each in done.values())


def test_workers_end_with_their_parent(tmp_path: Path) -> None:
    """The parent is killed, without a chance to say anything, while its workers hang."""
    code = (
        "import sys\nfrom pathlib import Path\nfrom flightstack.cli.campaign.plan import Plan\n"
        "from flightstack.cli.campaign.pool import Pool\n"
        "pool = Pool(2, Path(sys.argv[1]), 'none', module='strange_flights')\n"
        "plans = [Plan(i, i, 'x', {}, 'hang', 600.0) for i in range(2)]\n"
        "told = lambda: print(*[w.pid for w in pool._workers], pool._nursery._process.pid, flush=True)\n"
        "list(pool.run(plans, lambda: '', told))\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    parent = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], env=environment, stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout is not None
    pids = [int(word) for word in parent.stdout.readline().split()]
    assert len(pids) == 3
    parent.kill()
    parent.wait()
    until = time.monotonic() + 20.0
    while (alive := [pid for pid in pids if _is_alive(pid)]) and time.monotonic() < until:
        os.sched_yield()
    assert not alive
    parent.stdout.close()


def _is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] not in ("Z", "X")
    except OSError:
        return False
