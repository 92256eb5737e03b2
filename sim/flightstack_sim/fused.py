"""A native plant, its autopilot's rate loop and its sensors in one compiled call for several milliseconds.

It calls the very functions that those call one by one, in the same order, so the flight is the same bit for bit: only
the way through Python is left out.
"""

from __future__ import annotations

import numpy as np

from flightstack.effects import turbulence
from flightstack.effects.row import EVALUATED, S_COMMAND, S_FORCE, S_NORMALS, S_POS, S_Q, S_RATE, S_VEL
from flightstack.jit import Entry, njit
from flightstack.types import F64
from flightstack_sim.autopilot.rate_control import RateControl, motors_of, rate_step
from flightstack_sim.plant import NativePlant
from flightstack_sim.rigid_body import step_row
from flightstack_sim.sensors import GYRO, Sensors, sense


class FusedRun:
    """`run(steps)`: rate loop, plant, sensors, `steps` times."""

    __slots__ = ("_errors", "_plant", "_rate", "_sensors")

    def __init__(self, plant: NativePlant, rate: RateControl, sensors: Sensors) -> None:
        self._plant = plant
        self._rate = rate
        self._sensors = sensors
        self._errors = plant.gyro_bias_frd_radps, plant.accel_bias_frd_mps2, plant.misalignment_q

    def run(self, steps: int) -> None:
        """At most as many steps as the sensors have before their next estimate, that one included."""
        plant, rate, sensors = self._plant, self._rate, self._sensors
        while steps > 0:
            normals = plant.take_normals(steps)
            count = min(steps, len(normals)) if len(normals) else steps
            estimator = sensors.estimator
            _RUN.call(
                count, rate.row, plant.params_row, plant.state_row, normals,
                self._errors,
                (sensors.noise, sensors.noise_row(), sensors.imu),
                (estimator.noise, estimator.noise_row(), estimator.model, estimator.state),
            )  # fmt: skip
            plant.t_us += count * plant.dt_us
            sensors.sampled(plant, count)
            steps -= count


@njit
def _run(
    steps: int, loop: F64, params: F64, row: F64, normals: F64, errors: tuple[F64, F64, F64],
    sensors: tuple[F64, int, F64], estimator: tuple[F64, int, F64, F64],
) -> None:  # fmt: skip
    noise, noise_row, imu = sensors
    true = (
        row[S_RATE : S_RATE + 3], row[S_FORCE : S_FORCE + 3], row[S_POS : S_POS + 3], row[S_VEL : S_VEL + 3],
        row[S_Q : S_Q + 4],
    )  # fmt: skip
    work, motors = np.empty((3, EVALUATED)), motors_of(loop)
    for k in range(steps):
        rate_step(imu[GYRO : GYRO + 3], loop)
        for i in range(4):
            row[S_COMMAND + i] = motors[i]
        if normals.shape[0] > 0:
            for i in range(turbulence.NORMALS):
                row[S_NORMALS + i] = normals[k, 0, i]
        step_row(params, row, work)
        sense(true, errors, (noise, noise_row + k, imu), estimator)


_RUN = Entry(
    _run,
    "i8, f8[::1], f8[::1], f8[::1], f8[:, :, ::1], UniTuple(f8[::1], 3), "
    "Tuple((f8[:, ::1], i8, f8[::1])), Tuple((f8[:, ::1], i8, f8[:, ::1], f8[::1]))",
)
