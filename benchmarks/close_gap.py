"""End to end: fly what the file lacks, ask the log, fly again with the corrected file, put before and after on a page.

    python -m benchmarks.close_gap --out DIR       against the simulator, a load and drag hidden (make close-gap)
    python -m benchmarks.px4 gap                    against a real PX4 (benchmarks/px4/subjects/gap.py)

`DIR/page.md` is the page; `DIR/gap/` holds the report, gap.json and the corrected vehicle.toml.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flightstack.api import FlyOptions, fly, load_vehicle, vehicle_to_toml
from flightstack.cli.certify import certify
from flightstack.cli.gap import GapOptions, find_gap
from flightstack.gap.result import GapResult
from flightstack.vehicle import with_effects

Flown = tuple[Path, dict[str, Any]]
"""A flight's log and its result (`flightstack.fly/1`)."""
HIDDEN = {"payload": {"mass_kg": 0.2}, "linear_drag": {f"d_{axis}_kgps": 0.4 for axis in "xyz"}}


@dataclass(frozen=True, slots=True)
class Closed:
    """What became of it."""

    before: dict[str, Any]
    after: dict[str, Any]
    result: GapResult
    page: Path


def close(flown: Callable[[str, Path], Flown], vehicle: str, out: Path) -> Closed:
    """Fly, ask, fly again: `flown` flies with a vehicle file and puts its files into a folder."""
    log, before = flown(vehicle, out / "before")
    result = find_gap(GapOptions(logs=(log,), vehicle=vehicle, out=out / "gap"))
    _, after = flown(str(out / "gap" / "vehicle.toml"), out / "after")
    page = out / "page.md"
    page.write_text(_page(result, before, after), encoding="utf-8")
    return Closed(before, after, result, page)


def _page(result: GapResult, before: dict[str, Any], after: dict[str, Any]) -> str:
    rows = [("what", "before", "after")]
    for words, table, field in (
        ("tracking error, settled, m", "tracking", "rmse_settled_m"),
        ("tracking error, greatest, m", "tracking", "max_m"),
        ("thrust gain that was learned (1: as the file says)", "gp", "thrust_gain"),
        ("certified area, m^2/s", "certificate", "area_m2ps"),
    ):
        pair = [_number(each.get(table, {}).get(field)) for each in (before, after)]
        rows += [(words, *pair)] if set(pair) != {"–"} else []
    margins = [each.get("certificate", {}).get("margins") or {} for each in (before, after)]
    rows += [
        (f"margin: {name}, m/s^2", *(_number(each.get(name)) for each in margins))
        for name in {**margins[0], **margins[1]}
    ]
    gap = result.gap
    for words, field in (
        ("force, one step, m/s^2", "one_step_mps2"),
        ("turning, one step, rad/s^2", "one_step_radps2"),
    ):
        rows.append((f"model against log: {words}", *(_number(getattr(f, field)) for f in (gap.before, gap.after))))
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join(["# Before and after", "", result.sentence, "", lines[0], "| --- | --: | --: |", *lines[1:], ""])


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def simulated(truth: Path, *, learning: bool, duration_s: float | None) -> Callable[[str, Path], Flown]:
    """A flight of `figure8` on the simulator, in which `truth` is what flies."""

    def flown(vehicle: str, out: Path) -> Flown:
        options = FlyOptions(
            scenario="figure8", truth=str(truth), vehicle=vehicle, learning=learning, duration_s=duration_s, out=out
        )
        result = fly(options)
        return Path(str(result.log)), result.as_json()

    return flown


def hidden_truth(folder: Path) -> Path:
    """The vehicle that really flies: quad-x with a load and drag."""
    folder.mkdir(parents=True, exist_ok=True)
    truth = folder / "truth.toml"
    truth.write_text(vehicle_to_toml(with_effects(load_vehicle("quad-x")[0], HIDDEN)), encoding="utf-8")
    return truth


def certified(flown: Callable[[str, Path], Flown], truth: Path) -> Callable[[str, Path], Flown]:
    """The same with a certificate that is learned before each flight."""

    def both(vehicle: str, out: Path) -> Flown:
        options = FlyOptions(scenario="paper-barrier", truth=str(truth), vehicle=vehicle, out=out / "certify")
        told = certify(options, stop_requested=lambda: "").as_json()
        log, result = flown(vehicle, out)
        return log, {**result, "certificate": told}

    return both


def main() -> int:
    """One command: the page's path and what it says."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/close-gap"))
    out = parser.parse_args().out
    truth = hidden_truth(out)
    closed = close(certified(simulated(truth, learning=True, duration_s=None), truth), "quad-x", out)
    print(closed.page.read_text("utf-8"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
