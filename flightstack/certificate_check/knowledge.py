"""What each axis can count on, worked out anew from the points, kernels and limits that the certificate carries.

Thrust vectors f (believed newton per believed kilogram, NED, thrust is -f) have a direction b with b_n and b_e each in
a range of its own and a down part F from low to high.  The true acceleration at velocity v, R(b) the shortest turn of
down onto b, is

    a = g e_d - f + R(b) (residual(x) - D R(b)' v),    x = (R(b)' v, b_n, b_e, |f| / g, near |f| / g)

residual: three independent Gaussian processes, the first two on one store, each with the variance
inflation^2 posterior variance + excess, and beside it remainder (1 + sum of its absolute weights).  The points' noise
is white and, with `drift`, v exp(-|t_i - t_j| / time) of their windows' last stamps; excess is at least 1.05^2 v.
Also, with mass ratio r and force |w| <= W,
a = g e_d - (f + drag v) / r + w.

At each node of speed and at both ends of the command the intervals (mean -+ k_a
sigma, k_a the axis' `k_queries`, cut with what mass and force allow; their hull where they are apart) of 17 queries are
joined: the other speeds and thrust at the corners of their ranges, and one in the middle, all at the greatest height.
What the ground adds below it lies between nothing and g = 2 near(least height) |f| along any b.  In the last
certificate of a flight, if the prior knows the ground, it is no more along down than what was learned says at the least
height: mean - k sigma there, less g near / (1 - near).  Lateral intervals are those of what thrust does not do, a +
gain f, over both ends.
The middle and half width of the joint interval give the mean and the error; the error of a node holds for its
neighbours' intervals too, and is made larger by k times the prior's deviation half-way between two nodes, and by what
falsified bounds have added.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import floors
from .box import Box
from .gaussian import factor, kernel, posterior, wandering
from .intervals import F64, I64
from .reading import Refused, number, numbers, rows, stamps, table_of
from .together import Asked, check_together

NEAR = 1e-6
"""What two correct computations of a posterior may differ by, m/s^2."""
DOWN = 2
_MOST_VERSIONS = 100_000
_KEYS = (
    "kind", "initial", "gravity_mps2", "drag_per_s", "rotor_radius_m", "speeds_mps", "heights_m", "nodes",
    "slice_only", "axes", "delta", "version", "k_sigma", "statements", "widen_mps2",
    "torque_mps2", "k_queries",
)  # fmt: skip
_LEARNED = ("lateral", "vertical", "sha256")
_ALSO = ("doubts", "falsified", "hand_over", "last", "vehicle", "vehicle_hash")
_PROCESS = ("kernel", "noise_var", "inflation", "remainder_mps2", "excess", "x", "y", "windows_us")
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=4)))


_THRUST, _GROUND = 5, 6
"""Of an input of a store, after velocity and axis."""


@dataclass
class StatedProcess:
    """One store: its points and calibration."""

    spec: Any
    lower: F64
    inflation: F64
    remainder: F64
    excess: F64
    x: F64
    y: F64
    noise_var: float
    windows_us: I64
    """(n, 2) of each point, or none."""
    drift: tuple[float, float] = (0.0, 1.0)
    """Variance and time (s) of what noise wanders by."""

    def drifted(self, last_us: I64) -> F64:
        """(m, outputs) what noise has most likely wandered to in windows that end at these stamps."""
        if self.drift[0] == 0.0:
            return np.zeros((len(last_us), self.y.shape[1]))
        weights = np.linalg.solve(self.lower.T, np.linalg.solve(self.lower, self.y))
        return np.asarray(wandering(self.drift, last_us, self.windows_us[:, 1]) @ weights)

    def at(self, queries: F64, where: str) -> tuple[F64, F64, F64]:
        """Means, calibrated variances and remainders (m, outputs)."""
        mean, variance, sums = posterior(self.spec, self.x, self.y, self.lower, queries, where)
        return mean, self.inflation**2 * variance[:, None] + self.excess, (1.0 + sums[:, None]) * self.remainder


@dataclass
class StatedKnowledge:
    """The certificate's `knowledge`, read and checked for itself."""

    data: dict[str, Any]
    box: Box
    speeds: F64
    heights: tuple[float, float]
    nodes: int
    k: float
    k_queries: tuple[float, ...]
    """Of each axis' queries."""
    widen: F64
    initial: tuple[float, float, float] | None
    stores: list[StatedProcess]
    torque: float = 0.0
    """Along the thrust, what torque adds or takes of acceleration at most: known with the tables."""
    lead: float = 0.0
    """Thrust that lateral axes are steered with, m/s^2: known with the tables."""

    @property
    def last(self) -> bool:
        """No certificate was issued after it."""
        return self.data.get("last", False) is True

    @property
    def queries(self) -> int:
        """At each node and end."""
        return 1 if self.data["slice_only"] else 1 + len(_CORNERS)

    def at(self, axis: int) -> F64:
        """(nodes,) speeds."""
        return np.linspace(float(self.speeds[axis, 0]), float(self.speeds[axis, 1]), self.nodes)

    def bends(self) -> list[float]:
        """For each axis the prior's deviation half-way between two nodes from the mean of both."""
        out = []
        for axis in range(3):
            x = np.zeros((3, 7))
            step = (self.speeds[axis, 1] - self.speeds[axis, 0]) / (self.nodes - 1)
            x[:, axis] = self.speeds[axis, 0] + step * np.array([0.0, 0.5, 1.0])
            x[:, _THRUST] = 1.0
            weights = np.array([-0.5, 1.0, -0.5])
            grams = [float(store.inflation.max()) ** 2 * kernel(store.spec, x, x, "kernel") for store in self.stores]
            out.append(math.sqrt(max([0.0, *(float(weights @ gram @ weights) for gram in grams)])))
        return out

    def hull(self, axis: int, gain: tuple[F64, float] | None) -> F64:
        """(2, 2, nodes) least and greatest acceleration, at the low and the high end; `gain` and hover of vertical."""
        joint, asked = np.empty((2, 2, self.nodes)), []
        for end in range(2):
            parts = [self._query(axis, speed, end, gain) for speed in self.at(axis)]
            v, f, done = (np.concatenate([part[i] for part in parts]) for i in range(3))
            sides = self._interval(axis, v, f)
            near = self._near(self.heights[0])
            ground = 2.0 * near * np.linalg.norm(f, axis=1)
            below, above = ground, 0.0 * ground
            if axis != DOWN:
                least_lean, most_lean = self.box.leans[axis]
                below, above = max(most_lean, 0.0) * ground, max(-least_lean, 0.0) * ground
            if (
                axis == DOWN and self.last and self._knows_ground(near)
            ):  # learned at the least height: no more than that
                a, deviation, rest = self._learned(axis, v, f, near)
                least = a - self.k * deviation - rest - ground * near / (1.0 - near)
                below = np.minimum(ground, np.maximum(sides.low - least, 0.0))
            for side in (sides.low, sides.mean_low, sides.sure_low):
                side += done - below
            for side in (sides.high, sides.mean_high, sides.sure_high):
                side += done + above
            asked.append(Asked(*(part.reshape(self.nodes, -1) for part in vars(sides).values())))
            joint[0, end], joint[1, end] = asked[end].low.min(axis=1), asked[end].high.max(axis=1)
        if self.stores:
            k = self.k if self.last else self.k_queries[axis]
            check_together(asked, axis != DOWN, k, self.k)
        return joint

    def _knows_ground(self, near: float) -> bool:
        """Whether the prior lets the ground do half of Cheeseman and Bennett's, one standard deviation."""
        if not self.stores:
            return False
        x = np.zeros((2, 7))
        x[:, _THRUST], x[1, _GROUND] = 1.0, near
        far, close = np.diag(kernel(self.stores[1].spec, x, x, "kernel"))
        return bool(close - far >= (0.5 * near * float(self.data["gravity_mps2"])) ** 2)

    def _near(self, height_m: float) -> float:
        radius = float(self.data["rotor_radius_m"])
        return float(0.25 * radius / max(height_m, 0.5 * radius)) ** 2

    def _query(self, axis: int, speed: float, end: int, gain: tuple[F64, float] | None) -> tuple[F64, F64, F64]:
        """Velocities, thrust vectors (q, 3) and what thrust does (q,) at one node and end of the command."""
        corners = _CORNERS if self.queries > 1 else _CORNERS[:0]
        others = [i for i in range(3) if i != axis]
        v, b = np.zeros((self.queries, 3)), np.zeros((self.queries, 3))
        v[0] = np.clip(0.0, self.speeds[:, 0], self.speeds[:, 1])
        for column, other in zip((2, 3), others, strict=True):
            v[1:, other] = np.where(corners[:, column] > 0.0, self.speeds[other, 1], self.speeds[other, 0])
        v[:, axis] = speed
        down = np.full(self.queries, self.box.low if end else self.box.high)
        for other in (0, 1) if axis == DOWN else others[:1]:
            least, most = self.box.leans[other]
            b[0, other] = np.clip(0.0, least, most)
            b[1:, other] = np.where(corners[:, other if axis == DOWN else 0] > 0.0, most, least)
        if gain is not None:
            b[:, axis] = self.box.leans[axis, 0] if end else self.box.leans[axis, 1]
            down = np.array([gain[1], *np.where(corners[:, 1] > 0.0, self.box.high, self.box.low)])
        b[:, DOWN] = np.sqrt(1.0 - b[:, 0] ** 2 - b[:, 1] ** 2)
        f = b * (down / b[:, DOWN])[:, None]
        there = np.zeros(self.queries) if gain is None else np.interp(v[:, DOWN], self.at(DOWN), gain[0])
        return v, f, there * f[:, axis]

    def _interval(self, axis: int, v: F64, f: F64) -> Asked:
        """Least and greatest true acceleration along an axis at each query, and what they are made of."""
        g = float(self.data["gravity_mps2"])
        low, high = np.full(len(v), -np.inf), np.full(len(v), np.inf)
        if self.initial is not None:
            force = -f[:, axis] - max(self.data["drag_per_s"]) * v[:, axis]
            ends = np.stack([force / self.initial[0], force / self.initial[1]])
            middle = g if axis == DOWN else 0.0
            low, high = (
                middle + ends.min(axis=0) - self.initial[2] * g,
                middle + ends.max(axis=0) + self.initial[2] * g,
            )
        if not self.stores:
            return Asked(low.copy(), high.copy(), low.copy(), high.copy(), np.zeros(len(v)), low, high)
        a, deviation, rest = self._learned(axis, v, f, self._near(self.heights[1]))
        k = self.k if self.last else self.k_queries[axis]
        least, most = a - rest - k * deviation, a + rest + k * deviation
        apart = np.maximum(low, least) > np.minimum(high, most)
        return Asked(
            np.where(apart, np.minimum(low, least), np.maximum(low, least)),
            np.where(apart, np.maximum(high, most), np.minimum(high, most)),
            a - rest, a + rest, deviation, low, high,
        )  # fmt: skip

    def _learned(self, axis: int, v: F64, f: F64, near: float) -> tuple[F64, F64, F64]:
        """Mean, standard deviation and remainder of the acceleration along an axis at each query."""
        g = float(self.data["gravity_mps2"])
        size = np.linalg.norm(f, axis=1)
        b = f / size[:, None]
        turn = _turns(b)
        body = np.einsum("qji,qj->qi", turn, v)
        x = np.column_stack([body, b[:, :2], size / g, near * size / g])
        (side, side_var, side_rest), (up, up_var, up_rest) = (
            s.at(x, n) for s, n in zip(self.stores, _LEARNED, strict=False)
        )
        mean, variance = np.column_stack([side, up]), np.column_stack([side_var, up_var])
        drag = np.array(self.data["drag_per_s"])
        drag[:2] = drag[:2].mean()
        a = np.einsum("qj,qj->q", turn[:, axis], mean - drag * body) - f[:, axis] + (g if axis == DOWN else 0.0)
        rest = np.einsum("qj,qj->q", np.abs(turn[:, axis]), np.column_stack([side_rest, up_rest]))
        return a, np.sqrt(np.einsum("qj,qj->q", turn[:, axis] ** 2, variance)), rest


def _turns(b: F64) -> F64:
    """(q, 3, 3) the shortest turn of (0, 0, 1) onto each b, |b| = 1: Rodrigues, I + K + K^2 / (1 + b_z)."""
    k = np.zeros((len(b), 3, 3))
    k[:, 0, 2], k[:, 1, 2], k[:, 2, 0], k[:, 2, 1] = b[:, 0], b[:, 1], -b[:, 0], -b[:, 1]
    turn: F64 = np.eye(3) + k + k @ k / (1.0 + b[:, 2])[:, None, None]
    return turn


def torque_of(known: StatedKnowledge, axis: int) -> float:
    """Of the error of an axis, what torque does: along the thrust, sideways by the sine of the greatest lean."""
    return known.torque if axis == DOWN else known.torque * known.box.corner


def tables(known: StatedKnowledge) -> dict[int, F64]:
    """For each axis asked for (7, nodes): v, offset, gain, u_low, u_high, error_low, error_high."""
    box, hulls = known.box, {DOWN: known.hull(DOWN, None)}
    span, bends, middle = max(box.high - box.low, 1e-9), known.bends(), hulls[DOWN].mean(axis=0)
    gain = (middle[1] - middle[0]) / span
    floored, still = np.maximum(gain, 1e-3), int(np.argmin(np.abs(known.at(DOWN))))
    hover = min(max(float(middle[1, still] / floored[still]) + box.low, box.low), box.high)
    known.lead = max(hover, 0.5 * (box.low + box.high))
    gains = known.lead * np.array([floored.min(), floored.max()])
    hulls |= {axis: known.hull(axis, (floored, hover)) for axis in known.data["axes"] if axis != DOWN}
    known.torque = number(known.data["torque_mps2"], "knowledge.torque_mps2") * float(floored.max())
    out = {}
    for axis, hull in hulls.items():
        ends = middle = hull.mean(axis=0)
        half = 0.5 * (hull[1] - hull[0])
        columns = [ends[1] + gain * box.low, gain]
        if axis != DOWN:
            least, most = hull[0].min(axis=0), hull[1].max(axis=0)
            columns = [0.5 * (least + most), np.zeros(known.nodes)]
            kept = box.kept(axis)  # what the weakest gain gives at one end, and the strongest leaves at the other
            ends = columns[0] - np.array([[(gains * kept[1]).min()], [(gains * kept[0]).max()]])
            half, middle = np.stack([0.5 * (most - least)] * 2), np.stack([columns[0]] * 2)
        errors = []
        for end in range(2):
            around = [half[end]]
            for step in (1, -1):
                near = np.abs(np.roll(middle[end], step) - middle[end]) + np.roll(half[end], step)
                near[0 if step > 0 else -1] = 0.0
                around.append(near)
            errors.append(np.max(around, axis=0) + known.k * bends[axis] + known.widen[axis] + torque_of(known, axis))
        out[axis] = np.array([known.at(axis), *columns, *ends, *errors])
    return out


def read(data: Any, box: Box, delta: float, k: float, version: Any) -> StatedKnowledge:
    """The knowledge of a certificate with this thrust box, chance, sigmas and version."""
    learned = isinstance(data, dict) and data.get("kind") == "learned"
    also = tuple(key for key in _ALSO if isinstance(data, dict) and key in data)
    table_of(data, _KEYS + (_LEARNED if learned else ()) + also, "knowledge")
    if data.get("hand_over", False) is not False:
        raise Refused("knowledge.hand_over: what it rests on was falsified in flight")
    for key, size in (("drag_per_s", 3), ("heights_m", 2), ("widen_mps2", 3), ("k_queries", 3)):
        rows([data[key]], size, f"knowledge.{key}")
    for key in ("gravity_mps2", "rotor_radius_m", "delta", "k_sigma", "statements", "version", "torque_mps2"):
        number(data[key], f"knowledge.{key}")
    speeds, nodes = rows(data["speeds_mps"], 2, "knowledge.speeds_mps"), data["nodes"]
    if not isinstance(nodes, int) or not 2 <= nodes <= 200 or not isinstance(data["slice_only"], bool):
        raise Refused("knowledge: nodes must be a whole number of 2 to 200, slice_only true or false")
    low, high = data["heights_m"]
    if speeds.shape != (3, 2) or not (
        np.all(speeds[:, 0] < speeds[:, 1]) and low <= high and data["rotor_radius_m"] > 0.0
    ):
        raise Refused("knowledge: speeds, heights and the rotor's radius must be ranges in order, and above 0")
    if min(*data["drag_per_s"], *data["widen_mps2"], data["torque_mps2"]) < 0.0 or not 9.7 < data["gravity_mps2"] < 9.9:
        raise Refused("knowledge: drag and widening must be at least 0, gravity about 9.8 m/s^2")
    initial = None
    if data["initial"] is not None:
        table = table_of(data["initial"], ("mass_ratio", "force_weights"), "knowledge.initial")
        ratio = rows([table["mass_ratio"]], 2, "knowledge.initial.mass_ratio")[0]
        initial = float(ratio[0]), float(ratio[1]), number(table["force_weights"], "knowledge.initial.force_weights")
        if not (0.0 < initial[0] <= initial[1] and initial[2] >= 0.0):
            raise Refused("knowledge.initial: mass_ratio must be in order and above 0, force_weights at least 0")
    if initial is None and not learned:
        raise Refused("knowledge: nothing is known: neither initial bounds nor a learned process")
    axes = data["axes"]
    if (
        not isinstance(axes, list)
        or not all(type(axis) is int and 0 <= axis < 3 for axis in axes)
        or len(set(axes)) != len(axes)
    ):
        raise Refused("knowledge.axes must be a list of axes, 0 to 2")
    widen, heights = np.array(data["widen_mps2"], np.float64), (float(low), float(high))
    stores = [_process(data[name], count, name) for name, count in (("lateral", 2), ("vertical", 1))] if learned else []
    known = StatedKnowledge(data, box, speeds, heights, nodes, k, tuple(data["k_queries"]), widen, initial, stores)
    _check_chance(known, delta, k, version)
    return known


def _process(value: Any, outputs: int, name: str) -> StatedProcess:
    where = f"knowledge.{name}"
    table_of(value, (*_PROCESS, "drift") if isinstance(value, dict) and "drift" in value else _PROCESS, where)
    x, y = rows(value["x"], 7, f"{where}.x"), rows(value["y"], outputs, f"{where}.y")
    excess, inflation, rest = (
        rows([value[key]], outputs, f"{where}.{key}")[0] for key in ("excess", "inflation", "remainder_mps2")
    )
    noise = number(value["noise_var"], f"{where}.noise_var")
    if len(x) != len(y):
        raise Refused(f"{where}: {len(x)} x belong to {len(y)} y")
    floors.check_process(noise, inflation, excess, rest, where)
    windows, drift = stamps(value["windows_us"], len(x), where), (0.0, 1.0)
    more = noise * np.eye(len(x))
    if "drift" in value:
        variance, time_s = numbers(value["drift"], ("variance", "time_s"), f"{where}.drift")
        drift = (variance, time_s)
        floors.check_drift(drift, noise, excess, len(windows) == len(x), where)
        more += wandering(drift, windows[:, 1], windows[:, 1])
    lower = factor(value["kernel"], x, more, f"{where}.kernel")
    floors.check_fit(y, lower, inflation, where)
    return StatedProcess(value["kernel"], lower, inflation, rest, excess, x, y, noise, windows, drift)


def _check_chance(known: StatedKnowledge, delta: float, k: float, version: Any) -> None:
    """delta, k_sigma, the count of statements and the hash of the points belong together."""
    data = known.data
    if (data["delta"], data["k_sigma"], data["version"]) != (delta, k, version):
        raise Refused("knowledge: delta, k_sigma and version are not the certificate's")
    if any(known.k_queries[axis] != k for axis in range(3) if axis not in {DOWN, *data["axes"]}):
        raise Refused("knowledge.k_queries of an axis that is not asked for is not k_sigma")
    if not known.stores:
        return
    if not isinstance(data.get("last", False), bool):
        raise Refused("knowledge: last must be true or false")
    statements = len({DOWN, *data["axes"]}) * 2 * (known.queries * known.nodes + known.nodes - 1)
    statements += 2 * known.queries * known.nodes if known.last else 0
    if (
        data["statements"] != statements
        or not isinstance(version, int)
        or not 1 <= version <= _MOST_VERSIONS
        or not 0.0 < delta < 1.0
    ):
        raise Refused(f"knowledge: statements must be {statements}, version 1 to {_MOST_VERSIONS}, delta in 0 to 1")
    shares = [6.0 / (math.pi * n) ** 2 for n in range(1, version + 1)]
    allowed = delta * (1.0 - sum(shares[:-1]) if known.last else shares[-1]) / statements
    if not math.erfc(k / math.sqrt(2.0)) <= allowed * (1.0 + 1e-9):
        raise Refused(f"k_sigma = {k:.6g} is less than delta = {delta:g} asks for with {statements} statements")
    digest = hashlib.sha256()
    for store in known.stores:
        digest.update(store.x.astype("<f8").tobytes() + store.y.astype("<f8").tobytes())
    if data["sha256"] != digest.hexdigest():
        raise Refused("knowledge.sha256 is not the hash of the points")
