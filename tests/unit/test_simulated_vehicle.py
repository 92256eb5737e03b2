"""The simulated vehicle: one compiled call for several milliseconds flies just as every part stepped on its own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from station import vehicle_file

from flightstack.types import F64
from flightstack.vehicle import with_effects
from flightstack_sim.autopilot.flight_control import FlightControl, airframe_params
from flightstack_sim.autopilot.setpoint import HOLD, LAND, OFF, ControlKind, ControlSetpoint
from flightstack_sim.grade import load_grade
from flightstack_sim.plant import NativePlant, Truth
from flightstack_sim.sensors import Sensors
from flightstack_sim.simulated_vehicle import SimulatedVehicle

EFFECTS = {
    "turbulence": {"sigma_mps": 0.5, "length_m": 20.0},
    "gyro_bias": {"x_radps": 0.01},
    "transport_delay": {"delay_s": 0.0123},
}


class Foreign:
    """A plant of another make, as far as the vehicle can tell."""

    def __init__(self, plant: NativePlant) -> None:
        self._plant = plant
        self.dt_us = plant.dt_us
        self.pos_ned_m, self.vel_ned_mps, self.q_ned_frd = plant.pos_ned_m, plant.vel_ned_mps, plant.q_ned_frd
        self.rate_frd_radps, self.specific_force_frd_mps2 = plant.rate_frd_radps, plant.specific_force_frd_mps2
        self.accel_bias_frd_mps2, self.gyro_bias_frd_radps = plant.accel_bias_frd_mps2, plant.gyro_bias_frd_radps
        self.misalignment_q = plant.misalignment_q

    @property
    def t_us(self) -> int:
        return self._plant.t_us

    @property
    def battery_v(self) -> float:
        return self._plant.battery_v

    @property
    def on_ground(self) -> bool:
        return self._plant.on_ground

    def step(self, motor_command: F64) -> None:
        self._plant.step(motor_command)

    def truth(self) -> Truth:
        return self._plant.truth()

    def set_effect(self, name: str, values: Mapping[str, float]) -> None:
        self._plant.set_effect(name, values)


def flight(grade: str, *, foreign: bool, ticks: tuple[int, ...]) -> list[bytes]:
    """What can be seen of a flight through every kind of control, with an effect that comes on the way."""
    believed = vehicle_file("px4-sihsim-quadx")
    native = NativePlant(with_effects(believed, EFFECTS), seed=3)
    control = FlightControl(believed, airframe_params(believed))
    plant = Foreign(native) if foreign else native
    vehicle = SimulatedVehicle(plant, Sensors(load_grade(grade), seed=4), control)  # type: ignore[arg-type]
    seen = []
    for setpoint, ms in (
        (OFF, 60),
        (ControlSetpoint(ControlKind.TAKEOFF, pos_ned_m=(np.nan, np.nan, -2.0)), 5000),
        (ControlSetpoint(ControlKind.RATE, (0.1, -0.2, 0.3), 0.55), 600),
        (HOLD, 1200),
        (LAND, 600),
    ):
        while ms > 0:
            for n in ticks:
                vehicle.advance(setpoint, n)
                ms -= n
            seen.append(
                b"".join(a.tobytes() for a in (vehicle.motor_command, vehicle.torque, vehicle.sensors.mean_imu))
                + repr((vehicle.plant.truth(), vehicle.estimate, vehicle.fix)).encode()
            )
        if setpoint.kind is ControlKind.RATE:
            vehicle.plant.set_effect("accelerometer_bias", {"z_mps2": 0.1})
    assert -native.truth().pos_ned_m[2] > 0.5
    return seen


@pytest.mark.parametrize("ticks", [(4,), (1, 5, 6), (20,)])
@pytest.mark.parametrize("grade", ["mocap", "gps"])
def test_a_native_plant_flies_the_same_bits_as_any_other_stepped_one_by_one(grade: str, ticks: tuple[int, ...]) -> None:
    assert flight(grade, foreign=False, ticks=ticks) == flight(grade, foreign=True, ticks=ticks)


def test_gusts_stay_the_same_when_steps_taken_outside_put_their_blocks_out_of_step() -> None:
    """A block of gust normals then ends within a tick."""
    believed = vehicle_file("px4-sihsim-quadx")
    states = []
    for foreign in (False, True):
        native = NativePlant(with_effects(believed, EFFECTS), seed=3)
        for _ in range(3):
            native.step(np.zeros(4))
        plant = Foreign(native) if foreign else native
        control = FlightControl(believed, airframe_params(believed))
        vehicle = SimulatedVehicle(plant, Sensors(load_grade("mocap"), seed=4), control)  # type: ignore[arg-type]
        vehicle.advance(ControlSetpoint(ControlKind.RATE, thrust_norm=0.6), 1000)
        states.append(native.truth())
    assert states[0] == states[1]
    assert states[0].wind_ned_mps != (0.0, 0.0, 0.0)
