"""From what came of an exploration to its page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from flightstack.cli.certified import counted_mps2, vertical
from flightstack.explore import width_mps2
from flightstack.types import F64
from flightstack_logs.reader import read
from flightstack_logs.report.certified import ExplorationPage, render
from flightstack_logs.report.words import KeyFigure, count

if TYPE_CHECKING:
    from flightstack.cli.certify import CertifyResult


def page_of(result: CertifyResult, limit_m: float) -> str:
    """The page's HTML; `limit_m` is the region's, up and down."""
    axis = vertical(result.adopted[-1])
    kernel = None
    if axis is not None and (counted := counted_mps2(axis))[0] < 0.0 < counted[1]:
        kernel = (limit_m, *counted)
    exploration = ExplorationPage(
        title=f"{result.flight.scenario}: {'as published' if result.as_published else 'certified in flight'}",
        good=result.passed,
        words=result.failure() or result.words,
        figures=figures(result),
        certificates=tuple(result.adopted),
        rounds=() if result.state is None else result.state.rounds,
        path=path_of(result),
        kernel=kernel,
        checker=tuple(result.verdict),
        settled=settled_of(result),
    )
    return render(exploration)


def settled_of(result: CertifyResult) -> tuple[float, float] | None:
    """Area and largest bound of the last certificate, where it was made after the last round."""
    state, axis = result.state, vertical(result.adopted[-1])
    rounds = () if state is None else state.rounds
    area_m2ps = None if result.figures is None else result.figures.area_m2ps
    if area_m2ps is None or axis is None or not rounds or rounds[-1].axis != axis.axis:
        return None
    return (area_m2ps, width_mps2(axis)) if result.adopted[-1].version > rounds[-1].version else None


def figures(result: CertifyResult) -> tuple[KeyFigure, ...]:
    """The key figures, for the page and the terminal."""
    found, flight = result.figures, result.flight
    if found is None:
        return ()
    share = "" if found.share_kernel is None or found.share_kernel_vehicle is None else (
        f"{100.0 * found.share_kernel_vehicle:.0f} % of the kernel of the vehicle's own limits, "
        f"{_shown(found.area_kernel_vehicle_m2ps, 2)}; {100.0 * found.share_kernel:.0f} % of the kernel's "
        f"{_shown(found.area_kernel_m2ps, 2)} within the certificate's thrust"
    )  # fmt: skip
    rounds = 0 if result.state is None else len(result.state.rounds)
    exits = flight.barrier["violations"]
    return (
        KeyFigure("Certified area", _shown(found.area_m2ps, 3, "m²/s"), share),
        KeyFigure(
            "On the worst slice",
            _shown(found.area_worst_m2ps, 3, "m²/s"),
            f"at first {_shown(found.area_initial_m2ps, 2)}",
        ),
        KeyFigure(
            "mu",
            _shown(found.mu_final, 3),
            f"from {_shown(found.mu_initial, 2)}; physics {_shown(found.mu_physics, 4)}",
        ),
        KeyFigure("Rounds", str(rounds), f"{flight.flight_time_s:.0f} s of flight"),
        KeyFigure("Exits", count(exits), f"infeasible steps: {flight.qp['infeasible']}"),
        KeyFigure("Samples", count(found.samples), f"uniform grid: {count(found.samples_uniform)}"),
    )


def _shown(value: float | None, digits: int, unit: str = "") -> str:
    return "–" if value is None else f"{value:.{digits}f} {unit}".strip()


def path_of(result: CertifyResult) -> F64:
    """(n, 6) the true position relative to the region's centre, and the velocity, while it was explored."""
    if result.state is None or result.flight.log is None:
        return np.zeros((0, 6))
    truth = read(result.flight.log).tables["/truth"]
    during = (truth.t_us >= result.span_us[0]) & (truth.t_us <= result.span_us[1])
    return np.concatenate(
        [truth["pos_ned_m"][during] - result.state.centre_ned_m, truth["vel_ned_mps"][during]], axis=1
    )
