"""What was really applied of what was sent: the collective thrust by the motors' own word.

An autopilot may change a collective on its way to the motors: with the battery (PX4's MC_BAT_SCALE_EN), at its limits.
The motors' reported commands say by how much, on average over two seconds, so that sampling and delays fall out; what
differs by less than 3 % is the same.  Where the motors are not reported the commands that were sent have to do.
"""

from __future__ import annotations

from typing import NamedTuple

from flightstack.jit import Entry, njit
from flightstack.model import Model, thrust_to_norm
from flightstack.types import F64, Command, Tuple3, made

_TIME_CONSTANT_US = 2_000_000
_SAME = 0.03
_RANGE = (0.5, 2.0)
_LEAST_NORM = 0.2
"""Below this, as on the ground, mixing and idling say more than the collective."""
_RECENT_US = 50_000
_STEADY = 0.05
"""Thrust that changes faster than this share in 50 ms says more about delays."""
_KNOWN = 0.1
"""Of a sum that grows towards the collective: a quarter of the time constant or more was steady."""


class Applied(NamedTuple):
    """Forgetting sums of both collectives, over the ticks in which thrust was steady."""

    recent_norm: float = 0.0
    sent: float = 0.0
    measured: float = 0.0

    @property
    def ratio(self) -> float:
        """Applied over sent, 1 where they agree or too little is known."""
        if self.sent < _KNOWN:
            return 1.0
        ratio = self.measured / self.sent
        return 1.0 if abs(ratio - 1.0) < _SAME else min(max(ratio, _RANGE[0]), _RANGE[1])

    def follow(self, sent: Command, motor_command: F64, model: Model, dt_us: int) -> Applied:
        """One tick on; `motor_command` (4,): normalised commands as reported, NaN where they are not."""
        curve = model.max_thrust_n, model.thrust_model_factor
        return made(Applied, _FOLLOWED.call(*self, sent.thrust_norm, motor_command, *curve, dt_us))

    def of(self, sent: Command) -> Command:
        """The command as it was applied; the very same one where nothing was changed."""
        ratio = self.ratio
        return sent if ratio == 1.0 else sent._replace(thrust_norm=min(1.0, sent.thrust_norm * ratio))


@njit
def _followed(
    recent: float, sent: float, measured: float, norm: float, motors: F64, max_thrust: float, f: float, dt_us: float
) -> Tuple3:
    """As `Applied.follow` says: the sums one tick on."""
    recent += _share(dt_us / _RECENT_US) * (norm - recent)
    inside = True
    for command in motors:
        inside = inside and 0.0 <= command <= 1.0  # False for NaN
    if not (norm > _LEAST_NORM and abs(norm - recent) < _STEADY * norm and inside):
        return recent, sent, measured
    squares = total = 0.0
    for command in motors:
        squares, total = squares + command * command, total + command
    mean = 0.25 * (f * squares + (1.0 - f) * total)
    share = _share(dt_us / _TIME_CONSTANT_US)
    now = thrust_to_norm(mean * max_thrust, max_thrust, f)
    return recent, sent + share * (norm - sent), measured + share * (now - measured)


@njit
def _share(value: float) -> float:
    """Within 0..1."""
    return 0.0 if value < 0.0 else 1.0 if value > 1.0 else value


_FOLLOWED = Entry(_followed, "f8, f8, f8, f8, f8[::1], f8, f8, f8")
