"""For what a certificate holds: that its premises are no wider than what its bounds and its ledger were made for.

estimate            the same bounds as in knowledge.doubts; of a grade that is known at least k_sigma, 4.3 or more, of
                    its standard deviations
speeds_mps          of the estimate: with an axis that is certified, whose region holds the true speed, the velocity's
                    bound beyond what was asked for; with another so much within it
leans               within what was asked for; what is spared of them is at least what the attitude may be off by
thrust_mps2         within the budget
thrust_gain         the gain at the nodes of down, widened by its error over the greatest thrust
delay_s             the response's delay and the ledger's doubt about it
jitter_s            within that doubt
age_s               within the ledger's
command_interval_s  within every axis' dt
vehicle_hash        the knowledge's, where that names one
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .intervals import F64
from .knowledge import NEAR, StatedKnowledge
from .reading import Refused, number, rows, table_of

_KEYS = (
    "sensors", "vehicle_hash", "estimate", "speeds_mps", "leans", "thrust_mps2", "applied_share", "thrust_gain",
    "delay_s", "jitter_s", "age_s", "command_interval_s", "battery_v",
)  # fmt: skip
_SLACK = 1e-9
_BOUNDS = ("pos_m", "vel_mps", "acc_mps2")
_K_SIGMA = 4.3
_FINEST = np.array([1e-4, 1e-3, 5e-3])
_STEADIEST = {
    "mocap": np.array([[0.0052, 0.0104, 0.0292], [0.0052, 0.0104, 0.0292], [0.0051, 0.0076, 0.0106]]),
    "gps": np.array([[0.206, 0.0696, 0.0668], [0.209, 0.0873, 0.0750], [0.206, 0.0547, 0.0255]]),
    "px4-sih": np.array([[0.162, 0.169, 0.145], [0.333, 0.349, 0.145], [0.230, 0.169, 0.0374]]),
    "px4-sih-ekf": np.array([[0.072, 0.068, 0.126], [0.097, 0.137, 0.126], [0.194, 0.109, 0.0329]]),
}
"""One sigma of position (m), velocity (m/s) and thrust's acceleration (m/s^2) along each axis: what the best linear
estimate can reach with these grades' sensors, rounded down."""
_ROUNDED = 0.01
_ANY_V = (0.0, 1000.0)
_WIDEST = 1.25
_AXES = ("north", "east", "down")


def check_premises(value: Any, axes: list[dict[str, Any]], budget: Any, known: StatedKnowledge, down: F64) -> str:
    """Verify the premises against the axes, the budget, the knowledge and its table of down; what was, in words."""
    table = table_of(value, _KEYS, "premises")
    for key in ("sensors", "vehicle_hash"):
        if not isinstance(table[key], str):
            raise Refused(f"premises.{key} must be a word")
    if table["vehicle_hash"] != known.data.get("vehicle_hash", table["vehicle_hash"]):
        raise Refused("premises.vehicle_hash is not the one of knowledge")
    doubts = known.data.get("doubts")
    if not isinstance(doubts, dict):
        raise Refused("knowledge.doubts is missing: nothing says what the ledger rests on")
    pos, vel, acc = estimate_of(table).T
    if not np.all(acc <= known.widen + _SLACK):
        raise Refused("knowledge.widen_mps2 does not hold premises.estimate.acc_mps2")
    if not known.box.spare >= float(acc[:2].max()) / float(known.data["gravity_mps2"]) - _SLACK:
        raise Refused(f"budget.lean_spare = {known.box.spare:.6g} is less than what the attitude may be off by")
    _check_ranges(table, axes, budget, known, vel)
    stated, found = _range(table["thrust_gain"], "premises.thrust_gain"), _gain(down, known.box.high)
    if not max(abs(stated[i] - found[i]) for i in range(2)) <= NEAR:
        raise Refused(f"premises.thrust_gain must be {found[0]:.9g} to {found[1]:.9g}, what down's bounds allow")
    delay_doubt = number(doubts.get("delay_s"), "knowledge.doubts.delay_s")
    low, high = _range(table["delay_s"], "premises.delay_s")
    for axis in axes:
        delay = number(axis["response"]["delay_s"], "response.delay_s")
        _least(delay - delay_doubt, low, "premises.delay_s", "the delay that was counted with, less its doubt")
        _most(high, delay + delay_doubt, "premises.delay_s", "the delay that was counted with and its doubt")
        dt = number(axis["setting"]["dt_s"], "setting.dt_s")
        _most(
            number(table["command_interval_s"], "premises.command_interval_s"), dt, "premises.command_interval_s", "dt"
        )
    _most(number(table["jitter_s"], "premises.jitter_s"), delay_doubt, "premises.jitter_s", "the delay's doubt")
    age = number(doubts.get("age_s"), "knowledge.doubts.age_s")
    _most(number(table["age_s"], "premises.age_s"), age, "premises.age_s", "the ledger's age")
    return (
        f"premises: sensors {table['sensors'][:40]} ({pos.max():.3g} m, {vel.max():.3g} m/s, "
        f"{acc.max():.3g} m/s^2 at {table['estimate']['k_sigma']:.3g} sigma), "
        "speeds, lean, thrust, delay and commands within what the bounds were made for"
    )


def estimate_of(premises: Any) -> F64:
    """(3, 3) bounds of position, velocity and acceleration for north, east and down."""
    table = table_of(premises, _KEYS, "premises")
    estimate = table_of(table["estimate"], ("pos_m", "vel_mps", "acc_mps2", "k_sigma"), "premises.estimate")
    bounds = np.array([rows([estimate[key]], 3, f"premises.estimate.{key}")[0] for key in _BOUNDS]).T
    k = number(estimate["k_sigma"], "premises.estimate.k_sigma")
    if not np.all(bounds >= _FINEST):
        raise Refused("premises.estimate is finer than anything could be known: 0.1 mm, 1 mm/s, 5 mm/s^2")
    least = _STEADIEST.get(table["sensors"])
    if least is not None and not (k >= _K_SIGMA and np.all(bounds >= k * least * (1.0 - _ROUNDED))):
        raise Refused(
            f"premises.estimate is less than {_K_SIGMA:g} sigma of what {table['sensors']} sensors are known to"
        )
    return bounds


def _check_ranges(
    table: dict[str, Any], axes: list[dict[str, Any]], budget: Any, known: StatedKnowledge, vel: F64
) -> None:
    certified = {axis["axis"] for axis in axes}
    if not isinstance(table["speeds_mps"], list) or len(table["speeds_mps"]) != len(_AXES):
        raise Refused("premises.speeds_mps must be three ranges")
    for i, entry in enumerate(table["speeds_mps"]):
        least, greatest = _range(entry, f"premises.speeds_mps[{i}]")
        spare = float(-vel[i] if _AXES[i] in certified else vel[i])
        _least(float(known.speeds[i, 0]), least - spare, f"premises.speeds_mps[{i}]", "the speeds asked for")
        _most(greatest + spare, float(known.speeds[i, 1]), f"premises.speeds_mps[{i}]", "the speeds asked for")
    if not isinstance(table["leans"], list) or len(table["leans"]) != len(known.box.leans):
        raise Refused("premises.leans must be two ranges")
    for i, asked in enumerate(known.box.leans):
        least, greatest = _range(table["leans"][i], f"premises.leans[{i}]")
        _least(float(asked[0]), least, f"premises.leans[{i}]", "the leans asked for")
        _most(greatest, float(asked[1]), f"premises.leans[{i}]", "the leans asked for")
    low, high = _range(table["thrust_mps2"], "premises.thrust_mps2")
    _least(known.box.low, low, "premises.thrust_mps2", "the budget")
    _most(high, number(budget["thrust_max_mps2"], "budget.thrust_max_mps2"), "premises.thrust_mps2", "the budget")
    for key in ("applied_share", "battery_v"):
        low, high = _range(table[key], f"premises.{key}")
        if (low, high) != _ANY_V and not 0.0 < high <= _WIDEST * low:
            raise Refused(f"premises.{key} is wider than one flight's {100.0 * (_WIDEST - 1.0):.0f} %")


def _gain(down: F64, high_mps2: float) -> tuple[float, float]:
    """Delivered over believed thrust: down's gain at every node, off by what its error allows at full thrust."""
    gain, errors = down[2], down[-2:]
    off = float(errors.max()) / high_mps2
    return float(gain.min()) - off, float(gain.max()) + off


def _range(value: Any, where: str) -> tuple[float, float]:
    low, high = rows([value], 2, where)[0]
    if not (math.isfinite(low) and low <= high):
        raise Refused(f"{where} must begin with the least")
    return float(low), float(high)


def _least(least: float, value: float, where: str, of: str) -> None:
    if not least <= value + _SLACK:
        raise Refused(f"{where} begins at {value:.9g}, below {of}, {least:.9g}")


def _most(value: float, most: float, where: str, of: str) -> None:
    if not value <= most + _SLACK:
        raise Refused(f"{where} reaches {value:.9g}, beyond {of}, {most:.9g}")
