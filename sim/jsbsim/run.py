"""A JSBSim plant, its autopilot's rate loop and its sensors for several milliseconds, with one compiled call for each.

It calls the very functions that those call one by one, in the same order, so the flight is the same bit for bit: only
the way through Python is left out.  JSBSim itself can't be called from compiled code.
"""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from sim.autopilot.rate_control import RateControl, rate_step
from sim.jsbsim.plant import JsbsimPlant
from sim.jsbsim.readings import R_FORCE, R_POS, R_Q, R_RATE, R_VEL, read
from sim.sensors import GYRO, Sensors, sense


class JsbsimRun:
    """`run(steps)`: rate loop, plant, sensors, `steps` times."""

    __slots__ = ("_plant", "_rate", "_sensors")

    def __init__(self, plant: JsbsimPlant, rate: RateControl, sensors: Sensors) -> None:
        self._plant = plant
        self._rate = rate
        self._sensors = sensors

    def run(self, steps: int) -> None:
        """At most as many steps as the sensors have before their next estimate, that one included."""
        plant, rate, sensors = self._plant, self._rate, self._sensors
        estimator = sensors.estimator
        row, estimator_row = sensors.noise_row(), estimator.noise_row()
        arrays = (
            rate.config, rate.state, rate.mix, rate.motor_command, plant.gyro_bias_frd_radps,
            plant.accel_bias_frd_mps2, plant.misalignment_q, sensors.noise, sensors.imu, estimator.noise,
            estimator.model, estimator.state,
        )  # fmt: skip
        rate.step(sensors.gyro_frd_radps)
        plant.fly(rate.motor_command, _look, [(steps - 1 - k, row + k, estimator_row, *arrays) for k in range(steps)])
        sensors.sampled(plant, steps)


@njit
def _look(
    shown: F64, frame: F64, x: float, y: float, z: float, vn: float, ve: float, vd: float, phi: float, theta: float,
    psi: float, p: float, q: float, r: float, fx: float, fy: float, fz: float, left: int, noise_row: int,
    estimator_row: int, config: F64, loop: F64, mix: F64, motors: F64, gyro_bias: F64, accel_bias: F64,
    misalignment: F64, noise: F64, imu: F64, estimator_noise: F64, model: F64, estimate: F64,
) -> float:  # fmt: skip
    """After JSBSim's frame: its numbers, the sensors, and where another step follows its motor commands."""
    height = read(shown, frame, x, y, z, vn, ve, vd, phi, theta, psi, p, q, r, fx, fy, fz)
    sense(
        shown[R_RATE : R_RATE + 3],
        shown[R_FORCE : R_FORCE + 3],
        shown[R_POS : R_POS + 3],
        shown[R_VEL : R_VEL + 3],
        shown[R_Q : R_Q + 4],
        gyro_bias,
        accel_bias,
        misalignment,
        noise,
        noise_row,
        imu,
        estimator_noise,
        estimator_row,
        model,
        estimate,
    )
    if left > 0:
        rate_step(imu[GYRO : GYRO + 3], config, loop, mix, motors)
    return height
