"""The simulated vehicle as its links see it: commands, setpoints, failsafes; the oracle is a real PX4, measured."""

from __future__ import annotations

import math

import pytest
from station import (
    ARM,
    GCS,
    HOLD_MODE,
    LAND,
    MODE,
    NAN,
    OFFBOARD_MODE,
    ONBOARD,
    POSITION_MODE,
    RETURN,
    TAKEOFF,
    Station,
    airborne,
    position_setpoint,
    rates_setpoint,
    velocity_setpoint,
)

from mavlink_bridge import messages as m


@pytest.fixture
def station() -> Station:
    return Station().boot()


@pytest.fixture
def flying() -> Station:
    station = airborne()
    station.clear()
    return station


# --- commands and acknowledgements ---


def test_do_set_mode_has_two_acknowledgements_the_second_is_the_verdict(station: Station) -> None:
    assert station.command(MODE, *HOLD_MODE) == [0, 0]
    assert station.command(MODE, *OFFBOARD_MODE) == [0, 0]
    assert station.command(MODE, 129.0, 4.0, 3.0) == [0, 0]  # as MAVSDK sends it
    assert station.command(MODE, 1.0, 99.0) == [0, 1]
    assert station.command(ARM, 1.0) == [0]
    assert station.command(MODE, *OFFBOARD_MODE) == [0, 1]
    assert station.command(MODE, *POSITION_MODE) == [0, 1]


def test_an_acknowledgement_names_the_requester_and_goes_to_its_link_only() -> None:
    station = Station(system=17, component=33, link_index=GCS)
    station.command(519)
    ack = station.last(m.CommandAck)
    assert ack == m.CommandAck(519, 0, 0, 0, 17, 33)
    assert station.all(m.CommandAck, ONBOARD) == []


def test_legacy_set_mode_has_one_acknowledgement_for_176(station: Station) -> None:
    station.send(m.SetMode(1, 1, 0x00060000))
    station.run(0.02)
    assert station.all(m.CommandAck) == [m.CommandAck(176, 0, 0, 0, 245, 190)]
    assert station.state.mode.title == "Offboard"


def test_command_int_is_taken_in_frame_5_and_refused_in_any_other(station: Station) -> None:
    for frame, results in ((5, [0, 0]), (3, [9]), (0, [9]), (6, [9])):
        station.clear()
        station.send(m.CommandInt(1, 1, frame, MODE, 0, 0, (1.0, 4.0, 3.0, 0.0, 0, 0, 0.0)))
        station.run(0.02)
        assert [ack.result for ack in station.all(m.CommandAck)] == results


@pytest.mark.parametrize("command", [31999, 192, 2000, 65535, 1])
def test_an_unknown_command_is_unsupported(station: Station, command: int) -> None:
    assert station.command(command) == [3]


@pytest.mark.parametrize("target", [(9, 1), (1, 2), (2, 0), (0, 191)])
def test_a_command_for_somebody_else_gets_silence(station: Station, target: tuple[int, int]) -> None:
    assert station.command(ARM, 1.0, target=target) == []
    assert not station.state.armed


@pytest.mark.parametrize("target", [(1, 1), (1, 0), (0, 0), (0, 1)])
def test_broadcast_targets_are_taken(station: Station, target: tuple[int, int]) -> None:
    assert station.command(ARM, 0.0, target=target) == [0]


def test_reboot_is_denied(station: Station) -> None:
    assert station.command(246, 1.0) == [2]


@pytest.mark.parametrize("number", [148, 300, 242, 397, 395, 436, 264, 230, 245, 147, 33, 49, 0, 30])
def test_a_message_asked_for_comes_before_its_acknowledgement(station: Station, number: int) -> None:
    station.clear()
    assert station.command(512, float(number)) == [0]
    names = [type(message) for _, message in station.heard[ONBOARD]]
    assert m.BY_ID[number].event in names[: names.index(m.CommandAck)]


@pytest.mark.parametrize("number", [259, 410, 411, 77, 12345, 65000, -1, math.inf])
def test_a_message_that_is_not_to_be_had_is_denied(station: Station, number: float) -> None:
    assert station.command(512, float(number)) == [2]


def test_a_fix_that_was_sent_already_is_denied() -> None:
    station = Station(grade="gps").boot()
    station.command(512, 24.0)
    assert station.command(512, 24.0) == [2]


def test_all_26_modes_are_listed_on_request_or_one_by_its_index(station: Station) -> None:
    station.command(512, 435.0, 0.0)
    listed = station.all(m.AvailableModes)
    assert [mode.mode_index for mode in listed] == list(range(1, 27))
    assert all(mode.number_modes == 26 for mode in listed)
    station.clear()
    assert station.command(512, 435.0, 11.0) == [0]
    assert [(mode.custom_mode, mode.mode_name) for mode in station.all(m.AvailableModes)] == [(393216, "Offboard")]
    assert station.command(512, 435.0, 27.0) == [2]


@pytest.mark.parametrize(
    ("command", "event"), [(519, m.ProtocolVersion), (520, m.AutopilotVersion), (410, m.HomePosition)]
)
def test_old_request_commands_give_their_message(station: Station, command: int, event: type) -> None:
    station.clear()
    assert station.command(command, 1.0) == [0]
    assert station.all(event)


def test_the_version_is_px4s(station: Station) -> None:
    station.command(512, 148.0)
    version = station.last(m.AutopilotVersion)
    assert (version.capabilities, version.flight_sw_version, version.uid) == (0xE8FF, 0x01120040, 5283920058631409231)
    station.command(512, 300.0)
    protocol = station.last(m.ProtocolVersion)
    assert (protocol.version, protocol.min_version, protocol.max_version) == (200, 100, 203)


def test_an_arm_command_with_2_gets_no_acknowledgement_but_words(station: Station) -> None:
    station.heartbeat_every_us = 1_000_000
    station.run(1.1)
    assert station.command(ARM, 2.0) == []
    assert station.texts()[-1] == "Unsupported ARM_DISARM param: 2.000"


# --- who hears what ---


def test_texts_go_only_to_links_that_hear_a_ground_station_but_events_to_all(station: Station) -> None:
    station.clear()
    station.command(MODE, 1.0, 99.0)
    assert station.texts(ONBOARD) == station.texts(GCS) == []
    assert station.all(m.Event, ONBOARD)
    assert station.all(m.Event, ONBOARD) == station.all(m.Event, GCS)
    station.send(m.Heartbeat(18, 8, 0, 0, 4))  # an onboard controller is no ground station
    station.command(MODE, 1.0, 99.0)
    assert station.texts(ONBOARD) == []
    station.send(m.Heartbeat(6, 8, 0, 0, 4), GCS)
    station.command(MODE, 1.0, 99.0)
    assert station.texts(GCS) == ["Unsupported main mode"]
    assert station.texts(ONBOARD) == []


def test_a_long_text_comes_in_chunks_of_50_that_end_in_a_tab(station: Station) -> None:
    station.send(m.Heartbeat(6, 8, 0, 0, 4))
    station.command(MODE, *POSITION_MODE)
    station.clear()
    assert station.command(ARM, 1.0) == [1]
    chunks = station.all(m.Statustext)
    assert [(chunk.text, chunk.chunk_seq) for chunk in chunks] == [
        ("Arming denied: Resolve system health failures firs", 0),
        ("t\t", 1),
    ]
    assert chunks[0].id == chunks[1].id
    assert chunks[0].severity == 2


def test_events_are_numbered_without_gaps_and_can_be_had_again(station: Station) -> None:
    station.command(ARM, 1.0)
    station.command(ARM, 0.0)
    station.run(3.1)
    numbers = [event.sequence for event in station.all(m.Event)]
    assert numbers == list(range(1, len(numbers) + 1))
    assert station.last(m.CurrentEventSequence).sequence == numbers[-1]
    again = station.all(m.Event)[2:4]
    station.clear()
    station.send(m.RequestEvent(1, 1, 3, 4))
    station.run(0.01)
    assert station.all(m.Event) == again
    station.send(m.RequestEvent(1, 1, 999, 65535))
    station.run(0.01)
    assert [error.sequence for error in station.all(m.ResponseEventError)] == [999]


# --- setpoints ---

RATE, ATTITUDE, NONE = "rate", "attitude", "no signal"


@pytest.mark.parametrize(
    ("mask", "meaning"),
    [
        (128, RATE), (132, RATE), (192, RATE), (196, RATE), (160, RATE), (7, ATTITUDE), (0, ATTITUDE), (71, ATTITUDE),
        (1, ATTITUDE), (32, ATTITUDE), (129, NONE), (130, NONE), (131, NONE), (135, NONE), (255, NONE), (193, NONE),
    ],
)  # fmt: skip
def test_a_type_mask_is_a_signal_and_controls_what_px4_says(station: Station, mask: int, meaning: str) -> None:
    station.stream = rates_setpoint(0.0, mask=mask)
    station.run(0.3)
    station.command(MODE, *OFFBOARD_MODE)
    assert station.command(ARM, 1.0) == ([1] if meaning is NONE else [0])
    if meaning is not NONE:
        station.run(1.1)
        assert station.last(m.Heartbeat).base_mode == (0x81 if meaning is RATE else 0x91)


@pytest.mark.parametrize(
    ("thrust", "mask", "pwm"),
    [
        (0.0, 128, 1000), (-0.3, 128, 1000), (1.5, 128, 2000), (0.4, 128, 1400), (0.4, 132, 1400), (0.4, 160, 1400),
        (0.4, 192, 1000), (0.4, 196, 1000), (math.nan, 128, 900), (math.inf, 128, 900), (1e30, 128, 2000),
    ],
)  # fmt: skip
def test_thrust_reaches_the_motors_as_on_px4(station: Station, thrust: float, mask: int, pwm: int) -> None:
    """On the ground, so that the rates stay 0 and the mixing adds next to nothing."""
    station.stream = rates_setpoint(0.0)
    station.run(0.3)
    station.command(MODE, *OFFBOARD_MODE)
    station.command(ARM, 1.0)
    station.stream = rates_setpoint(thrust, (0.0, 0.0, NAN), mask)
    station.run(0.12)
    station.command(512, 36.0)
    motors = station.last(m.ServoOutputRaw).pwm_us
    assert motors[:4] == pytest.approx((pwm,) * 4, abs=30)
    assert motors[4:] == (900,) * 12


def test_hover_thrust_is_weight_over_four_rotors(flying: Station) -> None:
    """m g / (4 T_max) of the vehicle file, 0.4903; PX4 itself hovered at 0.487 to 0.492."""
    flying.run(4.0)
    flying.clear()
    flying.run(2.0)
    pwm = [sum(message.pwm_us[:4]) / 4 for message in flying.all(m.ServoOutputRaw)]
    assert sum(pwm) / len(pwm) == pytest.approx(1000 + 490.3, abs=8)


def test_a_setpoint_received_before_a_tick_acts_in_it(station: Station) -> None:
    station.stream = rates_setpoint(0.0)
    station.run(0.3)
    station.command(MODE, *OFFBOARD_MODE)
    station.command(ARM, 1.0)
    assert max(station.vehicle.motor_command) < 0.05
    station.stream = rates_setpoint(0.4)
    station.tick()
    assert min(station.vehicle.motor_command) > 0.35


def test_setpoints_act_only_in_offboard(station: Station) -> None:
    station.command(ARM, 1.0)
    station.stream = rates_setpoint(0.9)
    station.run(1.0)
    assert station.state.mode.title == "Hold"
    assert max(station.vehicle.motor_command) < 0.2
    assert station.last(m.ExtendedSysState).landed_state == 1


@pytest.mark.parametrize("target", [(2, 1), (1, 2), (2, 2), (1, 191)])
def test_setpoints_for_somebody_else_are_no_signal(station: Station, target: tuple[int, int]) -> None:
    station.stream = rates_setpoint()._replace(target_system=target[0], target_component=target[1])
    station.run(0.3)
    station.command(MODE, *OFFBOARD_MODE)
    assert station.command(ARM, 1.0) == [1]


def test_throttle_ignored_in_hover_stops_the_motors_and_it_falls(flying: Station) -> None:
    """PX4: 0.6 s of mask 196 in hover, motors at 1000, falling at 3.7 m/s."""
    flying.vehicle.params.set("COM_DISARM_LAND", -1.0)
    flying.stream = rates_setpoint(0.49, mask=196)
    flying.run(0.4)
    flying.command(512, 36.0)
    assert flying.last(m.ServoOutputRaw).pwm_us[:4] == pytest.approx((1000,) * 4, abs=40)
    assert flying.vehicle.plant.truth().vel_ned_mps[2] == pytest.approx(3.7 * 0.4 / 0.6, rel=0.35)


def test_velocity_setpoints_fly_at_that_velocity(flying: Station) -> None:
    flying.stream = velocity_setpoint(1.0, -0.5, 0.0)
    flying.run(5.0)
    assert flying.vehicle.plant.truth().vel_ned_mps == pytest.approx((1.0, -0.5, 0.0), abs=0.15)


def test_body_frame_velocities_turn_with_the_heading(flying: Station) -> None:
    flying.stream = position_setpoint(0.0, 0.0, -2.5)._replace(yaw_rad=math.pi / 2)
    flying.run(6.0)
    flying.stream = velocity_setpoint(1.0, 0.0, 0.0)._replace(frame=8, yaw_rad=math.pi / 2)
    flying.run(8.0)
    assert flying.vehicle.plant.truth().vel_ned_mps == pytest.approx((0.0, 1.0, 0.0), abs=0.15)


def test_position_setpoints_are_reached(flying: Station) -> None:
    flying.stream = position_setpoint(2.0, -1.0, -3.0)
    flying.run(8.0)
    assert flying.vehicle.plant.truth().pos_ned_m == pytest.approx((2.0, -1.0, -3.0), abs=0.2)


@pytest.mark.parametrize(("frame", "height_m"), [(5, 489.4 + 3.0), (6, 3.0)])
def test_a_position_on_the_globe_is_reached(flying: Station, frame: int, height_m: float) -> None:
    """1e-5 degrees of latitude are 1.112 m."""
    zero = (0.0, 0.0, 0.0)
    home = flying.server.view.frame
    flying.stream = m.SetPositionTargetGlobalInt(
        0, 1, 1, frame, 0b101111111000, home.latitude_deg + 2e-5, home.longitude_deg, height_m, zero, zero, 0.0, 0.0
    )
    flying.run(8.0)
    assert flying.vehicle.plant.truth().pos_ned_m == pytest.approx((2.224, 0.0, -3.0), abs=0.2)


@pytest.mark.parametrize("frame", [0, 3, 5, 6, 7, 9, 255])
def test_position_setpoints_in_unsupported_frames_are_no_signal(station: Station, frame: int) -> None:
    station.stream = position_setpoint(0.0, 0.0, -1.0)._replace(frame=frame)
    station.run(0.3)
    station.command(MODE, *OFFBOARD_MODE)
    assert station.command(ARM, 1.0) == [1]


HOSTILE = (math.nan, math.inf, -math.inf, 1e38, -1e38)


@pytest.mark.parametrize("value", HOSTILE)
def test_hostile_setpoints_leave_the_state_finite(flying: Station, value: float) -> None:
    triple, quad = (value,) * 3, (value,) * 4
    for message in (
        m.SetAttitudeTarget(0, 1, 1, 128, quad, triple, value, triple),
        m.SetAttitudeTarget(0, 1, 1, 7, quad, triple, value, triple),
        m.SetAttitudeTarget(0, 1, 1, 0, (0.0,) * 4, triple, 0.5),
        m.SetPositionTargetLocalNed(0, 1, 1, 1, 0, triple, triple, triple, value, value),
        m.SetPositionTargetLocalNed(0, 1, 1, 8, 0, triple, triple, triple, value, value),
    ):
        flying.stream = message
        flying.run(0.2)
        plant = flying.vehicle.plant
        assert all(map(math.isfinite, (*plant.pos_ned_m, *plant.q_ned_frd, *flying.vehicle.motor_command)))


# --- flights ---


def test_a_takeoff_asked_for_while_disarmed_climbs_after_arming_and_holds() -> None:
    station = Station().boot()
    station.heartbeat_every_us = 1_000_000
    assert station.command(TAKEOFF) == [0]
    assert station.command(ARM, 1.0) == [0]
    station.run_until(lambda: station.last(m.ExtendedSysState).landed_state == 3, 5.0)
    station.run_until(lambda: station.last(m.Heartbeat).custom_mode == 0x03040000, 15.0)
    station.run(4.0)
    assert station.vehicle.plant.truth().pos_ned_m[2] == pytest.approx(-2.5, abs=0.25)
    assert station.last(m.ExtendedSysState).landed_state == 2
    assert "Using default takeoff altitude: 2.5 m" in station.texts()
    assert "Takeoff detected" in station.texts()


def test_a_takeoff_can_name_its_altitude() -> None:
    station = Station().boot()
    station.command(TAKEOFF, NAN, NAN, NAN, NAN, NAN, NAN, 489.4 + 5.0)
    station.command(ARM, 1.0)
    station.run(12.0)
    assert station.vehicle.plant.truth().pos_ned_m[2] == pytest.approx(-5.0, abs=0.25)


def test_a_landing_ends_disarmed_two_seconds_after_touch_down_with_offboard_still_chosen(flying: Station) -> None:
    flying.heartbeat_every_us = 1_000_000
    flying.run(1.1)
    assert flying.command(LAND) == [0]
    flying.stream = None
    flying.run(0.4)
    assert flying.last(m.ExtendedSysState).landed_state == 4
    flying.run_until(lambda: "Landing detected" in flying.texts(), 15.0)
    took_s = flying.run_until(lambda: not flying.state.armed, 5.0)
    assert took_s == pytest.approx(2.05, abs=0.07)
    assert flying.texts()[-3:] == ["Landing at current position", "Landing detected", "Disarmed by landing"]
    flying.run(1.1)
    assert flying.last(m.Heartbeat) == m.Heartbeat(2, 12, 0x01, 0x00060000, 0)
    assert flying.last(m.ServoOutputRaw).pwm_us == (900,) * 16


def test_return_near_home_lands_at_home(flying: Station) -> None:
    flying.heartbeat_every_us = 1_000_000
    flying.stream = position_setpoint(4.0, 2.0, -2.5)
    flying.run(6.0)
    assert flying.command(RETURN) == [0]
    flying.run_until(lambda: not flying.state.armed, 30.0)
    assert flying.vehicle.plant.truth().pos_ned_m[:2] == pytest.approx((0.0, 0.0), abs=0.5)
    texts = flying.texts()
    assert "Returning to launch" in texts
    assert "RTL: start return at 492 m (3 m above destination)" in texts
    assert "RTL: land at destination" in texts


def test_return_from_afar_climbs_before_it_crosses(flying: Station) -> None:
    flying.vehicle.params.set("RTL_RETURN_ALT", 8.0)
    flying.stream = position_setpoint(20.0, 0.0, -2.5)
    flying.run(14.0)
    flying.command(RETURN)
    highest = 0.0
    while flying.state.armed:
        flying.run(0.1)
        north, _, down = flying.vehicle.plant.truth().pos_ned_m
        highest = max(highest, -down)
        assert flying.server.t_us < 120e6
        if 5.0 < north < 15.0:
            assert -down > 6.5
    assert highest == pytest.approx(8.0, abs=1.0)
    assert flying.vehicle.plant.truth().pos_ned_m[:2] == pytest.approx((0.0, 0.0), abs=0.5)


def test_a_lost_stream_returns_after_1_0_to_1_1_s_with_critical_heartbeats_and_both_modes_told(flying: Station) -> None:
    flying.heartbeat_every_us = 1_000_000
    flying.run(1.1)
    flying.clear()
    flying.stream = None
    took_s = flying.run_until(lambda: flying.state.mode.title == "Return", 2.0)
    assert 1.0 <= took_s <= 1.104
    assert "Failsafe activated" in flying.texts()
    flying.run(2.1)
    assert flying.last(m.Heartbeat) == m.Heartbeat(2, 12, 0x9D, 0x05040000, 5)
    assert flying.last(m.CurrentMode) == m.CurrentMode(5, 0x05040000, 0x00060000)


@pytest.mark.parametrize(
    ("setting", "custom_mode"), [((5, 2), 0x03040000), ((4, 2), 0x06040000), ((0, 1), 0x03040000), ((3, 2), 0x05040000)]
)
def test_the_answer_to_a_lost_stream_follows_its_parameters(
    flying: Station, setting: tuple[int, int], custom_mode: int
) -> None:
    for name, value in zip(("COM_OBL_RC_ACT", "NAV_RCL_ACT"), setting, strict=True):
        flying.send(m.ParamSet(1, 1, name, m.param_bits(value, 6), 6))
    flying.stream = None
    flying.run(2.3)
    assert flying.last(m.Heartbeat) == m.Heartbeat(2, 12, 0x9D, custom_mode, 5)


def test_a_resumed_stream_takes_off_again_out_of_the_landed_failsafe(flying: Station) -> None:
    flying.stream = None
    flying.run(2.2)
    assert flying.last(m.Heartbeat).system_status == 5
    flying.run_until(lambda: flying.state.landed, 20.0)
    assert flying.state.armed
    flying.stream = position_setpoint(0.0, 0.0, -2.0)
    took_s = flying.run_until(lambda: flying.state.mode.title == "Offboard", 1.0)
    assert took_s <= 0.2
    flying.run(6.0)
    assert flying.vehicle.plant.truth().pos_ned_m[2] < -1.5


def test_disarming_in_the_air_is_refused_and_forced_disarming_drops_it(flying: Station) -> None:
    assert flying.command(ARM, 0.0) == [1]
    assert flying.command(ARM, 0.0, 21196.0) == [0]
    flying.run(1.1)
    assert flying.last(m.Heartbeat).base_mode == 0x01
    assert flying.vehicle.plant.truth().vel_ned_mps[2] > 3.0 or flying.vehicle.plant.on_ground


def test_armed_in_hold_it_stands_with_idle_motors_and_disarms_by_itself(station: Station) -> None:
    station.heartbeat_every_us = 1_000_000
    assert station.command(ARM, 1.0) == [0]
    station.run(2.0)
    assert station.last(m.ServoOutputRaw).pwm_us[:4] == pytest.approx((1000,) * 4, abs=5)
    assert station.last(m.Heartbeat) == m.Heartbeat(2, 12, 0x9D, 0x03040000, 4)
    took_s = 2.0 + station.run_until(lambda: not station.state.armed, 12.0)
    assert took_s == pytest.approx(11.05, abs=0.1)
    assert station.texts()[-1] == "Disarmed by auto preflight disarming"


# --- parameters, clocks, missions, files ---


def read(station: Station, name: str, index: int = -1) -> None:
    station.clear()
    station.send(m.ParamRequestRead(1, 1, name, index))
    station.run(0.01)


def test_an_integer_parameter_is_bit_cast_into_the_float(station: Station) -> None:
    read(station, "NAV_RCL_ACT")
    value = station.last(m.ParamValue)
    assert (value.param_id, value.param_type, value.bits) == ("NAV_RCL_ACT", 6, 2)
    read(station, "", value.param_index)
    assert station.last(m.ParamValue) == value
    read(station, "COM_OF_LOSS_T")
    assert (station.last(m.ParamValue).param_type, station.last(m.ParamValue).bits) == (9, 0x3F800000)


@pytest.mark.parametrize(("name", "index"), [("NO_SUCH_PARAM", -1), ("", 5000), ("", 32767), ("\xff\xfe", -1)])
def test_an_unknown_parameter_gets_an_error_and_no_value(station: Station, name: str, index: int) -> None:
    read(station, name, index)
    assert station.all(m.ParamValue) == []
    error = station.last(m.ParamError)
    assert (error.target_system, error.target_component, error.error) == (245, 190, 1)


def test_a_set_parameter_acts_and_is_told_on_every_link_once(station: Station) -> None:
    station.clear()
    station.send(m.ParamSet(1, 1, "COM_OF_LOSS_T", m.param_bits(0.5, 9), 9))
    station.run(0.01)
    for link in (ONBOARD, GCS):
        assert [value.value for value in station.all(m.ParamValue, link)] == [0.5]
    assert station.vehicle.params.get("COM_OF_LOSS_T") == 0.5


@pytest.mark.parametrize(
    ("name", "bits", "type_", "error"),
    [
        ("NO_SUCH", 0, 9, 1),
        ("NAV_DLL_ACT", 0, 9, 7),
        ("COM_OF_LOSS_T", 1, 6, 7),
        ("COM_OF_LOSS_T", 1, 77, 7),
        ("COM_OF_LOSS_T", 0x7FC00000, 9, 2),
        ("COM_OF_LOSS_T", 0x7F800000, 9, 2),
        ("NAV_DLL_ACT", 0x7FFFFFFF, 6, 2),
        ("NAV_DLL_ACT", 0xFFFFFFFF, 6, 2),
    ],
)
def test_a_bad_parameter_value_gets_an_error_and_changes_nothing(
    station: Station, name: str, bits: int, type_: int, error: int
) -> None:
    version = station.vehicle.params.version
    station.clear()
    station.send(m.ParamSet(1, 1, name, bits, type_))
    station.run(0.01)
    assert [message.error for message in station.all(m.ParamError)] == [error]
    assert station.all(m.ParamValue) == station.all(m.ParamValue, GCS) == []
    assert station.vehicle.params.version == version


def test_the_parameter_list_begins_with_the_hash_and_is_whole(station: Station) -> None:
    station.clear()
    station.send(m.ParamRequestList(1, 1))
    station.run(1.0)
    items = station.all(m.ParamValue)
    assert (items[0].param_id, items[0].param_type, items[0].param_index) == ("_HASH_CHECK", 5, 65535)
    assert [item.param_index for item in items[1:]] == list(range(len(station.vehicle.params)))
    assert all(item.param_count == len(items) - 1 for item in items)
    names = [item.param_id for item in items[1:]]
    assert names == sorted(names)
    before = items[0].bits
    read(station, "_HASH_CHECK")
    assert station.last(m.ParamValue).bits == before
    station.send(m.ParamSet(1, 1, "COM_OF_LOSS_T", m.param_bits(2.0, 9), 9))
    read(station, "_HASH_CHECK")
    assert station.last(m.ParamValue).bits != before


def test_a_timesync_question_is_answered_with_boot_time(station: Station) -> None:
    station.clear()
    station.send(m.Timesync(0, 123456789))
    now_ns = station.server.t_us * 1000
    station.run(0.01)
    answers = [message for message in station.all(m.Timesync) if message.tc1_ns]
    assert answers == [m.Timesync(now_ns, 123456789, 245, 190)]
    station.clear()
    station.send(m.Timesync(5, 6))  # an answer: no business of ours
    station.run(0.01)
    assert [message for message in station.all(m.Timesync) if message.tc1_ns] == []


def test_a_ping_to_all_comes_back_to_its_sender(station: Station) -> None:
    station.clear()
    station.send(m.Ping(77, 5, 0, 0))
    station.send(m.Ping(78, 6, 1, 1))
    station.run(0.01)
    assert [ping for ping in station.all(m.Ping) if ping.target_system] == [m.Ping(77, 5, 245, 190)]


def test_missions_are_empty(station: Station) -> None:
    station.clear()
    for kind in (0, 1, 2):
        station.send(m.MissionRequestList(1, 1, kind))
    station.send(m.MissionClearAll(1, 1, 0))
    station.send(m.MissionRequestInt(1, 1, 0, 0))
    station.run(0.01)
    assert station.all(m.MissionCount) == [m.MissionCount(245, 190, 0, kind) for kind in (0, 1, 2)]
    assert [ack.type for ack in station.all(m.MissionAck)] == [0, 1]


def test_a_file_request_is_refused_at_once(station: Station) -> None:
    station.clear()
    payload = bytes([7, 0, 3, 4, 5, 0, 0, 0, 0, 0, 0, 0]) + b"/etc\0"  # open "/etc" for reading, sequence 7, session 3
    station.send(m.FileTransferProtocol(0, 1, 1, payload.ljust(251, b"\0")))
    station.run(0.01)
    answer = station.last(m.FileTransferProtocol).payload
    assert (answer[0], answer[2], answer[3], answer[4], answer[5], answer[12]) == (8, 3, 129, 1, 4, 10)


# --- robustness and determinism ---


def test_every_message_of_the_table_with_zeros_and_with_ones_is_survived(station: Station) -> None:
    link = station.links[ONBOARD]
    for row in m.MESSAGES:
        for fill in (b"\0", b"\1", b"\x7f", b"\xff"):
            event = row.decode(fill * row.size, 0)
            if event is not None:
                link.send(event)
    for data in link.datagrams_to_send():
        station.server.receive(ONBOARD, data)
        station.server.receive(GCS, data)
    station.run(0.2)
    assert math.isfinite(station.vehicle.plant.truth().pos_ned_m[2])


@pytest.mark.parametrize("value", HOSTILE)
@pytest.mark.parametrize("command", [176, 400, 22, 21, 20, 246, 510, 511, 512, 410, 519, 520])
def test_commands_with_hostile_parameters_are_survived(station: Station, command: int, value: float) -> None:
    station.command(command, *(value,) * 7)
    station.send(m.CommandInt(1, 1, 5, command, 0, 0, (value, value, value, value, 2**31 - 1, -(2**31), value)))
    station.run(0.05)
    assert not station.state.armed


def test_the_same_inputs_give_the_same_bytes() -> None:
    def flight() -> bytes:
        station = airborne()
        out = bytearray()
        for _ in range(250):
            station.send(station.stream)
            station.server.advance(4)
            out += b"".join(station.server.datagrams(ONBOARD) + station.server.datagrams(GCS))
        return bytes(out)

    assert flight() == flight()


def test_a_longer_step_gives_the_same_vehicle_time_and_slower_streams() -> None:
    station = Station()
    for _ in range(100):
        station.server.advance(20)
        station.collect()
    assert station.server.t_us == 2_000_000
    assert len(station.all(m.Attitude)) == 100
    assert len(station.all(m.LocalPositionNed)) == pytest.approx(50, abs=11)
