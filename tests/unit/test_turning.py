"""What a governed lean turns in time, against SciPy's integration and against the governor itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from shipped import load_vehicle

from flightstack.barrier.condition import Reach, Setting, doubt_of, interval
from flightstack.barrier.shapes import Quadratic, piece_at
from flightstack.barrier.torque import governor_terms
from flightstack.barrier.turning import Turn, after_turning, paced, straight, turning
from flightstack.governor import Governor
from flightstack.model import Limits, Model
from flightstack.types import Command
from flightstack_sim.grade import load_grade

NOISE = load_grade("mocap").imu.gyro_noise_radps_rthz
TURN = Turn(0.4, 0.3, 9.0, 0.154, 6.4, 0.046)
SETTING = Setting(0.5, 0.05, 0.0, 0.004, 0.02, 0.1, 20.0, 0.05)
REACH = Reach(-2.5, 2.5, 0.4, 0.4)
ROWS = Quadratic(0.0, 0.0, 0.5, 0.1, 0.36).rows


@pytest.mark.parametrize(("way", "brake", "u"), [(1.0, -1.0, 1.5), (-1.0, 0.5, -2.0), (1.0, -0.2, 0.0)])
def test_the_state_after_turning_is_what_integration_gives(way: float, brake: float, u: float) -> None:
    force, stiff = TURN.force_mps2, TURN.force_mps2 * TURN.steer_s
    rate = max(way * (u - TURN.still_mps2) / stiff, way * TURN.rate_radps)

    def flow(t: float, x: list[float]) -> list[float]:
        _, v, owed, lean_rate = x
        slewing = t > TURN.wait_s
        change = force * lean_rate - (stiff * TURN.turn_radps2 if slewing else 0.0)
        return [v, brake + way * owed, change, -TURN.turn_radps2 if slewing else 0.0]

    def caught(t: float, x: list[float]) -> float:
        return float(x[2])

    caught.terminal = True  # type: ignore[attr-defined]
    start = [0.3, -0.2, way * (u - brake), rate]
    first = solve_ivp(flow, (0.0, TURN.wait_s), start, rtol=1e-10, atol=1e-12, max_step=1e-3)
    last = solve_ivp(flow, (TURN.wait_s + 1e-12, 3.0), first.y[:, -1], rtol=1e-10, atol=1e-12, events=caught)
    assert last.t_events[0].size == 1
    assert after_turning(0.3, -0.2, TURN, way, brake, u) == pytest.approx(last.y[:2, -1], abs=1e-6)


def test_what_the_flat_line_allows_is_always_let_through_and_nothing_beyond_the_steep_one() -> None:
    rng, bent = np.random.default_rng(0), 0
    flat = SETTING._replace(inside_ps=0.0)
    for _ in range(2000):
        e, v = rng.uniform(-1.4, 1.4), rng.uniform(-1.6, 1.6)
        turn = TURN._replace(still_mps2=rng.uniform(-2.0, 2.0), rate_radps=rng.uniform(-2.0, 2.0))
        low, high, margin = paced(ROWS, e, v, SETTING, REACH, turn)
        h, he, hv = piece_at(ROWS[0], e, v)
        inside = h - SETTING.inner - doubt_of(ROWS[0], he, hv, SETTING.off_m, SETTING.off_mps) >= 0.0
        wide = interval(ROWS, e, v, straight(SETTING) if inside else SETTING, REACH)
        assert margin == wide[2]
        if margin < 0.0:
            continue
        assert wide[0] <= low <= high <= wide[1]
        least, most, there = interval(ROWS, e, v, flat, REACH)
        if there >= 0.0:
            assert low <= least + 1e-9
            assert high >= most - 1e-9
        bent += high < wide[1] or low > wide[0]
    assert bent > 100


def test_a_lean_that_turns_outwards_is_held_back_before_there_is_no_room() -> None:
    """Pushed outwards at most, a lean with the least turning rate of the governor never leaves; unpaced, it does."""
    least = {}
    for held in (True, False):
        e, v, lean, rate, least[held] = -0.8, 0.2, 0.0, 0.0, 1.0
        for _ in range(1500):
            turn = TURN._replace(still_mps2=lean, rate_radps=rate)
            way = paced(ROWS, e, v, SETTING, REACH, turn) if held else interval(ROWS, e, v, SETTING, REACH)
            wanted = (min(way[1], 2.5) - lean) / (TURN.force_mps2 * TURN.steer_s)
            step = TURN.turn_radps2 * 0.004
            rate = min(max(wanted, rate - step), rate + step)
            u = lean + TURN.force_mps2 * TURN.steer_s * rate
            e, v, lean = e + 0.004 * v, v + 0.004 * u, lean + 0.004 * TURN.force_mps2 * rate
            h, he, hv = piece_at(ROWS[0], e, v)
            least[held] = min(least[held], h - SETTING.inner - doubt_of(ROWS[0], he, hv, 0.0, 0.0))
    assert least[True] >= -0.01
    assert least[False] < -0.05


@pytest.mark.parametrize("heading_rad", [0.0, 0.8])
@pytest.mark.parametrize("name", ["quad-x", "px4-sihsim-quadx"])
def test_the_governor_turns_a_dithered_command_as_fast_as_is_counted_on(name: str, heading_rad: float) -> None:
    """Lean rates to north and to east (0, 1), whatever the other does and wherever the nose points."""
    vehicle = load_vehicle(name)
    model = Model.from_vehicle(vehicle)
    terms = governor_terms(vehicle, model, Limits(), NOISE)
    governor, rng = Governor(vehicle), np.random.default_rng(0)
    low_mps2 = 11.6
    turn, wait_s = turning(terms, model, low_mps2)
    assert turn > 0.5
    norm, sin, cos = model.norm_of(low_mps2 * model.mass_kg), math.sin(heading_rad), math.cos(heading_rad)
    most, back = (6.0, 4.0) if heading_rad == 0.0 else (2.5, 2.5)  # PX4's own limits are of roll and of pitch
    for trial in range(16):
        hz, size, base = rng.uniform(1.0, 15.0), rng.uniform(0.0, most), rng.uniform(-2.0, 2.0)
        phase, axis, begins = rng.uniform(0.0, 6.3, 2), trial % 2, int(rng.integers(80, 160))
        state, sent = governor.init(), []
        north, east = np.array([sin, cos]), np.array([-cos, sin])  # what roll and pitch rates turn the lean by
        for k in range(begins + 75):
            angle = 2.0 * math.pi * hz * 0.004 * k
            leans = np.zeros(2)
            leans[axis] = base + size * math.copysign(1.0, math.sin(angle + phase[0])) if k < begins else -back
            leans[1 - axis] = size * math.copysign(1.0, math.sin(angle + phase[1]))
            rates = np.append(leans[0] * north + leans[1] * east, 0.0)
            command = Command(k * 4000, 0.0, norm, rates)
            state, _, changed = governor.step(state, command, terms.limits, heading_rad)
            sent.append(float((north, east)[axis] @ (rates if changed is None else changed)[:2]))
        turned = sent[begins - 1] - np.array(sent[begins:])
        counted = turn * np.maximum(0.004 * np.arange(75) - wait_s, 0.0)
        assert (turned >= np.minimum(counted, sent[begins - 1] + back) - 0.05).all(), (trial, turn, turned - counted)
