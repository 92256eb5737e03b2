"""A vehicle that is carried away from where its site was laid out, before it is armed."""

from __future__ import annotations

import pytest

from flightstack.barrier.estimate_bounds import estimate_bounds
from flightstack.cli.sensors import error_statistics
from flightstack.cli.vehicle_site import carried, unknowing
from flightstack.geodesy import LocalFrame
from flightstack_sim.grade import load_grade
from mavlink_bridge import messages as m
from mavlink_bridge.px4 import ARMED_BIT
from mavlink_bridge.vehicle_view import VehicleView

HOME = (47.397742, 8.545594)


def seen(north_m: float, *, armed: bool = False) -> VehicleView:
    """A vehicle so far north of the place."""
    view = VehicleView()
    place = LocalFrame(*HOME, 0.0).to_globe(north_m, 0.0)
    view.update(m.GlobalPositionInt(0, *place, 488.0, 0.0, (0.0, 0.0, 0.0), 0.0), 0)
    view.update(m.Heartbeat(2, 12, ARMED_BIT if armed else 0, 0, 3), 0)
    return view


@pytest.mark.parametrize(
    ("view", "laid_round", "is_told"),
    [
        (seen(2.9), HOME, False),
        (seen(3.1), HOME, True),
        (seen(-30.0), HOME, True),
        (seen(30.0, armed=True), HOME, False),  # it flies
        (seen(30.0), None, False),  # its site is no place on the globe
        (VehicleView(), HOME, False),  # it has not told
    ],
)
def test_who_was_carried_is_told(view: VehicleView, laid_round: tuple[float, float] | None, is_told: bool) -> None:
    said = carried(view, laid_round)
    assert bool(said) is is_told
    assert "\n" not in said


@pytest.mark.parametrize(
    ("sensors", "accuracy_m", "armed", "is_told"),
    [
        ("mocap", (0.29, 0.5), False, True),  # a real PX4 with GPS whose user left out --sensors
        ("mocap", (0.29, 0.5), True, False),  # in flight nobody is refused
        ("mocap", (0.01, 0.01), False, False),
        ("gps", (0.29, 0.5), False, False),
        ("gps", (0.29, 4.0), False, True),
        ("mocap", (float("nan"), float("nan")), False, False),  # it has not told
    ],
)
def test_who_knows_less_than_its_site_counts_on_is_told(
    sensors: str, accuracy_m: tuple[float, float], armed: bool, is_told: bool
) -> None:
    view = seen(0.0, armed=armed)
    view.accuracy_m = accuracy_m
    said = unknowing(view, estimate_bounds(error_statistics(load_grade(sensors))), sensors)
    assert bool(said) is is_told
    assert said == "" or (
        f"with {sensors} sensors" in said and said.endswith("name the sensors that it has with --sensors")
    )
    assert unknowing(view, None, sensors) == ""  # there is no site
