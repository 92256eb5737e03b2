"""A JSBSim plant, its autopilot's rate loop and its sensors for several milliseconds, with one compiled call for each.

It calls the very functions that those call one by one, in the same order, so the flight is the same bit for bit: only
the way through Python is left out.  JSBSim itself can't be called from compiled code.
"""

from __future__ import annotations

from flightstack.jit import Entry, njit
from flightstack.types import F64
from flightstack_sim.autopilot.rate_control import RateControl, rate_step
from flightstack_sim.jsbsim.plant import E_ACCEL, E_GYRO, E_TURN, JsbsimPlant
from flightstack_sim.jsbsim.readings import R_FORCE, R_POS, R_Q, R_RATE, R_VEL, read
from flightstack_sim.sensors import GYRO, Sensors, sense


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
        row, told = sensors.noise_row(), (estimator.noise, estimator.noise_row(), estimator.model, estimator.state)
        arrays = rate.row, plant.sensor_errors
        rate.step(sensors.gyro_frd_radps)
        plant.fly(
            rate.motor_command,
            _LOOK.call,
            [(steps - 1 - k, *arrays, (sensors.noise, row + k, sensors.imu), told) for k in range(steps)],
        )
        sensors.sampled(plant, steps)


@njit
def _look(
    shown: F64, frame: F64, numbers: tuple[float, ...], left: int, loop: F64, errors: F64,
    sensors: tuple[F64, int, F64], estimator: tuple[F64, int, F64, F64],
) -> float:  # fmt: skip
    """After JSBSim's frame: its numbers, the sensors, and where another step follows its motor commands."""
    height = read(shown, frame, numbers)
    true = (
        shown[R_RATE : R_RATE + 3], shown[R_FORCE : R_FORCE + 3], shown[R_POS : R_POS + 3], shown[R_VEL : R_VEL + 3],
        shown[R_Q : R_Q + 4],
    )  # fmt: skip
    wrong = errors[E_GYRO : E_GYRO + 3], errors[E_ACCEL : E_ACCEL + 3], errors[E_TURN : E_TURN + 4]
    sense(true, wrong, sensors, estimator)
    if left > 0:
        imu = sensors[2]
        rate_step(imu[GYRO : GYRO + 3], loop)
    return height


_LOOK = Entry(
    _look,
    "f8[::1], f8[::1], UniTuple(f8, 15), i8, f8[::1], f8[::1], Tuple((f8[:, ::1], i8, f8[::1])), "
    "Tuple((f8[:, ::1], i8, f8[:, ::1], f8[::1]))",
)
