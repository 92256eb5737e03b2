"""Fixtures that every test may use."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line has it, and before numpy: sums in one order

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    # Begun in a shell's background: every process of a test would inherit that Ctrl-C is ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def recorded() -> Path:
    """Folder of recorded flights; a test that needs it skips where it is absent, saying so."""
    folder = os.environ.get("FLIGHTSTACK_TEST_DATA", "")
    if not folder or not Path(folder).is_dir():
        pytest.skip("no recorded flights: set FLIGHTSTACK_TEST_DATA to their folder")
    return Path(folder)
