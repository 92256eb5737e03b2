"""What the checker derives from a log's ticks against what the learner took, where ticks repeat an IMU sample.

PX4 sends HIGHRES_IMU at 246 Hz, ticks come at 250: some see no new force.
"""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
import pytest
from shipped import load_scenario, load_vehicle

from flightstack.certificate_check.provenance import check_age
from flightstack.certificate_check.reading import Refused
from flightstack.certificate_check.samples import TICK, WINDOW, Believed, Ticks, samples
from flightstack.learning.learner import GpLearner
from flightstack.model import Limits, Model
from flightstack.predictor import Streams
from flightstack.stack import Stack
from flightstack.vehicle import vehicle_to_toml
from tests import closed_loop

QUAD = load_vehicle("quad-x")


@pytest.mark.parametrize("missing_every", [61, 7])
def test_every_window_of_the_learner_is_found_where_ticks_repeat_a_sample(
    monkeypatch: pytest.MonkeyPatch, missing_every: int
) -> None:
    heard = 0
    imu = Streams.imu

    def some(streams: Streams, t_us: int, *sample: object) -> None:
        nonlocal heard
        heard += 1
        if heard % missing_every:
            imu(streams, t_us, *sample)  # type: ignore[arg-type]

    monkeypatch.setattr(Streams, "imu", some)
    held: dict[str, Any] = {}
    step = GpLearner.step

    def kept(self: GpLearner, state: Any, *more: Any) -> Any:
        held["state"] = state
        return step(self, state, *more)

    def made(model: Model, limits: Limits) -> Stack:
        return Stack(model, limits, learner=GpLearner(model))

    monkeypatch.setattr(GpLearner, "step", kept)
    flight = closed_loop.fly(load_scenario("hover").with_duration(8.0), QUAD, make_stack=made, latency_ticks=0)
    ticks = Ticks(
        np.array([r.t_us for r in flight.records], np.int64),
        {name: np.array([getattr(r.measurement, name, r.t_us) for r in flight.records]) for name in TICK},
        np.array([r.command.thrust_norm for r in flight.records]),
        np.array([r.command.rate_frd_radps for r in flight.records]),
        np.array([r.learned.delay_s for r in flight.records]),
    )
    found = samples(ticks, Believed.of(tomllib.loads(vehicle_to_toml(QUAD))), 0.1)
    learnt = held["state"].evidence()
    assert len(learnt.vertical.places) > 60
    for store, columns in ((learnt.lateral, slice(0, 2)), (learnt.vertical, slice(2, 3))):
        first = np.searchsorted(found.t_us, store.spans_us[:, 0])
        np.testing.assert_array_equal(found.t_us[first], store.spans_us[:, 0])
        np.testing.assert_array_equal(found.t_us[first + WINDOW - 1], store.spans_us[:, 1])
        index = first[:, None] + np.arange(WINDOW)
        assert found.fit[index].all()
        np.testing.assert_allclose(store.values, found.y[index][:, :, columns].mean(axis=1), atol=1e-9)
        np.testing.assert_allclose(store.places, found.x[index].mean(axis=1), atol=1e-9)


@pytest.mark.parametrize(("older", "refused"), [(0, False), (20, False), (21, True), (1000, True)])
def test_a_log_whose_newest_samples_were_older_than_the_premise_is_refused(older: int, refused: bool) -> None:
    """One tick in 50; the maker's own rule is one in 100.  The newest of the three streams counts."""
    ages_us = np.where(np.arange(1000) < older, 6000, 2400)
    tick = {"position_age_us": ages_us + 3000, "attitude_age_us": ages_us, "imu_age_us": ages_us + 1000}
    ticks = Ticks(np.arange(1000), tick, *(np.zeros((1000, 3)) for _ in range(3)))
    if refused:
        with pytest.raises(Refused, match=f"in {older} of 1000 ticks of the log the newest sample was older"):
            check_age(ticks, 0.002)
    else:
        assert f"in {older} of 1000 ticks" in check_age(ticks, 0.002)
