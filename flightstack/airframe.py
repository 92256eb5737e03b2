"""Does a vehicle file describe the vehicle that PX4 is set up for?  Rotors and hover thrust by PX4's parameters.

PX4's geometry is free of scale: its allocation normalises the rotors' places, so CA_ROTORi_PX and _PY say order, signs
and ratios only (an airframe file may well say 1 for every arm), and CA_ROTORi_KM says the turning direction only:
positive is counter-clockwise from above, whose reaction turns the body clockwise, about +z.
Source: PX4 v1.16 `ActuatorEffectivenessRotors.cpp`, `ControlAllocationPseudoInverse.cpp`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from flightstack.types import F64
from flightstack.vehicle import Vehicle

ROTORS = 4
PLACES = tuple(f"CA_ROTOR{i}_P{axis}" for i in range(ROTORS) for axis in "XY")
TURNS = tuple(f"CA_ROTOR{i}_KM" for i in range(ROTORS))
GEOMETRY = ("CA_ROTOR_COUNT", *PLACES, *TURNS)
"""The parameters that say where PX4 believes the rotors."""
HOVER_TOLERANCE = 0.25
"""Share of MPC_THR_HOVER by which the file's hover thrust may differ (contract, section 10): a battery and a payload
move it by less, another vehicle by more."""
UNTOLD_HOVER = 0.5
"""PX4's default MPC_THR_HOVER: nobody has measured it."""
_PLACE_TOLERANCE = 0.25
"""Share of the mean arm by which a rotor may lie elsewhere after the common scale is taken out: airframe files round
(all arms 1, an X that is wider than long by 20 %), which moves a rotor by up to 0.1."""
_CENTRE_SHARE = 0.1
"""A place closer than this share of the mean arm to an axis has no sign."""
_LENGTH_WORDS, _SIDE_WORDS = {1: "front", -1: "rear", 0: ""}, {1: "right", -1: "left", 0: ""}


def contradictions(values: Mapping[str, float], vehicle: Vehicle, hover_norm: float) -> list[str]:
    """Why the file can't be this vehicle's, one line each; empty where nothing that PX4 told speaks against it.

    `values`: PX4's parameters by name, as far as they are known; `hover_norm`: the file's motor command in hover.
    """
    lines = _count(values) or [*_places(values, vehicle), *_turns(values, vehicle)]
    told = values.get("MPC_THR_HOVER", math.nan)
    if told != UNTOLD_HOVER and hover_differs(hover_setpoint(values, hover_norm), told):
        lines.append(
            f"hover thrust: {hover_setpoint(values, hover_norm):.2f} by the vehicle file, {told:.2f} by MPC_THR_HOVER "
            f"(more than {HOVER_TOLERANCE:.0%} apart)"
        )
    return lines


def unsettled_hover(values: Mapping[str, float], hover_norm: float) -> str:
    """That MPC_THR_HOVER stands at its default and the file's hover thrust is far from it, one line; else empty."""
    believed = hover_setpoint(values, hover_norm)
    if values.get("MPC_THR_HOVER", math.nan) != UNTOLD_HOVER or not hover_differs(believed, UNTOLD_HOVER):
        return ""
    return (
        f"hover thrust: {believed:.2f} by the vehicle file, and MPC_THR_HOVER stands at its default "
        f"{UNTOLD_HOVER:g}: the first hover decides"
    )


def hover_setpoint(values: Mapping[str, float], hover_norm: float) -> float:
    """The thrust setpoint that PX4 turns into the motor command `hover_norm`, by its THR_MDL_FAC."""
    factor = values.get("THR_MDL_FAC", 0.0)
    return factor * hover_norm * hover_norm + (1.0 - factor) * hover_norm


def hover_differs(believed: float, told: float) -> bool:
    """Whether two hover thrusts are those of different vehicles; False where one is not known."""
    return abs(believed - told) > HOVER_TOLERANCE * told


def _count(values: Mapping[str, float]) -> list[str]:
    count = values.get("CA_ROTOR_COUNT", float(ROTORS))
    return [] if count == ROTORS else [f"rotors: {ROTORS} in the vehicle file, {count:g} by CA_ROTOR_COUNT"]


def _places(values: Mapping[str, float], vehicle: Vehicle) -> list[str]:
    if not all(name in values for name in PLACES):
        return []
    told = np.array([values[name] for name in PLACES]).reshape(ROTORS, 2)
    believed = vehicle.rotors.position_m[:, :2]
    told_arm, arm_m = (float(np.linalg.norm(xy, axis=1).mean()) for xy in (told, believed))
    if told_arm == 0.0 or arm_m == 0.0 or not math.isfinite(told_arm):
        return []  # nobody has told PX4: it could not fly so either
    lines = [
        f"rotor {i + 1}: {ours} in the vehicle file, {theirs} by CA_ROTOR{i}_PX and _PY"
        for i in range(ROTORS)
        if (ours := _words(believed[i] / arm_m)) != (theirs := _words(told[i] / told_arm))
    ]
    return lines or _ratios(told, believed, arm_m)


def _ratios(told: F64, believed: F64, arm_m: float) -> list[str]:
    """Places that differ in more than their common scale."""
    scale = float((told * believed).sum() / (told * told).sum())
    off = np.linalg.norm(scale * told - believed, axis=1) / arm_m
    worst = int(np.argmax(off))
    if off[worst] <= _PLACE_TOLERANCE:
        return []
    x, y = (scale * told[worst]).tolist()
    at_x, at_y = believed[worst].tolist()
    return [
        f"rotor {worst + 1}: at ({at_x:.3g}, {at_y:.3g}) m in the vehicle file; by the ratios of CA_ROTOR* it lies "
        f"at ({x:.3g}, {y:.3g}) m"
    ]


def _turns(values: Mapping[str, float], vehicle: Vehicle) -> list[str]:
    words = {True: "counter-clockwise", False: "clockwise"}
    lines = []
    for i, (name, ratio) in enumerate(zip(TURNS, vehicle.rotors.torque_ratio_m.tolist(), strict=True)):
        moment = values.get(name, 0.0)
        if moment * ratio < 0.0:
            lines.append(
                f"rotor {i + 1}: turns {words[ratio > 0.0]} (from above) by rotors.torque_ratio_m, "
                f"{words[moment > 0.0]} by {name} = {moment:g}"
            )
    return lines


def _words(place: F64) -> str:
    """Where a rotor lies, seen from above; `place` in mean arms, forward and right."""
    x, y = (0 if abs(part) < _CENTRE_SHARE else int(math.copysign(1, part)) for part in place.tolist())
    return f"{_LENGTH_WORDS[x]} {_SIDE_WORDS[y]}".strip() or "in the middle"
