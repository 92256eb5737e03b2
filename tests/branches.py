"""Tests that go on from one flown situation, each in a process of its own that branches off there.

What many tests begin with, a vehicle in the middle of its track, is flown once for all of them; none sees what another
has done to it.  A fixture hands out the situation and calls `branching`; the test's body then runs in a child.
"""

from __future__ import annotations

import os
import traceback
import warnings
from collections.abc import Callable

import pytest

_MARK = "branches"


def branching(request: pytest.FixtureRequest) -> None:
    """The test that asks for this fixture runs in a child process."""
    request.node.add_marker(_MARK)


def is_branching(item: pytest.Item) -> bool:
    """Whether a fixture of it has called `branching`."""
    return item.get_closest_marker(_MARK) is not None


def in_a_child(work: Callable[[], object]) -> str:
    """What `work` returns in a copy of this process, as text; what it raises there fails the test, in its words."""
    read, write = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # other threads here wait for the next test, no more
        child = os.fork()
    if not child:
        code = 1
        try:
            said, code = str(work()), 0
        except BaseException:
            said = traceback.format_exc()
        finally:
            os.write(write, said.encode()[-60_000:])  # what a pipe holds
            os._exit(code)
    os.close(write)
    with os.fdopen(read, encoding="utf-8", errors="replace") as pipe:
        said = pipe.read()
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status:
        pytest.fail(said or f"its process ended with {status}", pytrace=False)
    return said
