"""Messages between PX4 and the physics behind it (hardware or software in the loop)."""

from __future__ import annotations

from typing import NamedTuple

from flightstack.types import Tuple3


class HilSensor(NamedTuple):
    """Sensors of a simulated vehicle: what PX4 takes for its own."""

    t_us: int
    """PX4 in lockstep takes it for its clock."""
    accel_frd_mps2: Tuple3
    rate_frd_radps: Tuple3
    mag_frd_gauss: Tuple3
    abs_pressure_hpa: float
    diff_pressure_hpa: float
    pressure_alt_m: float
    temperature_degc: float
    fields_updated: int
    """Bits of the fields that are new: 0-2 acceleration, 3-5 rate, 6-8 field, 9 pressure, 10 difference, 11 height, 12
    temperature."""
    id: int = 0
    """0: the primary sensor, which drives the lockstep."""


class HilGps(NamedTuple):
    """A raw position fix of a simulated vehicle."""

    t_us: int
    fix_type: int
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    hdop: float
    """PX4 takes it for the horizontal error in metres."""
    vdop: float
    """And this for the vertical one."""
    speed_mps: float
    vel_north_mps: float
    vel_east_mps: float
    vel_down_mps: float
    course_deg: float
    satellites_visible: int
    id: int = 0
    yaw: int = 0
    """Hundredths of a degree; 0: none."""


class HilActuatorControls(NamedTuple):
    """What PX4's outputs command: 0..1 for motors."""

    t_us: int
    """PX4's time."""
    controls: tuple[float, ...]
    """16."""
    mode: int
    """MAV_MODE_FLAG: bit 7 armed."""
    flags: int
    """Bit 0: in lockstep with the sensors."""
