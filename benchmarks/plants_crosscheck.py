"""The two plants on the same commands: how far they come apart, effect by effect, and the same flights over UDP.

Open loop: an autopilot flies the native plant for 10 s along a lively path; its motor commands, a thousand a second,
then drive both plants from the same state with nobody steering, so that every difference between them adds up: once
over a still ball with the native plant's gravity, where only the vehicle's physics can differ, and once over JSBSim's
turning earth (the fall through its other gravity, in closed form, is taken out).  Closed loop: whole flights through
`fly` on either plant.

`python -m benchmarks.plants_crosscheck [--flights]` prints the tables of docs/physics.md; exit code 1 if a tolerance is
missed.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flightstack.cli import files
from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.result import FlightResult
from flightstack.effects.row import S_RING
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle, with_effects
from flightstack_logs.reader import read
from flightstack_sim.autopilot.flight_control import FlightControl, airframe_params
from flightstack_sim.autopilot.setpoint import OFF, ControlKind, ControlSetpoint
from flightstack_sim.grade import EstimateGrade, Grade, ImuGrade, load_grade
from flightstack_sim.jsbsim.earth import STILL, TURNING, Earth
from flightstack_sim.jsbsim.plant import JsbsimPlant
from flightstack_sim.plant import NativePlant
from flightstack_sim.sensors import Sensors
from flightstack_sim.simulated_vehicle import SimulatedVehicle

SECONDS = 10
DT_S = 1e-3
HEIGHT_M = 3.0
PATHS_M = 0.005
"""How far the true paths of a flight over UDP may differ, rms."""
OTHER_VEHICLE_M = 0.03
"""The same for JSBSim's F450, whose motors and propellers the native plant only resembles."""
TAKEOFF_MS = 8_000
_ZERO = (0.0, 0.0, 0.0)


class Apart(NamedTuple):
    """A distance between the plants' places and an angle between their attitudes."""

    position_m: float
    attitude_rad: float

    def within(self, limit: Apart) -> bool:
        """Whether both are no greater than the limit's."""
        return self.position_m <= limit.position_m and self.attitude_rad <= limit.attitude_rad


_STILL, _TURNING = Apart(0.02, 2e-4), Apart(0.1, 1.5e-3)


@dataclass(frozen=True, slots=True)
class Case:
    """An effect, its values, and how far apart the plants may be after 10 s: over the still ball, the turning earth."""

    name: str
    effects: Mapping[str, Mapping[str, float]]
    still: Apart = _STILL
    turning: Apart = _TURNING
    height_m: float = HEIGHT_M


_WIND = {"steady_wind": {"north_mps": 4.0, "east_mps": -3.0, "down_mps": 0.5}}
_DRAG = {"linear_drag": {"d_x_kgps": 0.3, "d_y_kgps": 0.4, "d_z_kgps": 0.2}}
CASES = (
    Case("none", {}),
    Case("payload", {"payload": {"mass_kg": 0.3}}),
    Case("thrust_scale", {"thrust_scale": {"scale": 0.9}}),
    Case("thrust_curve", {"thrust_curve": {"thrust_model_factor": 0.4}}),
    Case("rotor_fault", {"rotor_fault": {"rotor": 3, "effectiveness": 0.9}}),
    Case("com_offset", {"com_offset": {"x_m": 0.02, "y_m": -0.015, "z_m": 0.03}}),
    Case("inertia", {"inertia": {"scale_x": 1.2, "scale_y": 0.9, "scale_z": 1.1}}),
    Case("motor_lag", {"motor_lag": {"time_constant_s": 0.05}}),
    Case("transport_delay", {"transport_delay": {"delay_s": 0.0125}}),
    Case("battery_sag", {"battery_sag": {"thrust_loss_per_v": 0.06}}),
    Case("linear_drag", _DRAG),
    Case("angular_damping", {"angular_damping": {"k_x_nms": 0.01, "k_y_nms": 0.02, "k_z_nms": 0.03}}),
    Case("rotor_drag", {"rotor_drag": {"k_d_kg_per_rad": 1.6e-4}}),
    Case("induced_inflow", {"induced_inflow": {"k_z_kg_per_rad": 2e-4}}),
    Case("parasitic_drag", {"parasitic_drag": {"c_x_kg_per_m": 0.02, "c_y_kg_per_m": 0.03, "c_z_kg_per_m": 0.05}}),
    Case("translational_lift", {"translational_lift": {"k_h_kg_per_m": 0.008}}),
    Case(
        "blade_flapping",  # turns the vehicle the faster the faster it flies: what is apart grows by itself
        {"blade_flapping": {"k_flap_nms2_per_rad_m": 1e-6}},
        Apart(0.02, 6e-3),
        Apart(0.15, 0.02),
    ),
    Case("rotor_gyroscopic", {"rotor_gyroscopic": {"rotor_inertia_kgm2": 5e-5}}),
    Case(
        "ground_effect",  # a tilted vehicle is righted or turned over by it
        {"ground_effect": {"strength": 0.3}},
        Apart(0.06, 4e-3),
        Apart(0.25, 0.08),
        0.8,
    ),
    Case(
        "vortex_ring",  # who sinks loses thrust, and sinks faster
        {"vortex_ring": {"strength": 0.1}},
        Apart(0.05, 1e-3),
        Apart(0.2, 3e-3),
    ),
    Case("steady_wind", {**_WIND, **_DRAG}),
    Case("constant_force", {"constant_force": {"north_n": 1.2, "east_n": -0.4, "down_n": 0.2}}),
)
"""Every effect that moves the vehicle and has no dice in it."""


@dataclass(frozen=True, slots=True)
class Row:
    """How far the plants are apart after 10 s on the same commands; gravity's difference is taken out."""

    case: Case
    still: Apart
    turning: Apart
    travelled_m: float

    @property
    def holds(self) -> bool:
        """Whether both are within what is stated."""
        return self.still.within(self.case.still) and self.turning.within(self.case.turning)


def perfect() -> Grade:
    """Sensors without errors: the commands shall depend on nothing but the path."""
    grade = load_grade("mocap")
    estimate = EstimateGrade(_ZERO, _ZERO, 1.0, _ZERO, 1.0, 0.0, 1.0, 0.0, 1.0)
    return replace(grade, imu=ImuGrade(_ZERO, _ZERO, 0.0, 0.0, 0.0), estimate=estimate)


def setpoint(t: float, height_m: float) -> ControlSetpoint:
    """A place on a lively path, 4 m/s at the most, the nose turning."""
    swing = min(1.2, 0.6 * height_m)
    position = (3.0 * math.sin(1.1 * t), 2.0 * math.sin(0.8 * t), -height_m + swing * math.sin(1.5 * t))
    velocity = (3.3 * math.cos(1.1 * t), 1.6 * math.cos(0.8 * t), 1.5 * swing * math.cos(1.5 * t))
    return ControlSetpoint(
        ControlKind.POSITION, pos_ned_m=position, vel_ned_mps=velocity, yaw_rad=0.5 * math.sin(0.7 * t)
    )


class Start(NamedTuple):
    """A state in the air, as numbers."""

    pos_ned_m: F64
    vel_ned_mps: F64
    q_ned_frd: F64
    rate_frd_radps: F64
    motor_u: F64

    @property
    def euler_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw."""
        w, x, y, z = self.q_ned_frd.tolist()
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        return roll, math.asin(2.0 * (w * y - z * x)), math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def flown_commands(believed: Vehicle, vehicle: Vehicle, height_m: float, seconds: float) -> tuple[Start, F64]:
    """A state in flight, and the (steps, 4) motor commands of an autopilot that flies the native plant from there."""
    control = FlightControl(believed, airframe_params(believed))
    plant = NativePlant(vehicle, seed=0)
    flown = SimulatedVehicle(plant, Sensors(perfect(), seed=0), control)
    flown.advance(OFF, 40)
    flown.advance(ControlSetpoint(ControlKind.TAKEOFF, pos_ned_m=(math.nan, math.nan, -height_m)), TAKEOFF_MS)
    for k in range(TAKEOFF_MS):
        flown.advance(setpoint(k * DT_S, height_m), 1)
    row = (plant.pos_ned_m, plant.vel_ned_mps, plant.q_ned_frd, plant.rate_frd_radps, plant.motor_u)
    start = Start(*(part.copy() for part in row))
    sent = np.empty((round(seconds / DT_S), 4))
    for k in range(len(sent)):
        flown.advance(setpoint((TAKEOFF_MS + k) * DT_S, height_m), 1)
        sent[k] = flown.motor_command
    return start, sent


def both(vehicle: Vehicle, start: Start, earth: Earth) -> tuple[NativePlant, JsbsimPlant]:
    """The two plants in that state."""
    native, other = NativePlant(vehicle, seed=0), JsbsimPlant(vehicle, seed=0, earth=earth)
    native.pos_ned_m[:], native.vel_ned_mps[:], native.q_ned_frd[:] = start[:3]
    native.rate_frd_radps[:], native.motor_u[:] = start[3:]
    native.state_row[S_RING:] = np.tile(start.motor_u, len(native.state_row[S_RING:]) // 4)  # commands on their way
    other.place(
        pos_ned_m=start.pos_ned_m.tolist(),
        vel_ned_mps=start.vel_ned_mps.tolist(),
        euler_rad=start.euler_rad,
        rate_frd_radps=start.rate_frd_radps.tolist(),
        motor_u=start.motor_u.tolist(),
    )
    return native, other


def compare(believed: Vehicle, case: Case, seconds: float = SECONDS) -> Row:
    """Both plants on the same commands from the same state."""
    vehicle = with_effects(believed, case.effects)
    start, sent = flown_commands(believed, vehicle, case.height_m, seconds)
    still, _ = replay(vehicle, start, sent, STILL)
    turning, travelled_m = replay(vehicle, start, sent, TURNING)
    return Row(case, still, turning, travelled_m)


def replay(vehicle: Vehicle, start: Start, sent: F64, earth: Earth) -> tuple[Apart, float]:
    """How far apart they end up, and how far they flew (m)."""
    native, other = both(vehicle, start, earth)
    travelled = 0.0
    for command in sent:
        native.step(command)
        other.step(command)
        travelled += DT_S * float(np.linalg.norm(native.vel_ned_mps))
    apart = other.pos_ned_m - native.pos_ned_m
    apart[2] -= 0.5 * (earth.gravity_mps2 - STANDARD_GRAVITY_MPS2) * (len(sent) * DT_S) ** 2
    turned = abs(float(native.q_ned_frd @ other.q_ned_frd))
    return Apart(float(np.linalg.norm(apart)), 2.0 * math.acos(min(1.0, turned))), travelled


@dataclass(frozen=True, slots=True)
class Pair:
    """A scenario flown over UDP on either plant, the native model believed, learner and filter as they come."""

    scenario: str
    native: FlightResult
    other: FlightResult
    paths_apart_m: float
    """Root mean square distance of the two true paths."""
    allowed_m: float

    @property
    def holds(self) -> bool:
        """Both flights passed, and their paths are no further apart than allowed."""
        return self.native.passed and self.other.passed and self.paths_apart_m <= self.allowed_m


def flights() -> dict[str, dict[str, Any]]:
    """Label -> what `fly` is asked for: every scenario, and some with JSBSim's own F450."""
    asked: dict[str, dict[str, Any]] = {name: {"scenario": name} for name in files.shipped_names("scenarios")}
    square = Path(files.__file__).parents[1] / "data" / "scenarios" / "waypoints" / "square.toml"
    asked["waypoints square"] = {"scenario": "waypoints", "waypoints": str(square)}
    for name in ("hover", "figure8", "paper-tracking", "paper-barrier"):
        asked[f"{name}, f450"] = {"scenario": name, "vehicle": "f450"}
    return asked


def fly_both(label: str, asked: Mapping[str, Any], out: Path) -> Pair:
    """One flight on either plant with the same seed."""
    found, paths = [], []
    for plant in ("native", "jsbsim"):
        folder = out / plant
        found.append(fly(FlyOptions(plant=plant, out=folder, **asked), stop_requested=lambda: ""))
        paths.append(read(folder / "flight.mcap").tables["/truth"]["pos_ned_m"])
    count = min(map(len, paths))
    one, other = (path[:count] for path in paths)
    apart = float(np.sqrt(np.mean(np.sum((one - other) ** 2, axis=1))))
    allowed = OTHER_VEHICLE_M if asked.get("vehicle") == "f450" else PATHS_M
    return Pair(label, found[0], found[1], apart, allowed)


def open_loop(believed: Vehicle) -> Iterator[Row]:
    """All cases, one after another."""
    for i, case in enumerate(CASES, 1):
        print(f"[{i}/{len(CASES)}] {case.name}", file=sys.stderr, flush=True)
        yield compare(believed, case)


def show_open_loop(rows: list[Row]) -> str:
    """The table of docs/physics.md."""
    lines = [
        "| effect | still ball: mm | mrad | (allowed) | turning earth: mm | mrad | (allowed) |",
        "| --- | ---: | ---: | --- | ---: | ---: | --- |",
    ]
    for row in rows:
        parts = [f"| `{row.case.name}` " if row.case.effects else "| none "]
        for found, limit in ((row.still, row.case.still), (row.turning, row.case.turning)):
            allowed = f"{1e3 * limit.position_m:.0f}, {1e3 * limit.attitude_rad:g}"
            parts.append(f"| {1e3 * found.position_m:.1f} | {1e3 * found.attitude_rad:.2f} | {allowed} ")
        lines.append("".join(parts) + "|" + ("" if row.holds else " MISSED"))
    return "\n".join(lines)


FLIGHTS_HEAD = """\
| scenario | rms from the path: mm, native / JSBSim | paths apart: mm rms | least h | violations | thrust gain learned |
| --- | --- | ---: | --- | --- | --- |"""


def show_flight(pair: Pair) -> str:
    """A row of the second table."""
    both_of = (pair.native, pair.other)
    rms = " / ".join(f"{1e3 * flight.tracking['rmse_m']:.2f}" for flight in both_of)
    least = " / ".join(_said(flight.barrier["min_h_truth"], ".4f") for flight in both_of)
    broken = " / ".join(_said(flight.barrier["violations"], "d") for flight in both_of)
    gain = " / ".join(_said(flight.gp["thrust_gain"], ".4f") for flight in both_of)
    verdict = "" if pair.holds else " MISSED: " + "; ".join(flight.failure() for flight in both_of)
    return f"| {pair.scenario} | {rms} | {1e3 * pair.paths_apart_m:.2f} | {least} | {broken} | {gain} |{verdict}"


def _said(value: float | None, how: str) -> str:
    return "-" if value is None else format(value, how)


def main() -> None:
    """Measure and show; exit code 1 where a tolerance is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", default=["effects", "flights"], help="effects, flights (default: both)")
    tables = parser.parse_args().tables
    held = True
    if "effects" in tables:
        rows = list(open_loop(files.load_vehicle(None)[0]))
        print(show_open_loop(rows) + "\n", flush=True)
        held = all(row.holds for row in rows)
    if "flights" in tables:
        print(FLIGHTS_HEAD, flush=True)
        for label, asked in flights().items():
            with tempfile.TemporaryDirectory() as folder:
                pair = fly_both(label, asked, Path(folder))
            print(show_flight(pair), flush=True)
            held = held and pair.holds
    sys.exit(0 if held else 1)


if __name__ == "__main__":
    main()
