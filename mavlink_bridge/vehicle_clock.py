"""The vehicle's clock, seen from here: local monotonic time to the vehicle's time since boot.

A stamp is taken before it is sent, so (stamp - receipt) is the clocks' offset minus a latency that is never
negative: the largest values are the good ones.  The largest of each bucket of time is kept, and a line through the
buckets gives offset and rate.  A simulator may run several times faster than real time, and PX4's lockstep simulation
1.5 % slower: the controller lives in the vehicle's time, so both are no more than a rate.

One-way stamps can't tell a vehicle whose clock stood still for a moment (a simulator on a busy machine) from a link
that became slow.  Round trips (TIMESYNC) can: one that is quick and contradicts the line shows a clock that slipped.
On a link whose trips are never quick the line's time of a question is compared: the vehicle's answer may come to hold
more than that when the link slows down, but less only where the clock stood still, or where the whole trip became
quicker by as much.
"""

from __future__ import annotations

from collections import deque
from itertools import combinations, pairwise
from statistics import median

_BUCKET_US = 250_000
_BUCKETS = 12
_JUMP_US = 500_000
_ROUND_TRIP_MAX_US = 30_000
_SLIP_US = 2_000
_AHEAD_US = 10_000
"""A stamp so far ahead of the line: the clock ran ahead, and a line through both sides of that has a wrong rate."""
_TRIPS = 6
_REMEMBERED = 20
"""Round trips with which a new one is compared, two seconds of them."""
_STOOD_US = 5_000
"""By so much less an answer holds after the clock stood still; less than that harms nobody."""
_FITTED = 4
"""Buckets after which the rate is known well enough for that."""


class VehicleClock:
    """Maps local microseconds to the vehicle's microseconds since boot; fed with (stamp, time of receipt) pairs."""

    def __init__(self) -> None:
        self.rate = 1.0
        """Vehicle seconds per local second."""
        self.jumps = 0
        """How often stamps or a round trip left the line by over 0.5 s (a reboot, a jump): the fit began anew."""
        self.slips = 0
        """How often a round trip showed that the vehicle's clock had stood still or run ahead."""
        self._anchor: tuple[int, int] | None = None
        self._bucket_id = 0
        self._best: tuple[int, int] | None = None
        self._buckets: deque[tuple[int, int]] = deque(maxlen=_BUCKETS)
        self._trips: deque[tuple[int, int]] = deque(maxlen=_TRIPS)
        """Local and vehicle time in the middle of the last round trips."""
        self._ways: deque[tuple[int, int]] = deque(maxlen=_REMEMBERED)
        """By how much their answers were later than the line had it when they were asked, and what they took."""
        self._fits = False
        """The rate has once been fitted to a second of stamps."""

    @property
    def synchronised(self) -> bool:
        """Whether any stamp has been seen."""
        return self._anchor is not None

    def observe(self, stamp_us: int, local_us: int) -> None:
        """Take one message's stamp (vehicle time) and its time of receipt (local time)."""
        if self._anchor is None:
            self._restart(stamp_us, local_us)
            return
        (local0, stamp0), rate = self._anchor, self.rate
        lead = stamp_us - stamp0 - round((local_us - local0) * rate)
        if abs(lead) > _JUMP_US and abs(lead) > _JUMP_US * rate and len(self._buckets) >= 2:
            self.jumps += 1
            self._restart(stamp_us, local_us)
            return
        if lead > _AHEAD_US * max(1.0, rate) and len(self._buckets) >= 2:  # none comes before it was sent
            self.slips += 1
            self._restart(stamp_us, local_us)
            self.rate = rate
            return
        bucket = local_us // _BUCKET_US
        if bucket != self._bucket_id:
            if self._best is not None:
                self._buckets.append(self._best)
                self._fit()
            self._bucket_id, self._best = bucket, (local_us, stamp_us)
        elif self._best is None or lead > self._best[1] - self.vehicle_us(self._best[0]):
            self._best = (local_us, stamp_us)
        if len(self._buckets) < 2 and lead > 0:  # too early for a line: the least latency so far
            self._anchor = (local_us, stamp_us)

    def observe_round_trip(self, asked_us: int, vehicle_us: int, answered_us: int) -> None:
        """Take an answered TIMESYNC: local times of question and answer, and the vehicle's time in between."""
        trip_us = answered_us - asked_us
        if self._anchor is None or trip_us < 0:
            return
        way_us = vehicle_us - self.vehicle_us(asked_us)
        if trip_us > _ROUND_TRIP_MAX_US and way_us > (trip_us + _STOOD_US) * max(1.0, self.rate):
            return  # no way takes longer than the whole trip: it is by another clock than the stamps
        if self._has_stood(way_us, trip_us):
            self.slips += 1
            rate = self.rate
            self._restart(vehicle_us, answered_us)
            self.rate = rate
            return
        if trip_us > _ROUND_TRIP_MAX_US:
            return
        middle_us = (asked_us + answered_us) // 2
        error_us = vehicle_us - self.vehicle_us(middle_us)
        if not self._trips or middle_us > self._trips[-1][0]:
            self._trips.append((middle_us, vehicle_us))
        if abs(error_us) > (trip_us / 2 + _SLIP_US) * max(1.0, self.rate):
            self.slips += 1
            jumped = abs(error_us) > _JUMP_US * max(1.0, self.rate)
            self.jumps += jumped
            told = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in pairwise(self._trips)]
            fitted = jumped or len(self._buckets) >= 2 or len(told) < 2
            rate = self.rate if fitted else median(told)
            self._restart(
                vehicle_us, answered_us
            )  # as stamps are taken: by receipt, without what the link always takes
            self.rate = rate

    def vehicle_us(self, local_us: int) -> int:
        """The vehicle's time at a local time; local time itself before the first stamp."""
        if self._anchor is None:
            return local_us
        local0, stamp0 = self._anchor
        return stamp0 + round((local_us - local0) * self.rate)

    def _has_stood(self, way_us: int, trip_us: int) -> bool:
        """Whether an answer is less late than any of late, by more than the trip was quicker."""
        least_us = min((way for way, _ in self._ways), default=way_us)
        quicker_us = max(min((trip for _, trip in self._ways), default=trip_us) - trip_us, 0)
        self._ways.append((way_us, trip_us))
        return self._fits and least_us - way_us - quicker_us * max(1.0, self.rate) > _STOOD_US * max(1.0, self.rate)

    def _restart(self, stamp_us: int, local_us: int) -> None:
        self._anchor = (local_us, stamp_us)
        self._bucket_id, self._best = local_us // _BUCKET_US, (local_us, stamp_us)
        self._buckets.clear()
        self._ways.clear()
        self.rate = 1.0

    def _fit(self) -> None:
        """A line with the median of the buckets' slopes (robust to bursts), through the pair with the least latency."""
        if len(self._buckets) < 2:
            return
        self._fits = self._fits or len(self._buckets) >= _FITTED
        self.rate = median((b[1] - a[1]) / (b[0] - a[0]) for a, b in combinations(self._buckets, 2))
        self._anchor = max(self._buckets, key=lambda pair: pair[1] - self.rate * pair[0])
