"""For what a certificate holds: everything that its proof takes as given and a flight can break.

A certificate ends where a premise ends.  What a flight can see is watched in flight (`premise_monitor`); how far the
estimate is from the truth no flight can see: that is derived from the sensors' statistics (`estimate_bounds`) and
scored against the truth in simulation.

    estimate    each component of truth minus estimate within its bound
    speeds      of the vehicle as estimated, each axis; on an axis that is not certified nothing else limits it
    lean        of the thrust axis to north and to east, each
    thrust      specific thrust that is commanded, and which share of it the motors report as applied
    link        time from sending a command to its effect, by how much messages may come later than the quickest, and
                the age of the newest sample
    interval    longest time between two commands
    battery     voltage; what it does to thrust was learned at these voltages
    vehicle     hash of the believed vehicle's file; what it carries and its state are in the learned thrust gain
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, fields

from flightstack.barrier.estimate_bounds import EstimateBounds
from flightstack.checked import number, only, vector
from flightstack.types import F64, InputError, Tuple3

Range = tuple[float, float]
ANY_BATTERY_V: Range = (0.0, 1000.0)
"""No battery was reported: nothing is known of its part."""
APPLIED_AS_SENT: Range = (0.97, 1.03)
"""What the motors report to make of the thrust sent where nothing on its way changes it (`applied`)."""
_LARGEST = 1e6
_BOUNDS = ("pos_m", "vel_mps", "acc_mps2")
_RANGES = ("thrust_mps2", "applied_share", "thrust_gain", "delay_s", "battery_v")


@dataclass(frozen=True, slots=True)
class Premises:
    """The premises of one certificate; ranges are (least, greatest)."""

    sensors: str
    """Name of the sensors' grade, or of the autopilot whose streams were measured."""
    vehicle_hash: str
    """Of the believed vehicle's file; empty until it is stamped."""
    estimate: EstimateBounds
    speeds_mps: tuple[Range, Range, Range]
    """Along north, east, down, of the estimate."""
    leans: tuple[Range, Range]
    """Of the thrust axis' parts along north and along east, as parts of its length."""
    thrust_mps2: Range
    """Believed newton per believed kilogram."""
    applied_share: Range
    """Thrust that the motors report over thrust sent."""
    thrust_gain: Range
    """Delivered over believed thrust, as learned at the ends of the certified thrust (`premise_watch`)."""
    delay_s: Range
    """From sending a command to its first effect."""
    jitter_s: float
    """By how much a message may come later than the quickest, either way."""
    age_s: float
    """Of the newest sample."""
    command_interval_s: float
    battery_v: Range


def speeds_of(asked_mps: Sequence[Range], certified: Collection[int], vel_mps: Tuple3) -> tuple[Range, Range, Range]:
    """Speeds that the estimate may show, for true ones within those that the bounds were asked for.

    On a certified axis the region holds the true speed, the estimate may lie beyond it by its bound `vel_mps`; on
    another the estimate has to keep that far inside.
    """
    spare = [-vel_mps[i] if i in certified else vel_mps[i] for i in range(3)]
    north, east, down = ((low + s, high - s) for (low, high), s in zip(asked_mps, spare, strict=True))
    return north, east, down


def gain_of(gain: F64, error_mps2: float, thrust_mps2: float) -> Range:
    """Delivered over believed thrust (n,) at the nodes, off by what the acceleration's error allows at full thrust."""
    off = float(error_mps2) / thrust_mps2
    return float(gain.min()) - off, float(gain.max()) + off


def premises_table(premises: Premises) -> dict[str, object]:
    """The premises as plain JSON."""
    table: dict[str, object] = _plain(asdict(premises))  # type: ignore[assignment]
    return table


def parse_premises(value: object, where: str) -> Premises:
    """The premises of a file's table; InputError, one line that names the key."""
    table = _table(value, [part.name for part in fields(Premises)], where)
    estimate = _table(table["estimate"], [part.name for part in fields(EstimateBounds)], f"{where}.estimate")
    speeds = table["speeds_mps"]
    if not isinstance(speeds, list) or len(speeds) != 3:
        raise InputError(f"{where}.speeds_mps must be a list of three ranges: north, east, down")
    north, east, down = (_range(each, f"{where}.speeds_mps[{i}]") for i, each in enumerate(speeds))
    leans = table["leans"]
    if not isinstance(leans, list) or len(leans) != 2:
        raise InputError(f"{where}.leans must be a list of two ranges: north, east")
    north_lean, east_lean = (_range(each, f"{where}.leans[{i}]") for i, each in enumerate(leans))
    ranges = {key: _range(table[key], f"{where}.{key}") for key in _RANGES}
    pos, vel, acc = (vector(estimate[key], f"{where}.estimate.{key}", 0.0, _LARGEST) for key in _BOUNDS)
    k_sigma = number(estimate["k_sigma"], f"{where}.estimate.k_sigma", 0.0, _LARGEST)
    return Premises(
        sensors=_word(table["sensors"], f"{where}.sensors"),
        vehicle_hash=_word(table["vehicle_hash"], f"{where}.vehicle_hash"),
        estimate=EstimateBounds(pos, vel, acc, k_sigma),
        speeds_mps=(north, east, down),
        leans=(north_lean, east_lean),
        thrust_mps2=ranges["thrust_mps2"],
        applied_share=ranges["applied_share"],
        thrust_gain=ranges["thrust_gain"],
        delay_s=ranges["delay_s"],
        jitter_s=number(table["jitter_s"], f"{where}.jitter_s", 0.0, _LARGEST),
        age_s=number(table["age_s"], f"{where}.age_s", 0.0, _LARGEST),
        command_interval_s=number(table["command_interval_s"], f"{where}.command_interval_s", 0.0, _LARGEST),
        battery_v=ranges["battery_v"],
    )


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, tuple) else value


def _table(value: object, names: list[str], where: str) -> Mapping[str, object]:
    if not isinstance(value, Mapping):
        raise InputError(f"{where} must be a table")
    only(value, names, where)
    missing = [name for name in names if name not in value]
    if missing:
        raise InputError(f"{where}.{missing[0]} is missing")
    return value


def _range(value: object, where: str) -> Range:
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"{where} must be a list of two numbers: least, greatest")
    least, greatest = (number(part, where, -_LARGEST, _LARGEST) for part in value)
    if least > greatest:
        raise InputError(f"{where} = [{least:g}, {greatest:g}] must begin with the least")
    return least, greatest


def _word(value: object, where: str) -> str:
    if not isinstance(value, str) or len(value) > 100 or not value.isprintable():
        raise InputError(f"{where} must be a word")
    return value
