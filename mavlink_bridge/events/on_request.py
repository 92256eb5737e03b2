"""Telemetry that PX4 sends only where a client asks for it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from flightstack.types import Tuple3


class ActuatorOutputStatus(NamedTuple):
    """The outputs again, as numbers: what SERVO_OUTPUT_RAW says in microseconds."""

    t_us: int
    active: int
    """Outputs in use, counted from the first."""
    outputs: tuple[float, ...]
    """(32,)"""


class ScaledImu(NamedTuple):
    """IMU and magnetometer in whole mG, mrad/s and mgauss."""

    t_boot_us: int
    accel_frd_mps2: Tuple3
    """Specific force."""
    rate_frd_radps: Tuple3
    mag_frd_gauss: Tuple3
    temperature_degc: float
