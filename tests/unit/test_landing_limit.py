"""A landing that does not come to its end: the companion stops waiting at a stated time, and commands nothing more.

The oracle is closed form: 60 s and the height at 0.3 m/s.
"""

from __future__ import annotations

from typing import Any

import pytest
from companions import flying
from fake_px4 import LAND, exchange

from mavlink_bridge import messages as m
from mavlink_bridge.handshake import State
from mavlink_bridge.vehicle_view import VehicleView
from tests.thorough import thorough


@pytest.mark.parametrize(("landed", "where"), [(2, "in the air"), thorough(1, "on the ground")])
def test_a_landing_that_never_ends_is_left_to_px4(landed: int, where: str) -> None:
    flight = flying()
    companion, _, vehicle, start = flight
    height_m = -float(companion.mission.reference(60.0).pos_ned_m[2]) if companion.mission else 0.0
    companion.stop("enough")
    begun = exchange(companion, vehicle, 0.5, start_us=start)
    assert (companion.state, vehicle.mode) == (State.LANDING, LAND)
    vehicle.landed = landed
    said = len(vehicle.commands)
    end = exchange(companion, vehicle, 100.0, start_us=begun, until=lambda: companion.state is not State.LANDING)
    assert companion.state is State.LOST
    assert (end - start) * 1e-6 == pytest.approx(60.0 + height_m / 0.3, abs=1.0)
    assert "after Land was commanded the vehicle is armed" in companion.reason
    assert where in companion.reason
    assert not companion.completed
    assert vehicle.commands[said:] == []


@pytest.mark.parametrize(
    ("pwm_us", "force_mps2", "stands"), [(1080, 9.8, True), (1480, 9.8, False), (1080, 1.6, False), (None, 9.8, False)]
)
def test_a_vehicle_whose_motors_idle_and_that_feels_its_weight_stands(
    pwm_us: int | None, force_mps2: float, stands: bool
) -> None:
    """A real PX4 believed for 50 s that it rose at 1.4 m/s, on the ground, motors idle.

    With MPC_THR_HOVER 0.5 they carry a sixth of the weight then, and who falls by them feels no more than that.
    """
    view, still = VehicleView(), (0.0, 0.0, 0.0)
    assert not view.stands
    view.params.take(m.ParamValue("MPC_THR_HOVER", m.param_bits(0.5, m.PARAM_REAL32), m.PARAM_REAL32, 875, 1))
    view.update(m.AttitudeQuaternion(4_000, (1.0, 0.0, 0.0, 0.0), still), 4_000)
    view.update(m.LocalPositionNed(4_000, still, (0.0, 0.0, -1.4)), 4_000)
    view.update(m.HighresImu(4_000, (0.0, 0.0, -force_mps2), still, still, 955.0, 0.0, 488.0, 20.0, 63), 4_000)
    if pwm_us is not None:
        view.update(m.ServoOutputRaw(4_000, 0, (pwm_us,) * 4 + (0,) * 12), 4_000)
    assert view.stands is stands


def test_a_vehicle_whose_heartbeats_have_stopped_is_asked_whether_it_has_disarmed() -> None:
    """A real PX4 whose HEARTBEAT is off answers REQUEST_MESSAGE 0 with one within 8 ms (v1.18.0alpha, 2026-11-24)."""
    companion, _, vehicle, start = flying()
    vehicle.heartbeats = False
    companion.stop("enough")
    begun = exchange(companion, vehicle, 5.0, start_us=start)
    assert companion.state is State.LANDING
    vehicle.landed, vehicle.armed = 1, False
    end = exchange(companion, vehicle, 100.0, start_us=begun, until=lambda: companion.state is not State.LANDING)
    assert companion.state is State.LANDED
    assert (end - begun) * 1e-6 < 3.6


def test_a_vehicle_that_somebody_disarms_is_noticed_without_its_heartbeats() -> None:
    companion, _, vehicle, start = flying()
    vehicle.heartbeats = False
    later = exchange(companion, vehicle, 4.0, start_us=start)
    assert companion.state is State.OFFBOARD
    vehicle.armed = False
    exchange(companion, vehicle, 3.6, start_us=later)
    assert companion.state is State.PILOT
    assert companion.reason == "the vehicle was disarmed by someone else"


def test_a_fall_after_a_stranger_disarmed_is_told_as_what_it_was() -> None:
    """On a real PX4 its fall was seen 0.4 s before a heartbeat said that the motors stand still."""
    companion, _, vehicle, start = flying()
    vehicle.armed = False

    def falls(message: Any) -> Any:
        t_s = 1e-6 * (message[0] - start)
        if isinstance(message, m.LocalPositionNed):
            (n, e, d), (vn, ve, vd) = message.pos_ned_m, message.vel_ned_mps
            return message._replace(pos_ned_m=(n, e, d + 4.9 * t_s**2), vel_ned_mps=(vn, ve, vd + 9.8 * t_s))
        return message

    vehicle.alter, vehicle.heartbeats = falls, False
    later = exchange(companion, vehicle, 1.0, start_us=start, until=lambda: companion.state is State.LANDING)
    assert companion.state is State.LANDING
    vehicle.heartbeats = True
    exchange(companion, vehicle, 1.1, start_us=later)
    assert companion.state is State.PILOT
    assert companion.reason.startswith("velocity-against-imu: ")
    assert companion.reason.endswith("; the vehicle was disarmed by someone else")


def test_a_vehicle_that_sends_its_heartbeats_is_not_asked_for_them() -> None:
    companion, _, vehicle, start = flying()
    exchange(companion, vehicle, 5.0, start_us=start)
    assert not [given for given in vehicle.set_modes(512) if given.params[0] == 0.0]
