"""Makes `Samples` of a flight's signals: the grid, what is derived, which rows count."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from flightstack.gap import voltage
from flightstack.gap.checks.flying import flying
from flightstack.gap.checks.grid import (
    SLOWEST_MOTOR_S,
    attitude_on_grid,
    grid_period_s,
    held,
    motors_on_grid,
    on_grid,
    period_s,
)
from flightstack.gap.checks.motion import rates_of
from flightstack.gap.checks.speeds import MEASURED
from flightstack.gap.filters import white_noise
from flightstack.gap.records import Samples, Signal
from flightstack.gap.sources import DERIVED, DERIVED_HZ, FREED
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle
from flightstack_logs.turn import rotate_inverse

_G_NED = np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
_BANDWIDTH = 0.4
"""Of the slowest topic's rate."""
_NOISY = ("pos_ned_m", "vel_ned_mps", "q_ned_frd", "rate_frd_radps", "accel_frd_mps2")


def make_samples(
    name: str, signals: Mapping[str, Signal], vehicle: Vehicle, ground_d_m: float, *, estimated: bool = False
) -> Samples | None:
    """The flying part on a grid; None where there is none of at least half a second.

    `estimated`: velocities are an autopilot's filter's, so that a specific force made of them is its accelerometer's
    less what the filter believes of its bias.
    """
    used = dict(signals)
    t_s, dt_s = _grid(used)
    if len(t_s) < 8:
        return None
    columns, valid, derived = _columns(used, t_s, dt_s)
    if estimated and "accel_frd_mps2" in derived and FREED not in derived:
        derived.append(FREED)
    height = _height(used, columns, t_s, ground_d_m)
    up = _in_the_air(used, vehicle, t_s, dt_s, ground_d_m)
    valid &= up
    rows = np.flatnonzero(valid)
    if len(rows) * dt_s < 0.5:
        return None
    keep = slice(int(rows[0]), int(rows[-1]) + 1)
    noise = _noise(used, columns, dt_s, (float(t_s[keep][0]), float(t_s[keep][-1])), keep)
    return Samples(
        name=name,
        t_s=t_s[keep],
        dt_s=dt_s,
        height_m=height[keep],
        valid=valid[keep],
        noise=noise,
        derived=tuple(derived),
        bandwidth_hz=_bandwidth(used, dt_s),
        command_late_s=0.0,
        **{key: value[keep] for key, value in columns.items()},
    )


def flying_span(signals: Mapping[str, Signal], vehicle: Vehicle, ground_d_m: float) -> tuple[float, float] | None:
    """First and last time in the air; None where it never flies."""
    used = dict(signals)
    t_s, dt_s = _grid(used)
    if len(t_s) < 8:
        return None
    up = _in_the_air(used, vehicle, t_s, dt_s, ground_d_m)
    rows = np.flatnonzero(up)
    return (float(t_s[rows[0]]), float(t_s[rows[-1]])) if len(rows) else None


def _in_the_air(
    used: dict[str, Signal], vehicle: Vehicle, t_s: F64, dt_s: float, ground_d_m: float
) -> NDArray[np.bool_]:
    motor = motors_on_grid(used["motor"], t_s)[0] if "motor" in used and len(used["motor"].t_s) > 3 else None
    landed = held(used["landed"], t_s) if "landed" in used else None
    height = None
    if "pos_ned_m" in used and len(used["pos_ned_m"].t_s) > 3:
        height = ground_d_m - on_grid(used["pos_ned_m"], t_s)[0][:, 2]
    speed = None
    if "vel_ned_mps" in used and len(used["vel_ned_mps"].t_s) > 3:
        speed = np.linalg.norm(on_grid(used["vel_ned_mps"], t_s)[0], axis=1)
    if motor is None and landed is None:
        return np.ones(len(t_s), np.bool_)
    return flying(vehicle, dt_s, motor, landed, height, speed)


def _grid(signals: dict[str, Signal]) -> tuple[F64, float]:
    """Grid times: where the topics that count overlap, on the IMU's own stamps where it can be."""
    dt_s = grid_period_s(signals)
    names = [name for name in (*_NOISY, "motor") if name in signals and len(signals[name].t_s) > 3]
    if not names:
        return np.zeros(0), dt_s
    begin = max(float(signals[name].t_s[0]) for name in names)
    end = min(float(signals[name].t_s[-1]) for name in names)
    if end - begin < 8 * dt_s:
        return np.zeros(0), dt_s
    for name in ("motor", "accel_frd_mps2", "rate_frd_radps", "vel_ned_mps"):
        if name in signals and abs(period_s(signals[name]) - dt_s) < 0.02 * dt_s:
            begin = float(signals[name].t_s[np.searchsorted(signals[name].t_s, begin)])
            break
    times: F64 = begin + dt_s * np.arange(int((end - begin) / dt_s + 1e-6) + 1, dtype=np.float64)
    return times, dt_s


def _columns(used: dict[str, Signal], t_s: F64, dt_s: float) -> tuple[dict[str, F64], NDArray[np.bool_], list[str]]:
    """Every column of `Samples` on the grid, where the log has them all, and which were derived."""
    rows = len(t_s)
    valid = np.ones(rows, np.bool_)
    widths = {"pos_ned_m": 3, "vel_ned_mps": 3, "q_ned_frd": 4, "rate_frd_radps": 3, "accel_frd_mps2": 3, "motor": 4}
    columns: dict[str, F64] = {name: np.full((rows, width), np.nan) for name, width in widths.items()}
    for name in widths:
        if name in used and len(used[name].t_s) > 3:
            how = {"q_ned_frd": attitude_on_grid, "motor": motors_on_grid}.get(name, on_grid)
            columns[name], good = how(used[name], t_s)
            valid &= good
    columns["battery_v"] = np.zeros(rows)
    if "battery_v" in used:
        columns["battery_v"] = voltage.on_grid(used["battery_v"], t_s, columns["motor"], dt_s)
    return columns, valid, _derive(used, columns, t_s, dt_s)


def _derive(used: dict[str, Signal], columns: dict[str, F64], t_s: F64, dt_s: float) -> list[str]:
    """Fill what the log lacks from what it has; motors too slow to say more than their mean count as derived."""
    derived = [name for name in columns if name in used and used[name].source.startswith(DERIVED)]
    if "motor" in used and period_s(used["motor"]) > SLOWEST_MOTOR_S:
        derived.append("motor")
    if "motor" in used and used["motor"].source.startswith(MEASURED):
        derived.append("command")
    if "accel_frd_mps2" in used and used["accel_frd_mps2"].source.endswith(FREED):
        derived.append(FREED)
    if "vel_ned_mps" not in used and "pos_ned_m" in used:
        columns["vel_ned_mps"] = np.gradient(columns["pos_ned_m"], dt_s, axis=0)
        derived.append("vel_ned_mps")
    if "pos_ned_m" not in used and "vel_ned_mps" in used:
        velocity = np.nan_to_num(columns["vel_ned_mps"])
        steps = 0.5 * dt_s * (velocity[1:] + velocity[:-1])
        columns["pos_ned_m"] = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        derived.append("pos_ned_m")
    has_attitude, has_velocity = "q_ned_frd" in used, "vel_ned_mps" in used or "pos_ned_m" in used
    if "rate_frd_radps" not in used and has_attitude:
        columns["rate_frd_radps"] = rates_of(columns["q_ned_frd"], dt_s)
        derived.append("rate_frd_radps")
    if "accel_frd_mps2" not in used and has_attitude and ("acc_ned_mps2" in used or has_velocity):
        if "acc_ned_mps2" in used:
            acceleration = on_grid(used["acc_ned_mps2"], t_s)[0]
        else:
            acceleration = np.gradient(columns["vel_ned_mps"], dt_s, axis=0)
        columns["accel_frd_mps2"] = rotate_inverse(columns["q_ned_frd"], acceleration - _G_NED)
        derived.append("accel_frd_mps2")
    return derived


def _height(used: dict[str, Signal], columns: dict[str, F64], t_s: F64, ground_d_m: float) -> F64:
    if "height_m" in used and len(used["height_m"].t_s) > 3:
        value, good = on_grid(used["height_m"], t_s)
        return np.where(good, value, np.nan)
    if "pos_ned_m" in used:
        return ground_d_m - columns["pos_ned_m"][:, 2]
    return np.full(len(t_s), np.nan)


def _noise(
    used: dict[str, Signal], columns: dict[str, F64], dt_s: float, span: tuple[float, float], keep: slice
) -> dict[str, float]:
    """White noise of each measured signal: of its own samples where it is slower than the grid, else of the grid's."""
    out: dict[str, float] = {}
    for name in _NOISY:
        if name not in used:
            continue
        signal = used[name]
        inside = (signal.t_s >= span[0]) & (signal.t_s <= span[1])
        values = signal.value[inside] if period_s(signal) > 0.8 * dt_s else columns[name][keep]
        each = white_noise(values)
        if np.isfinite(each).all():
            out[name] = float(np.sqrt(np.mean(each**2)))
            out |= {f"{name}_{axis}": float(std) for axis, std in zip("xyz", each, strict=False) if len(each) == 3}
    return out


def _bandwidth(used: dict[str, Signal], dt_s: float) -> float:
    wanted: tuple[str, ...] = ("q_ned_frd", "rate_frd_radps", "accel_frd_mps2", "motor")
    names = [name for name in wanted if name in used and (name != "motor" or period_s(used[name]) < SLOWEST_MOTOR_S)]
    if "accel_frd_mps2" not in used:
        names += ["vel_ned_mps"] if "vel_ned_mps" in used else []
    own = _BANDWIDTH / max(dt_s, *(period_s(used[name]) for name in names))
    return min(own, DERIVED_HZ) if any(used[name].source.startswith(DERIVED) for name in names) else own
