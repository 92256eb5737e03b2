"""The vehicle's parameters: read, judged and acted on; the oracle is PX4's own formulae and its recorded parameters."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from companions import MODEL, Notes, build, flying
from fake_px4 import PARAMS, FakePx4, exchange
from shipped import load_vehicle
from tlog import recording

from flightstack.barrier.estimate_bounds import BENCH
from flightstack.barrier.premise_watch import watched
from flightstack.barrier.premises import Premises
from flightstack.cli.vehicle_gains import counted_on
from flightstack.types import Command
from mavlink_bridge import messages as m
from mavlink_bridge.companion import Companion
from mavlink_bridge.handshake import State
from mavlink_bridge.link import Link
from mavlink_bridge.vehicle_params import NEEDED, Outputs, ParamReader, unsafe
from mavlink_bridge.voice import Voice


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("COM_OF_LOSS_T", 0.0, "COM_OF_LOSS_T is 0 s"), ("COM_OF_LOSS_T", 5.0, "COM_OF_LOSS_T is 5 s"),
        ("COM_OF_LOSS_T", 60.0, "set it to 0.1 to 2 s"), ("COM_OBL_RC_ACT", 6.0, "terminate"),
        ("COM_OBL_RC_ACT", 7.0, "disarm"), ("MC_ROLLRATE_MAX", 0.0, "no control"),
        ("MC_YAWRATE_MAX", -5.0, "no control"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("arm", [True, False])
def test_unsafe_parameters_are_refused_with_the_reason(name: str, value: float, said: str, arm: bool) -> None:
    companion, _ = build(arm=arm)
    vehicle = FakePx4(params={**PARAMS, name: value})
    exchange(companion, vehicle, 20.0)
    assert companion.state is State.REFUSED
    assert said in companion.reason
    assert "\n" not in companion.reason
    assert not vehicle.setpoints
    assert not vehicle.set_modes(400)


@pytest.mark.parametrize("name", NEEDED)
def test_a_needed_parameter_that_is_not_told_is_named(name: str) -> None:
    companion, _ = build()
    vehicle = FakePx4(params={key: value for key, value in PARAMS.items() if key != name})
    exchange(companion, vehicle, 60.0)
    assert companion.state is State.REFUSED
    assert name in companion.reason
    assert not vehicle.setpoints


def test_an_older_px4_that_is_silent_about_what_it_lacks_is_flown() -> None:
    companion, _ = build()
    vehicle = FakePx4(params={name: PARAMS[name] for name in NEEDED})
    vehicle.lacks_param_error = True
    exchange(companion, vehicle, 20.0, until=lambda: companion.state is State.OFFBOARD)
    assert companion.state is State.OFFBOARD


def test_parameters_that_get_lost_are_asked_for_again() -> None:
    reader, link, asked = ParamReader(), Link(240, 191), 0
    for step in range(20):
        reader.ask(link, 1, step * 300_000)
        asked += len(link.datagrams_to_send())
        if step == 5:
            for name in PARAMS:
                reader.take(m.ParamValue(name, m.param_bits(PARAMS[name], m.PARAM_REAL32), m.PARAM_REAL32, 1, 1))
    assert not reader.missing
    assert reader.settled
    assert asked > 3 * len(NEEDED)


def test_px4s_own_parameters_are_read_and_found_safe(recorded: Path) -> None:
    """Integers come bit-cast; the simulated PX4 has no PWM limits, so its outputs are 1000 to 2000."""
    reader = ParamReader()
    for heard in recording(recorded / "px4_sih_offboard.tlog"):
        if heard.system == 1:
            reader.take(heard.message)
    assert reader.values["COM_OF_LOSS_T"] == 1.0
    assert reader.values["COM_OBL_RC_ACT"] == 0.0
    assert reader.values["PWM_MAIN_FUNC4"] == 104.0
    assert reader.rate_max_radps == pytest.approx([math.radians(v) for v in (220.0, 220.0, 200.0)])
    assert reader.outputs == Outputs()
    assert unsafe(reader.values) == ""


def test_outputs_are_scaled_by_the_vehicles_own_limits_and_found_where_they_are() -> None:
    """Motors 1 to 4 on outputs 5, 6, 8, 7 with pulses of 1100 to 1900, motor 4 of 1000 to 1800."""
    reader = ParamReader()
    given = {f"PWM_MAIN_FUNC{k}": float(f) for k, f in zip((1, 5, 6, 8, 7), (0, 101, 102, 103, 104), strict=True)}
    given |= {f"PWM_MAIN_MIN{k}": 1100.0 for k in (5, 6, 8)} | {f"PWM_MAIN_MAX{k}": 1900.0 for k in (5, 6, 8)}
    given |= {"PWM_MAIN_MIN7": 1000.0, "PWM_MAIN_MAX7": 1800.0}
    reader.ask(Link(240, 191), 1, 0)
    for name, value in given.items():
        reader.take(m.ParamValue(name, m.param_bits(value, m.PARAM_INT32), m.PARAM_INT32, 1, 1))
        reader.ask(Link(240, 191), 1, 0)
    pwm = (0, 0, 0, 0, 1100, 1500, 1400, 1900, *(0,) * 8)
    assert reader.outputs_now.commands(pwm) == pytest.approx((0.0, 0.5, 1.0, 0.5))
    assert reader.outputs_now.commands((900,) * 16) == (0.0,) * 4


def test_a_vehicle_with_its_own_pulses_is_measured_by_them() -> None:
    companion, _, vehicle, now = flying()
    view = companion.view
    view.params.values |= {
        f"PWM_MAIN_{end}{k}": v for k in range(1, 5) for end, v in (("MIN", 1100.0), ("MAX", 1900.0))
    }
    view.params.outputs_now = view.params.outputs
    vehicle.link.send(m.ServoOutputRaw(now, 0, (1300, 1500, 1700, 1900, *(900,) * 12)))
    exchange(companion, vehicle, 0.02, start_us=now)
    measured = companion._measurement
    assert measured is not None
    assert measured.motor_command == pytest.approx([0.25, 0.5, 0.75, 1.0])


@pytest.mark.parametrize(
    ("told", "factor"), [(0.0, 0.0), (0.3, 0.3), (0.7, 0.7), (1.0, 1.0), (7.0, 1.0), (-0.5, 0.0), (math.nan, 0.0)]
)
def test_what_px4_undoes_before_the_motors_is_applied_to_what_is_sent(told: float, factor: float) -> None:
    """PX4: u = (-(1 - f) + sqrt((1 - f)^2 + 4 f c)) / 2 f of the command c; the motors get the u that was wanted.

    THR_MDL_FAC lies in 0..1; what is told beyond that counts as the nearer end.
    """
    link, ear = Link(240, 191), Link(1, 1)
    voice = Voice(link)
    voice.system, voice.thrust_model_factor = 1, told
    for wanted in (0.0, 0.2, 0.5, 0.9, 1.0):
        voice.fly(Command(0, 1.0, wanted, np.zeros(3)))
        ear.receive_datagram(link.datagrams_to_send()[0], 0)
        received = ear.next_event()
        assert received is not None
        c = received.message.thrust_norm
        u = c if factor == 0.0 else (factor - 1.0 + math.sqrt((1.0 - factor) ** 2 + 4.0 * factor * c)) / (2.0 * factor)
        assert u == pytest.approx(wanted, abs=1e-6)


def test_no_rate_beyond_the_owners_limits_is_sent() -> None:
    link, ear = Link(240, 191), Link(1, 1)
    voice = Voice(link)
    voice.system, voice.rate_max_radps = 1, (3.0, 2.0, 1.0)
    voice.fly(Command(0, 1.0, 0.5, np.array([5.0, -5.0, 0.5])))
    ear.receive_datagram(link.datagrams_to_send()[0], 0)
    received = ear.next_event()
    assert received is not None
    assert received.message.rate_frd_radps == (3.0, -2.0, 0.5)


def test_what_was_read_is_told_once_before_the_flight() -> None:
    companion, notes = build(dry_run=True)
    exchange(companion, FakePx4(params={**PARAMS, "MC_BAT_SCALE_EN": 1.0}), 20.0)
    assert companion.done
    told = notes.texts("parameters")
    assert len(told) == 1
    assert "MPC_THR_HOVER 0.50" in told[0]
    assert f"{MODEL.hover_norm:.2f}" in told[0]
    assert "MC_BAT_SCALE_EN is on" in told[0]


def _waiting() -> tuple[Companion, Notes, FakePx4, int]:
    """A companion that streams and leaves arming to the pilot."""
    companion, notes = build(arm=False)
    vehicle = FakePx4()
    now = exchange(companion, vehicle, 10.0)
    assert companion.state is State.STREAMING
    return companion, notes, vehicle, now


def _tell(vehicle: FakePx4, name: str, value: float) -> None:
    """A ground station set it on a link of its own, and PX4 tells all."""
    vehicle.params[name] = value
    vehicle.link.send(m.ParamValue(name, m.param_bits(value, m.PARAM_REAL32), m.PARAM_REAL32, 875, 1))


def test_parameters_that_are_changed_while_it_waits_are_judged_again() -> None:
    companion, notes, vehicle, now = _waiting()
    _tell(vehicle, "COM_OF_LOSS_T", 0.4)
    now = exchange(companion, vehicle, 0.1, start_us=now)
    assert companion.state is State.STREAMING
    _tell(vehicle, "COM_OF_LOSS_T", 5.0)
    exchange(companion, vehicle, 0.1, start_us=now)
    assert companion.state is State.REFUSED
    assert companion.reason.startswith("COM_OF_LOSS_T is 5 s")
    assert "COM_OF_LOSS_T is 5 now, was 0.4: set by someone else" in notes.texts("parameters")


def test_a_thrust_curve_that_is_changed_in_flight_is_followed_at_once() -> None:
    companion, notes, vehicle, now = flying()
    _tell(vehicle, "THR_MDL_FAC", 0.5)
    exchange(companion, vehicle, 0.1, start_us=now)
    wanted = notes.ticks[-1].command.thrust_norm
    assert 0.2 < wanted < 0.8
    assert vehicle.setpoints[-1].thrust_norm == pytest.approx(0.5 * wanted**2 + 0.5 * wanted, abs=1e-3)
    assert companion.state is State.OFFBOARD
    assert notes.texts("parameters")[-1] == "THR_MDL_FAC is 0.5 now, was 0: set by someone else"


def test_a_vehicle_that_is_started_anew_while_it_waits_is_refused() -> None:
    companion, _, vehicle, now = _waiting()

    def younger(message: Any) -> Any:
        stamp = "t_us" if isinstance(message, m.HighresImu) else "t_boot_us"
        return message._replace(**{stamp: getattr(message, stamp) - 8_000_000})

    vehicle.alter = younger
    exchange(companion, vehicle, 0.1, start_us=now)
    assert companion.state is State.REFUSED
    assert "it started anew" in companion.reason


@pytest.mark.parametrize(("action", "kinds"), [(0.0, {18, 6}), (2.0, {18})])
def test_where_px4_is_to_notice_a_lost_ground_station_it_does_not_pose_as_one(action: float, kinds: set[int]) -> None:
    """MAV_TYPE 6 is a ground station, 18 an onboard controller: PX4 counts the former on every link."""
    link, ear = Link(240, 191), Link(1, 1)
    voice, params = Voice(link), ParamReader()
    voice.system = 1
    params.take(m.ParamValue("NAV_DLL_ACT", m.param_bits(action, m.PARAM_REAL32), m.PARAM_REAL32, 875, 1))
    voice.heed(params)
    voice.keep_in_touch(0, heartbeat_missing=False)
    for data in link.datagrams_to_send():
        ear.receive_datagram(data, 0)
    assert {received.message.type for received in ear.take_events() if type(received.message) is m.Heartbeat} == kinds


@pytest.mark.parametrize("speaks_first", [False, True])
def test_before_the_vehicle_is_known_only_who_calls_speaks_and_once_a_second(speaks_first: bool) -> None:
    """`udpout`: a vehicle that answers only who has spoken would never be heard."""
    link = Link(240, 191)
    voice = Voice(link, speaks_first=speaks_first)
    for now_us in range(0, 2_000_000, 4_000):
        voice.keep_in_touch(now_us, heartbeat_missing=True)
    assert len(link.datagrams_to_send()) == (2 if speaks_first else 0)


@pytest.mark.parametrize(("told", "ends"), [(0.1, True), (0.15, False)], ids=["another", "the same"])
def test_a_rate_gain_that_is_changed_in_flight_ends_the_certificate(told: float, ends: bool) -> None:
    companion, notes, vehicle, now = flying()
    counted = counted_on(load_vehicle("quad-x"))
    companion._now.config = replace(companion._now.config, counted=counted)
    assert companion._stack_state is not None
    in_force = watched(1, Premises(
        "mocap", "", BENCH, ((-9.0, 9.0),) * 3, ((-0.9, 0.9),) * 2, (0.0, 99.0), (0.1, 9.0), (0.1, 9.0), (0.0, 1.0),
        1.0, 1.0, 1.0, (0.0, 99.0),
    ))  # fmt: skip
    companion._stack_state = companion._stack_state._replace(watch=in_force)
    _tell(vehicle, "MC_ROLLRATE_P", told)
    exchange(companion, vehicle, 3.0, start_us=now)
    told_so = [text for text in notes.texts("parameters") if "MC_ROLLRATE_P" in text]
    assert told_so == (["MC_ROLLRATE_P is 0.1 now, certificates count on 0.15: none holds any more"] if ends else [])
    assert notes.texts("filter") == (["filter: premise broken: rate gains: braking, to rest"] if ends else [])
    assert (companion.state is State.OFFBOARD) != ends
    assert companion.reason == ("premise of the certificate broken: rate gains; braked, then landed" if ends else "")
