"""Rows of the message table for the physics behind a PX4 (`messages.py` has the others)."""

from __future__ import annotations

from mavlink_bridge.codec import Row, row, wire
from mavlink_bridge.events import hil

HIL_ROWS: tuple[Row, ...] = (
    row(
        hil.HilSensor,
        t_us="time_usec",
        accel_frd_mps2="xacc yacc zacc",
        rate_frd_radps="xgyro ygyro zgyro",
        mag_frd_gauss="xmag ymag zmag",
        abs_pressure_hpa="abs_pressure",
        diff_pressure_hpa="diff_pressure",
        pressure_alt_m="pressure_alt",
        temperature_degc="temperature",
    ),
    row(
        hil.HilGps,
        t_us="time_usec",
        lat_deg=wire("lat", per=1e7),
        lon_deg=wire("lon", per=1e7),
        alt_msl_m=wire("alt", per=1000.0),
        hdop=wire("eph", per=100.0, unknown=0xFFFF),
        vdop=wire("epv", per=100.0, unknown=0xFFFF),
        speed_mps=wire("vel", per=100.0, unknown=0xFFFF),
        vel_north_mps=wire("vn", per=100.0),
        vel_east_mps=wire("ve", per=100.0),
        vel_down_mps=wire("vd", per=100.0),
        course_deg=wire("cog", per=100.0, unknown=0xFFFF),
    ),
    row(hil.HilActuatorControls, t_us="time_usec", nan="controls"),
)
