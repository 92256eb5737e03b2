"""What is kept between flights: fitted to real windows, tied to vehicle and data, refused where it doesn't belong."""

from __future__ import annotations

import json

import numpy as np
import pytest
from shipped import load_vehicle
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel

from flightstack.gp import Constant, Linear
from flightstack.learning import sampler as s
from flightstack.learning.priors import default_priors
from flightstack.learning.stored import StoredPriors, fit_priors, parse_stored, to_json
from flightstack.learning.windows import SampleWindows
from flightstack.types import F64, InputError
from flightstack.vehicle import scaled

QUAD = load_vehicle("quad-x")
NOISE = 0.05


def recorded(count: int = 160, seed: int = 0) -> SampleWindows:
    """Windows of a world with linear drag of 0.7 / s and thrust that gives 80 %."""
    rng = np.random.default_rng(seed)
    x = np.zeros((count, s.D))
    x[:, : s.V_Z + 1] = rng.normal(scale=2.0, size=(count, 3))
    x[:, s.AXIS_N : s.AXIS_E + 1] = rng.normal(scale=0.2, size=(count, 2))
    x[:, s.THRUST] = rng.uniform(0.7, 1.4, size=count)
    y = np.zeros((count, 3))
    y[:, :2] = -0.7 * x[:, :2]
    y[:, 2] = 0.2 * 9.80665 * x[:, s.THRUST]
    y += rng.normal(scale=NOISE, size=y.shape)
    rate_x = rng.normal(size=(count, 3))
    return SampleWindows(x, y, rate_x, 0.05 * rate_x + rng.normal(scale=0.02, size=rate_x.shape))


@pytest.fixture(scope="module")
def stored() -> StoredPriors:
    return fit_priors(QUAD, recorded())


def likelihood(prior_kernel: F64, noise_var: float, y: F64) -> float:
    """scikit-learn's marginal likelihood of one output for a kernel matrix, through a precomputed-kernel shift."""
    sign, logdet = np.linalg.slogdet(prior_kernel + noise_var * np.eye(len(y)))
    assert sign > 0
    alpha = np.linalg.solve(prior_kernel + noise_var * np.eye(len(y)), y)
    return float(-0.5 * (y @ alpha + logdet + len(y) * np.log(2.0 * np.pi)))


def test_the_fit_finds_the_noise_and_explains_the_data(stored: StoredPriors) -> None:
    assert np.sqrt(stored.priors.lateral.noise_var) == pytest.approx(NOISE, rel=0.15)
    assert np.sqrt(stored.priors.vertical.noise_var) == pytest.approx(NOISE, rel=0.2)
    data = recorded(seed=1)
    fitted, default = (
        likelihood(prior.kernel.matrix(data.x), prior.noise_var, data.y[:, 0])
        for prior in (stored.priors.lateral, default_priors().lateral)
    )
    assert fitted > default, "data it has not seen are likelier than under the prior it began with"


def test_the_helper_above_is_scikit_learns_likelihood() -> None:
    x = np.linspace(0.0, 1.0, 12)[:, None]
    y = np.sin(3.0 * x[:, 0])
    model = GaussianProcessRegressor(ConstantKernel(0.7, "fixed"), alpha=0.1, optimizer=None).fit(x, y)
    ours = likelihood(np.full((12, 12), 0.7), 0.1, y)
    assert ours == pytest.approx(model.log_marginal_likelihood_value_)


def test_a_file_reads_back_as_it_was_written(stored: StoredPriors) -> None:
    again = parse_stored(to_json(stored), "a.json", QUAD)
    assert again == stored
    assert to_json(again) == to_json(stored)


def test_the_same_data_give_the_same_bytes(stored: StoredPriors) -> None:
    assert to_json(fit_priors(QUAD, recorded())) == to_json(stored)
    assert fit_priors(QUAD, recorded(seed=2)).data_hash != stored.data_hash


def test_a_file_of_another_vehicle_is_refused(stored: StoredPriors) -> None:
    heavier = scaled(QUAD, mass_ratio=1.01)
    with pytest.raises(InputError, match=r"a\.json: fitted for vehicle 'quad-x' with another vehicle file"):
        parse_stored(to_json(stored), "a.json", heavier)


def test_too_little_flight_is_refused() -> None:
    short = SampleWindows(*(part[:20] for part in recorded()))
    with pytest.raises(InputError, match="20 windows of flight are too few"):
        fit_priors(QUAD, short)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(schema="other/1"), "not a"),
        (lambda d: d.update(extra=1), "unknown key extra"),
        (lambda d: d["stores"].pop("vertical"), r"stores\.vertical is missing"),
        (lambda d: d["stores"]["lateral"].update(noise_var=-1.0), r"stores\.lateral\.noise_var"),
        (lambda d: d["stores"]["lateral"].update(noise_var=float("nan")), r"stores\.lateral\.noise_var"),
        (lambda d: d["stores"]["rates"].update(kernel={"kind": "magic"}), r"stores\.rates\.kernel"),
        (lambda d: d.update(stores=3), "stores must be a table"),
    ],
)
def test_a_damaged_file_is_named_in_one_line(stored: StoredPriors, change: object, words: str) -> None:
    data = json.loads(to_json(stored))
    change(data)  # type: ignore[operator]
    with pytest.raises(InputError, match=words) as caught:
        parse_stored(json.dumps(data), "a.json", QUAD)
    assert "\n" not in str(caught.value)
    assert "a.json" in str(caught.value)


def test_text_that_is_no_json_is_refused() -> None:
    with pytest.raises(InputError, match="not valid JSON"):
        parse_stored("{", "a.json", QUAD)


def test_kernels_are_sums_of_named_physics(stored: StoredPriors) -> None:
    kinds = str(stored.priors.vertical.kernel.to_dict())
    assert all(name in kinds for name in ("constant", "linear", "squared_exponential"))
    assert isinstance(Constant(1.0) + Linear(1.0, 0), type(stored.priors.vertical.kernel))
