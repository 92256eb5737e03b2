"""One flight of a campaign, in the process that calls: from a scenario file's text to a row."""

from __future__ import annotations

import errno
import gc
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flightstack.cli.campaign.outcomes import COMPLETED, CRASHED, FAILED, REFUSED
from flightstack.errors import InputError

if TYPE_CHECKING:
    from flightstack.cli import flight

Row = dict[str, Any]


def fly_text(text: str, folder: Path, *, keep: str, kept: bool, on_progress: Callable[[float], None]) -> Row:
    """Fly the scenario in `text`; log and report stay in `folder` where they are to be kept.

    `keep`: failures, all or none; `kept`: whatever comes of it.  A full disk costs the log: it is flown once more where
    temporary files lie, and without room there too it counts as crashed.  The row: outcome, reason, result (fly's JSON
    or None), wall_s, cpu_s.  Raises nothing but what ends a process.
    """
    row = _row(text, folder, keep, kept, on_progress)
    if _no_room(row):
        try:
            with tempfile.TemporaryDirectory(prefix="flightstack-campaign-") as spare:
                row = _row(text, Path(spare), "none", False, on_progress)
        except OSError as error:
            row["reason"] = f"{type(error).__name__}: {error.strerror or error}"
        if _no_room(row):
            row["outcome"] = CRASHED
    return row


def _no_room(row: Row) -> bool:
    """Whether the disk was full."""
    return os.strerror(errno.ENOSPC) in row["reason"]


def _row(text: str, folder: Path, keep: str, kept: bool, on_progress: Callable[[float], None]) -> Row:
    from flightstack.cli import flight
    from flightstack.cli.campaign.task import called

    began, cpu_s = time.perf_counter(), sum(os.times()[:4])  # with the processes that a task starts
    row: Row = {"outcome": REFUSED, "reason": "", "result": None}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if (other := called(text, folder)) is not None:
            row |= other
        else:
            scenario = folder / "scenario.toml"
            scenario.write_text(text, encoding="utf-8")
            options = flight.FlyOptions(
                scenario=str(scenario), out=folder, log_kept=keep != "none" or kept, beside=False
            )
            row |= _flown(options, folder, keep, kept, on_progress)
    except InputError as error:
        row["reason"] = " ".join(str(error).replace(str(folder / "scenario.toml"), "scenario").split())
    except OSError as error:
        row |= {"outcome": CRASHED, "reason": f"{type(error).__name__}: {error.strerror or error}"}
    except Exception as error:  # a campaign of thousands goes on
        row |= {"outcome": CRASHED, "reason": f"{type(error).__name__}: {error}"}
    finally:
        gc.collect()  # what a flight leaves behind in cycles is much for the few objects that the collector counts
    row["wall_s"], row["cpu_s"] = time.perf_counter() - began, sum(os.times()[:4]) - cpu_s
    return row


def _flown(
    options: flight.FlyOptions, folder: Path, keep: str, kept: bool, on_progress: Callable[[float], None]
) -> Row:
    from flightstack.cli import flight

    wanted: list[bool] = []

    def is_kept(result: Any) -> bool:
        wanted.append(keep == "all" or kept or (keep == "failures" and not result.passed))
        return wanted[0]

    result = flight.fly(
        options, stop_requested=lambda: "", on_progress=lambda share, phase: on_progress(share), report_wanted=is_kept
    )
    if not (wanted and wanted[0]):
        (folder / "flight.mcap").unlink(missing_ok=True)
    refused = result.link_too_slow or bool(result.contradictions)
    outcome = REFUSED if refused else COMPLETED if result.passed else FAILED
    return {"outcome": outcome, "reason": result.failure(), "result": result.as_json()}
