"""Fixtures that every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def recorded() -> Path:
    """Folder of recorded flights; a test that needs it skips where it is absent, saying so."""
    folder = os.environ.get("FLIGHTSTACK_TEST_DATA", "")
    if not folder or not Path(folder).is_dir():
        pytest.skip("no recorded flights: set FLIGHTSTACK_TEST_DATA to their folder")
    return Path(folder)
