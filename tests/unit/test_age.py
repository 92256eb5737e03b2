"""What the ledger says of the newest sample's age, against an exact plant whose acceleration is off by all that is
certified, with thrust and lean switched from end to end meanwhile."""

from __future__ import annotations

import numpy as np
from lagging_plant import G, Plant, authority, certificate, crossed
from shipped import load_vehicle

from flightstack.barrier.margins import Accuracy, Doubts, Ledger
from flightstack.barrier.packed import P_BOUNDS, P_CHAIN
from flightstack.barrier.records import Budget, Certificate, Response
from flightstack.barrier.response import lead
from flightstack.model import Limits, Model
from flightstack.safety_filter import BarrierFilter
from flightstack.types import F64, Command, Learned
from flightstack.under_way import UnderWay

QUAD = Model.from_vehicle(load_vehicle("quad-x"))
TICK_US, DELAY_US, AGE_US, ERROR = 4000, 16_000, 24_000, 0.6
STEER, GAIN = 1.0 / 6.5, 1.0 / 1.4
ACCURACY = Accuracy(0.005, 0.02, 0.0)
RESPONSES = (Response(STEER, STEER * QUAD.rate_lag_s, 1e-6 * DELAY_US),) * 2 + (
    Response(QUAD.motor_lag_s, 0.0, 1e-6 * DELAY_US),
)
LOW, HIGH = 0.5 * G, 1.7 * G


def certified(age_s: float) -> Certificate:
    """All axes; what its ledger leaves out but age, delay and estimate is known exactly."""
    rows = {}
    for i, response in enumerate(RESPONSES):
        reach = authority(-1.5, 1.5, ERROR) if i < 2 else authority(G - GAIN * HIGH, G - GAIN * LOW, ERROR, G, GAIN)
        shape = crossed(0.6, 0.7, 0.742)
        doubts = Doubts(0.0, 0.0, 0.0, 0.0, age_s)
        setting, _ = Ledger(i, reach, response, gamma_ps=0.5, dt_s=0.004, accuracy=ACCURACY, doubts=doubts)(shape)
        rows[i] = (shape, setting, response, reach)
    return certificate(rows, Budget.square(LOW, HIGH, HIGH, 0.5))


def apart(seed: int) -> F64:
    """(n, 3, 2) by how far z, predicted from an old sample, is off when the command begins to act: place and speed."""
    rng, flown = np.random.default_rng(seed), certified(0.0)
    norm = QUAD.norm_of(G / GAIN * QUAD.mass_kg)
    plant = Plant(
        QUAD.max_thrust_n / QUAD.mass_kg, QUAD.thrust_model_factor, GAIN, np.zeros(3), QUAD.motor_lag_s,
        QUAD.rate_lag_s, DELAY_US, norm,
    )  # fmt: skip
    under_way, safety = UnderWay(QUAD), BarrierFilter(QUAD, Limits())
    memory, state = under_way.init(), safety.adopt(safety.init(np.zeros(3)), flown)
    chain = state.packed[P_CHAIN:P_BOUNDS].copy()
    response = np.array([[r.c1_s, r.c2_s2, r.delay_s] for r in RESPONSES])
    sent = Command(-TICK_US, 0.0, norm, np.zeros(3))
    samples, found, true = [], [], []
    wind, place, speed = np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(320):
        plant.advance(k * TICK_US)
        row = plant.measurement().row
        z = np.zeros(14)
        z[:13], z[13] = row[:13], plant.norm
        offset = np.array([0.0, 0.0, G])
        true.append([lead(chain, z, response, i, float(offset[i]), GAIN) for i in range(3)])
        if k % 40 == 0:  # a good while in one direction, as the estimate: the worst of a prediction of 40 ms
            sign = rng.choice([-1.0, 1.0], 3)
            wind, place, speed = ERROR * sign, -ACCURACY.pos_m * sign, -ACCURACY.vel_mps * sign
        plant.push = wind
        seen = plant.measurement()
        seen.row[:3] += place
        seen.row[3:6] += speed
        samples.append(seen)
        command = Command(
            k * TICK_US, 0.0, float(QUAD.norm_of(rng.choice([LOW, HIGH]) * QUAD.mass_kg)),
            np.append(rng.choice([-0.4, 0.4], 2), 0.0),
        )  # fmt: skip
        if k >= AGE_US // TICK_US:
            old = samples[k - AGE_US // TICK_US]
            now = under_way.carry(memory, old, sent, Learned.nothing(), k * TICK_US, safety.in_force(state))
            state, _, filtered = safety.step(state, now, command, sent, Learned.nothing())
            found.append((k, filtered.row[23:29].copy()))
        sent = command
        plant.send(command)
    late = DELAY_US // TICK_US
    return np.array(
        [np.stack([z[:3], z[3:]]).T - np.array(true[k + late]) for k, z in found if 60 < k < 320 - late]
    )  # fmt: skip


def test_an_old_sample_costs_what_the_ledger_says_and_no_less_than_without_its_line() -> None:
    off = np.abs(apart(3)).max(axis=0)
    for i in range(3):
        with_line, without = (certified(age).axes[i].setting for age in (1e-6 * AGE_US, 0.0))
        assert off[i, 0] <= with_line.off_m + 1e-5, (i, off[i], with_line)  # so much the integration is off by
        assert off[i, 1] <= with_line.off_mps + 1e-5, (i, off[i], with_line)
        lead = RESPONSES[i].c1_s * ERROR  # what z's speed is off by that is no part of the prediction
        assert off[i, 1] > 1.2 * (without.off_mps - lead), (i, off[i], without)
        assert off[i, 0] > 0.7 * with_line.off_m
        assert off[i, 1] > 0.8 * (with_line.off_mps - lead)
