"""A blind case: flown, and written as files that hold no trace of the answer; the answer lies elsewhere, sealed.

    python -m benchmarks.gap_cases --out DIR --count 20 --seed 0 [--kind one:payload]     cases to look at by hand

writes DIR/case-NNNNN.csv and DIR/case-NNNNN.toml (the believed vehicle) and DIR/sealed/case-NNNNN.json.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import gap_draw
from benchmarks.gap_flights import (
    DT_US,
    L_FORCE,
    L_MOTOR,
    L_NORMAL,
    L_POS,
    L_Q,
    L_RATE,
    L_VEL,
    L_VOLTAGE,
    Flown,
    Senses,
    fly,
    fly_plant,
)
from benchmarks.gap_judge import judge
from benchmarks.gap_mcap import write_mcap
from benchmarks.gap_rules import rules
from flightstack.cli.files import load_vehicle
from flightstack.cli.gap import GapOptions, find_gap
from flightstack.types import F64, InputError
from flightstack.vehicle import Vehicle, vehicle_to_toml, with_effects
from flightstack_sim.jsbsim.aircraft import REFUSED
from flightstack_sim.plant import Plant

HEADER = (
    "time_s,pos_n_m,pos_e_m,pos_d_m,vel_n_mps,vel_e_mps,vel_d_mps,q_w,q_x,q_y,q_z,rate_x_radps,rate_y_radps,"
    "rate_z_radps,accel_x_mps2,accel_y_mps2,accel_z_mps2,motor_1,motor_2,motor_3,motor_4,battery_v"
)
RATES_HZ = (100, 125, 200, 250)
IMU_MS = 4
"""Gyro and accelerometer are means over so many milliseconds, half of them before the stamp."""
TRIES = 20


@dataclass(frozen=True, slots=True)
class Answer:
    """What only the judge reads."""

    effects: dict[str, dict[str, float]]
    """Hidden effects of the table: absolute values, as they stand in the true vehicle's file."""
    outside: str
    """What is hidden and not in the table; empty where nothing is."""
    depends_on: tuple[str, ...]
    rich: bool
    """Whether every kind of manoeuvre was flown."""
    notes: dict[str, float]
    """Offsets and noise that were drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """What the workflow is given (believed vehicle, measured columns), what is sealed, and the true vehicle."""

    believed: Vehicle
    table: dict[str, F64]
    """Column of `HEADER` -> (N,), and `on_ground`."""
    answer: Answer
    truth: Vehicle
    flown: Flown


def make(kind: str, seed: int, *, plant: str = "native") -> Case:
    """A case of `kind`: clean, one:NAME, two, three, outside:NAME; a flight that crashes is drawn anew.

    `plant`: native, or jsbsim (the effects of the table only).
    """
    for attempt in range(TRIES):
        rng = np.random.default_rng([seed, attempt, *kind.encode()])
        case = _make(kind, rng, plant)
        if case is not None:
            return case
    raise RuntimeError(f"{kind} {seed}: no flight came down whole in {TRIES} tries")


def other_plant(truth: Vehicle, seed: int) -> Plant:
    """The truth on JSBSim: other equations, other integrators, other code."""
    from flightstack_sim.jsbsim.plant import JsbsimPlant

    made: Plant = JsbsimPlant(truth, seed=seed, dt_us=DT_US)
    return made


def _names(kind: str, rng: np.random.Generator) -> list[str]:
    if kind.startswith("one:"):
        return [kind.removeprefix("one:")]
    count = {"two": 2, "three": 3}.get(kind, 0)
    return [str(name) for name in rng.choice(list(gap_draw.EFFECTS), count, replace=False)]


def _make(kind: str, rng: np.random.Generator, plant: str) -> Case | None:
    names = _names(kind, rng)
    outside_name = kind.removeprefix("outside:") if kind.startswith("outside:") else ""
    believed = gap_draw.vehicle(rng, drag=bool(gap_draw.NEEDS_DRAG & set(names)))
    while gap_draw.NEEDS_BATTERY & set(names) and believed.battery is None:
        believed = gap_draw.vehicle(rng, drag=False)
    hidden = {name: gap_draw.EFFECTS[name](rng, believed) for name in names}
    try:
        truth = with_effects(believed, hidden)
        outside, depends_on = gap_draw.outside(rng, believed, outside_name)
        rich = bool(rng.random() < 0.8)
        reference = gap_draw.plan(rng, believed, rich=rich)
        scale = float(np.exp(rng.uniform(np.log(0.4), np.log(2.0))))
        senses = Senses(0.003 * scale, 0.02 * scale, 0.006 * scale)
        rate_hz = int(rng.choice(RATES_HZ))
        hold_ms = int(rng.choice([2, 1000 // rate_hz]))  # logged whole, or sampled from a faster loop
        drawn = int(rng.integers(2**31))
        if plant == "native":
            flown = fly(believed, truth, reference, outside, seed=drawn, senses=senses, hold_ms=hold_ms)
        else:
            other = other_plant(truth, drawn)
            flown = fly_plant(other, believed, truth, reference, seed=drawn, senses=senses, hold_ms=hold_ms)
    except InputError:  # too stiff for the plant's step
        return None
    if flown.crashed or float(np.max(np.linalg.norm(flown.rows[:, :3], axis=1))) > 60.0:
        return None
    table, notes = measure(flown, truth, rng, scale, rate_hz)
    notes["hold_ms"] = hold_ms
    return Case(believed, table, Answer(hidden, outside_name, depends_on, rich, notes), truth, flown)


def measure(
    flown: Flown, truth: Vehicle, rng: np.random.Generator, scale: float, rate_hz: int
) -> tuple[dict[str, F64], dict[str, float]]:
    """The flight as a log has it, column by column: sampled, late by topic, noisy; and what was drawn."""
    rows = flown.rows
    late = {
        "position": float(rng.choice([0.0, rng.uniform(0.004, 0.04)])),
        "imu": float(rng.choice([0.0, 0.0, 0.0, rng.uniform(-0.006, 0.006)])),
    }
    stamps = np.arange(10 * (1000 // rate_hz), len(rows) - 60, 1000 // rate_hz)  # ms; row k ends at k + 1
    t_s = 1e-6 * DT_US * stamps
    noise = {"pos": 0.002, "vel": 0.015, "q": 0.0012, "rate": 0.003, "accel": 0.06, "battery": 0.01}

    def at(columns: slice, late_s: float = 0.0) -> F64:
        index = np.clip(np.rint((t_s - late_s) / (1e-6 * DT_US)).astype(int) - 1, 0, len(rows) - 1)
        return np.asarray(rows[index, columns])

    def noisy(values: F64, name: str) -> F64:
        return values + scale * noise[name] * rng.standard_normal(values.shape)

    def mean(columns: slice) -> F64:
        totals = np.cumsum(np.vstack([np.zeros(columns.stop - columns.start), rows[:, columns]]), axis=0)
        end = np.rint((t_s - late["imu"]) / (1e-6 * DT_US)).astype(int) + IMU_MS // 2
        return np.asarray((totals[end] - totals[end - IMU_MS]) / IMU_MS)

    biased = truth.effects.get("accelerometer_bias", {}), truth.effects.get("gyro_bias", {})
    accel_bias = [biased[0].get(f"{axis}_mps2", 0.0) for axis in "xyz"]
    gyro_bias = [biased[1].get(f"{axis}_radps", 0.0) for axis in "xyz"]
    table = [
        noisy(at(slice(L_POS, L_POS + 3), late["position"]), "pos"),
        noisy(at(slice(L_VEL, L_VEL + 3), late["position"]), "vel"),
        _attitude(at(slice(L_Q, L_Q + 4)), truth, scale * noise["q"], rng),
        noisy(mean(slice(L_RATE, L_RATE + 3)), "rate") + gyro_bias,
        noisy(mean(slice(L_FORCE, L_FORCE + 3)), "accel") + accel_bias,
        np.round(rows[stamps, L_MOTOR : L_MOTOR + 4], 6),  # sent at the stamp
    ]
    columns = HEADER.split(",")
    if truth.battery is None:
        columns = columns[:-1]
    else:
        table.append(noisy(at(slice(L_VOLTAGE, L_VOLTAGE + 1)), "battery"))
    first = int(rng.choice([0, int(rng.uniform(5.0, 8.0) * rate_hz)]))  # some logs begin in the air
    data = np.hstack([(t_s + float(rng.uniform(0.0, 500.0)))[:, None], *table])[first:]
    named = dict(zip(columns, data.T, strict=True)) | {"on_ground": rows[stamps[first:], L_NORMAL] > 0.0}
    return named, {**late, "rate_hz": rate_hz, "noise_scale": scale}


def as_csv(table: dict[str, F64]) -> str:
    """The contract's CSV."""
    columns = [name for name in HEADER.split(",") if name in table]
    lines = [",".join(columns)]
    rows = np.stack([table[name] for name in columns], axis=1).tolist()
    lines += [
        f"{row[0]:.6f}," + ",".join("" if value != value else f"{value:.7g}" for value in row[1:]) for row in rows
    ]
    return "\n".join(lines) + "\n"


def with_slow_motors(table: dict[str, F64]) -> dict[str, F64]:
    """The table with commands ten times a second, as PX4 logs them by default; NaN between."""
    tenth = np.floor(table["time_s"] / 0.1)
    kept = np.diff(tenth, prepend=tenth[0] - 1.0) > 0.0
    return table | {name: np.where(kept, table[name], np.nan) for name in (f"motor_{k}" for k in range(1, 5))}


def _attitude(q: F64, truth: Vehicle, std_rad: float, rng: np.random.Generator) -> F64:
    """The measured attitude: the true one, the misalignment, small white errors."""
    from flightstack.frames import quat_from_euler

    given = truth.effects.get("attitude_misalignment", {})
    turn = quat_from_euler(*(given.get(f"{axis}_rad", 0.0) for axis in ("roll", "pitch", "yaw")))
    small = np.hstack([np.ones((len(q), 1)), 0.5 * std_rad * rng.standard_normal((len(q), 3))])
    measured = _times(_times(q, np.tile(turn, (len(q), 1))), small)
    return np.asarray(measured / np.linalg.norm(measured, axis=1, keepdims=True))


def _times(a: F64, b: F64) -> F64:
    """Hamilton products row by row."""
    aw, ax, ay, az = a.T
    bw, bx, by, bz = b.T
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=1,
    )


def write(case: Case, folder: Path, stem: str, form: str = "csv") -> tuple[Path, Path, Path]:
    """Log (`form`: csv, slow: with slow motors, mcap) and vehicle into `folder`, the answer into `folder/sealed`."""
    sealed = folder / "sealed"
    sealed.mkdir(parents=True, exist_ok=True)
    log, vehicle, answer = (
        folder / f"{stem}.{'mcap' if form == 'mcap' else 'csv'}",
        folder / f"{stem}.toml",
        sealed / f"{stem}.json",
    )
    if form == "mcap":
        write_mcap(log, case.table, case.table["on_ground"])
    else:
        table = with_slow_motors(case.table) if form == "slow" else case.table
        log.write_text(as_csv(table), encoding="utf-8")
    vehicle.write_text(vehicle_to_toml(case.believed), encoding="utf-8")
    answer.write_text(json.dumps(as_json(case.answer)) + "\n", encoding="utf-8")
    return log, vehicle, answer


def as_json(answer: Answer) -> dict[str, Any]:
    """For the sealed file."""
    return {
        "effects": answer.effects,
        "outside": answer.outside,
        "depends_on": list(answer.depends_on),
        "rich": answer.rich,
        "notes": answer.notes,
    }


def blind(values: dict[str, Any], seed: int, folder: Path) -> dict[str, Any]:
    """A case named without a look at its answer, and judged: a task of `campaigns/gap-blind.toml`.

    `kind` as for `make`, `form` as for `write`, `plant`: jsbsim flies what it can, the native one what it refuses.
    """
    kind, plant = str(values["kind"]), str(values["plant"])
    if kind.startswith("outside:") or kind in {f"one:{effect}" for effect in REFUSED}:
        plant = "native"
    log, vehicle, sealed = write(make(kind, seed, plant=plant), folder, "case", str(values["form"]))
    began = time.perf_counter()
    find_gap(GapOptions(logs=(log,), vehicle=str(vehicle), out=folder / "out"))
    wall_s = round(time.perf_counter() - began, 2)
    said = json.loads((folder / "out" / "gap.json").read_text(encoding="utf-8"))
    row = judge(json.loads(sealed.read_text(encoding="utf-8")), said, load_vehicle(str(vehicle))[0])
    return row | {"flown_on": plant, "case_s": wall_s, "rules": rules()}


def kinds() -> list[str]:
    """Every kind of case."""
    ones = [f"one:{name}" for name in gap_draw.EFFECTS]
    return ["clean", *ones, "two", "three", *(f"outside:{name}" for name in gap_draw.OUTSIDE)]


def main() -> int:
    """Write some cases."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=20, help="of each kind named, or in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--form", choices=("csv", "slow", "mcap"), default="csv")
    parser.add_argument("--kind", action="append", help="clean, one:NAME, two, three, outside:NAME (may be repeated)")
    options = parser.parse_args()
    every = kinds()
    wanted = options.kind * options.count if options.kind else [every[k % len(every)] for k in range(options.count)]
    for k, kind in enumerate(wanted):
        write(make(kind, options.seed + k), options.out, f"case-{options.seed + k:05d}", options.form)
    print(f"wrote {len(wanted)} cases into {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
