"""The frozen set of gap verdicts: drawn flights whose answers every commit must repeat.

    python -m benchmarks.gap_frozen             compares (make gap-frozen), exit 1 where one differs
    python -m benchmarks.gap_frozen --freeze    keeps today's answers as the frozen ones

The answers stand in benchmarks/gap_frozen.json.  The flights are drawn anew from their seeds (`benchmarks.gap_cases`)
into runs/gap-frozen; a number may differ by 1e-9 of itself: another processor's arithmetic differs in the last bits.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from functools import cache
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # with two, all guessed differs by 1e-5: sums in another order

import numpy as np

from benchmarks.gap_cases import make, write
from benchmarks.gap_rough import spoilt
from flightstack.cli.files import load_vehicle
from flightstack.gap.result import GapResult
from flightstack.gap.workflow import analyse
from flightstack.types import InputError
from flightstack.vehicle import vehicle_to_toml

ROOT = Path(__file__).resolve().parents[1]
FROZEN = Path(__file__).with_suffix(".json")
FOLDER = ROOT / "runs" / "gap-frozen"
TOLERANCE = 1e-9
CASES: dict[str, tuple[str, int, str, str]] = {
    # name: kind, seed, plant, what of the file is spoilt ("+": with ranges)
    "clean": ("clean", 600_000, "native", ""),
    "clean jsbsim": ("clean", 600_001, "jsbsim", ""),
    "payload": ("one:payload", 600_002, "native", ""),
    "weak rotor": ("one:rotor_fault", 600_003, "native", ""),
    "shifted mass": ("one:com_offset", 600_004, "jsbsim", ""),
    "motor lag": ("one:motor_lag", 600_005, "native", ""),
    "battery sag": ("one:battery_sag", 600_006, "native", ""),
    "rotor drag": ("one:rotor_drag", 600_007, "jsbsim", ""),
    "ground effect": ("one:ground_effect", 600_008, "native", ""),
    "wind": ("one:steady_wind", 600_009, "native", ""),
    "turbulence": ("one:turbulence", 600_010, "native", ""),
    "slung load": ("one:slung_load", 600_011, "native", ""),
    "misaligned": ("one:attitude_misalignment", 600_012, "native", ""),
    "two": ("two", 600_013, "native", ""),
    "two jsbsim": ("two", 600_014, "jsbsim", ""),
    "three": ("three", 600_015, "native", ""),
    "three more": ("three", 600_016, "native", ""),
    "jet": ("outside:jet", 600_017, "native", ""),
    "slosh": ("outside:slosh", 600_018, "native", ""),
    "fading thrust": ("outside:fading_thrust", 600_019, "native", ""),
    "wake": ("outside:wake", 600_020, "native", ""),
    "all guessed": ("one:linear_drag", 600_021, "native", "all"),
    "inertia guessed, ranges": ("one:payload", 600_022, "native", "inertia+"),
    "curve wrong": ("clean", 600_023, "native", "curve"),
}
Verdict = dict[str, Any]


def files(name: str) -> tuple[Path, Path]:
    """Log and vehicle file of a case, drawn where they are not there yet."""
    kind, seed, plant, wrong = CASES[name]
    stem = name.replace(" ", "-").replace(",", "")
    log, vehicle = FOLDER / f"{stem}.csv", FOLDER / f"{stem}.toml"
    if not vehicle.exists():
        case = make(kind, seed, plant=plant)
        FOLDER.mkdir(parents=True, exist_ok=True)
        write(case, FOLDER, stem)
        if wrong:
            rng = np.random.default_rng([seed, 7])
            rough = spoilt(case.believed, wrong.removesuffix("+"), wrong.endswith("+"), rng)
            vehicle.write_text(vehicle_to_toml(rough), encoding="utf-8")
    return log, vehicle


@cache
def _paths(name: str) -> tuple[Path, Path]:
    return files(name)


def verdict(name: str) -> Verdict:
    """What the workflow says of a case."""
    log, vehicle = _paths(name)
    try:
        return said(analyse([log], load_vehicle(str(vehicle))[0]))
    except InputError as error:
        return {"refused": str(error).replace(str(FOLDER), "")}


def said(result: GapResult) -> Verdict:
    """The answer's fields, but for the page."""
    return {
        "names": {
            f.name: {
                "twins": list(f.indistinguishable_from),
                "parameters": {p: [float(e.estimate), float(e.low), float(e.high)] for p, e in f.parameters.items()},
            }
            for f in result.found
        },
        "unexplained": result.unexplained.significant,
        "depends_on": list(result.unexplained.depends_on),
        "closed": None if result.gap.closed is None else float(result.gap.closed),
    }


def words(of: Verdict) -> str:
    """The answer without its numbers: what a reader acts upon."""
    if "refused" in of:
        return "refused"
    names = [f"{name} ({', '.join(sorted(each['twins']))})" for name, each in sorted(of["names"].items())]
    left = [f"unexplained: {', '.join(of['depends_on'])}"] if of["unexplained"] else []
    return "; ".join(names + left) or "nothing"


def different(then: Any, now: Any, place: str = "") -> list[str]:
    """Where two answers differ by more than the tolerance."""
    if isinstance(then, dict) and isinstance(now, dict):
        apart = [f"{place}.{key} only in one" for key in sorted(then.keys() ^ now.keys())]
        return apart + [w for key in then if key in now for w in different(then[key], now[key], f"{place}.{key}")]
    if isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        return [w for k, pair in enumerate(zip(then, now, strict=True)) for w in different(*pair, f"{place}[{k}]")]
    if isinstance(then, float) and isinstance(now, float):
        close = math.isclose(then, now, rel_tol=TOLERANCE, abs_tol=TOLERANCE) or then == now
        return [] if close or (math.isnan(then) and math.isnan(now)) else [f"{place}: {then:.9g}, now {now:.9g}"]
    return [] if then == now else [f"{place}: {then}, now {now}"]


def main() -> int:
    """Compare, or freeze."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--freeze", action="store_true")
    parser.add_argument("--case", action="append", choices=list(CASES), help="only this (may be repeated)")
    options = parser.parse_args()
    kept: dict[str, Verdict] = json.loads(FROZEN.read_text(encoding="utf-8")) if FROZEN.exists() else {}
    apart = 0
    for name in options.case or CASES:
        now = json.loads(json.dumps(verdict(name)))
        if options.freeze:
            kept[name] = now
        wrong = different(kept[name], now) if name in kept else ["never frozen"]
        apart += bool(wrong)
        print(f"{name}: {words(now)}{'' if not wrong else '   DIFFERS ' + '; '.join(wrong[:3])}", flush=True)
    if options.freeze:
        text = json.dumps({name: kept[name] for name in CASES if name in kept}, indent=1, allow_nan=True)
        FROZEN.write_text(text + "\n", encoding="utf-8")
    print(f"{apart} of {len(options.case or CASES)} differ from the frozen answers")
    return int(apart > 0)


if __name__ == "__main__":
    sys.exit(main())
