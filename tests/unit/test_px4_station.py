"""The bench's ground station sets parameters of a real PX4: a late answer is not taken for a refusal."""

from __future__ import annotations

import struct
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.px4 import station
from benchmarks.px4.records import Bench
from benchmarks.px4.station import Px4

REAL32, INT32 = 9, 6


class Vehicle:
    """Holds one parameter, as PX4 does: each request is answered in its order, `late` answers after the newest one."""

    def __init__(self, px4: Px4, value: float, kind: int = REAL32) -> None:
        self.px4, self.value, self.kind = px4, value, kind
        self.sets = 0
        self.deaf_to = 0
        """So many PARAM_SET are lost."""
        self.refuses = False
        self.late: list[float] = []
        self.mav = self

    def answer(self, name: str, value: float) -> None:
        wire = struct.unpack("<f", struct.pack("<i", int(value)))[0] if self.kind == INT32 else value
        self.px4._take("PARAM_VALUE", SimpleNamespace(param_id=name, param_value=wire, param_type=self.kind), 0.0)

    def param_request_read_send(self, system: int, component: int, name: bytes, index: int) -> None:
        self.answer(name.decode(), self.late.pop(0) if self.late else self.value)

    def param_set_send(self, system: int, component: int, name: bytes, value: float, kind: int) -> None:
        self.sets += 1
        if self.sets <= self.deaf_to or self.refuses:
            return
        self.value = float(struct.unpack("<i", struct.pack("<f", value))[0]) if kind == INT32 else value
        if self.late:  # of a request before
            self.answer(name.decode(), self.late.pop(0))
        self.answer(name.decode(), self.value)


@pytest.fixture
def px4(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Px4:
    monkeypatch.setattr(station, "ANSWER_S", 0.5)
    return Px4(Bench(tmp_path, tmp_path))


def vehicle_of(px4: Px4, value: float, kind: int = REAL32) -> Vehicle:
    vehicle = Vehicle(px4, value, kind)
    px4.link = vehicle
    return vehicle


def test_answers_to_earlier_requests_are_waited_out(px4: Px4) -> None:
    vehicle = vehicle_of(px4, 220.0)
    vehicle.late = [220.0] * 3  # a busy machine: what was asked before the parameter was set comes after it
    px4.set_param("MC_PITCHRATE_MAX", 40.0)
    assert vehicle.value == px4.param("MC_PITCHRATE_MAX") == 40.0


def test_a_lost_set_is_sent_again(px4: Px4) -> None:
    vehicle = vehicle_of(px4, 4.0, INT32)
    vehicle.deaf_to = 1
    px4.set_param("COM_OBL_RC_ACT", 6.0)
    assert vehicle.value == 6.0


def test_a_set_that_is_never_taken_is_told(px4: Px4) -> None:
    vehicle = vehicle_of(px4, 220.0)
    vehicle.refuses = True
    with pytest.raises(RuntimeError, match="MC_PITCHRATE_MAX is 220, not 40"):
        px4.set_param("MC_PITCHRATE_MAX", 40.0)
