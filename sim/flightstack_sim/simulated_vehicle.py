"""A vehicle with its autopilot, short of modes and MAVLink: plant, sensors and control loops, stepped together.

A millisecond is: rate loop on the last gyro sample, plant, sensors.  Every fourth, before it, the outer loops run on
the last state estimate.  After `advance` everything readable here is of the present time `t_us`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_sim.autopilot.flight_control import FlightControl, airframe_params
from flightstack_sim.autopilot.params import Params
from flightstack_sim.autopilot.setpoint import ControlSetpoint
from flightstack_sim.estimator import EstimatorOutput
from flightstack_sim.fused import FusedRun
from flightstack_sim.grade import Grade
from flightstack_sim.plant import NativePlant, Plant, make_plant
from flightstack_sim.sensors import ESTIMATE_EVERY_MS, Fix, Sensors


class SimulatedVehicle:
    """Plant + sensors + control loops.

    `motor_command` (4,) 0..1, `rate_setpoint_frd_radps`, `rate_frd_radps` (filtered gyro), `torque` (3,) are updated in
    place.
    """

    def __init__(self, plant: Plant, sensors: Sensors, control: FlightControl) -> None:
        self.plant = plant
        self.sensors = sensors
        self.control = control
        self.motor_command: F64 = control.motor_command
        self.rate_setpoint_frd_radps: F64 = control.rate.rate_setpoint_frd_radps
        self.rate_frd_radps: F64 = control.rate.rate_frd_radps
        self.torque: F64 = control.rate.torque
        self._run = _fused(plant, control, sensors) or self._step_by_step
        self._ms = 0
        self._estimate: EstimatorOutput | None = None
        for _ in range(2 * ESTIMATE_EVERY_MS):  # the sensors have run before the first control step
            sensors.step(plant)

    @property
    def t_us(self) -> int:
        """Time since boot."""
        return self.plant.t_us

    @property
    def params(self) -> Params:
        """The autopilot's parameters; a changed one acts from the next 4 ms step."""
        return self.control.params

    @property
    def landed(self) -> bool:
        """The land detector's verdict."""
        return self.control.landed

    @property
    def estimate(self) -> EstimatorOutput:
        """The state estimate, renewed every 4 ms."""
        if self._estimate is None:
            self._estimate = self.sensors.estimate(self.rate_frd_radps)
        return self._estimate

    @property
    def fix(self) -> Fix | None:
        """The last raw position fix that has become known."""
        return self.sensors.fix

    def fail_motor(self, number: int, *, failed: bool) -> None:
        """A motor (1 to 4; 0: all) is stopped from now on, or runs again."""
        self.control.rate.stop_motor(number, stopped=failed)

    def advance(self, setpoint: ControlSetpoint, n_ms: int = ESTIMATE_EVERY_MS) -> None:
        """Fly `setpoint` for n_ms milliseconds."""
        while n_ms > 0:
            phase = self._ms % ESTIMATE_EVERY_MS
            if phase == 0:
                self.control.update(setpoint, self.sensors.state)
            steps = min(n_ms, ESTIMATE_EVERY_MS - phase)
            self._run(steps)
            self._ms += steps
            n_ms -= steps
        self._estimate = None

    def _step_by_step(self, steps: int) -> None:
        """Rate loop, plant, sensors, `steps` times: how any plant flies."""
        for _ in range(steps):
            self.control.rate_step(self.sensors.gyro_frd_radps)
            self.plant.step(self.motor_command)
            self.sensors.step(self.plant)


def _fused(plant: Plant, control: FlightControl, sensors: Sensors) -> Callable[[int], None] | None:
    """The plant's own way of several steps at once, bit for bit the same; None where it has none."""
    if isinstance(plant, NativePlant):
        return FusedRun(plant, control.rate, sensors).run
    from flightstack_sim.jsbsim.plant import JsbsimPlant  # a library that not every machine has
    from flightstack_sim.jsbsim.run import JsbsimRun

    return JsbsimRun(plant, control.rate, sensors).run if isinstance(plant, JsbsimPlant) else None


def simulated_vehicle(
    believed: Vehicle,
    truth: Vehicle,
    grade: Grade,
    *,
    seed: int,
    params: Params | None = None,
    plant: str = "native",
    heading_rad: float = 0.0,
) -> SimulatedVehicle:
    """A vehicle that flies as `truth` with an autopilot set up for `believed`; the seed fixes plant and sensors.

    `heading_rad`: the way it looks at first, clockwise from north.
    """
    plant_seed, sensor_seed = np.random.SeedSequence(seed).spawn(2)
    physics = make_plant(plant, truth, seed=int(plant_seed.generate_state(1)[0]))
    if heading_rad != 0.0:
        _turn(physics, heading_rad)
    control = FlightControl(believed, params if params is not None else airframe_params(believed, truth))
    return SimulatedVehicle(physics, Sensors(grade, seed=sensor_seed), control)


def _turn(plant: Plant, heading_rad: float) -> None:
    """Let a vehicle that stands at the origin look another way."""
    if isinstance(plant, NativePlant):
        plant.q_ned_frd[:] = math.cos(0.5 * heading_rad), 0.0, 0.0, math.sin(0.5 * heading_rad)
        plant.evaluate()
        return
    plant.place(euler_rad=(0.0, 0.0, heading_rad))  # type: ignore[attr-defined]
