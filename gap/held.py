"""Whether a named effect does on data not used before what it did where it was learned.

Without the effect, the held-out disagreement is what the effect makes there and what is left anyway.  If the
effect is really there and of the size that was found, the slope of the one against the other is 1 wherever one looks; a
proxy's slope falls away, and what grows with time shows a slope beyond 1 on what was flown last.  The slope's error is
of the sandwich kind over seconds, so that a slow remainder is not taken for many errors.

Where a model leaves much more than noise, small effects only trim what it lacks: one is kept if what is left on the
held-out data, all others fitted again, would be clearly more without it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from flightstack.effect_specs import EFFECT_SPECS
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from gap.compare import residual
from gap.pooled import Split
from gap.records import Estimate, Found, Gap
from gap.remainder import GROUPS
from gap.scales import natural_scale
from gap.simulate import Knob, sensitivities, value, with_value

_BLOCK_S = 1.0
_FEWEST_BLOCKS = 4
_SURE = 2.0
"""Standard errors by which a slope must miss what is allowed."""
_LEAST = 0.5
"""Slope below which less than nothing of the effect's own share is closed."""
_FAR = 3.0
"""Times the noise floor, from which a model is taken to lack something."""
_CLEARLY = 0.2
"""Share by which the mean square that is left must rise."""
_TRIFLE = 0.02
"""Of the mean square before anything was named, what is small anyway."""
_NOT_CONSTANT_P = 1e-6
_STEPS = 6
_AS_GOOD = 1.5
"""Times the mean square of plain least squares, up to which an estimate by the noise model is the better one."""
_NEXT_TO = 1e-6
_WORTH = 1e-3
"""Share that another step must gain."""
_REACH = 1.959964
_LEAST_BESIDE, _MOST_BESIDE = 0.75, 4.0 / 3.0
"""What is allowed where something else that nothing explains is there as well (0.75: half the own share is closed)."""


@dataclass(frozen=True, slots=True)
class Slope:
    """Slope of the held-out disagreement against what effects make of it, and its standard error."""

    value: float
    error: float

    def holds(self, *, beside: bool) -> bool:
        """Whether the effects do what they did; `beside`: something that nothing explains is there as well."""
        low, high = (_LEAST_BESIDE, _MOST_BESIDE) if beside else (_LEAST, np.inf)
        return self.value + _SURE * self.error >= low and self.value - _SURE * self.error <= high


def slope(without: Vehicle, corrected: Vehicle, of: Split) -> Slope:
    """Of the held-out residual of `without` against what `corrected` makes of it; 1 +- 0 where that can't be said."""
    shares: list[F64] = []
    pairs = []
    for samples, mask in zip(of.flights, of.holdout, strict=True):
        if not mask.any():
            continue
        was, now = residual(without, samples).y[mask], residual(corrected, samples).y[mask]
        pairs.append((np.nan_to_num(was), np.nan_to_num(now), max(1, round(_BLOCK_S / samples.dt_s))))
    if not pairs:
        return Slope(1.0, 0.0)
    left = np.sqrt(np.mean(np.concatenate([now for _, now, _ in pairs]) ** 2, axis=0))
    weight = np.where(left > 0.0, 1.0 / np.maximum(left, 1e-12), 0.0)
    for was, now, size in pairs:
        made, rest = (was - now) * weight, now * weight
        rows = np.stack([np.sum(made * rest, axis=1), np.sum(made * made, axis=1)], axis=1)
        count = len(rows) // size
        shares.append(rows[: count * size].reshape(count, size, 2).sum(axis=1))
    blocks = np.concatenate(shares)
    power = float(blocks[:, 1].sum())
    if len(blocks) < _FEWEST_BLOCKS or power <= 0.0:
        return Slope(1.0, 0.0)
    off = float(blocks[:, 0].sum()) / power
    scatter = blocks[:, 0] - off * blocks[:, 1]
    return Slope(1.0 + off, float(np.sqrt(np.sum(scatter**2))) / power)


def doubtful(believed: Vehicle, found: Sequence[Found], of: Split, *, beside: bool) -> tuple[str, ...]:
    """Named effects that don't hold on data not used before; all of them where they don't hold together."""
    whole = corrected(believed, found)
    if not slope(believed, whole, of).holds(beside=beside):
        return tuple(each.name for each in found)
    if len(found) == 1:
        return ()
    others = {each.name: corrected(believed, [f for f in found if f is not each]) for each in found}
    return tuple(name for name, without in others.items() if not slope(without, whole, of).holds(beside=beside))


def corrected(believed: Vehicle, found: Sequence[Found]) -> Vehicle:
    """The vehicle with these effects at their estimates."""
    vehicle = believed
    for each in found:
        vehicle = with_value(vehicle, each.name, {p: e.estimate for p, e in each.parameters.items()})
    return vehicle


def trimmings(
    believed: Vehicle, found: Sequence[Found], of: Split, gap: Gap, constant: Mapping[str, float] = MappingProxyType({})
) -> tuple[str, ...]:
    """Named effects that are no effects of this vehicle, but trim what its model lacks; () near the noise.

    Those that stand at the end of their range, those whose size changes from stretch to stretch (`constant`: p-values
    of its being the same), then, weakest first, those without which hardly more would be left on the held-out data.
    """
    pairs = [(getattr(gap.after, n), getattr(gap.noise_floor, n)) for n in ("one_step_mps2", "one_step_radps2")]
    if not any(now is not None and least is not None and now > _FAR * least for now, least in pairs):
        return ()
    gone = [f.name for f in found if f.name in on_edge(found) or constant.get(f.name, 1.0) < _NOT_CONSTANT_P]
    left = [f for f in found if f.name not in gone]
    before = _powers(believed, [], of)
    while len(left) > 1:
        base = _fitted_again(believed, left, of)
        gains = {}
        for each in left:
            more = _fitted_again(believed, [f for f in left if f is not each], of)
            gains[each.name] = float(np.max((more - base) / np.maximum(base + _TRIFLE * before, 1e-300)))
        weakest = min(gains, key=lambda effect: gains[effect])
        if gains[weakest] >= _CLEARLY:
            break
        gone.append(weakest)
        left = [f for f in left if f.name != weakest]
    return tuple(gone)


def fitted_plainly(believed: Vehicle, found: Sequence[Found], of: Split) -> tuple[Found, ...]:
    """These effects with their parameters by plain least squares, far from the noise.

    A noise model learned from what a poor model leaves takes slow disagreement for colour and hardly looks at it: such
    estimates may leave a weight uncarried.  Here each channel counts by its sensors' noise, steps are taken while
    they leave less, and intervals are of the sandwich kind over blocks of a second.  Sensor effects stay as they are,
    and so do all where the noise model's estimates leave little more.
    """
    moved = [f for f in found if EFFECT_SPECS[f.name].kind != "sensor"]
    knobs = [Knob(f.name, p) for f in moved for p in _free(f)]
    if not knobs:
        return tuple(found)
    now, rows = corrected(believed, found), None
    for _ in range(_STEPS):
        rows = _rows(now, knobs, of)
        step = _within(now, knobs, rows.x.reshape(-1, len(knobs)), rows.y.ravel())
        after = now
        for knob, change in zip(knobs, step, strict=True):
            spec = next(p for p in EFFECT_SPECS[knob.effect].params if p.name == knob.parameter)
            to = float(np.clip(value(now, knob.effect, knob.parameter) + change, spec.minimum, spec.maximum))
            if abs(to - spec.minimum) < _NEXT_TO * natural_scale(believed, knob.effect, knob.parameter):
                to = spec.minimum
            after = with_value(after, knob.effect, {knob.parameter: to})
        if _rows(after, [], of).power > (1.0 - _WORTH) * _rows(now, [], of).power:
            break
        now = after
    assert rows is not None
    if _rows(corrected(believed, found), [], of).power < _AS_GOOD * _rows(now, [], of).power:
        return tuple(found)
    reach = _REACH * np.sqrt(np.diag(rows.covariance()))
    half = {(k.effect, k.parameter): float(each) for k, each in zip(knobs, reach, strict=True)}
    return tuple(replace(f, parameters=_at(f, now, half)) if f in moved else f for f in found)


def _at(found: Found, vehicle: Vehicle, half: Mapping[tuple[str, str], float]) -> dict[str, Estimate]:
    """Its parameters as this vehicle has them."""
    out = dict(found.parameters)
    for name in _free(found):
        spec = next(p for p in EFFECT_SPECS[found.name].params if p.name == name)
        now, reach = value(vehicle, found.name, name), half[found.name, name]
        low, high = max(now - reach, spec.minimum), min(now + reach, spec.maximum)
        out[name] = Estimate(found.parameters[name].before, now, low, high)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Weighed rows to learn from: y (N, 6), x (N, 6, K), and their block numbers (N,)."""

    y: F64
    x: F64
    block: NDArray[np.int64]

    @property
    def power(self) -> float:
        """Mean square that is left."""
        return float(np.mean(self.y**2))

    def covariance(self) -> F64:
        """(K, K) sandwich over blocks."""
        flat = self.x.reshape(-1, self.x.shape[2])
        inverse = np.linalg.pinv(flat.T @ flat)
        left = self.y - self.x @ (inverse @ (flat.T @ self.y.ravel()))
        scores = np.einsum("nc,nck->nk", left, self.x)
        sums = np.zeros((int(self.block.max(initial=0)) + 1, flat.shape[1]))
        np.add.at(sums, self.block, scores)
        return np.asarray(inverse @ (sums.T @ sums) @ inverse)


def _rows(vehicle: Vehicle, knobs: Sequence[Knob], of: Split) -> _Rows:
    ys, xs, blocks, count = [], [], [], 0
    for samples, fit in zip(of.flights, of.fit, strict=True):
        if not fit.any():
            continue
        ys.append(np.nan_to_num(residual(vehicle, samples).y[fit, :6]))
        columns = sensitivities(vehicle, samples, knobs)[fit, :6] if knobs else np.zeros((len(ys[-1]), 6, 0))
        xs.append(np.nan_to_num(columns))
        blocks.append(count + np.arange(len(ys[-1])) * samples.dt_s // _BLOCK_S)
        count = int(blocks[-1][-1]) + 1
    y, x = np.concatenate(ys), np.concatenate(xs)
    weight = _weights(vehicle, of)
    return _Rows(y * weight, x * weight[:, None], np.concatenate(blocks).astype(np.int64))


def _weights(vehicle: Vehicle, of: Split) -> F64:
    """(6,) one over each channel's noise; 0 where it is not measured."""
    noise = np.array([residual(vehicle, samples).noise[:6] for samples in of.flights])
    worst = np.max(np.nan_to_num(noise), axis=0)
    return np.where(worst > 0.0, 1.0 / np.maximum(worst, 1e-12), 0.0)


def _fitted_again(believed: Vehicle, found: Sequence[Found], of: Split) -> F64:
    """(groups,) what these effects leave, fitted alike whether one more is among them or not."""
    return _powers(corrected(believed, found), [Knob(f.name, p) for f in found for p in _free(f)], of)


def on_edge(found: Sequence[Found]) -> tuple[str, ...]:
    """Effects with a parameter at the end of its range."""
    return tuple(f.name for f in found if any(_on_edge(f.name, p, e.estimate) for p, e in f.parameters.items()))


def _on_edge(effect: str, parameter: str, estimate: float) -> bool:
    """Whether an estimate has run against the far end of its range: what it stands for is something else."""
    spec = next(p for p in EFFECT_SPECS[effect].params if p.name == parameter)
    ends = [end for end in (spec.minimum, spec.maximum) if spec.null is None or end != spec.null]
    return not spec.integer and any(abs(estimate - end) <= 1e-6 * abs(end) for end in ends)


def _free(found: Found) -> list[str]:
    return [p.name for p in EFFECT_SPECS[found.name].params if not p.integer and p.name in found.parameters]


def _within(vehicle: Vehicle, knobs: Sequence[Knob], x: F64, y: F64) -> F64:
    """(K,) changes of these parameters by least squares that stay in their ranges."""
    from scipy.optimize import lsq_linear  # here: a fifth of a second that most flights need not wait for

    size = np.maximum(np.linalg.norm(x, axis=0), 1e-300)
    specs = [next(p for p in EFFECT_SPECS[k.effect].params if p.name == k.parameter) for k in knobs]
    now = np.array([value(vehicle, k.effect, k.parameter) for k in knobs])
    low = np.minimum((np.array([p.minimum for p in specs]) - now) * size, -1e-12)
    high = np.maximum((np.array([p.maximum for p in specs]) - now) * size, 1e-12)
    x = x / size
    damped = x.T @ x + 1e-6 * np.eye(len(size))
    root = np.linalg.cholesky(damped)
    return np.asarray(lsq_linear(root.T, np.linalg.solve(root, x.T @ y), bounds=(low, high)).x / size)


def _powers(vehicle: Vehicle, knobs: Sequence[Knob], of: Split) -> F64:
    """(groups,) held-out mean square of side force, lift and torque, these parameters fitted again where one learns."""
    rows: list[tuple[F64, F64, F64, F64]] = []
    for samples, fit, held in zip(of.flights, of.fit, of.holdout, strict=True):
        y = np.nan_to_num(residual(vehicle, samples).y[:, :6])
        x = np.nan_to_num(sensitivities(vehicle, samples, knobs)[:, :6]) if knobs else np.zeros((*y.shape, 0))
        rows.append((y[fit], x[fit], y[held], x[held]))
    y_fit, x_fit, y_held, x_held = (np.concatenate([row[k] for row in rows]) for k in range(4))
    if knobs and len(y_fit):
        weight = _weights(vehicle, of)
        flat = (x_fit * weight[:, None]).reshape(-1, len(knobs))
        y_held = y_held - x_held @ _within(vehicle, knobs, flat, (y_fit * weight).ravel())
    return np.array([np.mean(np.sum(y_held[:, list(channels)] ** 2, axis=1)) for channels in GROUPS.values()])
