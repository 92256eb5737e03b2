"""The vehicle's clock, seen from here: local monotonic time to the vehicle's time since boot.

A stamp is taken before it is sent, so (stamp - receipt) is the clocks' offset minus a latency that is never
negative: the largest values are the good ones.  The largest of each bucket of time is kept, and a line through the
buckets gives offset and rate.  A simulator may run several times faster than real time, and PX4's lockstep simulation
1.5 % slower: the controller lives in the vehicle's time, so both are no more than a rate.
"""

from __future__ import annotations

from collections import deque

_BUCKET_US = 250_000
_BUCKETS = 12
_JUMP_US = 500_000


class VehicleClock:
    """Maps local microseconds to the vehicle's microseconds since boot; fed with (stamp, time of receipt) pairs."""

    def __init__(self) -> None:
        self.rate = 1.0
        """Vehicle seconds per local second."""
        self.jumps = 0
        """How often the stamps left the line by more than half a second (a reboot, a jump): the fit began anew."""
        self._anchor: tuple[int, int] | None = None
        self._bucket_id = 0
        self._best: tuple[int, int] | None = None
        self._buckets: deque[tuple[int, int]] = deque(maxlen=_BUCKETS)

    @property
    def synchronised(self) -> bool:
        """Whether any stamp has been seen."""
        return self._anchor is not None

    def observe(self, stamp_us: int, local_us: int) -> None:
        """Take one message's stamp (vehicle time) and its time of receipt (local time)."""
        if self._anchor is None:
            self._restart(stamp_us, local_us)
            return
        lead = stamp_us - self.vehicle_us(local_us)
        if abs(lead) > _JUMP_US * max(1.0, self.rate) and len(self._buckets) >= 2:
            self.jumps += 1
            self._restart(stamp_us, local_us)
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

    def vehicle_us(self, local_us: int) -> int:
        """The vehicle's time at a local time; local time itself before the first stamp."""
        if self._anchor is None:
            return local_us
        local0, stamp0 = self._anchor
        return stamp0 + round((local_us - local0) * self.rate)

    def _restart(self, stamp_us: int, local_us: int) -> None:
        self._anchor = (local_us, stamp_us)
        self._bucket_id, self._best = local_us // _BUCKET_US, (local_us, stamp_us)
        self._buckets.clear()
        self.rate = 1.0

    def _fit(self) -> None:
        """Least-squares line through the buckets' best pairs, raised to touch the one with the least latency."""
        if len(self._buckets) < 2:
            return
        local0, stamp0 = self._buckets[0]
        xs = [local - local0 for local, _ in self._buckets]
        ys = [stamp - stamp0 for _, stamp in self._buckets]
        n = len(xs)
        mean_x, mean_y = sum(xs) / n, sum(ys) / n
        sxx = sum((x - mean_x) ** 2 for x in xs)
        self.rate = sum((x - mean_x) * (y - mean_y) for x, y in zip(xs, ys, strict=True)) / sxx
        self._anchor = max(self._buckets, key=lambda pair: pair[1] - self.rate * pair[0])
