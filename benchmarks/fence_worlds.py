"""Random sites, truths and links for the flights of `make campaign-fence`: every figure comes from the seed.

One flight in six has GPS, in a field of 60 to 300 m; the others motion capture, in halls of 5 to 40 m.  Sites are stars
round the start, rectangles, or rooms joined by a slot; one truth in four has a mass at the end of what is declared, one
force in four its full size.  Links take 0 to 40 ms there and back.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from benchmarks.attack_worlds import World
from benchmarks.fence_flight import DITHER, PUSH, RANDOM, THROUGH, Attack
from flightstack.types import F64

KINDS = (PUSH, THROUGH, DITHER, RANDOM)
_GPS_SHARE, _EDGE_SHARE, _JSBSIM_SHARE = 1.0 / 6.0, 0.25, 0.25
_FORCE_G, _MASSES = 0.15, (0.8, 1.5)
_CLIMBED_S = 14.0
"""To 8 m, with GPS: whoever pushes before pushes into the ground under the open chute, of which nothing is promised."""
_SLOT_M = {"mocap": 1.5, "gps": 20.0}
HOVER = """schema = "flightstack.scenario/1"
name = "hover"
description = "hold a point above the start"
duration_s = 20.0

[trajectory]
kind = "hover"
position_m = [0.0, 0.0, {down}]
"""


def drawn_grade(seed: int) -> str:
    """Sensors of a flight."""
    return "gps" if np.random.default_rng([20, seed]).uniform() < _GPS_SHARE else "mocap"


def _star(rng: np.random.Generator, reach_m: float) -> F64:
    """Every corner at 0.35 to 1 of the reach."""
    count = int(rng.integers(4, 51))
    angle = np.sort((np.arange(count) + rng.uniform(0.1, 0.9, count)) * 2.0 * math.pi / count)
    radius = rng.uniform(0.35, 1.0, count) * reach_m
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def _box(rng: np.random.Generator, reach_m: float) -> F64:
    half = rng.uniform(0.5, 1.0, 2) * reach_m / math.sqrt(2.0)
    return np.array([-half, [half[0], -half[1]], half, [-half[0], half[1]]])


def _rooms(rng: np.random.Generator, reach_m: float, slot_m: float) -> F64:
    """Two rooms joined by a slot."""
    half, first, last = 0.5 * slot_m, 0.4 * reach_m, 0.6 * reach_m
    wide, way = rng.uniform(0.3, 0.5, 2) * reach_m, rng.uniform(-0.5, 0.5) * 0.25 * reach_m
    wide = np.maximum(wide, abs(way) + half + 0.1)
    return np.array([
        [-0.4 * reach_m, -wide[0]], [first, -wide[0]], [first, way - half], [last, way - half], [last, -wide[1]],
        [reach_m, -wide[1]], [reach_m, wide[1]], [last, wide[1]], [last, way + half], [first, way + half],
        [first, wide[0]], [-0.4 * reach_m, wide[0]],
    ])  # fmt: skip


def _inside(rng: np.random.Generator, reach_m: float, slot_m: float) -> F64:
    kind = int(rng.integers(4))
    if kind == 0:
        return _box(rng, reach_m)
    if kind == 1:
        return _rooms(rng, reach_m, slot_m * rng.uniform(1.0, 2.0))
    turn = rng.uniform(0.0, 2.0 * math.pi)
    c, s = math.cos(turn), math.sin(turn)
    corners: F64 = _star(rng, reach_m) @ np.array([[c, s], [-s, c]])
    return corners


def drawn_site(seed: int) -> str:
    """A site file's text: up to 50 edges and up to four pillars, spheres and blocks."""
    rng, grade = np.random.default_rng([21, seed]), drawn_grade(seed)
    scale = 1.0 if grade == "mocap" else 8.0
    reach_m = rng.uniform(2.5, 20.0) if grade == "mocap" else rng.uniform(30.0, 150.0)
    corners = _inside(rng, reach_m, _SLOT_M[grade]).round(3).tolist()
    ceiling = rng.uniform(3.5, 8.0) if grade == "mocap" else rng.uniform(20.0, 60.0)
    text = f'schema = "flightstack.site/1"\nfloor_m = 0.3\nceiling_m = {ceiling:.2f}\ninside = {corners}\n'
    for _ in range(int(rng.integers(0, 5))):
        far, way = rng.uniform(2.0 * scale, max(reach_m, 3.0 * scale)), rng.uniform(0.0, 2.0 * math.pi)
        n, e, size = far * math.cos(way), far * math.sin(way), scale * rng.uniform(0.2, 1.0)
        kind = rng.integers(3)
        if kind == 0:
            text += f"[[keep_out]]\ncentre = [{n:.2f}, {e:.2f}]\nradius_m = {size:.2f}\n"
        elif kind == 1:
            height = scale * rng.uniform(0.5, 4.0)
            text += f"[[keep_out]]\ncentre = [{n:.2f}, {e:.2f}, {height:.2f}]\nradius_m = {size:.2f}\n"
        else:
            block = [[n, e], [n + size, e], [n + size, e + size], [n, e + size]]
            low = rng.uniform(0.0, 2.0) * scale * float(rng.integers(2))
            high = low + scale * rng.uniform(0.5, 3.0)
            text += f"[[keep_out]]\npolygon = {np.round(block, 2).tolist()}\n"
            text += f"floor_m = {low:.2f}\nceiling_m = {high:.2f}\n"
    return text


def drawn_world(seed: int, folder: Path) -> World:
    """The truth and the link of a flight; with GPS the scenario's file goes into the folder."""
    rng, grade = np.random.default_rng([22, seed]), drawn_grade(seed)
    scenario = "hover"
    if grade == "gps":
        path = folder / "hover-8m.toml"
        path.write_text(HOVER.format(down=-8.0))
        scenario = str(path)
    way = rng.normal(size=3)
    size = _FORCE_G if rng.uniform() < _EDGE_SHARE else rng.uniform(0.0, _FORCE_G)
    force = size * way / np.linalg.norm(way)
    mass = float(rng.choice(_MASSES)) if rng.uniform() < _EDGE_SHARE else float(rng.uniform(*_MASSES))
    link, share = rng.uniform(0.0, 40.0), rng.uniform(0.3, 0.7)
    return World(
        seed=seed, scenario=scenario, vehicle="quad-x", grade=grade,
        plant="jsbsim" if rng.uniform() < _JSBSIM_SHARE else "native", mass_ratio=mass,
        wind_g=(float(force[0]), float(force[1]), float(force[2])), lag_ratio=float(rng.uniform(0.8, 1.2)),
        inertia_ratio=float(rng.uniform(0.85, 1.2)), down_ms=float(link * share), up_ms=float(link * (1.0 - share)),
        jitter_ms=float(rng.uniform(0.0, 4.0)), delay_error_ms=float(rng.uniform(-2.0, 2.0)),
        period_ticks=int(rng.integers(1, 4)),
    )  # fmt: skip


def drawn_attack(seed: int) -> Attack:
    """The adversary of a flight, once it is in the air.

    A third drives the force along the velocity; in a third the estimate errs as far as is declared.
    """
    rng, begins_s = np.random.default_rng([24, seed]), 4.0 if drawn_grade(seed) == "mocap" else _CLIMBED_S
    pumps, errs = (rng.uniform(size=2) < 1.0 / 3.0).tolist()
    return Attack(KINDS[seed % len(KINDS)], seed=seed, begins_s=begins_s, pumps=pumps, errs=errs)
