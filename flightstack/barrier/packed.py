"""A certificate as one row of numbers, for the compiled tick (`assess`).

Compiled code is entered with flat arrays only, because each array that is handed over costs half a microsecond.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.barrier.condition import Setting
from flightstack.barrier.cover import bands
from flightstack.barrier.records import Certificate, Leans, spared
from flightstack.barrier.response import CHAIN
from flightstack.barrier.shapes import ROW
from flightstack.barrier.turning import turning
from flightstack.jit import njit
from flightstack.model import Limits, Model
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

DT_RANGE_S = (0.001, 0.05)
P_CERTIFIED, P_CENTRE, P_PIECES, P_NODES, P_SETTING = 0, 3, 6, 9, 12
P_NUMBERS = len(Setting._fields)
P_RESPONSE = P_SETTING + 3 * P_NUMBERS
P_CHAIN = P_RESPONSE + 9
P_BOUNDS = P_CHAIN + CHAIN
P_LEANS = P_BOUNDS + 2
P_RATES = P_LEANS + 4
P_TURNING = P_RATES + 2
P_SIZES = P_TURNING + 2
P_HEAD = P_SIZES + 2
"""Places in a packed certificate: certified (3), centre (3), numbers of pieces and nodes (3 each), settings (3, 8),
response (3, 3), chain, bounds (least and greatest normalised thrust of the budget, leans to north and to east, greatest
roll and pitch rates), `turning` (2, 0 where nothing governs rates), and how many pieces and nodes each axis has room
for; pieces and tables (`table_of`)."""


def pack(certificate: Certificate | None, model: Model, limits: Limits, attitude_p_ps: float) -> F64:
    """The certificate in one row, with what it leaves open taken from the model."""
    axes = {axis.axis: axis for axis in certificate.axes} if certificate else {}
    pieces = max((len(axis.barrier.rows) for axis in axes.values()), default=1)
    nodes = max((axis.authority.table.shape[1] for axis in axes.values()), default=2)
    flat = np.zeros(P_HEAD + 3 * pieces * ROW + 3 * 7 * nodes)
    flat[P_SIZES : P_SIZES + 2] = pieces, nodes
    flat[P_NODES : P_NODES + 3] = 1.0
    if certificate:
        flat[P_CENTRE : P_CENTRE + 3] = certificate.centre_ned_m
    steer_s = 1.0 / attitude_p_ps
    response = flat[P_RESPONSE:P_CHAIN].reshape(3, 3)
    response[:] = steer_s, steer_s * model.rate_lag_s, model.transport_delay_s
    response[2, :2] = model.motor_lag_s, 0.0
    tables = flat[P_HEAD + 3 * pieces * ROW :].reshape(3, 7, nodes)
    tables[2, 1], tables[2, 2] = STANDARD_GRAVITY_MPS2, 1.0
    for i, axis in axes.items():
        rows, table = axis.barrier.rows, axis.authority.table
        flat[[P_CERTIFIED + i, P_PIECES + i, P_NODES + i]] = 1.0, len(rows), table.shape[1]
        flat[P_SETTING + P_NUMBERS * i : P_SETTING + P_NUMBERS * (i + 1)] = axis.setting
        response[i] = axis.response.c1_s, axis.response.c2_s2, axis.response.delay_s
        flat[P_HEAD + i * pieces * ROW :][: rows.size] = rows.ravel()
        tables[i, :3, : table.shape[1]] = table[:3]
        tables[i, 3:, : table.shape[1] - 1] = bands(axis.authority)[:, 2:].T
    _fill_chain(flat, tables[2], certificate, model, limits)
    return flat


def _fill_chain(flat: F64, vertical: F64, certificate: Certificate | None, model: Model, limits: Limits) -> None:
    """The vehicle's answer and its limits; `vertical` (7, n): the authority's table.

    The thrust that leads the lateral axes is that of hover, or the budget's middle if that is more, as `budgets.budget`
    has it: then no thrust in the budget takes away what lateral authority the budget grants.
    """
    low_n, high_n = model.thrust_range_n(limits)
    low, high, tilt = low_n / model.mass_kg, high_n / model.mass_kg, limits.tilt_max_rad
    least, most, longest = low, high, high
    if certificate:
        box = certificate.budget
        tilt, least, most, longest = min(box.tilt_max_rad, tilt), box.low_mps2, box.high_mps2, box.thrust_max_mps2
    steered = 1 if flat[P_CERTIFIED + 1] and not flat[P_CERTIFIED] else 0
    steer, square, delay = flat[P_RESPONSE + 3 * steered : P_RESPONSE + 3 * steered + 3]
    at = int(np.argmin(np.abs(vertical[0, : int(flat[P_NODES + 2])])))
    rotor_lag, thrust_delay = flat[P_RESPONSE + 6], flat[P_RESPONSE + 8]
    flat[P_CHAIN:P_BOUNDS] = [
        model.max_thrust_n / model.mass_kg, model.thrust_model_factor, model.norm_of(low_n), model.norm_of(high_n),
        rotor_lag, square / steer if steer > 0.0 else 0.0, round(1e6 * thrust_delay), round(1e6 * delay), steer,
        max(min(vertical[1, at] / vertical[2, at], most), 0.5 * (least + most)), DT_RANGE_S[0],
    ]  # fmt: skip
    if certificate and certificate.governor is not None:
        flat[P_TURNING:P_SIZES] = turning(certificate.governor, model, max(least, low))
    asked = (model.norm_of(min(max(each, low), high) * model.mass_kg) for each in (least, longest))
    north, east = _leans(certificate, tilt)
    flat[P_BOUNDS:P_TURNING] = *asked, *north, *east, *limits.rate_max_radps[:2]


def _leans(certificate: Certificate | None, tilt_rad: float) -> Leans:
    """Leans to north and to east that are steered to: the estimate must keep within the certificate's, which what the
    attitude may be off by and what the governor lets it run over take up."""
    if certificate is None:
        most = math.sin(tilt_rad) * math.sqrt(0.5)
        return (-most, most), (-most, most)
    if certificate.premises is None:
        return certificate.budget.kept
    return spared(certificate.premises.leans, certificate.budget.lean_spare)


@njit
def pieces_of(flat: F64, axis: int) -> F64:
    """(n, ROW) the pieces of one axis' barrier."""
    at = P_HEAD + axis * int(flat[P_SIZES]) * ROW
    count = int(flat[P_PIECES + axis])
    return flat[at : at + count * ROW].reshape(count, ROW)


@njit
def table_of(flat: F64, axis: int) -> F64:
    """(7, n) one axis' authority: v, offset, gain at each node; the reach from it to the next one."""
    nodes = int(flat[P_SIZES + 1])
    at = P_HEAD + 3 * int(flat[P_SIZES]) * ROW + axis * 7 * nodes
    return flat[at : at + 7 * nodes].reshape(7, nodes)[:, : int(flat[P_NODES + axis])]


@njit
def setting_of(flat: F64, axis: int) -> Setting:
    """The constants of one axis' condition."""
    at = P_SETTING + P_NUMBERS * axis
    return Setting(
        flat[at], flat[at + 1], flat[at + 2], flat[at + 3], flat[at + 4], flat[at + 5], flat[at + 6], flat[at + 7]
    )
