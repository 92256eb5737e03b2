"""What an effect is worth on held-out rows: harm in one group weighs as much as it is beside what the effect does."""

from __future__ import annotations

import numpy as np
import pytest

from flightstack.gap.naming.design import Layout
from flightstack.gap.naming.trifles import _View
from flightstack.types import F64

SECONDS, RATE = 40, 25
SIDE, LIFT = 0, 2


def view() -> _View:
    """Rows of side force and of lift, one after the other, at 25 Hz."""
    rows = SECONDS * RATE
    channel, at = np.repeat([SIDE, LIFT], rows), np.tile(np.arange(rows), 2)
    yes, flight = np.ones(2 * rows, dtype=bool), np.zeros(2 * rows, dtype=np.int64)
    layout = Layout([], [], [], flight, channel, at, yes, yes)
    return _View(layout, np.zeros((2 * rows, 0)), np.zeros(2 * rows), np.array([float(RATE)]))


def rows(side: float, lift: float) -> F64:
    """(R,) disagreement of these sizes, alternating."""
    each = np.where(np.arange(SECONDS * RATE) % 2, 1.0, -1.0) * (1.0 + 0.3 * np.sin(np.arange(SECONDS * RATE)))
    return np.concatenate([side * each, lift * each])


@pytest.mark.parametrize(
    ("side", "lift", "expected"),
    [
        ((3.4, 1.0), (0.24, 0.5), 10.56),  # (3.4^2 - 1) in the side force; lift falls by a fiftieth of that
        ((1.5, 1.0), (0.24, 0.5), -0.7696),  # lift falls by a seventh of what the side force rises by
        ((1.0, 1.0), (0.24, 0.5), -0.7696),  # harm alone
        ((1.5, 1.0), (0.4, 0.5), 1.25),  # harm that is not large
    ],
)
def test_harm_counts_where_it_is_no_trifle_beside_the_help(
    side: tuple[float, float], lift: tuple[float, float], expected: float
) -> None:
    """(without, with) the effect; on two circles of a Crazyflie a drag of 10 to 1 was dropped for its vertical part."""
    without, base = rows(side[0], lift[0]), rows(side[1], lift[1])
    worth = view().worth(base, without, np.ones(len(base), dtype=bool), "linear_drag")
    assert worth == pytest.approx(expected, rel=1e-9)
