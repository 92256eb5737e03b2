"""What the guard, the watch of resets and a certificate's premises did in flight, told once each."""

from __future__ import annotations

import math

import numpy as np

from flightstack.barrier.premise_watch import NAMES
from flightstack.rows import F_ENDED_BY, RATE_X
from flightstack.types import TickRecord
from mavlink_bridge.faults import FAULTS
from mavlink_bridge.onlookers import Observer
from mavlink_bridge.watchdogs import ResetWatch

_AT_REST_MPS, _REST_LEAST_US, _REST_MOST_US = 0.2, 1_000_000, 5_000_000
"""After a premise was broken: slower than this counts as rest; no sooner and no later than so long it ends."""

_EPISODE_APART_US = 1_000_000
"""A guard that has not acted for so long has let go."""

_SWING_RAD, _SWING_US = 0.4, 3_000_000
"""Of the angle turned otherwise than sent (rms), and over how long."""
_SWING_MOST, _SWING_GAP_US = 0.5, 100_000
"""What a tick and a gap between two count for at most (rad^2, us): a single tumble is the guard's."""
_RATES = slice(RATE_X, RATE_X + 3)
_TURN_US = 1_000_000
"""Over how long a turn is summed: a rate that is off for good counts as the angle of one second."""


class BrokenPremise:
    """Once a certificate's premise has ended it, the flight ends when the vehicle has come to rest."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._since_us = -1
        """Vehicle time at which a premise was broken; -1: none was."""

    def take(self, record: TickRecord) -> str:
        """A tick; why the flight ends now, empty: it goes on."""
        ended = record.filtered.row.item(F_ENDED_BY)
        if not ended > 0.0:
            self._since_us = -1
            return ""
        if self._since_us < 0:
            self._since_us = record.t_us
            text = f"premise broken: {NAMES[int(ended)]}: braking, to rest"
            self._observer.on_event(record.t_us, "filter", f"filter: {text}", "warning")
        calm = float(np.abs(record.measurement.vel_ned_mps).max()) < _AT_REST_MPS
        waited_us = record.t_us - self._since_us
        if waited_us > _REST_MOST_US or (calm and waited_us > _REST_LEAST_US):
            return f"premise of the certificate broken: {NAMES[int(ended)]}; braked, then landed"
        return ""


class Swinging:
    """Whether the vehicle turns as it is sent: the angle between measured and sent body rates, summed over a second.

    What counts is what was sent, not what the controller asks for: in a site the filter may send something else all
    the time.  The mean square of that angle is forgotten over some seconds.  Measured on a real PX4: at most 0.09 rad
    (rms) in figures of eight at default parameters, and 0.03 where the filter changed 95 of 100 commands.
    """

    def __init__(self) -> None:
        self._apart = (0.0, 0.0, 0.0)
        """Measured less sent turn by axis, rad, body FRD."""
        self._sent = (math.nan, math.nan, math.nan)
        self._square = 0.0
        self._t_us = 0

    def take(self, record: TickRecord) -> str:
        """A tick; why the flight ends now, empty: it goes on."""
        since_us = min(record.t_us - self._t_us, _SWING_GAP_US)
        left, sum_s = 1.0 - since_us / _TURN_US, 1e-6 * since_us
        self._t_us = record.t_us
        if not math.isnan(record.proposal.thrust_n):  # else what was measured is not fit to be judged by
            (x, y, z), (p, q, r), (roll, pitch, yaw) = self._apart, record.measurement.row[_RATES].tolist(), self._sent
            x, y, z = left * x + sum_s * (p - roll), left * y + sum_s * (q - pitch), left * z + sum_s * (r - yaw)
            square = x * x + y * y + z * z
            if square >= 0.0:  # no number where nothing was sent before
                self._apart = (x, y, z)
                self._square += since_us / _SWING_US * (min(square, _SWING_MOST) - self._square)
        x, y, z = record.command.rate_frd_radps.tolist()
        self._sent = (x, y, z)
        if self._square < _SWING_RAD * _SWING_RAD:
            return ""
        error_rad = math.sqrt(self._square)
        return (
            f"swinging: the vehicle turns {error_rad:.1f} rad (rms) otherwise than sent: look at PX4's rate gains and "
            "limits (MC_*RATE_MAX)"
        )


class GuardNotes:
    """Tells the observer when the guard begins to act and when it has let go, and each counted reset.

    A guard that acts now and then is one episode: told are its begin, each kind of act once, and the count at its end.
    """

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._guard = ""
        self._flown_us, self._at_us = 0, -1
        """What `guard_s` says, at the local time of the latest tick; -1: none yet."""
        self._acts: dict[str, int] = {}
        """How often each kind of act began in this episode; empty: none."""
        self._span_us = (0, 0)
        """Vehicle time of the episode's first and latest tick."""
        self._resets = 0

    def begin(self) -> None:
        """The flight begins, or goes on after somebody else flew."""
        self._flown_us, self._at_us = 0, -1

    def end(self, t_us: int) -> None:
        """Nobody is guarded any more: an episode ends."""
        if self._acts:
            self._tell_end(t_us, "acted until the flight ended:")

    def guard_s(self, now_us: int) -> float:
        """By how much longer the guard has flown of late than not.

        A stream at 5 Hz makes it fly nine tenths of the time without ever flying for 0.2 s on end.
        """
        return 1e-6 * self._flown_by(now_us)

    def _flown_by(self, now_us: int) -> int:
        """The same in microseconds."""
        if self._at_us < 0:
            return 0
        since_us = now_us - self._at_us
        return max(0, self._flown_us + (since_us if self._guard else -since_us))

    def take(self, guard: str, resets: ResetWatch, t_us: int, now_us: int) -> bool:
        """A tick's guard by name (empty: none) and the resets so far, vehicle and local time; whether one was new."""
        acts = "" if guard.startswith("clip") else guard
        self._flown_us, self._at_us = self._flown_by(now_us), now_us
        if acts:
            self._note(acts, t_us)
        elif self._acts and t_us - self._span_us[1] > _EPISODE_APART_US:
            self._tell_end(t_us, "lets go: acted")
        self._guard = acts
        is_new = resets.counted != self._resets
        if is_new:
            self._resets = resets.counted
            moved = ", ".join(f"{part:z.2f}" for part in resets.shift_ned_m)
            text = f"reset: {FAULTS['reset'].what}; taken out: ({moved}) m in all"
            self._observer.on_event(t_us, "fault", text, "warning")
        return is_new

    def _note(self, acts: str, t_us: int) -> None:
        if acts not in self._acts:
            self._observer.on_event(t_us, "guard", f"guard: {acts}", "warning")
        self._span_us = (self._span_us[0] if self._acts else t_us, t_us)
        self._acts[acts] = self._acts.get(acts, 0) + (acts != self._guard)

    def _tell_end(self, t_us: int, how: str) -> None:
        times, lasted_s = sum(self._acts.values()), 1e-6 * (self._span_us[1] - self._span_us[0])
        kinds = "; ".join(self._acts)
        often = f"{times} times" if times > 1 else "once"
        self._observer.on_event(t_us, "guard", f"guard: {how} {often} within {lasted_s:.1f} s ({kinds})", "info")
        self._acts = {}
