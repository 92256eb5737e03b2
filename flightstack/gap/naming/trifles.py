"""Which of the named effects only trim what a poor model lacks: judged on rows that nothing was learned from.

Far from the noise everything that bends a curve helps a little.  An effect of the vehicle makes what is left on
held-out rows clearly smaller, second for second; the rest is taken back, weakest first, the others fitted again.  It
may show in either of two views: in whitened rows, where slow disagreement (which a rate loop's disturbances make of
torques) counts little, or in the rows as they are, where fast disagreement counts little.  What doubles any group's
remainder there goes, unless that is less than a tenth of what it takes away elsewhere: a drag sideways stays, whatever
its vertical part spoils of the lift.  What a sensor errs by shows in what the log's signals say of one another, too:
there gusts are nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.gap.decisions import CLEAR_SHARE, CLEARLY, SURE_ERRORS, TENTH
from flightstack.gap.naming.design import Layout, layout_of
from flightstack.gap.naming.estimate import Estimates, parameter_change
from flightstack.gap.naming.search import SelectionState
from flightstack.gap.naming.whitening import Mask
from flightstack.gap.remainder import GROUPS
from flightstack.gap.simulate import FreeParameter
from flightstack.types import F64

_FEWEST_BLOCKS = 4
_KINEMATIC = ((6, 7, 8), (9, 10, 11))
"""Channels in which no physics acts: the gyro against the attitude, the accelerometer against the velocity."""


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """Rows of one kind: `x` (R, n) columns, `whole` (R,) the disagreement with no effect at all."""

    layout: Layout
    x: F64
    whole: F64
    rate: F64
    """(flights,) rows a second."""

    @property
    def learned(self) -> Mask:
        """(R,) rows to learn from."""
        return self.layout.keep & ~self.layout.held

    @property
    def judged(self) -> Mask:
        """(R,) rows that nothing is learned from."""
        return self.layout.keep & self.layout.held

    def left(self, mine: list[int], fit: Mask) -> F64:
        """(R,) what these columns leave, fitted on these rows."""
        x = self.x[:, mine]
        size = np.maximum(np.linalg.norm(x[fit], axis=0), 1e-300)
        theta = np.linalg.lstsq(x[fit] / size, self.whole[fit], rcond=1e-9)[0] / size
        return np.asarray(self.whole - x @ theta)

    def left_across(self, mine: list[int]) -> F64:
        """(R,) what these columns leave of each quarter of the rows to learn from, fitted on the other three."""
        at, out = np.flatnonzero(self.learned), self.whole.copy()
        quarter = np.zeros(len(self.whole), dtype=np.int64)
        when = self.layout.flight[at] * 1e9 + self.layout.at[at]
        quarter[at] = np.searchsorted(np.quantile(when, (0.25, 0.5, 0.75)), when)
        for k in range(4):
            own = self.learned & (quarter == k)
            out[own] = self.left(mine, self.learned & ~own)[own]
        return out

    def worth(self, base: F64, without: F64, judged: Mask, effect: str) -> float:
        """Greatest sure rise of a group's mean square over these rows, relative; a fall where it is large, and no
        trifle beside what the effect does elsewhere."""
        best = worst = helps = harms = 0.0
        for channels in (*GROUPS.values(), *(_KINEMATIC if EFFECTS[effect].kind == "sensor" else ())):
            mine = judged & np.isin(self.layout.channel, channels)
            if not mine.any():
                continue
            blocks = self._seconds(mine, without[mine] ** 2 - base[mine] ** 2)
            risen = float(blocks.sum())
            if len(blocks) < _FEWEST_BLOCKS:
                continue
            if abs(risen) > SURE_ERRORS * float(np.std(blocks, ddof=1)) * np.sqrt(len(blocks)):
                share = risen / max(float(np.sum(base[mine] ** 2)), 1e-300)
                best, worst = max(best, share), min(worst, share)
                helps, harms = max(helps, risen), max(harms, -risen)
        return worst if worst <= -CLEAR_SHARE and harms >= TENTH * helps else best

    def _seconds(self, mine: Mask, change: F64) -> F64:
        """Sums of these rows' changes over each second of each flight."""
        flight = self.layout.flight[mine]
        second = (self.layout.at[mine] / self.rate[flight]).astype(np.int64)
        _, block = np.unique(np.stack([flight, second]), axis=1, return_inverse=True)
        return np.asarray(np.bincount(block.ravel(), weights=change), dtype=np.float64)


def trifles(state: SelectionState, made: Estimates, effects: Sequence[str]) -> tuple[str, ...]:
    """Of these effects, all in `made`, those that are taken back; () where nothing is held out."""
    if not np.any(state.point.layout.keep & state.point.layout.held):
        return ()
    views = _views(state, made)
    left, gone = list(effects), list[str]()
    while len(left) > 1:
        worth = {effect: _of_all(_worth(view, made, left, effect) for view in views) for effect in left}
        weakest = min(worth, key=lambda effect: worth[effect])
        if worth[weakest] >= CLEARLY:
            break
        gone.append(weakest)
        left.remove(weakest)
    return tuple(gone)


def mse_increase(state: SelectionState, made: Estimates, effects: Sequence[str], effect: str) -> tuple[float, float]:
    """What one of these effects (all in `made`) is worth: across the rows to learn from, and on held-out ones."""
    views = _views(state, made)
    base, less = _columns(made, effects), _columns(made, [e for e in effects if e != effect])
    across = (view.worth(view.left_across(base), view.left_across(less), view.learned, effect) for view in views)
    return _of_all(across), _of_all(_worth(view, made, effects, effect) for view in views)


def _of_all(worths: Iterable[float]) -> float:
    """An effect must help in one view and do harm in none."""
    values = list(worths)
    return min(values) if min(values) < 0.0 else max(values)


def _worth(view: _View, made: Estimates, effects: Sequence[str], gone: str) -> float:
    base, less = (
        view.left(_columns(made, kept), view.learned) for kept in (effects, [e for e in effects if e != gone])
    )
    return view.worth(base, less, view.judged, gone)


def _columns(made: Estimates, effects: Sequence[str]) -> list[int]:
    return [i for i, (effect, _) in enumerate(made.slots) if effect in effects]


def _views(state: SelectionState, made: Estimates) -> tuple[_View, _View]:
    changed = parameter_change(state, made)
    bench, coloured = state.bench, state.point.layout
    rate = np.array([bench.rate(f) for f in range(len(bench.fit))])
    rows = bench.residual(made.vehicle)
    raw = [np.nan_to_num(x) for x in bench.columns(made.vehicle, [FreeParameter(e, p) for e, p in made.slots])]
    plain = layout_of(bench, rows, coloured=False)
    x = plain.stack(raw)
    return (
        _View(coloured, made.x, made.rows + made.x @ changed, rate),
        _View(plain, x, plain.stack(rows) + x @ changed, rate),
    )
