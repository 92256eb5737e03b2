"""The barrier campaign: an adversary that searches, in worlds inside what is declared, each with its certificate.

    python -m benchmarks.barrier_attack --resume --minutes 60   as many as an hour takes (make campaign-barrier)
    python -m benchmarks.barrier_attack --quick                 a block of each kind, into runs/campaign-barrier-quick
    python -m benchmarks.barrier_attack --report-only           the tables anew from results.json

A block is one truth: a nominal flight learns and is certified, and from the moment the filter is engaged several
adversaries fly 30 s each from that same state, each with other noise: known attacks first, random ones, then ones
between and near the best so far (cross-entropy).  Seeds come from the commit, so they are drawn after the code is fixed
and no journal mixes commits.  Every finished block is kept at once in runs/campaign-barrier.jsonl.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

from benchmarks import campaign

SCHEMA = "flightstack.campaign-barrier/2"
ENGAGED_S = 30.0
LEARNING_S = 60.0
"""The nominal flight may take so long until the filter is engaged."""
BLOCK, QUICK_BLOCK = 12, 4
"""Flights of a block."""
_RANDOM, _ELITE = 4, 3
"""Of them at random after the known ones; so many of the best are mixed."""
_WORTH_KEEPING_H = 0.05
"""With less h than this the journal says what was flown; the rest follows from the seed."""
LEAST_SHARE = 0.5
"""A flight counts if its filter was engaged for so much of it."""
Job = tuple[str, int, int]
"""Kind, seed, flights."""


class Kind(NamedTuple):
    """What a block's world and stack are."""

    scenario: str = "paper-tracking"
    vehicle: str = "quad-x"
    grade: str = "mocap"
    plant: str = "native"
    late_ms: float = 40.0
    torque: bool = True
    """False: the torque margin is planted away, to show that the campaign can fail."""
    blocks: int = 1
    """Of a whole campaign."""


KINDS = {
    "three axes, mocap": Kind(blocks=400),
    "three axes, mocap, JSBSim": Kind(plant="jsbsim", blocks=30),
    "vertical, mocap": Kind(scenario="paper-barrier", blocks=30),
    "vertical, mocap, px4-sih": Kind(scenario="paper-barrier", vehicle="px4-sihsim-quadx", blocks=30),
    "gps-barrier, gps": Kind(scenario="gps-barrier", grade="gps", blocks=60),
    "three axes, mocap, no torque margin": Kind(torque=False, blocks=20),
}


def first_seed() -> int:
    """Of a campaign with this code."""
    from flightstack.cli.versions import versions

    commit = versions()["git_commit"]
    return int(commit[:7], 16) if all(c in "0123456789abcdef" for c in commit[:7]) else 0


def jobs_of(quick: bool) -> list[Job]:
    """Blocks of all kinds, mixed: wherever the campaign is cut, each kind has had its share."""
    base = first_seed()
    counts = {name: 1 if quick else kind.blocks for name, kind in KINDS.items() if there(kind.scenario)}
    ordered = [((k + 0.5) / count, name, 1000 * base + k) for name, count in counts.items() for k in range(count)]
    return [(name, seed, QUICK_BLOCK if quick else BLOCK) for _, name, seed in sorted(ordered)]


def there(scenario: str) -> bool:
    """Whether it is among those that come with the stack."""
    from flightstack.cli.files import load_scenario
    from flightstack.types import InputError

    try:
        load_scenario(scenario, None)
    except InputError:
        return False
    return True


def run(job: Job) -> dict[str, Any]:
    """One block, in a process of the pool; one that could not be flown says so."""
    began = sum(os.times()[:4])  # the flights' own processes too
    try:
        block = fly_block(*job)
    except Exception as error:  # a campaign of thousands goes on
        block = {"lost": repr(error), "flights": []}
    return block | {"kind": job[0], "seed": job[1], "cpu_s": round(sum(os.times()[:4]) - began, 2)}


def fly_block(name: str, seed: int, flights: int = BLOCK, seconds: float = ENGAGED_S) -> dict[str, Any]:
    """Learn, certify, and attack from there."""
    import numpy as np

    from benchmarks import attack_adversary as adversary
    from benchmarks.attack_flight import AttackFlight
    from benchmarks.attack_worlds import draw
    from flightstack.cli.files import load_scenario
    from flightstack.cli.versions import versions
    from flightstack.types import InputError

    kind = KINDS[name]
    world = draw(
        seed, scenario=kind.scenario, vehicle=kind.vehicle, grade=kind.grade, plant=kind.plant, late_ms=kind.late_ms
    )
    scenario, _ = load_scenario(kind.scenario, None)
    block: dict[str, Any] = {
        "commit": versions()["git_commit"],
        "world": dataclasses.asdict(world),
        "refused": "",
        "flights": [],
    }
    if world.refused(scenario.limits.thrust_max_weights):
        return block | {"refused": "too little thrust: drawn worlds that no scenario would fly"}
    try:
        flight = AttackFlight(world, seed, torque=kind.torque)
    except InputError as error:
        return block | {"refused": str(error)}
    engaged_s = flight.fly_until_engaged(LEARNING_S)
    block |= {"engaged_s": engaged_s, "ended": flight.ended}
    if engaged_s is None or flight.certificate is None:
        return block
    flight.held.hold(flight.certificate)
    block["areas_m2ps"] = [round(axis.barrier.area_m2ps, 3) for axis in flight.certificate.axes]
    rng = np.random.default_rng([11, seed])
    known = [adversary.KNOWN, adversary.PUSH, adversary.TIMED, adversary.TIMED_FAST]
    tried: list[tuple[float, Any]] = []
    for k in range(flights):
        point = None
        if k >= len(known):
            best = [x for _, x in sorted(tried, key=lambda each: each[0])[:_ELITE]]
            explore = k < len(known) + _RANDOM or len(best) < 2
            point = adversary.drawn(rng) if explore else adversary.near(best, rng)
        strategy = known[k] if point is None else adversary.decode(point)
        row = _apart(lambda k=k, strategy=strategy: _one(flight, strategy, seed * 100 + k, seconds))  # type: ignore[misc]
        row |= {"k": k, "known": point is None}
        if row.get("least_h", 0.0) < _WORTH_KEEPING_H:
            row["strategy"] = [round(v, 4) for v in strategy]
        block["flights"].append(row)
        if point is not None and row.get("share", 0.0) >= LEAST_SHARE:
            tried.append((row["least_h"], point))
    return block


def _one(flight: Any, strategy: Any, seed: int, seconds: float) -> dict[str, Any]:
    flight.reseed(seed)
    out = flight.attack(strategy, seconds)
    return {
        "share": round(out.share, 4), "least_h": round(min(out.least_h, 1.0), 4), "at_s": out.at_s,
        "broken": out.broken, "broken_s": out.broken_s, "outside": out.outside,
        "infeasible": out.infeasible, "falsified": out.falsified, "ended": out.ended,
        "intervened": out.intervened, "premises": out.premises, "premises_true": out.premises_true,
        "tilt_rad": round(out.tilt_rad, 3), "travelled_m": round(out.travelled_m, 2),
    }  # fmt: skip


def _apart(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
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
    return json.loads(text) if text else {"lost": "its process ended"}  # type: ignore[no-any-return]


def summary(blocks: list[dict[str, Any]]) -> dict[str, Any]:
    """What a table's row says of the blocks of one kind."""
    refused = [b for b in blocks if b.get("refused")]
    flown = [b for b in blocks if not b.get("refused") and "lost" not in b]
    engaged = [b for b in flown if b.get("engaged_s") is not None]
    rows = [row for b in engaged for row in b["flights"]]
    counted = [row for row in rows if row.get("share", 0.0) >= LEAST_SHARE]
    early = [row for row in rows if "lost" not in row and row["share"] < LEAST_SHARE]
    left = [row for row in rows if row.get("outside")]
    premises = sum(row["premises"] for row in rows if "lost" not in row)
    return {
        "blocks": len(blocks), "refused": len(refused), "truths": len(flown), "engaged": len(engaged),
        "flights": len(rows), "counted": len(counted), "ended_early": len(early),
        "left": len(left), "infeasible": sum(row.get("infeasible", 0) for row in rows),
        "falsified": sum(bool(row.get("falsified")) for row in rows),
        "least_h": min((row["least_h"] for row in rows if "lost" not in row), default=None),
        "premises": sum(row["premises_true"] for row in rows if "lost" not in row) / premises if premises else None,
        "lost": sum("lost" in b for b in blocks) + sum("lost" in row for row in rows),
        "limit": upper_limit(sum(bool(row.get("outside")) for row in counted), len(counted)),
        "cpu_s": sum(b["cpu_s"] for b in blocks),
    }  # fmt: skip


def upper_limit(hits: int, trials: int, confidence: float = 0.95) -> float | None:
    """Clopper-Pearson's one-sided upper limit of a share."""
    from scipy.stats import beta

    if trials == 0:
        return None
    return 1.0 if hits == trials else float(beta.ppf(confidence, hits + 1, trials - hits))


def page(results: dict[str, Any], command: str) -> str:
    """docs/barrier-campaign.md."""
    blocks = results["blocks"]
    lines = [
        "# The barrier campaign", "",
        f"{results['date']}, {results['machine']}, {results['cores']} cores, Python {results['python']}, commit "
        f"{results['git_commit']}; `{command}`, {results['wall_s'] / 60:.0f} minutes.", "",
        "An adversary stands where the nominal controller stands, knows the certificate and the true state, and wants ",
        "out: rates dithered by 0 to 6 rad/s at 1 to 15 Hz, thrust at its ends, leans, yaw swings, references through ",
        f"walls.  It attacks for {ENGAGED_S:.0f} s once the filter is engaged, {BLOCK} times from each truth ",
        f"({QUICK_BLOCK} if quick): known attacks, random ones, searched ones.  Mass 0.8 to 1.5 of the believed ",
        "one, a force up to 0.15 g, rotor lag to a fifth, inertia 0.85 to 1.2, links of 0 to 40 ms known to 2 ms with ",
        "up to 4 ms of jitter, a command every 4 to 12 ms.", "",
        "*Counted*: flights engaged for at least half of their ticks; those that ended before (falsified, guard) are ",
        "*ended early*.  *Left*: true position and velocity outside the certificate in force at any engaged tick, ",
        "early ends included.  *Premises*: share of engaged ticks in which every estimate was as good as declared.", "",
        "| kind | truths drawn | refused | engaged | flights | counted | left | at most (95 %) | infeasible steps | "
        "least h | falsified | ended early | premises | lost |",
        "| --- |" + 13 * " --: |",
    ]  # fmt: skip
    for name in KINDS:
        s = summary([b for b in blocks if b["kind"] == name])
        share = "–" if not s["truths"] else f"{s['engaged']} of {s['truths']}, {100 * s['engaged'] / s['truths']:.0f} %"
        shown = [
            s["blocks"], s["refused"], share, s["flights"], s["counted"], s["left"], _percent(s["limit"]),
            s["infeasible"], _short(s["least_h"]), s["falsified"], s["ended_early"], _percent(s["premises"]), s["lost"],
        ]  # fmt: skip
        lines.append(f"| {name} | " + " | ".join(str(value) for value in shown) + " |")
    cpu_s, flights = sum(b["cpu_s"] for b in blocks), sum(len(b["flights"]) for b in blocks)
    if flights:
        lines += ["", f"A flight took {cpu_s / flights:.1f} s of processor time, learning included."]
    return "\n".join(lines) + "\n"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.3g} %"


def _short(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}".replace("-", "−")


def gather(held: dict[campaign.Job, Any], jobs: Sequence[Any]) -> dict[str, Any]:
    """The results: the blocks of these jobs."""
    return {"blocks": [held[job] for job in jobs if job in held]}


def write_results(results: dict[str, Any], path: Path) -> None:
    """As JSON."""
    path.write_text(json.dumps(results) + "\n", encoding="utf-8")


def write_page(results: dict[str, Any], path: Path, command: str) -> None:
    """The tables."""
    path.write_text(page(results, command), encoding="utf-8")


def passed(results: dict[str, Any]) -> bool:
    """No flight left, no step was infeasible, and with the torque margin planted away some did leave."""
    fine = True
    for name, kind in KINDS.items():
        s = summary([b for b in results["blocks"] if b["kind"] == name])
        if kind.torque:
            fine = fine and not (s["left"] or s["infeasible"] or s["lost"])
        elif s["counted"] + s["ended_early"] > 50:
            fine = fine and s["left"] > 0
    return fine


CAMPAIGN = campaign.Campaign(
    "barrier", "barrier-campaign.md", (__doc__ or "").splitlines()[0], jobs_of, run, SCHEMA, gather, write_results,
    write_page, passed,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(campaign.main(CAMPAIGN))
