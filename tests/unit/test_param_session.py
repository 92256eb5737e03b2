"""Parameters read and set over MAVLink; the other end answers as a PX4 does (integers bit-cast, PARAM_ERROR)."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import pytest

from flightstack.types import InputError
from mavlink_bridge import messages as m
from mavlink_bridge.link import Link
from mavlink_bridge.param_file import parse_params
from mavlink_bridge.param_session import ParamSession

STEP_US = 20_000


@dataclass
class Vehicle:
    """Has two parameters; hears only every `hears`-th datagram."""

    armed: bool = False
    hears: int = 1
    takes: bool = True
    values: dict[str, tuple[float, int]] = field(
        default_factory=lambda: {"EKF2_GYR_NOISE": (float(struct.unpack("<f", struct.pack("<f", 0.015))[0]), 9),
                                 "COM_RC_IN_MODE": (1.0, 6)}
    )  # fmt: skip
    sets: int = 0

    def __post_init__(self) -> None:
        self.link = Link(3, 1)
        self._heard = 0

    def hear(self, data: bytes, now_us: int) -> None:
        self._heard += 1
        if self._heard % self.hears:
            return
        self.link.receive_datagram(data, now_us)
        while (received := self.link.next_event()) is not None:
            message = received.message
            if isinstance(message, m.CommandLong):
                self.link.send(m.AutopilotVersion(0, 0, uid=77))
            elif isinstance(message, m.ParamRequestRead | m.ParamSet):
                self._answer(message)

    def _answer(self, message: m.ParamRequestRead | m.ParamSet) -> None:
        name = message.param_id
        if name not in self.values:
            self.link.send(m.ParamError(240, 191, name, -1, 1))
            return
        value, kind = self.values[name]
        if isinstance(message, m.ParamSet):
            assert message.param_type == kind
            self.sets += 1
            value = float(message.value) if self.takes else value
            self.values[name] = value, kind
        self.link.send(m.ParamValue(name, m.param_bits(value, kind), kind, 2, 0))


def exchange(session: ParamSession, vehicle: Vehicle, seconds: float, now_us: int = 0) -> int:
    end_us = now_us + round(seconds * 1e6)
    beat_us = now_us
    while now_us < end_us and not session.problem:
        now_us += STEP_US
        if now_us >= beat_us:
            beat_us += 1_000_000
            vehicle.link.send(m.Heartbeat(2, 12, 0x80 if vehicle.armed else 0x01, 0x03040000, 4))
        for data in vehicle.link.datagrams_to_send():
            session.receive(data, now_us)
        session.step(now_us)
        for data in session.to_send():
            vehicle.hear(data, now_us)
    return now_us


@pytest.mark.parametrize("hears", [1, 2, 3])
def test_values_are_read_set_and_put_back_though_datagrams_are_lost(hears: int) -> None:
    vehicle = Vehicle(hears=hears)
    session = ParamSession(Link(240, 191), list(vehicle.values))
    now_us = exchange(session, vehicle, 9.0)
    assert session.settled
    assert (session.system, session.uid) == (3, 77)
    before = {name: stored.value for name, stored in session.stored.items()}
    session.write({"EKF2_GYR_NOISE": 0.1, "COM_RC_IN_MODE": 4.0})
    assert not session.settled
    now_us = exchange(session, vehicle, 9.0, now_us)
    assert session.settled
    assert vehicle.values["EKF2_GYR_NOISE"][0] == pytest.approx(0.1)
    assert vehicle.values["COM_RC_IN_MODE"][0] == 4.0
    session.write(before)
    exchange(session, vehicle, 9.0, now_us)
    assert session.settled
    assert vehicle.values == Vehicle().values


def test_nothing_is_written_to_an_armed_vehicle() -> None:
    vehicle = Vehicle(armed=True)
    session = ParamSession(Link(240, 191), ["EKF2_GYR_NOISE"])
    now_us = exchange(session, vehicle, 3.0)
    session.write({"EKF2_GYR_NOISE": 0.1})
    exchange(session, vehicle, 3.0, now_us)
    assert "armed" in session.problem
    assert vehicle.sets == 0


def test_what_the_vehicle_lacks_or_does_not_take_is_said() -> None:
    session = ParamSession(Link(240, 191), ["NO_SUCH"])
    exchange(session, Vehicle(), 3.0)
    assert "NO_SUCH" in session.problem
    vehicle = Vehicle(takes=False)
    session = ParamSession(Link(240, 191), ["EKF2_GYR_NOISE"])
    now_us = exchange(session, vehicle, 3.0)
    session.write({"EKF2_GYR_NOISE": 0.1})
    exchange(session, vehicle, 9.0, now_us)
    assert "EKF2_GYR_NOISE" in session.problem
    session = ParamSession(Link(240, 191), ["COM_RC_IN_MODE"])
    exchange(session, Vehicle(), 3.0)
    session.write({"COM_RC_IN_MODE": 1.5})
    assert "integer" in session.problem


HEAD = 'schema = "flightstack.params/1"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "schema"), (HEAD, "[set]"), (HEAD + "[set]\n", "[set]"), (HEAD + "[set]\nekf2 = 1", "no name"),
        (HEAD + "[set]\nEKF2_GYR_NOISE_TOO_LONG = 1", "no name"), (HEAD + "[set]\nA = true", "number"),
        (HEAD + "[set]\nA = nan", "number"), (HEAD + '[set]\nA = "1"', "number"), (HEAD + "x = 1", "unknown key x"),
        ("[set", "not valid TOML"),
    ],
)  # fmt: skip
def test_bad_files_are_one_line_that_names_them(text: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        parse_params(text, "mine.toml")
    assert str(error.value).startswith("mine.toml: ")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_is_read() -> None:
    assert parse_params(HEAD + 'name = "x"\n[set]\nA = 1\nB_2 = 0.5\n', "").values == {"A": 1.0, "B_2": 0.5}
