"""What begins in mid-flight is no effect of the whole flight: it is called unexplained, and no name stands for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flightstack.gap import pooled
from flightstack.gap.drifting import gyro_changes_s, with_changing_gyro
from flightstack.gap.gusts import gusts
from flightstack.gap.name import name
from flightstack.gap.records import Samples
from flightstack.gap.report import words
from flightstack.gap.verdict import gap_of
from flightstack.types import F64
from tests import gap_batch as batch
from tests.gap_hidden import believed

BEGINS_S = 13.0
GYRO_RADPS = np.array([0.02, -0.03, 0.01])


@pytest.fixture(scope="module")
def flights() -> list[Samples]:
    """Calm and windy: one reference, so that a moment of one follows on the moment before of another."""
    hidden = [{}, {"steady_wind": {"north_mps": 4.0, "east_mps": -2.0, "down_mps": 0.0}}]
    return batch.fly(believed(), hidden, seed=61_000)


def _from(begins_s: float, before: Samples, after: Samples) -> Samples:
    """One flight up to a moment, another from then on; nothing is used within a second of it."""
    late = before.t_s - before.t_s[0] >= begins_s

    def spliced(field: str) -> F64:
        a, b = getattr(before, field), getattr(after, field)
        return np.where(late.reshape(-1, *[1] * (a.ndim - 1)), b, a)

    rows = ("pos_ned_m", "vel_ned_mps", "q_ned_frd", "rate_frd_radps", "accel_frd_mps2", "motor", "battery_v")
    made = replace(before, **{field: spliced(field) for field in rows}, height_m=spliced("height_m"))
    near = np.abs(before.t_s - before.t_s[0] - begins_s) < 1.0
    return replace(made, valid=before.valid & after.valid & ~near)


def test_a_wind_that_begins_in_mid_flight_is_no_turbulence(flights: list[Samples]) -> None:
    """Its two halves are alike within, as gusts of a great length are: it was told as gusts of 1.07 m/s."""
    calm, windy = flights
    stepped = _from(BEGINS_S, calm, windy)
    found = gusts(believed(), [stepped], [stepped.valid])
    assert found is None or not found.named


def test_a_gyro_that_changes_in_mid_flight_is_said(flights: list[Samples]) -> None:
    """Neither force nor turning holds a rate's offset: it was "no gap" with 2 degrees a second."""
    calm = flights[0]
    t_s = calm.t_s - calm.t_s[0]
    moved = replace(calm, rate_frd_radps=calm.rate_frd_radps + GYRO_RADPS * (t_s >= BEGINS_S)[:, None])
    assert gyro_changes_s(believed(), [moved]) == pytest.approx(BEGINS_S, abs=1.5)
    of = pooled.split([moved], [])
    said = with_changing_gyro(believed(), name(believed(), of.flights, of.fit, of.holdout), of.flights)
    assert not said.found
    assert said.unexplained.significant
    assert said.unexplained.depends_on[0] == "time"
    figures = pooled.figures(believed(), of)
    sentence = words.sentence(said.found, gap_of(figures, figures, figures), said.unexplained)
    assert "gyro and attitude disagree otherwise from 1" in sentence
    assert "learned from only" not in sentence


@pytest.mark.parametrize("bias", [np.zeros(3), GYRO_RADPS])
def test_a_gyro_that_is_off_all_along_has_not_changed(flights: list[Samples], bias: F64) -> None:
    for flight in flights:
        assert gyro_changes_s(believed(), [replace(flight, rate_frd_radps=flight.rate_frd_radps + bias)]) is None


def _again(samples: Samples, times: int) -> Samples:
    """The flight several times over; nothing is used within a second of where one ends."""
    rows = (
        "pos_ned_m",
        "vel_ned_mps",
        "q_ned_frd",
        "rate_frd_radps",
        "accel_frd_mps2",
        "motor",
        "battery_v",
        "height_m",
    )
    count = len(samples.t_s)
    longer = {field: np.concatenate([getattr(samples, field)] * times) for field in rows}
    at = np.arange(count * times)
    inside = (at % count > 1.0 / samples.dt_s) & (at % count < count - 1.0 / samples.dt_s)
    valid = np.concatenate([samples.valid] * times) & inside
    return replace(samples, t_s=samples.t_s[0] + samples.dt_s * at, valid=valid, **longer)


def test_an_estimator_that_turns_its_attitude_for_some_seconds_is_no_gyro_that_changes(flights: list[Samples]) -> None:
    """A PX4's found its heading in the air: some of the first ten seconds of 70 were off by 27 to 94 mrad/s."""
    long = _again(flights[0], 3)
    off_radps = np.repeat([0, 5, 2, 5, 27, 27, 61, 94, 3, 9, 12], round(1.0 / long.dt_s)) / 1e3
    rate = long.rate_frd_radps.copy()
    rate[: len(off_radps), 0] += off_radps
    assert gyro_changes_s(believed(), [replace(long, rate_frd_radps=rate)]) is None
