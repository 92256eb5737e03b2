"""Does a certificate from learned bounds ever claim more than physics allows?  Many random plants, each learned anew.

    python -m benchmarks.plants [--plants 1000] [--seed 0] [--delta 0.05]

Each plant: true over believed mass 0.8 to 1.6, wind in any direction up to 0.15 g, noise of the acceleration 0.02 to
0.1 m/s^2.  It hovers, then moves its thrust up and down by a fifth; two processes learn from that: the vertical
residual, affine in thrust, and the sideways thrust that balances the wind.  The noise is not told: it is bounded from
the scatter of the data.  From the bounds follows the least mu of the vertical line; physics refutes it where
the true plant's own least mu is larger.  Beside it the published way: the residual as a function of the state alone.

delta is shared out: a fifth to the bounds of noise, two fifths to the vertical bounds, two to the sideways ones.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta, chi2, norm

from flightstack.barrier.physics import PhysicalPlant, mu_physics
from flightstack.gp import Constant, Kernel, RecursiveGP, affine_in
from flightstack.region import Region
from flightstack.types import F64

REGION = Region("ellipsoid", (0.0, 0.0, -0.8), (0.4, 0.4, 0.6), (0.5, 0.5, 0.4))
POINTS = 80
EXCURSION = 0.2
G = 9.81
THRUST_MAX = 1.8 * G
NOISE_FLOOR = 0.02
OFFSET_STD, GAIN_STD, SIDE_STD = 2.0, 0.5, 3.0


@dataclass(frozen=True, slots=True)
class Count:
    """What came of one way of learning."""

    plants: int
    possible: int
    """Plants of which physics allows some mu."""
    certified: int
    refuted: int
    """Certified below what physics allows."""
    excess: float
    """Median of certified mu over physics, less 1."""

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Clopper-Pearson's interval of the share of plants with a refuted certificate."""
        tail, k, n = 0.5 * (1.0 - confidence), self.refuted, self.plants
        low = float(beta.ppf(tail, k, n - k + 1)) if k else 0.0
        return low, float(beta.ppf(1.0 - tail, k + 1, n - k)) if k < n else 1.0


@dataclass(frozen=True, slots=True)
class Flight:
    """What was seen of a plant: all (n,) or (n, 2), m/s^2, believed newton per believed kilogram."""

    thrust_up: F64
    """Vertical part of the specific thrust."""
    residual_down: F64
    """Measured acceleration less gravity and thrust as believed."""
    balance: F64
    """(n, 2) sideways specific thrust that was needed to stay."""


def draw(rng: np.random.Generator) -> tuple[PhysicalPlant, float]:
    """A plant and the noise of its accelerations."""
    direction = rng.standard_normal(3)
    wind = rng.uniform(0.0, 0.15) * direction / np.linalg.norm(direction)
    plant = PhysicalPlant(float(rng.uniform(0.8, 1.6)), (float(wind[0]), float(wind[1]), float(wind[2])))
    return plant, float(rng.uniform(0.02, 0.1))


def fly(plant: PhysicalPlant, noise: float, rng: np.random.Generator) -> Flight:
    """Hover for half of the points, then thrust up and down; sideways the wind is balanced throughout."""
    wind = G * np.array(plant.wind_g)
    hover = plant.mass_ratio * (G + wind[2])
    most = math.sqrt(THRUST_MAX**2 - float(np.sum((plant.mass_ratio * wind[:2]) ** 2)))
    swing = EXCURSION * np.sin(np.linspace(0.0, 6.0 * math.pi, POINTS // 2))
    up = np.minimum(hover * (1.0 + np.concatenate([np.zeros(POINTS - POINTS // 2), swing])), most)
    down = (G + wind[2] - up / plant.mass_ratio) - (G - up) + noise * rng.standard_normal(POINTS)
    side = plant.mass_ratio * wind[:2] + noise * plant.mass_ratio * rng.standard_normal((POINTS, 2))
    return Flight(up, down, side)


def certified_mu(flight: Flight, delta: float, *, affine: bool) -> float:
    """The least mu that the bounds of this flight allow on the vertical line; inf where they allow none."""
    k_side = float(norm.ppf(1.0 - 0.4 * delta / 4.0))
    k_down = float(norm.ppf(1.0 - 0.4 * delta / 2.0))
    columns = np.stack([np.ones(POINTS), flight.thrust_up], axis=1)
    noise_down = _noise_var(columns, flight.residual_down[:, None], 0.1 * delta)
    noise_side = _noise_var(columns[:, :1], flight.balance, 0.1 * delta)
    side = RecursiveGP(Constant(SIDE_STD**2), noise_side, input_dim=1, output_dim=2, capacity=POINTS)
    side.add(np.zeros((POINTS, 1)), flight.balance)
    mean, var = side.predict(np.zeros(1))
    balance = float(np.sum((np.abs(mean) + k_side * np.sqrt(var)) ** 2))
    if balance >= THRUST_MAX**2:
        return math.inf
    full = math.sqrt(THRUST_MAX**2 - balance)
    kernel: Kernel = Constant(OFFSET_STD**2)
    if affine:
        kernel = affine_in(0, kernel, Constant(GAIN_STD**2))
    down = RecursiveGP(kernel, noise_down, input_dim=1, output_dim=1, capacity=POINTS)
    used = slice(None) if affine else slice(POINTS - POINTS // 2)
    down.add(flight.thrust_up[used, None], flight.residual_down[used, None])
    mean, var = down.predict(np.array([full]))
    braking = full - G - float(mean[0]) - k_down * math.sqrt(float(var[0]))
    mean, var = down.predict(np.zeros(1))
    falling = G + float(mean[0]) - k_down * math.sqrt(float(var[0]))
    room = min(braking, falling)
    return 1.0 / (REGION.semi_axes_m[2] * room) if room > 0.0 else math.inf


def count(plants: int, seed: int, delta: float, *, affine: bool = True) -> Count:
    """Plants drawn, learned, certified and held against physics."""
    rng = np.random.default_rng(seed)
    possible = certified = refuted = 0
    excess = []
    for _ in range(plants):
        plant, noise = draw(rng)
        flight = fly(plant, noise, rng)
        claimed = certified_mu(flight, delta, affine=affine)
        allowed = mu_physics(plant, REGION, lateral=False)
        possible += math.isfinite(allowed)
        certified += math.isfinite(claimed)
        refuted += claimed < allowed * (1.0 - 1e-12)
        if math.isfinite(claimed) and math.isfinite(allowed):
            excess.append(claimed / allowed - 1.0)
    return Count(plants, possible, certified, refuted, float(np.median(excess)) if excess else math.nan)


def _noise_var(columns: F64, values: F64, share: float) -> float:
    """Upper bound (1 - share) of the noise variance, from what a least-squares fit leaves of values (n, p)."""
    left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    freedom = left.size - np.linalg.matrix_rank(columns) * values.shape[1]
    return max(float(np.sum(left * left) / chi2.ppf(share, freedom)), NOISE_FLOOR**2)


def main() -> None:
    """Print both ways' counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--delta", type=float, default=0.05)
    args = parser.parse_args()
    for name, affine in (("affine in thrust", True), ("state alone, as published", False)):
        found = count(args.plants, args.seed, args.delta, affine=affine)
        low, high = found.interval()
        print(
            f"{name}: {found.refuted} of {found.plants} refuted by physics, share {found.refuted / found.plants:.4f} "
            f"[{low:.4f}, {high:.4f}] (delta {args.delta:g}); certified {found.certified}, possible {found.possible}, "
            f"median mu {100 * found.excess:+.1f} % of physics"
        )


if __name__ == "__main__":
    main()
