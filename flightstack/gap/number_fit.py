"""What logs say of the numbers of a vehicle file: Gauss-Newton on the one-step residual, ranges as what is known.

A number's column is the difference of two predictions of the simulator, as an effect's is.  What the file gives as a
range is free, with a prior of the range's width (a uniform distribution's first two moments about the file's value);
plain numbers are known.  Effects that the file lacks are looked for beside the numbers and fitted along, so that a
drag that nobody wrote down does not bend a mass.  Intervals hold noise and what sampling hides (`gap.naming.estimate`)
and are cut off at the ranges.

Accelerations show ratios only: mass, greatest thrust, inertia, drag and forces times two fly alike.  That common
scale is as well known as the ranges tell, and every number over the mass may be known far better.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from flightstack.file_numbers import FileNumber, file_numbers, with_numbers
from flightstack.gap.name import name
from flightstack.gap.naming.bench import SimulatorBench, simulator_bench
from flightstack.gap.naming.candidates import fitted
from flightstack.gap.naming.design import layout_of, linearise
from flightstack.gap.naming.estimate import CI, covariance_of, without_nuisance
from flightstack.gap.naming.metric import bounded_step, metric_of
from flightstack.gap.naming.ranged import STANDS_FOR
from flightstack.gap.naming.search import SelectionState, pressed_beyond
from flightstack.gap.pooled import FitHoldoutSplit
from flightstack.gap.records import Unexplained
from flightstack.gap.simulate import FreeParameter, value, with_value
from flightstack.types import F64
from flightstack.vehicle import Vehicle

_STEP = 1e-3
"""Of a number's range, by which its column is taken."""
_ROUNDS = 3
_STEPS = 5
_HALVINGS = 4
_STILL = 0.02
_TOLD = 0.7
"""Posterior over prior deviation below which a log tells something of a number."""
_ALIKE = 0.9
"""Correlation from which two numbers are of one class."""
_SPREADS = {"body.inertia_kgm2": 1.7, "rotors.torque_ratio_m": 3.2, "rotors.max_thrust_n": 1.5}
"""Where a file gives no range at all: factors of what nobody measures without a stand (docs/vehicle.md)."""
_LAG_SPREAD = 3.0
_STANDS_FOR = {effect: name.split("[")[0] for (effect, _), name in STANDS_FOR.items()} | {
    "com_offset": "rotors.position_m"
}
"""Effect -> the file's key that it is under another name."""


@dataclass(frozen=True, slots=True)
class FittedNumber:
    """What the logs say of one number."""

    number: FileNumber
    estimate: float
    low: float
    high: float
    """95 % interval, within the file's range."""
    told_by: str
    """"logs", "scale" (up to the common scale, which only ranges tell), "range" (hardly more than the file says) or
    "file" (a plain number: taken as known)."""
    like: tuple[str, ...] = ()
    """Names of numbers that these logs can hardly tell from it."""


@dataclass(frozen=True, slots=True)
class ScaleClass:
    """The numbers whose common scale no acceleration shows."""

    members: tuple[str, ...]
    known_by: str
    """The plain number that fixes the scale, "" where only ranges do."""
    spread: float
    """Relative 95 % half-width of the common scale; 0 where it is fixed."""
    per_kg: Mapping[str, tuple[float, float, float]]
    """Ranged member over the file's mass: estimate, low, high."""


@dataclass(frozen=True, slots=True, eq=False)
class NumberFit:
    """The result of `fit_numbers`."""

    vehicle: Vehicle
    """With the estimates; ranges are the intervals of what the logs tell."""
    numbers: tuple[FittedNumber, ...]
    scale: ScaleClass
    missing: Mapping[str, Mapping[str, float]]
    """Effects that the logs show beside the numbers and the file lacks."""
    contradicted: tuple[str, ...]
    """Keys of plain numbers that an effect found beside would change: they or the effect are wrong."""
    unexplained: Unexplained
    pressed: tuple[str, ...]
    """Numbers at an end of their range that the logs clearly want to be beyond it."""
    assumed: bool
    """Whether the file gave no range at all, so that usual ones were taken."""


def with_usual_ranges(vehicle: Vehicle) -> Vehicle:
    """A vehicle without any range, with usual ones: mass and geometry stay known."""
    ranges: dict[str, F64] = {}
    for number_key, factor in _SPREADS.items():
        table, key = number_key.split(".")
        values = np.asarray(getattr(vehicle if table == "body" else vehicle.rotors, key), dtype=np.float64)
        ranges[number_key] = np.sort(np.stack([values / factor, values * factor], axis=-1), axis=-1)
    lag = vehicle.rotors.time_constant_s
    ranges["rotors.time_constant_s"] = np.array([lag / _LAG_SPREAD, max(lag * _LAG_SPREAD, 0.02)])
    ranges["rotors.thrust_model_factor"] = np.array([0.0, 1.0])
    return replace(vehicle, ranges=MappingProxyType(ranges))


def fit_numbers(vehicle: Vehicle, of: FitHoldoutSplit) -> NumberFit:
    """What these flights say of the vehicle's numbers; ranges decide what is free (`with_usual_ranges` without any)."""
    assumed = not vehicle.ranges
    start = with_usual_ranges(vehicle) if assumed else vehicle
    whole = [s.valid for s in of.flights]
    bench = simulator_bench(start, of.flights, whole, [m & False for m in whole])
    numbers = [n for n in file_numbers(start) if n.is_ranged]
    found = _Fit(bench, start, tuple(numbers))
    found.solve()
    naming = name(found.vehicle, of.flights, of.fit, of.holdout)
    free = {n.key for n in numbers}
    beside = {f.name: f for f in naming.found if _STANDS_FOR.get(f.name) not in free}
    values = {e: {p: x.estimate for p, x in f.parameters.items()} for e, f in beside.items()}
    if values or not numbers:
        found = _Fit(bench, start, tuple(numbers), found.vehicle, values)
        found.solve()
    contradicted = tuple(_STANDS_FOR[e] for e in values if e in _STANDS_FOR)
    missing = {e: {p: value(found.vehicle, e, p) for p in told} for e, told in values.items()}
    scale = found.scale()
    told = _possible(tuple(_up_to_scale(each, scale) for each in found.told()), found.vehicle)
    fitted_vehicle = replace(
        with_numbers(start, {f.number: f.estimate for f in told}), ranges=MappingProxyType(_narrowed(start, told))
    )
    known = tuple(FittedNumber(n, n.value, n.value, n.value, "file") for n in file_numbers(start) if not n.is_ranged)
    order = {n.name: k for k, n in enumerate(file_numbers(start))}
    rows = tuple(sorted((*told, *known), key=lambda row: order[row.number.name]))
    return NumberFit(fitted_vehicle, rows, scale, missing, contradicted, naming.unexplained, found.pressed, assumed)


def _possible(told: tuple[FittedNumber, ...], vehicle: Vehicle) -> tuple[FittedNumber, ...]:
    """The numbers with the greatest inertia brought to the sum of the others where it is beyond: no body has more."""
    most = int(np.argmax(vehicle.inertia_kgm2))
    least = float(vehicle.inertia_kgm2.sum() - vehicle.inertia_kgm2[most])
    if vehicle.inertia_kgm2[most] <= least:
        return told
    return tuple(
        replace(each, estimate=max(least, each.low), low=min(each.low, least))
        if (each.number.key, each.number.index) == ("body.inertia_kgm2", (most,))
        else each
        for each in told
    )


def _up_to_scale(told: FittedNumber, scale: ScaleClass) -> FittedNumber:
    """The number as told by the scale class where its share of the mass is known at least twice as well as itself."""
    if scale.known_by or told.number.name not in scale.members:
        return told
    ratio, low, high = scale.per_kg.get(told.number.name, (1.0, 1.0, 1.0))
    own = (told.high - told.low) / max(abs(told.estimate), 1e-300)
    return replace(told, told_by="scale") if 2.0 * (high - low) < own * abs(ratio) else told


def _narrowed(vehicle: Vehicle, told: Sequence[FittedNumber]) -> dict[str, F64]:
    """The ranges, each number's brought to its interval."""
    ranges = {key: np.array(pairs) for key, pairs in vehicle.ranges.items()}
    for each in told:
        ranges[each.number.key][each.number.index] = each.low, each.high
    for pairs in ranges.values():
        pairs.setflags(write=False)
    return ranges


class _Fit:
    """Numbers (K) and effects' parameters beside (E) as one vector in units of their priors."""

    def __init__(
        self,
        bench: SimulatorBench,
        start: Vehicle,
        numbers: tuple[FileNumber, ...],
        at: Vehicle | None = None,
        beside: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
    ) -> None:
        self._bench, self._start, self._numbers = bench, start, numbers
        self.vehicle = start if at is None else at
        for effect, values in beside.items():
            self.vehicle = with_value(self.vehicle, effect, values)
        self._knobs = [
            FreeParameter(e, p) for e in beside for p in fitted(self.vehicle, e, self.vehicle.effects[e]).parameters
        ]
        middle = np.array([0.5 * (n.low + n.high) - n.value for n in numbers])
        width = np.array([n.high - n.low for n in numbers])
        self._prior = np.sqrt(width**2 / 12.0 + middle**2)
        self._covariance = np.diag(self._prior**2)
        self.pressed: tuple[str, ...] = ()

    def solve(self) -> None:
        """Bring `vehicle` to the best fit within the ranges, the noise's colour learned anew in every round."""
        for _ in range(_ROUNDS):
            before = self._values(self.vehicle)
            point = linearise(self._bench, self.vehicle, self._start)
            state = SelectionState(self._bench, self._start, point, metric_of(point))
            x = self._settle(state)
            chosen = state.point.fit_rows()
            rows = without_nuisance(state, state.point.layout.stack(self._bench.residual(self.vehicle)), chosen)
            left = layout_of(self._bench, self._bench.residual(self.vehicle), coloured=True)
            prior = np.concatenate([1.0 / self._prior**2, np.zeros(len(self._knobs))])
            self._covariance = covariance_of(state, x, rows, chosen, left, prior)
            moved = np.abs(self._values(self.vehicle) - before)
            if np.all(moved < 0.1 * np.sqrt(np.diag(self._covariance)) + 1e-12):
                break

    def _settle(self, state: SelectionState) -> F64:
        """Gauss-Newton in one metric; the columns at the end."""
        chosen, layout = state.point.fit_rows(), state.point.layout
        nuisance = state.point.nuisance[chosen][:, state.point.nuisance_fitted]
        size = state.point.nuisance_size[state.point.nuisance_fitted]
        inner = np.linalg.inv(nuisance.T @ nuisance + np.diag(1.0 / size**2))

        def without(a: F64) -> F64:
            return np.asarray(a - nuisance @ (inner @ (nuisance.T @ a)))

        weight = np.concatenate([1.0 / self._prior**2, np.zeros(len(self._knobs))])
        low, high = self._limits()
        origin = np.concatenate([[n.value for n in self._numbers], np.zeros(len(self._knobs))])

        def cost(rows: F64, at: F64) -> float:
            return float(rows @ without(rows) + np.sum(weight * (at - origin) ** 2))

        x = self._columns(layout.stack)
        for _ in range(_STEPS):
            now = self._values(self.vehicle)
            rows = layout.stack(self._bench.residual(self.vehicle))[chosen]
            mine = without(x[chosen])
            k, b = x[chosen].T @ mine + np.diag(weight), mine.T @ rows - weight * (now - origin)
            unit = 1.0 / np.sqrt(np.maximum(np.diag(k), 1e-300))
            step = bounded_step(k * np.outer(unit, unit), b * unit, (low - now) / unit, (high - now) / unit)[0]
            sides = np.where(now <= low + 1e-9 * (high - low), -1, 0) + np.where(
                now >= high - 1e-9 * (high - low), 1, 0
            )
            self.pressed = tuple(self._numbers[i].name for i in pressed_beyond(k, b, sides) if i < len(self._numbers))
            if np.max(np.abs(step), initial=0.0) < _STILL:
                break
            share, was = 1.0, cost(rows, now)
            for _ in range(_HALVINGS):
                tried = self._at(np.clip(now + share * step * unit, low, high))
                if cost(layout.stack(self._bench.residual(tried))[chosen], self._values(tried)) < was:
                    self.vehicle = tried
                    break
                share *= 0.4
            else:
                break
            x = self._columns(layout.stack)
        return x

    def _limits(self) -> tuple[F64, F64]:
        specs = [fitted(self.vehicle, k.effect, self.vehicle.effects[k.effect]).spec(k.parameter) for k in self._knobs]
        low = [*(n.low for n in self._numbers), *(s.minimum for s in specs)]
        return np.array(low), np.array([*(n.high for n in self._numbers), *(s.maximum for s in specs)])

    def _values(self, vehicle: Vehicle) -> F64:
        now = {n.name: n.value for n in file_numbers(vehicle)}
        own = [now[n.name] for n in self._numbers]
        return np.array([*own, *(value(vehicle, k.effect, k.parameter) for k in self._knobs)])

    def _at(self, values: F64) -> Vehicle:
        vehicle = with_numbers(self.vehicle, dict(zip(self._numbers, values.tolist(), strict=False)))
        for knob, x in zip(self._knobs, values[len(self._numbers) :].tolist(), strict=True):
            vehicle = with_value(vehicle, knob.effect, {knob.parameter: x})
        return vehicle

    def _columns(self, stack: Callable[[Sequence[F64]], F64]) -> F64:
        """(R, K + E) whitened columns at the vehicle."""
        now = self._values(self.vehicle)
        parts: list[F64] = []
        for k, number in enumerate(self._numbers):
            step = _STEP * (number.high - number.low)
            low, high = max(now[k] - step, number.minimum), min(now[k] + step, number.maximum)
            less, more = (self._bench.residual(with_numbers(self.vehicle, {number: float(v)})) for v in (low, high))
            change = [np.nan_to_num((b - a) / (low - high)) for a, b in zip(less, more, strict=True)]
            parts.append(stack(change)[:, None])
        if self._knobs:
            parts.append(stack([np.nan_to_num(c) for c in self._bench.columns(self.vehicle, self._knobs)]))
        return np.hstack(parts) if parts else np.zeros((len(stack(self._bench.residual(self.vehicle))), 0))

    def told(self) -> tuple[FittedNumber, ...]:
        """Each ranged number with its interval and what it can't be told from."""
        values = self._values(self.vehicle)
        sigma = np.sqrt(np.maximum(np.diag(self._covariance), 0.0))
        correlation = self._covariance / np.maximum(np.outer(sigma, sigma), 1e-300)
        found = []
        for k, number in enumerate(self._numbers):
            low, high = max(values[k] - CI * sigma[k], number.low), min(values[k] + CI * sigma[k], number.high)
            like = tuple(o.name for j, o in enumerate(self._numbers) if j != k and abs(correlation[k, j]) > _ALIKE)
            tells = sigma[k] < _TOLD * self._prior[k]
            if not tells:
                low, high = number.low, number.high
            found.append(FittedNumber(number, float(values[k]), low, high, "logs" if tells else "range", like))
        return tuple(found)

    def scale(self) -> ScaleClass:
        """The class of the common scale, and its ranged members over the mass."""
        every = [n for n in file_numbers(self._start) if n.is_of_mass and n.value != 0.0]
        known = next((n.name for n in every if not n.is_ranged), "")
        values = dict(zip((n.name for n in self._numbers), self._values(self.vehicle).tolist(), strict=False))
        place = {n.name: k for k, n in enumerate(self._numbers)}
        mass = next(n for n in every if n.key == "body.mass_kg")
        own = values.get(mass.name, mass.value)
        per_kg: dict[str, tuple[float, float, float]] = {}
        for number in every:
            if number is mass or number.name not in place:
                continue
            gradient = np.zeros(len(self._covariance))
            gradient[place[number.name]] = 1.0 / own
            ratio = values[number.name] / own
            if mass.name in place:
                gradient[place[mass.name]] -= ratio / own
            half = CI * math.sqrt(max(float(gradient @ self._covariance @ gradient), 0.0))
            per_kg[number.name] = (ratio, ratio - half, ratio + half)
        spread = 0.0
        if not known and mass.name in place:
            spread = CI * math.sqrt(self._covariance[place[mass.name], place[mass.name]]) / own
        return ScaleClass(tuple(n.name for n in every), known, spread, per_kg)
