"""Attacks from one certified state, as tasks of a campaign: `campaigns/barrier.toml` and `campaigns/planted-tilt.toml`.

A block is one truth: a nominal flight learns and is certified, and from the moment the filter is engaged several
adversaries fly 30 s each from that same state, each with other noise: known attacks first, random ones, then ones
between and near the best so far (cross-entropy).  A strike is one attack of given figures on a given truth, which a
worker learns once: what a search moves.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections import Counter
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import attack_adversary as adversary
from benchmarks.attack_flight import AttackFlight
from benchmarks.attack_worlds import World, draw
from flightstack.barrier.premise_watch import NAMES
from flightstack.cli.files import load_scenario
from flightstack.errors import InputError

LEARNING_S = 60.0
"""The nominal flight may take so long until the filter is engaged."""
_RANDOM, _ELITE = 4, 3
"""Of a block's flights at random after the known ones; so many of the best are mixed."""
_WORTH_KEEPING_H = 0.05
"""With less h than this the row says what was flown; the rest follows from the seed."""
LEAST_SHARE = 0.5
"""A flight counts if its filter was engaged for so much of it."""


_SHAKE = adversary.KNOWN._replace(roll_radps=3.0, pitch_radps=3.0)
_LEAN = adversary.PUSH._replace(lateral=adversary.SWING, steer_ps=15.0)
LEANING = [
    adversary.KNOWN, adversary.TIMED, _SHAKE._replace(wave=adversary.SQUARE, hz=5.0), _SHAKE._replace(hz=1.0),
    _SHAKE._replace(roll_radps=6.0, pitch_radps=6.0, hz=1.0, lateral=adversary.GRADIENT, axes=7),
    _LEAN._replace(swing_s=0.4), _LEAN._replace(swing_s=1.0), _LEAN._replace(swing_s=2.0, vertical=adversary.SWING),
]  # fmt: skip
"""Dither of 1.6 to 6 rad/s at 1 to 10.8 Hz, leaning to and fro, thrust at its ends."""


class Kind(NamedTuple):
    """What a block's world is."""

    scenario: str = "paper-tracking"
    vehicle: str = "quad-x"
    grade: str = "mocap"
    plant: str = "native"
    period_ticks: tuple[int, int] = (1, 3)
    """Ticks of 4 ms between commands: from the first to below the second.  The companion sends every 4 ms."""


KINDS = {
    "three axes, mocap": Kind(),
    "three axes, mocap, commands every 12 ms": Kind(period_ticks=(3, 4)),
    "three axes, mocap, JSBSim": Kind(plant="jsbsim"),
    "vertical, mocap": Kind("paper-barrier"),
    "vertical, mocap, px4-sih": Kind("paper-barrier", "px4-sihsim-quadx"),
    "gps-barrier, gps": Kind("gps-barrier", grade="gps"),
}


def block(values: dict[str, Any], seed: int, folder: Path) -> dict[str, Any]:
    """Learn, certify, and attack from there: `kind`, `attacks`, `seconds`, `planted` (torque: its margin is away)."""
    kind = KINDS[values["kind"]]
    world = draw(seed, late_ms=40.0, **kind._asdict())
    scenario, _ = load_scenario(kind.scenario, None)
    if world.refused(scenario.limits.thrust_max_weights):
        raise InputError("too little thrust: drawn worlds that no scenario would fly")
    flight = AttackFlight(world, seed, planted=values.get("planted", ""))
    engaged_s = flight.fly_until_engaged(LEARNING_S)
    row = {"world": dataclasses.asdict(world), "engaged": engaged_s is not None, "engaged_s": engaged_s}
    if engaged_s is None or flight.certificate is None:
        return row | {"ended": flight.ended}
    flight.held.hold(flight.certificate)
    areas = [round(axis.barrier.area_m2ps, 3) for axis in flight.certificate.axes]
    flown = attacked(flight, seed, int(values["attacks"]), float(values["seconds"]))
    return row | {"areas_m2ps": areas} | told(flown)


def premises(values: dict[str, Any], seed: int, folder: Path) -> dict[str, Any]:
    """Who ends his own protection: 32 strategies of `seconds` each on `paper-tracking`, eight that shake rates,
    lean to and fro and push thrust, and 24 points of the adversary's cube, the same for every seed; `plant`."""
    drawn = [adversary.decode(np.random.default_rng([77, k]).uniform(size=20)) for k in range(24)]
    return _on_its_own_truth(values, seed, LEANING + drawn)


def dither(values: dict[str, Any], seed: int, folder: Path) -> dict[str, Any]:
    """Rates that are dithered while thrust is pushed to its ends, `attacks` times for `seconds` each on
    `paper-tracking`: the known dither, then amplitudes of 0 to 6 rad/s and 1 to 15 Hz of every wave; `plant`."""
    rng = np.random.default_rng([78, seed])
    drawn = [
        adversary.KNOWN._replace(
            roll_radps=float(rng.uniform(0.0, 6.0)), pitch_radps=float(rng.uniform(0.0, 6.0)),
            hz=float(15.0 ** rng.uniform()), phase_rad=float(rng.uniform(0.0, 2.0 * math.pi)), wave=k % 3,
            together=bool(rng.uniform() < 0.5),
        )
        for k in range(int(values["attacks"]) - 1)
    ]  # fmt: skip
    return _on_its_own_truth(values, seed, [adversary.KNOWN, *drawn])


def _on_its_own_truth(values: dict[str, Any], seed: int, strategies: list[adversary.Strategy]) -> dict[str, Any]:
    flight = AttackFlight(World(seed=seed, plant=str(values["plant"])), seed)
    if (engaged_s := flight.fly_until_engaged(LEARNING_S)) is None or flight.certificate is None:
        return {"engaged": False, "ended": flight.ended}
    flight.held.hold(flight.certificate)
    rows: list[dict[str, Any]] = [
        apart(lambda k=k, strategy=strategy: _one(flight, strategy, seed * 100 + k, float(values["seconds"])))  # type: ignore[misc]
        for k, strategy in enumerate(strategies)
    ]
    for k, row in enumerate(rows):
        row["k"] = k
    ends = Counter(NAMES[row["broken"]] for row in rows if row.get("broken"))
    return {"engaged": True, "engaged_s": engaged_s, "ended_by_premise": ends.total(), "ends": dict(ends)} | told(rows)


def attacked(flight: AttackFlight, seed: int, count: int, seconds: float) -> list[dict[str, Any]]:
    """The attacks of a block, each from the same state."""
    rng = np.random.default_rng([11, seed])
    known = [adversary.KNOWN, adversary.PUSH, adversary.TIMED, adversary.TIMED_FAST]
    tried: list[tuple[float, Any]] = []
    rows = []
    for k in range(count):
        point = None
        if k >= len(known):
            best = [x for _, x in sorted(tried, key=lambda each: each[0])[:_ELITE]]
            explore = k < len(known) + _RANDOM or len(best) < 2
            point = adversary.drawn(rng) if explore else adversary.near(best, rng)
        strategy = known[k] if point is None else adversary.decode(point)
        row = apart(lambda k=k, strategy=strategy: _one(flight, strategy, seed * 100 + k, seconds))  # type: ignore[misc]
        row |= {"k": k, "known": point is None}
        if row.get("least_h", 0.0) < _WORTH_KEEPING_H:
            row["strategy"] = [round(v, 4) for v in strategy]
        rows.append(row)
        if point is not None and row.get("share", 0.0) >= LEAST_SHARE:
            tried.append((row["least_h"], point))
    return rows


def told(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """A block's figures: what its attacks add up to; an exit counts however soon the flight ended after it."""
    flown = [row for row in rows if "lost" not in row]
    counted = [row for row in flown if row["share"] >= LEAST_SHARE]
    left, infeasible = sum(bool(row["outside"]) for row in flown), sum(row["infeasible"] for row in flown)
    lost = len(rows) - len(flown)
    words = {"left": left, "steps infeasible": infeasible, "lost": lost}
    return {
        "attacks": len(rows), "counted": len(counted), "ended_early": len(flown) - len(counted), "left": left,
        "left_counted": sum(bool(row["outside"]) for row in counted), "infeasible": infeasible,
        "falsified": sum(bool(row["falsified"]) for row in flown), "lost": lost,
        "premises": sum(row["premises"] for row in flown), "premises_true": sum(row["premises_true"] for row in flown),
        "barrier": {"min_h_truth": min((row["least_h"] for row in flown), default=None)}, "flights": rows,
        "failure": ", ".join(f"{count} {what}" for what, count in words.items() if count),
    }  # fmt: skip


def strike(values: dict[str, Any], seed: int, folder: Path) -> dict[str, Any]:
    """One attack: fields of `attack_adversary.Strategy` by their names, on the truth of `world_seed`, over a link of
    `late_ms`, for `seconds`, with `planted` left out."""
    flight = _learned(
        int(values.get("world_seed", 0)), str(values.get("planted", "")), float(values.get("late_ms", 4.0))
    )
    if flight is None:
        raise InputError("this truth is not certified")
    fields = {name: value for name, value in values.items() if name in adversary.Strategy._fields}
    strategy = adversary.PUSH._replace(**fields)
    row = apart(lambda: _one(flight, strategy, seed, float(values["seconds"])))
    if "lost" in row:
        raise RuntimeError(row["lost"])
    return row | {"failure": "left the certificate" if row["outside"] else ""}


@lru_cache(maxsize=2)
def _learned(world_seed: int, planted: str, late_ms: float) -> AttackFlight | None:
    """The flight of a truth, engaged, over a link that is so late in all."""
    world = World(seed=world_seed, down_ms=0.5 * late_ms, up_ms=0.5 * late_ms)
    flight = AttackFlight(world, world_seed, planted=planted)
    if flight.fly_until_engaged(LEARNING_S) is None or flight.certificate is None:
        return None
    flight.held.hold(flight.certificate)
    if planted == "tilt":
        flight.unguard()
    return flight


def _one(flight: AttackFlight, strategy: adversary.Strategy, seed: int, seconds: float) -> dict[str, Any]:
    flight.reseed(seed)
    out = flight.attack(strategy, seconds)
    return {
        "share": round(out.share, 4), "least_h": round(min(out.least_h, 1.0), 4), "at_s": out.at_s,
        "broken": out.broken, "broken_s": out.broken_s, "outside": out.outside,
        "infeasible": out.infeasible, "falsified": out.falsified, "ended": out.ended,
        "intervened": out.intervened, "premises": out.premises, "premises_true": out.premises_true,
        "tilt_rad": round(out.tilt_rad, 3), "travelled_m": round(out.travelled_m, 2),
    }  # fmt: skip


def apart(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The result of work done by a copy of this process: what it changes is not changed here."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.close(read)
            try:
                answer = work()
            except Exception as error:
                answer = {"lost": repr(error)}
            with os.fdopen(write, "w") as out:
                out.write(json.dumps(answer))
            status = 0
        finally:
            os._exit(status)
    os.close(write)
    with os.fdopen(read) as source:
        text = source.read()
    os.waitpid(child, 0)
    return json.loads(text) if text else {"lost": "its process ended"}
