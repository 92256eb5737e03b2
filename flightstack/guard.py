"""The independent last word on every command: finite, fresh, inside the envelope; else the stated fallback.

It knows the model's numbers and the limits, nothing of controller, learner or filter, and never raises.

| what is wrong                                           | what is sent instead                                     |
| ------------------------------------------------------- | -------------------------------------------------------- |
| attitude missing, stale or not finite                   | zero_rates: no rotation, the thrust that carried so far  |
| position, velocity or IMU missing, stale or not finite  | level: level attitude, 3 % less than that thrust (sinks) |
| tilt beyond `tilt_abort_rad`                            | brake: lean against the velocity, sink at 0.5 m/s        |
| position outside `radius_m`, `height_m`                 | brake, as the safety filter lets it pass                 |
| command not finite                                      | brake                                                    |
| tilt beyond 60 degrees as well                          | level and brake: less thrust, from 90 degrees the least  |
| thrust or rates outside their limits                    | clip: the nearest allowed ones                           |

Outside the envelope a certificate still holds: the stack asks `turn_back` before the filter, so that the brake keeps
the certified region, and the guard's own brake is left to a command that comes back as no number.

Ending the flight is the companion's business: it sees the name in the record and lands.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.frames import quat_to_matrix
from flightstack.jit import Entry, njit
from flightstack.model import Limits, Model
from flightstack.rows import Q_W, Q_X, Q_Y, Q_Z
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Command, Measurement

_LEVEL_GAIN_PS = 4.0
_BRAKE_GAIN_PS = 1.0
_BRAKE_MAX_MPS2 = 3.0
_SINK_MPS = 0.5
_SINK_GAIN_PS = 3.0
_FASTEST_MPS = 1e6
"""Of what is believed: the greatest float times a gain is infinite, and that times no thrust at all is no number."""
_LEVEL_SINK_SHARE = 0.97
_CARRIED_TIME_CONSTANT_US = 1_000_000

OUTSIDE = "brake: outside the envelope"
_THRUST_LEAST, _THRUST_MOST, _RATES, _RADIUS, _HEIGHT, _UPRIGHT, _MASS = 0, 1, 2, 5, 6, 7, 8
"""Of the bounds."""
_PASS, _CLIP, _COMMAND, _TILT, _ENVELOPE, _POSITION, _ATTITUDE = range(7)
_NAMES = (
    "",
    "clip: command beyond its limits",
    "brake: command not finite",
    "brake: tilt",
    OUTSIDE,
    "level: position lost",
    "zero_rates: attitude lost",
)


def carried_thrust(before_n: float, command: Command, measurement: Measurement, dt_us: int) -> float:
    """The vertical part of the thrust sent, low-passed over a second: what keeps this vehicle up, whatever its mass."""
    x, y = measurement.row[7:9].tolist()
    vertical = command.thrust_n * (1.0 - 2.0 * (x * x + y * y))
    share: float = min(max(dt_us / _CARRIED_TIME_CONSTANT_US, 0.0), 1.0)
    return before_n + share * (float(vertical) - before_n)


def stale(measurement: Measurement | None, limits: Limits) -> str:
    """Name of the stream that is missing, or older than three of its periods plus the link's latency ("" if none)."""
    if measurement is None:
        return "attitude"
    latency = limits.latency_max_us
    if measurement.attitude_age_us > limits.attitude_age_max_us + latency:
        return "attitude"
    if measurement.position_age_us > limits.position_age_max_us + latency:
        return "position"
    return "imu" if measurement.imu_age_us > limits.imu_age_max_us + latency else ""


class Guard:
    """The guard of one flight; final, holds only constants."""

    __slots__ = ("_bounds", "limits", "model")

    def __init__(self, model: Model, limits: Limits) -> None:
        self.model = model
        self.limits = limits
        low, high = model.thrust_range_n(limits)
        self._bounds = np.array(
            [
                low, high, *limits.rate_max_radps, limits.radius_m, limits.height_m,
                math.cos(limits.tilt_abort_rad), model.mass_kg,
            ]
        )  # fmt: skip

    def turn_back(
        self, command: Command, measurement: Measurement, origin_ned_m: F64, carried_n: float, now_us: int
    ) -> tuple[Command, bool]:
        """What a safety filter is to make safe: the brake and True outside the envelope, else the command and False.

        The arguments are those of `check`.
        """
        if not _OUTSIDE.call(measurement.row, origin_ned_m, self._bounds):
            return command, False
        brake, name = self.check(command, measurement, origin_ned_m, carried_n, now_us)
        return (brake, True) if name == OUTSIDE else (command, False)

    def check(
        self, command: Command, measurement: Measurement | None, origin_ned_m: F64, carried_n: float, now_us: int,
        turned: bool = False,
    ) -> tuple[Command, str]:  # fmt: skip
        """The command to send, and the name of what was done to it ("" where it passed).

        `origin_ned_m` (3,): where the vehicle was armed; `carried_n`: the vertical thrust that carried it so far, N;
        `turned`: the command is what a filter made of `turn_back`'s brake.
        """
        lost = stale(measurement, self.limits)
        rate = np.zeros(3)
        carried = carried_n if math.isfinite(carried_n) else self.model.weight_n
        if measurement is None or lost == "attitude":
            code, thrust = _ATTITUDE, min(max(carried, float(self._bounds[0])), float(self._bounds[1]))
        else:
            code, thrust = _JUDGE.call(
                (command.thrust_n, command.thrust_norm), command.rate_frd_radps, measurement.row,
                origin_ned_m, carried, self._bounds, (lost != "", turned), rate,
            )  # fmt: skip
        if code == _PASS:
            return command, OUTSIDE if turned else ""
        return Command(now_us, thrust, self.model.norm_of(thrust), rate), _NAMES[code]


@njit
def _finite(values: F64) -> bool:
    for value in values:  # noqa: SIM110  compiled: no generators
        if not math.isfinite(value):
            return False
    return True


@njit
def _outside(pos: F64, origin: F64, bounds: F64) -> bool:
    """Of the envelope; so is what is no number."""
    north, east, down = pos[0] - origin[0], pos[1] - origin[1], pos[2] - origin[2]
    return not (north * north + east * east <= bounds[_RADIUS] * bounds[_RADIUS] and -down <= bounds[_HEIGHT])


@njit
def _judge(
    thrusts: tuple[float, float], rate: F64, measured: F64, origin: F64, carried: float, bounds: F64,
    found: tuple[bool, bool], out: F64,
) -> tuple[int, float]:  # fmt: skip
    """What is wrong (the worst first) and the thrust for it; body rates in `out` (3,).

    `measured` (20,): a Measurement's row.  `bounds` (9,): least and greatest thrust, rates (3), radius, height, cosine
    of the greatest tilt, mass.  `thrusts`: N and normalised; `found`: position is lost; the
    command brakes outside the envelope already.
    """
    (thrust, thrust_norm), (lost, turned) = thrusts, found
    pos, vel, q, body_rate = measured[0:3], measured[3:6], measured[6:10], measured[10:13]
    carried = min(max(carried, bounds[_THRUST_LEAST]), bounds[_THRUST_MOST])
    norm = q[Q_W] * q[Q_W] + q[Q_X] * q[Q_X] + q[Q_Y] * q[Q_Y] + q[Q_Z] * q[Q_Z]
    if not (abs(norm - 1.0) < 1e-3 and _finite(body_rate)):
        return _ATTITUDE, carried
    still = np.zeros(3)
    if lost or not (_finite(pos) and _finite(vel)):
        cosine = _lean(q, still, bounds, out)
        return _POSITION, max(_LEVEL_SINK_SHARE * carried * _upright(cosine), bounds[_THRUST_LEAST])
    code = _PASS
    if not turned and _outside(pos, origin, bounds):
        code = _ENVELOPE
    elif not quat_to_matrix(q)[2, 2] >= bounds[_UPRIGHT]:
        code = _TILT
    elif not (_finite(rate) and math.isfinite(thrust) and math.isfinite(thrust_norm)):
        code = _COMMAND
    if code != _PASS:
        cosine = _lean(q, vel, bounds, out)
        sink = min(max(vel[2], -_FASTEST_MPS), _FASTEST_MPS)
        wanted = carried + bounds[_MASS] * _SINK_GAIN_PS * (sink - _SINK_MPS)
        wanted *= _upright(cosine) / max(cosine, 0.5)
        return code, min(max(wanted, bounds[_THRUST_LEAST]), bounds[_THRUST_MOST])
    clipped = min(max(thrust, bounds[_THRUST_LEAST]), bounds[_THRUST_MOST])
    if clipped != thrust or not 0.0 <= thrust_norm <= 1.0:
        code = _CLIP
    for i in range(3):
        out[i] = min(max(rate[i], -bounds[2 + i]), bounds[2 + i])
        if out[i] != rate[i]:
            code = _CLIP
    return code, clipped


@njit
def _upright(cosine: float) -> float:
    """Share of the thrust that is worth sending: 1 up to 60 degrees of tilt, 0 from 90 on, where it pushes down."""
    return min(max(2.0 * cosine, 0.0), 1.0)


@njit
def _lean(q: F64, vel: F64, bounds: F64, out: F64) -> float:
    """Body rates (into `out`) that lean the thrust against the horizontal velocity; the cosine of the present tilt."""
    r = quat_to_matrix(q)
    speed = math.sqrt(vel[0] * vel[0] + vel[1] * vel[1])
    brake = min(_BRAKE_GAIN_PS, _BRAKE_MAX_MPS2 / max(speed, 1e-9))
    north, east, down = brake * vel[0], brake * vel[1], STANDARD_GRAVITY_MPS2
    length = math.sqrt(north * north + east * east + down * down)
    x = (r[0, 0] * north + r[1, 0] * east + r[2, 0] * down) / length  # the wanted thrust axis, in body axes
    y = (r[0, 1] * north + r[1, 1] * east + r[2, 1] * down) / length
    z = (r[0, 2] * north + r[1, 2] * east + r[2, 2] * down) / length
    gain = _LEVEL_GAIN_PS
    if z < 0.0:  # more than a quarter turn away: as fast as at a quarter turn, about roll where undecided
        size = math.sqrt(x * x + y * y)
        gain = _LEVEL_GAIN_PS / max(size, 1e-9)
        y = y if size > 1e-9 else 1e-9
    out[0] = min(max(-gain * y, -bounds[_RATES]), bounds[_RATES])
    out[1] = min(max(gain * x, -bounds[_RATES + 1]), bounds[_RATES + 1])
    out[2] = 0.0
    return r[2, 2]  # type: ignore[no-any-return]


_OUTSIDE = Entry(_outside, "f8[::1], f8[::1], f8[::1]")
_JUDGE = Entry(_judge, "UniTuple(f8, 2), f8[::1], f8[::1], f8[::1], f8, f8[::1], UniTuple(b1, 2), f8[::1]")
