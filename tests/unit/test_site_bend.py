"""Bent references: what passes, what is led, how smooth it is, where a flight that begins in the air begins."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flightstack.site import approach, bend, slide
from flightstack.site.clearance import JUMP_CODE, packed
from flightstack.site.file import parse_site
from flightstack.site.slide import MOST_ROWS

DT_S = 0.004
BOX = packed(
    parse_site(
        'schema = "flightstack.site/1"\nfloor_m = 0.3\nceiling_m = 3.0\n'
        "inside = [[-6.0, -5.0], [6.0, -5.0], [6.0, 5.0], [-6.0, 5.0]]\n",
        "box.toml",
    ),
    np.zeros((1, 2)),
    1.6,
)
FIELD = packed(
    parse_site(
        'schema = "flightstack.site/1"\nfloor_m = 0.3\nceiling_m = 20.0\n'
        "inside = [[-60.0, -50.0], [60.0, -50.0], [60.0, 50.0], [-60.0, 50.0]]\n",
        "field.toml",
    ),
    np.zeros((1, 2)),
    1.6,
)
KEPT = np.zeros(slide.SOFT)
KEPT[[slide.RADIUS, slide.HALF, slide.SLOW_S, slide.BRAKE, slide.GAMMA, slide.UP, slide.DOWN, slide.LED_JERK]] = (
    0.6, 0.15, 0.4, 1.5, 2.5, 0.3, 1.4, 12.0,
)  # fmt: skip


def at(north: float, east: float, down: float, *velocity: float) -> np.ndarray:
    row = np.zeros(17)
    row[:3] = north, east, down
    row[3 : 3 + len(velocity)] = velocity
    return row


def led(begins: np.ndarray, to: np.ndarray, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """The rows that come out, (n, 17), and the memory."""
    memory, out, rows, way = np.zeros(bend.SIZE), np.empty(17), np.zeros((MOST_ROWS, 6)), np.zeros((192, 5))
    bend.begin(memory, begins, np.zeros(3))
    found = []
    for _ in range(round(seconds / DT_S)):
        bend.bend(memory, BOX, KEPT, to, DT_S, rows, way, out)
        found.append(out.copy())
    return np.array(found), memory


def test_where_the_vehicle_is_passes_to_the_bit() -> None:
    here = at(2.0, -1.0, -1.5)
    rows, memory = led(here, here, 0.1)
    assert memory[bend.BENT] == 0.0
    assert all(row.tobytes() == here.tobytes() for row in rows)


def test_a_jump_is_led_within_the_bounds_of_acceleration_and_jerk() -> None:
    rows, memory = led(at(-3.0, 0.0, -1.5), at(3.0, 1.0, -1.5), 6.0)
    speed = np.diff(rows[:, :3], axis=0) / DT_S
    acc = np.diff(speed, axis=0) / DT_S
    moving = np.linalg.norm(rows[:, :3] - rows[-1, :3], axis=1) > 0.05  # the last 2 cm are a step
    assert np.linalg.norm(acc, axis=1)[moving[2:]].max() <= approach.ACC_MOST_MPS2 * 1.02
    jerk = np.linalg.norm(np.diff(rows[:, 6:9], axis=0), axis=1) / DT_S
    assert jerk[moving[1:]].max() <= approach.JERK_MOST_MPS3 * 1.02
    assert np.allclose(rows[-1, :3], [3.0, 1.0, -1.5], atol=0.02)
    assert memory[bend.BENT] == 0.0  # it is there, and passes again


@pytest.mark.parametrize("jerk_mps3", [12.0, 6.0, 2.1, 1.0])
@pytest.mark.parametrize("jump_m", [0.3, 2.0])
@pytest.mark.parametrize("is_moving", [False, True])
def test_a_jump_is_caught_up_with_and_not_overshot(jerk_mps3: float, jump_m: float, is_moving: bool) -> None:
    """A figure of eight of 4 m/s^2, which a vehicle that turns slowly was led round for a whole flight, metres off."""
    memory, out, rows, way = np.zeros(bend.SIZE), np.empty(17), np.zeros((MOST_ROWS, 6)), np.zeros((192, 5))
    kept, w = KEPT.copy(), 2.0 * math.pi / 8.0 if is_moving else 0.0
    kept[slide.LED_JERK] = jerk_mps3
    amplitude, rate = np.array([3.0, 1.5, 0.0]), np.array([w, 2.0 * w, 0.0])
    away = []
    for n in range(round(15.0 / DT_S)):
        row, angle = np.zeros(17), rate * n * DT_S
        for k in range(5):  # position to snap
            row[3 * k : 3 * k + 3] = amplitude * rate**k * np.sin(angle + 0.5 * k * math.pi)
        row[2] = -10.0
        if n == 0:
            bend.begin(memory, row + np.array([jump_m, 0.0, 0.0, *np.zeros(14)]), np.zeros(3))
        bend.bend(memory, FIELD, kept, row, DT_S, rows, way, out)
        away.append(np.linalg.norm(out[:3] - row[:3]))
    assert max(away) <= jump_m + 0.02  # what it moves in a tick
    assert np.max(np.diff(away)) < 0.01  # nor does it go away again
    assert memory[bend.BENT] == 0.0
    assert away[-1] == 0.0


def test_a_jump_is_told_as_one() -> None:
    _, memory = led(at(-3.0, 0.0, -1.5), at(3.0, 1.0, -1.5), 0.02)
    assert memory[bend.BENT] == 1.0
    assert memory[bend.EDGE] == JUMP_CODE


def test_a_reference_behind_a_wall_ends_where_the_distance_is_kept() -> None:
    rows, memory = led(at(0.0, 0.0, -1.5), at(12.0, 0.0, -1.5), 8.0)
    assert abs(rows[-1, 0] - (6.0 - KEPT[slide.RADIUS])) < 0.03
    assert rows[:, 0].max() <= 6.0 - KEPT[slide.RADIUS] + 1e-6
    assert memory[bend.EDGE] == 1.0  # the edge from (6, -5) to (6, 5)
