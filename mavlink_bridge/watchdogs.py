"""What the companion watches in flight: the estimate, its resets, the vehicle's clock and its own pace.

Sans-IO.  `see` takes every message of the vehicle before anyone else does and gives the position back without the jumps
of the estimator's resets; `step` is called once a tick and names the first row of `faults.FAULTS` that applies.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from flightstack.consistency import JUMP_M, VELOCITY_ERROR_MPS, EstimateWatch
from flightstack.types import Tuple3
from mavlink_bridge import messages as m
from mavlink_bridge.aid_watch import AidWatch
from mavlink_bridge.vehicle_clock import VehicleClock

PERIOD_US = 4_000
GAP_US = 250_000
"""No tick for so long: the vehicle flew on its last rates all the while."""
SLEPT_US, AWAKE_US = 100_000, 250_000
"""No failsafe for want of setpoints acts sooner than the first; in the second all that has piled up is read."""
_READ_US = 50_000
"""That much of it is read within so long: a thousand datagrams a tick, 45 ms for 3 s of a real PX4."""
_MISSED_SHARE = 0.84
"""Of the ticks of a second: 40 Hz are left, 25 ms between ticks.  At 25 Hz a figure of eight of 3 m/s with the noise of
a real PX4 still flies as at 250 Hz in simulation (tilt at most 30 degrees, same error)."""
_SECOND_US = 1_000_000
_COUNTED_STEP_M = 0.05
_COUNT_WITHIN_US = 200_000
_RESETS, _RESETS_WITHIN_US = 3, 10_000_000
_UNAIDED_S = 5.0
"""EKF2_NOAID_TOUT's default: for so long PX4's estimator holds a position without aid for good."""
RESET_MOST_M = VELOCITY_ERROR_MPS * _UNAIDED_S
"""What a vehicle can have moved unnoticed: a velocity that is off by more contradicts the IMU.  A farther reset says
that one of the two positions is wrong, and not which."""
_STEPS_KEPT = 16
_BACK_US = 1_000_000
_MOVED_US = 50_000
"""Of stamps: a vehicle's clock that takes seconds for it stands still; the slowest simulator asked for needs one."""
_FLAG_ATTITUDE = 0x01
_FLAGS_STATE = 0x26
"""ESTIMATOR_STATUS.flags: horizontal and vertical velocity, height."""
_FLAGS_POSITION = 0x18
_FLAGS_TWICE = 2


@dataclass(slots=True)
class ResetWatch:
    """Jumps of position, counted or not: `shift_ned_m` is what they add up to since `begin`."""

    shift_ned_m: Tuple3 = (0.0, 0.0, 0.0)
    counted: int = 0
    """Counted steps since `begin`."""
    _counter: int = -1
    _steps: deque[tuple[int, Tuple3]] = field(default_factory=lambda: deque(maxlen=_STEPS_KEPT))
    """(stamp, unexplained step) of the newest samples that are not in the shift."""
    _far: bool = False
    """A step was farther than `RESET_MOST_M`."""
    _uncounted_us: int = -1
    """Stamp of a jump that no counter has told yet; -1: none."""
    _resets_us: deque[int] = field(default_factory=lambda: deque(maxlen=_RESETS))
    _now_us: int = 0

    def begin(self) -> None:
        """From here on jumps are taken out."""
        self.shift_ned_m, self.counted = (0.0, 0.0, 0.0), 0
        self._uncounted_us, self._far = -1, False
        self._steps.clear()
        self._resets_us.clear()

    def position(self, t_us: int, step_ned_m: Tuple3) -> bool:
        """Take a sample's unexplained step; whether it is a jump, and now in the shift."""
        self._now_us = max(self._now_us, t_us)
        if _size(step_ned_m) < JUMP_M:
            self._steps.append((t_us, step_ned_m))
            return False
        self._add(step_ned_m)
        self._uncounted_us = t_us
        return True

    def counter(self, t_us: int, count: int) -> bool:
        """Take ODOMETRY's reset counter; whether it tells of a step of position."""
        before, self._counter = self._counter, count
        if before in (-1, count):
            return False
        if self._uncounted_us < 0:  # a small one, if any: the largest of the last samples
            when, step = max(self._steps, key=lambda one: _size(one[1]), default=(0, (0.0, 0.0, 0.0)))
            if _size(step) < _COUNTED_STEP_M:
                return False  # of heading or velocity: nothing to take out
            self._add(step)
            self._steps = deque((one for one in self._steps if one[0] != when), maxlen=_STEPS_KEPT)
        self._uncounted_us = -1
        self.counted += 1
        self._resets_us.append(t_us)
        return True

    @property
    def trouble(self) -> str:
        """Name of a row, empty where all is well."""
        if self._far:
            return "reset-far"
        if 0 <= self._uncounted_us < self._now_us - _COUNT_WITHIN_US:
            return "jump"
        resets = self._resets_us
        return "resets" if len(resets) == _RESETS and resets[-1] - resets[0] < _RESETS_WITHIN_US else ""

    def _add(self, step: Tuple3) -> None:
        self._far = self._far or _size(step) > RESET_MOST_M
        north, east, down = self.shift_ned_m
        self.shift_ned_m = (north + step[0], east + step[1], down + step[2])


@dataclass(slots=True)
class PaceWatch:
    """Our own ticks, counted in the vehicle's time: how many were missed, and the longest gap of late."""

    period_us: int = PERIOD_US
    _last_us: int = -1
    _missed: deque[tuple[int, int]] = field(default_factory=deque)
    _sum: int = 0
    gap_us: int = 0
    """The newest one."""
    slept_gap_us: int = 0
    """The newest one of at least `SLEPT_US`."""
    _slept_us: int = -AWAKE_US

    def step(self, now_us: int, rate: float) -> str:
        """A tick at local time `now_us`, `rate` vehicle seconds per local second; name of a row, or empty."""
        if self._last_us < 0:
            self._last_us = now_us
            return ""
        self.gap_us, self._last_us = round((now_us - self._last_us) * rate), now_us
        missed = round(self.gap_us / self.period_us) - 1 if self.gap_us > self.period_us else 0
        if missed:
            self._missed.append((now_us, missed))
            self._sum += missed
        while self._missed and (now_us - self._missed[0][0]) * rate > _SECOND_US:
            self._sum -= self._missed.popleft()[1]
        if self.gap_us >= SLEPT_US:
            self._slept_us, self.slept_gap_us = now_us, self.gap_us
        if self.gap_us >= GAP_US:
            return "overrun-gap"
        return "overrun-rate" if self._sum * self.period_us >= _MISSED_SHARE * _SECOND_US else ""

    def has_slept(self, now_us: int) -> bool:
        """There was no tick for so long that PX4 may have acted on it, and what it said since may not be read yet."""
        return now_us - self._slept_us < AWAKE_US

    def may_have_acted(self, heard_us: int, now_us: int, loss_s: float) -> bool:
        """Whether PX4, which acts on its own after `loss_s` without setpoints, may have another mode than was heard."""
        slept_us = self.slept_gap_us if self.has_slept(now_us) else 0
        return slept_us >= max(SLEPT_US, 1e6 * loss_s) and heard_us <= self._slept_us + _READ_US

    def begin(self) -> None:
        """Forget what was missed so far."""
        self._missed.clear()
        self._sum = 0


class Watchdogs:
    """All of them for one flight."""

    def __init__(self, clock: VehicleClock, tick_s: float = 1e-6 * PERIOD_US) -> None:
        self.estimate = EstimateWatch()
        self.resets = ResetWatch()
        self.pace = PaceWatch(round(1e6 * tick_s))
        self.aid = AidWatch()
        self._now_us = 0
        """Local time of the latest tick."""
        self._clock = clock
        self._clock_jumps = 0
        self._newest_us = -1
        self._moved = (0, -1)
        """Local time and stamp when the stamps had last moved on."""
        self.stood_us = 0
        """For so long stamps have come and not moved on."""
        self._behind = False
        self._bad_flags = 0
        self._flags_trouble = ""
        self._flying = False
        self._pace_trouble = ""

    def begin(self) -> None:
        """The flight begins: jumps are taken out from here on, old troubles are forgotten."""
        self._flying = True
        self.resets.begin()
        self.pace.begin()
        self._clock_jumps = self._clock.jumps

    def resume(self) -> None:
        """The flight goes on after a stall: what was missed meanwhile means nothing."""
        self.pace.begin()
        self.estimate.forgive()

    def see(self, message: object) -> object:
        """Take a message; the same one back, a position without the jumps of the flight."""
        look = _LOOKS.get(type(message))
        return message if look is None else look(self, message)

    def step(self, now_us: int) -> None:
        """A tick at local time `now_us`."""
        self._now_us = now_us
        self._pace_trouble = self.pace.step(now_us, self._clock.rate)

    def judge(self) -> tuple[str, str]:
        """Names of two rows: one that says that the state is not fit to fly with, and the first that applies at all.

        Empty where all is well.
        """
        contradiction = self.estimate.trouble
        unfit = self._flags_trouble or contradiction
        if self._clock.jumps > self._clock_jumps:
            jump = "reboot" if self._behind else "clock"
            if self._flying:
                return unfit, jump
            unfit = jump if self._behind else unfit
        lost = "gps-lost" if self._flying and self.aid.is_lost(self._now_us) else ""
        return unfit, self._pace_trouble or self._flags_trouble or self.resets.trouble or contradiction or lost

    @property
    def trouble(self) -> str:
        """The second of the two."""
        return self.judge()[1]

    @property
    def is_flying(self) -> bool:
        """The flight has begun: jumps are taken out."""
        return self._flying

    def note_stamp(self, t_us: int) -> None:
        """The IMU's stamps go on; one far behind the newest comes from another boot, if the clock's line broke too."""
        if abs(t_us - self._moved[1]) >= _MOVED_US:
            self._moved = (self._now_us, t_us)
        self.stood_us = self._now_us - self._moved[0]
        self._behind = t_us < self._newest_us - _BACK_US
        if not self._behind and t_us > self._newest_us:
            self._newest_us = t_us

    def has_stepped(self, t_us: int) -> None:
        """A position in flight was watched (`estimate`): whether it is a jump, which the estimate is forgiven for."""
        if self.resets.position(t_us, self.estimate.step_ned_m):
            self.estimate.forgive()

    def _imu(self, message: m.HighresImu) -> m.HighresImu:
        self.note_stamp(message.t_us)
        self.estimate.imu(message.t_us, message.accel_frd_mps2, message.rate_frd_radps)
        return message

    def _attitude(self, message: m.AttitudeQuaternion) -> m.AttitudeQuaternion:
        self.estimate.attitude(message.t_boot_us, message.q_ned_frd, message.rate_frd_radps)
        return message

    def _odometry(self, message: m.Odometry) -> m.Odometry:
        if self.resets.counter(message.t_us, message.reset_counter):
            self.estimate.forgive()
        return message

    def _status(self, message: m.EstimatorStatus) -> m.EstimatorStatus:
        self._flags(message.flags)
        self.aid.estimator(message)
        return message

    def _gps(self, message: m.GpsRawInt) -> m.GpsRawInt:
        self.aid.gps(message.fix_type, self._now_us)
        return message

    def _position(self, message: m.LocalPositionNed) -> m.LocalPositionNed:
        self.estimate.position(message.t_boot_us, message.pos_ned_m, message.vel_ned_mps)
        if not self._flying:
            return message
        self.has_stepped(message.t_boot_us)
        shift = self.resets.shift_ned_m
        if shift == (0.0, 0.0, 0.0):
            return message
        north, east, down = message.pos_ned_m
        return message._replace(pos_ned_m=(north - shift[0], east - shift[1], down - shift[2]))

    def _flags(self, flags: int) -> None:
        bad = ""
        if not flags & _FLAG_ATTITUDE:
            bad = "estimator-attitude"
        elif flags & _FLAGS_STATE != _FLAGS_STATE or not flags & _FLAGS_POSITION:
            bad = "estimator-position"
        self._bad_flags = self._bad_flags + 1 if bad else 0
        self._flags_trouble = bad if self._bad_flags >= _FLAGS_TWICE else ""


_LOOKS: dict[type, Callable[[Watchdogs, Any], object]] = {
    m.HighresImu: Watchdogs._imu,
    m.AttitudeQuaternion: Watchdogs._attitude,
    m.LocalPositionNed: Watchdogs._position,
    m.Odometry: Watchdogs._odometry,
    m.EstimatorStatus: Watchdogs._status,
    m.GpsRawInt: Watchdogs._gps,
}


def _size(step: Tuple3) -> float:
    return max(abs(step[0]), abs(step[1]), abs(step[2]))
