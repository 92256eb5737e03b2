"""Forces from which an estimator's wrong idea of the bias was subtracted; the truth is what was put into the flight."""

from __future__ import annotations

import gzip
import io
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pyulog import ULog

from benchmarks.gap_cases import make, write
from flightstack.gap import estimator_bias, pooled
from flightstack.gap.concluded import concluded
from flightstack.gap.estimator_bias import slow_error, with_bias
from flightstack.gap.gather import untold_force
from flightstack.gap.name import Selection
from flightstack.gap.pooled import FitHoldoutSplit
from flightstack.gap.records import Gap, Samples
from flightstack.gap.result import as_json
from flightstack.gap.sources import FREED
from flightstack.gap.track import track
from flightstack.gap.workflow import analyse
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack_logs.turn import multiply, rotate_inverse, turned
from tests.gap_flights import Reference, as_samples, fly, hidden, quad, wander
from tests.thorough import ONLY_THEN, THOROUGH, thorough

DRAG = {"linear_drag": {f"d_{axis}_kgps": 0.4 for axis in "xyz"}}
BELIEVED = hidden(quad(), DRAG)
STD_MPS2, LASTS_S = 0.18, 12.0
"""Of PX4's own with its internal simulator: 0.06 to 0.25 m/s^2, at most 0.4, on ten flights of 46 to 96 s."""


def belief(count: int, dt_s: float, seed: int) -> F64:
    """(N, 2) a Gauss-Markov process, held within what PX4's filter may believe."""
    rng = np.random.default_rng([seed, 99])
    keep = np.exp(-dt_s / LASTS_S)
    drive = STD_MPS2 * np.sqrt(1.0 - keep**2) * rng.standard_normal((count, 2))
    out = np.zeros((count, 2))
    out[0] = STD_MPS2 * rng.standard_normal(2)
    for k in range(1, count):
        out[k] = keep * out[k - 1] + drive[k]
    return np.clip(out, -0.4, 0.4)


def estimated(samples: Samples, seed: int) -> Samples:
    """The flight as a filter with GPS tells it: level biases that it believes in, and tilts that cancel them."""
    off = belief(len(samples.t_s), samples.dt_s, seed)
    none = np.zeros(len(off))
    tilt = np.column_stack([off[:, 1], -off[:, 0], none]) / STANDARD_GRAVITY_MPS2
    return replace(
        samples,
        accel_frd_mps2=samples.accel_frd_mps2 - np.column_stack([off, none]),
        q_ned_frd=multiply(samples.q_ned_frd, turned(tilt)),
    )


def nose_north(t: float) -> tuple[F64, F64, F64, float]:
    """Without yaw a force of the world and one of the body are the same."""
    pos, vel, acc, _ = wander()(t)
    return pos, vel, acc, 0.0


FLOWN: dict[tuple[str, int, Reference], Samples] = {}
"""By effects, seed and path: two tests ask of the same flight."""
WANDER = wander()


def said(
    effects: dict[str, dict[str, float]], seed: int, reference: Reference, *, freed: bool = True
) -> tuple[Selection, FitHoldoutSplit, Gap]:
    """What is named of a flight of 50 s with these effects."""
    what = json.dumps(effects)
    if (what, seed, reference) not in FLOWN:
        FLOWN[what, seed, reference] = as_samples(
            fly(hidden(BELIEVED, effects), BELIEVED, reference, seconds=50.0, seed=seed)
        )
    flown = FLOWN[what, seed, reference]
    samples = replace(estimated(flown, seed), derived=(FREED,) if freed else ())
    return concluded(BELIEVED, pooled.split([samples], []), "it")


def test_a_slow_error_is_found_under_noise_that_is_larger() -> None:
    true = belief(3000, 0.02, 5)[:, 0]
    noisy = true + 0.5 * np.random.default_rng(3).standard_normal(3000)
    found = slow_error(noisy, np.ones(3000, np.bool_), 0.02)
    assert np.std(found - true) < 0.5 * np.std(true)


def test_noise_alone_has_no_slow_error() -> None:
    for seed in range(20):
        noise = np.random.default_rng(seed).standard_normal(3000)
        assert not slow_error(noise, np.ones(3000, np.bool_), 0.02).any()


@pytest.mark.parametrize("hz", [0.65, 0.8, 1.2])
def test_a_load_that_sloshes_beside_is_not_taken_for_what_a_filter_believes(hz: float) -> None:
    """Three quarters of one at 0.65 Hz were: a flight with 1.5 times the noise had "no gap"."""
    t_s = 0.02 * np.arange(3000)
    noise = 0.05 * np.random.default_rng(3).standard_normal(3000)
    swing = 0.05 * np.sqrt(2.0) * np.sin(2.0 * np.pi * hz * t_s + 0.3)
    for believed in (np.zeros(3000), belief(3000, 0.02, 7)[:, 0]):
        off = believed + swing
        left = off - slow_error(off + noise, np.ones(3000, np.bool_), 0.02)
        assert float(left @ swing) > 0.9 * float(swing @ swing)


@pytest.mark.recorded
def test_what_a_real_filter_believed_is_found(recorded: Path) -> None:
    """PX4 wrote down what it believed of its accelerometer's bias; more than a twentieth of the rms is not left."""
    log = ULog(io.BytesIO(gzip.decompress((recorded / "px4_sih_flight.ulg.gz").read_bytes())))
    said_by_px4 = log.get_dataset("estimator_sensor_bias").data
    at_s = 1e-6 * said_by_px4["timestamp"]
    t_s = np.arange(at_s[0], at_s[-1], 0.01)
    noise = 0.05 * np.random.default_rng(3).standard_normal(len(t_s))
    for axis in range(2):
        true = np.interp(t_s, at_s, said_by_px4[f"accel_bias[{axis}]"])
        found = slow_error(true + noise, np.ones(len(t_s), np.bool_), 0.01)
        assert np.std(true) > 0.09
        assert np.std(found - true) < 0.08 * np.std(true)


@ONLY_THEN
def test_a_load_that_sloshes_in_an_autopilot_s_log_is_called_unexplained(tmp_path: Path) -> None:
    """It pushes by 1.5 times the noise; the same flight as a CSV was called unexplained, as MCAP "no gap"."""
    case = make("outside:slosh", 5050204)
    log, _, _ = write(case, tmp_path, "case", "mcap")
    found = analyse([log], case.believed)
    assert found.found == ()
    assert found.unexplained.significant
    assert as_json(found)["untold"] == ""


def test_a_flight_loses_what_was_put_into_it_and_no_more_than_a_filter_believes() -> None:
    flown = as_samples(fly(BELIEVED, BELIEVED, wander(), seconds=50.0, seed=1))
    samples = replace(estimated(flown, 1), derived=(FREED,))
    bias = with_bias(BELIEVED, samples).bias_frd_mps2
    assert bias is not None
    rows = track(samples).usable
    left = bias[rows, :2] + belief(len(rows), samples.dt_s, 1)[rows]
    assert np.all(np.std(left, axis=0) < 0.3 * STD_MPS2)
    assert not bias[:, 2].any()
    pushed = replace(samples, accel_frd_mps2=samples.accel_frd_mps2 + np.eye(3)[0])
    pushed_bias = with_bias(BELIEVED, pushed).bias_frd_mps2
    assert pushed_bias is not None
    assert np.max(np.abs(pushed_bias)) == pytest.approx(0.4)


@pytest.mark.parametrize("reference", [WANDER, thorough(nose_north)], ids=["turning", "nose north"])
def test_what_a_filter_believes_is_no_gap_and_no_gusts(reference: Reference) -> None:
    told = said({}, 2, reference)[0]
    assert told.found == ()
    assert not told.unexplained.significant


def test_the_same_flight_is_called_unexplained_where_the_log_says_nothing_of_it() -> None:
    assert said({}, 2, WANDER, freed=False)[0].unexplained.significant


def test_a_steady_force_stays_and_its_interval_holds_what_a_filter_may_believe() -> None:
    """A wind through the same drag on every axis is a force: one of them is named with the other as its twin.

    Of eight intervals of 95 % two or more miss in one draw of eighteen, of two both in one of four hundred.
    """
    true = {"north_n": 0.8, "east_n": 0.4, "down_n": 0.0}
    holds = 0
    flights: list[tuple[Reference, int]] = [(wander(), 1), (nose_north, 2)]
    for reference, seed in [*flights, (wander(), 2), (nose_north, 1)] if THOROUGH else flights[:1]:
        told = said({"constant_force": true}, seed, reference)[0]
        (found,) = told.found
        assert {found.name, *found.indistinguishable_from} == {"constant_force", "steady_wind"}
        assert not told.unexplained.significant
        size, unit = (0.4, "mps") if found.name == "steady_wind" else (1.0, "n")
        for axis in ("north", "east"):
            interval = found.parameters[f"{axis}_{unit}"]
            holds += interval.low * size <= true[f"{axis}_n"] <= interval.high * size
    assert holds >= (7 if THOROUGH else 1)


def test_a_drag_beside_it_is_named_alone() -> None:
    told, _, gap = said({"linear_drag": {f"d_{axis}_kgps": 0.6 for axis in "xyz"}}, 1, wander())
    (found,) = told.found
    assert found.name == "linear_drag"
    assert all(e.low <= 0.6 <= e.high for e in found.parameters.values())
    assert gap.closed is not None
    assert gap.closed > 0.9


def test_a_level_force_that_is_taken_for_the_belief_is_said_with_its_class() -> None:
    """0.2 and 0.1 m/s^2 in axes of the world are 0.22 m/s^2 however the vehicle turns; of no belief nothing is said."""
    flown = as_samples(fly(BELIEVED, BELIEVED, wander(), seconds=20.0, seed=1))
    force = np.broadcast_to([0.2, 0.1, 0.0], flown.accel_frd_mps2.shape)
    told = untold_force([replace(flown, bias_frd_mps2=rotate_inverse(track(flown).q_ned_frd, force))])
    assert "0.22 m/s" in told
    for effect in ("constant force", "steady wind", "accelerometer bias", "misaligned attitude"):
        assert effect in told
    assert untold_force([flown]) == ""
    # a load that sloshed at 0.8 Hz, 1.5 times the noise in all, was "no gap" without a word
    swing = np.zeros_like(force)
    swing[:, 0] = 0.1 * np.sqrt(2.0) * np.sin(2.0 * np.pi * 0.8 * flown.t_s)
    moves = untold_force([replace(flown, bias_frd_mps2=swing)])
    assert moves.startswith("a level force that moves by 0.10 m/s² was taken for the autopilot's own estimate")
    small = [replace(flown, bias_frd_mps2=0.3 * swing)]
    assert untold_force(small) == ""
    assert untold_force(small, 0.06) == ""  # hypot(0.06, 0.03) is 1.1 times 0.06
    assert "moves by 0.03 m/s²" in untold_force(small, 0.04)


@pytest.mark.parametrize("lasts_s", [1.0, 2.0, 3.0, 5.0, 8.0])
def test_a_flight_of_a_few_seconds_has_fewer_shapes_and_no_fewer_columns(
    lasts_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A flight whose process was killed soon after take-off; beside a long one its columns must be as many."""
    monkeypatch.setattr(estimator_bias, "bias_std", lambda vehicle, samples: np.ones(3))
    counts = set()
    for span_s in (lasts_s, 60.0):
        flight: Any = SimpleNamespace(t_s=np.arange(0.0, span_s, 0.004), dt_s=0.004)
        found = estimator_bias.columns(quad(), flight, 5)
        assert np.isfinite(found).all()
        assert found[:, 0].any()
        assert found[:, 1].any()
        counts.add(found.shape[2])
    assert len(counts) == 1
