"""How far the estimate may be from the truth: bounds of each component, from the statistics of the sensors.

The state observer's steady covariance gives a standard deviation for each component of position, velocity and of the
acceleration that thrust along the axis as estimated gives; K_SIGMA of them are the bound.  Nine components at 4.3 sigma
all hold in 1 - 9 * 1.7e-5 = 99.985 % of the ticks; as errors last (some 10 ms at such a level), 99.9 % of a flight's
ticks hold but for one flight in a hundred.

Position counts from where the flight began, which is itself estimated, by the mean of REST_S at rest; or, where that is
more, from a place known otherwise, from which the bias that is constant in a flight takes it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flightstack.error_statistics import ErrorStatistics
from flightstack.learning.sampler import AWAY_M
from flightstack.region import Region
from flightstack.state_observer import steady
from flightstack.types import F64, Tuple3

K_SIGMA = 4.3
_GROWN_MPS = 1.4
"""A region that grows begins with this speed (`growing`)."""
_AXES = ("north", "east", "down")
REST_S = 0.5
"""The companion streams for so long at rest before it may take off."""


@dataclass(frozen=True, slots=True)
class EstimateBounds:
    """How far truth and estimate may be apart along north, east and down."""

    pos_m: Tuple3
    vel_mps: Tuple3
    acc_mps2: Tuple3
    """Of the acceleration that thrust along the axis as estimated gives, at the greatest thrust."""
    k_sigma: float
    """Standard deviations of the sensors' statistics that the bounds are."""

    @property
    def away_m(self) -> float:
        """At rest at the place of take-off estimates of position are no further apart; learning begins beyond."""
        return max(AWAY_M, 2.0 * math.hypot(*self.pos_m))


BENCH = EstimateBounds((0.002,) * 3, (0.01,) * 3, (0.035,) * 3, 0.0)
"""Where no sensors are named: made up, for what never flies."""


def estimate_bounds(statistics: ErrorStatistics, k_sigma: float = K_SIGMA, rest_s: float = REST_S) -> EstimateBounds:
    """The bounds behind the state observer, at the thrust of hover."""
    _, covariances = steady(statistics)
    share = _mean_share(rest_s / statistics.pos_time_s)
    pos, vel, acc = (np.sqrt(covariances[:, i, i]) for i in (0, 1, 4))
    origin = np.maximum(share * np.square(statistics.pos_std_m), np.square(statistics.pos_bias_std_m))
    return EstimateBounds(
        _three(k_sigma * np.sqrt(pos**2 + origin)), _three(k_sigma * vel), _three(k_sigma * acc), k_sigma
    )


def does_not_fit(bounds: EstimateBounds, region: Region, axes: tuple[int, ...]) -> str:
    """The bound that is too wide for a region, in words; empty where all fit.

    At the edge of an ellipse h falls by 2 / semi-axis for each m or m/s: bounds of half a semi-axis or more leave no
    state of which anything could be promised.
    """
    for axis in axes:
        name = _AXES[axis]
        for of, bound, semi, unit in (
            ("position", bounds.pos_m[axis], region.semi_axes_m[axis], "m"),
            ("velocity", bounds.vel_mps[axis], max(region.semi_axes_mps[axis], _GROWN_MPS), "m/s"),
        ):
            if 2.0 * bound >= semi:
                return (
                    f"{of} {name} is known to {bound:.2f} {unit} ({bounds.k_sigma:g} sigma), the region's semi-axis is "
                    f"{semi:.2f} {unit}: at least twice the bound is needed"
                )
    return ""


def contradiction(
    bounds: EstimateBounds, sensors: str, accuracy_m: tuple[float, float], disagreement_ned_mps: F64
) -> str:
    """What the vehicle itself says against the bounds of a grade, in words; empty where nothing does.

    `accuracy_m`: one standard deviation of its position, across (both axes together) and down, by its estimator, NaN
    where it does not say; `disagreement_ned_mps` (3,): rms of d(position)/dt - velocity.  An estimator that errs as the
    grade says reports no standard deviation beyond the bound, and its velocity and its position don't disagree by more
    than the bound of velocity.
    """
    north, east, down = bounds.pos_m
    for where, said_m, bound_m in (("across", accuracy_m[0], math.hypot(north, east)), ("down", accuracy_m[1], down)):
        if said_m > bound_m:
            return (
                f"the vehicle says that it knows its position {where} to {said_m:.2f} m (one standard deviation), with "
                f"{sensors} sensors that would be {bound_m:.2g} m at most ({bounds.k_sigma:g} sigma)"
            )
    for axis, name in enumerate(_AXES):
        if disagreement_ned_mps[axis] > bounds.vel_mps[axis]:
            return (
                f"velocity {name} and position disagree by {disagreement_ned_mps[axis]:.2f} m/s rms, with {sensors} "
                f"sensors velocity is known to {bounds.vel_mps[axis]:.2g} m/s ({bounds.k_sigma:g} sigma)"
            )
    return ""


def _mean_share(times: float) -> float:
    """Variance of a Gauss-Markov error's mean over so many time constants, as a share of its own."""
    return 2.0 / times**2 * (times - 1.0 + math.exp(-times))


def _three(values: object) -> Tuple3:
    north, east, down = np.asarray(values, np.float64).tolist()
    return north, east, down
