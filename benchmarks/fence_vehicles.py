"""Vehicles as strangers make them, kept in sites against adversaries: the task of `campaigns/fence-vehicles.toml`.

Shipped ones, a racer, a Crazyflie, a heavy lifter, and drawn ones: thrust-to-weight 1.5 to 10,
curve 0 to 1, motor lag 5 to 80 ms, arm 0.06 to 0.5 m, mass 0.03 to 8 kg with inertia to fit, PX4's rate limits up to
its greatest, drag.  Truths are at the edge of what is declared twice as often as inside; sites are `fence_worlds`', one
in three lower, with keep-outs that stand and that hang.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack_worlds import World
from benchmarks.fence_flight import Attack, FenceFlight
from benchmarks.fence_worlds import drawn_attack, drawn_site, drawn_world
from flightstack.site.stopping import HONEST, Told

_EDGE_SHARE, _LOW_SHARE = 2.0 / 3.0, 1.0 / 3.0
_FORCE_G = 0.15


def vehicle_text(
    name: str, mass_kg: float, weights: float, arm_m: float, lag_s: float, curve: float, more: str = ""
) -> str:
    """A vehicle file of an X; inertia as of a body whose mass lies at half the arm (a third more about z)."""
    half, thrust = arm_m / np.sqrt(2.0), weights * mass_kg * 9.80665 / 4.0
    gyration = mass_kg * (0.5 * arm_m) ** 2
    inertia = [gyration, 1.05 * gyration, 1.7 * gyration]
    ratio, radius = 0.08 * arm_m, 0.55 * arm_m
    places = [[half, half, 0.0], [-half, -half, 0.0], [half, -half, 0.0], [-half, half, 0.0]]
    return (
        f'schema = "flightstack.vehicle/1"\nname = "{name}"\n[body]\nmass_kg = {mass_kg:.5g}\n'
        f"inertia_kgm2 = {[float(f'{each:.4g}') for each in inertia]}\n[rotors]\n"
        f"position_m = {np.round(places, 4).tolist()}\n"
        f"torque_ratio_m = {[float(f'{each:.4g}') for each in (ratio, ratio, -ratio, -ratio)]}\n"
        f"max_thrust_n = {thrust:.5g}\nmax_speed_radps = 1500.0\nthrust_model_factor = {curve:.3f}\n"
        f"time_constant_s = {lag_s:.4f}\nradius_m = {radius:.4f}\n{more}"
    )


KINDS = {
    "racer": vehicle_text("racer-250", 0.6, 6.0, 0.125, 0.02, 1.0),
    "crazyflie": vehicle_text("crazyflie", 0.032, 1.9, 0.065, 0.03, 1.0),
    "lifter": vehicle_text("lifter-5kg", 5.0, 2.0, 0.4, 0.06, 0.9),
    "whoop": vehicle_text("whoop", 0.05, 4.0, 0.07, 0.015, 1.0),
    "photo": vehicle_text("photo-1kg4", 1.4, 2.4, 0.18, 0.035, 0.8),
}


def drawn_vehicle(seed: int) -> str:
    """The text of a vehicle file."""
    rng = np.random.default_rng([25, seed])
    mass_kg = float(np.exp(rng.uniform(np.log(0.03), np.log(8.0))))
    arm_m = float(np.clip(0.19 * mass_kg ** (1.0 / 3.0) * rng.uniform(0.7, 1.5), 0.06, 0.5))
    weights = float(np.exp(rng.uniform(np.log(1.5), np.log(10.0))))
    lag_s = float(np.exp(rng.uniform(np.log(0.005), np.log(0.08))))
    more = ""
    if rng.uniform() < 0.3:
        more += "[effects.linear_drag]\n" + "".join(
            f"d_{axis}_kgps = {mass_kg * rng.uniform(0.05, 0.6):.4g}\n" for axis in "xyz"
        )
    if rng.uniform() < 0.3:
        most = float(rng.choice([90.0, 360.0, 720.0, 1800.0]))
        more += "[autopilot]\n" + "".join(f"mc_{axis}rate_max = {most}\n" for axis in ("roll", "pitch"))
    return vehicle_text("drawn", mass_kg, weights, arm_m, lag_s, float(rng.uniform(0.0, 1.0)), more)


def drawn_room(seed: int, times: float = 1.0) -> str:
    """A site; one in three is low, with what stands on its floor and what hangs from its ceiling.  `times`: as much
    longer and wider, for a vehicle that needs more room than was drawn."""
    text, rng = drawn_site(seed), np.random.default_rng([26, seed])
    if rng.uniform() < _LOW_SHARE:
        text = _low(text, rng)

    def longer(line: re.Match[str]) -> str:
        places = np.array(json.loads(line[2]))
        places[..., :2] *= times
        return f"{line[1]}{places.round(3).tolist()}"

    return re.sub(r"((?:inside|polygon|centre) = )(.*)", longer, text) if times != 1.0 else text


def _low(text: str, rng: np.random.Generator) -> str:
    """With a low ceiling and four blocks."""
    ceiling = rng.uniform(2.5, 4.0)
    text = re.sub(r"ceiling_m = [0-9.]+\n", f"ceiling_m = {ceiling:.2f}\n", text, count=1)
    for low, high in ((0.0, 0.6), (ceiling - 0.6, ceiling)):
        far, way, size = rng.uniform(2.0, 6.0), rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.5, 2.0)
        n, e = far * np.cos(way), far * np.sin(way)
        block = np.round([[n, e], [n + size, e], [n + size, e + size], [n, e + size]], 2).tolist()
        text += f"[[keep_out]]\npolygon = {block}\nfloor_m = {low:.2f}\nceiling_m = {high:.2f}\n"
    return text


def drawn_truth(seed: int, vehicle: str, folder: Path, edge_share: float = _EDGE_SHARE) -> World:
    """World and link of a seed, with motion capture, for a vehicle (its name or file)."""
    rng, world = np.random.default_rng([27, seed]), drawn_world(seed, folder)
    plant = "native" if vehicle == "f450" else world.plant  # JSBSim's own takes no other lag
    world = replace(world, vehicle=vehicle, grade="mocap", scenario="hover", plant=plant)
    if rng.uniform() < edge_share:
        way = rng.normal(size=3)
        force = (_FORCE_G * way / np.linalg.norm(way)).tolist()
        mass, lag, inertia = rng.choice([0.8, 1.5]), rng.choice([0.8, 1.2]), rng.choice([0.85, 1.2])
        world = replace(
            world, mass_ratio=float(mass), wind_g=tuple(force), lag_ratio=float(lag), inertia_ratio=float(inertia)
        )
    return world


def flight(values: dict[str, Any], seed: int, folder: Path) -> dict[str, Any]:
    """One flight of `seconds`; `kind`: a shipped vehicle, one of KINDS, or drawn; `times`: of its room, if not 1."""
    kind = values["kind"]
    text = drawn_vehicle(seed) if kind == "drawn" else KINDS.get(kind, "")
    if text:
        (folder / "vehicle.toml").write_text(text)
    world = drawn_truth(seed, str(folder / "vehicle.toml") if text else kind, folder)
    attack = replace(drawn_attack(seed), begins_s=4.0)
    return _flown(world, attack, seed, folder, values)


def planted(values: dict[str, Any], seed: int, folder: Path) -> dict[str, Any]:
    """One flight of quad-x with a margin away: `away` a field of `Told`, "nothing", "all", or "half" of all.

    Every truth is at the edge of what is declared, the force drives the loop, the estimate errs by all; `slid`: whether
    a command is slid along what is near, or the way out alone keeps the vehicle in.
    """
    away = values["away"]
    shares = {"nothing": HONEST, "all": Told.all(0.0), "half": Told.all(0.5)}
    told = shares[away] if away in shares else HONEST._replace(**{away: 0.0})
    world = drawn_truth(seed, "quad-x", folder, edge_share=1.0)
    attack = replace(drawn_attack(seed), begins_s=4.0, pumps=True, errs=True)
    row = _flown(world, attack, seed, folder, values, told=told, unslid=not values["slid"])
    row.pop("failure", None)  # it is looked for
    return row


def _flown(
    world: World, attack: Attack, seed: int, folder: Path, values: dict[str, Any], **more: Any
) -> dict[str, Any]:
    site = folder / "site.toml"
    site.write_text(drawn_room(seed, values.get("times", 1.0)))
    flown = FenceFlight(world, site, attack, **more)
    out = flown.run(values["seconds"])
    row = {
        "attack": attack.kind, "errs": attack.errs, "pumps": attack.pumps, "plant": world.plant,
        "ticks": out.ticks, "engaged": out.engaged, "exits": out.exits, "first": flown.score.outside_first,
        "nearest_m": round(out.nearest_m, 3), "changed": out.changed, "stopped": out.kept, "broken": out.broken,
        "ended": out.ended, "left": int(out.exits > 0), "cut": int(bool(out.ended)), "opened": int(out.broken > 0),
        "rest_m": round(flown.plan_of.certificate.radius_m, 3),
    }  # fmt: skip
    if out.exits:
        row["failure"] = f"left: {flown.score.outside_first}"
    elif out.engaged < 0.95 * out.ticks:
        row["failure"] = f"engaged in {out.engaged} of {out.ticks} ticks"
    return row
