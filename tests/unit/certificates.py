"""Certificates for tests: a vertical axis, with a cover of equal cells made here."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from shipped import load_vehicle

from flightstack.barrier.budgets import budget
from flightstack.barrier.condition import Reach, Setting, coefficients
from flightstack.barrier.estimate_bounds import EstimateBounds
from flightstack.barrier.knowledge import Envelope, InitialKnowledge, Knowledge, Request
from flightstack.barrier.margins import Accuracy, Doubts, Ledger
from flightstack.barrier.posterior import Accelerations, Posterior, Process
from flightstack.barrier.premises import Premises
from flightstack.barrier.records import Authority, AxisCertificate, Certificate, Response
from flightstack.barrier.shapes import Barrier, Quadratic, Stopping, value
from flightstack.barrier.torque import GovernorTerms, governor_terms
from flightstack.certificate_check import knowledge as checked_knowledge
from flightstack.certificate_check.knowledge import tables
from flightstack.learning.priors import default_priors
from flightstack.model import Limits, Model
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

MODEL = Model(1.2, 26.4, 1.0, 0.02, 0.045, 0.0, (0.05, 0.05, 0.1), 0.12, ())
ELLIPSE = Quadratic(0.0, 0.0, 1.0 / 0.36 + 1.2**2 / 1.2, 1.2, 1.2)
STOPPING = Stopping(-0.5, 0.5, 0.4, 1.1, 1.5)
RESPONSE = Response(0.02, 0.0, 0.005)
DOUBTS, ACCURACY = Doubts(0.0005, 0.02, 0.02), Accuracy(0.0005, 0.002, 0.01)
ESTIMATE = EstimateBounds((0.0005,) * 3, (0.002,) * 3, (0.01,) * 3, 4.3)
TILT_OFF = 0.01 / STANDARD_GRAVITY_MPS2


def uniform_cells(barrier: Barrier, setting: Setting, table: Authority, across: int = 40) -> F64:
    """Equal cells over the barrier's box, cut at the nodes, each with the best of some commands by its corners."""
    low_e, high_e, low_v, high_v = barrier.box
    grow_e, grow_v = 0.2 * (high_e - low_e), 0.1 * (high_v - low_v)
    es = np.linspace(low_e - grow_e, high_e + grow_e, across + 1)
    kinks = [-s * b * barrier.reaction_s for s, b in _brakes(barrier)]
    vs = np.linspace(low_v - grow_v, high_v + grow_v, across + 1)
    between = [x for x in (*table.v_mps, *kinks) if vs[0] < x < vs[-1]]
    vs = np.unique(np.concatenate([vs, between]))
    cells = []
    for i in range(len(es) - 1):
        for j in range(len(vs) - 1):
            box = es[i], es[i + 1], vs[j], vs[j + 1]
            if touches(barrier, setting.eta - setting.inner, box):
                u, q = best_command(barrier, setting, table.reach(0.5 * (vs[j] + vs[j + 1])), box)
                cells.append([*box, u, q])
    return np.array(cells)


def touches(barrier: Barrier, eta: float, box: tuple[float, ...]) -> bool:
    """Whether the cell has a point of the region on a 9 x 9 grid, with a little to spare."""
    grid = [(e, v) for e in np.linspace(*box[:2], 9) for v in np.linspace(*box[2:], 9)]
    return any(value(barrier, e, v) >= -eta - 0.01 for e, v in grid)


def best_command(barrier: Barrier, setting: Setting, reach: Reach, box: tuple[float, ...]) -> tuple[float, float]:
    """The best of 41 commands, and its least q at the corners with the better line of alpha, a little rounded down."""
    us = np.linspace(reach.u_low, reach.u_high, 41)
    found = []
    for steep in (False, True):
        corners = [
            coefficients(row, e, v, setting, reach, steep) for row in barrier.rows for e in box[:2] for v in box[2:]
        ]
        a, b, c, k, m, l, n = np.array(corners).T[:, :, None]  # noqa: E741
        q = ((a * us + b) * us + c - np.abs(k + m * us) - np.abs(l + n * us)).min(axis=0)
        best = int(np.argmax(q))
        found.append((float(us[best]), float(q[best]) - 1e-7))
    return max(found, key=lambda pair: pair[1])


def _brakes(barrier: Barrier) -> list[tuple[float, float]]:
    return [(1.0, barrier.brake_high_mps2), (-1.0, barrier.brake_low_mps2)] if isinstance(barrier, Stopping) else []


def known_vehicle(points: int, *, seed: int = 1) -> Accelerations:
    """What a learner holds of a vehicle 1.4 times as heavy as believed, pushed north by 0.1 g."""
    rng = np.random.default_rng(seed)
    x = np.zeros((points, 7))
    x[:, :3] = rng.uniform(-1.5, 1.5, (points, 3))
    x[:, 3:5] = rng.uniform(-0.1, 0.1, (points, 2))
    x[:, 5] = rng.uniform(0.2, 1.8, points)
    x[:, 6] = x[:, 5] * rng.uniform(0.0, 0.001, points)
    priors = default_priors()
    thrust_mps2 = STANDARD_GRAVITY_MPS2 * x[:, 5:6]
    lateral_y = np.array([0.98, 0.0]) + rng.normal(0.0, 0.03, (points, 2))
    vertical_y = (1.0 - 1.0 / 1.4) * thrust_mps2 + rng.normal(0.0, 0.045, (points, 1))
    return Accelerations(
        Posterior(Process(priors.lateral.kernel, priors.lateral.noise_var, x, lateral_y, np.full(2, 1e-4))),
        Posterior(Process(priors.vertical.kernel, priors.vertical.noise_var, x, vertical_y, np.full(1, 1e-4))),
        MODEL,
    )


def knowledge(points: int = 60, axes: tuple[int, ...] = (2,), version: int = 1, last: bool = False) -> Knowledge:
    """What these points say of some axes round 2 m of height, with some thrust across."""
    envelope = Envelope(((-0.2, 0.2), (-0.2, 0.2), (-1.6, 1.6)), (1.2, 2.8), nodes=9, axes=axes)
    box = budget(MODEL, Limits(), sideways_mps2=((-0.5, 0.5), (-0.5, 0.5)), low_mps2=3.0, tilt_off=TILT_OFF)
    return Knowledge.of(
        Request(
            known_vehicle(points), MODEL, envelope, box, InitialKnowledge(), version=version, last=last,
            attitude_mps2=np.array(ESTIMATE.acc_mps2), torque_mps2=governor().worst_mps2,
        )
    )  # fmt: skip


@lru_cache(maxsize=8)
def certificate(barrier: Barrier = ELLIPSE, points: int = 60, across: int = 20) -> Certificate:
    """Of the vertical axis."""
    known = knowledge(points)
    table = known.authorities[2]
    setting, margins = Ledger(
        2,
        table,
        RESPONSE,
        gamma_ps=2.0,
        dt_s=0.004,
        accuracy=ACCURACY,
        doubts=DOUBTS,
        gain_part_mps2=known.gain_part_mps2[2],
        torque_part_mps2=known.torque_part_mps2[2],
        inside_ps=8.0,
    )(barrier)
    axis = AxisCertificate(
        2, barrier, setting, RESPONSE, table, margins, uniform_cells(barrier, setting, table, across)
    )
    rests_on = {**known.as_json(), "doubts": DOUBTS._asdict()}
    return Certificate(
        "sound", (0.0, 0.0, -2.0), (axis,), known.budget, known.delta, known.k_sigma, rests_on, known.version,
        premises_for(known), governor(),
    )  # fmt: skip


@lru_cache(maxsize=1)
def governor() -> GovernorTerms:
    """Of quad-x, which MODEL is."""
    return governor_terms(load_vehicle("quad-x"), MODEL, Limits(), (1e-3, 1e-3, 7e-4))


def premises_for(known: Knowledge) -> Premises:
    """The widest that the bounds bear."""
    table, box = known.authorities[2], known.budget
    ranges = known.as_json()["speeds_mps"]
    assert isinstance(ranges, list)
    spare = (-ACCURACY.vel_mps, -ACCURACY.vel_mps, ACCURACY.vel_mps)
    north, east, down = ((low - s, high + s) for (low, high), s in zip(ranges, spare, strict=True))
    off = max(table.error_low_mps2.max(), table.error_high_mps2.max()) / box.high_mps2
    return Premises(
        "made up", "", ESTIMATE, (north, east, down), box.leans,
        (box.low_mps2, box.thrust_max_mps2),
        (0.97, 1.03), (float(table.gain.min() - off), float(table.gain.max() + off)),
        (RESPONSE.delay_s - DOUBTS.delay_s, RESPONSE.delay_s + DOUBTS.delay_s), DOUBTS.delay_s, DOUBTS.age_s, 0.004,
        (14.0, 16.8),
    )  # fmt: skip


def resealed(data: dict[str, Any]) -> str:
    """Its text with a seal that fits."""
    data = {key: part for key, part in data.items() if key != "seal"}
    canonical = json.dumps(data, sort_keys=True, separators=(",", ":"))
    seal = hashlib.sha256(canonical.encode()).hexdigest()
    return f'{canonical[:-1]},"seal":"{seal}"}}'


@contextmanager
def tables_kept() -> Iterator[None]:
    """The checker's tables of the last knowledge are kept: nine changes of ten leave it as it was."""
    kept: dict[str, Any] = {}

    def once(known: Any) -> dict[int, F64]:
        key = json.dumps(known.data) + repr((known.box, known.k))
        if key not in kept:
            kept.clear()
            kept[key] = tables(known), known.lead, known.torque
        found, known.lead, known.torque = kept[key]
        return found  # type: ignore[no-any-return]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checked_knowledge, "tables", once)
        yield
