"""Prediction over delay and lags against a fine integration of the same chain by SciPy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flightstack.barrier.response import (
    C_HOLD,
    CHAIN,
    STATE,
    acceleration,
    ahead,
    command_for,
    follow_rotors,
    lead,
    new_memory,
    remember,
)  # fmt: skip
from flightstack.frames import quat_from_euler, quat_to_matrix
from flightstack.types import F64

ROTOR_LAG, RATE_LAG, STEER, LEAD_THRUST = 0.05, 0.045, 0.15, 13.0
OFFSET, GAIN = np.array([0.9, -0.4, 10.1]), 0.72


def chain_of(curve: float, thrust_delay_us: float, rate_delay_us: float, hold_s: float = 0.004) -> F64:
    chain = [22.0, curve, 0.2, 0.9, ROTOR_LAG, RATE_LAG, thrust_delay_us, rate_delay_us, STEER, LEAD_THRUST, hold_s]
    assert len(chain) == CHAIN
    return np.array(chain)


RESPONSE = np.array([[STEER, STEER * RATE_LAG, 0.0], [STEER, STEER * RATE_LAG, 0.0], [ROTOR_LAG, 0.0, 0.0]])


def slopes(_: float, y: F64, curve: float, norm: float, rate: F64) -> F64:
    """p, v, R by rows, body rates, w: the chain as the module's text says it."""
    v, r, omega, w = y[3:6], y[6:15].reshape(3, 3), y[15:18], y[18]
    force = GAIN * 22.0 * (curve * w * w + (1.0 - curve) * w)
    cross = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
    turn = np.append((rate[:2] - omega[:2]) / RATE_LAG, 0.0)
    return np.concatenate([v, OFFSET - force * r[:, 2], (r @ cross).ravel(), turn, [(norm - w) / ROTOR_LAG]])


def integrate(y: F64, from_us: float, to_us: float, sent: list[tuple[float, float, F64]], chain: F64) -> F64:
    """SciPy's answer; `sent` (time, norm, rates) in order, thrust and rates late by their own delays."""
    times = {from_us, to_us}
    for t, _, _ in sent:
        times |= {t + chain[6], t + chain[7]}
    edges = sorted(t for t in times if from_us <= t <= to_us)
    for start, end in itertools.pairwise(edges):
        norm = [n for t, n, _ in sent if t + chain[6] <= start][-1]
        rate = [r for t, _, r in sent if t + chain[7] <= start][-1]
        done = solve_ivp(slopes, (0.0, (end - start) * 1e-6), y, args=(chain[1], norm, rate), rtol=1e-11, atol=1e-12)
        y = done.y[:, -1]
    return y


def full(state: F64) -> F64:
    return np.concatenate([state[:6], quat_to_matrix(state[6:10]).ravel(), state[10:14]])


def some_commands(rng: np.random.Generator, period_us: int, count: int) -> list[tuple[float, float, F64]]:
    return [(float(i * period_us), rng.uniform(0.2, 0.9), rng.uniform(-2, 2, 3)) for i in range(count)]


@pytest.mark.parametrize("curve", [0.0, 0.4, 1.0])
@pytest.mark.parametrize(("thrust_delay_us", "rate_delay_us"), [(20_000, 20_000), (10_000, 37_000), (0, 0)])
def test_the_state_is_carried_over_delay_and_age_as_scipy_does(curve, thrust_delay_us, rate_delay_us):
    rng = np.random.default_rng(7)
    chain = chain_of(curve, thrust_delay_us, rate_delay_us)
    sent = some_commands(rng, 4000, 30)
    memory, measured_us = new_memory(), 117_500.0
    for t, norm, rate in sent:
        remember(memory, t, norm, rate)
    follow_rotors(memory, chain, measured_us)
    measured = np.zeros(20)
    measured[:6] = [0.3, -0.1, -1.0, 0.5, -0.7, 0.9]
    measured[6:10], measured[10:13] = quat_from_euler(0.2, -0.25, 1.1), [1.0, -1.5, 0.4]
    state = np.empty(STATE)
    now = 119_000.0  # the measurement is 1.5 ms old
    end = now + max(thrust_delay_us, rate_delay_us)
    ahead(memory, chain, measured, measured_us, end, OFFSET, GAIN, state)
    expected = integrate(full(np.append(measured[:13], memory[0, 1])), measured_us, end, sent, chain)
    np.testing.assert_allclose(full(state)[:6], expected[:6], atol=1e-6)
    np.testing.assert_allclose(full(state)[6:15], expected[6:15], atol=2e-5)
    np.testing.assert_allclose(full(state)[15:], expected[15:], atol=1e-10)


def test_rotors_fed_by_every_command_are_where_scipy_has_them():
    rng = np.random.default_rng(8)
    chain = chain_of(1.0, 13_000, 0)
    sent = some_commands(rng, 4000, 60)
    memory = new_memory()
    y = np.concatenate([np.zeros(6), np.eye(3).ravel(), np.zeros(3), [sent[0][1]]])
    for i, (t, norm, rate) in enumerate(sent):
        remember(memory, t, norm, rate)
        follow_rotors(memory, chain, t + 4000.0)
        y = integrate(y, t, t + 4000.0, [(-1e9, *sent[0][1:]), *sent[: i + 1]], chain)
        assert memory[0, 1] == pytest.approx(y[18], abs=1e-9)


@pytest.mark.parametrize("curve", [0.0, 1.0])
@pytest.mark.parametrize("hold_s", [0.004, 0.02])
def test_what_is_led_is_a_double_integrator_driven_by_u(curve, hold_s):
    """z_v changes by u times the hold: exactly for thrust at rest, sideways up to the axis' own curve."""
    rng = np.random.default_rng(9)
    chain = chain_of(curve, 0.0, 0.0, hold_s)
    for _ in range(40):
        state = np.zeros(STATE)
        state[:6] = rng.normal(size=6)
        state[6:10] = quat_from_euler(*rng.uniform(-0.2, 0.2, 2), rng.uniform(-3, 3))
        state[10:13] = [*rng.uniform(-1, 1, 2), 0.0]
        state[13] = rng.uniform(0.2, 0.9)
        norm, rate = rng.uniform(0.2, 0.9), np.array([*rng.uniform(-1, 1, 2), 0.0])
        y = integrate(full(state), 0.0, hold_s * 1e6, [(-1e6, norm, rate)], chain)
        u = np.empty(3)
        acceleration(chain, state, OFFSET, GAIN, norm, rate, u)
        before = [lead(chain, state, RESPONSE, i, OFFSET[i], GAIN) for i in range(3)]
        after_state = np.append(y[:6], np.zeros(8))
        after_state[10:14] = y[15:19]
        after_state[6:10] = _quaternion(y[6:15].reshape(3, 3))
        after = [lead(chain, after_state, RESPONSE, i, OFFSET[i], GAIN) for i in range(3)]
        driven = [(after[i][1] - before[i][1]) / hold_s for i in range(3)]
        np.testing.assert_allclose(u, driven, atol=0.25 if hold_s > 0.01 else 0.1)


@pytest.mark.parametrize("curve", [0.0, 0.6, 1.0])
def test_upright_the_vertical_axis_is_exact(curve):
    rng = np.random.default_rng(10)
    for hold_s in (0.002, 0.01, 0.04):
        chain = chain_of(curve, 0.0, 0.0, hold_s)
        state = np.zeros(STATE)
        state[6], state[5], state[13] = 1.0, rng.normal(), rng.uniform(0.2, 0.9)
        norm, rate, u = rng.uniform(0.2, 0.9), np.zeros(3), np.empty(3)
        y = integrate(full(state), 0.0, hold_s * 1e6, [(-1e6, norm, rate)], chain)
        acceleration(chain, state, OFFSET, GAIN, norm, rate, u)
        before = lead(chain, state, RESPONSE, 2, OFFSET[2], GAIN)
        after_state = state.copy()
        after_state[:6], after_state[13] = y[:6], y[18]
        after = lead(chain, after_state, RESPONSE, 2, OFFSET[2], GAIN)
        assert after[1] - before[1] == pytest.approx(u[2] * hold_s, abs=1e-9)


@pytest.mark.parametrize("curve", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("lag_s", [0.0, 0.05])
def test_a_command_and_its_acceleration_are_each_others_inverse(curve, lag_s):
    rng = np.random.default_rng(11)
    chain = chain_of(curve, 0.0, 0.0)
    chain[4] = lag_s
    for _ in range(100):
        chain[C_HOLD] = rng.uniform(0.002, 0.03)
        state = np.zeros(STATE)
        state[6:10], state[10:13] = quat_from_euler(*rng.uniform(-0.5, 0.5, 3)), rng.normal(size=3)
        state[13] = rng.uniform(0.2, 0.9)
        norm, rate, u = rng.uniform(0.2, 0.9), rng.normal(size=3), np.empty(3)
        acceleration(chain, state, OFFSET, GAIN, norm, rate, u)
        back = np.zeros(3)
        assert command_for(chain, state, OFFSET, GAIN, u, back) == pytest.approx(norm, abs=1e-10)
        np.testing.assert_allclose(back[:2], rate[:2], atol=1e-9)


def test_full_thrust_brakes_in_full_from_idle_and_idle_thrust_is_no_more_than_it_seems():
    """The reason for counting what the rotors owe: both ends of the range keep their authority whatever they do."""
    chain, u = chain_of(1.0, 0.0, 0.0, 0.004), np.empty(3)
    for w in np.linspace(0.2, 0.9, 15):
        state = np.zeros(STATE)
        state[6], state[13] = 1.0, w
        acceleration(chain, state, OFFSET, GAIN, 0.9, np.zeros(3), u)
        assert u[2] == pytest.approx(OFFSET[2] - GAIN * 22.0 * 0.81, abs=1e-12)
        acceleration(chain, state, OFFSET, GAIN, 0.2, np.zeros(3), u)
        assert u[2] >= OFFSET[2] - GAIN * 22.0 * 0.04 - 1e-12


def test_what_is_not_a_number_is_not_remembered():
    memory = new_memory()
    remember(memory, 0.0, np.nan, np.zeros(3))
    remember(memory, 1.0, 0.5, np.array([0.0, np.inf, 0.0]))
    assert (memory[:, 0] == -np.inf).all()
    state = np.empty(STATE)
    follow_rotors(memory, chain_of(1.0, 0.0, 0.0), 5000.0)
    measured = np.zeros(20)
    measured[6] = 1.0
    ahead(memory, chain_of(1.0, 0.0, 0.0), measured, 0.0, 5000.0, OFFSET, GAIN, state)
    assert np.isfinite(state).all()


def _quaternion(r: F64) -> F64:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(r).as_quat()
    return np.array([w, x, y, z])
