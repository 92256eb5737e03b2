"""Logs of ground stations and of ArduPilot as the workflow reads them: what they lack, and whose bias is taken out."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect
from shipped import load_vehicle

from flightstack.gap.read import flight
from flightstack.gap.sources import FREED
from flightstack.types import InputError
from tests.unit.test_log_formats import UTC_US, dataflash, tlog

PX4, ARDUPILOT = 12, 3


def telemetry(*messages: Any, seconds: float = 4.0, hz: float = 50.0, autopilot: int | None = PX4) -> bytes:
    """These messages (callables of the time since boot, s) again and again, as a ground station stores them."""
    link, out = dialect.MAVLink(io.BytesIO(), srcSystem=1, srcComponent=1), bytearray()
    for k in range(int(seconds * hz)):
        made = [message(10.0 + k / hz) for message in messages]
        if k % int(hz) == 0 and autopilot is not None:
            made.append(dialect.MAVLink_heartbeat_message(2, autopilot, 0x81, 4, 4, 3))
        for each in made:
            out += (UTC_US + round(1e6 * k / hz)).to_bytes(8, "big") + each.pack(link)
    return bytes(out)


def speed(_: float) -> Any:
    return dialect.MAVLink_vfr_hud_message(1.0, 1.0, 90, 50, 10.0, 0.0)


def highres(t_s: float) -> Any:
    return dialect.MAVLink_highres_imu_message(round(1e6 * t_s), 0.1, 0.2, -9.8, *[0.0] * 10, 63)


def raw(t_s: float) -> Any:
    return dialect.MAVLink_raw_imu_message(round(1e6 * t_s), 10, 20, -1000, 0, 0, 0, 0, 0, 0)


def words_only() -> bytes:
    """A DataFlash log of a board that said something and never flew: no IMU, no attitude, no outputs."""
    head = b"\xa3\x95\x80"
    out = head + struct.pack("<BB4s16s64s", 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    out += head + struct.pack("<BB4s16s64s", 130, 75, b"MSG", b"QZ", b"TimeUS,Message")
    for k in range(20):
        out += b"\xa3\x95" + bytes([130]) + struct.pack("<Q64s", 1_000_000 * k, b"ArduCopter V4.5.7")
    return out


@pytest.mark.parametrize(
    ("name", "content", "lacks"),
    [
        ("a.tlog", telemetry(speed, autopilot=None), "LOCAL_POSITION_NED"),
        ("heartbeats.tlog", telemetry(speed), "LOCAL_POSITION_NED"),
        ("a.BIN", words_only(), "XKF1"),
    ],
)
def test_a_log_without_a_flights_messages_is_told_which_it_lacks(
    tmp_path: Path, name: str, content: bytes, lacks: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        flight(tmp_path / name, load_vehicle("quad-x"))
    assert lacks in str(caught.value)
    assert "MCAP" not in str(caught.value)


@pytest.mark.parametrize(
    ("imu", "autopilot", "freed"),
    [
        (highres, PX4, True),
        (highres, None, True),
        (highres, ARDUPILOT, False),
        (raw, PX4, False),
        (raw, ARDUPILOT, False),
    ],
)
def test_px4s_highres_imu_lacks_the_bias_that_its_filter_believes_in_whoever_stored_it(
    tmp_path: Path, imu: Any, autopilot: int | None, freed: bool
) -> None:
    """mavlink_main's HIGHRES_IMU subtracts `estimator_sensor_bias`; SCALED_IMU, RAW_IMU and ArduPilot's do not."""
    (tmp_path / "a.tlog").write_bytes(telemetry(imu, autopilot=autopilot))
    signals = flight(tmp_path / "a.tlog", load_vehicle("quad-x")).signals
    assert signals["accel_frd_mps2"].source.endswith(FREED) == freed


def test_what_ardupilot_measures_is_as_it_came(tmp_path: Path) -> None:
    (tmp_path / "a.BIN").write_bytes(dataflash())
    (tmp_path / "a.tlog").write_bytes(tlog())
    for name in ("a.BIN", "a.tlog"):
        accel = flight(tmp_path / name, load_vehicle("quad-x")).signals["accel_frd_mps2"]
        assert not accel.source.endswith(FREED)
        np.testing.assert_allclose(accel.value[:, 2], -9.80665, rtol=1e-6)
