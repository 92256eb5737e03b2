"""How much later a command reaches the vehicle than it is sent, in the time that the companion lives in.

That time is the vehicle's as its stamps tell it when they arrive, so it is behind the vehicle's own by what they take:
a command that goes out at T acts when the vehicle's clock shows T plus all that the link takes, there *and* back.  The
answer to a TIMESYNC question holds just that: the vehicle's time when it was asked, less ours when we asked.  How the
round trip is shared between both ways does not matter, nor when the answer arrives, and a clock that stood still
counts here as it counts in the ages of samples.

No command takes longer than the whole round trip: an answer that has it so, or has it come before it was sent, is by
another clock than the samples' stamps, and its trip counts in its place.

The median of the last answers counts, followed no faster than a reference may be moved; less than half a tick is
nothing.
"""

from __future__ import annotations

from collections import deque

from flightstack.under_way import LATE_MOST_US

_ANSWERS = 10
_LEAST_ANSWERS = 3
_FOLLOWED_US = 4_000
"""From one answer to the next, ten a second: 0.15 m/s at figure8's speed."""
_NOTHING_US = 2_000


class CommandWay:
    """Fed with answers; `late_us` is what counts."""

    def __init__(self) -> None:
        self._latest: deque[int] = deque(maxlen=_ANSWERS)
        self._followed_us = -1

    def answered(self, late_us: int, trip_us: int) -> None:
        """The vehicle's time in an answer less the companion's vehicle time when it asked; what the trip took of it."""
        possible = -_NOTHING_US <= late_us <= trip_us + _NOTHING_US
        self._latest.append(late_us if possible else trip_us)
        if len(self._latest) < _LEAST_ANSWERS:
            return
        middle_us = min(max(sorted(self._latest)[len(self._latest) // 2], 0), LATE_MOST_US)
        if self._followed_us < 0:
            self._followed_us = middle_us
        step_us = middle_us - self._followed_us
        self._followed_us += min(max(step_us, -_FOLLOWED_US), _FOLLOWED_US)

    @property
    def late_us(self) -> int:
        """Vehicle microseconds; 0 before enough is known."""
        return self._followed_us if self._followed_us >= _NOTHING_US else 0
