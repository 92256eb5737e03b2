"""Slivers: a cover that leaves out next to nothing leaves out something."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from forging import resealed

from benchmarks.attack_flight import AttackFlight
from benchmarks.attack_worlds import World
from flightstack.barrier.file import certificate_to_json
from flightstack.barrier.shapes import value
from flightstack.certificate_check import check

pytestmark = pytest.mark.attack


@pytest.fixture(scope="module")
def honest() -> tuple[dict[str, Any], Any]:
    """A certificate from flight on three axes."""
    flight = AttackFlight(World(0), 0)
    assert flight.fly_until_engaged(40.0) is not None
    assert flight.certificate is not None
    text = certificate_to_json(flight.certificate)
    assert check(text).valid
    return json.loads(text), flight.certificate


@pytest.mark.parametrize("share", [1e-3, 1e-9, 1e-12, 1e-15])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_cell_that_gives_up_a_sliver_inside_the_region_is_noticed(
    honest: tuple[dict[str, Any], Any], axis: int, share: float
) -> None:
    data, certificate = json.loads(json.dumps(honest[0])), honest[1]
    barrier = certificate.axes[axis].barrier
    cells = data["axes"][axis]["cells"]
    inside = max(cells, key=lambda c: value(barrier, 0.5 * (c[0] + c[1]), 0.5 * (c[2] + c[3])))
    width = inside[1] - inside[0]
    inside[1] = min(inside[1] - share * width, float(np.nextafter(inside[1], -np.inf)))
    verdict = check(resealed(data))
    assert not verdict.valid, verdict.lines


def test_a_cell_that_is_left_out_is_noticed(honest: tuple[dict[str, Any], Any]) -> None:
    for axis in range(3):
        data = json.loads(json.dumps(honest[0]))
        cells = data["axes"][axis]["cells"]
        del cells[len(cells) // 2]
        assert not check(resealed(data)).valid


def test_the_forgers_seal_is_the_right_one(honest: tuple[dict[str, Any], Any]) -> None:
    assert check(resealed(honest[0])).valid
