"""Fixtures that every test may use."""

from __future__ import annotations

import gc
import os
import signal
import threading
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line has it, and before numpy: sums in one order

from flightstack.jit import Entry
from tests.branches import in_a_child, is_branching
from tests.thorough import THOROUGH

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    # Begun in a shell's background: every process of a test would inherit that Ctrl-C is ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)


Entry.checked = True  # what a compiled function is promised of its arguments is looked at

settings.register_profile(
    "any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=not THOROUGH
)
settings.load_profile(
    "any machine"
)  # how soon examples are drawn is the machine's; `make thorough` draws others each time

LONGEST = (
    "loopback/test_site_learned.py", "loopback/test_cli.py", "unit/test_stopping_certificate.py",
    "loopback/test_fly.py", "attack/test_fence.py", "unit/test_gap_gusts.py", "loopback/test_provenance.py",
    "loopback/test_shield_process.py", "loopback/test_before_flight.py", "unit/test_gap_motors.py",
    "loopback/test_campaign.py", "loopback/test_dead_man_process.py", "unit/test_gap_held.py",
    "loopback/test_set_params.py", "unit/test_gap_trim.py", "unit/test_gap_ranges.py", "client/test_mavsdk.py",
    "unit/test_campaign_cluster.py", "loopback/test_barrier_flights.py", "loopback/test_appointed_certificates.py",
    "unit/test_gap_voltage.py", "loopback/test_vehicle_gains.py", "loopback/test_site_sensors.py",
    "unit/test_gap_loop_noise.py", "unit/test_gap_estimator_bias.py", "loopback/test_site_flight.py",
    "loopback/test_fault_flights.py", "unit/test_gap_name_vehicle.py", "loopback/test_replay.py",
    "testkit/test_examples.py", "loopback/test_gap_flights.py", "loopback/test_dead_companion.py",
    "unit/test_certificate_check.py", "unit/test_certifier.py", "unit/test_vehicle_fit.py",
    "unit/test_shield_router.py", "loopback/test_px4_hil.py",
)  # fmt: skip
"""Files of 11 s and more, about the longest first: the processes end together where the last files are short."""
IN_TWO_PROCESSES = "loopback/test_reproduce_quick.py"
"""Uses both processors by itself: the very last, when no other file is left."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first, the others as they come."""
    tests = Path(__file__).parent
    places = {tests / name: place for place, name in enumerate(LONGEST)}
    places[tests / IN_TWO_PROCESSES] = len(LONGEST) + 1
    items.sort(key=lambda item: places.get(item.path, len(LONGEST)))


def pytest_collection_finish() -> None:
    """What was imported and collected stays for good: Python's collector need not look at it again."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """A test that branches off from a situation does so here."""
    if not is_branching(pyfuncitem):
        return None
    names = pyfuncitem._fixtureinfo.argnames
    in_a_child(lambda: pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in names}))
    return True


@pytest.fixture(scope="session")
def recorded() -> Path:
    """Folder of recorded flights; a test that needs it skips where it is absent, saying so."""
    folder = os.environ.get("FLIGHTSTACK_TEST_DATA", "")
    if not folder or not Path(folder).is_dir():
        pytest.skip("no recorded flights: set FLIGHTSTACK_TEST_DATA to their folder")
    return Path(folder)
