"""The log's time line against clocks made up here: from 0, never backwards, in the vehicle's seconds, through leaps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flightstack_logs.log_clock import LogClock, clock_metadata
from flightstack_logs.reader import read
from flightstack_logs.writer import FlightLog
from mavlink_bridge.messages import AttitudeQuaternion

HOST_UP_US = 1_700_000_000
"""Half an hour of uptime, as `time.monotonic` of a host shows it."""
BOOT_AHEAD_US = 321_000_000
"""The vehicle was switched on this long before."""
UTC_US = 1_767_225_600_000_000


class Rows:
    def __init__(self) -> None:
        self.rows: list[tuple[int, tuple[int, int]]] = []

    def write(self, topic: str, t_us: int, record: Any) -> None:
        assert topic == "/clock"
        self.rows.append((t_us, record))


def clock() -> tuple[LogClock, Rows]:
    rows = Rows()
    return LogClock(rows, zero_us=HOST_UP_US, utc_us=UTC_US), rows


def test_it_begins_at_0_whatever_the_hosts_clock_says_and_the_vehicles() -> None:
    line, rows = clock()
    assert line.step(HOST_UP_US) == 0
    assert line.step(HOST_UP_US + 4000) == 4000
    assert line.step(HOST_UP_US + 8000, BOOT_AHEAD_US + 8000) == 8000
    assert line.step(HOST_UP_US + 12_000, BOOT_AHEAD_US + 12_000) == 12_000
    assert rows.rows == [(0, (UTC_US, -1)), (8000, (UTC_US + 8000, BOOT_AHEAD_US + 8000))]


@pytest.mark.parametrize("rate", [1.0, 0.985, 4.0])
def test_it_counts_the_vehicles_seconds_and_its_utc_ours(rate: float) -> None:
    line, rows = clock()
    for k in range(2501):  # 10 s here
        local_us = 4000 * k
        line.step(HOST_UP_US + local_us, BOOT_AHEAD_US + round(rate * local_us), rate)
    assert line.t_us == pytest.approx(10e6 * rate, abs=2)
    assert len(rows.rows) == pytest.approx(10 * rate + 1, abs=1)
    t_us, (utc_us, vehicle_us) = rows.rows[-1]
    assert vehicle_us - t_us == BOOT_AHEAD_US
    assert utc_us - UTC_US == pytest.approx(t_us / rate, abs=2)


def test_a_fit_that_wavers_never_takes_it_back_and_a_leap_does_not_take_it_along() -> None:
    """+-3 ms of the fit from period to period; a reboot after 2 s; UTC is the host's throughout."""
    line, rows = clock()
    rng = np.random.default_rng(1)
    seen = []
    for k in range(1000):
        base_us = BOOT_AHEAD_US + 4000 * k if k < 500 else 4000 * (k - 500)
        seen.append(line.step(HOST_UP_US + 4000 * k, base_us + int(rng.integers(-3000, 3000))))
    assert np.all(np.diff(seen) >= 0)
    assert np.abs(np.array(seen) - 4000 * np.arange(1000)).max() < 10_000
    leaps = [record[1] - t_us for t_us, record in rows.rows]
    assert leaps[0] == pytest.approx(BOOT_AHEAD_US, abs=10_000)
    assert leaps[-1] == pytest.approx(-2_000_000, abs=10_000)


def test_no_two_periods_share_a_time_even_where_the_vehicles_clock_is_set_back() -> None:
    clock = LogClock(Rows(), zero_us=1_000, utc_us=0)
    times = [clock.step(1_000 + 4_000 * k, 50_000 + 4_000 * min(k, 5)) for k in range(1, 12)]
    assert (np.diff(times) > 0).all()


def test_reading_puts_the_vehicles_stamps_on_the_logs_time_line(tmp_path: Path) -> None:
    """20 ms old at receipt, before and after the vehicle's clock leaps."""
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    line = LogClock(log, zero_us=HOST_UP_US, utc_us=UTC_US)
    for k in range(1000):
        vehicle_us = BOOT_AHEAD_US + 4000 * k if k < 500 else 4000 * k
        t_us = line.step(HOST_UP_US + 4000 * k, vehicle_us)
        log.write("/vehicle/attitude", t_us, AttitudeQuaternion(vehicle_us - 20_000, (1.0, 0, 0, 0), (0.0, 0.0, 0.0)))
    log.close()
    table = read(tmp_path / "a.mcap").tables["/vehicle/attitude"]
    assert (table.t_us - table["t_boot_us"]).tolist() == [20_000] * 1000
    assert table.t_us[0] == 0


def test_the_date_in_words() -> None:
    assert clock_metadata(UTC_US + 1_234_567, simulated=True) == {
        "utc_start": "2026-01-01T00:00:01.234Z", "utc": "simulated",
    }  # fmt: skip
