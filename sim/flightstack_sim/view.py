"""What the streams report: one look at the vehicle a tick, as plain numbers.

Builders (`sim.builders`) read a `View` and nothing else.  It changes nothing in the vehicle.
"""

from __future__ import annotations

import math
from typing import Any, Final

from flightstack.geodesy import LocalFrame
from flightstack.types import Tuple3, Tuple4
from flightstack_sim.autopilot import modes
from flightstack_sim.autopilot.commander import CommanderState
from flightstack_sim.autopilot.navigator import NavigatorState
from flightstack_sim.autopilot.requests import NEVER
from flightstack_sim.autopilot.setpoint import POSITION_KINDS, ControlKind, ControlSetpoint
from flightstack_sim.battery_state import BatteryState
from flightstack_sim.estimator import EstimatorAccuracy
from flightstack_sim.fence import FenceWatch
from flightstack_sim.plans import Plans
from flightstack_sim.sensors import OFF
from flightstack_sim.simulated_vehicle import SimulatedVehicle

_MAG_PERIOD_US: Final = 20_000
_BARO_PERIOD_US: Final = 48_000
_IDLE_THRUST: Final = 0.001  # what PX4's attitude setpoint holds while nothing flies
_SETTLED_US: Final = 5_000_000
_DIAGONAL: Final = (0, 6, 11, 15, 18, 20)  # places of the diagonal in a 6x6 upper triangle


def _covariances(accuracy: EstimatorAccuracy) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """ODOMETRY's pose and velocity covariances (21,) each: the upper triangles' diagonals."""
    across, down = accuracy.pos_horizontal_std_m**2, accuracy.pos_vertical_std_m**2
    tilt, heading = accuracy.tilt_std_rad**2, accuracy.heading_std_rad**2
    speed = accuracy.vel_std_mps**2 / 3.0
    return _diagonal(across, across, down, tilt, tilt, heading), _diagonal(speed, speed, speed, 0.0, 0.0, 0.0)


def _diagonal(*values: float) -> tuple[float, ...]:
    matrix = [0.0] * 21
    for place, value in zip(_DIAGONAL, values, strict=True):
        matrix[place] = value
    return tuple(matrix)


class View:
    """The vehicle at `t_us`: the estimate as the autopilot knows it, never the truth (but for `vehicle` itself)."""

    __slots__ = (
        "_attitude_target",
        "_baro_at_us",
        "_mag_at_us",
        "_moved_at_us",
        "accuracy",
        "altitude_m",
        "attitude_controlled",
        "battery",
        "clock_offset_us",
        "commander",
        "covariances",
        "event_sequence",
        "fence",
        "fields_updated",
        "fixes_reported",
        "frame",
        "frozen",
        "mag_frd_gauss",
        "mission_valid",
        "navigator",
        "ping_sequence",
        "plans",
        "pos_ned_m",
        "pressure_hpa",
        "q_ned_frd",
        "rate_frd_radps",
        "setpoint",
        "silenced",
        "stamp_us",
        "sysid",
        "t_us",
        "unix_at_boot_us",
        "vehicle",
        "vel_ned_mps",
    )

    def __init__(
        self,
        vehicle: SimulatedVehicle,
        commander: CommanderState,
        navigator: NavigatorState,
        frame: LocalFrame,
        unix_at_boot_us: int,
    ) -> None:
        self.vehicle = vehicle
        self.commander = commander
        self.navigator = navigator
        self.frame = frame
        self.unix_at_boot_us = unix_at_boot_us
        self.accuracy = vehicle.estimate.accuracy
        self.covariances = _covariances(self.accuracy)
        self.battery = BatteryState(vehicle.params)
        self.sysid = 1
        self.plans = Plans()
        self.mission_valid = False
        self.fence = FenceWatch(self.plans, vehicle.params, frame)
        self.silenced: frozenset[type[Any]] = frozenset()
        """Messages that a fault keeps from being sent."""
        self.clock_offset_us = 0
        """By how much a fault has moved the stamps."""
        self.frozen: tuple[Tuple3, Tuple3] | None = None
        """Place and velocity that a fault has reported whatever the vehicle does."""
        self.setpoint: ControlSetpoint = vehicle.control.setpoint
        self.event_sequence = 0
        self.ping_sequence = 0
        self.mag_frd_gauss: Tuple3 = (0.0, 0.0, 0.0)
        self.pressure_hpa = 0.0
        self.altitude_m = 0.0
        self.fields_updated = 0
        self.fixes_reported = 0
        self._mag_at_us = self._baro_at_us = self._moved_at_us = NEVER
        self._attitude_target: tuple[int, Tuple4, float] = (0, (1.0, 0.0, 0.0, 0.0), _IDLE_THRUST)
        self.t_us = self.stamp_us = 0
        """Time since boot, and as messages carry it."""
        self.pos_ned_m: Tuple3 = (0.0, 0.0, 0.0)
        self.vel_ned_mps: Tuple3 = (0.0, 0.0, 0.0)
        self.q_ned_frd: Tuple4 = (1.0, 0.0, 0.0, 0.0)
        self.rate_frd_radps: Tuple3 = (0.0, 0.0, 0.0)
        self.attitude_controlled = False
        self.refresh()

    def refresh(self) -> None:
        """Look again: once a tick, after the vehicle has moved."""
        vehicle = self.vehicle
        self.t_us = vehicle.plant.t_us
        self.stamp_us = max(self.t_us + self.clock_offset_us, 0)
        north, east, down, v_north, v_east, v_down, w, x, y, z, _, _, _ = vehicle.sensors.state.tolist()
        self.pos_ned_m = (north, east, down)
        self.vel_ned_mps = (v_north, v_east, v_down)
        self.q_ned_frd = (w, x, y, z)
        p, q, r = vehicle.rate_frd_radps.tolist()
        self.rate_frd_radps = (p, q, r)

    def refresh_slow(self) -> None:
        """Battery and rest: ten times a second."""
        armed = self.commander.armed
        self.battery.update(self.t_us, armed=armed, plant_v=self.vehicle.plant.battery_v)
        if armed:
            self._moved_at_us = self.t_us

    def freeze(self) -> None:
        """From now on this place and velocity are reported."""
        self.frozen = (self.pos_ned_m, self.vel_ned_mps)

    def thaw(self) -> None:
        """Report what is."""
        self.frozen = None

    @property
    def told_pos_ned_m(self) -> Tuple3:
        """The position that is reported."""
        return self.frozen[0] if self.frozen is not None else self.pos_ned_m

    @property
    def told_vel_ned_mps(self) -> Tuple3:
        """The velocity that is reported."""
        return self.frozen[1] if self.frozen is not None else self.vel_ned_mps

    def use(self, setpoint: ControlSetpoint) -> None:
        """Note the setpoint of the next step; PX4's attitude setpoint goes stale when body rates take over."""
        if setpoint.kind is ControlKind.RATE and self.setpoint.kind is not ControlKind.RATE:
            self._attitude_target = self.attitude_target()
        self.setpoint = setpoint
        self.attitude_controlled = setpoint.kind is not ControlKind.RATE and setpoint.kind is not ControlKind.OFF

    @property
    def heading_rad(self) -> float:
        """Yaw, -pi to pi."""
        w, x, y, z = self.q_ned_frd
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    @property
    def heading_deg(self) -> float:
        """Heading, 0 to 360."""
        return math.degrees(self.heading_rad) % 360.0

    @property
    def altitude_amsl_m(self) -> float:
        """Height above the sea."""
        return self.frame.altitude_m - self.pos_ned_m[2]

    @property
    def relative_alt_m(self) -> float:
        """Height above home, above the origin before there is one."""
        home = self.navigator.home_ned_m
        return (home[2] if home is not None else 0.0) - self.pos_ned_m[2]

    @property
    def home_altitude_m(self) -> float:
        """Home's height above the sea."""
        home = self.navigator.home_ned_m
        return self.frame.altitude_m - (home[2] if home is not None else 0.0)

    @property
    def can_arm(self) -> bool:
        """Whether the arming checks pass in the mode chosen."""
        return self.commander.checks.arms(self.commander.intended)

    @property
    def is_still(self) -> bool:
        """On the ground with the motors off for some seconds: the estimator assumes a constant position."""
        return self.t_us - self._moved_at_us >= _SETTLED_US

    @property
    def landing(self) -> bool:
        """Coming down to land."""
        return self.setpoint.kind is ControlKind.LAND and not self.commander.landed

    @property
    def has_position_target(self) -> bool:
        """Whether a position setpoint exists: not while attitude or rates are flown."""
        return self.setpoint.kind in POSITION_KINDS or self.setpoint.kind is ControlKind.OFF

    @property
    def guided(self) -> bool:
        """Flying an automatic mode's position setpoint."""
        commander = self.commander
        flying = commander.armed and not commander.landed
        return flying and commander.mode is not modes.OFFBOARD and self.setpoint.kind in POSITION_KINDS

    def attitude_target(self) -> tuple[int, Tuple4, float]:
        """(time, attitude, thrust) of PX4's attitude setpoint; stale while body rates are flown."""
        kind = self.setpoint.kind
        if kind is ControlKind.RATE:
            return self._attitude_target
        if kind is ControlKind.OFF:
            half = 0.5 * self.heading_rad
            return self.t_us, (math.cos(half), 0.0, 0.0, math.sin(half)), _IDLE_THRUST
        control = self.vehicle.control
        w, x, y, z = control.q_setpoint_ned_frd.tolist()
        return self.t_us, (w, x, y, z), control.thrust_setpoint

    def silent(self) -> tuple[str, ...]:
        """The sensors whose data PX4 misses (SYS_HAS_BARO, SYS_HAS_MAG)."""
        sensors, params = self.vehicle.sensors, self.vehicle.params
        watched = (("Baro", sensors.barometer, "SYS_HAS_BARO"), ("Compass", sensors.magnetometer, "SYS_HAS_MAG"))
        return tuple(name for name, sensor, has in watched if sensor.lost(self.t_us) and params.get(has) != 0.0)

    def sample_air(self) -> None:
        """Magnetometer (50 Hz) and barometer (about 21 Hz) for HIGHRES_IMU; `fields_updated` says which are new."""
        fields = 0x3F
        sensors = self.vehicle.sensors
        if self.t_us - self._mag_at_us >= _MAG_PERIOD_US and sensors.magnetometer.kind != OFF:
            self._mag_at_us = self.t_us
            self.mag_frd_gauss = sensors.mag_frd_gauss()
            fields |= 0x1C0
        if self.t_us - self._baro_at_us >= _BARO_PERIOD_US and sensors.barometer.kind != OFF:
            self._baro_at_us = self.t_us
            self.pressure_hpa = sensors.pressure_hpa()
            self.altitude_m = 44330.8 * (1.0 - (self.pressure_hpa / 1013.25) ** 0.190263)
            fields |= 0x1A00
        self.fields_updated = fields
