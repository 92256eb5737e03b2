"""Proves that each cell's command meets the condition in all of it, and that the cells cover the region.

What covers: all edges of all cells cut the plane into a grid; each field of it is in a cell, or the concave h is below
the edge on it, because a tangent plane of h is.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from .condition import E_HIGH, E_LOW, SLACK, V_HIGH, V_LOW, Condition
from .intervals import F64, I64, Mask
from .reading import Refused

_SPLITS = 40
_BOXES = 400_000
_FIELDS = 5_000_000
_AT_ONCE = 20_000
"""Boxes that are looked at in one go: some 100 MB."""


_U, _Q = 4, 5
"""Of a cell, after its box."""


@dataclass
class Boxes:
    """Boxes in which q >= target is claimed for u, or (barred) which must lie outside the region."""

    box: F64
    u: F64
    target: F64
    reach: F64
    barred: Mask
    cell: I64

    def take(self, pick: Any) -> Boxes:
        """Some of them."""
        parts = (self.box[pick], self.u[pick], self.target[pick], self.reach[:, pick], self.barred[pick])
        return Boxes(*parts, self.cell[pick])


def _settle(condition: Condition, todo: Boxes, unit: tuple[float, float], name: str) -> int:
    """Proves every box, splitting where needed; the number of boxes looked at."""
    looked = 0
    for _ in range(_SPLITS):
        looked += len(todo.box)
        if looked > _BOXES:
            break
        if not len(todo.box):
            return looked
        todo = todo.take(np.concatenate([_open(condition, todo, start) for start in range(0, len(todo.box), _AT_ONCE)]))
        for start in range(0, len(todo.box), _AT_ONCE):
            _refute(condition, todo.take(np.arange(start, min(start + _AT_ONCE, len(todo.box)))), name)
        wide_e, wide_v = (
            (todo.box[:, E_HIGH] - todo.box[:, E_LOW]) / unit[0],
            (todo.box[:, V_HIGH] - todo.box[:, V_LOW]) / unit[1],
        )
        side = np.where(wide_e >= wide_v, 0, 2)
        at = np.arange(len(side))
        middle = 0.5 * (todo.box[at, side] + todo.box[at, side + 1])
        first, second = todo.box.copy(), todo.box.copy()
        first[at, side + 1], second[at, side] = middle, middle
        todo = todo.take(np.concatenate([at, at]))
        todo.box = np.concatenate([first, second])
    e0, e1, v0, v1 = todo.box[0]
    what = "is not covered" if todo.cell[0] < 0 else f"cell {todo.cell[0]}: its claim could not be proven"
    raise Refused(f"{name}: {what} at e {e0:.9g} to {e1:.9g} m, v {v0:.9g} to {v1:.9g} m/s")


def _open(condition: Condition, todo: Boxes, start: int) -> Mask:
    """Which boxes of the next `_AT_ONCE` from `start` on are not proven yet."""
    part = slice(start, start + _AT_ONCE)
    low = condition.lowest(todo.box[part], todo.u[part], todo.reach[:, part])
    low = np.where(todo.barred[part], -np.inf, low)
    return np.asarray(~(low >= todo.target[part]) & ~condition.outside(todo.box[part]))


def _refute(condition: Condition, todo: Boxes, name: str) -> None:
    """Raises where the middle of a box disproves the claim."""
    e, v = todo.box[:, :2].mean(axis=1), todo.box[:, 2:].mean(axis=1)
    inside = np.all([piece.at(e, v)[0].lo >= condition.edge for piece in condition.pieces], axis=0)
    q = np.min([condition.margin(piece, e, v, todo.u, todo.reach)[0].hi for piece in condition.pieces], axis=0)
    for i in np.flatnonzero(inside & (todo.barred | (q < todo.target))):
        where = f"at e = {e[i]:.6g} m, v = {v[i]:.6g} m/s"
        if todo.cell[i] < 0:
            raise Refused(f"{name}: no cell covers the region {where}")
        if todo.barred[i]:
            raise Refused(f"{name}: cell {todo.cell[i]}: its command {todo.u[i]:g} m/s^2 is not to be had {where}")
        short = f"q = {q[i]:.9g}/s, {todo.target[i] - q[i]:.3g}/s less than claimed"
        raise Refused(f"{name}: cell {todo.cell[i]}: command {todo.u[i]:g} m/s^2 has {short}, {where}")


def _claims(condition: Condition, cells: F64, nodes: F64) -> Boxes:
    """The cells, cut at the nodes of the authority (rows v, u_low, u_high, error_low, error_high) and at kinks."""
    v = nodes[0]
    bands = np.pad(_bands(nodes), ((0, 0), (1, 1)))  # nothing is certified beyond the nodes
    cuts = np.unique(np.concatenate([v, [speed for piece in condition.pieces for speed in piece.kinks()]]))
    boxes, owner = [], []
    for i, (e0, e1, v0, v1, *_) in enumerate(cells):
        edges = np.concatenate([[v0], cuts[(cuts > v0) & (cuts < v1)], [v1]])
        boxes += [(e0, e1, a, b) for a, b in pairwise(edges)]
        owner += [i] * (len(edges) - 1)
    box, cell = np.array(boxes), np.array(owner)
    band = np.where(box[:, V_HIGH] <= v[0], 0, np.searchsorted(v, box[:, V_LOW], side="right"))
    reach, u = bands[:, band], cells[cell, _U]
    barred = (band == 0) | (band == len(v)) | (u < reach[0] - SLACK) | (u > reach[1] + SLACK)
    return Boxes(box, u, np.maximum(cells[cell, _Q] - SLACK, 0.0), reach, barred, cell)


def _bands(nodes: F64) -> F64:
    """(4, n - 1) reach between neighbouring nodes: the narrower range, and the errors there.

    The larger errors hold at the ends of the wider range; the error is convex, so where an end moves inwards it may
    rise up to the chord.
    """
    _, low, high, error_low, error_high = nodes
    least, most = np.maximum(low[1:], low[:-1]), np.minimum(high[1:], high[:-1])
    at_low, at_high = (np.maximum(column[1:], column[:-1]) for column in (error_low, error_high))
    in_low, in_high = least - np.minimum(low[1:], low[:-1]), np.maximum(high[1:], high[:-1]) - most
    span, rise = np.maximum(most - least, 0.0), at_high - at_low
    with np.errstate(invalid="ignore"):
        more_low = np.where(in_low > 0.0, np.maximum(rise, 0.0) * in_low / (span + in_low), 0.0)
        more_high = np.where(in_high > 0.0, np.maximum(-rise, 0.0) * in_high / (span + in_high), 0.0)
    return np.stack([least, most, at_low + more_low, at_high + more_high])


def _fields(condition: Condition, cells: F64) -> tuple[F64, int]:
    """Boxes that no cell covers and that are not proven to lie outside at once, and the number of fields.

    The cells' edges cut the plane into fields; uncovered neighbours along e are looked at together, halved where they
    are not proven outside, down to single fields.  A frame round all cells is among them: a convex region that meets
    no frame and has a point within it ends there.
    """
    e, v = np.unique(cells[:, :2]), np.unique(cells[:, 2:4])
    e, v = (np.concatenate([[x[0] - (x[-1] - x[0])], x, [2.0 * x[-1] - x[0]]]) for x in (e, v))
    if len(e) * len(v) > _FIELDS:
        raise Refused(f"cells have {len(e)} times {len(v)} different edges, more than this checker looks at")
    count = np.zeros((len(e), len(v)), np.int32)
    e0, e1 = np.searchsorted(e, cells[:, E_LOW]), np.searchsorted(e, cells[:, E_HIGH])
    v0, v1 = np.searchsorted(v, cells[:, V_LOW]), np.searchsorted(v, cells[:, V_HIGH])
    for rows, columns, sign in ((e0, v0, 1), (e0, v1, -1), (e1, v0, -1), (e1, v1, 1)):
        np.add.at(count, (rows, columns), sign)
    np.cumsum(count, axis=0, out=count)
    np.cumsum(count, axis=1, out=count)
    empty = np.pad((count[:-1, :-1] == 0).astype(np.int8), ((1, 1), (0, 0)))
    change = np.diff(empty, axis=0).T  # by v, so that starts and ends of runs along e come in the same order
    (j, first), last = np.nonzero(change == 1), np.nonzero(change == -1)[1]
    left = [np.empty((0, 4))]
    looked = 0
    while len(j):
        looked += len(j)
        if looked > _BOXES:
            raise Refused(f"cells leave {looked} gaps between their edges, more than this checker looks at")
        box = np.stack([e[first], e[last], v[j], v[j + 1]], axis=1)
        still = ~condition.outside(box)
        single = still & (last - first == 1)
        left.append(box[single])
        j, first, last = (x[still & ~single] for x in (j, first, last))
        middle = (first + last) // 2
        j, first, last = np.tile(j, 2), np.concatenate([first, middle]), np.concatenate([middle, last])
    return np.concatenate(left), (len(e) - 1) * (len(v) - 1)


def check_cells(condition: Condition, cells: F64, nodes: F64, middle: tuple[float, float], name: str) -> str:
    """Proves the cells' claims and that they cover {h >= edge}; what was verified, in words."""
    wrong = np.flatnonzero(
        ~((cells[:, E_LOW] < cells[:, E_HIGH]) & (cells[:, V_LOW] < cells[:, V_HIGH]) & (cells[:, _Q] >= 0.0))
    )
    if len(wrong):
        raise Refused(f"{name}: cell {wrong[0]}: edges must be in order and q at least 0")
    unit, least = (float(np.ptp(cells[:, :2])), float(np.ptp(cells[:, 2:4]))), cells[:, _Q].min()
    looked = _settle(condition, _claims(condition, cells, nodes), unit, name)
    holes, fields = _fields(condition, cells)
    none, many = np.zeros(len(holes)), np.full(len(holes), True)
    at_least = [float(piece.at(*middle)[0].lo) for piece in condition.pieces]
    inside = unit[0] > 0.0 and cells[:, E_LOW].min() < middle[0] < cells[:, E_HIGH].max()
    if not (min(at_least) > 0.0 and inside and cells[:, V_LOW].min() < middle[1] < cells[:, V_HIGH].max()):
        raise Refused(f"{name}: the cells do not reach the region's middle")
    gaps = Boxes(holes, none, none, np.zeros((4, len(holes))), many, np.full(len(holes), -1))
    _settle(condition, gaps, unit, name)
    return (
        f"{name}: {len(cells)} cells meet the condition (proven on {looked} boxes) by {least:.4g}/s or more; "
        f"they cover h >= {condition.edge:g}: of {fields} fields between their edges those uncovered lie outside"
    )
