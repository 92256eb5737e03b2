"""`python -m benchmarks.fence_baselines`: the site filter beside three others, on the same flights.

    site         the site filter, as it flies
    px4          PX4's predictive fence (GF_PREDICT), its published rule: a test point ahead by the braking distance
                 v (v / (2 MPC_ACC_HOR) + MPC_ACC_HOR / MPC_JERK_AUTO); where that point is forbidden the mode changes
                 to Hold there and the program is out.  It is given keep-outs, floor and ceiling as well
    gatekeeper   arXiv 2211.14361: the same committed way out, with 5 % of the doubts, without rows or bent references
    backup-cbf   arXiv 2201.04331, closed form: a QP whose rows say that braking ends before each near thing; no tube,
                 no commitment, no bent references

Per method: flights with exits, share of the ticks outside, share of commands changed, and how near flights without an
exit came to what is forbidden (median; the room that is lost).  One line of the journal per flight; a run goes on where
it stopped.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fence_flight import FenceFlight
from benchmarks.fence_worlds import drawn_attack, drawn_grade, drawn_site, drawn_world
from flightstack.barrier.response import CHAIN, STATE
from flightstack.cli.controllers import build
from flightstack.cli.versions import versions
from flightstack.jit import njit_called
from flightstack.rows import F_H, F_INTERVENED, F_STATUS, F_THRUST, F_VERSION
from flightstack.site import decide as d
from flightstack.site import slide
from flightstack.site.clearance import CHUTE, FLOOR, GROUND, OPEN, clear_of
from flightstack.site.decide import CHANGED, LEFT, PASSED
from flightstack.site.filter import SiteFilter, SiteState
from flightstack.site.stopping import Told
from flightstack.types import F64, Command, Filtered, FlatOutput, InputError, Learned, Measurement

METHODS = ("site", "px4", "gatekeeper", "backup-cbf")
_ACC_MPS2, _ACC_UP_MPS2, _JERK_MPS3 = 3.0, 4.0, 4.0
"""PX4's defaults: MPC_ACC_HOR, MPC_ACC_UP_MAX, MPC_JERK_AUTO."""
_TOLD, _NO_ROWS_M = 0.05, -1e6
_LEFT_M, _PAUSE_US = 0.5, 50_000
_ALL_SAID = 0.7
"""`slide` is told that share of the braking there is; the QP's rows are told all."""


class _Unbent(SiteFilter):
    """Without bent references."""

    def bend(self, state: SiteState, setpoint: FlatOutput) -> FlatOutput:
        return setpoint


class PredictiveFence(_Unbent):
    """PX4's rule."""

    def compile(self) -> None:
        """Nothing to compile; before a flight."""
        self._px4 = build("px4", self.model, self.limits)[0]
        self._held: FlatOutput | None = None
        self._control: Any = None

    def governed(self, state: SiteState) -> None:
        """PX4 has no governor."""

    def step(
        self, state: SiteState, measurement: Measurement, command: Command, sent: Command, learned: Learned
    ) -> tuple[SiteState, Command, Filtered]:
        """The command, or once the test point was forbidden what Hold flies."""
        row = Filtered.nothing().row.copy()
        row[0] = row[6] = row[7] = 0.0
        row[2], row[8:14] = PASSED, 0.0
        place, v = measurement.row[:3] - state.origin_ned_m, measurement.row[3:6]
        ahead = place.copy()
        speed = math.hypot(v[0], v[1])
        ahead[:2] += v[:2] * (speed / (2.0 * _ACC_MPS2) + _ACC_MPS2 / _JERK_MPS3)
        ahead[2] += v[2] * (abs(v[2]) / (2.0 * _ACC_UP_MPS2) + _ACC_UP_MPS2 / _JERK_MPS3)
        if -place[2] > self.site.floor_m + _LEFT_M:
            state.numbers[LEFT], self._site[CHUTE] = 1.0, -1.0
        disc = np.array([[ahead[0], ahead[1], -ahead[2], 0.0, 0.0]])
        if self._held is None and state.numbers[LEFT] and clear_of(self._site, disc, 1, 1.0)[0] < 0.0:
            hold = np.zeros(17)
            hold[:3] = ahead + state.origin_ned_m
            self._held, self._control = FlatOutput(hold), self._px4.init(command.t_us)
        if self._held is None:
            return state, command, Filtered(row)
        self._control, proposal = self._px4.step(
            self._control, measurement, self._held, Learned.nothing(), sent, command.t_us
        )
        row[2], row[7] = CHANGED, 1.0
        safe, _ = self._limiter.limit(proposal.thrust_n, proposal.row[17:20], command.t_us)
        return state, safe, Filtered(row)


@njit_called
def _slid(
    known: tuple[F64, F64, F64, F64], kept: tuple[F64, F64, F64], site: F64, origin: F64, measured: F64,
    times_us: tuple[float, float, float], commands: tuple[float, F64, float, F64], buffers: tuple[F64, F64, F64, F64],
) -> tuple[float, int]:  # fmt: skip
    """`decide.decide` without a way out: the command slid along what is near, and what moved it."""
    of, lasting, wanted, into = d.Known(*known), d.Kept(*kept), d.Commands(*commands), d.Buffers(*buffers)
    n, vehicle, state, offset = lasting.numbers, of.vehicle, np.empty(STATE), np.zeros(3)
    at, spin = d._now(of, lasting, origin, measured, times_us, wanted), n[d.SPIN : d.SPIN + 2].copy()
    d._predict(of, lasting, measured, times_us, (state, spin, offset))
    for i in range(3):
        n[d.SENT + i], into.rate[i] = wanted.sent_rate[i], wanted.wanted_rate[i]
    now = d.Now(vehicle[:CHAIN], state, spin, vehicle[d._ROTORS_S], offset, origin, n)
    keeping = d.Keeping(of.rows[at], of.halves[0], site)
    if origin[2] - state[2] > site[FLOOR] + _LEFT_M:
        n[LEFT] = 1.0
    site[CHUTE] = -1.0 if n[LEFT] > 0.0 else site[OPEN]
    site[GROUND] = 0.0
    return d._slid(now, keeping, of.soft[at], vehicle, wanted.wanted_norm, into)


class BackupQp(_Unbent):
    """A QP whose rows say that braking ends before each near thing, and nothing else."""

    def step(
        self, state: SiteState, measurement: Measurement, command: Command, sent: Command, learned: Learned
    ) -> tuple[SiteState, Command, Filtered]:
        """The command that is nearest to the wanted one within the rows."""
        row = Filtered.nothing().row.copy()
        row[F_INTERVENED], row[F_THRUST], row[F_STATUS] = 0.0, command.thrust_n, PASSED
        row[F_H] = row[F_VERSION] = 0.0
        if command.t_us - state.numbers[d.LAST_US] > _PAUSE_US:
            self._begin(state, measurement, sent)
        norm, code = _slid(
            self._known[0].known, (state.memory, state.numbers, state.committed), self._site, state.origin_ned_m,
            measurement.row, (float(sent.t_us), float(measurement.t_us), float(command.t_us)),
            (sent.thrust_norm, sent.rate_frd_radps, command.thrust_norm, command.rate_frd_radps),
            (self._scratch, self._way, row, self._rate),
        )  # fmt: skip
        if code == d._FREE:
            return state, command, Filtered(row)
        row[F_STATUS], row[F_INTERVENED] = CHANGED, 1.0
        safe, _ = self._limiter.limit(self.model.thrust_of(norm), self._rate, command.t_us)
        return state, safe, Filtered(row)


_KINDS: dict[str, type[SiteFilter]] = {"px4": PredictiveFence, "gatekeeper": _Unbent, "backup-cbf": BackupQp}


def replaced(flight: FenceFlight, method: str) -> None:
    """Put another filter into a flight; `site`: its own stays."""
    if method == "site":
        return
    own: SiteFilter = flight.timed._filter
    made, plan_of = own.certificate, flight.plan_of
    other = _KINDS[method](own.model, own.limits, made, plan_of.site, plan_of.chutes, plan_of.chute_m)
    soft = d.Known(*other._known[0].known).soft
    if method == "gatekeeper":
        soft[:, slide.RADIUS] = soft[:, slide.HALF] = _NO_ROWS_M
    if method == "backup-cbf":
        soft[:, slide.RADIUS] = soft[:, slide.HALF] = 0.0
        soft[:, slide.BRAKE] /= _ALL_SAID
    flight.timed._filter = other
    flight.state = flight.state._replace(filter=other.init(flight.origin))


@cache
def _commit() -> str:
    """Of what flies here: asked once, for files change while a campaign flies."""
    return str(versions()["git_commit"])


def flown(method: str, seed: int, seconds: float, folder: Path) -> dict[str, Any]:
    """One flight with one method."""
    path = folder / f"site-{seed}.toml"
    path.write_text(drawn_site(seed))
    found = {"method": method, "seed": seed, "commit": _commit()}
    try:
        world, told = replace(drawn_world(seed, folder), plant="native"), _TOLD if method == "gatekeeper" else 1.0
        flight = FenceFlight(world, path, drawn_attack(seed), Told.all(told))
    except InputError as error:
        return {**found, "refused": str(error).partition(": ")[2]}
    replaced(flight, method)
    outcome = flight.run(seconds)
    return {
        **found, "exits": outcome.exits, "ticks": outcome.ticks,
        "nearest_m": round(outcome.nearest_m, 3), "changed": outcome.changed, "ended": outcome.ended,
    }  # fmt: skip


def _line(method: str, rows: list[dict[str, Any]]) -> str:
    flights = [row for row in rows if row["method"] == method and "refused" not in row]
    left = [row for row in flights if row["exits"]]
    stayed = [row["nearest_m"] for row in flights if not row["exits"]]
    ticks = sum(row["ticks"] for row in flights)
    changed = 100.0 * sum(row["changed"] for row in flights) / max(ticks, 1)
    outside = 100.0 * sum(row["exits"] for row in flights) / max(ticks, 1)
    room = f"{np.median(stayed):.2f} m" if stayed else "-"
    ended = sum(bool(row["ended"]) for row in flights)
    return f"| {method} | {len(flights)} | {len(left)} | {outside:.1f} % | {changed:.0f} % | {room} | {ended} |"


def main() -> None:
    """Fly what is left and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=500)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--journal", type=Path, default=Path("runs/fence-baselines.jsonl"))
    given = parser.parse_args()
    given.journal.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in given.journal.read_text().splitlines()] if given.journal.exists() else []
    done, began = {(row["method"], row["seed"]) for row in rows}, time.monotonic()
    seeds = [seed for seed in range(200_000, 200_000 + 2 * given.flights) if drawn_grade(seed) == "mocap"]
    with tempfile.TemporaryDirectory(prefix="fence-") as folder, given.journal.open("a") as journal:
        for seed in seeds[: given.flights]:
            if time.monotonic() - began > 60.0 * given.minutes:
                break
            for method in METHODS:
                if (method, seed) not in done:
                    rows.append(flown(method, seed, given.seconds, Path(folder)))
                    print(json.dumps(rows[-1]), file=journal, flush=True)
    print(
        "| method | flights | with exits | ticks outside | commands changed | nearest without an exit, median | ended |"
    )
    for method in METHODS:
        print(_line(method, rows))


if __name__ == "__main__":
    main()
