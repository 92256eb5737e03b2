"""Streams of the simulated vehicle: which, how often, with what in them; the rates are those of a real PX4."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import development as dialect
from station import GCS, ONBOARD, Station, airborne, position_setpoint, rates_setpoint

from flightstack_sim.schedule import STOPPED, Schedule
from flightstack_sim.streams import STREAMS
from mavlink_bridge import messages as m

SECONDS = 24.0

# Default rates in Hz, measured on PX4 1.18 disarmed.
ON_ONBOARD = {
    "Attitude": 100, "AttitudeQuaternion": 50, "HighresImu": 50, "GlobalPositionInt": 50, "LocalPositionNed": 30,
    "Odometry": 30, "Timesync": 10, "Altitude": 10, "DistanceSensor": 10, "AttitudeTarget": 10,
    "PositionTargetLocalNed": 10, "ServoOutputRaw": 10, "VfrHud": 10, "GpsRawInt": 8, "ExtendedSysState": 5,
    "SysStatus": 5, "Heartbeat": 1, "MissionCurrent": 1, "EstimatorStatus": 1, "OpenDroneIdLocation": 1,
    "OpenDroneIdSystem": 1, "Ping": 1, "ScaledPressure": 1, "SystemTime": 1, "LinkNodeStatus": 1, "BatteryStatus": 0.5,
    "CurrentMode": 0.5, "HomePosition": 0.5, "Vibration": 0.5, "TimeEstimateToTarget": 0.5,
    "CurrentEventSequence": 1 / 3,
}  # fmt: skip
ON_GCS = {
    "Attitude": 50, "AttitudeQuaternion": 50, "AttitudeTarget": 50, "LocalPositionNed": 50, "GlobalPositionInt": 50,
    "PositionTargetLocalNed": 50, "ServoOutputRaw": 50, "GpsRawInt": 5, "VfrHud": 4, "Heartbeat": 1,
    "MissionCurrent": 1, "Altitude": 1, "ExtendedSysState": 1, "OpenDroneIdLocation": 1, "OpenDroneIdSystem": 1,
    "ScaledPressure": 1, "SysStatus": 1, "LinkNodeStatus": 1, "BatteryStatus": 0.5, "CurrentMode": 0.5,
    "DistanceSensor": 0.5,
    "EstimatorStatus": 0.5, "HomePosition": 0.5, "TimeEstimateToTarget": 0.5, "CurrentEventSequence": 1 / 3,
    "Ping": 1 / 6, "Vibration": 1 / 6,
}  # fmt: skip


@pytest.fixture(scope="module")
def disarmed() -> Station:
    """24 s of a vehicle that nobody talks to, once it has booted."""
    station = Station(grade="gps").boot()
    station.clear()
    station.run(SECONDS)
    return station


@pytest.mark.parametrize(("link", "expected"), [(ONBOARD, ON_ONBOARD), (GCS, ON_GCS)], ids=["onboard", "gcs"])
def test_the_default_streams_are_px4s_each_within_3_percent(
    disarmed: Station, link: int, expected: dict[str, float]
) -> None:
    measured = disarmed.rates(link, SECONDS)
    assert set(measured) == set(expected)
    for name, rate in expected.items():
        assert abs(measured[name] * SECONDS - rate * SECONDS) <= max(0.03 * rate * SECONDS, 1e-6), name


def test_the_default_streams_of_the_onboard_link_are_those_of_the_recording(disarmed: Station, recorded: Path) -> None:
    data = (recorded / "px4_sih_offboard.tlog").read_bytes()
    at, start, end = 0, 0, 0
    ids: dict[int, int] = {}
    while at + 8 < len(data):
        t_us, frame = int.from_bytes(data[at : at + 8], "big"), data[at + 8 : at + 18]
        start = start or t_us
        if t_us - start > 3_900_000:  # then the recording's client begins to talk
            break
        end = t_us
        number = int.from_bytes(frame[7:10], "little")
        ids[number] = ids.get(number, 0) + (frame[5] == 1)
        at += 8 + 12 + frame[1] + (13 if frame[2] & 1 else 0)
    ours = disarmed.rates(ONBOARD, SECONDS)
    theirs = {number: 1e6 * count / (end - start) for number, count in ids.items()}
    assert {m.BY_ID[number].event.__name__ for number in theirs} == set(ours)
    for number, rate in theirs.items():
        if rate > 4.0:  # slower ones are too few in four seconds, and its clock ran 1 to 1.5 % slow
            assert ours[m.BY_ID[number].event.__name__] == pytest.approx(rate, rel=0.06), number


def request(station: Station, number: int, interval_us: float, link: int = ONBOARD) -> list[int]:
    station.link_index = link
    results = station.command(511, float(number), interval_us)
    station.link_index = ONBOARD
    return results


@pytest.mark.parametrize(
    ("event", "interval_us", "rate_hz"),
    [
        (m.LocalPositionNed, 10_000, 100.0),
        (m.LocalPositionNed, 8_000, 125.0),
        (m.LocalPositionNed, 2_000, 125.0),
        (m.AttitudeQuaternion, 4_000, 198.0),
        (m.AttitudeQuaternion, 2_000, 198.0),
        (m.AttitudeQuaternion, 10_000, 100.0),
        (m.Attitude, 4_000, 198.0),
        (m.HighresImu, 4_000, 250.0),
        (m.ServoOutputRaw, 20_000, 50.0),
        (m.ServoOutputRaw, 8_000, 125.0),
        (m.ServoOutputRaw, 4_000, 250.0),
        (m.Odometry, 10_000, 100.0),
        (m.HilStateQuaternion, 20_000, 50.0),
        (m.ScaledImu, 50_000, 20.0),
        (m.ActuatorOutputStatus, 100_000, 10.0),
        (m.ExtendedSysState, 100_000, 10.0),
        (m.GpsRawInt, 1, 8.0),
        (m.AttitudeTarget, 7_000, 1e6 / 7_000),
    ],
)
def test_a_stream_comes_as_fast_as_asked_for_and_no_faster_than_its_source(
    event: type, interval_us: int, rate_hz: float
) -> None:
    station = Station(grade="gps").boot()
    assert request(station, m.id_of(event), interval_us) == [0]
    station.clear()
    station.run(8.0)
    assert len(station.all(event)) == pytest.approx(8.0 * rate_hz, rel=0.03)
    assert len(station.all(event, GCS)) <= 8.0 * 50.0 + 1  # the other link keeps its own pace
    station.command(510, float(m.id_of(event)))
    assert station.last(m.MessageInterval) == m.MessageInterval(m.id_of(event), interval_us)


@pytest.mark.parametrize("number", [65, 231], ids=["RC_CHANNELS", "WIND_COV"])
def test_a_stream_that_has_nothing_to_say_takes_an_interval_and_stays_silent(number: int) -> None:
    station = Station().boot()
    assert request(station, number, 100_000) == [0]


def test_the_imu_in_whole_numbers_says_what_the_fine_one_says() -> None:
    """MAVLink's units: mG, mrad/s, mgauss, each rounded to a whole number."""
    station = Station().boot()
    request(station, m.id_of(m.HighresImu), 4_000)
    request(station, m.id_of(m.ScaledImu), 20_000)
    station.run(1.0)
    coarse, fine = station.last(m.ScaledImu), station.all(m.HighresImu)
    (same,) = [imu for imu in fine if imu.t_us == coarse.t_boot_us]
    assert coarse.accel_frd_mps2 == pytest.approx(same.accel_frd_mps2, abs=0.0051)
    assert coarse.rate_frd_radps == pytest.approx(same.rate_frd_radps, abs=0.00051)
    assert coarse.mag_frd_gauss == pytest.approx(same.mag_frd_gauss, abs=0.00051)


def test_the_outputs_as_numbers_are_those_in_microseconds() -> None:
    station = Station().boot()
    request(station, m.id_of(m.ActuatorOutputStatus), 20_000)
    station.run(0.5)
    status, servos = station.last(m.ActuatorOutputStatus), station.last(m.ServoOutputRaw)
    assert status.active == 16
    assert status.outputs == (*map(float, servos.pwm_us), *(0.0,) * 16)


def test_a_stream_is_stopped_by_minus_1_and_restored_by_0() -> None:
    station = Station().boot()
    number = m.id_of(m.HighresImu)
    assert request(station, number, -1.0) == [0]
    station.clear()
    station.run(2.0)
    assert station.all(m.HighresImu) == []
    station.command(510, float(number))
    assert station.last(m.MessageInterval).interval_us == -1
    assert request(station, number, 0.0) == [0]
    station.clear()
    station.run(2.0)
    assert len(station.all(m.HighresImu)) == pytest.approx(100, abs=2)


def test_the_default_interval_of_local_position_reads_33333_us() -> None:
    station = Station()
    assert station.command(510, 32.0) == [0]
    assert station.last(m.MessageInterval) == m.MessageInterval(32, 33333)


@pytest.mark.parametrize("number", [0, 12345, 65000, 77, -3, math.inf, 1e30])
def test_an_unknown_id_and_the_heartbeat_cannot_be_set(number: float) -> None:
    station = Station()
    assert request(station, number, 10_000) == [4]  # type: ignore[arg-type]
    station.clear()
    station.run(3.0)
    assert len(station.all(m.Heartbeat)) == 3


def test_a_heartbeat_is_sent_on_request() -> None:
    """As a real PX4 does, also where its stream is off (v1.18.0alpha, 2026-11-24)."""
    station = Station()
    station.clear()
    assert station.command(512, 0.0) == [0]
    assert station.last(m.Heartbeat).autopilot == 12


def test_the_interval_of_an_unknown_id_reads_minus_1() -> None:
    station = Station()
    assert station.command(510, 12345.0) == [0]
    assert station.last(m.MessageInterval) == m.MessageInterval(12345, -1)


@pytest.mark.parametrize(
    ("params", "result"),
    [
        ((31.0, 10_000.0, 1.0), 4),
        ((31.0, 10_000.0, 0.0, 5.0), 4),
        ((31.0, 10_000.0, 0.0, 0.0, 0.0, 0.0, 2.0), 4),
        ((31.0, 10_000.0, 0.0, 0.0, 7.0, 7.0, 0.0), 0),
        ((31.0, 10_000.0), 0),
        ((31.0,), 0),
        ((31.0, math.inf), 0),
        ((31.0, -math.inf), 0),
        ((31.0, 1e30), 0),
    ],
)
def test_only_finite_unused_parameters_spoil_an_interval_request(params: tuple[float, ...], result: int) -> None:
    assert Station().command(511, *params) == [result]


def test_intervals_are_each_links_own() -> None:
    station = Station().boot()
    assert request(station, m.id_of(m.AttitudeQuaternion), 100_000.0, GCS) == [0]
    station.clear()
    station.run(4.0)
    assert len(station.all(m.AttitudeQuaternion, GCS)) == pytest.approx(40, abs=1)
    assert len(station.all(m.AttitudeQuaternion, ONBOARD)) == pytest.approx(200, abs=1)


# --- what is in them ---


def test_while_disarmed_the_values_are_those_px4_sends(disarmed: Station) -> None:
    last = disarmed.last
    assert last(m.Heartbeat) == m.Heartbeat(2, 12, 0x1D, 0x03040000, 3)
    assert last(m.CurrentMode) == m.CurrentMode(0, 0x03040000, 0x03040000)
    assert last(m.ExtendedSysState) == m.ExtendedSysState(0, 1)
    assert last(m.ServoOutputRaw).pwm_us == (900,) * 16
    assert last(m.EstimatorStatus).flags == 1023
    assert math.isnan(last(m.EstimatorStatus).tas_ratio)
    status = last(m.SysStatus)
    assert (status.present, status.enabled, status.health) == (0x0300402F, 0x0301402F, 0x1320C83F)
    battery = last(m.BatteryStatus)
    assert battery.voltages_v[0] == pytest.approx(16.2, abs=1e-3)
    assert all(math.isnan(cell) for cell in battery.voltages_v[1:])
    assert (battery.current_a, battery.remaining) == (-1.0, 100)
    fix = last(m.GpsRawInt)
    assert (fix.t_us, fix.fix_type, fix.satellites_visible) == (0, 3, 10)
    assert last(m.HighresImu).id == 0
    assert (last(m.Odometry).frame_id, last(m.Odometry).child_frame_id) == (1, 1)
    assert math.isnan(last(m.VfrHud).airspeed_mps)
    target = last(m.PositionTargetLocalNed)
    assert (target.type_mask, target.acc_ned_mps2) == (63, (0.0, 0.0, 100.0))
    assert all(math.isnan(value) for value in target.pos_ned_m + target.vel_ned_mps)
    assert last(m.AttitudeTarget).thrust_norm == pytest.approx(0.001)


def test_home_and_position_lie_at_px4s_place(disarmed: Station) -> None:
    home = disarmed.last(m.HomePosition)
    assert (home.lat_deg, home.lon_deg) == pytest.approx((47.397742, 8.545594), abs=2e-5)
    assert home.alt_msl_m == pytest.approx(489.4, abs=2.0)
    assert home.t_us == pytest.approx(3.82e6, abs=0.1e6)
    position = disarmed.last(m.GlobalPositionInt)
    assert (position.lat_deg, position.lon_deg) == pytest.approx((home.lat_deg, home.lon_deg), abs=2e-5)
    assert position.relative_alt_m == pytest.approx(position.alt_msl_m - home.alt_msl_m, abs=2e-3)


def test_time_stamps_are_sample_times(disarmed: Station) -> None:
    for t_us, message in disarmed.heard[ONBOARD]:
        if isinstance(message, m.HighresImu | m.ServoOutputRaw | m.Odometry):
            assert message.t_us == t_us
        elif isinstance(message, m.AttitudeQuaternion | m.LocalPositionNed):
            assert 0 <= t_us - message.t_boot_us < 1000  # milliseconds on the wire


def test_the_imu_at_rest_measures_gravity(disarmed: Station) -> None:
    samples = disarmed.all(m.HighresImu)
    mean = [sum(s.accel_frd_mps2[axis] for s in samples) / len(samples) for axis in range(3)]
    assert mean == pytest.approx([0.0, 0.0, -9.80665], abs=0.05)
    assert all(s.fields_updated & 0x3F == 0x3F for s in samples)
    assert any(s.fields_updated & 0x1C0 for s in samples)


def test_before_the_estimate_is_ready_status_and_flags_say_so() -> None:
    station = Station()
    station.run(3.5)
    assert station.last(m.Heartbeat).system_status == 0
    assert not station.last(m.SysStatus).health & 1 << 28
    flags = [status.flags for status in station.all(m.EstimatorStatus)]
    assert flags[0] == 164
    assert flags[-1] == 229
    assert station.all(m.HomePosition) == []
    station.run(2.5)
    assert station.last(m.EstimatorStatus).flags == 1023
    assert station.last(m.Heartbeat).system_status == 3
    assert station.last(m.SysStatus).health & 1 << 28
    assert station.all(m.HomePosition)


def test_attitude_agrees_with_its_quaternion() -> None:
    station = airborne(position_setpoint(3.0, 2.0, -2.5))
    request(station, m.id_of(m.Attitude), 4_000)
    request(station, m.id_of(m.AttitudeQuaternion), 4_000)
    station.stream = position_setpoint(-3.0, 0.0, -2.5)
    station.run(2.0)
    attitudes = {message.t_boot_us: message for message in station.all(m.Attitude)}
    compared = 0
    for message in station.all(m.AttitudeQuaternion):
        other = attitudes.get(message.t_boot_us)
        if other is not None:
            w, x, y, z = message.q_ned_frd
            assert other.roll_rad == pytest.approx(math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), abs=1e-6)
            assert other.pitch_rad == pytest.approx(math.asin(2 * (w * y - z * x)), abs=1e-6)
            compared += 1
    assert compared > 50


def test_in_rate_offboard_the_attitude_target_is_stale_but_for_its_rates() -> None:
    station = Station().boot()
    station.stream = rates_setpoint(0.0)
    station.run(0.5)
    station.command(176, 1.0, 6.0)
    station.command(400, 1.0)
    station.stream = rates_setpoint(0.2, (0.1, -0.2, 0.3))
    station.run(1.0)
    target = station.last(m.AttitudeTarget)
    assert station.server.t_us - target.t_boot_us > 900_000
    assert target.thrust_norm == pytest.approx(0.001)
    assert target.rate_frd_radps == pytest.approx((0.1, -0.2, 0.3))
    station.clear()
    station.run(0.5)
    assert station.all(m.PositionTargetLocalNed) == []
    assert station.last(m.AttitudeTarget).t_boot_us == target.t_boot_us


def test_the_position_target_in_offboard_is_what_was_asked_for() -> None:
    station = airborne(position_setpoint(1.0, -0.5, -2.0))
    assert station.last(m.PositionTargetLocalNed).pos_ned_m == pytest.approx((1.0, -0.5, -2.0))
    assert station.all(m.PositionTargetGlobalInt) == []


def test_the_truth_is_sent_on_request_only_and_is_the_truth(disarmed: Station) -> None:
    assert disarmed.all(m.HilStateQuaternion) == []
    station = airborne()
    request(station, m.id_of(m.HilStateQuaternion), 20_000)
    station.run(0.2)
    truth = station.vehicle.plant.truth()
    message = station.last(m.HilStateQuaternion)
    assert message.t_us == 0
    assert message.alt_msl_m == pytest.approx(489.4 - truth.pos_ned_m[2], abs=0.1)
    assert message.q_ned_frd == pytest.approx(truth.q_ned_frd, abs=0.05)


def test_the_battery_falls_linearly_while_armed_and_stays_at_half() -> None:
    station = airborne()
    seconds = station.server.t_us * 1e-6 - station.state.armed_at_us * 1e-6
    assert station.last(m.SysStatus).remaining == pytest.approx(100.0 - 50.0 * seconds / 60.0, abs=1.0)
    station.vehicle.params.set("SIM_BAT_DRAIN", 2.0)
    station.run(3.0)
    assert station.last(m.SysStatus).remaining == 50
    assert station.last(m.SysStatus).voltage_v == pytest.approx(15.3, abs=1e-3)  # as recorded


# --- the table and the schedule ---


def test_every_row_of_the_table_names_its_message_once() -> None:
    ids = [spec.id for spec in STREAMS]
    assert len(set(ids)) == len(ids)


@pytest.mark.parametrize("spec", [spec for spec in STREAMS if spec.onboard_hz], ids=lambda spec: spec.event.__name__)
def test_the_table_of_streams_and_the_table_of_messages_state_the_same_rate(spec: object) -> None:
    row = m.BY_EVENT[spec.event]  # type: ignore[attr-defined]
    if row.rate_hz:
        assert row.rate_hz == pytest.approx(spec.onboard_hz)  # type: ignore[attr-defined]


def test_the_ids_are_those_of_the_dialect() -> None:
    assert m.id_of(m.HilStateQuaternion) == dialect.MAVLINK_MSG_ID_HIL_STATE_QUATERNION
    assert m.id_of(m.ServoOutputRaw) == dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW


@pytest.mark.parametrize("interval_us", [4_000, 5_050, 7_000, 33_333, 999_999])
def test_a_schedule_keeps_its_average_rate_though_ticks_do_not_divide_it(interval_us: int) -> None:
    schedule = Schedule()
    schedule.start(7, interval_us, 0)
    count = sum(len(list(schedule.due(now))) for now in range(0, 40_000_000, 4_000))
    assert count == pytest.approx(40_000_000 / interval_us, abs=1.01)


def test_a_schedule_that_fell_behind_does_not_catch_up() -> None:
    schedule = Schedule()
    schedule.start(1, 10_000, 0)
    assert list(schedule.due(1_000_000)) == [1]
    assert list(schedule.due(1_004_000)) == []
    assert list(schedule.due(1_010_000)) == [1]


def test_a_schedule_gives_what_is_due_in_order_of_time_then_key() -> None:
    schedule = Schedule()
    schedule.start(5, 100_000, 3_000)
    schedule.start(2, 100_000, 4_000)
    schedule.start(9, 100_000, 1_000)
    schedule.start(1, 100_000, 4_000)
    assert list(schedule.due(4_000)) == [9, 5, 1, 2]
    schedule.stop(5)
    assert schedule.interval_us(5) == STOPPED
    assert list(schedule.due(110_000)) == [9, 1, 2]
