"""Every way out of a flight: pilot, bug, kill, restart, a second companion, a link that goes and comes back."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator

import pytest
from companions import MODEL, Flying, build, flying
from fake_px4 import HOLD, LAND, OFFBOARD, POSITION, RTL, STEP_US, FakePx4, exchange

from flightstack.cli.offboard import last_words
from flightstack.types import InputError
from mavlink_bridge import messages as m
from mavlink_bridge.faults import FAULTS
from mavlink_bridge.handshake import State
from mavlink_bridge.link import Link
from mavlink_bridge.transport.address import open_address


class _Wire:
    """A transport straight into the vehicle's link."""

    def __init__(self, vehicle: FakePx4) -> None:
        self._vehicle = vehicle

    def send(self, data: bytes) -> bool:
        self._vehicle.link.receive_datagram(data, 0)
        return True

    def receive(self) -> bytes | None:
        return None

    def receive_all(self) -> list[bytes]:
        return []

    def wait(self, timeout_s: float) -> bool:
        return False

    def close(self) -> None:
        pass


@pytest.mark.parametrize("error", [RuntimeError("a bug"), KeyboardInterrupt(), MemoryError(), SystemExit(3)])
def test_an_exception_in_flight_says_safe_last_words_and_asks_for_hold(error: BaseException) -> None:
    companion, notes, vehicle, now = flying()
    with pytest.raises(type(error)), last_words(companion, _Wire(vehicle)):
        raise error
    vehicle.step(now)
    word = vehicle.setpoints[-1]
    assert (word.type_mask, word.rate_frd_radps) == (7, (0.0, 0.0, 0.0))
    assert word.q_ned_frd == pytest.approx((1.0, 0.0, 0.0, 0.0), abs=1e-3)
    assert word.thrust_norm == pytest.approx(MODEL.hover_norm, rel=0.1)
    assert vehicle.mode == HOLD
    assert any("last words" in text for text in notes.texts("fault"))


@pytest.mark.parametrize("armed", [False, True])
def test_an_exception_before_the_flight_touches_nothing(armed: bool) -> None:
    companion, _ = build(arm=False)
    vehicle = FakePx4(armed=armed, mode=POSITION, landed=2 if armed else 1)
    now = exchange(companion, vehicle, 5.0)
    assert companion.state is State.STREAMING
    vehicle.step(now)  # what was on its way
    sent = len(vehicle.setpoints), len(vehicle.commands)
    with pytest.raises(RuntimeError), last_words(companion, _Wire(vehicle)):
        raise RuntimeError("a bug")
    vehicle.step(now)
    assert (len(vehicle.setpoints), len(vehicle.commands)) == sent


def _silent_after(flight: Flying, change: Callable[[FakePx4], None]) -> float:
    """Seconds from a change at the vehicle to the last setpoint that reaches it."""
    companion, _, vehicle, now = flight
    change(vehicle)
    last, start = now, now
    for _ in range(500):
        count = len(vehicle.setpoints)
        now = exchange(companion, vehicle, STEP_US * 1e-6, start_us=now)
        last = now if len(vehicle.setpoints) > count else last
    return (last - start) * 1e-6


@pytest.mark.parametrize("mode", [POSITION, HOLD, RTL, LAND])
def test_a_pilots_mode_ends_the_flight_at_once_and_for_good(mode: int) -> None:
    flight = flying()
    companion, notes, vehicle, _ = flight
    after_s = _silent_after(flight, lambda vehicle: setattr(vehicle, "mode", mode))
    assert after_s <= (FAULTS["pilot-mode"].after_s or 0.0) + 2e-3 * 4
    assert companion.state is State.PILOT
    assert "not by this companion: hands off" in companion.reason
    assert any("pilot" in text for text in notes.texts("state"))
    said = len(vehicle.commands)
    vehicle.mode = OFFBOARD  # even if the pilot chooses OFFBOARD again: no re-entry without a new run
    assert _silent_after(flight, lambda vehicle: None) == 0.0
    assert len(vehicle.commands) == said


@pytest.mark.parametrize("landing", [False, True])
def test_stopped_motors_end_the_flight_and_nothing_more_is_sent(landing: bool) -> None:
    """The kill switch, or PX4's own fence that terminates: as on a real PX4 it stays armed and in the mode of before,
    and the switch, released, would give the motors back to whatever is sent."""
    flight = flying()
    companion, _, vehicle, now = flight
    vehicle.landed = 2
    if landing:
        companion.stop("enough")
        flight = flight._replace(now_us=exchange(companion, vehicle, 2.0, start_us=now))
        assert companion.state is State.LANDING
    after_s = _silent_after(flight, lambda vehicle: setattr(vehicle, "status", 8))
    assert after_s <= (FAULTS["pilot-kill"].after_s or 0.0) + 0.01
    assert companion.state is State.PILOT
    assert "motors are stopped" in companion.reason
    said = len(vehicle.commands)
    assert _silent_after(flight, lambda vehicle: setattr(vehicle, "status", 4)) == 0.0
    assert len(vehicle.commands) == said


def test_a_vehicle_that_is_disarmed_ends_the_flight_and_nothing_arms_again() -> None:
    flight = flying()
    vehicle = flight.vehicle
    armings = len(vehicle.set_modes(400))
    after_s = _silent_after(flight, lambda vehicle: setattr(vehicle, "armed", False))
    assert after_s <= (FAULTS["pilot-disarm"].after_s or 0.0) + 0.01
    assert flight.companion.state is State.PILOT
    assert len(vehicle.set_modes(400)) == armings


@pytest.mark.parametrize(
    ("mode", "intended", "tells", "arm"),
    [
        (RTL, OFFBOARD, True, False),  # PX4's failsafe: setpoints would bring OFFBOARD back, even after landing
        (LAND, OFFBOARD, True, False),
        (OFFBOARD, OFFBOARD, True, False),
        (OFFBOARD, OFFBOARD, True, True),
        (HOLD, HOLD, True, True),  # --arm on a vehicle that somebody flies
        (RTL, OFFBOARD, False, False),  # what it would go back to is not known
    ],
)
def test_a_restarted_companion_does_not_touch_a_vehicle_that_still_flies(
    mode: int, intended: int, tells: bool, arm: bool
) -> None:
    companion, _ = build(arm=arm)
    vehicle = FakePx4(armed=True, mode=mode, landed=2, intended=intended, tells_mode=tells)
    exchange(companion, vehicle, 60.0)
    assert companion.state is State.REFUSED
    assert "armed" in companion.reason
    assert not vehicle.setpoints
    assert not vehicle.set_modes(176)
    assert not vehicle.set_modes(400)


@pytest.mark.parametrize("waited", [10, 100, 200])
@pytest.mark.parametrize("tells_armed", [True, False])
def test_a_companion_that_slept_through_the_take_off_does_not_call_the_vehicle_back(
    tells_armed: bool, waited: int
) -> None:
    """It was stopped while it waited, the pilot took off in OFFBOARD, and PX4, hearing nothing, returns: a real one
    went back to OFFBOARD on the first setpoint.  What has piled up is read in pieces, HEARTBEAT comes once a second:
    whether one is the last of a piece, armed and in OFFBOARD, hangs on how many setpoints were `waited` for."""
    companion, _ = build(arm=False)
    vehicle = FakePx4(mode=POSITION)
    now = exchange(companion, vehicle, 10.0, until=lambda: len(vehicle.setpoints) > waited)
    vehicle.heartbeats = vehicle.answers_heartbeat = tells_armed
    said = []
    for mode in [POSITION] * 250 + [OFFBOARD] * 250 + [RTL] * 250:
        now += STEP_US
        vehicle.armed, vehicle.landed, vehicle.mode = mode != POSITION, 2, mode
        vehicle.intended = POSITION if mode == POSITION else OFFBOARD
        vehicle.step(now)
        said += vehicle.link.datagrams_to_send()
    sent = len(vehicle.setpoints)
    while said:
        now += STEP_US
        for data in said[:300]:
            companion.receive_datagram(data, now)
        said = said[300:]
        companion.step(now)
        assert m.id_of(m.SetAttitudeTarget) not in [data[7] for data in companion.link.datagrams_to_send()]
    exchange(companion, vehicle, 3.0, start_us=now)
    assert len(vehicle.setpoints) == sent
    assert not vehicle.set_modes(176)
    assert (companion.state is State.PILOT) is tells_armed
    assert ("would bring it back" in companion.reason) is tells_armed


def test_a_heartbeat_between_two_reports_of_the_intention_does_not_bring_a_vehicle_back_either() -> None:
    """Heartbeats are off, so one is asked for; it tells the mode alone, and the intention comes with CURRENT_MODE."""
    companion, _ = build(arm=False)
    vehicle = FakePx4(mode=POSITION)
    now = exchange(companion, vehicle, 10.0, until=lambda: len(vehicle.setpoints) > 10)
    vehicle.heartbeats = False
    vehicle.mode, vehicle.intended, vehicle.landed, vehicle.armed = RTL, OFFBOARD, 2, True
    now = exchange(companion, vehicle, 0.2, start_us=now)
    sent = len(vehicle.setpoints)
    exchange(companion, vehicle, 5.0, start_us=now)
    assert len(vehicle.setpoints) == sent
    assert companion.state is State.PILOT


def test_a_restarted_companion_on_a_landed_vehicle_waits_for_the_pilot() -> None:
    """OFFBOARD was left selected: the stream may flow, but nothing arms, and on the ground it says nothing but zero."""
    companion, _ = build(arm=False)
    vehicle = FakePx4(mode=OFFBOARD)
    exchange(companion, vehicle, 20.0)
    assert companion.state is State.STREAMING
    assert not vehicle.set_modes(400)
    assert {(point.thrust_norm, point.rate_frd_radps) for point in vehicle.setpoints} == {(0.0, (0.0, 0.0, 0.0))}


@pytest.fixture
def line() -> Iterator[str]:
    """The far end of a pseudo-terminal."""
    near, far = os.openpty()
    yield os.ttyname(far)
    os.close(near)
    os.close(far)


@pytest.mark.parametrize("kind", ["udpin", "serial"])
def test_a_second_companion_on_the_same_port_is_refused(kind: str, line: str) -> None:
    if kind == "serial":
        pytest.importorskip("serial")
    address = f"serial:{line}:921600" if kind == "serial" else _free_address()
    first = open_address(address)
    with pytest.raises(InputError) as caught:
        open_address(address)
    assert "\n" not in str(caught.value)
    first.close()
    open_address(address).close()


def _free_address() -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return f"udpin:127.0.0.1:{free.getsockname()[1]}"


SETPOINT = m.SetAttitudeTarget(0, 1, 1, 128, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5)


@pytest.mark.parametrize(
    ("system", "component", "message"),
    [(240, 191, m.Heartbeat(18, 8, 0, 0, 4)), (245, 190, SETPOINT), (240, 191, SETPOINT)],
)
def test_another_companion_on_the_link_is_refused(system: int, component: int, message: object) -> None:
    companion, _ = build()
    vehicle, other = FakePx4(), Link(system, component)

    def also(now_us: int) -> None:
        other.send(message)
        for data in other.datagrams_to_send():
            companion.receive_datagram(data, now_us)

    exchange(companion, vehicle, 10.0, each=also)
    assert companion.state is State.REFUSED
    assert "stop it first" in companion.reason
    assert not vehicle.setpoints
    assert not vehicle.set_modes(400)


def _apart(flight: Flying, seconds: float, start_us: int) -> tuple[int, list[tuple[float, object]]]:
    """Both live, nothing arrives; the time at the end and what the companion said, with seconds since the start."""
    companion, vehicle = flight.companion, flight.vehicle
    ear, said, now = Link(9, 9), [], start_us
    for _ in range(round(seconds * 1e6 / STEP_US)):
        now += STEP_US
        vehicle.step(now)
        vehicle.link.datagrams_to_send()
        companion.step(now)
        for data in companion.link.datagrams_to_send():
            ear.receive_datagram(data, now)
            received = ear.next_event()
            assert received is not None
            said.append(((now - start_us) * 1e-6, received.message))
    return now, said


def test_a_lost_link_falls_silent_before_it_may_come_back() -> None:
    """Land is asked for while OFFBOARD was seen of late, never later: a pilot may have taken over meanwhile."""
    flight = flying()
    _, said = _apart(flight, 5.0, flight.now_us)
    setpoints = [(t_s, message) for t_s, message in said if isinstance(message, m.SetAttitudeTarget)]
    commands = [(t_s, message) for t_s, message in said if isinstance(message, m.CommandLong)]
    modes = [(t_s, message) for t_s, message in commands if message.command == 176]
    assert modes[0][0] == pytest.approx((FAULTS["link-lost"].after_s or 0.0) + STEP_US * 1e-6, abs=0.006)
    assert modes[0][1].params[:3] == (1.0, 4.0, 6.0)
    assert modes[-1][0] < 1.6
    assert 1.4 < setpoints[-1][0] < 1.6
    word = setpoints[-1][1]
    assert word.rate_frd_radps == (0.0, 0.0, 0.0)
    assert word.thrust_norm == pytest.approx(MODEL.hover_norm, rel=0.1)
    assert flight.companion.state is State.LOST


@pytest.mark.parametrize(("seconds", "final"), [(1.3, State.PILOT), (2.5, State.PILOT), (5.0, State.LOST)])
@pytest.mark.parametrize("mode", [RTL, POSITION])
def test_a_link_that_comes_back_finds_a_companion_that_keeps_its_hands_off(
    mode: int, seconds: float, final: State
) -> None:
    """PX4's failsafe, or a pilot on another link, has taken over meanwhile; setpoints would bring OFFBOARD back."""
    flight = flying()
    companion, _, vehicle, now = flight
    now, _ = _apart(flight, seconds, now)
    vehicle.mode, vehicle.intended = mode, OFFBOARD if mode == RTL else mode
    sent = len(vehicle.setpoints)
    exchange(companion, vehicle, 5.0, start_us=now)
    assert companion.state is final
    assert (
        len(vehicle.setpoints) - sent <= 30
    )  # those of the 0.1 s until the mode is heard of, none where it was silent
    assert seconds < 1.6 or len(vehicle.setpoints) == sent
    assert vehicle.mode == mode
