"""What a certificate may count on: before take-off in closed form, from data against scikit-learn and the truth."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from shipped import load_scenario, load_vehicle
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from flightstack.barrier.budgets import budget
from flightstack.barrier.knowledge import (
    Envelope,
    InitialKnowledge,
    Knowledge,
    Request,
    confidence,
    require_authority,
    vertical_authority_weights,
)  # fmt: skip
from flightstack.barrier.posterior import Accelerations, Posterior, Process, sized_steps
from flightstack.gp import Kernel, SquaredExponential
from flightstack.gp.kernels import kernel_from_dict
from flightstack.learning.priors import default_priors
from flightstack.model import Limits, Model
from flightstack.scenario import parse_scenario
from flightstack.types import F64, InputError
from flightstack.types import STANDARD_GRAVITY_MPS2 as G

MODEL = Model.from_vehicle(load_vehicle("quad-x"))
LIMITS = Limits()
BOX = budget(MODEL, LIMITS)
VERTICAL = Envelope(((-1.0, 1.0), (-1.0, 1.0), (-2.0, 2.0)), (0.2, 1.4), 5, axes=(2,))
HIGH_UP = VERTICAL._replace(heights_m=(1e6, 1e6 + 1.0))


@pytest.mark.parametrize("name", ["paper-barrier", "paper-tracking"])
def test_the_papers_scenarios_leave_just_the_authority_that_is_needed(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.knowledge == InitialKnowledge((0.8, 1.5), 0.15)
    assert require_authority(scenario.knowledge, MODEL, scenario.limits) == pytest.approx(0.05)


def test_too_little_authority_is_one_line_with_its_figures() -> None:
    with pytest.raises(InputError, match=r"^mine: 1\.8 .* 1\.55 times .* 0\.15 g down leave 0\.011 g .* 0\.05 g"):
        require_authority(InitialKnowledge((0.8, 1.55), 0.15), MODEL, LIMITS, "mine")


def test_authority_with_a_horizontal_force_is_the_papers() -> None:
    assert vertical_authority_weights(1.8, 1.4, (0.1, 0.0, 0.0)) == pytest.approx(0.2818, abs=5e-5)
    around = [
        vertical_authority_weights(1.8, 1.5, (0.15 * math.cos(t), 0.0, 0.15 * math.sin(t)))
        for t in np.linspace(-math.pi, math.pi, 721)
    ]
    assert min(around) == pytest.approx(0.05)
    assert vertical_authority_weights(0.1, 1.0, (0.2, 0.0, 0.0)) == -math.inf


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("mass_ratio = [1.5, 0.8]\nforce_weights = 0.1", "must begin with the least"),
        ("mass_ratio = 1.4\nforce_weights = 0.1", "list of 2 numbers"),
        ("mass_ratio = [0.8, 1.5]", "force_weights = missing"),
        ("mass_ratio = [0.8, 1.5]\nforce_weights = 0.1\nwind = 1", "unknown key wind"),
    ],
)
def test_a_wrong_knowledge_table_is_one_line(line: str, what: str) -> None:
    text = (
        'schema = "flightstack.scenario/1"\nname = "s"\ndescription = "d"\nduration_s = 5\n[trajectory]\n'
        'kind = "hover"\nposition_m = [0, 0, -1]\n[knowledge]\n' + line
    )
    with pytest.raises(InputError, match=what) as error:
        parse_scenario(text, "file")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("mass", "force", "sigma", "mu"),
    [
        (1.4, 0.0, 0.0, 0.594631), (1.4, 0.1, 0.0, 0.914817), (1.0, 0.0, 0.0, 0.2124), (1.4, 0.0, 0.05, 0.6054),
        (1.4, 0.0, 0.1, 0.6166), (1.4, 0.0, 0.2, 0.6403), (1.4, 0.0, 0.3, 0.6659), (1.4, 0.0, 0.5, 0.7237),
        (1.4, 0.0, 1.0, 0.9245),
    ],
)  # fmt: skip
def test_braking_that_is_left_gives_the_papers_least_mu(mass: float, force: float, sigma: float, mu: float) -> None:
    known = Knowledge.of(Request(None, MODEL, HIGH_UP, BOX, InitialKnowledge((mass, mass), force)))
    authority = known.authorities[2]
    braking = -float(authority.u_low_mps2[0] + authority.error_low_mps2[0]) * 9.81 / G - sigma
    assert (0.6 / 0.36) / braking == pytest.approx(mu, abs=1e-4)


def test_initial_knowledge_is_exact_at_its_corners() -> None:
    box = budget(MODEL, LIMITS, sideways_mps2=((-0.5, 1.0), (-1.0, 1.0)), low_mps2=5.0, hover_mps2=G)
    known = Knowledge.of(Request(None, MODEL, HIGH_UP, box, InitialKnowledge()))
    a = known.authorities[2]
    for thrust, middle, error in (
        (box.high_mps2, a.u_low_mps2, a.error_low_mps2), (box.low_mps2, a.u_high_mps2, a.error_high_mps2),
    ):  # fmt: skip
        corners = [G - thrust / mass + 0.15 * G * sign for mass in (0.8, 1.5) for sign in (-1.0, 1.0)]
        np.testing.assert_allclose(middle + error, max(corners))
        np.testing.assert_allclose(middle - error, min(corners))
    np.testing.assert_allclose(a.offset_mps2 - a.gain * box.high_mps2, a.u_low_mps2)


def test_posterior_is_scikit_learns() -> None:
    rng = np.random.default_rng(3)
    x, y, at = rng.normal(size=(80, 7)), rng.normal(size=(80, 2)), rng.normal(size=(25, 7))
    scales = (1.0, 2.0, 0.7, 1.5, 3.0, 1.1, 0.9)
    oracle = GaussianProcessRegressor(ConstantKernel(0.8) * RBF(scales), alpha=0.01, optimizer=None).fit(x, y)
    ours = Posterior(Process(SquaredExponential(0.8, scales), 0.01, x, y, np.zeros(2)))
    mean, variance = ours.at(at)
    expected, sigma = oracle.predict(at, return_std=True)
    np.testing.assert_allclose(mean, expected, atol=1e-9)
    np.testing.assert_allclose(np.sqrt(variance), sigma[:, 0], atol=1e-9)
    likelihood = ours.log_likelihood - 80 * math.log(2.0 * math.pi)
    assert likelihood == pytest.approx(oracle.log_marginal_likelihood_value_, rel=1e-9)


@pytest.mark.parametrize(
    ("kernel", "constant", "linear", "smooth"),
    [
        (default_priors().lateral.kernel, 1.0, [0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0], 0.6),
        (default_priors().vertical.kernel, 0.05, [0.0, 0.0, 0.3, 1.0, 1.0, 0.4 * G, G], 0.12),
    ],
)
def test_posteriors_at_places_that_differ_in_thrust_alone_are_those_of_the_whole_covariance(
    kernel: Kernel, constant: float, linear: list[float], smooth: float
) -> None:
    """The flights' own priors; at four places with three thrusts each, at one twice, and elsewhere."""

    def whole(a: F64, b: F64) -> F64:
        near = RBF((4.0, 4.0, 4.0, 0.5, 0.5))(a[:, :5], b[:, :5])
        return np.asarray(constant**2 + (a * np.square(linear)) @ b.T + smooth**2 * near)

    rng = np.random.default_rng(4)
    low, high = np.array([-2.0, -2.0, -1.0, -0.3, -0.3, 0.7, 0.0]), np.array([2.0, 2.0, 1.0, 0.3, 0.3, 1.5, 0.1])
    x, y, at = rng.uniform(low, high, (80, 7)), rng.normal(0.0, 0.3, (80, 2)), rng.uniform(low, high, (17, 7))
    at[4:12, :5], at[12] = np.tile(at[:4, :5], (2, 1)), at[3]
    mean, variance = Posterior(Process(kernel, 0.045**2, x, y, np.zeros(2))).at(at)
    gram, cross = whole(x, x) + 0.045**2 * np.eye(len(x)), whole(x, at)
    np.testing.assert_allclose(mean, cross.T @ np.linalg.solve(gram, y), atol=1e-9)
    expected = np.diag(whole(at, at)) - np.sum(cross * np.linalg.solve(gram, cross), axis=0)
    np.testing.assert_allclose(variance, expected, atol=1e-9)
    assert variance.min() > 1e-4, "far more than what is allowed"


def cushion(height_m: np.ndarray, strength: float) -> np.ndarray:
    """Thrust over thrust far away: I. Cheeseman and W. Bennett, 1955, with a strength."""
    return 1.0 / (1.0 - strength * (MODEL.rotor_radius_m / (4.0 * height_m)) ** 2)


def plant(
    rng: np.random.Generator, points: int = 100, ground: float | None = None
) -> tuple[Accelerations, float, np.ndarray]:
    """A true mass ratio and a true force (m/s^2, NED), and what processes learn of them in an upright flight.

    `ground`: strength of a ground effect; then the flight goes from 0.2 to 1.4 m, else far above.
    """
    mass, direction = rng.uniform(0.8, 1.5), rng.normal(size=3)
    force = rng.uniform(0.0, 0.15) * G * direction / np.linalg.norm(direction)
    x = np.zeros((points, 7))
    x[:, :3] = rng.uniform(-0.3, 0.3, (points, 3))
    x[:, 5] = np.clip(mass * (1.0 + force[2] / G) + rng.normal(0.0, 0.1, points), 0.2, 1.8)
    lifts = np.ones(points)
    if ground is not None:
        height = rng.uniform(0.2, 1.4, points)
        lifts = cushion(height, ground)
        x[:, 6] = x[:, 5] * (MODEL.rotor_radius_m / (4.0 * height)) ** 2
    residual = force + np.outer(x[:, 5] * G * (1.0 - lifts / mass), [0.0, 0.0, 1.0])
    noisy = residual + rng.normal(0.0, 0.03, residual.shape)
    priors = default_priors()
    found = []
    for prior, columns in ((priors.lateral, slice(0, 2)), (priors.vertical, slice(2, 3))):
        y = noisy[:, columns]
        process = Process(prior.kernel, 0.03**2, x, y, np.full(y.shape[1], 1e-5))
        *_, sized = sized_steps(process)
        found.append(sized)
    return Accelerations(found[0], found[1], MODEL), float(mass), force


def test_certified_braking_is_what_the_true_plant_has_in_all_but_delta_of_plants() -> None:
    rng, refuted, plants = np.random.default_rng(11), 0, 120
    envelope = VERTICAL._replace(slice_only=True)
    for _ in range(plants):
        learned, mass, force = plant(rng)
        known = Knowledge.of(Request(learned, MODEL, envelope, BOX, InitialKnowledge()))
        a, box = known.authorities[2], known.budget
        true_low, true_high = (G + force[2] - thrust / mass for thrust in (box.high_mps2, box.low_mps2))
        off_low = np.abs(true_low - a.u_low_mps2) > a.error_low_mps2
        off_high = np.abs(true_high - a.u_high_mps2) > a.error_high_mps2
        refuted += bool(off_low.any() or off_high.any())
        assert float(a.error_low_mps2.max()) < 0.67 * G * 0.6  # far better than before any data
    assert refuted <= 0.05 * plants


@pytest.mark.parametrize("issued", [0, 1, 7])
def test_all_certificates_together_fail_with_delta_at_most(issued: int) -> None:
    """However many are issued, the last one with what is left: by the tail of the normal distribution."""
    k = [confidence(0.05, n, 30) for n in range(1, issued + 1)] + [confidence(0.05, issued + 1, 30, last=True)]
    assert sum(30 * 2 * norm.sf(each) for each in k) == pytest.approx(0.05)
    assert sum(30 * 2 * norm.sf(confidence(0.05, n, 30)) for n in range(1, 4000)) == pytest.approx(0.05, rel=1e-3)


def test_the_last_certificates_braking_is_true_from_the_least_height_to_the_greatest() -> None:
    """With a ground effect of none to one and a half times Cheeseman and Bennett's, which the flight has met."""
    rng, refuted, plants, narrower = np.random.default_rng(12), 0, 60, []
    envelope = VERTICAL._replace(slice_only=True)
    heights = np.linspace(0.2, 1.4, 40)
    for _ in range(plants):
        strength = float(rng.uniform(0.0, 1.5))
        learned, mass, force = plant(rng, ground=strength)
        before, last = (
            Knowledge.of(Request(learned, MODEL, envelope, BOX, InitialKnowledge(), last=last))
            for last in (False, True)
        )
        assert before is not None
        assert last is not None
        a, box = last.authorities[2], last.budget
        for thrust, middle, error in (
            (box.high_mps2, a.u_low_mps2, a.error_low_mps2), (box.low_mps2, a.u_high_mps2, a.error_high_mps2),
        ):  # fmt: skip
            true = G + force[2] - thrust / mass * cushion(heights, strength)
            refuted += bool((np.abs(true[:, None] - middle) > error).any())
        narrower.append(a.error_low_mps2.max() / before.authorities[2].error_low_mps2.max())
    assert refuted <= 0.05 * plants
    assert max(narrower) < 1.0
    assert np.mean(narrower) < 0.8


def test_a_learner_that_knows_no_ground_says_nothing_of_it() -> None:
    learned, _, _ = plant(np.random.default_rng(13))
    process = learned.vertical.process
    blind = Posterior(replace(process, kernel=SquaredExponential(4.0, 2.0, (0, 1, 2, 3, 4, 5))))
    envelope = VERTICAL._replace(slice_only=True)
    errors = []
    for last in (False, True):
        known = Knowledge.of(Request(Accelerations(learned.lateral, blind, MODEL), MODEL, envelope, BOX, last=last))
        errors.append(known.authorities[2].error_low_mps2.min())
    ground = 2.0 * (MODEL.rotor_radius_m / 0.8) ** 2 * known.budget.high_mps2
    assert errors[1] > 0.5 * ground
    assert errors[1] == pytest.approx(errors[0], rel=0.2), "the sigmas apart"


def test_bounds_at_the_nodes_are_mean_and_k_sigma_of_an_independent_computation() -> None:
    learned, _, _ = plant(np.random.default_rng(5), 60)
    envelope = VERTICAL._replace(slice_only=True, nodes=3)
    known = Knowledge.of(Request(learned, MODEL, envelope, BOX))
    data = known.as_json()
    store = data["vertical"]
    assert isinstance(store, dict)
    kernel, x, y = kernel_from_dict(store["kernel"]), np.array(store["x"]), np.array(store["y"])
    gram = kernel.matrix(x) + store["noise_var"] * np.eye(len(x))
    assert known.k_sigma == pytest.approx(confidence(0.05, 1, 2 * (3 + 2)))
    far, close = ((MODEL.rotor_radius_m * 0.25 / h) ** 2 for h in (1.4, 0.2))
    for thrust, middle, error in (
        (known.budget.high_mps2, known.authorities[2].u_low_mps2, known.authorities[2].error_low_mps2),
        (known.budget.low_mps2, known.authorities[2].u_high_mps2, known.authorities[2].error_high_mps2),
    ):
        queries = np.zeros((1, 7))
        queries[:, 5], queries[:, 6] = thrust / G, far * thrust / G
        cross = kernel.matrix(x, queries)
        mean = G - thrust + (cross.T @ np.linalg.solve(gram, y))[:, 0]
        latent = kernel.diagonal(queries) - np.einsum("ij,ij->j", cross, np.linalg.solve(gram, cross))
        half = known.k_sigma * np.sqrt(store["inflation"][0] ** 2 * latent + store["excess"][0])
        low, high = (mean - half).min() - 2.0 * close * thrust, (mean + half).max()
        assert middle[1] == pytest.approx(0.5 * (low + high), abs=1e-7)
        assert error[1] >= 0.5 * (high - low) - 1e-9
        assert error[1] <= 0.5 * (high - low) + 0.5
    blob = b"".join(
        np.array(data[name][key], "<f8").tobytes()  # type: ignore[index]
        for name in ("lateral", "vertical")
        for key in ("x", "y")
    )
    assert data["sha256"] == hashlib.sha256(blob).hexdigest()


def test_widening_adds_to_the_error_and_later_versions_ask_for_more_sigmas() -> None:
    learned, _, _ = plant(np.random.default_rng(6), 40)
    envelope = VERTICAL._replace(slice_only=True, nodes=3)
    plain = Knowledge.of(Request(learned, MODEL, envelope, BOX))
    wide = Knowledge.of(Request(learned, MODEL, envelope, BOX, widen_mps2=np.array([0.0, 0.0, 0.4])))
    np.testing.assert_allclose(
        wide.authorities[2].error_low_mps2 - plain.authorities[2].error_low_mps2, np.full(3, 0.4)
    )
    assert confidence(0.05, 2, 100) > confidence(0.05, 1, 100)
    total = sum(2 * 100 * 0.5 * math.erfc(confidence(0.05, n, 100) / math.sqrt(2.0)) for n in range(1, 2000))
    assert total == pytest.approx(0.05, rel=1e-3)


def test_a_smooth_part_that_the_data_do_not_show_is_made_small_and_one_that_they_show_is_kept() -> None:
    rng = np.random.default_rng(8)
    kernel = default_priors().vertical.kernel + SquaredExponential(0.6**2, (4.0,) * 3 + (0.5,) * 2, columns=range(5))
    x = np.zeros((150, 7))
    x[:, :3], x[:, 3:5] = rng.uniform(-2.0, 2.0, (150, 3)), rng.uniform(-0.2, 0.2, (150, 2))
    x[:, 5] = rng.uniform(1.0, 1.6, 150)
    flat = 0.15 + 2.0 * x[:, 5:6] + rng.normal(0.0, 0.03, (150, 1))
    bent = flat + 0.6 * np.cos(1.2 * x[:, 2:3])
    *_, small = sized_steps(Process(kernel, 0.03**2, x, flat, np.zeros(1)))
    *_, large = sized_steps(Process(kernel, 0.03**2, x, bent, np.zeros(1)))
    far = np.zeros((1, 7))
    far[0, 3:6] = 0.3, 0.3, 1.8
    assert small.at(far)[1][0] < 0.05 * large.at(far)[1][0]
    assert large.process.kernel == kernel
