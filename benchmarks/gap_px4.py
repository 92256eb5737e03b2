"""The gap workflow on the logs of a real PX4 whose mass and drag are drawn: what it says beside the truth, as a table.

    python -m benchmarks.gap_px4 fly DIR [--from N] [--to N]    fly numbers N on the PX4 that PX4_HOME names
    python -m benchmarks.gap_px4 judge DIR [--from N] [--to N]  what `gap` says of their logs
    python -m benchmarks.gap_px4 bent DIR [--from N] [--to N]   inertia and lag that they show with the truth put in

A flight's number decides its mass, drag, path, length, learning and log profile.  The vehicle file has 1 kg and
1 kg/s; SIH_MASS and SIH_KDV are drawn from 1 to 1.4 and from 1 to 2.  The ULog lies beside the companion's MCAP.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from benchmarks.px4.companion import VEHICLE, fly
from benchmarks.px4.records import Bench
from benchmarks.px4.station import Px4
from flightstack.api import load_vehicle
from flightstack.gap.name import name
from flightstack.gap.naming import bench as naming_bench
from flightstack.gap.naming.design import linearise
from flightstack.gap.naming.estimate import CI
from flightstack.gap.naming.metric import metric_of
from flightstack.gap.naming.search import SelectionState, fit_from
from flightstack.gap.pooled import split
from flightstack.gap.result import GapResult
from flightstack.gap.sampled import loop_noise
from flightstack.gap.simulate import with_value
from flightstack.gap.workflow import analyse, usable_flights
from flightstack.types import InputError
from flightstack.vehicle import Vehicle, with_effects

SEED = 20261124
FAST, USUAL = 25, 1
"""SDLOG_PROFILE: with system identification and high rates; as PX4 comes."""
SECOND = 100
"""From this number on flights are second ones of the same vehicles."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """One flight to be."""

    number: int
    mass_kg: float
    drag_kgps: float
    scenario: str
    duration_s: float
    learning: bool
    profile: int


def drawn(number: int) -> Drawn:
    """The flight of this number; from 100 on it has the vehicle of number - 100, and a path of its own."""
    rng = np.random.default_rng([SEED, number])
    mass = 1.0 if rng.random() < 0.2 else round(float(rng.uniform(1.0, 1.4)), 3)
    drag = 1.0 if rng.random() < 0.2 else round(float(rng.uniform(1.0, 2.0)), 3)
    scenario = str(rng.choice(["figure8", "paper-tracking", "waypoints"], p=[0.5, 0.25, 0.25]))
    duration_s = float(rng.choice([18.0, 40.0, 60.0], p=[0.15, 0.35, 0.5]))
    learning, profile = bool(rng.random() < 0.5), FAST if rng.random() < 0.75 else USUAL
    if number >= SECOND:
        first = drawn(number - SECOND)
        mass, drag, profile = first.mass_kg, first.drag_kgps, first.profile
    return Drawn(number, mass, drag, scenario, duration_s, learning, profile)


def waypoints(number: int, duration_s: float) -> str:
    """A wandering path, a point every 2.5 s."""
    rng = np.random.default_rng([SEED, number, 1])
    count = int(duration_s / 2.5) + 1
    at = np.cumsum(rng.uniform(-2.5, 2.5, (count, 3)) * [1.0, 1.0, 0.3], axis=0)
    at[:, 2] = np.clip(at[:, 2] - 2.0, -4.0, -1.2)
    at[0] = 0.0, 0.0, -2.0
    yaw = np.cumsum(rng.uniform(-0.6, 0.6, count))
    rows = np.column_stack([at, yaw, 2.5 * np.arange(count)])
    lines = [",".join(f"{value:.2f}" for value in row) for row in rows]
    return "north_m,east_m,down_m,yaw_rad,time_s\n" + "\n".join(lines) + "\n"


def flown(home: Path, out: Path, flight: Drawn, instance: int, prefix: tuple[str, ...]) -> str:
    """Fly one and keep its logs; in words what became of it."""
    folder = out / f"f{flight.number:02d}"
    if (folder / "meta.json").exists():
        return "flown before"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    bench = Bench(home.resolve(), folder, instance, prefix, prefix)
    os.environ |= {"KEEP_LOGS": "1", "PX4_PARAM_SDLOG_PROFILE": str(flight.profile)}
    more = ["--unprotected-ok", "--believe-file", "--duration", f"{flight.duration_s:g}"]
    more += [] if flight.learning else ["--no-learning"]
    if flight.scenario == "waypoints":
        (folder / "waypoints.csv").write_text(waypoints(flight.number, flight.duration_s))
        more += ["--waypoints", str(folder / "waypoints.csv")]
        more = [word for word in more if word not in ("--duration", f"{flight.duration_s:g}")]
    old = set(home.rglob("*.ulg"))
    with Px4(bench, params={"SIH_MASS": flight.mass_kg, "SIH_KDV": flight.drag_kgps}) as px4:
        done = fly(bench, px4, flight.scenario, *more)
    new = sorted(set(home.rglob("*.ulg")) - old, key=lambda path: path.stat().st_size)
    if not new:
        raise SystemExit(
            f"error: {home}: no ULog lies there after the flight: with KEEP_LOGS=1 run.sh has to keep them"
        )
    shutil.move(new[-1], folder / "flight.ulg")
    loop, code = done.result.get("loop", {}), done.code
    shutil.move(done.folder / "flight.mcap", folder / "flight.mcap")
    (folder / "meta.json").write_text(json.dumps(asdict(flight) | {"code": code, "loop": loop}, indent=1))
    return f"exit {code}, loop {loop}, load {os.getloadavg()[0]:.1f}"


@dataclass(frozen=True, slots=True)
class Case:
    """Logs that are asked together."""

    words: str
    flight: Drawn
    logs: tuple[Path, ...]
    holdout: tuple[Path, ...] = ()


def cases(out: Path, numbers: Sequence[int]) -> Iterator[Case]:
    """Each ULog and each MCAP alone; each two of one kind and truth pooled, and one held out."""
    for number in numbers:
        folder = out / f"f{number:02d}"
        other = out / f"f{number + SECOND}"
        if not (folder / "meta.json").exists():
            continue
        for kind, file in (("ULog", "flight.ulg"), ("MCAP", "flight.mcap")):
            one, second = folder / file, other / file
            yield Case(f"{number} {kind}", drawn(number), (one,))
            if number < SECOND and second.exists():
                yield Case(f"{number} {kind}s pooled", drawn(number), (one, second))
                yield Case(f"{number} {kind}s held out", drawn(number), (one,), (second,))


@dataclass(frozen=True, slots=True)
class Judged:
    """What was said, held against the truth."""

    says: str
    names: bool
    missed: tuple[str, ...]
    """What is hidden and not named, where nothing false is said: a name, or that something is unexplained."""
    values: int
    """How many named values there are,"""
    hold: int
    """how many of their intervals hold the truth,"""
    errors: tuple[float, ...]
    """and each one's share of error."""


def judged(result: GapResult, flight: Drawn) -> Judged:
    """Hold an answer against the truth."""
    load, drag = flight.mass_kg - 1.0, flight.drag_kgps
    hidden = {effect for effect, is_hidden in (("payload", load), ("linear_drag", drag != 1.0)) if is_hidden}
    truth = {f"d_{axis}_kgps": drag for axis in "xyz"} | {"mass_kg": load, "scale": 1.0 / flight.mass_kg}
    errors, hold, words, false = [], 0, [], False
    classes: set[str] = set()
    for found in result.found:
        twins = {found.name, *found.indistinguishable_from}
        classes |= twins
        false |= not hidden & twins
        told = [(parameter, value) for parameter, value in found.parameters.items() if value.told]
        values = ", ".join(f"{value.estimate:.3g} ({value.low:.3g} to {value.high:.3g})" for _, value in told)
        words.append(f"{' or '.join((found.name, *found.indistinguishable_from))} {values}")
        for parameter, value in told:
            if found.name in ("payload", "thrust_scale", "linear_drag"):
                hold += value.low <= truth[parameter] <= value.high
                errors.append(value.estimate / truth[parameter] - 1.0 if truth[parameter] else np.inf)
    tail = "; unexplained" if result.unexplained.significant else ""
    right = hidden <= classes and not false
    missed = () if false or result.unexplained.significant else tuple(sorted(hidden - classes))
    return Judged(("; ".join(words) or "nothing") + tail, right, missed, len(errors), hold, tuple(errors))


def are_too_small(case: Case, vehicle: Vehicle, missed: Mapping[str, float]) -> bool:
    """Whether what is missed (effect -> its change) is each less than half of its 95 % interval in this case, a drag's
    on every level axis.

    The interval is that of the flights' own information (`gap.identify`), the truth takes no part in it.
    """
    flights, kept = (usable_flights(logs, vehicle) for logs in (case.logs, case.holdout))
    of = split(flights, kept)
    seen = name(vehicle, of.flights, of.fit, of.holdout).identifiable
    half = {
        effect: [CI * row.error for row in seen if (row.effect, row.parameter) in _TOLD[effect]] for effect in missed
    }
    return all(half[effect] and abs(change) < min(half[effect]) for effect, change in missed.items())


_TOLD = {
    "linear_drag": (("linear_drag", "d_x_kgps"), ("linear_drag", "d_y_kgps")),
    "payload": (("payload", "mass_kg"),),
}


def verdict(said: Judged, case: Case, vehicle: Vehicle) -> str:
    """In a word; what is missed may be more than the log can tell."""
    flight = case.flight
    if said.names:
        return "right"
    changes = {"linear_drag": flight.drag_kgps - 1.0, "payload": flight.mass_kg - 1.0}
    missed = {effect: changes[effect] for effect in said.missed}
    small = bool(missed) and are_too_small(case, vehicle, missed)
    return "right: within what the log can tell" if small else "WRONG"


def bent(case: Case, vehicle: Vehicle) -> str:
    """What the noise that a rate loop feeds back makes of the file's own inertia and lag, with nothing left open."""
    flight = case.flight
    drag = {f"d_{axis}_kgps": flight.drag_kgps for axis in "xyz"}
    truth = with_effects(vehicle, {"payload": {"mass_kg": flight.mass_kg - 1.0}, "linear_drag": drag})
    of = split(usable_flights(case.logs, vehicle), [])
    noise = max(loop_noise(samples) for samples in of.flights) ** 0.5
    closed, naming_bench.loop_noise = naming_bench.loop_noise, lambda samples: 0.0
    try:
        bench = naming_bench.simulator_bench(truth, of.flights, of.fit, of.holdout)
        point = linearise(bench, truth, truth)
        state = SelectionState(bench, truth, point, metric_of(point))
        words = []
        for effect in ("inertia", "motor_lag"):
            group = [candidate for candidate in point.candidates if candidate.effect == effect]
            fit = fit_from(state, group, with_value(truth, effect, group[0].values(truth)))
            words += [f"{p} {x:.4g}" for p, x in fit.effects[effect].items()]
    finally:
        naming_bench.loop_noise = closed
    return f"{case.words} | noise {noise:.4f} | " + ", ".join(words)


def main() -> int:
    """Fly or judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("deed", choices=("draw", "fly", "judge", "bent"))
    parser.add_argument("out", type=Path)
    parser.add_argument("--from", dest="first", type=int, default=0)
    parser.add_argument("--to", type=int, default=16)
    parser.add_argument("--instance", type=int, default=0)
    parser.add_argument("--prefix", default="")
    parser.add_argument("--only", default="", help="words of a case: ULog, MCAP, MCAPs, pooled, held")
    given = parser.parse_args()
    for number in range(given.first, given.to):
        flight = drawn(number)
        if given.deed == "draw":
            print(flight)
        if given.deed == "fly":
            home = Path(os.environ["PX4_HOME"])
            print(flight, flown(home, given.out, flight, given.instance, tuple(given.prefix.split())), flush=True)
    if given.deed in ("judge", "bent"):
        vehicle = load_vehicle(VEHICLE)[0]
        for case in cases(given.out, range(given.first, given.to)):
            if given.only not in case.words:
                continue
            if given.deed == "bent":
                print(bent(case, vehicle), flush=True)
                continue
            began = time.process_time()
            try:
                result = analyse(case.logs, vehicle, vehicle_name=VEHICLE, holdout=case.holdout)
            except InputError as error:
                print(f"{case.words}: error: {error}", flush=True)
                continue
            said = judged(result, case.flight)
            truth = f"{case.flight.mass_kg - 1:.3f} kg, {case.flight.drag_kgps:g}"
            right = verdict(said, case, vehicle)
            errors = " ".join(f"{100 * e:.1f}" for e in said.errors)
            print(
                f"{case.words} | {truth} | {right} {said.hold}/{said.values} | {errors} | {said.says} | "
                f"closed {result.gap.closed} | {time.process_time() - began:.1f} s",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
