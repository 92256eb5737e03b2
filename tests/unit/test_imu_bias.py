"""The accelerometer bias that the filter takes out, told by the stream that has it."""

from __future__ import annotations

import numpy as np

from flightstack.imu_bias import ImuBias
from flightstack.predictor import Streams, predict

SECONDS = 20


def run(bias: ImuBias, true: np.ndarray, *, late: int, seed: int = 1) -> np.ndarray:
    """b as found after 20 s at 250 Hz and 25 Hz, the raw samples in whole mG and `late` by so many."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(SECONDS * 250, 3)) * [0.35, 1.2, 1.0] + [0.0, 0.0, -9.8]
    for k, sample in enumerate(noise):
        slow = true * min(k / 2500.0, 1.0)
        bias.reported(tuple(sample - slow))
        if k % 10 == 0 and k >= late:
            raw = np.trunc(noise[k - late] / 9.80665e-3) * 9.80665e-3
            bias.raw(4000 * k, tuple(raw))
    return bias.bias_frd_mps2


def test_it_is_found_within_two_hundredths_whatever_the_stamps() -> None:
    true = np.array([-0.35, 0.25, 0.02])
    for late in (0, 1, 3):
        np.testing.assert_allclose(run(ImuBias(), true, late=late), true, atol=0.02)


def test_one_that_moves_as_on_a_real_px4_is_followed_whatever_was_believed() -> None:
    """x by 0.25 m/s^2 within half a second (after a take-off), every tenth reported sample lost, 60 s."""
    rng = np.random.default_rng(4)
    white = rng.normal(size=(60 * 250 + 1, 3)) * [0.5, 1.7, 1.4]
    noise = 0.5 * (white[1:] + white[:-1]) + [0.0, 0.0, -9.8]
    bias = ImuBias()
    for k, sample in enumerate(noise):
        true = np.array([-0.25 * min(max(k / 250.0 - 5.0, 0.0) / 0.5, 1.0), 0.1, -0.02])
        if rng.random() > 0.1:
            bias.reported(tuple(sample - true))
        if k % 10 == 0:
            bias.raw(4000 * k, tuple(np.trunc(sample / 9.80665e-3) * 9.80665e-3))
            if k > 250 * 11:
                np.testing.assert_allclose(bias.bias_frd_mps2, true, atol=0.03)


def test_where_raw_samples_are_of_another_sensor_nothing_is_told() -> None:
    rng = np.random.default_rng(5)
    bias = ImuBias()
    for k in range(60 * 250):
        bias.reported(tuple(rng.normal(size=3) * [0.35, 1.2, 1.0] + [0.0, 0.0, -9.8]))
        if k % 10 == 0:
            bias.raw(4000 * k, tuple(rng.normal(size=3) * [0.35, 1.2, 1.0] + [0.3, 0.0, -9.8]))
    np.testing.assert_array_equal(bias.bias_frd_mps2, np.zeros(3))


def test_a_pair_that_is_none_changes_nothing() -> None:
    bias = ImuBias()
    rng = np.random.default_rng(2)
    for k in range(2000):
        bias.reported(tuple(rng.normal(size=3) + np.array([0.0, 0.0, -9.8])))
        if k % 200 == 0:
            bias.raw(4000 * k, (0.0, 0.0, 9.8))
            bias.raw(4000 * k, (np.nan, 0.0, 0.0))
    np.testing.assert_array_equal(bias.bias_frd_mps2, np.zeros(3))


def test_only_of_an_estimator_that_contradicts_itself_the_bias_is_put_back() -> None:
    """c of 0.3 m/s: given back whole; agreement: left as reported."""
    for c, share in ((0.3, 0.95), (0.0, 0.0)):
        streams, slow = Streams(), 0.2
        for k in range(5000):
            t_us = 4000 * (k + 1)
            streams.attitude(t_us, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
            streams.imu(t_us, (-slow, 0.0, -9.8), (0.0, 0.0, 0.0))
            if k % 2 == 0:
                streams.position(t_us, (c * 1e-6 * t_us, 0.0, 0.0), (0.0, 0.0, 0.0))
            if k % 10 == 0:
                streams.raw_imu(t_us, (0.0, 0.0, -9.8))
        seen = predict(streams, t_us)
        assert seen is not None
        np.testing.assert_allclose(seen.specific_force_frd_mps2[0], (share - 1.0) * slow, atol=0.02)
