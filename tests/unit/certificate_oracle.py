"""What is true of a certificate file, by brute force: rollouts, dense grids, and the maker's own knowledge."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from certificates import MODEL, resealed

from flightstack.barrier.confidence import Colour
from flightstack.barrier.file import parse_certificate
from flightstack.barrier.knowledge import Envelope, InitialKnowledge, Knowledge, Request
from flightstack.barrier.margins import Accuracy, Doubts, Ledger
from flightstack.barrier.posterior import Accelerations, Posterior, Process
from flightstack.barrier.records import AxisCertificate
from flightstack.barrier.shapes import Barrier, Quadratic, Stopping
from flightstack.gp.kernels import kernel_from_dict
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

CHANGES = {
    "+1 %": lambda x: 1.01 * x,
    "-1 %": lambda x: 0.99 * x,
    "+10 %": lambda x: 1.1 * x,
    "-10 %": lambda x: 0.9 * x,
    "sign": lambda x: -x,
    "zero": lambda x: 0.0,
    "one more": lambda x: x + 1,
    "a little for nothing": lambda x: 1e-5 if x == 0.0 else x,
}


NO_CONSEQUENCE = {
    "centre_ned_m": "where the region lies; heights above the ground are looked at",
}
"""Numbers on which nothing that is proven depends."""


ONLY_MEASURED = ("applied_share", "battery_v")
"""Premises that only the flight's log can tell."""


def narrower(before: dict[str, Any], data: dict[str, Any]) -> bool:
    """Whether premises hold for no more than those before."""
    old, new = before["premises"], data["premises"]
    ranges = [(a, b) for key in ("thrust_mps2", "delay_s") for a, b in [(old[key], new[key])]]
    ranges += list(zip(old["speeds_mps"] + old["leans"], new["speeds_mps"] + new["leans"], strict=True))
    inside = all(a[0] - 1e-8 <= b[0] <= b[1] <= a[1] + 1e-8 for a, b in ranges)
    single = all(new[key] <= old[key] + 1e-8 for key in ("jitter_s", "age_s", "command_interval_s"))
    down = all(new["estimate"][key][2] == old["estimate"][key][2] for key in Accuracy._fields[:3])  # alone is certified
    return inside and single and down and new["thrust_gain"] == old["thrust_gain"]


def leaves(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where the numbers are."""
    if isinstance(data, dict):
        for key, part in data.items():
            yield from leaves(part, (*path, key))
    elif isinstance(data, list):
        for i, part in enumerate(data):
            yield from leaves(part, (*path, i))
    elif isinstance(data, int | float) and not isinstance(data, bool):
        yield path


def changes(
    text: str, wanted: Callable[[tuple[Any, ...]], bool]
) -> Iterator[tuple[tuple[Any, ...], str, dict[str, Any]]]:
    """The file's table with one number changed, in turn: where, how, and the table."""
    data: dict[str, Any] = json.loads(text)
    for path in [path for path in leaves(data) if wanted(path)]:
        inner: Any = data
        for key in path[:-1]:
            inner = inner[key]
        before = inner[path[-1]]
        for name, change in CHANGES.items():
            inner[path[-1]] = change(before)
            if inner[path[-1]] != before:
                yield path, name, data
        inner[path[-1]] = before
        if isinstance(path[-1], int) and path[-1] + 1 < len(inner) and inner[path[-1] + 1] != before:
            inner[path[-1]], inner[path[-1] + 1] = inner[path[-1] + 1], before
            yield path, "swap", data
            inner[path[-1]], inner[path[-1] + 1] = before, inner[path[-1]]


def ways_at(barrier: Barrier, e: F64, v: F64) -> list[F64]:
    """h written down once more, for arrays: of an ellipse, or towards either limit of a stopping distance."""
    if isinstance(barrier, Quadratic):
        e, v = e - barrier.centre_m, v - barrier.centre_mps
        return [np.asarray(1.0 - barrier.p11 * e * e - 2.0 * barrier.p12 * e * v - barrier.p22 * v * v)]
    b, t = barrier, barrier.reaction_s
    up, down = np.maximum(v, -b.brake_high_mps2 * t), np.maximum(-v, -b.brake_low_mps2 * t)
    rooms = (
        b.high_m - e - t * up - up * up / (2.0 * b.brake_high_mps2),
        e - b.low_m - t * down - down * down / (2.0 * b.brake_low_mps2),
    )
    return [np.asarray(2.0 * room / (b.high_m - b.low_m)) for room in rooms]


def h_at(barrier: Barrier, e: F64, v: F64) -> F64:
    """The least of them."""
    return np.asarray(np.min(ways_at(barrier, e, v), axis=0))


def untrue(text: str) -> str:
    """What brute force finds wrong with a certificate's claims; empty where it finds nothing."""
    for axis in parse_certificate(text, "file").axes:
        nodes = axis.authority.v_mps
        for cell in axis.cells:
            for i in range(len(nodes) - 1):
                low, high = max(cell[2], nodes[i]), min(cell[3], nodes[i + 1])
                if low < high and (found := broken(axis, cell, low, high)):
                    return found
        if found := uncovered(axis):
            return found
    return ""


def broken(axis: AxisCertificate, cell: F64, low: float, high: float) -> str:
    """Where a vehicle that obeys the cell's command loses h faster than the cell claims; empty if nowhere."""
    gamma, eta, rate, dt, off_m, inner, more, off_mps = axis.setting
    reach = axis.authority.reach(0.5 * (low + high))
    share = (cell[4] - reach.u_low) / (reach.u_high - reach.u_low)
    error = reach.error_low + share * (reach.error_high - reach.error_low)
    e, v = np.meshgrid(np.linspace(cell[0], cell[1], 6), np.linspace(low, high, 6))
    inside = h_at(axis.barrier, e, v) >= inner - eta + 1e-8
    if not inside.any():
        return ""
    if not reach.u_low - 1e-6 <= cell[4] <= reach.u_high + 1e-6:
        return f"command {cell[4]} is not to be had"
    xs = [h - inner - lost for h, lost in zip(ways_at(axis.barrier, e, v), lost_by_doubt(axis, e, v), strict=True)]
    alphas = [np.maximum(gamma * x, (gamma + more) * x - 0.05 * more) for x in xs]
    if isinstance(axis.barrier, Stopping):
        off_m = 0.0  # h falls as fast at any e
    for a, x, y in itertools.product((cell[4] - error, cell[4] + error), (-off_m, off_m), (-off_mps, off_mps)):
        there_e, there_v = e + x, v + y
        before = ways_at(axis.barrier, there_e, there_v)
        for t in (0.3 * dt, dt) if dt > 0.0 else (1e-7,):
            after = ways_at(axis.barrier, there_e + there_v * t + 0.5 * a * t * t, there_v + a * t)
            for now, then, alpha in zip(before, after, alphas, strict=True):
                if np.any((then - now + t * alpha)[inside] / t - rate < cell[5] - 1e-5):
                    return f"cell {cell}"
    return ""


def lost_by_doubt(axis: AxisCertificate, e: F64, v: F64) -> list[F64]:
    """By how much h of each way may be less where the true state is."""
    off_m, off_mps = axis.setting.off_m, axis.setting.off_mps
    if isinstance(axis.barrier, Quadratic):
        h = h_at(axis.barrier, e, v)
        corners = [(x * off_m, y * off_mps) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]
        return [np.asarray(np.max([h - h_at(axis.barrier, e + x, v + y) for x, y in corners], axis=0))]
    b, scale = axis.barrier, 0.5 * (axis.barrier.high_m - axis.barrier.low_m)
    lost = []
    for speed, brake in ((v, b.brake_high_mps2), (-v, b.brake_low_mps2)):
        slope = (b.reaction_s + np.maximum(speed, -brake * b.reaction_s) / brake) / scale
        lost.append(off_m / scale + slope * off_mps + off_mps**2 / (2.0 * brake * scale))
    return lost


def uncovered(axis: AxisCertificate) -> str:
    """A point of a fine grid of the region that lies in no cell."""
    low_e, high_e, low_v, high_v = axis.barrier.box
    e, v = (part.ravel() for part in np.meshgrid(np.linspace(low_e, high_e, 101), np.linspace(low_v, high_v, 101)))
    region = h_at(axis.barrier, e, v) >= 0.0
    e, v = e[region][:, None], v[region][:, None]
    e0, e1, v0, v1, *_ = axis.cells.T
    missing = ~((e0 <= e) & (e <= e1) & (v0 <= v) & (v <= v1)).any(axis=1)
    return f"nothing at {e[missing][0]}, {v[missing][0]}" if missing.any() else ""


def still_true(before: dict[str, Any], path: tuple[Any, ...], text: str) -> bool:
    """Whether a change that passed did no harm: what the filter would rely on is so, by brute force."""
    data = json.loads(text)
    if path[0] in NO_CONSEQUENCE or path[-1] in NO_CONSEQUENCE:
        return True
    if path[0] == "premises":  # they are made as wide as they may be
        return path[1] in ONLY_MEASURED or path[2:] == ("k_sigma",) or narrower(before, data)
    if path[0] == "budget":  # what the tilt may be off by is kept from leans that no certified axis needs
        acc = max(before["premises"]["estimate"]["acc_mps2"][:2])
        return path[1] == "lean_spare" and data["budget"][path[1]] >= acc / STANDARD_GRAVITY_MPS2 - 1e-8
    if path[0] == "governor":
        return bounded(before, data, path)
    if path[0] == "knowledge":
        return supported(data)
    if path[2] == "setting" and path[3] in ("eta", "off_m", "off_mps"):  # the margins need so much
        old, new = (each["axes"][0]["setting"][path[3]] for each in (before, data))
        return new >= old * (1.0 - 1.1e-3) and untrue(text) == ""
    return path[2] in ("setting", "barrier", "cells") and untrue(text) == ""


def bounded(before: dict[str, Any], data: dict[str, Any], path: tuple[Any, ...]) -> bool:
    """Whether a change of the governor's terms lets no more torque pass than before, and charges no less for it.

    Vehicle and autopilot are the vehicle file's: `fly` compares them, a file by itself can't.
    """
    if path[1] in ("vehicle", "autopilot"):
        return True
    old, new = (each["governor"][path[1]] for each in (before, data))
    if path[1] == "trim":  # mostly 0: what the margin's own leeway holds
        return bool(new <= old * 1.011 + 1.1e-3 * before["governor"]["margin"])
    if path[1] in ("roll_pitch_max", "yaw_max"):
        return bool(new <= old * 1.011)
    return bool(new >= old * 0.989)


def supported(data: dict[str, Any]) -> bool:
    """Whether the maker, which shares no code with the checker, draws the same conclusions from the knowledge."""
    certified = parse_certificate(resealed(data), "file")
    axis, known = certified.axes[0], data["knowledge"]
    processes = [
        Posterior(Process(
            kernel_from_dict(part["kernel"]), part["noise_var"], np.array(part["x"]), np.array(part["y"]),
            np.array(part["excess"]), Colour(np.array(part["inflation"]), np.array(part["remainder_mps2"])),
        ))
        for part in (known["lateral"], known["vertical"])
    ]  # fmt: skip
    model = replace(
        MODEL, rotor_radius_m=known["rotor_radius_m"],
        drag_kgps=tuple(MODEL.mass_kg * each for each in known["drag_per_s"]),
    )  # fmt: skip
    speeds = tuple((low, high) for low, high in known["speeds_mps"])
    envelope = Envelope(speeds, tuple(known["heights_m"]), known["nodes"], known["slice_only"], tuple(known["axes"]))
    told = known["initial"]
    initial = None if told is None else InitialKnowledge(tuple(told["mass_ratio"]), told["force_weights"])
    remade = Knowledge.of(
        Request(
            Accelerations(processes[0], processes[1], model), model, envelope, certified.budget, initial,
            widen_mps2=np.array(known["widen_mps2"]), torque_mps2=known["torque_mps2"],
        )
    )  # fmt: skip
    doubts = known["doubts"]
    _, margins = Ledger(
        2, axis.authority, axis.response, gamma_ps=axis.setting.gamma_ps, dt_s=axis.setting.dt_s,
        accuracy=Accuracy(*(data["premises"]["estimate"][key][2] for key in Accuracy._fields[:3])),
        doubts=Doubts(*(doubts[key] for key in Doubts._fields)), gain_part_mps2=axis.margins[1].mps2,
        torque_part_mps2=axis.margins[-1].mps2,
    )(axis.barrier)  # fmt: skip
    same = np.abs(remade.authorities[2].table - axis.authority.table).max() < 2e-6
    near = [abs(a.mps2 - b.mps2) <= 1.5e-3 * b.mps2 + 2e-6 for a, b in zip(axis.margins, margins, strict=True)]
    return bool(same and all(near) and remade.k_sigma <= certified.k_sigma + 1e-9)
