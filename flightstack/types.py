"""What crosses modules: records with frame and unit in every name.

Frames are NED (world) and FRD (body); quaternions are Hamilton, scalar first, body to world (`q_ned_frd` turns an FRD
vector into NED).  Time is integer microseconds of the vehicle's own clock (`t_us`, since its boot).
Arrays are float64 and must not be written to by whoever receives them.

What a tick makes anew is lean: numbers that belong together lie in one `row`, which compiled code reads and the log
writes as it is; their names are `Part`s, views made when somebody asks.  Nothing is assigned to them once they are
made; that is a rule and not `frozen`, which makes a record three times as slowly.  Bundles of them are named tuples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, Protocol, TypeVar, overload
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from flightstack import rows
from flightstack.errors import InputError as InputError

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Tuple3 = tuple[float, float, float]
Tuple4 = tuple[float, float, float, float]

STANDARD_GRAVITY_MPS2 = 9.80665


class _Record(Protocol):
    @property
    def row(self) -> F64: ...


class Part:
    """A named stretch of a record's row."""

    __slots__ = ("place",)

    def __init__(self, start: int, stop: int) -> None:
        self.place = slice(start, stop)

    @overload
    def __get__(self, record: None, owner: type[Any]) -> Part: ...
    @overload
    def __get__(self, record: _Record, owner: type[Any]) -> F64: ...
    def __get__(self, record: _Record | None, owner: type[Any]) -> Part | F64:
        return self if record is None else record.row[self.place]


class Element:
    """A named number of a record's row."""

    __slots__ = ("place",)

    def __init__(self, place: int) -> None:
        self.place = place

    @overload
    def __get__(self, record: None, owner: type[Any]) -> Element: ...
    @overload
    def __get__(self, record: _Record, owner: type[Any]) -> float: ...
    def __get__(self, record: _Record | None, owner: type[Any]) -> Element | float:
        return self if record is None else record.row.item(self.place)


@dataclass(slots=True, eq=False)
class FlatOutput:
    """One point of a reference: the flat outputs (position, yaw) and their time derivatives."""

    row: F64
    """(17,) the parts below in their order."""
    pos_ned_m = Part(0, 3)
    vel_ned_mps = Part(3, 6)
    acc_ned_mps2 = Part(6, 9)
    jerk_ned_mps3 = Part(9, 12)
    snap_ned_mps4 = Part(12, 15)
    yaw_rad = Element(15)
    yaw_rate_radps = Element(16)

    @classmethod
    def of(
        cls,
        pos_ned_m: F64,
        vel_ned_mps: F64,
        acc_ned_mps2: F64,
        jerk_ned_mps3: F64,
        snap_ned_mps4: F64,
        yaw_rad: float = 0.0,
        yaw_rate_radps: float = 0.0,
    ) -> FlatOutput:
        """From its parts."""
        yaw = (yaw_rad, yaw_rate_radps)
        return cls(np.concatenate([pos_ned_m, vel_ned_mps, acc_ned_mps2, jerk_ned_mps3, snap_ned_mps4, yaw]))

    def later(self, span_s: float) -> FlatOutput:
        """The point so much later, by its own derivatives: of 60 ms at figure8's speed, within 1 um."""
        row, t = self.row.copy(), span_s
        for order in range(4):  # position to jerk, from those above
            for above, share in enumerate((t, t**2 / 2.0, t**3 / 6.0, t**4 / 24.0)[: 4 - order]):
                at = 3 * (order + 1 + above)
                row[3 * order : 3 * order + 3] += share * self.row[at : at + 3]
        row[rows.YAW] += t * row[rows.YAW_RATE]
        return FlatOutput(row)


@dataclass(slots=True, eq=False)
class Measurement:
    """What the vehicle reports of itself, predicted to `t_us`; an age is `t_us` minus the stream's own sample time."""

    t_us: int
    row: F64
    """(20,) the parts below in their order."""
    position_age_us: int
    attitude_age_us: int
    imu_age_us: int
    battery_v: float = math.nan
    """NaN where none is reported."""
    late_us: int = 0
    """How much later than now a command of this tick reaches the vehicle, as far as the link says; 0: at once."""
    felt: F64 | None = None
    """(20,) the same as `row` when it does, by what was sent; None: as now."""
    pos_ned_m = Part(0, 3)
    vel_ned_mps = Part(3, 6)
    q_ned_frd = Part(6, 10)
    rate_frd_radps = Part(10, 13)
    specific_force_frd_mps2 = Part(13, 16)
    motor_command = Part(16, 20)
    """Normalised commands last reported applied (0..1), NaN where the vehicle doesn't report them."""


@dataclass(slots=True, eq=False)
class Proposal:
    """What the controller wants, part by part, before limits and guard; body FRD unless named NED."""

    thrust_n: float
    """Feed-forward and feedback together."""
    row: F64
    """(20,) the parts below in their order."""
    thrust_ff_n = Element(0)
    thrust_fb_n = Element(1)
    rate_ff_frd_radps = Part(2, 5)
    rate_fb_frd_radps = Part(5, 8)
    attitude_error_rad = Part(8, 11)
    """Rotation vector from the measured to the wanted attitude."""
    nominal_acc_ned_mps2 = Part(11, 14)
    nominal_jerk_ned_mps3 = Part(14, 17)
    rate_frd_radps = Part(17, 20)
    """Feed-forward and feedback together."""


@dataclass(slots=True, eq=False)
class Learned:
    """What a learner knows at one tick: what to feed forward at the reference, and what it expects at the state.

    The residual is the specific force that the model does not explain at the thrust that acted, body FRD.
    """

    row: F64
    """(33,) the parts below in their order."""
    acc_ned_mps2 = Part(0, 3)
    """Unexplained acceleration at the reference, after gates and clips; thrust's own error is in `thrust_gain`."""
    jerk_ned_mps3 = Part(3, 6)
    """Its time derivative along the reference."""
    thrust_gain = Element(rows.L_GAIN)
    """Delivered over believed thrust per mass, 1 as believed; it scales every thrust that is asked for."""
    confidence = Element(rows.L_CONFIDENCE)
    """1 where the bound (three sigma) is nothing, 0 from 0.1 g on and where nothing is used."""
    stage = Element(rows.L_STAGE)
    """-1 there is no learner, 0 nothing, 1 calculable, 2 valid, 3 used, 4 used but frozen."""
    residual_frd_mps2 = Part(rows.L_RESIDUAL, rows.L_RESIDUAL + 3)
    """Expected residual at the measured state; NaN without a learner."""
    sigma_frd_mps2 = Part(rows.L_SIGMA, rows.L_SIGMA + 3)
    """Its calibrated standard deviation (three of them are the bound); NaN without a learner."""
    target_frd_mps2 = Part(rows.L_TARGET, rows.L_TARGET + 3)
    """The residual as measured at this tick; NaN where there was no fit sample."""
    thrust_gain_sigma = Element(rows.L_GAIN_SIGMA)
    """Standard deviation of the gain; at least the vertical bound's share of gravity."""
    rate_residual_frd_radps = Part(rows.L_RATE, rows.L_RATE + 3)
    """Expected body rates less those that the model of the rate loop says."""
    rate_sigma_frd_radps = Part(rows.L_RATE_SIGMA, rows.L_RATE_SIGMA + 3)
    applied_thrust_n = Element(rows.L_APPLIED)
    """Thrust that acted by the model: after latency and the rotors' lag."""
    latency_s = Element(rows.L_LATENCY)
    """From sending a command to its first effect, as identified; NaN until it is evident."""
    points = Element(rows.L_POINTS)
    """Points held."""
    fed = Element(rows.L_FED)
    """Samples taken so far."""
    refused = Element(rows.L_REFUSED)
    """Samples refused so far."""
    changes = Element(rows.L_CHANGES)
    """Sudden changes noticed so far."""
    surprise = Element(rows.L_SURPRISE)
    """Largest recent error of prediction, in its own standard deviations."""
    delay_s = Element(rows.L_DELAY)
    """Delay of commands that the sample was made with: the latency, and before that is evident the file's."""

    @classmethod
    def nothing(cls) -> Learned:
        """Without a learner: the model as believed."""
        row = np.zeros(rows.LEARNED)
        row[rows.L_GAIN], row[rows.L_STAGE] = 1.0, -1.0
        row[rows.L_RESIDUAL : rows.L_APPLIED] = np.nan
        row[rows.L_SURPRISE :] = np.nan
        return cls(row)


@dataclass(slots=True, eq=False)
class Filtered:
    """What the safety filter did with a command, and by what margins; what does not apply is NaN."""

    row: F64
    """(35,) the parts below in their order; axes are north, east, down."""
    h = Element(rows.F_H)
    """Least barrier value of the predicted state: at least 0 inside the certified region."""
    h_state = Element(rows.F_H_STATE)
    """The same at the measured position and velocity."""
    status = Element(rows.F_STATUS)
    """-1 there is no filter, 0 nothing is certified, 1 not engaged yet, 2 passed, 3 changed, 4 fallback: infeasible,
    5 fallback: not solved, 6 the certificate was falsified and nothing is left to keep to: commands pass."""
    margin_ps = Element(rows.F_MARGIN)
    """Least margin of the barrier condition at the acceleration that is sent, 1/s."""
    iterations = Element(rows.F_ITERATIONS)
    """Of the QP's solver."""
    residual = Element(rows.F_RESIDUAL)
    """Largest violation of a row of the QP by its solution, m/s^2."""
    version = Element(rows.F_VERSION)
    """Of the certificate."""
    intervened = Element(rows.F_INTERVENED)
    """1 where the command was changed."""
    wanted_acc_ned_mps2 = Part(rows.F_WANTED, rows.F_WANTED + 3)
    """What the controller's command steers towards."""
    safe_acc_ned_mps2 = Part(rows.F_SAFE, rows.F_SAFE + 3)
    """What the sent command steers towards."""
    low_ned_mps2 = Part(rows.F_LOW, rows.F_LOW + 3)
    """Least acceleration that the barriers allow."""
    high_ned_mps2 = Part(rows.F_HIGH, rows.F_HIGH + 3)
    margins_ned_ps = Part(rows.F_MARGINS, rows.F_MARGINS + 3)
    """Margin of each axis' condition at its best command, 1/s."""
    error_ned_m = Part(rows.F_ERROR, rows.F_ERROR + 3)
    """Predicted distance from the region's centre, as the barriers take it."""
    rate_ned_mps = Part(rows.F_RATE, rows.F_RATE + 3)
    """Its rate."""
    bound_ned_mps2 = Part(rows.F_BOUND, rows.F_BOUND + 3)
    """How far the acceleration may be off, as the certificate says."""
    wanted_thrust_n = Element(rows.F_THRUST)
    """The thrust asked for before filtering."""
    premise = Element(rows.F_PREMISE)
    """Number of the certificate's premise that is broken at this tick (`barrier.premise_watch.NAMES`), 0 none."""
    ended_by = Element(rows.F_ENDED_BY)
    """Number of the premise whose breach ended the certificate: the flight is at rest, or on its way there; 0 none."""

    @classmethod
    def nothing(cls) -> Filtered:
        """Without a filter."""
        row = np.full(rows.FILTERED, np.nan)
        row[rows.F_STATUS], row[rows.F_INTERVENED] = -1.0, 0.0
        row.flags.writeable = False  # one record serves many ticks, and flights
        return cls(row)

    def with_premise(self, broken: float, ended_by: float) -> Filtered:
        """The same with the certificate's premises as they stand."""
        row = self.row.copy()
        row[rows.F_PREMISE], row[rows.F_ENDED_BY] = broken, ended_by
        return Filtered(row)

    @property
    def handed_over(self) -> bool:
        """What the filter kept to was falsified, and nothing is left: the flight has to end."""
        return self.status == 6.0


made = tuple.__new__
"""`made(Command, (t_us, ...))`, every field given: a named tuple's own constructor takes twice as long.  For what each
tick makes."""

R = TypeVar("R", FlatOutput, Measurement, Learned, Filtered)


def changed(record: R, **values: Any) -> R:
    """The record with some of its parts or fields changed."""
    row = record.row.copy()
    own = {field.name: values.pop(field.name) for field in fields(record) if field.name in values}
    for name, value in values.items():
        row[getattr(type(record), name).place] = value
    return replace(record, row=row, **own)


class Command(NamedTuple):
    """What is sent: total thrust along body -z and body rates."""

    t_us: int
    thrust_n: float
    """Total thrust the model expects, newton (0 or more)."""
    thrust_norm: float
    """The same, as the normalised collective thrust that PX4 takes, 0..1."""
    rate_frd_radps: F64


class TickRecord(NamedTuple):
    """Why the command is what it is: one tick of the stack, for the log."""

    t_us: int
    reference: FlatOutput
    measurement: Measurement
    proposal: Proposal
    """NaN where the measurement was not fit for control."""
    learned: Learned
    command: Command
    thrust_saturated: bool
    guard: str
    """Empty where the guard let the command pass, else the name of what it did instead."""
    filtered: Filtered = Filtered.nothing()
    governed: bool = False
    """Whether the governor of rate commands changed the command."""

    @property
    def delay_s(self) -> float:
        """Delay of commands that the learner goes by; NaN where nothing learns."""
        learned = self.learned.row
        return learned.item(rows.L_DELAY) if learned.item(rows.L_STAGE) >= 0.0 else math.nan

    @property
    def digest(self) -> int:
        """CRC-32 over every bit of reference, proposal, what was learned and what was filtered."""
        said: Any = self.reference.row, self.proposal.row, self.learned.row, self.filtered.row
        return crc32(b"".join(said))
