"""The two plants on the same commands: how far they come apart, effect by effect, and the same flights over UDP.

Open loop: an autopilot flies the native plant for 10 s along a lively path; its motor commands, a thousand a second, then
drive both plants from the same state with nobody steering, so that every difference between them adds up.  Expected
differences are taken out by closed forms first: the native plant's gravity is 9.80665 m/s^2, JSBSim's that of its
turning ellipsoid.  Closed loop: whole flights through `fly` on either plant.

`python -m benchmarks.plants_crosscheck [--flights]` prints the tables of docs/physics.md; exit code 1 if a tolerance is
missed.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from app import files
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle, with_effects
from sim.autopilot.flight_control import FlightControl, airframe_params
from sim.autopilot.setpoint import OFF, ControlKind, ControlSetpoint
from sim.grade import EstimateGrade, Grade, ImuGrade, load_grade
from sim.jsbsim.earth import STILL, TURNING, Earth
from sim.jsbsim.plant import JsbsimPlant
from sim.plant import NativePlant
from sim.sensors import Sensors
from sim.simulated_vehicle import SimulatedVehicle

SECONDS = 10
DT_S = 1e-3
HEIGHT_M = 3.0
TAKEOFF_MS = 8_000
_ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Case:
    """An effect, its values, and how far the plants may be apart after 10 s."""

    name: str
    effects: Mapping[str, Mapping[str, float]]
    position_m: float = 0.02
    attitude_rad: float = 0.002
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
    Case("blade_flapping", {"blade_flapping": {"k_flap_nms2_per_rad_m": 5e-6}}),
    Case("rotor_gyroscopic", {"rotor_gyroscopic": {"rotor_inertia_kgm2": 5e-5}}),
    Case("ground_effect", {"ground_effect": {"strength": 1.0}}, height_m=0.8),
    Case("vortex_ring", {"vortex_ring": {"strength": 0.4}}),
    Case("steady_wind", {**_WIND, **_DRAG}),
    Case("constant_force", {"constant_force": {"north_n": 1.2, "east_n": -0.4, "down_n": 0.2}}),
)
"""Every effect that moves the vehicle and has no dice in it; turbulence and the sensors' effects have rows of their own."""


@dataclass(frozen=True, slots=True)
class Row:
    """How far the plants are apart after 10 s on the same commands, expected differences taken out."""

    case: Case
    position_m: float
    attitude_rad: float
    travelled_m: float

    @property
    def holds(self) -> bool:
        """Whether it is within what is stated."""
        return self.position_m <= self.case.position_m and self.attitude_rad <= self.case.attitude_rad


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
    """A state in flight, and the (steps, 4) motor commands of an autopilot that flies the native plant on from there."""
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
    other.place(
        pos_ned_m=start.pos_ned_m.tolist(),
        vel_ned_mps=start.vel_ned_mps.tolist(),
        euler_rad=start.euler_rad,
        rate_frd_radps=start.rate_frd_radps.tolist(),
        motor_u=start.motor_u.tolist(),
    )
    return native, other


def compare(believed: Vehicle, case: Case, seconds: float = SECONDS, earths: tuple[Earth, ...] = (STILL, TURNING)) -> Row:
    """Both plants on the same commands from the same state."""
    vehicle = with_effects(believed, case.effects)
    start, sent = flown_commands(believed, vehicle, case.height_m, seconds)
    found = []
    for earth in earths:
        native, other = both(vehicle, start, earth)
        travelled = 0.0
        for command in sent:
            native.step(command)
            other.step(command)
            travelled += DT_S * float(np.linalg.norm(native.vel_ned_mps))
        apart = other.pos_ned_m - native.pos_ned_m
        apart[2] -= 0.5 * (earth.gravity_mps2 - STANDARD_GRAVITY_MPS2) * seconds**2
        turned = abs(float(native.q_ned_frd @ other.q_ned_frd))
        found.append((float(np.linalg.norm(apart)), 2.0 * math.acos(min(1.0, turned))))
    return found, travelled
