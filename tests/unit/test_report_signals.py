"""The numbers on their way to the report's page: decimation, comparison, the lateness histogram."""

from __future__ import annotations

import base64
import json
import math
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flightstack_logs.report import signals
from flightstack_logs.report.flight import ReportSamples, samples
from flightstack_logs.report.histogram import counts, edges_us, lateness_svg
from flightstack_logs.report.page import safe_json


def signal(t: object, values: object) -> ReportSamples:
    made = samples(t, values)
    assert made is not None
    return made


# ---------------------------------------------------------------- decimation


@pytest.mark.parametrize("points", [4, 50, 1000])
def test_decimation_keeps_every_intervals_minimum_and_maximum(points: int) -> None:
    rng = np.random.default_rng(points)
    t = np.arange(10_007) * 0.004
    given = signal(t, rng.normal(size=(len(t), 3)))
    shown = signals.decimate(given, points)
    assert len(shown.t_s) <= points
    bucket = np.minimum((t / (t[-1] / (points // 2))).astype(int), points // 2 - 1)
    for b in range(points // 2):
        inside = given.values[bucket == b]
        pair = shown.values[2 * b : 2 * b + 2]
        np.testing.assert_array_equal(np.sort(pair, axis=0), np.stack([inside.min(axis=0), inside.max(axis=0)]))
        for column in range(3):
            rising = inside[:, column].argmin() < inside[:, column].argmax()
            assert (pair[0, column] < pair[1, column]) == rising


def test_one_spike_of_one_sample_survives_decimation_near_where_it_was() -> None:
    t = np.arange(15_000) * 0.004
    values = np.zeros(len(t))
    values[9_876] = 5.0
    shown = signals.decimate(signal(t, values), 400)
    peak = int(np.nanargmax(shown.values[:, 0]))
    assert shown.values[peak, 0] == 5.0
    assert abs(shown.t_s[peak] - t[9_876]) <= t[-1] / 200


def test_a_hole_in_the_log_stays_a_hole() -> None:
    t = np.concatenate([np.arange(0.0, 10.0, 0.004), np.arange(20.0, 30.0, 0.004)])
    shown = signals.decimate(signal(t, np.ones(len(t))), 300)
    inside = (shown.t_s > 10.2) & (shown.t_s < 19.8)
    assert inside.any()
    assert np.isnan(shown.values[inside]).all()
    assert np.isfinite(shown.values[~inside & (shown.t_s < 9.8)]).all()


def test_unknown_values_do_not_hide_known_ones_when_decimated() -> None:
    values = np.where(np.arange(9_000) % 3 == 0, np.nan, np.arange(9_000) * 1.0)
    shown = signals.decimate(signal(np.arange(9_000) * 0.01, values), 90)
    assert np.isfinite(shown.values).all()
    assert shown.values.max() == 8_999.0


def test_a_short_signal_is_shown_as_it_is() -> None:
    given = signal(np.arange(10.0), np.arange(10.0))
    assert signals.decimate(given, 100) is given


# ---------------------------------------------------------------- comparison


def test_resampling_is_linear_inside_and_unknown_outside_and_in_holes() -> None:
    given = signal([0.0, 0.1, 0.2, 1.0, 1.1], [0.0, 1.0, 2.0, 3.0, 4.0])
    got = signals.resample(given, np.array([-0.1, 0.0, 0.05, 0.2, 0.6, 1.0, 1.05, 1.2]))[:, 0]
    np.testing.assert_allclose(got, [math.nan, 0.0, 0.5, 2.0, math.nan, 3.0, 3.5, math.nan], atol=1e-12)


def test_tilt_and_attitude_difference_agree_with_scipy() -> None:
    a = Rotation.random(200, random_state=np.random.default_rng(1))
    b = Rotation.from_rotvec(np.random.default_rng(2).normal(scale=1e-3, size=(200, 3))) * a
    t = np.arange(200.0)
    sign = np.where(np.arange(200) % 7 < 3, -1.0, 1.0)[:, None]  # q and -q are one attitude
    qa, qb = (signal(t, r.as_quat()[:, [3, 0, 1, 2]]) for r in (a, b))
    qb = ReportSamples(t, qb.values * sign)
    tilt = np.degrees(np.arccos(np.clip(a.apply([0.0, 0.0, 1.0])[:, 2], -1.0, 1.0)))
    np.testing.assert_allclose(signals.tilt_deg(qa).values[:, 0], tilt, atol=1e-6)
    expected = np.degrees((a.inv() * b).magnitude())
    np.testing.assert_allclose(signals.rotation_between_deg(qa, qb).values[:, 0], expected, rtol=1e-6)


def test_attitudes_are_compared_at_the_same_instant() -> None:
    """Turning at 2 rad/s, sampled 2 ms apart: without interpolation 0.23 degrees would appear."""
    t = np.arange(0.0, 2.0, 0.004)
    q = [signal(at, Rotation.from_euler("z", 2.0 * at[:, None]).as_quat()[:, [3, 0, 1, 2]]) for at in (t, t + 0.002)]
    angle = signals.rotation_between_deg(*q).values[1:, 0]
    assert np.nanmax(angle) < 1e-3


def test_spans_at_a_limit_are_found_and_joined_when_too_many() -> None:
    t = np.arange(20_000) * 0.01
    flags = np.zeros(len(t))
    flags[100:200] = flags[5000:5001] = 1.0
    assert signals.intervals(signal(t, flags)) == [(1.0, 2.0), (50.0, pytest.approx(50.01))]
    chattering = signals.intervals(signal(t, np.arange(len(t)) // 5 % 2))
    assert 1 <= len(chattering) <= 400
    assert chattering[0][0] == pytest.approx(0.05)
    assert chattering[-1][1] == pytest.approx(t[-1])


@pytest.mark.parametrize("t", [[0.0, 2.0, 1.0], [math.nan, 1.0, 2.0]])
def test_samples_are_put_in_order_and_cleaned(t: list[float]) -> None:
    made = signal(t, [1.0, math.inf, 3.0])
    assert (np.diff(made.t_s) >= 0.0).all()
    assert not np.isinf(made.values).any()


@pytest.mark.parametrize(("t", "values"), [([], []), ([1.0], [math.nan]), ([1.0, 2.0], [1.0])])
def test_signals_without_anything_known_are_not_recorded(t: list[float], values: list[float]) -> None:
    assert samples(t, values) is None


# ---------------------------------------------------------------- lateness


def test_every_tick_is_in_the_histogram() -> None:
    late = np.concatenate([np.random.default_rng(0).lognormal(1.0, 1.0, 5000), [0.0, 1.0, 10.0, 99_999.0, 100_000.0]])
    bins = counts(late, edges_us(late))
    assert sum(bins) == len(late)
    assert bins[-1] == 2
    drawn = lateness_svg(late, 4000.0)
    assert sum(int(n) for n in re.findall(r": (\d+) ticks", drawn)) == len(late)
    assert "one period" in drawn


def test_json_in_a_script_can_neither_end_it_nor_open_a_comment() -> None:
    text = safe_json({"a": ["</script>", "<!--", "]]>", "\u2028", "&lt;"]})
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == {"a": ["</script>", "<!--", "]]>", "\u2028", "&lt;"]}


def test_what_a_float32_cannot_hold_is_unknown_on_the_page() -> None:
    raw = base64.b64decode(signals.encode(np.array([1.5, 1e300, -math.inf, math.nan, -3.0])))
    np.testing.assert_array_equal(np.frombuffer(raw, "<f4"), [1.5, math.nan, math.nan, math.nan, -3.0])
