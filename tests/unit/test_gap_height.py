"""How high the centre of mass sits, no measurement where its interval reaches an end of what is plausible."""

from __future__ import annotations

import pytest
from shipped import load_vehicle

from flightstack.gap.naming.candidates import plausible
from flightstack.gap.naming.estimate import fills

SLOT = ("com_offset", "z_m")


@pytest.mark.parametrize(
    ("low", "high", "untold"),
    [(-1.0, -0.8, True), (0.4, 1.1, True), (-1.2, 1.2, True), (-0.4, 0.3, False), (0.1, 0.3, False)],
)
def test_a_height_at_either_end_of_its_range_is_not_told(low: float, high: float, untold: bool) -> None:
    """In shares of the range; of flights of a Crazyflie -46 mm were told, which is its whole arm."""
    vehicle = load_vehicle("quad-x")
    end = plausible(vehicle, *SLOT)[1]
    assert fills(vehicle, SLOT, low * end, high * end) is untold


def test_aside_an_end_that_is_reached_is_told() -> None:
    vehicle = load_vehicle("quad-x")
    end = plausible(vehicle, "com_offset", "x_m")[1]
    assert not fills(vehicle, ("com_offset", "x_m"), 0.5 * end, 1.1 * end)
