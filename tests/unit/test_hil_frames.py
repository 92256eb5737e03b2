"""The physics behind a real PX4: how old its fixes are, and how PX4's local frame lies to the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shipped import load_vehicle

from flightstack.cli.hil_flight import GlobalEstimateScore
from flightstack.geodesy import PX4_SIH, LocalFrame
from flightstack_sim.grade import load_grade
from flightstack_sim.px4_hil import PhysicsBehindPx4
from mavlink_bridge import messages as m
from mavlink_bridge.events.hil import HilGps
from mavlink_bridge.framing import StreamFraming
from mavlink_bridge.link import Link

STEP_S = 0.004


def ages_s(told_s: float | None) -> list[float]:
    """Age of each fix when it arrives: when the vehicle, climbing ever faster, was at the height that the fix says."""
    grade = load_grade("gps")
    exact = replace(grade, fix=replace(grade.fix, pos_std_m=(0.0,) * 3, vel_std_mps=(0.0,) * 3))
    hil = PhysicsBehindPx4(load_vehicle("iris"), exact, seed=0)
    if told_s is not None:
        hil.set_gps_delay(told_s)
    ear, heights, found = Link(1, 1, framing=StreamFraming()), [], []
    for step in range(750):
        hil.motors[:] = 0.9
        hil.advance()
        heights.append(-float(hil.plant.pos_ned_m[2]))
        ear.receive_datagram(hil.to_send(), 0)
        for received in ear.take_events():
            if isinstance(received.message, HilGps) and step > 200:
                height_m = received.message.alt_msl_m - PX4_SIH.altitude_m
                found.append(step * STEP_S - float(np.interp(height_m, heights, STEP_S * np.arange(step + 1))))
    return found


@pytest.mark.parametrize(("told_s", "age_s"), [(None, 0.010), (0.010, 0.010), (0.109, 0.109), (0.0, 0.0)])
def test_fixes_are_as_old_as_px4_expects_within_a_step(told_s: float | None, age_s: float) -> None:
    """PX4's start-up behind a MAVLink simulator sets EKF2_GPS_DELAY to 10 ms."""
    ages = ages_s(told_s)
    assert len(ages) > 10
    assert min(ages) >= age_s - 0.001
    assert max(ages) <= age_s + STEP_S + 0.001


def test_the_truth_is_put_into_px4s_frame_before_it_is_compared() -> None:
    """PX4's first fix lay 3 m north, 2 m west and 0.5 m above the truth's origin: that place reads (0, 0, 0)."""
    lat, lon = PX4_SIH.to_globe(3.0, -2.0)
    score = GlobalEstimateScore(PX4_SIH)
    assert score.in_px4s_frame((0.0, 0.0, 0.0)) is None
    assert score.summary()["height_rms_m"] is None
    score.on_message(0, m.GpsGlobalOrigin(lat, lon, PX4_SIH.altitude_m + 0.5))
    assert score.in_px4s_frame((3.0, -2.0, -0.5)) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert score.in_px4s_frame((4.0, -2.0, -2.5)) == pytest.approx((1.0, 0.0, -2.0), abs=1e-5)
    score.add((0.3, 0.4, -2.0), (0.0, 0.0, -2.1))  # half a metre beside it, 0.1 m too low
    score.add((0.3, 0.4, -2.0), (0.0, 0.0, -2.1))
    figures = {"horizontal_rms_m": 0.5, "height_rms_m": 0.1, "height_mean_m": -0.1}
    assert {name: score.summary()[name] for name in figures} == pytest.approx(figures)


def test_the_frame_is_the_globes_not_the_simulators() -> None:
    far = LocalFrame(-33.0, 151.0, 20.0)
    score = GlobalEstimateScore(far)
    score.on_message(0, m.GpsGlobalOrigin(-33.0, 151.0, 20.0))
    assert score.in_px4s_frame((10.0, -5.0, -1.0)) == pytest.approx((10.0, -5.0, -1.0), abs=1e-6)
