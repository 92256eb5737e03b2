"""Measured rotor speeds in place of commands that were not logged, or too slowly."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flightstack.gap.checks.grid import SLOWEST_MOTOR_S, period_s
from flightstack.gap.records import Finding, Signal, ok
from flightstack.types import F64
from flightstack.vehicle import Vehicle

MEASURED = "speeds of "
"""How the source of commands begins that were made of speeds."""
_BEYOND = 1.02
"""Of the file's greatest speed: what is faster belongs to another rotor."""


def commands_of_speeds(signals: Mapping[str, Signal], vehicle: Vehicle) -> tuple[dict[str, Signal], list[Finding]]:
    """The signals without `rotor_speed_radps`; where commands lack or are too slow, those that made these speeds.

    A speed is where a command was led to by the rotor's lag: the lag and curve of the file are undone, and the
    simulator's own rotors turn at what was measured again, whatever the true ones are.
    """
    out = dict(signals)
    speed = out.pop("rotor_speed_radps", None)
    if speed is None or len(speed.t_s) < 4 or period_s(speed) > SLOWEST_MOTOR_S:
        return out, []
    if "motor" in out and period_s(out["motor"]) < SLOWEST_MOTOR_S:
        return out, []
    share = np.abs(speed.value) / vehicle.rotors.max_speed_radps
    if not np.any(share) or np.quantile(share, 0.99) > _BEYOND:
        return out, []
    effects = vehicle.effects
    lag_s = effects.get("motor_lag", {}).get("time_constant_s", vehicle.rotors.time_constant_s)
    delay_s = effects.get("transport_delay", {}).get("delay_s", 0.0)
    factor = effects.get("thrust_curve", {}).get("thrust_model_factor", vehicle.rotors.thrust_model_factor)
    u = linearised(np.minimum(share, 1.0) ** 2, factor)
    command = np.clip(u + lag_s * np.gradient(u, speed.t_s, axis=0), 0.0, 1.0)
    out["motor"] = Signal(speed.t_s - delay_s, command, f"{MEASURED}{speed.source}")
    text = "motors: measured speeds stand for the commands; lag, delay, sag and the commands' curve can't be told"
    return out, [ok("motors", text)]


def linearised(thrust: F64, factor: float) -> F64:
    """PX4's undoing of a thrust curve: the command u with factor u^2 + (1 - factor) u = thrust (PX4, THR_MDL_FAC)."""
    f = min(max(factor, 0.0), 1.0)
    if f < 1e-6:
        return thrust
    return np.asarray((np.sqrt((1.0 - f) ** 2 + 4.0 * f * thrust) - (1.0 - f)) / (2.0 * f))
