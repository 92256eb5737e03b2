"""Certificates made by hand for tests: one set of figures for an axis, with room to spare."""

from __future__ import annotations

import numpy as np

from flightstack.barrier.condition import Setting
from flightstack.barrier.records import Authority, AxisCertificate, Budget, Certificate, Margin, Response
from flightstack.barrier.shapes import Barrier

NODES_MPS = np.linspace(-3.0, 3.0, 31)


def axis_of(
    barrier: Barrier, *, axis: int = 2, error_mps2: float = 0.2, slope_ps: float = 0.3,
    u_mps2: tuple[float, float] = (-2.6, 9.0),
) -> AxisCertificate:  # fmt: skip
    """One axis; the bound grows with speed by `slope_ps`."""
    one = np.ones_like(NODES_MPS)
    error = error_mps2 + slope_ps * np.abs(NODES_MPS)
    authority = Authority(NODES_MPS, 9.81 * one, 0.7 * one, u_mps2[0] * one, u_mps2[1] * one, error, error)
    margins = (Margin("gp_error", error_mps2, "made up"), Margin("delay", 0.1, "made up <&>"))
    cells = np.array([[-0.1, 0.1, -0.2, 0.2, 0.0, 0.5], [0.1, 0.2, -0.2, 0.2, -0.5, 0.2]])
    return AxisCertificate(
        axis, barrier, Setting(4.0, 0.01, 0.05, 0.008), Response(0.05, 0.0, 0.02), authority, margins, cells
    )


def certificate_of(*axes: AxisCertificate, version: int = 1, **knowledge: object) -> Certificate:
    """A certificate of some axes."""
    budget = Budget.square(2.0, 15.0, 17.0, 0.6)
    return Certificate("sound", (0.0, 0.0, -0.8), axes, budget, 0.05, 4.3, dict(knowledge), version)
