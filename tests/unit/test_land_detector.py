"""The land detector against a recorded PX4 landing, and where it must keep quiet."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from flightstack_sim.autopilot.land_detector import LandDetector
from flightstack_sim.autopilot.params import Params
from tests.recorded_px4 import latest, read_flight

NAN = math.nan
STILL = (0.0, 0.0, 0.0)
DT_S = 0.004


def flying() -> LandDetector:
    detector = LandDetector(Params())
    detector.update(
        armed=True,
        thrust=0.5,
        vel_ned_mps=(0.0, 0.0, -1.0),
        rate_frd_radps=STILL,
        descent_setpoint_mps=NAN,
        dt_s=DT_S,
    )
    assert not detector.landed
    return detector


def hold(
    detector: LandDetector,
    seconds: float,
    thrust: float,
    *,
    vel: tuple[float, float, float] = STILL,
    rate: tuple[float, float, float] = STILL,
    descent: float = NAN,
    armed: bool = True,
) -> LandDetector:
    for _ in range(round(seconds / DT_S)):
        detector.update(
            armed=armed,
            thrust=thrust,
            vel_ned_mps=vel,
            rate_frd_radps=rate,
            descent_setpoint_mps=descent,
            dt_s=DT_S,
        )
    return detector


@pytest.mark.recorded
def test_stages_change_when_those_of_a_real_px4_did(recorded: Path) -> None:
    """PX4's: in the air at 10.368 s, contact 41.304, maybe landed 41.656, landed 41.992, and nothing in between."""
    log, _ = read_flight(recorded)
    detector = LandDetector(Params())
    changes: list[tuple[float, tuple[bool, bool, bool]]] = []
    descent = NAN
    for row in log["vehicle_local_position"]:
        t = int(row["timestamp"])
        if not 9_200_000 <= t < 44_000_000:
            continue
        if t > 36_990_000:  # from here on PX4 lands; before, rates are flown
            asked = float(latest(log["vehicle_local_position_setpoint"], t)["vz"])
            descent = asked if math.isfinite(asked) else descent
        rate = latest(log["vehicle_angular_velocity"], t)["xyz"].astype(float).tolist()
        detector.update(
            armed=True,
            thrust=-float(latest(log["vehicle_thrust_setpoint"], t)["xyz"][2]),
            vel_ned_mps=(float(row["vx"]), float(row["vy"]), float(row["vz"])),
            rate_frd_radps=(rate[0], rate[1], rate[2]),
            descent_setpoint_mps=descent,
            dt_s=0.008,
        )
        stages = (detector.ground_contact, detector.maybe_landed, detector.landed)
        if not changes or stages != changes[-1][1]:
            changes.append((t * 1e-6, stages))
    assert [stages for _, stages in changes] == [
        (True, True, True),
        (False, False, False),
        (True, False, False),
        (True, True, False),
        (True, True, True),
    ]
    times = [t for t, _ in changes[1:]]
    assert times == pytest.approx([10.368, 41.304, 41.656, 41.992], abs=0.15)


def test_a_disarmed_vehicle_is_landed_and_stays_so_after_arming_at_no_thrust() -> None:
    detector = hold(flying(), 0.1, 0.0, armed=False)
    assert detector.landed
    assert hold(detector, 5.0, 0.0).landed


def test_landing_out_of_rate_offboard_takes_three_stages_of_a_third_of_a_second() -> None:
    detector = flying()
    assert not hold(detector, 0.30, 0.0).ground_contact
    assert hold(detector, 0.06, 0.0).ground_contact
    assert not detector.maybe_landed
    assert hold(detector, 0.34, 0.0).maybe_landed
    assert not detector.landed
    assert hold(detector, 0.34, 0.0).landed


def test_hover_is_never_a_landing_with_or_without_vertical_control() -> None:
    for descent in (NAN, 0.0, 0.7):
        detector = hold(flying(), 30.0, 0.5, descent=descent)
        assert not detector.ground_contact


def test_a_short_drop_at_no_thrust_is_no_landing() -> None:
    """0.9 s of free fall from the top of a climb at 1 m/s: vertical speed is small only for 0.05 s."""
    detector, speed = flying(), -1.0
    for _ in range(round(0.9 / DT_S)):
        speed += 9.80665 * DT_S
        hold(detector, DT_S, 0.0, vel=(0.0, 0.0, speed))
        assert not detector.ground_contact


@pytest.mark.parametrize(
    "moving",
    [
        {"vel": (0.0, 0.0, 0.3)},
        {"vel": (1.2, 1.2, 0.0)},
        {"thrust": 0.4},
    ],
)
def test_movement_or_thrust_prevents_ground_contact(moving: dict[str, object]) -> None:
    arguments: dict[str, object] = {"thrust": 0.0, **moving}
    assert not hold(flying(), 5.0, **arguments).ground_contact  # type: ignore[arg-type]


def test_rotation_prevents_landing_but_not_ground_contact() -> None:
    detector = hold(flying(), 5.0, 0.0, rate=(0.0, 0.36, 0.0))  # 20 degrees/s is 0.349 rad/s
    assert detector.ground_contact
    assert not detector.maybe_landed


def test_with_vertical_control_low_thrust_alone_is_no_contact() -> None:
    assert not hold(flying(), 5.0, 0.2, descent=0.0).ground_contact
    assert hold(flying(), 5.0, 0.2, descent=0.7).ground_contact


def test_thrust_ends_every_stage_at_once() -> None:
    detector = hold(flying(), 2.0, 0.0)
    assert detector.landed
    hold(detector, DT_S, 0.5)
    assert (detector.ground_contact, detector.maybe_landed, detector.landed) == (False, False, False)


def test_once_landed_a_drifting_velocity_estimate_does_not_lift_it() -> None:
    detector = hold(flying(), 2.0, 0.0)
    assert hold(detector, 1.0, 0.0, vel=(0.0, 0.0, -0.4)).landed
    assert not hold(detector, DT_S, 0.0, vel=(0.0, 0.0, -0.7)).landed


def test_a_thrust_that_is_no_number_counts_as_none() -> None:
    assert hold(flying(), 2.0, NAN).landed
