"""How many deviations an axis' queries need together: against draws of correlated Gaussians, of a posterior's, and by
the independent checker."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest
from barriers import inputs, turns
from certificates import ESTIMATE, MODEL, known_vehicle
from scipy.stats import binom, multivariate_normal, norm, wishart

from flightstack.barrier.budgets import budget
from flightstack.barrier.hull_sigmas import Sides, sigmas
from flightstack.barrier.knowledge import Envelope, InitialKnowledge, Knowledge, Request
from flightstack.barrier.posterior import Posterior
from flightstack.barrier.queries import queries
from flightstack.barrier.response import C_LEAD_THRUST, CHAIN, STATE, lead
from flightstack.certificate_check.knowledge import Box, read, tables
from flightstack.certificate_check.reading import Refused
from flightstack.certificate_check.together import Asked, check_together
from flightstack.frames import quat_from_rotation_vector
from flightstack.model import Limits
from flightstack.types import F64
from flightstack.types import STANDARD_GRAVITY_MPS2 as G

DRAWS = 10_000
AXES = ((-0.8, 0.8), (-0.8, 0.8), (-0.9, 0.9))


def sides(low: F64, sigma: F64, sure: float = math.inf) -> Sides:
    none = np.zeros(low.shape)
    return Sides(low, low, sigma, none - sure, none + sure, none, none)


def outside(low: F64, sigma: F64, k: float, drawn: F64) -> float:
    """Share of draws (n, groups, queries) of which any leaves its group's hull."""
    least, most = (low - k * sigma).min(axis=1)[:, None], (low + k * sigma).max(axis=1)[:, None]
    return float(((drawn < least) | (drawn > most)).any(axis=(1, 2)).mean())


@pytest.mark.parametrize("freedom", [30, 60, 1000], ids=["hardly", "somewhat", "not"])
def test_correlated_draws_leave_their_hulls_no_more_often_than_the_union_allows(freedom: int) -> None:
    rng, groups, each = np.random.default_rng(freedom), 3, 10
    covariance = wishart.rvs(freedom, np.eye(groups * each) / freedom, random_state=rng)
    covariance *= np.outer(*[rng.uniform(0.2, 1.0, groups * each)] * 2) ** 0.5
    mean = rng.normal(0.0, 0.3, (groups, each))
    sigma = np.sqrt(np.diag(covariance)).reshape(groups, each)
    union = float(norm.isf(0.02 / (2 * groups * each)))
    k = sigmas(sides(mean, sigma), union)
    drawn = multivariate_normal(mean.ravel(), covariance).rvs(DRAWS, random_state=rng).reshape(DRAWS, groups, each)
    assert k < union - 0.1
    left = round(DRAWS * outside(mean, sigma, k, drawn))
    assert binom.sf(left - 1, DRAWS, 0.02) > 1e-3, "no more than chance has of 0.02"
    assert outside(mean, sigma, k - 0.8, drawn) > 0.02, "the test can tell"


def test_single_bounds_keep_the_unions_deviations_and_what_is_sure_does_not_fail() -> None:
    mean, sigma = np.zeros((5, 1)), np.ones((5, 1))
    assert sigmas(sides(mean, sigma), 3.0) == pytest.approx(3.0, abs=1e-3)
    assert sides(mean, sigma, sure=1.0).outside(2.5) == 0.0
    assert sides(mean, sigma).outside(2.5) == pytest.approx(10.0 * norm.sf(2.5))


def three_axes() -> Knowledge:
    envelope, box = (
        Envelope(AXES, (0.5, 2.5), nodes=6),
        budget(MODEL, Limits(), sideways_mps2=((-1.0, 2.0), (-1.5, 1.5)), low_mps2=4.0),
    )
    return Knowledge.of(
        Request(known_vehicle(80), MODEL, envelope, box, InitialKnowledge(), attitude_mps2=np.array(ESTIMATE.acc_mps2))
    )


def textbook(posterior: Posterior, x: F64) -> tuple[F64, F64]:
    """Mean (n, outputs) and covariance (n, n) at x: Rasmussen and Williams, equations 2.23 and 2.24."""
    process = posterior.process
    gram = process.kernel.matrix(process.x, process.x) + process.noise_var * np.eye(len(process.x))
    cross = process.kernel.matrix(process.x, x)
    return cross.T @ np.linalg.solve(gram, process.y), process.kernel.matrix(x, x) - cross.T @ np.linalg.solve(
        gram, cross
    )


def test_draws_of_the_posterior_stay_within_the_vertical_table() -> None:
    """The accelerations at all queries of down together, three processes, with the excess apart at each query."""
    known, rng = three_axes(), np.random.default_rng(3)
    request, table = known.request, known.authorities[2]
    asked = queries(request.envelope, request.box, MODEL.rotor_radius_m, 2, None)
    nodes, ends, count = asked.speed_mps.shape[:3]
    speed, thrust = asked.speed_mps.reshape(-1, 3), asked.thrust_mps2.reshape(-1, 3)
    x = inputs(speed, thrust, np.broadcast_to(asked.near, (nodes, ends, count)).ravel())
    along = turns(x[:, 3], x[:, 4])[:, 2, :]
    assert request.learned is not None
    drag = np.array([0.5 * sum(MODEL.drag_kgps[:2])] * 2 + [MODEL.drag_kgps[2]]) / MODEL.mass_kg
    mean, covariance = G - thrust[:, 2] - np.sum(along * drag * x[:, :3], axis=1), np.zeros((len(x), len(x)))
    for posterior, columns in ((request.learned.lateral, slice(0, 2)), (request.learned.vertical, slice(2, 3))):
        found, together = textbook(posterior, x)
        mean = mean + np.sum(along[:, columns] * found, axis=1)
        covariance += together * (along[:, columns] @ along[:, columns].T) * 1.21
        covariance += np.diag(along[:, columns] ** 2 @ posterior.process.excess)
    drawn = multivariate_normal(mean, covariance, allow_singular=True).rvs(DRAWS, random_state=rng)
    middles, errors = (table.u_low_mps2, table.u_high_mps2), (table.error_low_mps2, table.error_high_mps2)
    off = np.abs(drawn.reshape(DRAWS, nodes, ends, count) - np.stack(middles, axis=1)[None, :, :, None])
    beyond = (off > np.stack(errors, axis=1)[None, :, :, None]).any(axis=(1, 2, 3)).mean()
    allowed = 6.0 * known.delta / math.pi**2 / 3.0
    assert known.k_queries[2] < known.k_sigma - 0.2
    assert beyond <= allowed
    assert (off > 0.5 * np.stack(errors, axis=1)[None, :, :, None]).any(axis=(1, 2, 3)).mean() > allowed


def test_the_checker_refuses_fewer_deviations_than_the_queries_need() -> None:
    known = three_axes()
    made = known.budget
    box = Box(np.array(made.leans), made.lean_spare, made.low_mps2, made.high_mps2)
    for axis in range(3):
        data = copy.deepcopy(known.as_json())
        tables(read(data, box, known.delta, known.k_sigma, 1))
        data["k_queries"][axis] -= 0.01  # type: ignore[index]
        with pytest.raises(Refused, match="k_queries"):
            tables(read(data, box, known.delta, known.k_sigma, 1))


def test_z_is_off_by_the_attitudes_error_at_the_thrust_it_is_built_with() -> None:
    """The ledger counts c1 lead of speed for it; a tilt that is off by 3 mrad, by the filter's own prediction."""
    chain, response = np.zeros(CHAIN), np.array([[0.1, 0.004, 0.0]] * 3)
    chain[C_LEAD_THRUST], state = 12.0, np.zeros(STATE)
    state[6] = 1.0
    tilted = state.copy()
    tilted[6:10] = quat_from_rotation_vector(np.array([0.0, 0.003, 0.0]))
    true, seen = (lead(chain, each, response, 0, 0.0, 0.9) for each in (state, tilted))
    at_lead = 0.9 * 12.0 * math.sin(0.003)
    assert abs(seen[1] - true[1]) == pytest.approx(0.1 * at_lead, rel=1e-9)
    assert abs(seen[0] - true[0]) == pytest.approx(0.004 * at_lead, rel=1e-9)


def test_a_hull_that_ends_at_what_is_sure_does_not_fail_by_rounding() -> None:
    """Each query's interval is what is sure of it alone, shifted by numbers that no double holds exactly."""
    rng, none = np.random.default_rng(5), np.zeros((1000, 1))
    sure, shift = rng.uniform(-5.0, 5.0, (1000, 1)), rng.uniform(-5.0, 5.0, (1000, 1))
    tied = Sides(sure, sure, none + 1.0, sure, sure, shift, shift)
    assert tied.outside(2.5) == 0.0
    again = Asked(*(each + shift - shift for each in (sure, sure)), sure, sure, none + 1.0, sure, sure)
    check_together([again], False, 2.5, 3.0)
