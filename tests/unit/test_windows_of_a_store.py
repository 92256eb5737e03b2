"""A certificate's noise and misses are told by each store's own windows: one begins anew where a change was noticed."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from flightstack.certificate_check.gaussian import factor
from flightstack.certificate_check.knowledge import StatedProcess
from flightstack.certificate_check.provenance import _check_windows
from flightstack.certificate_check.reading import Refused
from flightstack.certificate_check.samples import WINDOW
from flightstack.types import F64

WINDOWS, NOISE = 400, 0.1
SPEC = {"kernel": "constant", "variance": 1.0}


def process(found: SimpleNamespace, columns: slice, first: int) -> StatedProcess:
    """What a certificate would state of all windows from the `first` on."""
    ends = np.arange(first, WINDOWS) * WINDOW
    index = ends[:, None] + np.arange(WINDOW)
    x, y = found.x[index].mean(axis=1), found.y[index].mean(axis=1)[:, columns]
    noise_var = NOISE**2 / WINDOW
    outputs = y.shape[1]
    spans = np.stack([found.t_us[ends], found.t_us[ends + WINDOW - 1]], axis=1)
    lower = factor(SPEC, x, noise_var * np.eye(len(x)), "test")
    return StatedProcess(
        SPEC, lower, np.full(outputs, 1.5), np.zeros(outputs), np.zeros(outputs), x, y, noise_var, spans
    )


def flown(change_at: int) -> SimpleNamespace:
    """White noise, and a force up that ends before a window."""
    rng = np.random.default_rng(6)
    count = WINDOWS * WINDOW
    y: F64 = rng.normal(0.0, NOISE, (count, 3))
    y[: change_at * WINDOW, 2] -= 3.0
    x = np.zeros((count, 7))
    return SimpleNamespace(t_us=4000 * np.arange(count), fit=np.ones(count, bool), x=x, y=y)


def test_what_was_before_a_change_of_one_store_is_not_counted_against_it() -> None:
    found = flown(change_at=200)
    known = SimpleNamespace(stores=[process(found, slice(0, 2), 0), process(found, slice(2, 3), 200)])
    lines = _check_windows(known, found)  # type: ignore[arg-type]
    assert [line.split(" windows")[0] for line in lines] == [
        "lateral 0: of all 400", "lateral 1: of all 400", "vertical 0: of all 200"
    ]  # fmt: skip


def test_a_change_among_a_stores_own_windows_is() -> None:
    found = flown(change_at=250)
    known = SimpleNamespace(stores=[process(found, slice(0, 2), 0), process(found, slice(2, 3), 200)])
    with pytest.raises(Refused, match="vertical, output 0: noise of"):
        _check_windows(known, found)  # type: ignore[arg-type]
