"""From measurements and sent commands to samples: what the model did not explain, and where.

A sample's target is the measured specific force less what the model says of it at the thrust that *acted*: the
commands sent, delayed by the identified latency and by the rotors' lag, taken at the IMU's own sample time.  Nothing
is differentiated.  (The paper uses x' of the state; on a vehicle that is a numerical derivative.)

Tilt axes.  Inputs and targets are in the frame that the shortest rotation turns from the world's axes so that its down
axis is the thrust axis: body axes with the heading taken out, identical to them at yaw 0.  There every effect
that is symmetric about the thrust axis (drag, wind, a world force, thrust's own error) is a function of
q' = (velocity, thrust direction) alone, whatever the heading.  Velocity is given along these axes, too: drag along an
axis is proportional to that axis' own component.  (Of a NED velocity, drag along the thrust axis is in products b_n v_n
and b_e v_e; they vary as thrust does in a turn, and taken for thrust they put its gain off by a tenth.)

Latency.  A bank of candidate delays runs beside each other; each one's delayed and lagged thrust is regressed on the
measured specific force along the thrust axis, both without what is slower than 0.1 s (what the state does to the force
is slow), forgetting over some seconds.  The delay with the least residual wins once thrust has been excited enough, it
explains half of the force's fast part, and its lead is clear.  It is unknown (NaN), and the delay of the file stands,
until so much is explained and delays two steps away leave clearly more, by what so many samples can tell: PX4's
simulator's IMU is too noisy.  What the link is known to take (`Measurement.late_us`) is in the delay from
the start, and moves it as soon as it changes.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.frames import quat_to_matrix
from flightstack.jit import Entry, njit
from flightstack.learning import asked
from flightstack.learning.tilt import tilt_axes
from flightstack.model import Model
from flightstack.rows import VEL_D
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Command, FlatOutput, Measurement

INPUTS = ("vel_x_mps", "vel_y_mps", "vel_z_mps", "thrust_axis_n", "thrust_axis_e", "thrust_weights", "ground_weights")
"""Columns of a sample's input: velocity along tilt axes; the thrust axis' north and east parts; applied thrust over the
believed weight (affine in it, the residual along z has the thrust's own error as its slope); the same times (R / 4h)^2,
the leading term of every ground effect, with h the height above the place of take-off."""
D = len(INPUTS)
V_X, V_Y, V_Z, AXIS_N, AXIS_E, THRUST, GROUND = range(D)

_CANDIDATES = 13
_CANDIDATE_STEP_S = 0.004
_RING = 32
_FORGET_S = 4.0
_SLOW_S = 0.1
_EXCITED_MPS2 = 0.2
"""Standard deviation that the fast part of applied thrust per mass must have before latencies are compared."""
_LEAD = 0.9
"""A candidate must leave less than this share of the present one's residual variance."""
_SETTLED_S = 0.5
"""Of samples in a row before the regressions begin: until then the slow parts are not what they will be."""
_EXPLAINED = 0.5
"""Share of the fast force's variance that the delayed thrust must explain before delays are told apart."""
_CURVED = 1.02
"""What delays two steps away must leave at least, of the chosen one's residual variance."""
_TOLD = 7.4
"""And by so much more, over the number of samples: a true delay that seems so much worse is one in 40 (chi squared of
two, delay and lag)."""
_GAP_MAX_S = 0.05
_LINK_CHANGED = 0.75
"""Steps by which what the link takes must differ before the delay follows: not to and fro between two."""
_SAME_S = 5e-7
"""Stamps of whole microseconds that differ by less are one."""
_THRUST_LEAST_WEIGHTS = 0.3
AWAY_M = 0.1
"""From the place of take-off: nearer the ground may hold the vehicle."""
_FORCE_MAX_MPS2 = 40.0
_LEAST_DOWN = 0.1
"""A thrust axis that leans beyond 84 degrees is none that a reference is flown with: its rate stays finite."""

# What the sampler is made for, one row.
_C_MASS, _C_MAX_THRUST, _C_THRUST_FACTOR, _C_MOTOR_LAG, _C_RATE_LAG, _C_DRAG = range(6)
_C_ROTOR_RADIUS, _C_DELAY, _C_AWAY = range(_C_DRAG + 3, _C_DRAG + 6)

# What the sampler remembers, one row: scalars, then the ring of commands, then the bank.
_M_IMU_S, _M_GROUND, _M_PICK, _M_HEAD, _M_STARTED = range(5)
_M_START = 5
_M_RATE = 8  # lagged rate commands
_M_RING = 11  # time, norm, rates: 5 each
_M_SLOW = _M_RING + 5 * _RING  # slow part of the force
_M_BANK = _M_SLOW + 1
_B_U, _B_SLOW, _B_COUNT, _B_TT, _B_TF, _B_FF = range(6)  # lagged u, slow part of the thrust, then sums
_BANK = 6
_M_EVIDENT = _M_BANK + _BANK * _CANDIDATES
_M_RUN_S = _M_EVIDENT + 1
_M_LINK = _M_RUN_S + 1  # steps of the delays that the link accounts for
_M_ASKED = _M_LINK + 1  # thrust that the reference asks for
_MEMORY = _M_ASKED + asked.ROW

# What a sample is, one row.
S_OK = 0
S_INPUT = 1
S_TARGET = S_INPUT + D
S_RATE_INPUT = S_TARGET + 3
S_RATE_TARGET = S_RATE_INPUT + 3
S_APART = S_RATE_TARGET + 3  # `asked`
S_APPLIED = S_APART + 1
S_LATENCY = S_APPLIED + 1
S_HEADING = S_LATENCY + 1  # cosine and sine of the turn from tilt axes to body axes
S_TARGET_FRD = S_HEADING + 2
S_HEIGHT = S_TARGET_FRD + 3
S_DELAY = S_HEIGHT + 1  # that the sample was made with, evident or not
S_REPEATED = S_DELAY + 1  # the force is that of the step before: nothing new came
SAMPLE = S_REPEATED + 1


class Sampler:
    """Samples of one vehicle; final, holds only constants.  The state (`init`) is one row, changed in place."""

    __slots__ = ("_constants",)

    def __init__(self, model: Model, away_m: float = AWAY_M) -> None:
        """`away_m`: so far from the place of take-off, as estimated, samples begin."""
        m = model
        lags_s = max(m.motor_lag_s, 1e-4), max(m.rate_lag_s, 1e-4)
        row = m.mass_kg, m.max_thrust_n, m.thrust_model_factor, *lags_s, *m.drag_kgps, m.rotor_radius_m
        self._constants = np.array([*row, m.transport_delay_s, away_m])

    def init(self) -> F64:
        """State before the first measurement."""
        memory = np.zeros(_MEMORY)
        memory[_M_IMU_S] = -1.0
        memory[_M_RING:_M_SLOW:5] = -1.0
        memory[_M_PICK] = min(round(self._constants[_C_DELAY] / _CANDIDATE_STEP_S), _CANDIDATES - 1)
        return memory

    def step(self, memory: F64, measurement: Measurement, sent: Command, out: F64) -> None:
        """One sample into `out` (SAMPLE,): OK is 0 where it is not fit to learn from."""
        _SAMPLED.call(
            self._constants, memory, measurement.row, sent.rate_frd_radps, float(sent.thrust_norm),
            (sent.t_us * 1e-6, measurement.t_us * 1e-6, measurement.imu_age_us * 1e-6), measurement.late_us * 1e-6, out,
        )  # fmt: skip

    def renew(self, memory: F64) -> None:
        """The vehicle is not what it was: thrust has another level from now on."""
        memory[_M_ASKED + asked.SEEN_S] = 0.0

    def at_reference(self, memory: F64, reference: FlatOutput, learned: F64, out: F64) -> None:
        """The input at the reference and its time derivative into `out` (2, D), thrust columns 0 in the first.

        `learned` (6,): acceleration and jerk fed forward so far.  The thrust axis depends on them, and they on the
        thrust axis; one fixed-point step a tick, from the tick before, follows it.  The thrust columns of
        out[0] are 0 and (R / 4h)^2: per unit of thrust; those of out[1] are 0 and its derivative.
        """
        _REFERENCE.call(self._constants, memory, reference.row, learned, out)


@njit
def _thrust(u: float, max_thrust: float, factor: float) -> float:
    return max_thrust * (factor * u * u + (1.0 - factor) * u)


@njit
def _proximity(radius: float, height: float) -> float:
    """(R / 4h)^2 with h at least R / 2, as in the ground effect's own definition."""
    share = 0.25 * radius / max(height, 0.5 * radius)
    return share * share


@njit
def _command_at(memory: F64, time: float) -> int:
    """Place in the ring of the newest command sent at or before `time`; -1 if none."""
    head = int(memory[_M_HEAD])
    for back in range(_RING):
        place = _M_RING + 5 * ((head - back) % _RING)
        if memory[place] < 0.0:
            return -1
        if memory[place] <= time:
            return place
    return -1


@njit
def _advance(constants: F64, memory: F64, now: float, dt: float, force_z: float, learn: bool) -> None:
    """Carry every candidate's rotors over `dt` to `now`, and its regression along."""
    keep_u = math.exp(-dt / constants[_C_MOTOR_LAG])
    keep_rate = math.exp(-dt / constants[_C_RATE_LAG])
    forget = math.exp(-dt / _FORGET_S)
    slow = 1.0 - math.exp(-dt / _SLOW_S)
    middle = now - 0.5 * dt
    memory[_M_RUN_S] = memory[_M_RUN_S] + dt if learn else 0.0
    learn = learn and memory[_M_RUN_S] > _SETTLED_S
    pick = int(memory[_M_PICK])
    memory[_M_SLOW] += slow * (force_z - memory[_M_SLOW])
    force = force_z - memory[_M_SLOW]
    for k in range(_CANDIDATES):
        b = _M_BANK + _BANK * k
        place = _command_at(memory, middle - k * _CANDIDATE_STEP_S)
        u = memory[place + 1] if place >= 0 else 0.0
        memory[b + _B_U] = u + keep_u * (memory[b + _B_U] - u)
        if k == pick:
            for i in range(3):
                rate = memory[place + 2 + i] if place >= 0 else 0.0
                memory[_M_RATE + i] = rate + keep_rate * (memory[_M_RATE + i] - rate)
        thrust = _thrust(memory[b + _B_U], constants[_C_MAX_THRUST], constants[_C_THRUST_FACTOR]) / constants[_C_MASS]
        memory[b + _B_SLOW] += slow * (thrust - memory[b + _B_SLOW])
        thrust -= memory[b + _B_SLOW]
        for j in range(2, _BANK):
            memory[b + j] *= forget
        if learn:
            memory[b + _B_COUNT] += 1.0
            memory[b + _B_TT] += thrust * thrust
            memory[b + _B_TF] += thrust * force
            memory[b + _B_FF] += force * force


@njit
def _left(memory: F64, k: int) -> tuple[float, float]:
    """Residual variance of candidate `k`'s regression, and the variance of its thrust."""
    b = _M_BANK + _BANK * k
    n, tt = memory[b + _B_COUNT], memory[b + _B_TT]
    if n < 50.0 or tt <= 0.0:
        return math.inf, 0.0
    return (memory[b + _B_FF] - memory[b + _B_TF] * memory[b + _B_TF] / tt) / n, tt / n


@njit
def _choose_latency(memory: F64) -> None:
    present, excited = _left(memory, int(memory[_M_PICK]))
    if not excited > _EXCITED_MPS2 * _EXCITED_MPS2:
        return
    best, least = -1, _LEAD * present
    for k in range(_CANDIDATES):
        left, _ = _left(memory, k)
        if left < least:
            best, least = k, left
    pick = best if best >= 0 else int(memory[_M_PICK])
    left = min(least, present)
    b = _M_BANK + _BANK * pick
    if left > (1.0 - _EXPLAINED) * memory[b + _B_FF] / memory[b + _B_COUNT]:
        return
    memory[_M_PICK] = pick
    curved = max(_CURVED, 1.0 + _TOLD / memory[b + _B_COUNT])
    for k in (pick - 2, pick + 2):
        if 0 <= k < _CANDIDATES and _left(memory, k)[0] < curved * _left(memory, pick)[0]:
            return
    memory[_M_EVIDENT] = 1.0


@njit
def _remember(memory: F64, t_sent: float, norm: float, rate: F64) -> None:
    head = int(memory[_M_HEAD])
    if memory[_M_RING + 5 * head] >= t_sent:
        return
    head = (head + 1) % _RING
    memory[_M_HEAD] = head
    place = _M_RING + 5 * head
    memory[place] = t_sent
    memory[place + 1] = norm
    for i in range(3):
        memory[place + 2 + i] = rate[i]


@njit
def _follow_link(memory: F64, late_s: float) -> None:
    """Move the present candidate by what the link takes more or less than before."""
    steps = late_s / _CANDIDATE_STEP_S
    if abs(steps - memory[_M_LINK]) > _LINK_CHANGED:
        moved = memory[_M_PICK] + round(steps) - memory[_M_LINK]
        memory[_M_PICK], memory[_M_LINK] = min(max(moved, 0.0), _CANDIDATES - 1.0), round(steps)


@njit
def _sample(
    constants: F64, memory: F64, measured: F64, sent_rate: F64, norm: float, times_s: tuple[float, float, float],
    late_s: float, out: F64,
) -> None:  # fmt: skip
    """`measured` (20,): a Measurement's row; the rest as in `Sampler.step`."""
    t_sent, now, imu_age = times_s
    out[:] = 0.0
    finite = math.isfinite(norm)
    for i in range(16):
        finite = finite and math.isfinite(measured[i])
    for i in range(3):
        finite = finite and math.isfinite(sent_rate[i])
    if not finite:
        return
    pos, vel, q, rate, force = measured[0:3], measured[3:6], measured[6:10], measured[10:13], measured[13:16]
    if memory[_M_STARTED] == 0.0:
        memory[_M_STARTED] = 1.0
        memory[_M_GROUND] = pos[2]
        memory[_M_START : _M_START + 3] = pos
    _remember(memory, t_sent, norm, sent_rate)
    _follow_link(memory, late_s)
    imu_time = now - imu_age
    dt = imu_time - memory[_M_IMU_S]
    fresh = _SAME_S < dt <= _GAP_MAX_S and memory[_M_IMU_S] >= 0.0
    away = 0.0
    size = 0.0
    for i in range(3):
        away += (pos[i] - memory[_M_START + i]) ** 2
        size += force[i] * force[i]
    flying = away > constants[_C_AWAY] * constants[_C_AWAY] and size < _FORCE_MAX_MPS2 * _FORCE_MAX_MPS2
    if dt > _SAME_S:
        _advance(constants, memory, imu_time, min(dt, _GAP_MAX_S), force[2], flying and fresh)
        memory[_M_IMU_S] = imu_time
        if flying and fresh:
            _choose_latency(memory)
    pick = int(memory[_M_PICK])
    thrust = _thrust(memory[_M_BANK + _BANK * pick + _B_U], constants[_C_MAX_THRUST], constants[_C_THRUST_FACTOR])
    weights = thrust / (constants[_C_MASS] * STANDARD_GRAVITY_MPS2)
    r = quat_to_matrix(q)
    height = memory[_M_GROUND] - pos[2]
    _put_force(constants, r, vel, force, thrust, weights, height, out)
    for i in range(3):
        out[S_RATE_INPUT + i] = memory[_M_RATE + i]
        out[S_RATE_TARGET + i] = rate[i] - memory[_M_RATE + i]
    out[S_APPLIED] = thrust
    out[S_DELAY] = pick * _CANDIDATE_STEP_S
    out[S_LATENCY] = out[S_DELAY] if memory[_M_EVIDENT] != 0.0 else math.nan
    if flying and fresh:
        out[S_APART] = asked.apart(memory[_M_ASKED:_MEMORY], weights, dt, constants[_C_MOTOR_LAG])
    upright = r[2, 2] > 0.0
    out[S_REPEATED] = 0.0 if dt > _SAME_S else 1.0
    out[S_OK] = 1.0 if fresh and flying and upright and weights > _THRUST_LEAST_WEIGHTS else 0.0


@njit
def _put_force(
    constants: F64, r: F64, vel: F64, force: F64, thrust: float, weights: float, height: float, out: F64
) -> None:
    """Inputs and targets of the force into `out`, from the rotation matrix, velocity NED and specific force FRD."""
    mass = constants[_C_MASS]
    x = out[S_INPUT : S_INPUT + D]
    x[AXIS_N], x[AXIS_E] = r[0, 2], r[1, 2]
    x[THRUST] = weights
    x[GROUND] = weights * _proximity(constants[_C_ROTOR_RADIUS], height)
    tilt = np.empty((3, 3))
    tilt_axes(r[0, 2], r[1, 2], tilt)
    for i in range(3):
        x[V_X + i] = tilt[0, i] * vel[0] + tilt[1, i] * vel[1] + tilt[2, i] * vel[2]
    # body x axis in tilt axes: the heading that was taken out
    c = tilt[0, 0] * r[0, 0] + tilt[1, 0] * r[1, 0] + tilt[2, 0] * r[2, 0]
    s = tilt[0, 1] * r[0, 0] + tilt[1, 1] * r[1, 0] + tilt[2, 1] * r[2, 0]
    residual = out[S_TARGET_FRD : S_TARGET_FRD + 3]
    for i in range(3):
        along = r[0, i] * vel[0] + r[1, i] * vel[1] + r[2, i] * vel[2]
        residual[i] = force[i] + constants[_C_DRAG + i] * along / mass
    residual[2] += thrust / mass
    out[S_TARGET] = c * residual[0] - s * residual[1]
    out[S_TARGET + 1] = s * residual[0] + c * residual[1]
    out[S_TARGET + 2] = residual[2]
    out[S_HEADING], out[S_HEADING + 1] = c, s
    out[S_HEIGHT] = height


@njit
def _velocity_along(vel: F64, acc: F64, out: F64) -> None:
    """Velocity along tilt axes and its rate into `out` (2, D), which has the thrust axis and its rate."""
    n, e = out[0, AXIS_N], out[0, AXIS_E]
    n_rate, e_rate = out[1, AXIS_N], out[1, AXIS_E]
    down = math.sqrt(max(1.0 - n * n - e * e, 0.0))
    down_rate = -(n * n_rate + e * e_rate) / max(down, _LEAST_DOWN)
    share = 1.0 / (1.0 + down)
    share_rate = -share * share * down_rate
    across = n * vel[0] + e * vel[1]
    across_rate = n * acc[0] + e * acc[1] + n_rate * vel[0] + e_rate * vel[1]
    part = share * across + vel[2]
    part_rate = share_rate * across + share * across_rate + acc[2]
    out[0, V_X], out[0, V_Y], out[0, V_Z] = vel[0] - n * part, vel[1] - e * part, across + down * vel[2]
    out[1, V_X] = acc[0] - n_rate * part - n * part_rate
    out[1, V_Y] = acc[1] - e_rate * part - e * part_rate
    out[1, V_Z] = across_rate + down_rate * vel[2] + down * acc[2]


@njit
def _at_reference(constants: F64, memory: F64, reference: F64, learned: F64, out: F64) -> None:
    """As `Sampler.at_reference` says; `reference` (17,), `learned` (6,), `out` (2, D)."""
    drag = 0.5 * (constants[_C_DRAG] + constants[_C_DRAG + 1]) / constants[_C_MASS]
    t = np.empty(3)
    rate = np.empty(3)
    for i in range(3):
        t[i] = learned[i] - reference[6 + i] - drag * reference[3 + i]
        rate[i] = learned[3 + i] - reference[9 + i] - drag * reference[6 + i]
    t[2] += STANDARD_GRAVITY_MPS2
    size = math.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
    if size < 1.0:
        t[0], t[1], t[2], size = 0.0, 0.0, 1.0, 1.0
        rate[:] = 0.0
    memory[_M_ASKED + asked.NOW] = size / STANDARD_GRAVITY_MPS2
    along = (t[0] * rate[0] + t[1] * rate[1] + t[2] * rate[2]) / size
    for i in range(2):
        out[0, AXIS_N + i] = t[i] / size
        out[1, AXIS_N + i] = (rate[i] - along * t[i] / size) / size
    _velocity_along(reference[3:6], reference[6:9], out)
    height = memory[_M_GROUND] - reference[2]
    near = _proximity(constants[_C_ROTOR_RADIUS], height)
    out[0, THRUST] = 0.0
    out[1, THRUST] = 0.0
    out[0, GROUND] = near
    out[1, GROUND] = 2.0 * near * reference[VEL_D] / height if height > 0.5 * constants[_C_ROTOR_RADIUS] else 0.0


_SAMPLED = Entry(_sample, "f8[::1], f8[::1], f8[::1], f8[::1], f8, UniTuple(f8, 3), f8, f8[::1]")
_REFERENCE = Entry(_at_reference, "f8[::1], f8[::1], f8[::1], f8[::1], f8[:, ::1]")
