"""Blind cases with a rough vehicle file: numbers off by up to what nobody measures, alone and together, effects beside.

    python -m benchmarks.gap_rough FOLDER...       docs/gap-measured.md, of campaigns/gap-rough.toml

The flights are those of `benchmarks.gap_cases`; only the file that the workflow is given is spoilt: mass and greatest
thrust by up to 30 %, inertia by a factor of up to 1.5, motor lag by up to 3, the thrust curve anywhere from 0 to 1.
Every second file says so by ranges.  An error is named in its class where the answer holds an effect that corrects it
or, mass, thrust and inertia having a common scale that no log shows, one of the others; in numbers, thrust and inertia
over the mass of the corrected file are compared with those of what flew.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from benchmarks import campaign
from benchmarks.gap_cases import make, write
from benchmarks.gap_rules import rules
from flightstack.cli.gap import GapOptions, find_gap
from flightstack.vehicle import Vehicle, parse_vehicle, vehicle_to_toml

_BEGIN, _END = "<!-- rough: begin -->", "<!-- rough: end -->"
KINDS = ("mass", "thrust", "inertia", "lag", "curve", "all")
CLASSES = {
    "mass": {"payload", "thrust_scale", "inertia"},
    "thrust": {"payload", "thrust_scale", "inertia"},
    "inertia": {"inertia", "payload", "thrust_scale"},
    "lag": {"motor_lag", "transport_delay"},
    "curve": {"thrust_curve", "thrust_scale", "payload"},
}
FALSE = {"steady_wind", "constant_force", "accelerometer_bias", "gyro_bias", "attitude_misalignment"}
_SPREAD = {"mass": 1.3, "thrust": 1.3, "inertia": 1.5, "lag": 3.0}
Row = dict[str, Any]


def spoilt(truth: Vehicle, kind: str, ranged: bool, rng: np.random.Generator) -> Vehicle:
    """The vehicle with the numbers of one kind, or all, wrong; `ranged`: with the ranges in which the true ones lie."""

    def drawn(of: str, size: int | None = None) -> Any:
        far = np.exp(np.log(_SPREAD[of]) * rng.uniform(0.5, 1.0, size) * rng.choice([-1.0, 1.0], size))
        return far if kind in (of, "all") else np.ones_like(far)

    rotors = truth.rotors
    curve = float(rng.uniform(0.0, 1.0)) if kind in ("curve", "all") else rotors.thrust_model_factor
    wrong = replace(
        truth,
        mass_kg=float(truth.mass_kg * drawn("mass")),
        inertia_kgm2=_possible(truth.inertia_kgm2 * drawn("inertia", 3)),
        rotors=replace(
            rotors,
            max_thrust_n=float(rotors.max_thrust_n * drawn("thrust")),
            time_constant_s=float(rotors.time_constant_s * drawn("lag")),
            thrust_model_factor=round(curve, 3),
        ),
    )
    if not ranged:
        return wrong
    keys = {
        "mass": ("body.mass_kg", wrong.mass_kg),
        "inertia": ("body.inertia_kgm2", wrong.inertia_kgm2),
        "thrust": ("rotors.max_thrust_n", wrong.rotors.max_thrust_n),
        "lag": ("rotors.time_constant_s", wrong.rotors.time_constant_s),
    }
    ranges = {
        key: np.stack([np.asarray(v) / _SPREAD[of], np.asarray(v) * _SPREAD[of]], axis=-1)
        for of, (key, v) in keys.items()
        if kind in (of, "all")
    }
    if kind in ("curve", "all"):
        ranges["rotors.thrust_model_factor"] = np.array([0.0, 1.0])
    return replace(wrong, ranges=MappingProxyType(ranges))


def _possible(inertia: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """No moment is greater than the sum of the others."""
    most = int(np.argmax(inertia))
    inertia[most] = min(inertia[most], float(inertia.sum() - inertia[most]))
    return inertia


def rough(values: dict[str, Any], seed: int, folder: Path) -> Row:
    """One case, a task of a campaign: `kind` of KINDS, `beside` an effect or none, `form` plain or ranged."""
    kind, beside = str(values["kind"]), str(values["beside"])
    case = make(f"one:{beside}" if beside else "clean", seed)
    log, vehicle, _ = write(case, folder, "case")
    wrong = spoilt(case.believed, kind, values["form"] == "ranged", np.random.default_rng([seed, 7]))
    vehicle.write_text(vehicle_to_toml(wrong), encoding="utf-8")
    find_gap(GapOptions(logs=(log,), vehicle=str(vehicle), out=folder / "out"))
    said = json.loads((folder / "out" / "gap.json").read_text(encoding="utf-8"))
    found = parse_vehicle((folder / "out" / "vehicle.toml").read_text(encoding="utf-8"), "corrected")
    return judge(kind, case.truth, wrong, found, said) | {"rules": rules()}


def judge(kind: str, truth: Vehicle, rough: Vehicle, found: Vehicle, said: dict[str, Any]) -> Row:
    """What of the planted errors was named, what else was, and how far the corrected file is from what flew."""
    names = {e["name"] for e in said["effects"]} | {t for e in said["effects"] for t in e["indistinguishable_from"]}
    planted = [each for each in KINDS[:-1] if _is_planted(each, kind, truth, rough)]
    hidden = {e for e, values in truth.effects.items() if dict(rough.effects.get(e, {})) != dict(values)}
    right = {e for each in KINDS[:-1] if kind in (each, "all") for e in CLASSES[each]} | hidden
    right |= {t for e in said["effects"] if e["name"] in right for t in e["indistinguishable_from"]}
    wrong = [
        e["name"] for e in said["effects"] if e["name"] not in right and not set(e["indistinguishable_from"]) & right
    ]
    was, now = ratios(truth), ratios(found)
    return {
        "kind": kind,
        "planted": planted,
        "named": [each for each in planted if CLASSES[each] & names],
        "hidden_named": sorted(hidden & names),
        "hidden": sorted(hidden),
        "wrong": wrong,
        "false": [e for e in wrong if e in FALSE],
        "within": within(truth, rough, said, kind != "all" or bool(rough.ranges)),
        "off": {key: abs(now[key] / was[key] - 1.0) for key in was},
        "closed": said["gap"]["closed"],
        "unexplained": said["unexplained"]["significant"],
        "silent": not said["effects"] and not said["unexplained"]["significant"],
    }


def _is_planted(each: str, kind: str, truth: Vehicle, rough: Vehicle) -> bool:
    """Whether the file is wrong by enough in this to matter."""
    if each == "curve":
        return abs(truth.rotors.thrust_model_factor - rough.rotors.thrust_model_factor) > 0.1
    return kind in (each, "all")


def ratios(vehicle: Vehicle) -> dict[str, float]:
    """Thrust at two thirds of the command and inertia over the mass, effects counted: what accelerations show."""
    effects = vehicle.effects
    f = effects.get("thrust_curve", {}).get("thrust_model_factor", vehicle.rotors.thrust_model_factor)
    u = 2.0 / 3.0
    thrust = vehicle.rotors.max_thrust_n * effects.get("thrust_scale", {}).get("scale", 1.0) * (f * u * u + (1 - f) * u)
    scale = effects.get("inertia", {})
    inertia = vehicle.inertia_kgm2 * [scale.get(f"scale_{axis}", 1.0) for axis in "xyz"]
    mass = vehicle.total_mass_kg
    return {"thrust": thrust / mass, "inertia_x": inertia[0] / mass, "inertia_z": inertia[2] / mass}


def within(truth: Vehicle, rough: Vehicle, said: dict[str, Any], scaled: bool) -> list[bool]:
    """Which intervals of the effects that correct numbers hold what is true of this file.

    Where plain numbers are wrong all together, those with mass in their unit have no truth of their own: the file says
    that each of them is known, and any of them may be taken at its word.
    """
    true = {
        "payload": {"mass_kg": truth.total_mass_kg - rough.mass_kg},
        "thrust_scale": {"scale": truth.rotors.max_thrust_n / rough.rotors.max_thrust_n},
        "thrust_curve": {"thrust_model_factor": truth.rotors.thrust_model_factor},
        "motor_lag": {"time_constant_s": truth.rotors.time_constant_s},
        "inertia": {f"scale_{a}": truth.inertia_kgm2[i] / rough.inertia_kgm2[i] for i, a in enumerate("xyz")},
    }
    if not scaled:
        true = {name: true[name] for name in ("thrust_curve", "motor_lag")}
    hits = []
    for effect in said["effects"]:
        for parameter, value in true.get(effect["name"], {}).items():
            low, high = effect["parameters"][parameter]["ci95"]
            if low is not None and high is not None:
                hits.append(bool(low - 1e-9 <= value <= high + 1e-9))
    return hits


def summary(rows: list[Row]) -> dict[str, Any]:
    """The figures over these cases."""
    judged = [row for row in rows if "lost" not in row]

    def share(values: list[bool]) -> str:
        return f"{100.0 * sum(values) / len(values):.1f} %" if values else "–"

    off = {key: [row["off"][key] for row in judged] for key in ("thrust", "inertia_x", "inertia_z")}
    return {
        "cases": len(rows),
        "lost or refused": len(rows) - len(judged),
        "planted errors named in their class": share([e in row["named"] for row in judged for e in row["planted"]]),
        "effects beside named": share([e in row["hidden_named"] for row in judged for e in row["hidden"]]),
        "cases with a wrong name": share([bool(row["wrong"]) for row in judged]),
        "cases with a false wind, force, bias or misalignment": share([bool(row["false"]) for row in judged]),
        "intervals that hold the truth": share([hit for row in judged for hit in row["within"]]),
        "corrected thrust over mass, median and worst off": _off(off["thrust"]),
        "corrected inertia over mass (roll)": _off(off["inertia_x"]),
        "corrected inertia over mass (yaw)": _off(off["inertia_z"]),
        "closed by 90 %": share([row["closed"] is not None and row["closed"] >= 0.9 for row in judged]),
        "unexplained": share([row["unexplained"] for row in judged]),
        "nothing said": sum(row["silent"] for row in judged),
    }


def _off(values: list[float]) -> str:
    return f"{100.0 * float(np.median(values)):.1f} %, {100.0 * max(values):.0f} %" if values else "–"


def table(rows: list[Row]) -> list[str]:
    """Figures of all cases, of those of one error and of all together, of plain files and of ranged ones."""
    groups = {
        "all": rows,
        "one error": [r for r in rows if r["job_kind"] != "all"],
        "all together": [r for r in rows if r["job_kind"] == "all"],
        "plain": [r for r in rows if not r["ranged"]],
        "ranges": [r for r in rows if r["ranged"]],
    }
    figures = {name: summary(each) for name, each in groups.items()}
    lines = [f"| figure | {' | '.join(groups)} |", f"| --- |{' --: |' * len(groups)}"]
    return [*lines, *(f"| {key} | {' | '.join(str(f[key]) for f in figures.values())} |" for key in figures["all"])]


if __name__ == "__main__":
    entries = campaign.flown(sys.argv[1:])
    cases = [campaign.result(e) | {"job_kind": e["values"]["kind"], "ranged": e["values"]["form"] == "ranged"}
             for e in entries if campaign.result(e).get("rules", rules()) == rules()]  # fmt: skip
    made = "\n".join([campaign.about(entries, "make gap-rough", f"{len(cases)} cases"), "", *table(cases)])
    campaign.put(made, _BEGIN, _END)
    print(made)
