"""The pytest plugin `flightstack`: fixtures `px4_sim` and `px4_fleet`, and a failed flight's log and page.

Loaded into every pytest run of an environment that has flightstack: it imports nothing heavy until a fixture is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from flightstack.testkit.fleet import Fleet
    from flightstack.testkit.px4_sim import Px4Sim

_FLOWN = pytest.StashKey[list[Any]]()
"""On a test: the vehicles that it has flown."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--px4-speed`, `--px4-vehicle`, `--px4-flights`."""
    group = parser.getgroup("flightstack", "flightstack's simulated PX4 (fixtures px4_sim, px4_fleet)")
    group.addoption(
        "--px4-speed", type=float, default=0.0, metavar="X",
        help="step at X times real time, to watch a test with a ground station (default: as fast as it goes)",
    )  # fmt: skip
    group.addoption("--px4-vehicle", default=None, metavar="NAME|FILE", help="the vehicle that flies (default: quad-x)")
    group.addoption(
        "--px4-flights", type=Path, default=None, metavar="DIR",
        help="where logs and reports of failed tests are kept (default: pytest's folder of temporary files)",
    )  # fmt: skip


def _options(request: pytest.FixtureRequest, folder: Path, sysid: int) -> Any:
    from flightstack.testkit.px4_sim import Px4Options

    config = request.config
    return Px4Options(
        vehicle=config.getoption("--px4-vehicle"),
        speed=config.getoption("--px4-speed"),
        sysid=sysid,
        folder=folder,
    )


def _folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of this test's own."""
    name = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in request.node.name)[:60]
    kept: Path | None = request.config.getoption("--px4-flights")
    return tmp_path_factory.mktemp("px4") / name if kept is None else kept / name


def _start(request: pytest.FixtureRequest, folder: Path, sysid: int) -> Px4Sim:
    from flightstack.errors import InputError
    from flightstack.testkit.px4_sim import Px4Sim

    plugins = request.config.pluginmanager
    terminal, capture = plugins.get_plugin("terminalreporter"), plugins.get_plugin("capturemanager")

    def say(text: str) -> None:
        if terminal is not None:  # a worker of pytest-xdist has none
            with nullcontext() if capture is None else capture.global_and_fixture_disabled():
                terminal.ensure_newline()
                terminal.write_line(f"px4_sim: {text}")

    try:
        vehicle = Px4Sim(_options(request, folder, sysid), say)
    except InputError as error:
        raise pytest.UsageError(str(error)) from None
    request.node.stash.setdefault(_FLOWN, []).append(vehicle)
    return vehicle


@pytest.fixture
def px4_sim(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Px4Sim]:
    """A simulated PX4 whose time moves with `px4_sim.step(seconds)`: see flightstack.testkit.Px4Sim."""
    vehicle = _start(request, _folder(request, tmp_path_factory), 1)
    yield vehicle
    vehicle.close()


@pytest.fixture
def px4_fleet(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[int], Fleet]]:
    """`px4_fleet(n)` gives n simulated PX4s, system ids 1 to n, that move together with `.step(seconds)`."""
    from flightstack.testkit.fleet import Fleet

    folder = _folder(request, tmp_path_factory)
    fleets: list[Fleet] = []

    def make(n: int) -> Fleet:
        if n < 1:
            raise ValueError(f"px4_fleet gives one vehicle or more, not {n}")
        flying = sum(len(fleet) for fleet in fleets)
        fleets.append(Fleet([_start(request, folder, flying + number + 1) for number in range(n)]))
        return fleets[-1]

    yield make
    for fleet in fleets:
        fleet.close()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
    """Keep log and report of what a failed test has flown, and say where."""
    report = yield
    if report.when == "call" and report.failed:
        lines = [line for vehicle in item.stash.get(_FLOWN, []) for line in _keep(vehicle)]
        if lines:
            report.sections.append(("simulated PX4", "\n".join(lines)))
    return report


def _keep(vehicle: Px4Sim) -> Iterator[str]:
    yield f"vehicle {vehicle.options.sysid}: {vehicle.now_s:.3f} s flown, mode {vehicle.mode.title}"
    try:
        log = vehicle.write_log(vehicle.options.folder)
        yield f"log    {log}"
        yield f"report {vehicle.write_report(vehicle.options.folder, log)}"
    except Exception as error:  # a test's own failure must be seen whatever happens here
        yield f"the flight could not be kept: {error}"
