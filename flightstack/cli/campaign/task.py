"""A campaign of something else than flights of `fly`: a Python function that is called with values and a seed.

    def measure(values: dict, seed: int, folder: Path) -> dict

It gives plain data back, as JSON has it; `failure`, a text, says why it did not go well.  InputError: refused.  The
text of such a flight is a campaign file of one flight.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from flightstack.cli.campaign.outcomes import COMPLETED, FAILED
from flightstack.errors import InputError
from flightstack.toml_text import toml_text

Task = Callable[[dict[str, Any], int, Path], dict[str, Any]]


def task_text(task: str, values: Mapping[str, Any], seed: int) -> str:
    """The campaign file of one call."""
    return toml_text(
        {
            "schema": "flightstack.campaign/1", "task": task, "seeds": {"from": seed}, "count": 1,
            "vary": {name: [value] for name, value in values.items()},
        }
    )  # fmt: skip


def function(task: str) -> Task:
    """The function of MODULE:FUNCTION, looked for in the working directory too; InputError where there is none."""
    module, _, name = task.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        found = getattr(importlib.import_module(module), name, None)
    except Exception as error:  # whatever a module does when it is imported
        words = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"task = {task}: {words}") from None
    if not callable(found):
        raise InputError(f"task = {task}: {module} has no function {name}")
    made: Task = found
    return made


def called(text: str, folder: Path) -> dict[str, Any] | None:
    """Call what the text asks for: outcome, reason, result; None where the text is a scenario."""
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None
    if "task" not in data:
        return None
    values = {name: listed[0] for name, listed in data.get("vary", {}).items()}
    result = function(data["task"])(values, data["seeds"]["from"], folder)
    failure = " ".join(str(result.pop("failure", "")).split())
    json.dumps(result)  # what is no plain data is said here, not by a process that ends
    return {"outcome": FAILED if failure else COMPLETED, "reason": failure, "result": result}
