"""Compile everything that the simulator calls in flight, before anyone waits for it."""

from __future__ import annotations

import numpy as np

from flightstack.vehicle import Vehicle
from flightstack_sim.autopilot.setpoint import HOLD, LAND, ControlKind, ControlSetpoint
from flightstack_sim.grade import Grade
from flightstack_sim.plant import make_plant
from flightstack_sim.server import Server
from flightstack_sim.simulated_vehicle import simulated_vehicle

_SETTLE_MS = 200
_LIFT_MS = 1000


def warm_up(vehicle: Vehicle, grade: Grade, plant: str = "native") -> None:
    """A throwaway vehicle's life: idle behind its server, then in the air with every control loop running."""
    throwaway = simulated_vehicle(vehicle, vehicle, grade, seed=0, plant=plant)
    Server(throwaway).advance(_SETTLE_MS)
    throwaway.advance(ControlSetpoint(ControlKind.RATE, thrust_norm=1.0), _LIFT_MS)  # some loops rest on the ground
    for setpoint in (HOLD, LAND):
        throwaway.advance(setpoint, _SETTLE_MS)


def warm_up_lockstep(vehicle: Vehicle, plant: str = "native") -> None:
    """What a PX4 in lockstep calls besides: the plant's steps, one by one."""
    make_plant(plant, vehicle, seed=0).step(np.zeros(4))
