"""The estimated height held against the barometer's."""

import math

import numpy as np
import pytest

from flightstack.cli.height_events import HeightEvents
from mavlink_bridge import messages as m

ZERO = (0.0, 0.0, 0.0)
GROUND_S, CLIMB_S, END_S = 5.0, 3.0, 60.0
NOISE_M, DATUM_M = 0.1, 489.4


def _told(drift_m: float, *, fields: int = 0x1A3F, pressure_alt_m: float = math.nan) -> list[tuple[float, str]]:
    """What is told of a hover at 2 m during which the estimate drifts away by `drift_m` and back, 250 and 25 Hz."""
    told: list[tuple[float, str]] = []
    events = HeightEvents(lambda t_us, name, text, severity: told.append((1e-6 * t_us, text)))
    noise = np.random.default_rng(1)
    for t_us in range(0, int(END_S * 1e6), 40_000):
        t_s = 1e-6 * t_us
        true_m = 2.0 * min(1.0, max(0.0, (t_s - GROUND_S) / CLIMB_S))
        up_m = true_m + drift_m * math.sin(math.pi * max(0.0, t_s - GROUND_S) / (END_S - GROUND_S)) - 0.18
        if abs(t_s - GROUND_S) < 1e-9:
            events.begin()
        events.on_message(t_us, m.LocalPositionNed(t_us // 1000 * 1000, (0.0, 0.0, -up_m), ZERO))
        height_m = (
            DATUM_M + true_m + NOISE_M * noise.standard_normal() if math.isnan(pressure_alt_m) else pressure_alt_m
        )
        events.on_message(t_us, m.HighresImu(t_us, ZERO, ZERO, ZERO, 956.0, 0.0, height_m, 15.0, fields))
    return told


@pytest.mark.parametrize(("drift_m", "words"), [(1.6, "1.0 m above"), (-1.6, "1.0 m below")])
def test_a_height_that_leaves_the_barometers_is_told_once(drift_m: float, words: str) -> None:
    """1.6 m is what a real PX4's height erred by when a killed companion's vehicle met the ground."""
    ((at_s, text),) = _told(drift_m)
    assert words in text
    crossed_s = GROUND_S + (END_S - GROUND_S) / math.pi * math.asin(1.0 / 1.6)
    assert crossed_s - 1.0 < at_s < crossed_s + 3.0  # a second of smoothing; the noise of its mean is 0.02 m


def test_heights_that_agree_within_a_metre_are_not_told() -> None:
    """0.4 m is the median flight's error on a real PX4; the datum of the two differs by 489 m."""
    assert not _told(0.4)
    assert not _told(0.8)


def test_a_vehicle_without_a_barometer_is_not_judged() -> None:
    assert not _told(1.6, fields=0x3F, pressure_alt_m=0.0)
    assert not _told(1.6, pressure_alt_m=math.inf)
