"""Cases that `make thorough` runs and `make test` leaves out: others that stay ask the same."""

from __future__ import annotations

import os

import pytest

THOROUGH = "FLIGHTSTACK_THOROUGH" in os.environ
ONLY_THEN = pytest.mark.skipif(not THOROUGH, reason="run by make thorough")


def thorough(*case: object) -> object:
    """A case of `pytest.mark.parametrize` that is flown only then."""
    return pytest.param(*case, marks=ONLY_THEN)
