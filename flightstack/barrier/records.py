"""What a certificate says, as data: for each axis a barrier, what the command can do there, and every margin by name.

Axes are north, east, down (0, 1, 2), relative to the region's centre.  Each stands for itself: its commanded
acceleration comes from a box that the thrust budget holds for all at once (`Budget`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from flightstack.barrier.condition import Reach, Setting
from flightstack.barrier.premises import Premises
from flightstack.barrier.provenance import Provenance
from flightstack.barrier.shapes import Barrier
from flightstack.barrier.torque import GovernorTerms
from flightstack.jit import njit_called
from flightstack.types import F64, Tuple3

AXES = ("north", "east", "down")
Leans = tuple[tuple[float, float], tuple[float, float]]
"""Least and greatest part of the thrust axis along north and along east."""
MARGINS = (
    "gp_error", "thrust_gain", "discretisation", "zero_order_hold", "delay", "age", "rotor_lag",
    "attitude_lag", "estimate_error", "torque",
)  # fmt: skip
"""Every margin that a ledger names, in its order."""


@dataclass(frozen=True, slots=True)
class Response:
    """How one axis' acceleration a follows its command u: a + c1 a' + c2 a'' = u, `delay_s` late.

    With p_ = p + c1 v + c2 a and v_ = v + c1 a + c2 a', z = (p_, v_) is a double integrator driven by u alone; p and v
    are p_ and v_ seen through the same low pass of gain 1, hence weighted means of them: what is convex and holds z
    holds (p, v).  `delay_s` is bridged with the commands already sent.
    """

    c1_s: float
    c2_s2: float
    delay_s: float


@dataclass(frozen=True, slots=True)
class Authority:
    """What the command of one axis can do at each speed: mean acceleration and how far the true one may be off.

    Nodes along v, linear between them.  The mean is offset - gain * F for the vertical axis, F the specific thrust
    (believed newton per believed kilogram) along down, and offset + the wanted acceleration for lateral ones
    (gain 0), whose range is the budget's.
    """

    v_mps: F64
    """(n,) increasing; at a speed beyond them nothing is certified."""
    offset_mps2: F64
    """(n,) mean acceleration without thrust (down: gravity and residual; lateral: residual)."""
    gain: F64
    """(n,) delivered over believed specific thrust; 0 on lateral axes."""
    u_low_mps2: F64
    """(n,) least mean acceleration that the budget gives."""
    u_high_mps2: F64
    error_low_mps2: F64
    """(n,) bound of |true - mean| at u_low, anywhere between the node's neighbours."""
    error_high_mps2: F64

    def reach(self, v_mps: float) -> Reach:
        """At a speed: the narrower range of the two nodes around it, and a doubt that holds at its ends.

        The larger doubts hold at the ends of the wider range.  Convex, it may be larger at an end drawn inwards: up to
        the chord there.
        """
        i = min(max(int(np.searchsorted(self.v_mps, v_mps)) - 1, 0), len(self.v_mps) - 2)
        return Reach(*reach_between(self.table, i))

    @property
    def table(self) -> F64:
        """(7, n) the columns in their order, for compiled code."""
        return np.stack(
            [
                self.v_mps, self.offset_mps2, self.gain, self.u_low_mps2, self.u_high_mps2, self.error_low_mps2,
                self.error_high_mps2,
            ]
        )  # fmt: skip


N_LOW, N_HIGH, N_ERROR_LOW, N_ERROR_HIGH = 3, 4, 5, 6
"""Rows of `Authority.table`."""


@njit_called
def reach_between(table: F64, i: int) -> tuple[float, float, float, float]:
    """What `Authority.reach` says between a node and the next."""
    low, high = max(table[N_LOW, i], table[N_LOW, i + 1]), min(table[N_HIGH, i], table[N_HIGH, i + 1])
    at_low = max(table[N_ERROR_LOW, i], table[N_ERROR_LOW, i + 1])
    at_high = max(table[N_ERROR_HIGH, i], table[N_ERROR_HIGH, i + 1])
    inward_low = low - min(table[N_LOW, i], table[N_LOW, i + 1])
    inward_high = max(table[N_HIGH, i], table[N_HIGH, i + 1]) - high
    rise = at_high - at_low
    if rise > 0.0 and inward_low > 0.0:
        at_low += rise * inward_low / (high - low + inward_low) if high > low else rise
    elif rise < 0.0 and inward_high > 0.0:
        at_high -= rise * inward_high / (high - low + inward_high) if high > low else rise
    return low, high, at_low, at_high


@dataclass(frozen=True, slots=True)
class Margin:
    """One line of the ledger."""

    name: str
    """One of MARGINS."""
    mps2: float
    """What it takes from the acceleration at hand, on this axis, at worst."""
    because: str
    """The figures it comes from, in words."""


@dataclass(frozen=True, slots=True)
class Budget:
    """The thrust that all axes share: what the filter may ask for, as specific thrust (believed newton per kilogram).

    The thrust axis b leans within a range to north and within one to east, and thrust's down part lies in [low, high]
    (upward thrust counted positive): all within the limits of thrust and tilt, at every learned gain within its bound.
    """

    north_least: float
    """b's part along north."""
    north_most: float
    east_least: float
    east_most: float
    low_mps2: float
    high_mps2: float
    thrust_max_mps2: float
    """Greatest length of the thrust vector."""
    tilt_max_rad: float
    """Of the corner that leans furthest."""
    lean_spare: float = 0.0
    """What the filter keeps from either end of a range: what the attitude may be off by, and what it runs over."""

    @classmethod
    def square(cls, low_mps2: float, high_mps2: float, thrust_max_mps2: float, tilt_max_rad: float) -> Budget:
        """As far to all sides, with nothing to spare."""
        most = math.sin(tilt_max_rad) * math.sqrt(0.5)
        return cls(-most, most, -most, most, low_mps2, high_mps2, thrust_max_mps2, tilt_max_rad)

    @property
    def leans(self) -> Leans:
        """Of north and of east."""
        return (self.north_least, self.north_most), (self.east_least, self.east_most)

    @property
    def kept(self) -> Leans:
        """The same less what is spared."""
        return spared(self.leans, self.lean_spare)


def spared(leans: Leans, spare: float) -> Leans:
    """So much narrower at either end, down to nothing in the middle."""
    north, east = (
        (min(least + spare, 0.5 * (least + most)), max(most - spare, 0.5 * (least + most))) for least, most in leans
    )
    return north, east


@dataclass(frozen=True, slots=True)
class AxisCertificate:
    """One axis."""

    axis: int
    barrier: Barrier
    setting: Setting
    response: Response
    authority: Authority
    margins: tuple[Margin, ...]
    cells: F64
    """(m, 6) e_low, e_high, v_low, v_high, u, q: in each box the command u meets the condition by at least q (1/s).
    Together they cover the region h >= -eta."""


@dataclass(frozen=True, slots=True)
class Certificate:
    """A region that the filter keeps the vehicle in; `axes` need not be all three."""

    mode: str
    """sound or as-published."""
    centre_ned_m: Tuple3
    """Relative to the start."""
    axes: tuple[AxisCertificate, ...]
    budget: Budget
    delta: float
    """Chance that a bound of the ledger fails."""
    k_sigma: float
    """Sigmas of the bound that delta asks for."""
    knowledge: dict[str, object] = field(default_factory=dict)
    """What the bounds rest on: kernels, points, noise, hashes; plain JSON."""
    version: int = 0
    """Counted up by each that replaces another in flight."""
    premises: Premises | None = None
    """For what it holds; None: as published, or made up: it claims nothing of a flight."""
    governor: GovernorTerms | None = None
    """What bounds torque while it is in force; None: nothing does, and no margin counts on it."""
    provenance: Provenance | None = None
    """The flight that it was learned in; None: nothing ties it to one."""


def area_of(certificate: Certificate) -> float:
    """Product of the axes' areas."""
    return math.prod(each.barrier.area_m2ps for each in certificate.axes)
