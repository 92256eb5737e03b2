"""Certificates of learned random plants, held against physics (the full count: `python -m benchmarks.plants`)."""

import math

import numpy as np
import pytest
from scipy.stats import binomtest

from benchmarks import plants
from flightstack.barrier.physics import PhysicalPlant, mu_physics, state_only


def test_a_hundred_learned_plants_are_refuted_no_more_often_than_stated() -> None:
    found = plants.count(100, seed=1, delta=0.05)
    assert binomtest(found.refuted, found.plants, 0.05, alternative="greater").pvalue > 0.01
    assert found.certified == found.plants
    assert 0.0 < found.excess < 0.05  # near what physics allows, and above


def test_the_count_can_fail_a_residual_of_the_state_alone_is_refuted_by_most_heavier_plants() -> None:
    found = plants.count(40, seed=1, delta=0.05, affine=False)
    assert found.refuted > 20


def test_without_noise_both_ways_claim_what_they_should() -> None:
    plant = PhysicalPlant(1.4, (0.05, -0.02, 0.03))
    flight = plants.fly(plant, 0.0, np.random.default_rng(0))
    affine, state = (plants.certified_mu(flight, 0.05, affine=each) for each in (True, False))
    assert affine == pytest.approx(mu_physics(plant, plants.REGION, lateral=False), rel=0.02)
    assert state == pytest.approx(mu_physics(state_only(plant), plants.REGION, lateral=False), rel=0.02)


def test_the_interval_is_clopper_and_pearson_s() -> None:
    for refuted in (0, 3, 100):
        found = plants.Count(100, 100, 100, refuted, 0.0)
        exact = binomtest(refuted, 100).proportion_ci(0.95, "exact")
        assert found.interval() == pytest.approx((exact.low, exact.high), abs=1e-9)


def test_where_authority_is_gone_nothing_is_certified() -> None:
    plant = PhysicalPlant(1.75, (0.0, 0.0, 0.05))
    assert mu_physics(plant, plants.REGION, lateral=False) == math.inf
    assert plants.certified_mu(plants.fly(plant, 0.05, np.random.default_rng(0)), 0.05, affine=True) == math.inf
