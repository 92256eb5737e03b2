"""What can be said of the paper's formulas without a flight: each claim tried in closed form or by a small simulation.

Sources of the numbers are the functions that the tests hold against independent ones; nothing is stored here.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from scipy.stats import norm

from flightstack.barrier.physics import PhysicalPlant, mu_physics, overshoot_m, state_only
from flightstack.barrier.published import Basis, certificate, constant, on_the_vertical, tip, with_mu
from flightstack.barrier.published_filter import PublishedFilter
from flightstack.barrier.records import Authority, AxisCertificate, Budget, Certificate
from flightstack.barrier.sampling import Claim, adaptive, crossed
from flightstack.model import Limits, Model
from flightstack.region import Region
from flightstack.types import F64, Command, Learned, Measurement, changed

GRAVITY_MPS2 = 9.81
"""The paper's."""
MASS_RATIO, THRUST_WEIGHTS, LIMIT_M, MU, GAMMA_PS = 1.4, 1.8, 0.6, 0.6, 2.0
CROSS = 0.617
_ROOMY_MU = 0.65
"""Well above what physics allows: what stays open then is due to the form of h alone."""
PERIODS_S = (0.0005, 0.004, 0.01, 0.02)
_BRAKING_MPS2 = GRAVITY_MPS2 * (1.0 - THRUST_WEIGHTS / MASS_RATIO)
_REGION = Region("ellipsoid", (0.0, 0.0, -0.8), (0.4, 0.4, LIMIT_M), (0.5, 0.5, MU**-0.5))
_MODEL = Model(1.4, 60.0, 0.0, 0.02, 0.05, 0.0, (0.0, 0.0, 0.0), 0.1, ())
"""The true vehicle, known exactly, without lags."""
_LIMITS = Limits(thrust_max_weights=THRUST_WEIGHTS / MASS_RATIO, thrust_min_weights=0.0)
_NOTHING = Authority(*(np.zeros(2) for _ in range(7)))
_BASIS = Basis(GAMMA_PS, 2.0, 0.05, (_NOTHING,) * 3, Budget.square(0.0, 0.0, 0.0, 0.0))


def measure() -> dict[str, Any]:
    """Everything, for the rows and two figures."""
    return {
        "lemma": lemma(),
        "cover": cover(),
        "mu": mu_table(),
        "sampled": sampled(),
        "five_terms": five_terms(),
        "block_inverse": block_inverse(),
        "joint": {str(k): float((2.0 * norm.cdf(k) - 1.0) ** 6) for k in (2, 3)},
    }


def lemma() -> dict[str, Any]:
    """The sampling condition at the grid's point nearest to a tip: the greatest left side over the right one."""
    bounds = constant(_BRAKING_MPS2, GRAVITY_MPS2)
    tried = list(product((0.2, 0.6, 1.0, 6.3), (0.1, 2.0, 10.0), (0.01, 0.05, 0.2)))
    found = [tip(LIMIT_M, mu, gamma, bounds, tau) for mu, gamma, tau in tried]
    return {"tried": len(tried), "greatest_share": max(each.left / each.right for each in found)}


def cover() -> dict[str, Any]:
    """Cells that adaptive sampling leaves open at ever finer depths; the strict form's least left side, its samples."""
    bounds = constant(_BRAKING_MPS2, GRAVITY_MPS2)
    published = Claim(on_the_vertical(LIMIT_M, _ROOMY_MU), GAMMA_PS, bounds)
    strict = Claim(crossed(LIMIT_M, MU, CROSS), GAMMA_PS, bounds)
    low_e, high_e, low_v, high_v = strict.barrier.box
    e, v = np.meshgrid(np.linspace(low_e, high_e, 601), np.linspace(low_v, high_v, 601))
    points = np.stack([e.ravel(), v.ravel()], axis=1)
    b = strict.barrier
    inside = b.p11 * points[:, 0] ** 2 + 2.0 * b.p12 * points[:, 0] * points[:, 1] + b.p22 * points[:, 1] ** 2 <= 1.0
    found = adaptive(strict, local=True)
    return {
        "mu": _ROOMY_MU,
        "open": {str(depth): len(adaptive(published, depth=depth, local=True).open) for depth in (12, 16, 20)},
        "strict_margin_ps": float(strict.left(points[inside]).min()),
        "strict_samples": len(found.points),
        "strict_open": len(found.open),
    }


def mu_table() -> dict[str, float]:
    """The least mu that physics allows, and what a residual learned as of the state alone claims."""
    heavy = PhysicalPlant(MASS_RATIO)
    claimed = mu_physics(state_only(heavy), _REGION)
    return {
        "exact": mu_physics(heavy, _REGION),
        "wind_north": mu_physics(PhysicalPlant(MASS_RATIO, (0.1, 0.0, 0.0)), _REGION),
        "wind_down": mu_physics(PhysicalPlant(MASS_RATIO, (0.0, 0.0, 0.1)), _REGION),
        "wind_up": mu_physics(PhysicalPlant(MASS_RATIO, (0.0, 0.0, -0.1)), _REGION),
        "state_only": claimed,
        "state_only_overshoot_m": overshoot_m(claimed, LIMIT_M, -_BRAKING_MPS2),
        "slack_mps2": -_BRAKING_MPS2 - 1.0 / (LIMIT_M * MU),
    }


def sampled() -> dict[str, Any]:
    """Pushed down for ever through the published filter, exact model: how far out, without and with a cross term.

    At each period; `traces` have time and e for the figure.
    """
    found: dict[str, Any] = {"periods_s": list(PERIODS_S)}
    for name, cross in (("published", 0.0), ("cross", CROSS)):
        flown = [pushed(on_the_line(cross, MU), period_s) for period_s in PERIODS_S]
        found[name] = {
            "most_m": [float(np.abs(e).max()) for e, _ in flown],
            "infeasible": [share for _, share in flown],
            "traces": [
                [[round(k * period_s, 4), round(float(e[k]), 5)] for k in range(0, len(e), max(1, len(e) // 600))]
                for (e, _), period_s in zip(flown, PERIODS_S, strict=True)
            ],
        }
    return found


def on_the_line(cross: float, mu: float) -> Certificate:
    """h = 1 - P11 e^2 - 2 c e v - mu v^2 with |e| <= 0.6; c = 0: the paper's."""
    made = certificate(with_mu(_REGION, mu), _BASIS)
    down = made.axes[2]
    barrier = crossed(LIMIT_M, mu, cross)
    axis = AxisCertificate(2, barrier, down.setting, down.response, _NOTHING, (), down.cells)
    return Certificate(made.mode, made.centre_ned_m, (axis,), made.budget, _BASIS.delta, _BASIS.k_sigma)


def pushed(made: Certificate, period_s: float, duration_s: float = 12.0) -> tuple[F64, float]:
    """Positions (n,) of an exact double integrator that no thrust is asked of, and the share of infeasible steps."""
    published = PublishedFilter(_MODEL, _LIMITS)
    state = published.adopt(published.init(np.zeros(3)), made)._replace(engaged=True)
    gravity, none = float(_weight_mps2()), Command(0, 0.0, 0.0, np.zeros(3))
    steps, failed, learned = round(duration_s / period_s), 0, Learned.nothing()
    e, v = np.zeros(steps + 1), 0.0
    for k in range(steps):
        state, command, filtered = published.step(state, _at(e[k], v), none, none, learned)
        failed += int(filtered.status == 4.0)
        a = gravity - command.thrust_n / _MODEL.mass_kg
        e[k + 1], v = e[k] + v * period_s + 0.5 * a * period_s**2, v + a * period_s
    return e, failed / steps


def five_terms() -> dict[str, float]:
    """The 5-term h of section V.B on its boundary, level and moving sideways: what thrust does to it, and its rate."""
    published = PublishedFilter(_MODEL, _LIMITS)
    made = certificate(with_mu(_REGION, MU), _BASIS)
    seen = _at(0.0, 0.0, (0.283, 0.0, 0.0), (0.354, 0.0, 0.0))
    windy = changed(
        Learned.nothing(), residual_frd_mps2=np.array([0.1 * GRAVITY_MPS2, 0.0, 0.0]), sigma_frd_mps2=np.zeros(3)
    )
    calm, wind = (published.row(made, np.zeros(3), seen, known) for known in (Learned.nothing(), windy))
    return {
        "h": calm.h, "slope": calm.slope, "rate_ps": calm.rest - GAMMA_PS * calm.h,
        "rate_wind_ps": wind.rest - GAMMA_PS * wind.h,
    }  # fmt: skip


def block_inverse(points: int = 60, added: int = 5) -> dict[str, float]:
    """max |M F - I| of the paper's bordered inverse F of a kernel matrix M, as printed and put right."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(points + added, 3))
    kernel = np.exp(-0.5 * ((x[:, None] - x) ** 2).sum(axis=2))
    m = kernel + 1e-2 * np.eye(points + added)
    inverse, k = np.linalg.inv(m[:points, :points]), m[:points, points:]
    s = m[points:, points:] - k.T @ inverse @ k
    across, corner = inverse @ k @ np.linalg.inv(s), np.linalg.inv(s)
    first = inverse + across @ k.T @ inverse
    printed = np.block([[first, across], [-across.T, s]])
    right = np.block([[first, -across], [-across.T, corner]])
    unit = np.eye(points + added)
    return {"printed": float(np.abs(m @ printed - unit).max()), "right": float(np.abs(m @ right - unit).max())}


def _weight_mps2() -> float:
    return _MODEL.weight_n / _MODEL.mass_kg


def _at(
    e_m: float, v_mps: float, aside_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    aside_mps: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Measurement:  # fmt: skip
    """Level, at e and v down from the region's centre, and so far aside."""
    pos = np.array(_REGION.centre_ned_m) + np.array(aside_m) + np.array([0.0, 0.0, e_m])
    vel = np.array(aside_mps) + np.array([0.0, 0.0, v_mps])
    level = np.array([1.0, 0.0, 0.0, 0.0])
    return Measurement(0, np.concatenate([pos, vel, level, np.zeros(6), np.full(4, np.nan)]), 0, 0, 0)
