"""The first hover against the vehicle file, where MPC_THR_HOVER was never set; figures worked out by hand."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from shipped import load_scenario, load_vehicle

from flightstack.mission import plan
from flightstack.model import Model
from flightstack.types import F64, Command
from mavlink_bridge.hover_check import HoverCheck, RiseCheck
from mavlink_bridge.vehicle_view import VehicleView

MISSION = plan(load_scenario("hover"), np.zeros(3))
MODEL = Model.from_vehicle(load_vehicle("quad-x"))  # 1.2 kg of 26.4 N, speed-controlled: hovers at sqrt(0.4458) = 0.668
STEP_S = 0.004


class _Measured(NamedTuple):
    pos_ned_m: F64


class _Record(NamedTuple):
    command: Command
    measurement: _Measured


def flown(
    thrust_norm: float, *, landed: int = 2, told: float = 0.5, share: float = 1.0
) -> tuple[HoverCheck, list[str]]:
    """A flight that commands a constant thrust, with noise that averages out, and rises by a share of its reference."""
    stops: list[str] = []
    view = VehicleView()
    view.landed_state = landed
    view.params.values |= {"MPC_THR_HOVER": told, "THR_MDL_FAC": 0.0}
    check = HoverCheck(MODEL, view, stops.append)
    noise = np.random.default_rng(1).normal(0.0, 0.05, 5000)
    for tick in range(round((MISSION.takeoff_end_s + 3.0) / STEP_S)):
        command = Command(0, 1.0, thrust_norm + float(noise[tick]), np.zeros(3))
        measured = _Measured(share * MISSION.reference(tick * STEP_S).pos_ned_m)
        assert check.step(MISSION, tick * STEP_S, _Record(command, measured)) is MISSION  # type: ignore[arg-type]
    return check, stops


@pytest.mark.parametrize(("thrust_norm", "refused"), [(0.49, True), (0.52, True), (0.55, False), (0.86, False)])
def test_a_hover_thrust_a_quarter_off_stops_the_flight_once(thrust_norm: float, refused: bool) -> None:
    """0.668 / 1.25 = 0.534 and 0.668 / 0.75 = 0.890 are the bounds."""
    check, stops = flown(thrust_norm)
    assert bool(check.contradiction) is refused
    assert stops == ([check.contradiction] if refused else [])
    if refused:
        assert check.contradiction.startswith(f"hover thrust: 0.67 by the vehicle file, {thrust_norm:.2f}")


def test_a_vehicle_that_has_not_left_the_ground_is_another_one() -> None:
    check, stops = flown(0.7, landed=1)
    assert "has not left the ground" in check.contradiction
    assert stops == [check.contradiction]


@pytest.mark.parametrize("thrust_norm", [0.35, 0.7])
def test_one_that_stands_on_the_ground_with_its_motors_loud_was_in_no_hover(thrust_norm: float) -> None:
    """A real PX4 calls a vehicle with a third of its thrust in the air, on the ground as it is."""
    check, stops = flown(thrust_norm, landed=2, share=0.02)
    said = f"with {thrust_norm:.2f} it rose 0.03 m of the 1.50 m of its first climb"
    assert check.contradiction == f"hover thrust: 0.67 by the vehicle file, {said}"
    assert stops == [check.contradiction]


@pytest.mark.parametrize("told", [0.668, 0.6, 0.49])
def test_where_px4_was_told_its_hover_thrust_nothing_is_left_to_decide(told: float) -> None:
    """A heavier load than the file's is the learner's business, not another vehicle."""
    check, stops = flown(0.95, told=told)
    assert not check.contradiction
    assert not stops


def test_thrust_that_is_no_number_decides_nothing() -> None:
    view = VehicleView()
    view.landed_state = 2
    view.params.values |= {"MPC_THR_HOVER": 0.5, "THR_MDL_FAC": 0.0}
    stops: list[str] = []
    check = HoverCheck(MODEL, view, stops.append)
    for tick in range(round((MISSION.takeoff_end_s + 3.0) / STEP_S)):
        record = _Record(Command(0, 1.0, float("nan"), np.zeros(3)), _Measured(np.zeros(3)))
        check.step(MISSION, tick * STEP_S, record)  # type: ignore[arg-type]
    assert not stops


class _Seen(NamedTuple):
    measurement: _Measured


@pytest.mark.parametrize(
    ("share", "why"),
    [
        (0.0, "never flew: it rose 0.00 m of the 1.50 m of its first climb (at least half counts)"),
        (0.4, "never flew: it rose 0.60 m of the 1.50 m of its first climb (at least half counts)"),
        (0.6, ""),
    ],
)
def test_a_vehicle_that_does_not_rise_is_stopped_after_the_first_climb(share: float, why: str) -> None:
    """A real PX4 with too little thrust: the motors ran for the whole scenario, leaning to follow it on the ground."""
    stops: list[tuple[float, str]] = []
    check = RiseCheck(lambda reason: stops.append((t_s, reason)))
    for tick in range(round((MISSION.takeoff_end_s + 5.0) / STEP_S)):
        t_s = tick * STEP_S
        seen = _Seen(_Measured(share * MISSION.reference(t_s).pos_ned_m))
        assert check.step(MISSION, t_s, seen) is MISSION  # type: ignore[arg-type]
    assert [reason for _, reason in stops] == ([why] if why else [])
    assert all(at_s == pytest.approx(MISSION.takeoff_end_s + 1.4, abs=2 * STEP_S) for at_s, _ in stops)


@pytest.mark.parametrize("behind_m", [0.5, math.inf])
def test_a_vehicle_that_a_high_climb_leaves_behind_is_stopped_before_its_end(behind_m: float) -> None:
    """One that stood on the ground with its reference 14 m above it was left to come free at full thrust."""
    mission = plan(load_scenario("gps-barrier"), np.zeros(3))
    stops: list[tuple[float, str]] = []
    check = RiseCheck(lambda reason: stops.append((t_s, reason)))
    for tick in range(round((mission.takeoff_end_s + 3.0) / STEP_S)):
        t_s = tick * STEP_S
        at = np.minimum(mission.reference(t_s).pos_ned_m + behind_m, 0.0)
        assert check.step(mission, t_s, _Seen(_Measured(at))) is mission  # type: ignore[arg-type]
    assert [reason for _, reason in stops] == (
        ["never flew: it rose 0.00 m where its first climb is 2.00 m high already"] if behind_m > 1.0 else []
    )
    assert all(float(mission.reference(at_s).pos_ned_m[2]) == pytest.approx(-2.0, abs=0.02) for at_s, _ in stops)
