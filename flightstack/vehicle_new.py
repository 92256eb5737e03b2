"""A vehicle file from what a PX4 is set up with: text of `flightstack.vehicle/1`, every number with its source.

PX4's parameters tell the rotors' order, turning directions and the ratios between arms (CA_ROTORi_*; its geometry is
free of scale), the thrust curve (THR_MDL_FAC), the hover thrust (MPC_THR_HOVER) and the battery (BAT1_*).  The mass is
the caller's.  What nothing tells is scaled from multirotors of 27 g to 5 kg whose numbers are published (see
docs/vehicle.md) and gets a range that held all of them:

    mean arm = 0.18 m (mass / kg)^(1/3), rotor radius = 0.55 arm, torque ratio = 0.14 radius,
    Ixx = Iyy = 0.28 m arm^2, Izz = 0.47 m arm^2, tip speed 120 m/s
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from flightstack import ranges
from flightstack.airframe import GEOMETRY, PLACES, ROTORS, TURNS, UNTOLD_HOVER
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, InputError

BATTERY = ("BAT1_N_CELLS", "BAT1_V_CHARGED", "BAT1_V_EMPTY", "BAT1_CAPACITY", "BAT1_R_INTERNAL")
NEEDED = ("MPC_THR_HOVER", "THR_MDL_FAC", *GEOMETRY)
"""What is asked of a PX4, besides its battery."""
_ARM_M, _ARM_SPREAD = 0.18, 1.5
_RADIUS, _RADIUS_SPREAD = 0.55, 1.35
_TORQUE, _TORQUE_SPREAD = 0.14, 3.2
_INERTIA, _INERTIA_SPREAD = (0.28, 0.28, 0.47), 1.7
_TIP_MPS, _TIP_SPREAD = 120.0, 2.5
_LAG_S, _LAG_RANGE_S = 0.03, (0.01, 0.09)
_HOVER_RANGE = (0.25, 0.75)
"""Where nobody has measured MPC_THR_HOVER."""
_MEASURED_HOVER = 0.1
"""Share by which a measured one may be off: another battery, another payload."""
_CELL_OHM, _CELL_OHM_SPREAD = 0.005, 2.5
_CELL_FULL_V, _CELL_EMPTY_V, _CELL_AS = 4.2, 3.5, 18_000.0


def vehicle_text(values: Mapping[str, float], *, name: str, mass_kg: float, arm_m: float | None, source: str) -> str:
    """The file's text from PX4's parameters `values`; `arm_m`: mean distance of the rotors' axes from the CoM.

    InputError, one line, where the parameters describe no quadrotor of four turning rotors.
    """
    told = _places(values, source)
    mean = float(np.linalg.norm(told, axis=1).mean())
    arm = arm_m if arm_m is not None else _ARM_M * mass_kg ** (1.0 / 3.0)
    arm_range = None if arm_m is not None else _spread(arm, _ARM_SPREAD)
    scale = told * arm / mean
    places = np.hstack([scale, np.zeros((ROTORS, 1))])
    radius = _RADIUS * arm
    curve, curve_range, curve_from = _curve(values)
    thrust, thrust_range, thrust_from = _max_thrust(values, mass_kg)
    inertia: F64 = mass_kg * arm * arm * np.array(_INERTIA)
    wide = 1.0 if arm_range is None else _ARM_SPREAD  # what an unknown arm adds
    speed = _TIP_MPS / radius
    arm_words = "--arm" if arm_m is not None else f"scaled from the mass: mean arm {arm:.3g} m"
    rows = [
        f'schema = "flightstack.vehicle/1"\nname = "{name}"',
        "\n[body]",
        f"mass_kg = {mass_kg!r}  # --mass",
        _row("inertia_kgm2", inertia, _spread(inertia, _INERTIA_SPREAD * wide**2), "scaled from mass and arm"),
        "\n[rotors]",
        _row("position_m", places, _scaled(places, wide), f"ratios of CA_ROTOR*_PX and _PY; length: {arm_words}"),
        _row(
            "torque_ratio_m",
            np.array(_signs(values, source)) * _TORQUE * radius,
            _signed(_signs(values, source), _TORQUE * radius, _TORQUE_SPREAD * wide),
            "signs of CA_ROTOR*_KM; size scaled from the radius",
        ),
        _row("max_thrust_n", thrust, thrust_range, thrust_from),
        _row("max_speed_radps", speed, _spread(speed, _TIP_SPREAD * wide), "scaled from the radius"),
        _row("thrust_model_factor", curve, curve_range, curve_from),
        _row("time_constant_s", _LAG_S, np.array(_LAG_RANGE_S), "scaled: not told by any parameter"),
        _row("radius_m", radius, _spread(radius, _RADIUS_SPREAD * wide), "scaled from the arm"),
        *_battery(values),
    ]
    head = f"# Made from {source}; a range is what is known of a number that nobody has measured."
    return "\n".join([head, *rows]) + "\n"


def _places(values: Mapping[str, float], source: str) -> F64:
    """(4, 2) forward and right as PX4 has them, free of scale."""
    count = values.get("CA_ROTOR_COUNT", float(ROTORS))
    if count != ROTORS:
        raise InputError(f"{source}: CA_ROTOR_COUNT = {count:g}: only vehicles of {ROTORS} rotors can be described")
    missing = [name for name in PLACES if not math.isfinite(values.get(name, math.nan))]
    if missing:
        why = "these are not the parameters of a PX4 multicopter"
        if "MC_ROLLRATE_P" in values:  # geometry was in mixer files before PX4 1.14
            why = (
                "a PX4 this old keeps its geometry in mixer files; copy a vehicle file and change it (docs/vehicle.md)"
            )
        raise InputError(f"{source}: {missing[0]} is not told: {why}")
    told = np.array([values[name] for name in PLACES]).reshape(ROTORS, 2)
    if np.linalg.norm(told, axis=1).min() <= 0.0:
        raise InputError(f"{source}: CA_ROTOR*_PX and _PY put a rotor at the centre: set the geometry in PX4 first")
    return told


def _signs(values: Mapping[str, float], source: str) -> tuple[float, ...]:
    moments = [values.get(name, 0.0) for name in TURNS]
    if not all(moments):
        at = moments.index(0.0)
        raise InputError(f"{source}: {TURNS[at]} is 0 or not told: the turning direction of rotor {at + 1} is unknown")
    return tuple(math.copysign(1.0, moment) for moment in moments)


def _curve(values: Mapping[str, float]) -> tuple[float, F64, str]:
    """PX4 undoes THR_MDL_FAC's curve; where it stands at 0 nobody has measured one."""
    told = min(max(values.get("THR_MDL_FAC", 0.0), 0.0), 1.0)
    if told == 0.0:
        return 0.0, np.array([0.0, 1.0]), "THR_MDL_FAC 0: PX4 takes thrust as linear in the command, nobody measured it"
    return told, np.array([max(told - 0.2, 0.0), min(told + 0.2, 1.0)]), "THR_MDL_FAC"


def _max_thrust(values: Mapping[str, float], mass_kg: float) -> tuple[float, F64, str]:
    """One rotor's; PX4's thrust setpoint is the share of the greatest thrust, for it undoes THR_MDL_FAC's curve."""
    weight_n = mass_kg * STANDARD_GRAVITY_MPS2
    told = values.get("MPC_THR_HOVER", UNTOLD_HOVER)
    at = told if 0.05 <= told <= 0.95 else UNTOLD_HOVER
    known = at != UNTOLD_HOVER
    low, high = (at * (1.0 - _MEASURED_HOVER), at * (1.0 + _MEASURED_HOVER)) if known else _HOVER_RANGE
    each = 0.25 * weight_n
    words = f"MPC_THR_HOVER {at:g}" if known else f"MPC_THR_HOVER at its default {at:g}: not measured"
    return each / at, np.array([each / high, each / low]), f"the weight at {words}"


def _battery(values: Mapping[str, float]) -> list[str]:
    cells = values.get("BAT1_N_CELLS", 0.0)
    if not 1.0 <= cells <= 40.0:
        return []
    full = cells * _CELL_FULL_V
    empty = round(cells * _or(values, "BAT1_V_EMPTY", _CELL_EMPTY_V, 2.0, 4.1), 4)  # PX4 counts in 32 bits
    told_mah, told_ohm = values.get("BAT1_CAPACITY", -1.0), values.get("BAT1_R_INTERNAL", -1.0)
    capacity = 3.6 * told_mah if told_mah > 0.0 else _CELL_AS
    ohm = told_ohm if told_ohm > 0.0 else cells * _CELL_OHM
    mean = 0.5 * (full + empty)
    return [
        "\n[battery]",
        _row("reference_v", mean, np.array([empty, full]), "half way: nothing tells at which voltage"),
        f"full_v = {full!r}  # BAT1_N_CELLS times {_CELL_FULL_V} V",
        f"empty_v = {empty!r}  # BAT1_N_CELLS times BAT1_V_EMPTY",
        f"capacity_as = {capacity!r}  # BAT1_CAPACITY"
        if told_mah > 0.0
        else _row("capacity_as", capacity, _spread(capacity, 4.0), "not told"),
        f"resistance_ohm = {ohm!r}  # BAT1_R_INTERNAL"
        if told_ohm > 0.0
        else _row("resistance_ohm", ohm, _spread(ohm, _CELL_OHM_SPREAD), "a usual one of so many cells"),
    ]


def _or(values: Mapping[str, float], name: str, usual: float, low: float, high: float) -> float:
    told = values.get(name, usual)
    return told if low <= told <= high else usual


def _spread(value: F64 | float, factor: float) -> F64:
    """(..., 2) from value / factor to value * factor, for positive numbers."""
    return np.stack([np.asarray(value) / factor, np.asarray(value) * factor], axis=-1)


def _scaled(places: F64, factor: float) -> F64 | None:
    """(4, 3, 2) of places whose common scale is known within `factor`; None where it is known."""
    if factor == 1.0:
        return None
    ends = np.stack([places / factor, places * factor], axis=-1)
    return np.sort(ends, axis=-1)


def _signed(signs: tuple[float, ...], size: float, factor: float) -> F64:
    return np.sort(np.array(signs)[:, None] * _spread(size, factor)[None, :], axis=-1)


def _row(key: str, value: F64 | float, pairs: F64 | None, source: str) -> str:
    return f"{key} = {ranges.to_toml(_short(value), None if pairs is None else _short(pairs))}  # {source}"


def _short(values: F64 | float) -> F64:
    """Five digits of each: more would pretend to be known."""
    flat = [float(f"{x:.5g}") for x in np.ravel(values).tolist()]
    return np.array(flat).reshape(np.shape(values))
