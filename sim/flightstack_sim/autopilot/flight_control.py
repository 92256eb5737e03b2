"""All of the autopilot's control loops together: setpoint and estimate in, motor commands out.

The rate loop runs with every gyro sample (1 kHz), attitude and the land detector every 4 ms, position every 8 ms.
Which loops run follows from the setpoint's kind, as PX4's follows from its navigation state.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.autopilot import autopilot_of, hover_command
from flightstack.autopilot_params import AUTOPILOT_PARAMS
from flightstack.types import F64, Tuple3
from flightstack.vehicle import Vehicle
from flightstack_sim.autopilot.attitude_control import AttitudeControl
from flightstack_sim.autopilot.guidance import Guidance
from flightstack_sim.autopilot.hover_thrust import HoverThrust
from flightstack_sim.autopilot.land_detector import LandDetector
from flightstack_sim.autopilot.params import Params
from flightstack_sim.autopilot.rate_control import RateControl
from flightstack_sim.autopilot.setpoint import OFF, POSITION_KINDS, ControlKind, ControlSetpoint

TICK_S = 0.004
POSITION_TICKS = 2
_OFF, _RATE, _ATTITUDE = ControlKind.OFF, ControlKind.RATE, ControlKind.ATTITUDE


def airframe_params(vehicle: Vehicle, flown: Vehicle | None = None) -> Params:
    """Parameters as an autopilot set up for this vehicle has them: hover thrust, rotor places, its file's [autopilot].

    Gains that the file does not state are tuned on what is `flown`, as everybody's are; by default the same.
    """
    params = Params()
    values = {"MPC_THR_HOVER": min(0.8, max(0.1, hover_command(vehicle)))}
    values |= {AUTOPILOT_PARAMS[key].name: value for key, value in autopilot_of(vehicle, flown).items()}
    for index, (place, ratio) in enumerate(zip(vehicle.rotors.position_m, vehicle.rotors.torque_ratio_m, strict=True)):
        values |= {f"CA_ROTOR{index}_P{axis}": float(place[k]) for k, axis in enumerate("XYZ")}
        values[f"CA_ROTOR{index}_KM"] = float(ratio)
    for name, value in values.items():
        params.set(name, value)
    params.version = 0
    return params


class FlightControl:
    """Control loops of one vehicle.

    `update` every 4 ms takes the setpoint and the estimate's state (13,), `rate_step` every 1 ms the gyro;
    `motor_command` (4,) is updated in place.  `vehicle` is what the autopilot was set up for, not what flies.
    """

    def __init__(self, vehicle: Vehicle, params: Params) -> None:
        self.params = params
        self.rate = RateControl(vehicle, params)
        self.attitude = AttitudeControl(params)
        self.guidance = Guidance(params, POSITION_TICKS * TICK_S)
        self.hover_thrust = HoverThrust(params, POSITION_TICKS * TICK_S)
        self.land_detector = LandDetector(params)
        self.motor_command = self.rate.motor_command
        self.setpoint: ControlSetpoint = OFF
        self.q_setpoint_ned_frd = np.array([1.0, 0.0, 0.0, 0.0])
        self._version = params.version
        self._tick = 0
        self._armed_s = 0.0

    @property
    def armed(self) -> bool:
        """Motors may turn."""
        return self.setpoint.kind is not ControlKind.OFF

    @property
    def landed(self) -> bool:
        """The land detector's verdict."""
        return self.land_detector.landed

    @property
    def ground_contact(self) -> bool:
        """The land detector's first stage."""
        return self.land_detector.ground_contact

    @property
    def taking_off(self) -> bool:
        """A take-off's ramp is running."""
        return self.guidance.taking_off

    @property
    def thrust_setpoint(self) -> float:
        """Collective thrust asked of the allocation, 0..1."""
        return self.rate.thrust_setpoint

    def update(self, setpoint: ControlSetpoint, state: F64) -> None:
        """Land detector, position and attitude loops: every 4 ms, before the next rate steps."""
        if self.params.version != self._version:
            self._version = self.params.version
            for loop in (self.rate, self.attitude, self.guidance, self.hover_thrust, self.land_detector):
                loop.configure(self.params)
        entered = setpoint.kind is not self.setpoint.kind
        self.setpoint = setpoint
        kind = setpoint.kind
        armed = kind is not _OFF
        thrust = self.rate.thrust_setpoint
        if not (armed and self.land_detector.lifted(thrust)):
            self._detect_landing(state)
        landed = self.land_detector.landed
        if self._tick % POSITION_TICKS == 0:
            self.hover_thrust.update(thrust, state, landed=landed)
        attitude = kind is _ATTITUDE
        self._armed_s = self._armed_s + TICK_S if armed else 0.0
        thrust = setpoint.thrust_norm
        if kind is not _RATE and kind in POSITION_KINDS:
            attitude = True
            if entered or self._tick % POSITION_TICKS == 0:
                self.guidance.position.use_hover_thrust(self.hover_thrust.value)
                self.guidance.step(setpoint, state, self.land_detector, self._armed_s)
            self.q_setpoint_ned_frd[:] = self.guidance.q_setpoint_ned_frd
            thrust = self.guidance.thrust
        else:
            self.guidance.release(landed)
            norm = math.hypot(*setpoint.q_ned_frd) if attitude else 0.0
            if norm > 1e-6:  # else: no attitude, keep the last one
                self.q_setpoint_ned_frd[:] = setpoint.q_ned_frd
                self.q_setpoint_ned_frd /= norm
        rate: Tuple3 = setpoint.rate_frd_radps
        if attitude:
            yaw_rate = setpoint.yaw_rate_radps
            self.attitude.step(state[6:10], self.q_setpoint_ned_frd, 0.0 if math.isnan(yaw_rate) else yaw_rate)
            roll, pitch, yaw = self.attitude.rate_setpoint_frd_radps.tolist()
            rate = (roll, pitch, yaw)
        self._tick += 1
        held = self.land_detector.maybe_landed  # includes landed
        self.rate.set_target(rate, thrust, armed=armed, hold_integral=held)

    def _detect_landing(self, state: F64) -> None:
        north, east, down = state[3:6].tolist()
        roll, pitch, yaw = self.rate.rate_frd_radps.tolist()
        self.land_detector.update(
            armed=self.armed,
            thrust=self.rate.thrust_setpoint,
            vel_ned_mps=(north, east, down),
            rate_frd_radps=(roll, pitch, yaw),
            descent_setpoint_mps=self.guidance.descent_setpoint_mps,
            dt_s=TICK_S,
        )

    def rate_step(self, gyro_frd_radps: F64) -> None:
        """Rate loop and allocation: every 1 ms -> `motor_command`."""
        self.rate.step(gyro_frd_radps)
