"""Rows of Example 1."""

from __future__ import annotations

import math
from typing import Any

from flightstack_paper.rows import Cell, ResultLine, ResultTable

_PART = ("example1",)
_PRINTED = {"lyapunov": (1.343, 0.5155, 1.152, 0.0, 0.0), "barrier": (0.8616, 0.2846, 0.7549, 0.4254, 0.3248)}
"""a x1^2 + b x1 x2 + c x2^2 + d x1 + e x2 <= 1, as printed."""


def _printed_area(name: str) -> float:
    """pi level / sqrt(det P) of the printed digits, the level seen from the ellipse's centre."""
    a, b, c, d, e = _PRINTED[name]
    det = a * c - 0.25 * b * b
    level = 1.0 + 0.25 * (c * d * d - b * d * e + a * e * e) / det
    return math.pi * level / math.sqrt(det)


_NAMES = {
    "lyapunov": ("the Lyapunov function's region {V* <= 1}", _printed_area("lyapunov")),
    "barrier": ("the barrier's region {h* >= 0}", _printed_area("barrier")),
}
_RATIO = _NAMES["barrier"][1] / _NAMES["lyapunov"][1]
_MUCH = 1.5
_SAME_PROBLEM = 0.02
"""Share by which the programme's region may differ from the printed one: two searches end in neighbouring optima."""


def rows(run: ResultTable) -> list[ResultLine]:
    """Areas as printed, what is wrong with the digits, what is left when they are mended, and larger regions."""
    both = [kind(run, name) for kind in (_area, _invariant, _lowered, _strict) for name in _NAMES]
    return [*both[:2], _ratio(run, "ratio_published", "ex1-ratio", "with the printed digits"), *both[2:],
            _ratio(run, "ratio", "ex1-ratio-strict", "of our own, strictly invariant regions")]  # fmt: skip


def _area(run: ResultTable, name: str) -> ResultLine:
    words, paper = _NAMES[name]

    def make(found: dict[str, Any]) -> Cell:
        enclosed, solved = found["regions"][f"published_{name}"]["level_set_area"], found["solved"][name]
        agree = abs(enclosed - paper) < 1e-3 and abs(solved["area"] / paper - 1.0) < _SAME_PROBLEM
        return enclosed, agree, (
            f"enclosed by the printed function's level set; the sum-of-squares programme of the same problem, solved "
            f"{'anew' if solved['anew'] else 'before (extra sos not installed)'} from the dynamics alone, encloses "
            f"{solved['area']:.3f}; see below: the printed digits are not quite an invariant set, and not the largest"
        )  # fmt: skip

    return run.row(f"ex1-{name}-area", f"area of {words} (Fig. 1)", paper, "1", _PART, make)


def _ratio(run: ResultTable, key: str, row_id: str, which: str) -> ResultLine:
    def make(found: dict[str, Any]) -> Cell:
        return found[key], found[key] > _MUCH, f"area over area, {which}; 'much' is read as half as large again"

    claim = "the barrier certified region is much larger than the Lyapunov based one (Fig. 1)"
    return run.row(row_id, claim, _RATIO, "1", _PART, make)


def _invariant(run: ResultTable, name: str) -> ResultLine:
    words, _ = _NAMES[name]

    def make(found: dict[str, Any]) -> Cell:
        region, flow = found["regions"][f"published_{name}"], found["flows"][name]
        at = ", ".join(f"{each:.3f}" for each in region["least_rate_at"])
        proven = "proven in exact arithmetic at one point" if region["refuted"] else "not proven"
        return region["least_rate"], region["least_rate"] >= 0.0, (
            f"least inward rate on the boundary, near ({at}); {100 * region['outward_share']:.2f} % of the boundary "
            f"leads outward ({proven}); {flow['left']} of {flow['starts']} motions from the boundary leave, h down to "
            f"{flow['worst_h']:.1e}, and {flow['converged']} reach the origin: four digits are one too few"
        )  # fmt: skip

    claim = f"no motion leaves {words}: its boundary leads inward everywhere"
    return run.row(f"ex1-{name}-least-rate", claim, None, "1/s", _PART, make)


def _lowered(run: ResultTable, name: str) -> ResultLine:
    words, paper = _NAMES[name]

    def make(found: dict[str, Any]) -> Cell:
        region = found["regions"][f"lowered_{name}"]
        return region["area"], region["proven_rate"] is not None, (
            f"the level lowered by {'5.7e-4' if name == 'lyapunov' else '4.7e-4'}: hdot >= {region['proven_rate']} /s "
            "on the boundary, by a sum of squares in exact arithmetic"
        )  # fmt: skip

    claim = f"{words} is invariant, once its level is a little lower than printed"
    return run.row(f"ex1-{name}-lowered-area", claim, paper, "1", _PART, make)


def _strict(run: ResultTable, name: str) -> ResultLine:
    words, paper = _NAMES[name]

    def make(found: dict[str, Any]) -> Cell:
        region = found["regions"][name]
        return region["area"], region["area"] <= paper, (
            f"ours is larger by {100 * (region['area'] / paper - 1):.1f} % and strict: hdot >= {region['proven_rate']} "
            "/s on the boundary, by a sum of squares in exact arithmetic"
        )  # fmt: skip

    claim = f"{words} is the largest that a polynomial of second order certifies"
    return run.row(f"ex1-{name}-strict-area", claim, paper, "1", _PART, make)
