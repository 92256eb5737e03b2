"""The checker of certificate files: proves anew what a file claims, and shares no code with what made it.

Only numpy and the standard library are used.  In this order: the seal; the thrust budget; the knowledge and each axis'
`authority` from its points; the premises; the governor; the ledger with eta and b; the cells' claims and that they
cover the region.

A number that is changed under a new seal is refused, unless nothing that is claimed becomes untrue:

    a cell's q made smaller, or larger by less than what is left; its edges moved into its neighbours or outside the
        region; another command that does as well
    eta, b, b_u larger, gamma, dt, the barrier another, where all cells still hold and the margins still follow
    knowledge that no bound rests on: of axes that are not certified, of bounds that others cut, an effect below 1e-6
    centre_ned_m: where the region lies (but for its height above the ground)

Slack: 1e-9 in q, h and commands, 1e-6 m/s^2 in what the knowledge gives, 0.1 % in the ledger.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np

from . import floors, knowledge
from .autopilot import check_gyro
from .box import Box
from .cells import check_cells
from .condition import Condition, Piece
from .confidence import check_confidence
from .governor import check_governor
from .intervals import F64, Interval
from .ledger import N_ERROR_LOW, N_HIGH, N_LOW, check_ledger
from .log import FlightRecording
from .premises import check_premises, estimate_of
from .provenance import check_flight, check_keys
from .reading import Refused, Unreadable, number, numbers, rows, seal_of, table_of, unsealed
from .stopping import check_stopping, is_stopping

_TOP = (
    "schema", "mode", "version", "centre_ned_m", "delta", "k_sigma", "budget", "axes", "premises", "provenance",
    "confidence", "governor", "knowledge",
)  # fmt: skip
_AXIS = ("axis", "barrier", "setting", "response", "authority", "margins", "cells")
_AXES = ("north", "east", "down")
_BUDGET = (
    "north_least", "north_most", "east_least", "east_most", "low_mps2", "high_mps2", "thrust_max_mps2", "tilt_max_rad",
    "lean_spare",
)  # fmt: skip
_AUTHORITY = ("v_mps", "offset_mps2", "gain", "u_low_mps2", "u_high_mps2", "error_low_mps2", "error_high_mps2")
_CORNER = 1e-7
_SETTING = ("gamma_ps", "eta", "rate_ps", "dt_s", "off_m", "inner", "inside_ps", "off_mps")
_KINDS = {
    "quadratic": ("centre_m", "centre_mps", "p11", "p12", "p22"),
    "stopping": ("low_m", "high_m", "reaction_s", "brake_high_mps2", "brake_low_mps2"),
}


SELF_CONSISTENT = "self-consistent, not tied to a flight"
DERIVED = "derived from the log of its flight"


@dataclass
class Verdict:
    """What was found: `lines` say what was verified, with counts; where it is not valid, the last one says why."""

    valid: bool
    lines: list[str] = field(default_factory=list)
    readable: bool = True
    """False where it is no certificate file, or larger than any; then there is one line."""
    level: str = SELF_CONSISTENT
    """How far what is true of a valid file reaches."""


def check(text: str, log: BinaryIO | FlightRecording | None = None, vehicle: bytes | None = None) -> Verdict:
    """Verify a certificate file's text, and against a flight's log where one is given; never raises.

    `vehicle`: the vehicle file; without it the one that the log carries.

    Memory and time are bounded by what `bounds` lets pass; whoever wants a hard limit calls it in a process of its own.
    """
    verdict = Verdict(False)
    try:
        with np.errstate(all="ignore"):
            _check(text, verdict.lines, log, vehicle)
        verdict.valid, verdict.level = True, SELF_CONSISTENT if log is None else DERIVED
    except Unreadable as unreadable:
        verdict.lines, verdict.readable = [str(unreadable)], False
    except Refused as refused:
        verdict.lines.append(str(refused))
    except (ArithmeticError, AttributeError, LookupError, MemoryError, RecursionError, TypeError, ValueError) as error:
        verdict.lines, verdict.readable = [f"not to be read as a certificate: {type(error).__name__}"], False
    return verdict


def _check(text: str, lines: list[str], log: BinaryIO | FlightRecording | None, vehicle: bytes | None) -> None:
    if is_stopping(text):
        if log is not None:
            raise Unreadable("a certificate of a stop is not derived from a log: leave out --log")
        lines += check_stopping(text)
        return
    data = table_of(unsealed(text), _TOP, "certificate")
    lines.append("seal: fits")
    if data["mode"] != "sound":
        raise Refused("mode is not sound: the published conditions prove nothing that could be verified")
    number(data["version"], "version")
    delta, k = number(data["delta"], "delta"), number(data["k_sigma"], "k_sigma")
    centre = rows([data["centre_ned_m"]], 3, "centre_ned_m")[0]
    box = _budget(data["budget"], lines)
    known = knowledge.read(data["knowledge"], box, delta, k, data["version"])
    if not isinstance(data["axes"], list) or not data["axes"]:
        raise Refused("axes must be a list, at least one")
    axes = [table_of(axis, _AXIS, f"axes[{i}]") for i, axis in enumerate(data["axes"])]
    names = [axis["axis"] for axis in axes]
    if any(name not in _AXES for name in names) or len(set(names)) != len(names):
        raise Refused(f"axes must be of {', '.join(_AXES)}, each once")
    estimate = estimate_of(data["premises"])
    check_confidence(data["confidence"], delta, k)
    check_keys(data["provenance"], known.stores)
    sensors = data["premises"].get("sensors") if isinstance(data["premises"], dict) else None
    floors.check_noise([store.noise_var for store in known.stores], sensors)
    floors.check_radius(float(known.data["rotor_radius_m"]))
    if known.stores:
        floors.check_doubts(known.data.get("doubts"))
    tables = knowledge.tables(known)
    lines.append(check_premises(data["premises"], axes, data["budget"], known, tables[knowledge.DOWN]))
    lines.append(check_governor(data["governor"], data["budget"], known))
    check_gyro(data["governor"]["vehicle"]["gyro_noise_radps_rthz"], sensors)
    for name, axis in zip(names, axes, strict=True):
        condition, middle = _condition(axis, name)
        floors.check_hold(condition.dt)
        nodes = _nodes(axis["authority"], name)
        if _AXES.index(name) not in tables:
            raise Refused(f"{name} is not among knowledge.axes")
        _compare(nodes, tables[_AXES.index(name)], known, name, lines)
        lines.append(check_ledger(condition, axis, nodes, known, name, estimate[_AXES.index(name)]))
        if name == "down":
            _check_heights(condition, float(centre[2]), known)
        cells = rows(axis["cells"], 6, f"{name}.cells")
        lines.append(check_cells(condition, cells, nodes[[0, 3, 4, 5, 6]], middle, name))
    if log is not None:
        lines += check_flight(data, known, log, vehicle, seal_of(text))


def _budget(value: Any, lines: list[str]) -> Box:
    """The tilt cone holds the furthest of the leans, and full thrust reaches `high` wherever it leans."""
    *ends, low, high, most, tilt, spare = numbers(value, _BUDGET, "budget")
    leans = np.array(ends).reshape(2, 2)
    if not (np.all(leans[:, 0] <= leans[:, 1]) and 0.0 <= low < high and 0.0 <= tilt < 0.5 * math.pi and spare >= 0.0):
        raise Refused(
            "budget: leans must be ranges in order, low and spare at least 0, high above low, tilt in 0 to pi / 2"
        )
    if not abs(high - most * math.cos(tilt)) <= knowledge.NEAR:
        raise Refused(
            f"budget: high_mps2 = {high:.9g} is not thrust_max_mps2 at full tilt, {most * math.cos(tilt):.9g}"
        )
    box = Box(leans, spare, low, high)
    if not abs(box.corner - math.sin(tilt)) <= _CORNER:
        raise Refused(f"budget: tilt_max_rad = {tilt:.9g} is not that of the furthest lean, {box.corner:.9g}")
    lines.append(f"budget: thrust up to {most:.4g} m/s^2, leaning up to {tilt:.4g} rad")
    return box


def _check_heights(condition: Condition, centre_m: float, known: knowledge.StatedKnowledge) -> None:
    """The nearness to the ground was looked at for all heights of the region."""
    low, high = (-centre_m - e for e in reversed(condition.reach_m()))
    least = 0.5 * float(known.data["rotor_radius_m"])  # nothing changes below
    if not (known.heights[0] <= max(low, least) + 1e-9 and high <= known.heights[1] + 1e-9):
        raise Refused(f"knowledge.heights_m do not hold the region's {low:.6g} to {high:.6g} m")


def _compare(nodes: F64, table: F64, known: knowledge.StatedKnowledge, name: str, lines: list[str]) -> None:
    """The stated authority is that of the knowledge."""
    if nodes.shape != table.shape:
        raise Refused(f"{name}.authority has {nodes.shape[1]} nodes, the knowledge {table.shape[1]}")
    off = np.abs(nodes - table)
    if not off.max() <= knowledge.NEAR:
        row, node = np.unravel_index(np.argmax(np.nan_to_num(off, nan=np.inf)), off.shape)
        stated, found = nodes[row, node], table[row, node]
        raise Refused(f"{name}.authority.{_AUTHORITY[row]}[{node}] = {stated:.9g}, the knowledge gives {found:.9g}")
    points = " and ".join(str(len(store.x)) for store in known.stores) or "no"
    k = known.k_queries[_AXES.index(name)]
    lines.append(
        f"{name}: {table.shape[1]} nodes of the authority worked out anew from {points} points at {k:.3g} sigma "
        f"({known.queries} queries each); errors up to {nodes[5:].max():.4g} m/s^2"
    )


def _nodes(value: Any, name: str) -> F64:
    """(7, n) the authority's columns."""
    table = table_of(value, _AUTHORITY, f"{name}.authority")
    columns = [rows([table[key]], len(table["v_mps"]), f"{name}.authority.{key}")[0] for key in _AUTHORITY]
    nodes = np.array(columns)
    if nodes.shape[1] < 2 or not np.all(np.diff(nodes[0]) > 0.0):
        raise Refused(f"{name}.authority.v_mps must increase, at least two nodes")
    if not (np.all(nodes[N_ERROR_LOW:] >= 0.0) and np.all(nodes[N_LOW] <= nodes[N_HIGH])):
        raise Refused(f"{name}.authority: errors must be at least 0, u_low at most u_high")
    return nodes


def _condition(axis: dict[str, Any], where: str) -> tuple[Condition, tuple[float, float]]:
    """The barrier and setting of an axis, and a point in the middle of its region."""
    kind = axis["barrier"].get("kind") if isinstance(axis["barrier"], dict) else None
    if kind not in _KINDS:
        raise Refused(f"{where}.barrier.kind must be one of {', '.join(_KINDS)}")
    p = numbers({k: x for k, x in axis["barrier"].items() if k != "kind"}, _KINDS[kind], f"{where}.barrier")
    gamma, eta, rate, dt, off_m, inner, inside, off_mps = numbers(axis["setting"], _SETTING, f"{where}.setting")
    if not (
        gamma > 0.0
        and min(eta, inner) >= 0.0
        and eta + inner < 1.0
        and min(rate, off_m, off_mps, dt, inside) >= 0.0
        and (gamma + inside) * dt <= 1.0
    ):
        raise Refused(
            f"{where}.setting: gamma must be above 0, eta and inner in 0 to 1, b, offsets, dt and inside at least 0, "
            "(gamma + inside) dt at most 1"
        )
    setting = gamma, eta, rate, dt, off_m, inner, inside, off_mps
    if kind == "quadratic":
        e, v, p11, p12, p22 = p
        if not (p11 > 0.0 and p22 > 0.0 and (Interval(p11) * p22 - Interval(p12) * p12).lo > 0.0):
            raise Refused(f"{where}.barrier: P is not positive definite, so the region is no ellipse")
        return Condition([Piece(True, tuple(p))], *setting), (e, v)
    low, high, reaction, brake_high, brake_low = p
    if not (low < high and min(reaction, brake_high, brake_low) > 0.0):
        raise Refused(f"{where}.barrier: limits must be in order, reaction time and braking above 0")
    scale = 0.5 * (high - low)
    ways = (1.0, high, reaction, brake_high, scale), (-1.0, -low, reaction, brake_low, scale)
    return Condition([Piece(False, way) for way in ways], *setting), (
        0.5 * (low + high),
        0.0,
    )
