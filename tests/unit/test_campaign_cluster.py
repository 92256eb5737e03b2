"""A real Dask scheduler and real workers on loopback: killed, stopped, gone and back; no row is lost or doubled."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from flightstack.cli.campaign.plan import Plan
from flightstack.errors import InputError

pytest.importorskip("distributed")

from flightstack.cli.campaign.cluster import Cluster
from flightstack.cli.campaign.run import CampaignOptions, campaign
from tests.branches import branching


class Dask:
    """Scheduler and workers as processes of their own."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = int(probe.getsockname()[1])
        self.address, self._folder = f"tcp://127.0.0.1:{self.port}", folder
        self.processes: list[subprocess.Popen[bytes]] = []
        self.scheduler = self.start_scheduler()
        self.workers = [self.start_worker() for _ in range(2)]

    def _start(self, *arguments: str) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "DASK_DISTRIBUTED__VERSION": "2"}
        process = subprocess.Popen(
            [sys.executable, "-m", "distributed.cli." + arguments[0], *arguments[1:]],
            cwd=self._folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self.processes.append(process)
        return process

    def start_scheduler(self) -> subprocess.Popen[bytes]:
        return self._start("dask_scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard")

    def start_worker(self) -> subprocess.Popen[bytes]:
        return self._start("dask_worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard")

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dask]:
    started = Dask(tmp_path_factory.mktemp("dask"))
    yield started
    started.close()


def _fly(
    dask: Dask, folder: Path, texts: list[str], at: dict[int, Callable[[], object]], workers: int = 2
) -> list[str]:
    """Outcomes by flight; `at`: what happens once so many flights are done."""
    plans = [Plan(i, i, "x", {}, text, 2.0) for i, text in enumerate(texts)]
    found: dict[int, str] = {}
    with Cluster(dask.address, folder, "failures", module="strange_flights") as cluster:
        cluster._client.wait_for_workers(workers, timeout=60)
        for done in cluster.run(plans, lambda: "", lambda: None):
            assert done.plan.flight not in found
            found[done.plan.flight] = str(done.row["outcome"])
            at.pop(len(found), lambda: None)()
    assert not at
    return [found[i] for i in range(len(texts))]


def test_flights_that_crash_there_are_counted_as_here(dask: Dask, tmp_path: Path) -> None:
    texts = ["slow", "segfault", "slow", "exit", "slow"]
    assert _fly(dask, tmp_path, texts, {}) == ["completed", "crashed", "completed", "crashed", "completed"]


def test_a_killed_and_a_stalled_worker_lose_and_double_nothing(dask: Dask, tmp_path: Path) -> None:
    third = dask.start_worker()
    at: dict[int, Callable[[], object]] = {4: dask.workers[0].kill, 8: lambda: third.send_signal(signal.SIGSTOP)}
    assert _fly(dask, tmp_path, ["slow"] * 30, at, workers=3) == ["completed"] * 30
    third.kill()


def test_a_scheduler_that_goes_and_comes_back_loses_and_doubles_nothing(dask: Dask, tmp_path: Path) -> None:
    def away_and_back() -> None:
        dask.scheduler.kill()
        dask.scheduler.wait()
        dask.scheduler = dask.start_scheduler()
        dask.start_worker()

    assert _fly(dask, tmp_path, ["slow"] * 16, {5: away_and_back}, workers=1) == ["completed"] * 16


@pytest.fixture
def leaving(request: pytest.FixtureRequest) -> None:
    """A client that finds no scheduler leaves its thread behind, which Dask alone could end: it goes with the child."""
    branching(request)


@pytest.mark.usefixtures("leaving")
def test_a_scheduler_that_is_not_there_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flightstack.cli.campaign.cluster._CONNECT_S", 0.5)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
    with pytest.raises(InputError, match="no scheduler answers there") as caught:
        Cluster(address, tmp_path, "none")
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("leaving")
def test_nothing_is_compiled_here_for_a_scheduler_that_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flightstack.cli.campaign.cluster._CONNECT_S", 0.5)
    monkeypatch.setattr("flightstack.cli.campaign.run.ensure_compiled", lambda told: pytest.fail("compiles first"))
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
    file = Path(__file__).resolve().parents[2] / "campaigns/small.toml"
    with pytest.raises(InputError, match="no scheduler answers there"):
        campaign(CampaignOptions(file, tmp_path / "out", False, None, address), stop_requested=lambda: "")
    assert not (tmp_path / "out").exists()
