"""Records whose numbers lie in one row: what the log makes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from log_samples import tick_record
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from flightstack.types import FlatOutput, changed
from flightstack_logs.reader import read
from flightstack_logs.writer import FlightLog


def test_every_named_part_of_a_tick_reads_back_from_compressed_chunks(tmp_path: Path) -> None:
    record = tick_record(8000)
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    log.tick(record)
    log.close()
    with (tmp_path / "a.mcap").open("rb") as file:
        chunks = [part for part in StreamReader(file, emit_chunks=True).records if isinstance(part, Chunk)]
    assert {chunk.compression for chunk in chunks} == {"lz4"}
    tables = read(tmp_path / "a.mcap").tables
    for topic, source, names in (
        ("/tick", record.measurement, "pos_ned_m vel_ned_mps q_ned_frd rate_frd_radps motor_command imu_age_us"),
        ("/tick", record.proposal, "thrust_ff_n thrust_fb_n rate_ff_frd_radps rate_fb_frd_radps attitude_error_rad"),
        ("/tick", record.proposal, "nominal_acc_ned_mps2 nominal_jerk_ned_mps3"),
        ("/learner", record.learned, "acc_ned_mps2 thrust_gain residual_frd_mps2 sigma_frd_mps2 target_frd_mps2 fed"),
        ("/setpoint", record.reference, "pos_ned_m vel_ned_mps acc_ned_mps2 jerk_ned_mps3 snap_ned_mps4 yaw_rad"),
    ):
        for name in names.split():
            np.testing.assert_array_equal(tables[topic][name][0], getattr(source, name), err_msg=name)


def test_a_row_of_the_wrong_length_is_refused_and_the_next_one_is_written(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    good = tick_record(4000).reference
    for reference in (good, FlatOutput(good.row[:9]), good):
        log.write("/setpoint", 4000, reference)
    log.close()
    assert log.rejected == 1
    assert "/setpoint" in (log.failed or "")
    assert read(tmp_path / "a.mcap").tables["/setpoint"]["yaw_rad"].tolist() == [0.1, 0.1]


def test_a_changed_record_leaves_the_first_one_as_it_was() -> None:
    first = tick_record(4000).measurement
    before = first.row.copy()
    second = changed(first, vel_ned_mps=np.array([1.0, 2.0, 3.0]), imu_age_us=7)
    np.testing.assert_array_equal(first.row, before)
    assert second.vel_ned_mps.tolist() == [1.0, 2.0, 3.0]
    assert (second.imu_age_us, second.position_age_us, second.t_us) == (7, first.position_age_us, first.t_us)
    np.testing.assert_array_equal(second.row[6:], before[6:])
