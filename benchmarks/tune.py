"""The one procedure by which every controller's gains are found; it writes controllers/gains.toml.

    python benchmarks/tune.py                              all controllers, into controllers/gains.toml
    python benchmarks/tune.py --only pid indi --out x.toml

Procedure `tune/2`, the same for each controller:

Figure of merit: the mean of the true rms errors over the second halves of three flights without a wire, sensors of
mocap grade: `paper-tracking` for 24 s with its wrong mass and force; `figure8` for 16 s on px4-sihsim-quadx, whose
linear drag of 1 kg/s is not believed; `figure8` for 16 s on quad-x with a right model, but pushed in flight by a
quarter of its weight for half a second, once along each axis (else nothing would ask for damping).
Constraint: the same flights with every command 32 ms late, which nobody is told, and rotors 1.5 times as slow: no
guard acts, no error grows beyond twice its own, nor, with sensors of gps grade on px4-sihsim-quadx, beyond 1 m.
Search: in the logarithm of every gain that is not 0 and not of the attitude's loop, which all controllers share and
which is set by the rate loop's lag, not by a path (left free, the search turned it down to 1 / s, all but feed-forward:
good on these flights, and nobody's choice on a real vehicle).  It is an evolution strategy of one parent and one child:
a random half of the gains moves, a move that helped is tried again 1.5 times as long, and the step length follows the
rule of one success in five.  64 evaluations; a candidate is given up as soon as its sum exceeds
the best.  It begins at the defaults of the gains' records; for `pid` and `indi` where `pd` ended is tried
too; integral shares and cut-offs are halved until the constraint holds.
Seeds of the flights are 1000 to 1005: none that a test, a benchmark or a campaign uses.

No learner flies in tuning: `dob` is the flatness controller with an observer in the learner's place, and its gains are
the flatness controller's too, with learning and without (tuned with nothing in that place they would only fight the
tuning set's droop).  `state-gp` flies with them as well.
Source of the search: I. Rechenberg, "Evolutionsstrategie", 1973; the factors of the step length are those of S. Kern et
al., "Learning probability distributions in continuous evolutionary algorithms", 2004.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, replace
from datetime import date
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from flightstack.cli import controllers, files
from flightstack.control.attitude import AttitudeGains
from flightstack.control.gains import GAINS, Group, Tuned, gains_to_toml
from flightstack.control.pid import PidGains
from flightstack.model import Limits, Model
from flightstack.scenario import Scenario, TimedEvent
from flightstack.stack import Stack, StackState
from flightstack.types import F64, Command, FlatOutput, Measurement, TickRecord
from flightstack.vehicle import Vehicle, with_effects
from tests.closed_loop import fly

ROOT = Path(__file__).resolve().parents[1]
VERSION = "tune/2"
EVALUATIONS = 64
FIRST_SEED = 1000
SEARCH_SEED = 7
LATE_TICKS = 8
"""32 ms of 4 ms ticks."""
SLOWER_ROTORS = 1.5
GROWTH_MAX = 2.0
GPS_MAX_M = 1.0
SEARCHED = [name for name in GAINS if name != "flatness"]
AFTER_PD = ("pid", "indi")
SLOWEST = 1
"""The case of the vehicle with the slowest rotors."""
_LEFT_ALONE = tuple(f.name for f in fields(AttitudeGains))
_STEP, _FURTHER = 0.25, 1.5
_SUCCESS, _FAILURE = math.exp(1.0 / 3.0), math.exp(-1.0 / 12.0)

Make = Callable[[Model, Limits], Stack]


@dataclass(frozen=True)
class Case:
    """One flight of the tuning set."""

    name: str
    scenario: Scenario
    believed: Vehicle
    truth: Vehicle


class LateLink:
    """A stack whose commands reach the vehicle some ticks late, without its knowing."""

    def __init__(self, stack: Stack, ticks: int) -> None:
        self.stack, self.ticks = stack, ticks

    def init(self, measurement: Measurement) -> tuple[StackState, tuple[Command, ...]]:
        """State of the stack, nothing under way."""
        return self.stack.init(measurement), ()

    def tick(
        self, state: Any, measurement: Measurement | None, setpoint: FlatOutput, now_us: int
    ) -> tuple[Any, Command, TickRecord]:
        """The stack's tick; the command that comes out is an earlier one."""
        inner, under_way = state
        inner, command, record = self.stack.tick(inner, measurement, setpoint, now_us)
        under_way = (*under_way, command)
        return (inner, under_way[-self.ticks :]), under_way[0], record


def tuning_set() -> list[Case]:
    """The three flights."""
    quad, sih = files.load_vehicle("quad-x")[0], files.load_vehicle("px4-sihsim-quadx")[0]
    dragless = files.load_vehicle("px4-sihsim-quadx-no-drag")[0]
    paper = files.load_scenario("paper-tracking")[0].with_duration(24.0)
    eight = files.load_scenario("figure8")[0].with_duration(16.0)
    return [
        Case("wrong mass and force", paper, quad, paper.truth_vehicle(quad)),
        Case("drag unknown", eight, dragless, sih),
        Case("pushed", replace(eight, events=tuple(_pushes(quad))), quad, quad),
    ]


def _pushes(vehicle: Vehicle) -> Iterator[TimedEvent]:
    """A quarter of the weight for half a second, once along each axis, while errors count."""
    for time_s, axis in ((8.5, "north_n"), (11.0, "east_n"), (13.5, "down_n")):
        for begin_s, force_n in ((time_s, 0.25 * vehicle.weight_n), (time_s + 0.5, 0.0)):
            values = {"north_n": 0.0, "east_n": 0.0, "down_n": 0.0, axis: force_n}
            yield TimedEvent(begin_s, "constant_force", tuple(values.items()))


def evaluate(cases: list[Case], make: Make, enough_m: float = math.inf) -> list[float]:
    """Settled rms error of each case; infinite where a guard acted, cut short where the sum exceeds `enough_m`."""
    errors: list[float] = []
    for i, case in enumerate(cases):
        flight = fly(case.scenario, case.believed, truth=case.truth, seed=FIRST_SEED + i, make_stack=make)
        errors.append(math.inf if flight.guards else flight.rmse_settled_m)
        if sum(errors) > enough_m:
            break
    return errors


def robust(cases: list[Case], make: Make, errors: list[float]) -> bool:
    """Whether the flights with late commands and slow rotors stay within their bounds."""
    flights = [(SLOWEST, "gps", GPS_MAX_M), *((i, "mocap", GROWTH_MAX * error) for i, error in enumerate(errors))]
    for i, grade, most_m in flights:
        case = cases[i]
        lag = {"motor_lag": {"time_constant_s": SLOWER_ROTORS * case.truth.rotors.time_constant_s}}
        flight = fly(
            case.scenario,
            case.believed,
            truth=with_effects(case.truth, lag),
            seed=FIRST_SEED + len(cases) + i,
            grade=grade,
            make_stack=lambda model, limits: LateLink(make(model, limits), LATE_TICKS),  # type: ignore[arg-type,return-value]
        )
        if flight.guards or not flight.rmse_settled_m <= most_m:
            return False
    return True


def maker(name: str, groups: tuple[Group, ...]) -> Make:
    """The stack of a controller with these gains, without the Gaussian process."""
    tuned = {name: Tuned("candidate", 0.0, groups)}

    def make(model: Model, limits: Limits) -> Stack:
        controller, learner = controllers.build(name, model, limits, gains=tuned)
        return Stack(model, limits, controller=controller, learner=learner)

    return make


def starts(name: str, tuned: Mapping[str, Tuned]) -> list[tuple[Group, ...]]:
    """Where the search may begin: the records' defaults, and what was found for the same law with less in it."""
    found = [{}, {type(group): group for group in tuned["pd"].groups}] if name in AFTER_PD else [{}]
    return [tuple(_with_integral(less.get(kind, kind()), name) for kind in GAINS[name]) for less in found]


def _with_integral(gains: Group, name: str) -> Group:
    """Integral shares for `pid` alone."""
    if not isinstance(gains, PidGains):
        return gains
    usual = PidGains() if name == "pid" else PidGains(integral_xy=0.0, integral_z=0.0)
    return replace(gains, integral_xy=usual.integral_xy, integral_z=usual.integral_z)


def scaled(groups: tuple[Group, ...], logarithms: F64) -> tuple[Group, ...]:
    """Every tuned gain times its own factor."""
    factors = iter(np.exp(logarithms))
    return tuple(
        replace(group, **{key: float(f"{getattr(group, key) * next(factors):.4g}") for key in _tuned(group)})
        for group in groups
    )


def _tuned(group: Group) -> list[str]:
    return [f.name for f in fields(group) if f.name not in _LEFT_ALONE and getattr(group, f.name) != 0.0]


def _beyond_pd(group: Group) -> list[str]:
    return [f.name for f in fields(group) if f.name.startswith(("integral_", "cutoff_"))]


class Search:
    """What has been tried and what was best, in the logarithm of the gains."""

    def __init__(self, name: str, firsts: list[tuple[Group, ...]], cases: list[Case], evaluations: int) -> None:
        self.name, self.cases, self.left = name, cases, evaluations - len(firsts)
        self.best, self.first = min((self._inside(first) for first in firsts), key=lambda found: found[0])
        self.place: F64 = np.zeros(sum(len(_tuned(group)) for group in self.first))

    def _inside(self, first: tuple[Group, ...]) -> tuple[float, tuple[Group, ...]]:
        """A start and its sum, what `pd` lacks halved until the constraint holds."""
        for _ in range(6):
            errors = evaluate(self.cases, maker(self.name, first))
            if robust(self.cases, maker(self.name, first), errors):
                return sum(errors), first
            first = tuple(replace(g, **{key: 0.5 * getattr(g, key) for key in _beyond_pd(g)}) for g in first)
        return math.inf, first

    def helps(self, move: F64) -> bool:
        """Try a move from the best place; it is the new best place if it helped."""
        self.left -= 1
        make = maker(self.name, scaled(self.first, self.place + move))
        errors = evaluate(self.cases, make, self.best)
        if not sum(errors) < self.best or not robust(self.cases, make, errors):
            return False
        self.place, self.best = self.place + move, sum(errors)
        words = " ".join(f"{100 * error:.2f}" for error in errors)
        print(f"  {self.name}: {words} cm, {self.left} left, {np.round(self.place, 2)}", flush=True)
        return True

    def run(self, rng: np.random.Generator) -> None:
        """Random moves of some of the gains; one that helped is repeated and lengthened until it helps no more."""
        size, move = _STEP, np.full(len(self.place), _STEP)
        while self.left > 0:
            if self.helps(move):
                size *= _SUCCESS
                while self.left > 0 and self.helps(move := _FURTHER * move):
                    pass
            else:
                size *= _FAILURE
            some = rng.random(len(move)) < 0.5
            move = size * rng.standard_normal(len(move)) * (some if some.any() else 1.0)


def tune(name: str, firsts: list[tuple[Group, ...]], evaluations: int) -> Tuned:
    """Search and say where the gains come from."""
    began, cases = time.perf_counter(), tuning_set()
    search = Search(name, firsts, cases, evaluations)
    before = search.best / len(cases)
    search.run(np.random.default_rng(SEARCH_SEED))
    best = search.best / len(cases)
    print(f"{name:9s} {100 * before:.2f} -> {100 * best:.2f} cm in {time.perf_counter() - began:.0f} s", flush=True)
    origin = f"{VERSION}, {evaluations} evaluations, {date.today().isoformat()}; began at {before:.4f} m"
    return Tuned(origin, round(best, 6), scaled(search.first, search.place))


HEADING = """The gains of every controller, found by `make tune` (its procedure: benchmarks/tune.py).
score_m: mean over the tuning set of the settled rms error, without the Gaussian process."""

AS_DOB = "as dob: the same controller, tuned with the observer in the learner's place"


def main() -> None:
    """Tune and write the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=SEARCHED, default=SEARCHED, help="these tables only")
    parser.add_argument("--evaluations", type=int, default=EVALUATIONS)
    parser.add_argument("--out", type=Path, default=ROOT / "flightstack/data/controllers" / "gains.toml")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    tuned: dict[str, Tuned] = dict(controllers.load_gains())
    with ProcessPoolExecutor(options.processes) as pool:
        for later in (False, True):
            names = [name for name in options.only if (name in AFTER_PD) == later]
            firsts = [starts(name, tuned) for name in names]
            tuned |= zip(names, pool.map(tune, names, firsts, [options.evaluations] * len(names)), strict=True)
            tuned["flatness"] = Tuned(AS_DOB, tuned["dob"].score_m, tuned["dob"].groups[:2])
            options.out.write_text(gains_to_toml(tuned, HEADING), encoding="utf-8")


if __name__ == "__main__":
    main()
