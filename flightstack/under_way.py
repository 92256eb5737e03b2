"""The state at this tick from the newest sample, over what the link is late, with the commands that were under way.

A sample that is D late says nothing of what the commands did that acted meanwhile: thrust that is switched over its
whole range moves velocity by 0.1 m/s in 20 ms.  From the sample on the vehicle is taken to answer the commands sent as
its file says: thrust after delay and rotors' lag, times the learned gain; roll and pitch rates after delay and the rate
loop's lag; the rest of the force as the accelerometer measured it, fixed in the world (`barrier.response`).  Where
others give the commands force and rates stay as they were measured.

While a certificate is in force its delay, gain and mean accelerations count instead, along its axes: then what the
filter predicts from here on goes on with one prediction from the sample, off by what the certificate says of them.  The
ledger's line `age` pays for it.  (Force as measured would be off by twice that and by the accelerometer's noise, and
where rotors are not as believed by all that they owe.)

What a command of this tick will meet is the state by what the link takes later (`Measurement.late_us`): `felt`, the
same chain carried on with the commands that act until then, the rest of the force as it was on average of late, since
one sample's noise over so long would move the velocity.  The controller goes by it.  Source: O. Smith, "Closer control
of loops with dead time", 1957.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.barrier.assess import column_at
from flightstack.barrier.packed import P_BOUNDS, P_CERTIFIED, P_CHAIN, table_of
from flightstack.barrier.response import (
    C_CURVE,
    C_RATE_DELAY,
    C_RATE_LAG,
    C_ROTOR_LAG,
    C_SPECIFIC,
    C_THRUST_DELAY,
    CHAIN,
    COMMAND,
    M_ROTORS,
    RING,
    S_ROTORS,
    STATE,
    ahead,
    follow_rotors,
    new_memory,
    remember,
    thrust_of,
)
from flightstack.frames import quat_to_matrix
from flightstack.jit import Entry, njit
from flightstack.model import Model, thrust_to_norm
from flightstack.rows import ATTITUDE, FORCE_X, FORCE_Y, FORCE_Z, L_DELAY, L_GAIN, VEL_D, VEL_N
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Command, Learned, Measurement, Tuple3

_MOST_US = 50_000
"""Over more than this nothing is carried: the ages tell the guard."""
LATE_MOST_US = 60_000
"""Nor is anything looked up further ahead than this, whatever the link is said to take."""
_PAUSE_US = 100_000.0
"""After a longer pause others give the commands."""
_NEVER_S = 1e9
_NONE = np.zeros(P_BOUNDS)
_STEADY_US = 100_000.0
"""Over so long the rest of the force is averaged."""
_AVERAGED = RING + 1
"""Row of the memory after the commands: the mean rest of the force NED (3), its time."""


class UnderWay:
    """For one believed vehicle; final, holds only constants.  The memory (`init`) is changed in place."""

    __slots__ = ("_chain", "_delay_s")

    def __init__(self, model: Model) -> None:
        self._chain = np.zeros(CHAIN)
        self._chain[C_SPECIFIC], self._chain[C_CURVE] = model.max_thrust_n / model.mass_kg, model.thrust_model_factor
        self._chain[C_ROTOR_LAG], self._chain[C_RATE_LAG] = model.motor_lag_s, model.rate_lag_s
        self._delay_s = model.transport_delay_s

    def init(self) -> F64:
        """Nothing was sent."""
        memory = np.zeros((_AVERAGED + 1, COMMAND))
        memory[:_AVERAGED] = new_memory()
        memory[_AVERAGED, 3] = -np.inf
        return memory

    def carry(
        self, memory: F64, measurement: Measurement, sent: Command, learned: Learned, now_us: int,
        in_force: F64 | None = None,
    ) -> Measurement:  # fmt: skip
        """The state at `now_us`; `sent`: the newest command, as applied; `in_force`: a certificate (`packed`)."""
        age_us, late_us = max(now_us - measurement.t_us, 0), min(max(measurement.late_us, 0), LATE_MOST_US)
        delay_s, gain = learned.row.item(L_DELAY), learned.row.item(L_GAIN)
        if not delay_s >= 0.0:
            delay_s = self._delay_s + 1e-6 * late_us
        row = measurement.row.copy() if age_us + late_us else measurement.row  # then nothing is written
        felt = row.copy() if late_us else row
        to_us = measurement.t_us + min(age_us, _MOST_US)
        times_us = (float(measurement.t_us), float(to_us), float(to_us + late_us))
        _CARRY.call(
            memory, self._chain, round(1e6 * delay_s), gain, times_us,
            (float(sent.t_us), sent.thrust_norm, sent.rate_frd_radps), row, felt,
            _NONE if in_force is None else in_force,
        )  # fmt: skip
        if not age_us + late_us:
            return measurement
        return Measurement(
            measurement.t_us + age_us, row, measurement.position_age_us + age_us, measurement.attitude_age_us + age_us,
            measurement.imu_age_us + age_us, measurement.battery_v, late_us, felt if late_us else None,
        )  # fmt: skip


@njit
def _carry(
    memory: F64, constants: F64, delay_us: float, gain: float, times_us: Tuple3, sent: tuple[float, float, F64],
    row: F64, felt: F64, flat: F64,
) -> None:  # fmt: skip
    """`row` (20,), a Measurement's at the first of `times_us`, becomes that of the second, `felt` that of the third.

    `felt` may be `row` where both times are the same; `flat`: `packed`, or 0.
    """
    from_us, to_us, felt_us = times_us
    remember(memory, *sent)
    chain = constants.copy()
    chain[C_THRUST_DELAY] = chain[C_RATE_DELAY] = delay_us
    ours = to_us - memory[RING, 0] <= _PAUSE_US
    if flat[P_CERTIFIED : P_CERTIFIED + 3].max() > 0.0:
        chain[:] = flat[P_CHAIN:P_BOUNDS]
    follow_rotors(memory, chain, from_us)
    if not felt_us > from_us:
        return
    if not ours:
        chain[C_ROTOR_LAG] = chain[C_RATE_LAG] = _NEVER_S  # rotors and rates go on as they are
        memory[0, M_ROTORS] = thrust_to_norm(max(-row[FORCE_Z], 0.0) / gain, chain[C_SPECIFIC], chain[C_CURVE])
    elif flat[P_CERTIFIED + 2] > 0.0:
        gain = column_at(table_of(flat, 2), 2, row[VEL_D])
    r, offset, state = quat_to_matrix(row[ATTITUDE : ATTITUDE + 4]), np.empty(3), np.empty(STATE)
    along = row[FORCE_Z] + gain * thrust_of(chain, memory[0, M_ROTORS])
    for i in range(3):
        offset[i] = r[i, 0] * row[FORCE_X] + r[i, 1] * row[FORCE_Y] + r[i, 2] * along
    offset[2] += STANDARD_GRAVITY_MPS2
    steady = _averaged(memory[_AVERAGED], offset, from_us) if felt_us > to_us else offset
    for i in range(3):
        if ours and flat[P_CERTIFIED + i] > 0.0:
            offset[i] = steady[i] = column_at(table_of(flat, i), 1, row[VEL_N + i])
    ahead(memory, chain, row, from_us, to_us, offset, gain, state)
    for i in range(13):
        row[i] = felt[i] = state[i]
    if felt_us > to_us:
        rotors = memory[0, M_ROTORS]
        memory[0, M_ROTORS] = state[S_ROTORS]
        ahead(memory, chain, row, to_us, felt_us, steady, gain, state)
        memory[0, M_ROTORS] = rotors  # as of the sample
        for i in range(13):
            felt[i] = state[i]


@njit
def _averaged(kept: F64, offset: F64, t_us: float) -> F64:
    """The mean of the rest of the force with one more sample of it (no number: none); `kept`: a row of the memory."""
    since_us, mean = t_us - kept[3], np.empty(3)
    share = 1.0 if not 0.0 <= since_us <= _PAUSE_US else 1.0 - math.exp(-since_us / _STEADY_US)
    if not math.isfinite(offset.sum()):
        return offset
    kept[3] = t_us
    for i in range(3):
        kept[i] += share * (offset[i] - kept[i])
        mean[i] = kept[i]
    return mean


_CARRY = Entry(
    _carry, "f8[:, ::1], f8[::1], f8, f8, UniTuple(f8, 3), Tuple((f8, f8, f8[::1])), f8[::1], f8[::1], f8[::1]"
)

__all__ = ["UnderWay"]
