"""The latency of commands from what the motors report: a PX4 by hand, whose latency is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavlink_bridge.command_latency import CommandLatency


def _flown(
    latency_s: float, *, moving: float = 0.02, heard: float = 1.0, drift: float = 1e-3, taken_us: int = 20_000_000
) -> float:
    """What is found: 250 Hz of commands, a loop of PX4 every 4 ms (its clock drifts), every third output reported;
    from `taken_us` on somebody else flies."""
    draw = np.random.default_rng(3)
    found = CommandLatency()
    times = np.arange(0, 20_000_000, 4_000) + draw.integers(0, 400, 5_000)
    thrust = 0.5 + moving * np.sin(np.arange(5_000) * 0.3) + 0.2 * moving * draw.standard_normal(5_000)
    events: list[tuple[int, int, int]] = [(int(t), 0, k) for k, t in enumerate(times)]
    events += [(int(t * (1.0 + drift)) + 1_300, 1, k) for k, t in enumerate(range(200_000, 19_900_000, 12_000))]
    for t_us, kind, k in sorted(events):
        if kind == 0:
            found.sent(t_us, float(thrust[k]))
            continue
        newest = int(np.searchsorted(times, t_us - latency_s * 1e6, side="right")) - 1
        torque = 0.05 * draw.standard_normal()
        if t_us > taken_us:
            motors = np.full(4, 0.35 + 0.01 * draw.standard_normal())
            found.reported(t_us, (motors[0], motors[1], motors[2], motors[3]))
            continue
        motors = 0.5 + heard * (thrust[newest] - 0.5) + torque * np.array([1.0, 1.0, -1.0, -1.0])
        pulses = np.round(1000.0 * motors) / 1000.0
        found.reported(t_us, (float(pulses[0]), float(pulses[1]), float(pulses[2]), float(pulses[3])))
    return found.latency_s


@pytest.mark.parametrize("latency_s", [0.0005, 0.003, 0.0073, 0.022, 0.041])
def test_the_latency_is_found_within_2_ms(latency_s: float) -> None:
    assert _flown(latency_s) == pytest.approx(latency_s, abs=0.002)


def test_two_loops_in_step_tell_it_to_half_a_step() -> None:
    assert _flown(0.0073, drift=0.0) == pytest.approx(0.0073, abs=0.0021)


@pytest.mark.parametrize(("moving", "heard"), [(0.0, 1.0), (0.02, 0.0)])
def test_what_nothing_shows_is_unknown(moving: float, heard: float) -> None:
    """Thrust that does not move; motors that follow something else."""
    assert math.isnan(_flown(0.01, moving=moving, heard=heard))


def test_it_outlives_somebody_else_who_flies_at_the_end() -> None:
    assert _flown(0.0073, taken_us=12_000_000) == pytest.approx(0.0073, abs=0.002)


def test_it_is_unknown_beyond_what_is_looked_at() -> None:
    assert math.isnan(_flown(0.09))


def test_motors_at_their_ends_are_left_out() -> None:
    found = CommandLatency()
    for t_us in range(0, 4_000_000, 4_000):
        found.sent(t_us, 0.5)
        found.reported(t_us, (1.0, 0.0, 0.5, 0.5))
    assert math.isnan(found.latency_s)
