"""A vehicle without its MAVLink: `step(command)`, and what became of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from flightstack.cli.files import load_vehicle
from flightstack.types import Tuple3
from flightstack_sim.autopilot.setpoint import OFF, ControlKind, ControlSetpoint
from flightstack_sim.estimator import EstimatorOutput
from flightstack_sim.grade import load_grade
from flightstack_sim.plant import Truth
from flightstack_sim.simulated_vehicle import simulated_vehicle

STEP_MS = 4
MOTORS = 4


class Rates(NamedTuple):
    """Body rates (FRD, rad/s) and collective thrust 0..1: what PX4's rate loop flies."""

    rate_frd_radps: Tuple3
    thrust_norm: float


class SteppedVehicle:
    """Physics and sensors of one vehicle, 4 ms a step; the same commands give the same flight, bit for bit.

    It starts at rest on the ground at the origin, facing north (NED, metres).  InputError for an unknown vehicle file,
    plant or grade of sensors.
    """

    def __init__(
        self, vehicle: str = "quad-x", *, seed: int = 0, plant: str = "native", sensors: str = "mocap"
    ) -> None:
        description, _ = load_vehicle(vehicle)
        believed = replace(description, effects={})
        self._vehicle = simulated_vehicle(believed, description, load_grade(sensors), seed=seed, plant=plant)

    @property
    def now_s(self) -> float:
        """Simulated time, s."""
        return self._vehicle.t_us * 1e-6

    @property
    def truth(self) -> Truth:
        """The state as it is."""
        return self._vehicle.plant.truth()

    @property
    def estimate(self) -> EstimatorOutput:
        """The state as the autopilot's estimator tells it."""
        return self._vehicle.estimate

    def step(self, command: Sequence[float] | Rates) -> Truth:
        """Fly a command for 4 ms: four motor commands 0..1 in the file's order (NaN stops one), or `Rates`.

        ValueError for another number of motors.
        """
        vehicle = self._vehicle
        if isinstance(command, Rates):
            vehicle.advance(ControlSetpoint(ControlKind.RATE, command.rate_frd_radps, command.thrust_norm), STEP_MS)
            return self.truth
        motors = np.asarray(command, dtype=float)
        if motors.shape != (MOTORS,):
            raise ValueError(f"step takes {MOTORS} motor commands or Rates, not {command!r}")
        for _ in range(STEP_MS):
            vehicle.plant.step(motors)
            vehicle.sensors.step(vehicle.plant)
        vehicle.advance(OFF, 0)  # the estimate is of the present time
        return self.truth

    def set_effect(self, name: str, values: Mapping[str, float]) -> None:
        """From now on an effect (`flightstack.api.EFFECTS`) has these values; InputError where they are not allowed."""
        self._vehicle.plant.set_effect(name, values)
