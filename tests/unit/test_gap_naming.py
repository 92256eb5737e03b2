"""The statistics of naming against closed forms and SciPy, on made-up columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import comb
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

from flightstack.gap.decisions import NAME_EVIDENCE
from flightstack.gap.identify import IN_PROPORTION, identify
from flightstack.gap.judge import pruned
from flightstack.gap.naming import whitening
from flightstack.gap.naming.candidates import candidates, members, negligible
from flightstack.gap.naming.design import design
from flightstack.gap.naming.estimate import estimate
from flightstack.gap.naming.evidence import Gram, all_subsets, fit_subsets, robust
from flightstack.gap.naming.metric import bounded_step
from flightstack.gap.naming.proportion import in_proportion, priced
from flightstack.gap.naming.search import SelectionState, search
from flightstack.gap.naming.whitening import Mask
from flightstack.gap.simulate import FreeParameter, value
from flightstack.types import F64
from flightstack.vehicle import Vehicle, parse_vehicle
from tests.thorough import thorough

_QUAD = Path(__file__).resolve().parents[2] / "flightstack/data/vehicles" / "quad-x.toml"


@pytest.fixture(scope="module")
def quad() -> Vehicle:
    return parse_vehicle(_QUAD.read_text("utf-8"), "quad-x.toml")


# --- whitening


def test_the_noise_model_is_the_one_that_made_the_noise() -> None:
    """e[t] = 1.2 e[t-1] - 0.5 e[t-2] + 0.3 n: 20 000 samples tell each coefficient to about 0.01."""
    rng = np.random.default_rng(1)
    e = lfilter([0.3], [1.0, -1.2, 0.5], rng.standard_normal(20_000))
    whitener = whitening.fit([e], [np.ones(20_000, dtype=bool)])
    assert whitener.taps[:3] == pytest.approx([1.0, -1.2, 0.5], abs=0.03)
    assert np.abs(whitener.taps[3:]).max() < 0.04
    assert whitener.sigma == pytest.approx(0.3, rel=0.03)


def test_whitened_least_squares_is_generalised_least_squares() -> None:
    """The same estimate as the closed form with the noise's Toeplitz covariance, but for the first ORDER rows."""
    rng = np.random.default_rng(2)
    n, phi = 900, 0.9
    e = lfilter([1.0], [1.0, -phi], rng.standard_normal(n))
    x = gaussian_filter1d(rng.standard_normal((n, 2)), 6.0, axis=0)
    y = x @ [2.0, -1.0] + e
    ok = np.ones(n, dtype=bool)
    exact = whitening.Whitener(np.concatenate([[1.0, -phi], np.zeros(whitening.ORDER - 1)]), 1.0)
    use = np.flatnonzero(whitening.whole_windows(ok, whitening.ORDER))
    both, white = np.column_stack([x, y])[:, None, :], np.empty((len(use), 3))
    whitening.whiten(exact.taps, both, 0, use, white)
    mine = np.linalg.lstsq(white[:, :2], white[:, 2], rcond=None)[0]
    k = whitening.ORDER - 1  # rows before enter through the filter only
    inverse = np.linalg.inv(toeplitz(phi ** np.arange(n - k)) / (1.0 - phi**2))
    closed = np.linalg.solve(x[k:].T @ inverse @ x[k:], x[k:].T @ inverse @ y[k:])
    assert mine == pytest.approx(closed, abs=0.03)


def test_a_gap_costs_as_many_rows_as_the_filter_is_long() -> None:
    ok = np.ones(100, dtype=bool)
    ok[40] = False
    assert whitening.whole_windows(ok, whitening.ORDER).sum() == 100 - 2 * whitening.ORDER - 1


# --- evidence


def _regression(rng: np.random.Generator, rows: int = 80, columns: int = 6) -> tuple[F64, F64]:
    return rng.standard_normal((rows, columns)), rng.standard_normal(rows)


def test_a_little_of_everything_is_the_dense_covariance() -> None:
    """K, b and c against (I + X T X')^-1 written out."""
    rng = np.random.default_rng(3)
    x, y = _regression(rng)
    t = rng.uniform(0.1, 3.0, 6)
    gram = robust(x.T @ x, x.T @ y, float(y @ y), 80.0, t)
    dense = np.linalg.inv(np.eye(80) + x @ np.diag(t**2) @ x.T)
    assert gram.k == pytest.approx(x.T @ dense @ x, abs=1e-9)
    assert gram.b == pytest.approx(x.T @ dense @ y, abs=1e-9)
    assert gram.c == pytest.approx(float(y @ dense @ y), abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_step_within_bounds_is_scipys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = _regression(rng, columns=3)
    low, high = np.full(3, -0.05), np.full(3, 0.1)
    step, used = bounded_step(x.T @ x, x.T @ y, low, high)
    oracle = lsq_linear(x, y, bounds=(low, high), method="bvls")
    cost = float(np.sum((y - x @ step) ** 2))
    assert cost <= 2.0 * oracle.cost * (1.0 + 1e-3)
    assert used == 3


def test_every_subset_gains_what_least_squares_gains() -> None:
    rng = np.random.default_rng(4)
    x, y = _regression(rng)
    columns = [np.array([0]), np.array([1, 2]), np.array([3, 4, 5])]
    wide = np.full(6, 1e9)
    subsets = all_subsets(3, 3, ["a", "b", "c"])
    for fitted in fit_subsets(Gram(x.T @ x, x.T @ y, float(y @ y), 80.0), subsets, columns, -wide, wide):
        use = [i for m in fitted.members for i in columns[m]]
        rest = y - x[:, use] @ np.linalg.lstsq(x[:, use], y, rcond=None)[0] if use else y
        assert fitted.gain == pytest.approx(float(y @ y - rest @ rest), abs=1e-6)
        assert fitted.used == len(use)


def test_a_coefficient_of_the_wrong_sign_takes_its_candidate_out() -> None:
    """y = -3 x0 + x1 where x0 may only be positive: the subset with x0 in it is out of the race."""
    rng = np.random.default_rng(5)
    x, _ = _regression(rng, columns=2)
    y = x @ [-3.0, 1.0]
    low, high = np.array([0.0, -9.0]), np.array([9.0, 9.0])
    gram = Gram(x.T @ x, x.T @ y, float(y @ y), 80.0)
    columns = [np.array([0]), np.array([1])]
    both, second = fit_subsets(gram, [(0, 1), (1,)], columns, low, high)
    assert both.gain == -np.inf
    assert second.gain > 0.0


def test_no_subset_holds_two_variants_of_one_effect() -> None:
    names = ["a", "a", "b", "c"]
    subsets = all_subsets(4, 3, names)
    assert len(subsets) == 1 + 4 + (comb(4, 2) - 1) + 2
    assert len(set(subsets)) == len(subsets)


# --- search and estimate on a made-up bench


@dataclass
class MadeUp:
    """A bench whose physics is linear: smooth random columns, coloured noise; two channels."""

    seed: int
    truth: dict[tuple[str, str], float]
    """(effect, parameter) -> distance from where it starts."""
    vehicle: Vehicle
    rows: int = 1200
    noise: float = 1.0
    _columns: dict[tuple[str, str, str], F64] = field(default_factory=dict)

    def _column(self, effect: str, parameter: str, variant: object) -> F64:
        key = (effect, parameter, str(variant))
        if key not in self._columns:
            rng = np.random.default_rng([7, *"".join(key).encode()])
            smooth = gaussian_filter1d(rng.standard_normal((self.rows, 2)), 12.0, axis=0)
            scale = 0.1 / negligible(self.vehicle, effect, parameter)
            self._columns[key] = scale * smooth / smooth.std()
        return self._columns[key]

    def residual(self, vehicle: Vehicle) -> list[F64]:
        rng = np.random.default_rng(self.seed)
        y = self.noise * lfilter([0.5], [1.0, -0.85], rng.standard_normal((self.rows, 2)), axis=0)
        for c in candidates(self.vehicle):
            if "slung" in c.effect:
                continue
            for p in c.parameters:
                held = dict(vehicle.effects.get(c.effect, {}))
                if c.variant and any(held.get(k) != v for k, v in c.variant.items()):
                    continue
                moved = value(vehicle, c.effect, p) - value(self.vehicle, c.effect, p)
                y = y + self._column(c.effect, p, dict(c.variant)) * (self.truth.get((c.effect, p), 0.0) - moved)
        return [y]

    def columns(self, vehicle: Vehicle, knobs: Sequence[FreeParameter]) -> list[F64]:
        def one(knob: FreeParameter) -> F64:
            if knob.effect == "slung_load":
                return np.zeros((self.rows, 2))
            held = {**vehicle.effects.get(knob.effect, {}), **knob.at}
            variant = {"rotor": held["rotor"]} if knob.effect == "rotor_fault" else {}
            return self._column(knob.effect, knob.parameter, variant)

        return [np.stack([one(knob) for knob in knobs], axis=2)]

    @property
    def trifles(self) -> float:
        return 1.0

    def nuisance(self, vehicle: Vehicle) -> tuple[list[F64], F64, Mask]:
        return [np.zeros((self.rows, 2, 1))], np.ones(1), np.ones(1, dtype=bool)

    def rate(self, flight: int) -> float:
        return 50.0

    @property
    def fit(self) -> list[Mask]:
        return [np.arange(self.rows) < 800]

    @property
    def holdout(self) -> list[Mask]:
        return [np.arange(self.rows) >= 900]


def searched(bench: MadeUp, start: Vehicle) -> SelectionState:
    return search(bench, design(bench, start, start))


@pytest.mark.parametrize("seed", range(12))
def test_of_noise_alone_nothing_is_the_best_subset(quad: Vehicle, seed: int) -> None:
    state = searched(MadeUp(seed, {}, quad), quad)
    assert dict(state.best.effects) == {}


@pytest.mark.parametrize("seed", range(3))
def test_two_hidden_effects_are_the_best_subset_and_estimated(quad: Vehicle, seed: int) -> None:
    """Found among all candidates, and each coefficient within four of its standard deviations."""
    hidden = {
        ("payload", "mass_kg"): 40.0 * negligible(quad, "payload", "mass_kg"),
        ("rotor_drag", "k_d_kg_per_rad"): 30.0 * negligible(quad, "rotor_drag", "k_d_kg_per_rad"),
    }
    state = searched(MadeUp(seed, hidden, quad), quad)
    assert set(state.best.effects) == {"payload", "rotor_drag"}
    made = estimate(state, state.best.effects)
    for slot, now, variance in zip(made.slots, made.values, np.diag(made.covariance), strict=True):
        assert abs(now - hidden[slot]) < 4.0 * np.sqrt(variance)


def test_what_adds_less_than_a_name_needs_is_not_followed(quad: Vehicle) -> None:
    """The simpler fit stays the best until something on top of it gains as much as a name must."""
    state = searched(MadeUp(1, {("payload", "mass_kg"): 60.0 * negligible(quad, "payload", "mass_kg")}, quad), quad)
    simple, key = state.best, state.best_key
    assert set(simple.effects) == {"payload"}
    more = {**simple.effects, "rotor_drag": {"k_d_kg_per_rad": negligible(quad, "rotor_drag", "k_d_kg_per_rad")}}
    for gained, followed in ((0.7 * NAME_EVIDENCE, False), (1.3 * NAME_EVIDENCE, True)):
        state.fits[key | {"rotor_drag"}] = replace(simple, effects=more, score=simple.score - gained)
        assert ("rotor_drag" in state.best.effects) is followed


def test_an_effect_is_one_member_however_many_variants_are_looked_at(quad: Vehicle) -> None:
    """The fault of that rotor, the rope that is nearest; never all of them at once."""
    group = candidates(quad)
    effects = {
        "payload": {"mass_kg": 0.1},
        "rotor_fault": {"rotor": 3.0, "effectiveness": 0.8},
        "slung_load": {"mass_kg": 0.1, "length_m": 1.1},
    }
    inside = [group[m] for m in members(group, effects)]
    assert sorted(c.effect for c in inside) == sorted(effects)
    assert {c.effect: dict(c.variant) for c in inside} == {
        "payload": {}, "rotor_fault": {"rotor": 3.0}, "slung_load": {"length_m": 1.0},
    }  # fmt: skip


def test_intervals_cover_as_often_as_they_say(quad: Vehicle) -> None:
    """95 % intervals of 60 noisy data sets: 51 at least hold the truth (fewer happens by chance in 0.2 % of trials)."""
    size = negligible(quad, "payload", "mass_kg")
    hidden = {("payload", "mass_kg"): 60.0 * size}
    held = 0
    state = searched(MadeUp(0, hidden, quad), quad)
    for seed in range(60):
        state.bench = MadeUp(1000 + seed, hidden, quad)
        made = estimate(state, {"payload": {"mass_kg": 0.0}})
        held += abs(made.values[0] - 60.0 * size) < 1.96 * np.sqrt(made.covariance[0, 0])
    assert held >= 51


@pytest.fixture(scope="module")
def dragged() -> Vehicle:
    path = _QUAD.with_name("px4-sihsim-quadx.toml")
    return parse_vehicle(path.read_text("utf-8"), path.name)


def _drag_off_by(share: float, vehicle: Vehicle) -> dict[tuple[str, str], float]:
    return {("linear_drag", p): share * x for p, x in vehicle.effects["linear_drag"].items()}


def test_one_factor_on_what_the_file_has_gains_what_least_squares_gains(dragged: Vehicle) -> None:
    """By the dense covariance of rows in which every candidate is a little there."""
    state = searched(MadeUp(2, _drag_off_by(0.02, dragged), dragged), dragged)
    point = state.point
    rows = point.fit_rows()
    whole, _ = point.learned()
    inverse = np.linalg.inv(np.eye(len(whole)) + whole @ np.diag(point.sizes**2) @ whole.T)
    origin = [s.origin * (point.candidates[s.candidate].effect == "linear_drag") for s in point.slots]
    along = inverse @ (point.x[rows] @ np.array(origin))
    gain = float(along @ point.y[rows]) ** 2 / float(along @ point.x[rows] @ np.array(origin))
    assert in_proportion(state.point, state.start, {}, "linear_drag") == pytest.approx(
        gain - np.log(rows.sum()), rel=1e-3
    )
    assert in_proportion(state.point, state.start, {}, "rotor_drag") == -np.inf  # not in the file


@pytest.mark.parametrize("seed", range(8))
def test_a_drag_of_the_file_off_by_what_would_be_named_is_named(dragged: Vehicle, seed: int) -> None:
    """All its coefficients and the choice among candidates are more than the flights can pay for; one factor is not."""
    clean = searched(MadeUp(seed, {}, dragged), dragged)
    assert dict(pruned(clean).effects) == {}
    of = {(row.effect, row.parameter): row for row in identify(clean.point, dragged, ())}
    row = of["linear_drag", IN_PROPORTION]
    state = searched(MadeUp(seed, _drag_off_by(row.smallest, dragged), dragged), dragged)
    best = pruned(state)
    assert set(best.effects) == {"linear_drag"}
    for value_ in best.effects["linear_drag"].values():
        assert value_ == pytest.approx(1.0 + row.smallest, abs=5.0 * np.sqrt(3.0) * row.error)


@pytest.mark.parametrize("errors", [thorough(3.0), thorough(4.5), 6.5])
def test_beside_a_load_a_factor_on_the_file_s_drag_is_a_name_from_its_own_least_evidence_on(
    dragged: Vehicle, errors: float
) -> None:
    """Below the 15 that a name chosen among all needs beyond its price, too."""
    of = {
        (row.effect, row.parameter): row
        for row in identify(searched(MadeUp(0, {}, dragged), dragged).point, dragged, ())
    }
    row, told = of["linear_drag", IN_PROPORTION], set()
    load = {("payload", "mass_kg"): 60.0 * negligible(dragged, "payload", "mass_kg")}
    for seed in range(8):
        hidden = load | _drag_off_by(errors * row.error, dragged)
        state = searched(MadeUp(seed, hidden, dragged), dragged)
        best = pruned(state)
        beside = {"payload": best.effects["payload"]}
        at = priced(state.point, dragged)
        gain = in_proportion(state.point, dragged, beside, "linear_drag") + at.factor_price
        if abs(gain - at.least_gain) > 1.5:  # by columns taken elsewhere the line is not that sharp
            assert ("linear_drag" in best.effects) == (gain > at.least_gain), gain
            told.add("linear_drag" in best.effects)
    assert told == ({False} if errors < 4.0 else {True, False} if errors < 5.0 else {True})


def test_whatever_has_not_changed_is_constant(quad: Vehicle) -> None:
    hidden = {("payload", "mass_kg"): 60.0 * negligible(quad, "payload", "mass_kg")}
    state = searched(MadeUp(3, hidden, quad), quad)
    assert estimate(state, state.best.effects).spread.min() > 1e-3


def test_a_short_channel_has_a_noise_model_of_fewer_taps() -> None:
    """White noise stays white whatever the length; few rows carry few taps, and hardly any say nothing."""
    rng = np.random.default_rng(5)
    for rows, order in ((4000, whitening.ORDER), (96, 8), (20, None)):
        e = 0.3 * rng.standard_normal(rows)
        made = whitening.fit([e], [np.ones(rows, dtype=bool)])
        if order is None:
            assert not made.usable
        else:
            assert made.order == order
            assert made.sigma == pytest.approx(0.3, rel=0.25)
